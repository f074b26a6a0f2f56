#include "platform/camera/dump_sequence.h"

#include <cinttypes>
#include <cmath>
#include <cstdio>
#include <string>

#include "platform/camera/image_files.h"
#include "platform/files.h"

namespace pptam::platform {
std::string timestamp_name(int64_t ns) {
  char text[48];
  std::snprintf(text, sizeof text, "%" PRId64 ".%09" PRId64, ns / 1000000000, ns % 1000000000);
  return text;
}

std::string calibration_text(const CameraInfo& info) {
  const CameraModel& m = info.model;
  const bool columns = info.shutter.axis == RollingShutter::Axis::kColumns;
  const double line_time_s = static_cast<double>(info.shutter.line_time_s);
  const double readout_s = std::abs(line_time_s) * (columns ? m.width : m.height);
  const char* distortion = "none";
  int coefficients = 0;
  if (m.distortion == Distortion::kFov) {
    distortion = "fov";
    coefficients = 1;
  } else if (m.distortion == Distortion::kRadTan) {
    distortion = "radtan";
    coefficients = m.coeffs[4] == 0 ? 4 : 5;
  } else if (m.distortion == Distortion::kEquidistant) {
    distortion = "equidistant";
    coefficients = 4;
  }
  const auto number = [](double value, int digits = 9) {
    char text[40];
    std::snprintf(text, sizeof text, "%.*g", digits, value);
    return std::string(text);
  };
  std::string coeffs;
  for (int i = 0; i < coefficients; ++i) coeffs += (i > 0 ? ", " : "") + number(static_cast<double>(m.coeffs[i]));
  const auto px = [&](float value) { return number(static_cast<double>(value)); };
  return "# Pixel centres at integers. readout_* and exposure_s: rolling shutter, seconds; direction 1: larger\n"
         "# coordinates are exposed later. A frame's timestamp is the mid-exposure of the image centre.\n"
         "cam0:\n"
         "  camera_model: pinhole\n"
         "  intrinsics: [" +
         px(m.fx) + ", " + px(m.fy) + ", " + px(m.cx) + ", " + px(m.cy) +
         "]\n"
         "  distortion_model: " +
         distortion +
         "\n"
         "  distortion_coeffs: [" +
         coeffs +
         "]\n"
         "  resolution: [" +
         std::to_string(m.width) + ", " + std::to_string(m.height) +
         "]\n"
         "  readout_s: " +
         number(readout_s, 7) +
         "\n"
         "  readout_axis: " +
         (columns ? "columns" : "rows") +
         "\n"
         "  readout_direction: " +
         (line_time_s < 0 ? "-1" : "1") +
         "\n"
         "  exposure_s: " +
         number(static_cast<double>(info.exposure_s), 7) + "\n";
}

void dump_sequence(Camera& camera, const std::filesystem::path& folder,
                   const std::function<bool(int done, int total)>& go_on) {
  std::error_code error;
  if (std::filesystem::exists(folder, error) &&
      (!std::filesystem::is_directory(folder, error) || !std::filesystem::is_empty(folder, error))) {
    throw InputError(folder.string() + ": exists and is not an empty folder; name a new one");
  }
  make_folder(folder / "rgb");

  std::string list = "# timestamp filename\n";
  Frame frame;
  int done = 0;
  const auto more = [&] { return go_on(done, camera.info().frame_count.value_or(done)); };
  std::string trouble;
  try {
    const bool begun = more();
    write_text_atomically(folder / "calibration.yaml", calibration_text(camera.info()));
    while (begun && camera.read(&frame)) {
      if (frame.format != PixelFormat::kGrey) throw InputError(camera.info().name + ": only grey images can be dumped");
      const std::string stamp = timestamp_name(frame.timestamp_ns);
      const std::string name = "rgb/" + stamp + ".png";
      write_png(folder / name, {frame.data, frame.width, frame.height, frame.stride_bytes});
      list.append(stamp).append(" ").append(name).append("\n");
      ++done;
      if (!more()) break;
    }
  } catch (const InputError& broken) {
    trouble = broken.what();
  }
  write_text_atomically(folder / "rgb.txt", list);
  Trajectory truth = camera.ground_truth();
  if (!truth.empty()) {
    write_tum_trajectory(folder / "groundtruth.txt", truth,
                         "T_world_camera: t tx ty tz qx qy qz qw (camera x right, y down, z forward)");
  }
  if (!trouble.empty()) throw InputError(trouble);
}

}  // namespace pptam::platform
