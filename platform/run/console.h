// What the program says on the terminal: progress and warnings on stderr, results on stdout. Colours only for a person
// (a terminal, and NO_COLOR is not set). Whatever a text holds, the terminal is sent no codes but these: all goes
// through printable().
#pragma once

#include <string>
#include <vector>

#include "platform/run/summary.h"

namespace pptam::platform {

// Control characters, marks that turn the direction of writing, and bytes that are not UTF-8 become visible: "\x1b",
// "\u202e". Line ends and tabs become blanks.
std::string printable(const std::string& text);

// One line that is rewritten on a terminal; elsewhere a line at every tenth of the way.
class Progress {
 public:
  Progress();
  ~Progress() { finish(); }
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;
  // total 0: unknown.
  void show(int done, int total, const std::string& text);
  void finish();  // leaves a clean line

 private:
  bool terminal_;
  size_t shown_width_ = 0;
  int last_mark_ = 0;
};

void print_rows(const std::vector<SummaryRow>& rows);
// Columns as wide as they need, the first one left-aligned; cells beyond the heads follow as they are, an empty row is
// a blank line.
void print_table(const std::vector<std::string>& heads, const std::vector<std::vector<std::string>>& rows);
void print_line(const std::string& text);  // of results
void print_warning(const std::string& text);
void print_error(const std::string& text);  // one line, whatever text holds

}  // namespace pptam::platform
