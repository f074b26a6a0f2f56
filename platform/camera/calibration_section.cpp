#include "platform/camera/calibration_section.h"

#include <glib.h>

#include <charconv>
#include <cmath>
#include <string_view>
#include <utility>

#include "platform/input_error.h"
#include "platform/text.h"
#include "platform/text_file.h"

namespace pptam::platform {
namespace {

constexpr size_t kMaxEntries = 64;             // numbers of a list that is asked for: a stereo rig's matrices have 16
constexpr double kMaxCalibrationNumber = 1e6;  // of any entry: beyond it the file is not a calibration
constexpr double kMaxCalibratedSide_px = 16384;
constexpr size_t kShownKeys = 6;
constexpr size_t kMaxWordBytes = 40;

}  // namespace

std::string shown_word(std::string_view word, size_t most) {
  std::string text(word.substr(0, most));
  for (char& c : text) {
    if (static_cast<unsigned char>(c) < ' ' || c == 0x7f) c = ' ';
  }
  return text + (word.size() > most ? "..." : "");
}

void refuse_calibration(const std::string& file, const std::string& what) {
  throw InputError("calibration " + file + ": " + what);
}

std::string plain_name(const std::string& text) {
  std::string name;
  for (const char c : text) {
    if (c != '_' && c != '-' && c != ' ') name.push_back(g_ascii_tolower(c));
  }
  return name;
}

CalibrationSection::CalibrationSection(std::string file, const YAML::Node& node, std::vector<std::string>* warnings)
    : file_(std::move(file)), warnings_(warnings) {
  if (!node.IsMap()) fail("a mapping of keys to values was expected: this is not a camera calibration");
  for (const auto& pair : node) {
    if (!pair.first.IsScalar()) continue;
    const std::string& spelling = pair.first.Scalar();
    const auto [entry, is_new] = entries_.try_emplace(plain_name(spelling), Entry{spelling, pair.second});
    if (!is_new) entry->second.again = true;
    if (spellings_.size() < kShownKeys) spellings_.push_back(shown_word(spelling));
  }
}

void CalibrationSection::fail(const std::string& what) const {
  refuse_calibration(file_, what);
}

void CalibrationSection::warn(const std::string& what) const {
  if (warnings_) warnings_->push_back("calibration " + file_ + ": " + what);
}

bool CalibrationSection::has_section(const std::string& key) const {
  const Entry* entry = find(key);
  return entry && entry->node.IsMap();
}

bool CalibrationSection::has_list(const std::string& key) const {
  const Entry* entry = find(key);
  return entry && (entry->node.IsMap() || entry->node.IsSequence());
}

std::string CalibrationSection::any_of(std::initializer_list<const char*> keys) const {
  for (const char* key : keys) {
    if (const Entry* entry = find(key)) return entry->spelling;
  }
  return "";
}

std::string CalibrationSection::keys() const {
  return joined(spellings_) + (entries_.size() > spellings_.size() ? ", ..." : "");
}

const CalibrationSection::Entry* CalibrationSection::find(const std::string& key) const {
  const auto entry = entries_.find(plain_name(key));
  if (entry == entries_.end() || entry->second.node.IsNull()) return nullptr;
  if (entry->second.again) fail(shown_word(entry->second.spelling) + " is there more than once");
  return &entry->second;
}

const CalibrationSection::Entry& CalibrationSection::require(const std::string& key) const {
  const Entry* entry = find(key);
  if (!entry) fail(key + " is missing");
  return *entry;
}

CalibrationSection CalibrationSection::section(const std::string& key) const {
  if (!has_section(key)) fail(key + " is missing or not a mapping");
  return CalibrationSection(file_, require(key).node, warnings_);
}

std::string CalibrationSection::text(const std::string& key) const {
  const YAML::Node& node = require(key).node;
  if (!node.IsScalar() || node.Scalar().size() > kMaxWordBytes) fail(key + " is not a word");
  return shown_word(node.Scalar());
}

std::string CalibrationSection::text_or_empty(const std::string& key) const {
  const Entry* entry = find(key);
  const bool word = entry && entry->node.IsScalar() && entry->node.Scalar().size() <= kMaxWordBytes;
  return word ? shown_word(entry->node.Scalar()) : "";
}

double CalibrationSection::number(const std::string& key) const {
  return number_of(require(key).node, key);
}

std::vector<double> CalibrationSection::numbers(const std::string& key) const {
  YAML::Node node = require(key).node;
  const bool is_matrix = node.IsMap();
  if (is_matrix) {
    const CalibrationSection matrix(file_, node, warnings_);
    if (!matrix.has("data")) fail(key + ": its data is missing");
    node.reset(matrix.require("data").node);
  }
  std::vector<double> list;
  if (is_matrix && node.IsScalar()) return {number_of(node, key)};  // in XML a list of one looks like that
  if (!node.IsSequence()) fail(key + " is not a list of numbers, such as [1.0, 2.0]");
  append_numbers(node, key, 0, &list);
  return list;
}

void CalibrationSection::append_numbers(const YAML::Node& node, const std::string& key, int depth,
                                        std::vector<double>* list) const {
  const bool rows = depth < 2 && node.size() > 0 && node[0].IsSequence();
  for (const YAML::Node& entry : node) {
    if (rows && entry.IsSequence()) {
      append_numbers(entry, key, depth + 1, list);
    } else {
      if (rows) fail(key + " holds both numbers and lists: it is not a list of numbers");
      list->push_back(number_of(entry, key));
    }
    if (list->size() > kMaxEntries) fail(key + " holds more than 64 numbers");
  }
}

double CalibrationSection::number_of(const YAML::Node& node, const std::string& key) const {
  if (!node.IsScalar()) fail(key + " holds something that is not a number");
  return calibration_number(node.Scalar(), file_, key);
}

double calibration_number(const std::string& word, const std::string& file, const std::string& what) {
  std::string_view digits = trimmed(word);
  if (digits.starts_with('+')) digits.remove_prefix(1);
  const std::string plain = plain_name(std::string(digits));
  if (plain == ".nan" || plain == ".inf" || plain == "+.inf" || plain == "nan" || plain == "inf" ||
      plain == "infinity") {
    refuse_calibration(file, what + " holds NaN or infinity");
  }
  double value = 0;
  const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), value);
  const bool whole = end == digits.data() + digits.size() && !digits.empty();
  if (whole && error == std::errc::result_out_of_range && digits.find("e-") != std::string_view::npos) return 0;
  if (error == std::errc() && whole && std::isfinite(value) && std::abs(value) <= kMaxCalibrationNumber) return value;
  if (whole) refuse_calibration(file, what + " holds a number over a million: not a calibration");
  const size_t comma = digits.find(',');
  const bool decimal_comma = comma != std::string_view::npos && comma > 0 && comma + 1 < digits.size() &&
                             digits.find_first_not_of("0123456789,-+eE") == std::string_view::npos;
  refuse_calibration(file, what + " holds something that is not a number: \"" + shown_word(word) + "\"" +
                               (decimal_comma ? ", with a decimal comma: write a point" : ""));
}

int CalibrationSection::pixels(double number, const std::string& key) const {
  if (number != std::floor(number) || number < 1 || number > kMaxCalibratedSide_px) {
    fail(key + " is not a number of pixels from 1 to 16384");
  }
  return static_cast<int>(number);
}

}  // namespace pptam::platform
