// Whether a run says that it was told of a wrong camera (platform/calibrate/camera_fit.h, doubt_camera): explorations
// tracked under the right camera, and under many wrong focal lengths and shutters, judged by ground truth.
#pragma once

#include <string>
#include <vector>

#include "platform/run/run.h"
#include "sim_phone/phone_camera.h"

namespace pptam::laboratory {

struct DoubtStudyOptions {
  std::vector<std::string> scenes;  // empty: desk, boxes, walls, clutter, plane, front
  int seeds = 1;                    // in each scene: 1 to seeds; the wrong cameras with the first one
  int jobs = 1;
  sim::PhoneOptions phone;  // but for scene and seed
  platform::RunOptions run;
};

// Prints a row for each wrong camera, and the counts. False when not all could be tried, or a goal is missed.
bool run_doubt_study(const DoubtStudyOptions& options);

}  // namespace pptam::laboratory
