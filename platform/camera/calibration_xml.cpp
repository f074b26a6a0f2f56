#include "platform/camera/calibration_xml.h"

#include <glib.h>

#include <algorithm>
#include <memory>
#include <utility>
#include <vector>

#include "platform/camera/calibration_section.h"
#include "platform/text_file.h"

namespace pptam::platform {
namespace {

constexpr size_t kMaxXmlBytes = 256 * 1024;  // likewise; a list of views takes more in XML

// Text between elements of more than kMaxCalibrationListBytes is left out.
std::string thin_xml(const std::string& text, const std::string& file) {
  std::string thin;
  for (size_t begin = 0; begin < text.size();) {
    const size_t tag = std::min(text.find('<', begin), text.size());
    if (tag - begin <= kMaxCalibrationListBytes) thin.append(text, begin, tag - begin);
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
    if (open_.size() >= kMaxCalibrationDepth) {
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

}  // namespace

YAML::Node parse_calibration_xml(const std::string& text, const std::string& file) {
  return XmlReader(file).parse(thin_xml(text, file));
}

}  // namespace pptam::platform
