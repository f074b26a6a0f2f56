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

std::string decoded(std::span<const std::byte> bytes) {
  const auto starts_with = [&](std::initializer_list<unsigned> mark) {
    return bytes.size() >= mark.size() &&
           std::equal(mark.begin(), mark.end(), bytes.begin(),
                      [](unsigned a, std::byte b) { return a == std::to_integer<unsigned>(b); });
  };
  if (starts_with({0xff, 0xfe})) return utf8_of_utf16(bytes.subspan(2), false);
  if (starts_with({0xfe, 0xff})) return utf8_of_utf16(bytes.subspan(2), true);
  if (starts_with({0xef, 0xbb, 0xbf})) bytes = bytes.subspan(3);
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

}  // namespace

std::string read_text(const std::filesystem::path& file, size_t most) {
  const std::vector<std::byte> bytes = read_file(file, most);
  const std::string raw = decoded(bytes);
  if (raw.find('\0') != std::string::npos) throw InputError(file.string() + ": is not a text file");
  std::string text;
  text.reserve(raw.size() + 1);
  for (size_t i = 0; i < raw.size(); ++i) {
    if (raw[i] != '\r') {
      text.push_back(raw[i]);
    } else if (i + 1 == raw.size() || raw[i + 1] != '\n') {
      text.push_back('\n');
    }
  }
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
