#include "platform/text_file.h"

#include <algorithm>
#include <charconv>
#include <span>
#include <vector>

#include "platform/files.h"
#include "platform/input_error.h"

namespace pptam::platform {
namespace {

void append_utf8(uint32_t code, std::string* text) {
  const auto put = [&](uint32_t byte) { text->push_back(static_cast<char>(byte)); };
  if (code < 0x80) {
    put(code);
  } else if (code < 0x800) {
    put(0xc0 | (code >> 6));
    put(0x80 | (code & 0x3f));
  } else if (code < 0x10000) {
    put(0xe0 | (code >> 12));
    put(0x80 | ((code >> 6) & 0x3f));
    put(0x80 | (code & 0x3f));
  } else {
    put(0xf0 | (code >> 18));
    put(0x80 | ((code >> 12) & 0x3f));
    put(0x80 | ((code >> 6) & 0x3f));
    put(0x80 | (code & 0x3f));
  }
}

// Of text in UTF-16 after its mark; halves of pairs that stand alone become U+FFFD.
std::string utf8_of_utf16(std::span<const std::byte> bytes, bool big_endian) {
  const auto unit = [&](size_t i) {
    const auto first = std::to_integer<uint32_t>(bytes[i]);
    const auto second = std::to_integer<uint32_t>(bytes[i + 1]);
    return big_endian ? (first << 8) | second : (second << 8) | first;
  };
  std::string text;
  text.reserve(bytes.size() / 2);
  for (size_t i = 0; i + 1 < bytes.size(); i += 2) {
    uint32_t code = unit(i);
    const bool first_of_pair = code >= 0xd800 && code < 0xdc00;
    const bool paired = first_of_pair && i + 3 < bytes.size() && unit(i + 2) >= 0xdc00 && unit(i + 2) < 0xe000;
    if (paired) {
      code = 0x10000 + ((code - 0xd800) << 10) + (unit(i + 2) - 0xdc00);
      i += 2;
    } else if (code >= 0xd800 && code < 0xe000) {
      code = 0xfffd;
    }
    append_utf8(code, &text);
  }
  return text;
}

// Without a mark, UTF-16 shows by the zeros beside its first two letters, which are ASCII's in all that we read.
std::string decoded(std::span<const std::byte> bytes) {
  const auto byte = [&](size_t i) { return i < bytes.size() ? std::to_integer<unsigned>(bytes[i]) : 0x100; };
  const auto is_ascii = [&](size_t i) { return byte(i) > 0 && byte(i) < 0x80; };
  if (byte(0) == 0xff && byte(1) == 0xfe) return utf8_of_utf16(bytes.subspan(2), false);
  if (byte(0) == 0xfe && byte(1) == 0xff) return utf8_of_utf16(bytes.subspan(2), true);
  if (is_ascii(0) && byte(1) == 0 && is_ascii(2) && byte(3) == 0) return utf8_of_utf16(bytes, false);
  if (byte(0) == 0 && is_ascii(1) && byte(2) == 0 && is_ascii(3)) return utf8_of_utf16(bytes, true);
  if (byte(0) == 0xef && byte(1) == 0xbb && byte(2) == 0xbf) bytes = bytes.subspan(3);
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

}  // namespace

std::string read_text(const std::filesystem::path& file, size_t most) {
  return text_of(read_file(file, most), file.string());
}

std::string text_of(std::vector<std::byte> bytes, const std::string& name) {
  std::string text = decoded(bytes);
  std::vector<std::byte>().swap(bytes);  // not both at a time: files may be large
  if (text.find('\0') != std::string::npos) throw InputError(name + ": is not a text file");
  size_t kept = 0;
  for (size_t i = 0; i < text.size(); ++i) {
    if (text[i] != '\r') {
      text[kept++] = text[i];
    } else if (i + 1 == text.size() || text[i + 1] != '\n') {
      text[kept++] = '\n';
    }
  }
  text.resize(kept);
  if (!text.empty() && text.back() != '\n') text.push_back('\n');
  return text;
}

void for_each_line(const std::filesystem::path& file,
                   const std::function<void(std::string_view line, const LineError& fail)>& f) {
  const std::string text = read_text(file);
  int number = 1;
  for (size_t begin = 0; begin < text.size(); ++number) {
    const size_t end = text.find('\n', begin);
    const std::string_view line = trimmed(std::string_view(text).substr(begin, end - begin));
    const LineError fail = [&](const std::string& what) {
      throw InputError(file.string() + ":" + std::to_string(number) + ": " + what);
    };
    if (line.size() > kMaxLineBytes) fail("a line of more than 64 kB");
    if (!line.empty() && line[0] != '#') f(line, fail);
    begin = end + 1;
  }
}

std::string_view trimmed(std::string_view text) {
  constexpr std::string_view kBlanks = " \t\r";
  const size_t begin = std::min(text.find_first_not_of(kBlanks), text.size());
  const size_t end = text.find_last_not_of(kBlanks);
  return end == std::string_view::npos ? std::string_view() : text.substr(begin, end + 1 - begin);
}

bool parse_integer(std::string_view text, int64_t* value) {
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), *value);
  return error == std::errc() && end == text.data() + text.size();
}

}  // namespace pptam::platform
