#include "sim_phone/laboratory/phone_profile.h"

#include <yaml-cpp/yaml.h>

#include <charconv>
#include <cmath>
#include <filesystem>
#include <functional>
#include <iterator>
#include <set>
#include <span>
#include <string_view>

#include "platform/input_error.h"
#include "platform/text.h"
#include "platform/text_file.h"
#include "sim_phone/laboratory/built_in_phones.h"

namespace pptam::laboratory {
namespace {

using platform::format;
using platform::InputError;
using platform::joined;

constexpr size_t kMaxProfileBytes = 16 * 1024;  // those of sim_phone/profiles have under 2 kB
constexpr size_t kMaxShown = 40;                // bytes of the file in a message
constexpr size_t kMaxSaysBytes = 200;

constexpr const char* kWorkNames[] = {"grey_pixel",        "pyramid_pixel",   "corner_pixel",      "corner_ascent",
                                      "rotation_pixel",    "point_projected", "patch_warp",        "patch_candidate",
                                      "patch_refine_step", "pose_point",      "pose_projection",   "homography_point",
                                      "keyframe_pixel",    "bundle_error",    "bundle_projection", "bundle_motion",
                                      "bundle_block",      "bundle_solve",    "bundle_step",       "other"};
static_assert(std::size(kWorkNames) == kWorkKinds);

std::string shown(const std::string& word) {
  return word.size() <= kMaxShown ? word : word.substr(0, kMaxShown) + "...";
}

// A number that a profile may hold, in which section and within which bounds.
struct Number {
  const char* section;
  const char* key;
  double least, most;
  std::function<void(Phone*, double)> set;
  bool whole = false;
};

const std::vector<Number>& numbers() {
  static const std::vector<Number> kNumbers = [] {
    const auto ns = [](double ms) { return static_cast<int64_t>(std::llround(1e6 * ms)); };
    std::vector<Number> all = {
        {"processor", "clock_mhz", 1, 1e5, [](Phone* p, double v) { p->processor.clock_mhz = static_cast<float>(v); }},
        {"processor", "cycles_per_instruction", 0.01, 100,
         [](Phone* p, double v) { p->processor.cycles_per_instruction = static_cast<float>(v); }},
        {"camera", "width", 64, 4096, [](Phone* p, double v) { p->width = static_cast<int>(v); }, true},
        {"camera", "height", 64, 4096, [](Phone* p, double v) { p->height = static_cast<int>(v); }, true},
        {"camera", "horizontal_fov_degrees", 5, 120, [](Phone* p, double v) { p->horizontal_fov_degrees = v; }},
        {"camera", "frames_per_s", 1, 240, [](Phone* p, double v) { p->frames_per_s = v; }},
        {"camera", "readout_s", 0, 1, [](Phone* p, double v) { p->readout_s = v; }},
        {"camera", "exposure_s", 0, 1, [](Phone* p, double v) { p->exposure_s = v; }},
        {"frame", "capture_ms", 0, 1000, [ns](Phone* p, double v) { p->capture_ns = ns(v); }},
        {"frame", "display_ms", 0, 1000, [ns](Phone* p, double v) { p->display_ns = ns(v); }},
    };
    for (size_t i = 0; i < std::size(kWorkNames); ++i) {
      all.push_back({"instructions", kWorkNames[i], 0, 1e5,
                     [i](Phone* p, double v) { p->processor.instructions[i] = static_cast<float>(v); }});
    }
    return all;
  }();
  return kNumbers;
}

class ProfileReader {
 public:
  ProfileReader(const std::string& text, const std::string& name) : name_(name) {
    phone_.name = name;
    if (text.size() > kMaxProfileBytes) fail("", "is longer than 16 kB: not a phone's profile");
    try {
      read_all(YAML::Load(text));
    } catch (const YAML::Exception& error) {
      const std::string line = error.mark.is_null() ? "" : format("line %d: ", error.mark.line + 1);
      fail("", "not readable as YAML: " + line + shown(error.msg));
    }
  }
  const Phone& phone() const { return phone_; }

 private:
  [[noreturn]] void fail(const std::string& key, const std::string& what) const {
    throw InputError("phone " + name_ + ": " + (key.empty() ? "" : key + ": ") + what);
  }

  // A mapping's keys and values, each key once.
  void for_each(const YAML::Node& node, const std::string& section,
                const std::function<void(const std::string&, const YAML::Node&)>& f) const {
    if (!node.IsMap()) fail(section, "lines of `key: value` were expected");
    std::set<std::string> seen;
    for (const auto& pair : node) {
      if (!pair.first.IsScalar()) fail(section, "a key is no word");
      const std::string& key = pair.first.Scalar();
      if (!seen.insert(key).second) fail(section, shown(key) + " is there twice");
      f(key, pair.second);
    }
  }

  void read_all(const YAML::Node& root) {
    static const std::set<std::string> kSections = {"processor", "camera", "frame", "instructions"};
    for_each(root, "", [&](const std::string& key, const YAML::Node& value) {
      if (key == "says") {
        phone_.says = word(key, value);
      } else if (kSections.contains(key)) {
        for_each(value, key, [&](const std::string& inner, const YAML::Node& node) { read(key, inner, node); });
      } else {
        fail(shown(key), "is unknown; there are says, processor, camera, frame and instructions");
      }
    });
    for (const char* key : {"processor.clock_mhz", "processor.cycles_per_instruction"})
      if (!told_.contains(key)) fail(key, "is missing");
    for (const char* key : {"camera.readout_axis", "camera.readout_direction"})
      if (told_.contains(key) && !phone_.readout_s) fail(key, "says nothing without readout_s");
    if (backwards_) phone_.readout_s = -*phone_.readout_s;
  }

  std::string word(const std::string& key, const YAML::Node& node) const {
    if (!node.IsScalar()) fail(key, "is no single value");
    if (node.Scalar().size() > kMaxSaysBytes) fail(key, "is longer than 200 bytes");
    return node.Scalar();
  }

  double number(const std::string& key, const YAML::Node& node, double least, double most) const {
    const std::string text = word(key, node);
    double value = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc() || end != text.data() + text.size() || !(value >= least && value <= most))
      fail(key, "'" + shown(text) + "' is not a number " + format("from %g to %g", least, most));
    return value;
  }

  void read(const std::string& section, const std::string& key, const YAML::Node& node) {
    const std::string whole = section + "." + key;
    told_.insert(whole);
    if (whole == "camera.readout_axis") {
      const std::string axis = word(whole, node);
      if (axis != "rows" && axis != "columns") fail(whole, "'" + shown(axis) + "' is neither rows nor columns");
      phone_.readout_axis = axis == "rows" ? RollingShutter::Axis::kRows : RollingShutter::Axis::kColumns;
      return;
    }
    if (whole == "camera.readout_direction") {
      const double direction = number(whole, node, -1, 1);
      if (std::abs(direction) != 1) fail(whole, "is neither 1 nor -1");
      backwards_ = direction < 0;
      return;
    }
    std::vector<std::string> keys;
    for (const Number& known : numbers()) {
      if (section != known.section) continue;
      keys.emplace_back(known.key);
      if (key != known.key) continue;
      const double value = number(whole, node, known.least, known.most);
      if (known.whole && value != std::floor(value))
        fail(whole, "'" + shown(node.Scalar()) + "' is not a whole number");
      return known.set(&phone_, value);
    }
    fail(section + "." + shown(key), "is unknown; there are " + joined(keys));
  }

  std::string name_;
  Phone phone_;
  std::set<std::string> told_;
  bool backwards_ = false;
};

}  // namespace

const char* work_name(Work kind) {
  return static_cast<size_t>(kind) < std::size(kWorkNames) ? kWorkNames[static_cast<size_t>(kind)] : "?";
}

const std::vector<std::string>& phone_names() {
  static const std::vector<std::string> kNames = [] {
    std::vector<std::string> names;
    for (const BuiltInPhone& phone : std::span(kBuiltInPhones, kBuiltInPhoneCount)) names.emplace_back(phone.name);
    return names;
  }();
  return kNames;
}

Phone read_phone(const std::string& text, const std::string& name) {
  return ProfileReader(text, name).phone();
}

Phone load_phone(const std::string& name_or_file) {
  for (const BuiltInPhone& phone : std::span(kBuiltInPhones, kBuiltInPhoneCount))
    if (name_or_file == phone.name) return read_phone(phone.yaml, phone.name);
  std::error_code ignored;
  if (!std::filesystem::exists(name_or_file, ignored))
    throw InputError("phone " + name_or_file + ": is neither a file nor one of " + joined(phone_names()));
  return read_phone(platform::read_text(name_or_file, kMaxProfileBytes), name_or_file);
}

void use_camera(const Phone& phone, sim::PhoneOptions* options) {
  options->width = phone.width.value_or(options->width);
  options->height = phone.height.value_or(options->height);
  options->horizontal_fov_degrees = phone.horizontal_fov_degrees.value_or(options->horizontal_fov_degrees);
  options->frames_per_s = phone.frames_per_s.value_or(options->frames_per_s);
  options->exposure_s = phone.exposure_s.value_or(options->exposure_s);
  if (!phone.readout_s) return;
  options->readout_s = *phone.readout_s;
  options->readout_axis = phone.readout_axis;
}

void use_processor(const Phone& phone, platform::RunOptions* options) {
  options->processor = phone.processor;
  options->capture_ns = phone.capture_ns;
  options->display_ns = phone.display_ns;
}

}  // namespace pptam::laboratory
