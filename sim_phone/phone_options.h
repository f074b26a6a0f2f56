// What can be chosen of an emulated phone's run: scene, motion, seeds, shutter, exposure and faults.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include <pocket_ptam/pocket_ptam.h>
#include "sim_phone/harshness.h"

namespace pptam::sim {

struct PhoneOptions {
  std::string story;                   // one of stories() (story.h): its scene and motion; empty: these two
  std::string scene = "desk";          // one of scene_names() (scene.h)
  std::string motion = "calm";         // one of motion_names() or start_names() (motion.h)
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
  bool even_readout = false;    // as of SensorOptions
  double drop_probability = 0;  // of each frame
  Harshness harsh;
};

}  // namespace pptam::sim
