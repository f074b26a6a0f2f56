#include "platform/run/console.h"

#include <unistd.h>

#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <iterator>

#include "platform/text.h"

namespace pptam::platform {
namespace {

bool use_colour(int fd) {
  const char* no_colour = std::getenv("NO_COLOR");
  const char* term = std::getenv("TERM");
  return isatty(fd) != 0 && (no_colour == nullptr || *no_colour == '\0') &&
         (term == nullptr || std::string(term) != "dumb");
}

std::string coloured(int fd, const char* code, const std::string& text) {
  return use_colour(fd) ? std::string("\033[") + code + "m" + text + "\033[0m" : text;
}

// The length of the UTF-8 character at the text's beginning, and the character; 0 when there is none.
size_t decode(const unsigned char* text, size_t bytes, uint32_t* character) {
  const unsigned char lead = text[0];
  const size_t length = lead < 0x80 ? 1 : lead < 0xc2 ? 0 : lead < 0xe0 ? 2 : lead < 0xf0 ? 3 : lead < 0xf5 ? 4 : 0;
  if (length == 0 || length > bytes) return 0;
  *character = length == 1 ? lead : lead & (0x7fu >> length);
  for (size_t i = 1; i < length; ++i) {
    if ((text[i] & 0xc0) != 0x80) return 0;
    *character = *character << 6 | (text[i] & 0x3fu);
  }
  constexpr uint32_t kSmallest[] = {0, 0, 0x80, 0x800, 0x10000};
  const bool surrogate = *character >= 0xd800 && *character < 0xe000;
  return *character < kSmallest[length] || surrogate || *character > 0x10ffff ? 0 : length;
}

// Controls, and what changes the text round it: line and paragraph separators, directions, tags.
bool is_harmless(uint32_t c) {
  constexpr struct {
    uint32_t first, last;
  } kHarmful[] = {{0, 0x1f},        {0x7f, 0x9f},     {0x61c, 0x61c},   {0x200e, 0x200f},  {0x2028, 0x202e},
                  {0x2066, 0x206f}, {0xfeff, 0xfeff}, {0xfff9, 0xfffb}, {0xe0000, 0xe007f}};
  return std::none_of(std::begin(kHarmful), std::end(kHarmful),
                      [c](const auto& range) { return range.first <= c && c <= range.last; });
}

}  // namespace

std::string printable(const std::string& text) {
  std::string clean;
  const auto* bytes = reinterpret_cast<const unsigned char*>(text.data());
  for (size_t i = 0; i < text.size();) {
    uint32_t character = 0;
    const size_t length = decode(bytes + i, text.size() - i, &character);
    if (length == 0) {
      clean += format("\\x%02x", bytes[i]);
    } else if (character == '\n' || character == '\r' || character == '\t') {
      clean += ' ';
    } else if (is_harmless(character)) {
      clean.append(text, i, length);
    } else {
      clean += format(character < 0x80 ? "\\x%02x" : "\\u%04x", character);
    }
    i += std::max<size_t>(1, length);
  }
  while (!clean.empty() && clean.back() == ' ') clean.pop_back();
  return clean;
}

Progress::Progress() : terminal_(isatty(STDERR_FILENO) != 0) {}

void Progress::show(int done, int total, const std::string& text) {
  const std::string part = total > 0 ? format("%3d %%", 100 * done / total) : format("%d", done);
  if (terminal_) {
    std::string line = part + "  " + printable(text);
    const size_t width = line.size();
    if (width < shown_width_) line.append(shown_width_ - width, ' ');
    shown_width_ = width;
    std::fprintf(stderr, "\r%s", line.c_str());
    return;
  }
  constexpr int kFramesPerLine = 200;  // of a source of unknown length
  const int mark = total > 0 ? 10 * done / total : done / kFramesPerLine;
  if (mark == last_mark_) return;
  last_mark_ = mark;
  std::fprintf(stderr, "%s  %s\n", part.c_str(), printable(text).c_str());
}

void Progress::finish() {
  if (terminal_ && shown_width_ > 0) std::fprintf(stderr, "\r%*s\r", static_cast<int>(shown_width_), "");
  shown_width_ = 0;
}

void print_rows(const std::vector<SummaryRow>& rows) {
  size_t width = 0;
  for (const SummaryRow& row : rows) width = std::max(width, row.label.size());
  for (const SummaryRow& row : rows) {
    const std::string label = row.label + std::string(width - row.label.size(), ' ');
    std::printf("%s  %s\n", coloured(STDOUT_FILENO, "2", label).c_str(), printable(row.value).c_str());
  }
}

void print_table(const std::vector<std::string>& heads, const std::vector<std::vector<std::string>>& rows) {
  std::vector<size_t> widths;
  widths.reserve(heads.size());
  for (const std::string& head : heads) widths.push_back(head.size());
  for (const std::vector<std::string>& row : rows) {
    for (size_t c = 0; c < std::min(row.size(), widths.size()); ++c) widths[c] = std::max(widths[c], row[c].size());
  }
  const auto print = [&](const std::vector<std::string>& row) {
    for (size_t c = 0; c < row.size(); ++c) {
      const int width = c < widths.size() ? static_cast<int>(widths[c]) : 0;
      std::printf("%s%*s", c == 0 ? "" : "  ", c == 0 ? -width : width, printable(row[c]).c_str());
    }
    std::printf("\n");
  };
  print(heads);
  for (const std::vector<std::string>& row : rows) print(row);
}

void print_line(const std::string& text) {
  std::printf("%s\n", printable(text).c_str());
}

void print_warning(const std::string& text) {
  std::fprintf(stderr, "pocket-ptam: %s %s\n", coloured(STDERR_FILENO, "33", "warning:").c_str(),
               printable(text).c_str());
}

void print_error(const std::string& text) {
  std::fprintf(stderr, "pocket-ptam: %s %s\n", coloured(STDERR_FILENO, "31", "error:").c_str(),
               printable(text).c_str());
}

}  // namespace pptam::platform
