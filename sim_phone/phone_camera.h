// The emulated phone: a scene, a hand that moves, and a rolling-shutter image sensor, as a platform::Camera.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "platform/camera.h"
#include "sim_phone/scene.h"

namespace pptam::sim {

struct PhoneOptions {
  std::string story;                   // one of stories() (sim_phone/story.h): its scene and motion; empty: these two
  std::string scene = "desk";          // one of scene_names()
  std::string motion = "calm";         // one of motion_names() or start_names() (sim_phone/motion.h)
  uint64_t seed = 1;                   // of the scene's details, the hand's motion and the sensor's noise
  std::optional<uint64_t> scene_seed;  // of the scene's details, when they have a seed of their own
  double duration_s = 20;
  int width = 240;  // portrait
  int height = 320;
  double horizontal_fov_degrees = 37;
  double frames_per_s = 15;
  RollingShutter::Axis readout_axis = RollingShutter::Axis::kColumns;
  double readout_s = -0.060;  // signed: the phone's left edge is exposed last [phone 6]; 0 is a global shutter
  double exposure_s = 0.030;
  bool noise = true;            // shot and read noise, vignetting, auto-exposure, gamma
  double drop_probability = 0;  // of each frame
};

// "desk", "boxes", "walls", "checkerboard" (alone, all its squares alike), "plane", "clutter", "sparse", "tiles",
// "board" (a checkerboard on the desk).
std::vector<std::string> scene_names();
// "calm": hold still, move sideways, then explore. "shaky": the same with four times the tremor. "still": as on a
// tripod. "pure_rotation": turns about a fixed point. "lap": as "calm", but ends as it begins, at the first view.
std::vector<std::string> motion_names();

// Throws platform::InputError on options that make no sense, naming the option.
void check_phone_options(const PhoneOptions& options);
// Checks likewise. scene: the one that the options ask
// for, when it has been painted before.
std::unique_ptr<platform::Camera> make_phone_camera(const PhoneOptions& options,
                                                    std::shared_ptr<const Scene> scene = nullptr);

}  // namespace pptam::sim
