#include "platform/run/console.h"

#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>

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

std::string one_line(std::string text) {
  std::replace(text.begin(), text.end(), '\n', ' ');
  while (!text.empty() && text.back() == ' ') text.pop_back();
  return text;
}

}  // namespace

Progress::Progress() : terminal_(isatty(STDERR_FILENO) != 0) {}

void Progress::show(int done, int total, const std::string& text) {
  const std::string part = total > 0 ? format("%3d %%", 100 * done / total) : format("%d", done);
  if (terminal_) {
    std::string line = part + "  " + text;
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
  std::fprintf(stderr, "%s  %s\n", part.c_str(), text.c_str());
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
    std::printf("%s  %s\n", coloured(STDOUT_FILENO, "2", label).c_str(), row.value.c_str());
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
      std::printf("%s%*s", c == 0 ? "" : "  ", c == 0 ? -width : width, row[c].c_str());
    }
    std::printf("\n");
  };
  print(heads);
  for (const std::vector<std::string>& row : rows) print(row);
}

void print_warning(const std::string& text) {
  std::fprintf(stderr, "pocket-ptam: %s %s\n", coloured(STDERR_FILENO, "33", "warning:").c_str(),
               one_line(text).c_str());
}

void print_error(const std::string& text) {
  std::fprintf(stderr, "pocket-ptam: %s %s\n", coloured(STDERR_FILENO, "31", "error:").c_str(), one_line(text).c_str());
}

}  // namespace pptam::platform
