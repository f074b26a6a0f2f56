#include "sim_phone/phone_camera.h"

#include <algorithm>
#include <cinttypes>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <numbers>

#include "platform/camera/image_files.h"
#include "sim_phone/motion.h"
#include "sim_phone/random.h"
#include "sim_phone/scene.h"
#include "sim_phone/sensor.h"

namespace pptam::sim {
namespace {

using platform::InputError;

std::string joined(const std::vector<std::string>& names) {
  std::string text;
  for (const std::string& name : names) text += (text.empty() ? "" : ", ") + name;
  return text;
}

void require(bool good, const std::string& message) {
  if (!good) throw InputError("emulated phone: " + message);
}

// Written so that NaN fails.
void check(const PhoneOptions& o) {
  const auto known = [](const std::string& name, const std::vector<std::string>& names) {
    return std::find(names.begin(), names.end(), name) != names.end();
  };
  require(known(o.scene, scene_names()), "scene '" + o.scene + "' is unknown; choose one of " + joined(scene_names()));
  require(known(o.motion, motion_names()),
          "motion '" + o.motion + "' is unknown; choose one of " + joined(motion_names()));
  require(o.duration_s > 0 && o.duration_s <= 3600, "duration_s must be over 0 and at most 3600 seconds");
  require(o.width >= 32 && o.width <= 4096, "width must be from 32 to 4096 pixels");
  require(o.height >= 32 && o.height <= 4096, "height must be from 32 to 4096 pixels");
  require(o.horizontal_fov_degrees >= 5 && o.horizontal_fov_degrees <= 120,
          "horizontal_fov_degrees must be from 5 to 120 degrees");
  require(o.frames_per_s >= 1 && o.frames_per_s <= 240, "frames_per_s must be from 1 to 240");
  require(std::abs(o.readout_s) <= 1 / o.frames_per_s, "readout_s must not be longer than a frame's period");
  require(o.exposure_s >= 0 && o.exposure_s <= 1 / o.frames_per_s, "exposure_s must be from 0 to a frame's period");
  require(o.drop_probability >= 0 && o.drop_probability < 1, "drop_probability must be from 0 to under 1");
}

class PhoneCamera : public platform::Camera {
 public:
  explicit PhoneCamera(const PhoneOptions& options)
      : options_(options),
        scene_(make_scene(options.scene, options.seed)),
        motion_(make_motion(options.motion, scene_.stage, options.seed, options.duration_s)),
        info_(make_info(options)),
        sensor_(scene_, motion_,
                SensorOptions{info_.model, info_.shutter, options.exposure_s, options.noise, options.seed}),
        pixels_(static_cast<size_t>(options.width) * static_cast<size_t>(options.height)) {
    const int frames = std::max(1, static_cast<int>(std::floor(options.duration_s * options.frames_per_s + 1e-9)));
    for (int i = 0; i < frames; ++i) {
      Random random(options.seed, 1000 + static_cast<uint64_t>(i));
      if (!random.chance(options.drop_probability)) delivered_.push_back(i);
    }
    info_.frame_count = static_cast<int>(delivered_.size());
  }

  const platform::CameraInfo& info() const override { return info_; }

  bool read(Frame* frame) override {
    if (next_ == delivered_.size()) return false;
    const int index = delivered_[next_++];
    const int64_t timestamp_ns = timestamp(index);
    sensor_.expose(1e-9 * static_cast<double>(timestamp_ns), static_cast<uint64_t>(index), pixels_.data());
    *frame = {pixels_.data(), options_.width, options_.height, options_.width, PixelFormat::kGrey, timestamp_ns};
    return true;
  }

  platform::Trajectory ground_truth() const override {
    platform::Trajectory truth;
    for (const int index : delivered_) {
      const int64_t timestamp_ns = timestamp(index);
      truth.push_back({timestamp_ns, motion_(1e-9 * static_cast<double>(timestamp_ns))});
    }
    return truth;
  }

 private:
  static platform::CameraInfo make_info(const PhoneOptions& o) {
    platform::CameraInfo info;
    const double half_fov = 0.5 * o.horizontal_fov_degrees * std::numbers::pi / 180;
    const float focal_px = static_cast<float>(0.5 * o.width / std::tan(half_fov));
    info.model.width = o.width;
    info.model.height = o.height;
    info.model.fx = focal_px;
    info.model.fy = focal_px;
    info.model.cx = 0.5f * static_cast<float>(o.width - 1);
    info.model.cy = 0.5f * static_cast<float>(o.height - 1);
    const int lines = o.readout_axis == RollingShutter::Axis::kColumns ? o.width : o.height;
    info.shutter.axis = o.readout_axis;
    info.shutter.line_time_s = static_cast<float>(o.readout_s / lines);
    info.exposure_s = static_cast<float>(o.exposure_s);
    info.frames_per_s = o.frames_per_s;
    info.name = o.scene + ", " + o.motion + ", seed " + std::to_string(o.seed);
    return info;
  }

  int64_t timestamp(int index) const { return std::llround(1e9 * index / options_.frames_per_s); }

  PhoneOptions options_;
  Scene scene_;
  MotionCurve motion_;
  platform::CameraInfo info_;
  Sensor sensor_;
  std::vector<uint8_t> pixels_;
  std::vector<int> delivered_;  // indices of the frames that are not dropped
  size_t next_ = 0;
};

std::string seconds(int64_t ns) {
  char text[48];
  std::snprintf(text, sizeof text, "%" PRId64 ".%09" PRId64, ns / 1000000000, ns % 1000000000);
  return text;
}

void write_text(const std::filesystem::path& file, const std::string& text) {
  std::ofstream out(file, std::ios::binary);
  out << text;
  out.close();
  if (!out) throw InputError(file.string() + ": cannot be written");
}

std::string calibration_text(const platform::CameraInfo& info) {
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

}  // namespace

std::unique_ptr<platform::Camera> make_phone_camera(const PhoneOptions& options) {
  check(options);
  return std::make_unique<PhoneCamera>(options);
}

void dump_sequence(platform::Camera& camera, const std::filesystem::path& folder, void (*progress)(int, int)) {
  std::error_code error;
  if (std::filesystem::exists(folder, error) &&
      (!std::filesystem::is_directory(folder, error) || !std::filesystem::is_empty(folder, error))) {
    throw InputError(folder.string() + ": exists and is not an empty folder; name a new one");
  }
  std::filesystem::create_directories(folder / "rgb", error);
  if (error) throw InputError(folder.string() + ": cannot be made: " + error.message());

  write_text(folder / "calibration.yaml", calibration_text(camera.info()));
  std::string list = "# timestamp filename\n";
  Frame frame;
  int done = 0;
  while (camera.read(&frame)) {
    if (frame.format != PixelFormat::kGrey) throw InputError(camera.info().name + ": only grey images can be dumped");
    const std::string stamp = seconds(frame.timestamp_ns);
    const std::string name = "rgb/" + stamp + ".png";
    platform::write_png(folder / name, {frame.data, frame.width, frame.height, frame.stride_bytes});
    list += stamp + " " + name + "\n";
    ++done;
    if (progress != nullptr) progress(done, camera.info().frame_count.value_or(done));
  }
  write_text(folder / "rgb.txt", list);
  platform::Trajectory truth = camera.ground_truth();
  if (!truth.empty()) {
    platform::write_tum_trajectory(folder / "groundtruth.txt", truth,
                                   "T_world_camera: t tx ty tz qx qy qz qw (camera x right, y down, z forward)");
  }
}

}  // namespace pptam::sim
