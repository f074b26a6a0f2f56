#include "platform/camera/calibration_colmap.h"

#include <algorithm>
#include <cstdint>
#include <iterator>
#include <sstream>
#include <string_view>

#include "platform/camera/calibration_lens.h"
#include "platform/camera/calibration_section.h"
#include "platform/text_file.h"

namespace pptam::platform {
namespace {

struct ColmapModel {
  const char* name;
  int focals;  // 1: fx = fy
  Distortion distortion;
  const char* coeffs;  // where each goes in CameraModel::coeffs, or in OpenCV's longer list
};

constexpr ColmapModel kColmapModels[] = {
    {"SIMPLE_PINHOLE", 1, Distortion::kNone, ""},
    {"PINHOLE", 2, Distortion::kNone, ""},
    {"SIMPLE_RADIAL", 1, Distortion::kRadTan, "0"},
    {"RADIAL", 1, Distortion::kRadTan, "01"},
    {"OPENCV", 2, Distortion::kRadTan, "0123"},
    {"FULL_OPENCV", 2, Distortion::kRadTan, "01234567"},
    {"OPENCV_FISHEYE", 2, Distortion::kEquidistant, "0123"},
    {"SIMPLE_RADIAL_FISHEYE", 1, Distortion::kEquidistant, "0"},
    {"RADIAL_FISHEYE", 1, Distortion::kEquidistant, "01"},
    {"FOV", 2, Distortion::kFov, "0"},
};

std::vector<std::string> words_of(std::string_view line) {
  std::istringstream stream{std::string(line)};
  std::vector<std::string> words;
  for (std::string word; stream >> word && words.size() < 32;) words.push_back(word);
  return words;
}

// Lines that are neither blank nor comments, cut to what a camera may have; at most `most` of them.
std::vector<std::string> colmap_lines(const std::string& text, size_t most) {
  constexpr size_t kMaxColmapLine = 1024;  // twelve parameters of twenty digits have under 300
  std::vector<std::string> lines;
  for (size_t begin = 0; begin < text.size() && lines.size() < most;) {
    const size_t end = std::min(text.find('\n', begin), text.size());
    const std::string_view line = trimmed(std::string_view(text).substr(begin, end - begin));
    if (!line.empty() && line[0] != '#') lines.emplace_back(line.substr(0, kMaxColmapLine));
    begin = end + 1;
  }
  return lines;
}

bool is_colmap_camera(const std::string& line) {
  const std::vector<std::string> words = words_of(line);
  int64_t number = 0;
  return words.size() > 4 && parse_integer(words[0], &number) && parse_integer(words[2], &number) &&
         parse_integer(words[3], &number) && words[1][0] >= 'A' && words[1][0] <= 'Z' &&
         words[1].find_first_not_of("ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_") == std::string::npos;
}

}  // namespace

bool is_colmap(const std::string& text) {
  const std::vector<std::string> lines = colmap_lines(text, 1);
  return !lines.empty() && is_colmap_camera(lines[0]);
}

CameraModel read_colmap_lens(const std::string& text, const std::string& file, std::vector<std::string>* warnings) {
  const std::vector<std::string> lines = colmap_lines(text, 2);
  const std::vector<std::string> words = words_of(lines.at(0));
  const CalibrationSection section(file, YAML::Node(YAML::NodeType::Map), warnings);
  const auto known = std::find_if(std::begin(kColmapModels), std::end(kColmapModels),
                                  [&](const ColmapModel& m) { return words[1] == m.name; });
  if (known == std::end(kColmapModels)) {
    section.fail("COLMAP's camera model " + words[1].substr(0, 40) +
                 " is not supported: use OPENCV, or OPENCV_FISHEYE "
                 "for wide lenses");
  }
  const std::string coeff_places = known->coeffs;
  const auto focals = static_cast<size_t>(known->focals);
  const size_t needed = 4 + focals + 2 + coeff_places.size();
  if (words.size() != needed) {
    section.fail("COLMAP's " + words[1] + " needs " + std::to_string(needed - 4) + " parameters, camera " + words[0] +
                 " has " + std::to_string(words.size() - 4));
  }
  std::vector<double> values;
  for (size_t i = 2; i < words.size(); ++i) values.push_back(calibration_number(words[i], file, "camera " + words[0]));
  CameraModel model;
  model.width = section.pixels(values[0], "WIDTH");
  model.height = section.pixels(values[1], "HEIGHT");
  set_focal(values[2], values[1 + focals], values[2 + focals] - 0.5, values[3 + focals] - 0.5, &model);
  std::vector<double> coeffs(known->distortion == Distortion::kFov ? 1 : 8);
  for (size_t i = 0; i < coeff_places.size(); ++i)
    coeffs[static_cast<size_t>(coeff_places[i] - '0')] = values[4 + focals + i];
  set_distortion(section, known->distortion, coeffs, &model);
  if (lines.size() > 1 && is_colmap_camera(lines[1]))
    section.warn("holds several cameras: the first is taken, camera " + words[0]);
  return model;
}

}  // namespace pptam::platform
