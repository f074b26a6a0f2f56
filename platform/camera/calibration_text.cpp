#include "platform/camera/calibration_text.h"

#include <glib.h>

#include <algorithm>
#include <memory>
#include <string_view>
#include <utility>

#include "platform/text_file.h"

namespace pptam::platform {
namespace {

constexpr size_t kMaxListBytes = 2048;       // fourteen coefficients, one a line, have under 1 kB
constexpr size_t kMaxYamlBytes = 64 * 1024;  // without long lists; a camchain of eight cameras has 5 kB
constexpr size_t kMaxXmlBytes = 256 * 1024;  // likewise; a list of views takes more in XML
constexpr size_t kMaxDepth = 64;             // of brackets or elements; calibrations have under 10. Not swept
constexpr size_t kMaxReasonBytes = 120;      // of a parser's message
constexpr size_t kTabColumns = 4;            // where a tab indents; a file that mixes both may be refused

bool is_blank(char c) {
  return c == ' ' || c == '\t';
}

bool is_one_of(char c, std::string_view set) {
  return set.find(c) != std::string_view::npos;
}

// ---- YAML and JSON: what is not needed is cut ----------------------------------------------------------------------

// Copies YAML or JSON up to the end of the first document, in one pass, and leaves out comments, directives (OpenCV's
// %YAML:1.0 is none) and what is inside lists of more than kMaxListBytes, in brackets or one entry a line. Tabs become
// spaces, and `key:1`, which OpenCV reads, becomes `key: 1`.
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
    } else if (!run_cut_ && out_.size() - run_begin_ > kMaxListBytes) {
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
      if (open_.size() > kMaxDepth)
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
    if (list == open_.end() || out_.size() - list->out_begin <= kMaxListBytes) return;
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

YAML::Node parse_yaml(const std::string& text, const std::string& file) {
  const std::string thin = YamlThinner(text, file).run();
  try {
    return YAML::Load(thin);
  } catch (const YAML::Exception& error) {
    const std::string line = error.mark.is_null() ? "" : "line " + std::to_string(error.mark.line + 1) + ": ";
    refuse_calibration(file, "not readable as YAML: " + line + shown_word(error.msg, kMaxReasonBytes));
  }
}

// ---- OpenCV's XML --------------------------------------------------------------------------------------------------

// Text between elements of more than kMaxListBytes is left out.
std::string thin_xml(const std::string& text, const std::string& file) {
  std::string thin;
  for (size_t begin = 0; begin < text.size();) {
    const size_t tag = std::min(text.find('<', begin), text.size());
    if (tag - begin <= kMaxListBytes) thin.append(text, begin, tag - begin);
    const size_t end = std::min(text.find('>', tag), text.size() - 1);
    if (tag < text.size()) thin.append(text, tag, std::min(end + 1 - tag, kMaxXmlBytes + 1));
    if (thin.size() > kMaxXmlBytes)
      refuse_calibration(file, "holds more than 256 kB beside its lists: not a calibration");
    begin = std::max(tag, end) + 1;
  }
  return thin;
}

// Elements as a tree. Numbers with blanks between them are a list.
class XmlReader {
 public:
  explicit XmlReader(std::string file) : file_(std::move(file)) {}

  YAML::Node parse(const std::string& text) {
    GMarkupParser parser = {};
    parser.start_element = [](GMarkupParseContext*, const gchar* name, const gchar**, const gchar**, gpointer self,
                              GError** error) { static_cast<XmlReader*>(self)->begin(name, error); };
    parser.end_element = [](GMarkupParseContext*, const gchar*, gpointer self, GError**) {
      static_cast<XmlReader*>(self)->end();
    };
    parser.text = [](GMarkupParseContext*, const gchar* words, gsize bytes, gpointer self, GError**) {
      auto& open = static_cast<XmlReader*>(self)->open_;
      if (!open.empty()) open.back().text.append(words, bytes);
    };
    const std::unique_ptr<GMarkupParseContext, void (*)(GMarkupParseContext*)> context(
        g_markup_parse_context_new(&parser, static_cast<GMarkupParseFlags>(0), this, nullptr),
        g_markup_parse_context_unref);
    GError* error = nullptr;
    if (!g_markup_parse_context_parse(context.get(), text.data(), static_cast<gssize>(text.size()), &error) ||
        !g_markup_parse_context_end_parse(context.get(), &error)) {
      const std::string message = error ? error->message : "unknown error";
      g_clear_error(&error);
      refuse_calibration(file_, "not readable as XML: " + shown_word(message, kMaxReasonBytes));
    }
    if (root_name_ != "opencv_storage") {
      refuse_calibration(
          file_, "XML of another program (<" + shown_word(root_name_) + ">): OpenCV's, <opencv_storage>, can be read");
    }
    return root_;
  }

 private:
  struct Element {
    std::string name;
    std::string text;
    YAML::Node children;
    bool parent = false;
  };

  void begin(const gchar* name, GError** error) {
    if (open_.size() >= kMaxDepth) {
      g_set_error_literal(error, G_MARKUP_ERROR, G_MARKUP_ERROR_PARSE, "elements in elements, more than 64 deep");
      return;
    }
    open_.push_back({name, {}, {}, false});
  }

  void end() {
    const Element element = std::move(open_.back());
    open_.pop_back();
    const YAML::Node value = element.parent ? element.children : leaf(element.text);
    if (open_.empty()) {
      root_ = value;
      root_name_ = element.name;
      return;
    }
    Element& parent = open_.back();
    parent.parent = true;
    if (element.name == "_") {
      if (!parent.children.IsMap()) parent.children.push_back(value);
    } else if (!parent.children.IsSequence()) {
      parent.children.force_insert(element.name, value);  // does not look for an equal key: that would be quadratic
    }
  }

  static YAML::Node leaf(const std::string& text) {
    std::vector<std::string> words;
    for (size_t i = 0; i < text.size();) {
      const size_t begin = text.find_first_not_of(" \t\n", i);
      if (begin == std::string::npos) break;
      i = std::min(text.find_first_of(" \t\n", begin), text.size());
      words.push_back(text.substr(begin, i - begin));
    }
    if (words.empty()) return YAML::Node(YAML::NodeType::Null);
    if (words.size() == 1) return YAML::Node(words[0].starts_with('"') ? unquoted(words[0]) : words[0]);
    if (words[0].starts_with('"')) return YAML::Node(unquoted(std::string(trimmed(text))));
    YAML::Node list(YAML::NodeType::Sequence);
    for (const std::string& word : words) list.push_back(word);
    return list;
  }

  static std::string unquoted(std::string word) {
    std::erase(word, '"');
    return word;
  }

  std::string file_;
  std::vector<Element> open_;
  YAML::Node root_;
  std::string root_name_;
};

// ---- What else the file may be -------------------------------------------------------------------------------------

struct Magic {
  std::string_view bytes;
  size_t offset;
  const char* what;
};

constexpr Magic kMagics[] = {
    {"\x89PNG", 0, "an image (PNG)"},
    {"\xff\xd8\xff", 0, "an image (JPEG)"},
    {"BM", 0, "an image (BMP)"},
    {"II*", 0, "an image (TIFF)"},
    {"MM", 0, "an image (TIFF)"},
    {"P5", 0, "an image (PGM)"},
    {"P6", 0, "an image (PPM)"},
    {"GIF8", 0, "an image (GIF)"},
    {"RIFF", 0, "an image or a video (RIFF)"},
    {"ftyp", 4, "a video (MP4)"},
    {"\x1a\x45\xdf\xa3", 0, "a video (Matroska)"},
    {"%PDF", 0, "a PDF"},
    {"PK\x03\x04", 0, "a zip archive or NumPy's .npz: unpack it, or write the numbers as OpenCV's YAML"},
    {"\x1f\x8b", 0, "a packed archive (gzip), such as calibrationdata.tar.gz: unpack it and give the ost.yaml inside"},
    {"BZh", 0, "a packed archive (bzip2): unpack it"},
    {"\xfd"
     "7zXZ",
     0, "a packed archive (xz): unpack it"},
    {"ustar", 257, "an archive (tar): unpack it and give the ost.yaml inside"},
    {"\x93NUMPY", 0, "NumPy's .npy: write the numbers as OpenCV's YAML"},
    {"\x80\x03", 0, "a Python pickle: write the numbers as OpenCV's YAML"},
    {"\x80\x04", 0, "a Python pickle: write the numbers as OpenCV's YAML"},
    {"MATLAB", 0, "a MATLAB file: write the numbers as OpenCV's YAML"},
    {"#ROSBAG", 0, "a ROS bag: write `rostopic echo -n 1 CAMERA/camera_info` to a file"},
    {"SQLite", 0, "a ROS 2 bag: write `ros2 topic echo --once CAMERA/camera_info` to a file"},
    {"\x7f"
     "ELF",
     0, "a program"},
};

void refuse_other_kinds(const std::vector<std::byte>& bytes, const std::string& file) {
  const std::string_view head(reinterpret_cast<const char*>(bytes.data()), std::min(bytes.size(), size_t{512}));
  for (const Magic& magic : kMagics) {
    const bool text = magic.bytes.size() == 2 && magic.bytes[0] >= 'A' && magic.bytes[0] <= 'P';  // may begin a word
    const bool zeros = head.find('\0') != std::string_view::npos || magic.bytes[0] == 'P';
    if (head.size() > magic.offset && head.substr(magic.offset).starts_with(magic.bytes) && (!text || zeros))
      refuse_calibration(file, std::string("is not a calibration but seems to be ") + magic.what);
  }
}

// Spaces that editors, web pages and word processors put where a plain one belongs.
void plain_spaces(std::string* text) {
  constexpr std::string_view kSpaces[] = {"\xc2\xa0", "\xe2\x80\x87", "\xe2\x80\xaf", "\xe3\x80\x80", "\xef\xbb\xbf"};
  size_t kept = 0;
  for (size_t i = 0; i < text->size();) {
    size_t length = 0;
    for (const std::string_view space : kSpaces) {
      if ((*text)[i] == space[0] && text->compare(i, space.size(), space) == 0) length = space.size();
    }
    (*text)[kept++] = length > 0 ? ' ' : (*text)[i];
    i += std::max(length, size_t{1});
  }
  text->resize(kept);
}

}  // namespace

std::string calibration_text(std::vector<std::byte> bytes, const std::string& file) {
  refuse_other_kinds(bytes, file);
  std::string text = text_of(std::move(bytes), "calibration " + file);
  plain_spaces(&text);
  return text;
}

CalibrationSection parse_calibration(const std::string& text, const std::string& file,
                                     std::vector<std::string>* warnings) {
  const size_t begin = text.find_first_not_of(" \t\n");
  if (begin == std::string::npos) refuse_calibration(file, "is empty: a mapping of keys to values was expected");
  const std::string_view head = std::string_view(text).substr(begin);
  if (head.starts_with("# oST version") || head.starts_with("[image]")) {
    refuse_calibration(file, "is the ost.txt of ROS's calibration: give the ost.yaml beside it");
  }
  const YAML::Node root = head[0] == '<' ? XmlReader(file).parse(thin_xml(text, file)) : parse_yaml(text, file);
  return CalibrationSection(file, root, warnings);
}

}  // namespace pptam::platform
