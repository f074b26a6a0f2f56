// Keys and numbers of a calibration file, whatever language it is written in. calibration_text makes the tree of which
// these are views, calibration_dialects knows what the keys mean.
#pragma once

#include <yaml-cpp/yaml.h>

#include <cstddef>
#include <initializer_list>
#include <map>
#include <string>
#include <string_view>
#include <vector>

namespace pptam::platform {

// What the readers of all languages keep to.
constexpr size_t kMaxCalibrationListBytes = 2048;  // fourteen coefficients, one a line, have under 1 kB
constexpr size_t kMaxCalibrationDepth = 64;        // of brackets or elements; calibrations have under 10. Not swept
constexpr size_t kMaxReasonBytes = 120;            // of a parser's message

// A mapping of keys to values. Keys are found by their spelling or by one that differs in capitals, underlines, hyphens
// and blanks: camera_matrix is cameraMatrix. Every getter throws InputError naming the file and the key.
class CalibrationSection {
 public:
  // Throws InputError unless node is a mapping. Warnings are added to `warnings` unless it is null.
  CalibrationSection(std::string file, const YAML::Node& node, std::vector<std::string>* warnings);

  [[noreturn]] void fail(const std::string& what) const;
  void warn(const std::string& what) const;

  bool has(const std::string& key) const { return find(key) != nullptr; }
  bool has_section(const std::string& key) const;
  bool has_list(const std::string& key) const;  // of whatever, or a matrix
  // The first of these keys that is there, else "".
  std::string any_of(std::initializer_list<const char*> keys) const;
  std::string keys() const;  // the first few as the file spells them, for messages

  CalibrationSection section(const std::string& key) const;
  std::string text(const std::string& key) const;           // one word
  std::string text_or_empty(const std::string& key) const;  // likewise; empty when there is none or something else
  double number(const std::string& key) const;
  double number_or_zero(const std::string& key) const { return has(key) ? number(key) : 0; }
  // Of a list, a list of lists, or a matrix that has such a list as its `data`.
  std::vector<double> numbers(const std::string& key) const;
  int pixels(double number, const std::string& key) const;  // an image's width or height

 private:
  struct Entry {
    std::string spelling;
    YAML::Node node;
    bool again = false;  // another key is the same
  };

  const Entry* find(const std::string& key) const;  // null too when the value is
  const Entry& require(const std::string& key) const;
  double number_of(const YAML::Node& node, const std::string& key) const;
  void append_numbers(const YAML::Node& node, const std::string& key, int depth, std::vector<double>* list) const;

  std::string file_;
  std::map<std::string, Entry> entries_;  // by key without capitals, underlines, hyphens and blanks
  std::vector<std::string> spellings_;    // the first few
  std::vector<std::string>* warnings_;
};

// Letters in lower case, without underlines, hyphens and blanks.
std::string plain_name(const std::string& text);

// As a number of a calibration; throws InputError naming file and `what`.
double calibration_number(const std::string& word, const std::string& file, const std::string& what);

// At most this many bytes of it, on one line, for a message.
std::string shown_word(std::string_view word, size_t most = 40);

[[noreturn]] void refuse_calibration(const std::string& file, const std::string& what);

}  // namespace pptam::platform
