#include "sim_phone/phone_camera.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "platform/input_error.h"
#include "platform/text.h"
#include "sim_phone/desktop_stories.h"
#include "sim_phone/model_stories.h"
#include "sim_phone/motion.h"
#include "sim_phone/random.h"
#include "sim_phone/scene.h"
#include "sim_phone/sensor.h"
#include "sim_phone/story.h"

namespace pptam::sim {
namespace {

using platform::InputError;
using platform::joined;

std::string limit_text(double value) {
  return platform::format("%g", value);
}

void require(bool good, const std::string& message) {
  if (!good) throw InputError("emulated phone: " + message);
}

SensorOptions sensor_for(const PhoneOptions& options, const platform::CameraInfo& info, const Story& story) {
  SensorOptions sensor;
  sensor.model = info.model;
  sensor.shutter = info.shutter;
  sensor.exposure_s = options.exposure_s;
  sensor.noise = options.noise;
  sensor.even_readout = options.even_readout;
  sensor.seed = options.seed;
  sensor.light = story.light;
  sensor.occluder = story.occluder;
  sensor.movers = story.movers;
  sensor.harsh = options.harsh;
  return sensor;
}

class PhoneCamera : public platform::Camera {
 public:
  PhoneCamera(const PhoneOptions& options, std::shared_ptr<const Scene> scene)
      : options_(options),
        scene_(scene ? std::move(scene) : std::make_shared<const Scene>(make_scene(options))),
        story_(story_of(options, *scene_)),
        info_(make_info(options)),
        sensor_(*scene_, story_.curve, sensor_for(options, info_, story_)),
        pixels_(static_cast<size_t>(options.width) * static_cast<size_t>(options.height)) {
    const int frames = std::max(1, static_cast<int>(std::floor(options.duration_s * options.frames_per_s + 1e-9)));
    for (int i = 0; i < frames; ++i) {
      Random random(options.seed, 1000 + static_cast<uint64_t>(i));
      const double t_s = 1e-9 * static_cast<double>(timestamp(i));
      const bool paused = std::any_of(story_.no_frames.begin(), story_.no_frames.end(),
                                      [&](const Interval& pause) { return t_s >= pause.from_s && t_s < pause.to_s; });
      if (!random.chance(options.drop_probability) && !paused) delivered_.push_back(i);
    }
    info_.frame_count = static_cast<int>(delivered_.size());
  }

  const platform::CameraInfo& info() const override { return info_; }

  platform::CameraEvent wait(Frame* frame, int64_t /*deadline_ns*/) override {
    if (next_ == delivered_.size()) return platform::CameraEvent::kEnd;
    const int index = delivered_[next_++];
    const int64_t timestamp_ns = timestamp(index);
    sensor_.expose(1e-9 * static_cast<double>(timestamp_ns), static_cast<uint64_t>(index), pixels_.data());
    *frame = {pixels_.data(), options_.width, options_.height, options_.width, PixelFormat::kGrey, timestamp_ns};
    return platform::CameraEvent::kFrame;
  }

  platform::Trajectory ground_truth() const override {
    platform::Trajectory truth;
    for (const int index : delivered_) {
      const int64_t timestamp_ns = timestamp(index);
      truth.push_back({timestamp_ns, story_.curve(1e-9 * static_cast<double>(timestamp_ns))});
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
    info.name = (o.story.empty() ? o.scene + ", " + o.motion : o.story) + ", seed " + std::to_string(o.seed);
    return info;
  }

  int64_t timestamp(int index) const { return std::llround(1e9 * index / options_.frames_per_s); }

  PhoneOptions options_;
  std::shared_ptr<const Scene> scene_;
  Story story_;
  platform::CameraInfo info_;
  Sensor sensor_;
  std::vector<uint8_t> pixels_;
  std::vector<int> delivered_;  // indices of the frames that are not dropped
  size_t next_ = 0;
};

}  // namespace

Scene make_scene(const PhoneOptions& options) {
  if (is_model_story(options.story)) return make_model_scene(options.story, options.seed);
  if (is_desktop_story(options.story)) return make_desktop_scene(options.story, options.seed);
  return make_scene(options.scene, options.scene_seed.value_or(options.seed), options.harsh);
}

// Written so that NaN fails.
void check_phone_options(const PhoneOptions& o) {
  const auto known = [](const std::string& name, const std::vector<std::string>& names) {
    return std::find(names.begin(), names.end(), name) != names.end();
  };
  if (!o.story.empty()) {
    std::vector<std::string> names;
    for (const StoryKind& kind : stories()) names.push_back(kind.name);
    for (const DesktopStory& kind : desktop_stories()) names.push_back(kind.name);
    for (const ModelStory& kind : model_stories()) names.push_back(kind.name);
    require(known(o.story, names), "story '" + o.story + "' is unknown; choose one of " + joined(names));
  }
  require(known(o.scene, scene_names()), "scene '" + o.scene + "' is unknown; choose one of " + joined(scene_names()));
  std::vector<std::string> motions = motion_names();
  for (const std::string& name : start_names()) motions.push_back(name);
  require(known(o.motion, motions), "motion '" + o.motion + "' is unknown; choose one of " + joined(motions));
  require(o.duration_s > 0 && o.duration_s <= 3600, "duration_s must be over 0 and at most 3600 seconds");
  require(o.width >= 32 && o.width <= 4096, "width must be from 32 to 4096 pixels");
  require(o.height >= 32 && o.height <= 4096, "height must be from 32 to 4096 pixels");
  require(o.horizontal_fov_degrees >= 5 && o.horizontal_fov_degrees <= 120,
          "horizontal_fov_degrees must be from 5 to 120 degrees");
  require(o.frames_per_s >= 1 && o.frames_per_s <= 240, "frames_per_s must be from 1 to 240");
  require(std::abs(o.readout_s) <= 1 / o.frames_per_s, "readout_s must not be longer than a frame's period");
  require(o.exposure_s >= 0 && o.exposure_s <= 1 / o.frames_per_s, "exposure_s must be from 0 to a frame's period");
  require(o.drop_probability >= 0 && o.drop_probability < 1, "drop_probability must be from 0 to under 1");
  for (const Cause& cause : causes()) {
    const double value = o.harsh.*cause.value;
    require(value >= 0 && value <= cause.greatest,
            std::string(cause.name) + " must be from 0 to " + limit_text(cause.greatest));
  }
}

std::unique_ptr<platform::Camera> make_phone_camera(const PhoneOptions& options, std::shared_ptr<const Scene> scene) {
  check_phone_options(options);
  return std::make_unique<PhoneCamera>(options, std::move(scene));
}

}  // namespace pptam::sim
