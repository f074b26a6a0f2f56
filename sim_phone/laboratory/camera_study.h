// How well a camera is found from a clip (platform/calibrate/camera_search.h): explorations by phones whose shutters
// and lenses are drawn by chance, told a global shutter and a wrong focal length.
#pragma once

#include <string>
#include <vector>

#include "platform/run/run.h"
#include "sim_phone/phone_camera.h"

namespace pptam::laboratory {

struct CameraStudyOptions {
  std::vector<std::string> scenes;  // empty: desk, boxes, walls
  int seeds = 5;                    // in each scene: 1 to seeds
  int jobs = 1;
  sim::PhoneOptions phone;  // but for scene, seed, shutter and field of view
  platform::RunOptions run;
};

// Prints a row for each clip, and the worst. False when not all could be tried, or a goal is missed.
bool run_camera_study(const CameraStudyOptions& options);

}  // namespace pptam::laboratory
