#include "platform/camera/calibration_yaml.h"

#include <glib.h>

#include <algorithm>
#include <string_view>
#include <utility>
#include <vector>

#include "platform/camera/calibration_section.h"

namespace pptam::platform {
namespace {

constexpr size_t kMaxYamlBytes = 64 * 1024;  // without long lists; a camchain of eight cameras has 5 kB
constexpr size_t kTabColumns = 4;            // where a tab indents; a file that mixes both may be refused

bool is_blank(char c) {
  return c == ' ' || c == '\t';
}

bool is_one_of(char c, std::string_view set) {
  return set.find(c) != std::string_view::npos;
}

// Copies YAML or JSON up to the end of the first document, in one pass, and leaves out comments, directives (OpenCV's
// %YAML:1.0 is none) and what is inside lists of more than kMaxCalibrationListBytes, in brackets or one entry a line.
// Tabs become spaces, and `key:1`, which OpenCV reads, becomes `key: 1`.
class YamlThinner {
 public:
  YamlThinner(std::string_view text, const std::string& file) : text_(text), file_(file) {}

  std::string run() {
    for (size_t begin = 0; begin < text_.size();) {
      const size_t end = std::min(text_.find('\n', begin), text_.size());
      const std::string_view line = text_.substr(begin, end - begin);
      begin = end + 1;
      const bool outside = open_.empty() && quote_ == 0;
      if (outside && ends_document(line)) break;
      if (outside && line.starts_with('%')) continue;
      copy(outside && line.starts_with("---") ? line.substr(3) : line, outside);
    }
    return std::move(out_);
  }

 private:
  struct Bracket {
    char kind;
    size_t out_begin;
  };

  bool ends_document(std::string_view line) {
    const bool marker = line.starts_with("---") || line.starts_with("...");
    if (marker && (line.size() == 3 || is_blank(line[3])) && !blank_so_far_) return true;
    return false;
  }

  bool emitting() const { return !list_cut_ && !run_cut_; }

  void put(char c) {
    if (!emitting()) return;
    out_.push_back(c);
    if (out_.size() > kMaxYamlBytes)
      refuse_calibration(file_, "holds more than 64 kB beside its lists: not a calibration");
  }

  // A run is a list with an entry a line, `- 1.5`; its end is seen when the next key comes.
  void follow_run(size_t column, bool is_entry) {
    const bool goes_on = in_run_ && (column > run_column_ || (column == run_column_ && is_entry));
    if (!goes_on) {
      in_run_ = is_entry;
      run_column_ = column;
      run_begin_ = out_.size();
      run_cut_ = false;
    } else if (!run_cut_ && out_.size() - run_begin_ > kMaxCalibrationListBytes) {
      out_.resize(run_begin_);
      run_cut_ = true;
    }
  }

  void copy(std::string_view line, bool outside) {
    size_t i = 0;
    size_t column = 0;
    for (; i < line.size() && is_blank(line[i]); ++i) column += line[i] == '\t' ? kTabColumns : 1;
    if (i == line.size() || (line[i] == '#' && quote_ == 0)) {
      put('\n');
      return;
    }
    blank_so_far_ = false;
    if (outside) follow_run(column, line[i] == '-' && (i + 1 == line.size() || is_blank(line[i + 1])));
    for (size_t space = 0; space < column; ++space) put(' ');
    bool in_key = outside;
    last_ = 0;
    for (const size_t begin = i; i < line.size(); ++i) {
      const char c = line[i];
      if (quote_ == 0 && c == '#' && is_blank(line[i - 1])) break;
      if (in_key && c == ':' && i > begin && glued_value(line.substr(i + 1))) {
        put(c);
        put(' ');
        last_ = c;
        in_key = false;
        continue;
      }
      in_key = in_key && (g_ascii_isalnum(c) || c == '_' || c == '.');
      i += copy_character(line, i);
    }
    put('\n');
  }

  static bool glued_value(std::string_view value) {
    if (value.empty()) return false;
    const std::string_view rest = is_one_of(value[0], "+-") ? value.substr(1) : value;
    return is_one_of(value[0], "[\"") || (!rest.empty() && g_ascii_isdigit(rest[0]));
  }

  // Returns how many more characters than this one were copied.
  size_t copy_character(std::string_view line, size_t i) {
    const char c = line[i];
    if (quote_ != 0) {
      put(c);
      const bool pair =
          i + 1 < line.size() && ((quote_ == '"' && c == '\\') || (quote_ == '\'' && c == '\'' && line[i + 1] == '\''));
      if (pair) {
        put(line[i + 1]);
        return 1;
      }
      if (c == quote_) quote_ = 0;
      last_ = c;
      return 0;
    }
    if ((c == '"' || c == '\'') && (last_ == 0 || is_one_of(last_, ":,[{-?"))) quote_ = c;
    const bool begins = !open_.empty() || last_ == 0 || last_ == ':' || is_blank(line[i - 1]);
    if ((c == '[' || c == '{') && begins) {
      put(c);
      open_.push_back({c, out_.size()});
      if (open_.size() > kMaxCalibrationDepth)
        refuse_calibration(file_, "brackets in brackets, more than 64 deep: not a calibration");
    } else {
      if ((c == ']' || c == '}') && !open_.empty()) {
        open_.pop_back();
        if (open_.size() <= list_cut_depth_) list_cut_ = false;
      }
      put(c == '\t' ? ' ' : c);
      cut_long_list();
    }
    if (!is_blank(c)) last_ = c;
    return 0;
  }

  void cut_long_list() {
    if (!emitting()) return;
    const auto list = std::find_if(open_.begin(), open_.end(), [](const Bracket& b) { return b.kind == '['; });
    if (list == open_.end() || out_.size() - list->out_begin <= kMaxCalibrationListBytes) return;
    out_.resize(list->out_begin);
    list_cut_ = true;
    list_cut_depth_ = static_cast<size_t>(list - open_.begin());
  }

  std::string_view text_;
  const std::string& file_;
  std::string out_;
  bool blank_so_far_ = true;
  std::vector<Bracket> open_;
  char quote_ = 0;
  char last_ = 0;  // before this one in its line, blanks aside; 0: none
  bool list_cut_ = false;
  size_t list_cut_depth_ = 0;
  bool in_run_ = false;
  bool run_cut_ = false;
  size_t run_column_ = 0;
  size_t run_begin_ = 0;
};

}  // namespace

YAML::Node parse_calibration_yaml(const std::string& text, const std::string& file) {
  const std::string thin = YamlThinner(text, file).run();
  try {
    return YAML::Load(thin);
  } catch (const YAML::Exception& error) {
    const std::string line = error.mark.is_null() ? "" : "line " + std::to_string(error.mark.line + 1) + ": ";
    refuse_calibration(file, "not readable as YAML: " + line + shown_word(error.msg, kMaxReasonBytes));
  }
}

}  // namespace pptam::platform
