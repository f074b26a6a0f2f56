// What culling of keyframes costs: exploring runs on the emulated phone, each seen twice, with the keyframes limited
// and with more than enough of them.
#pragma once

#include <string>
#include <vector>

#include "platform/run/run.h"
#include "sim_phone/phone_camera.h"

namespace pptam::laboratory {

struct CullingStudyOptions {
  std::vector<std::string> scenes;  // empty: desk and walls
  int seeds = 5;                    // 1 to seeds
  int jobs = 1;
  sim::PhoneOptions phone;   // but for scene and seed
  platform::RunOptions run;  // max_keyframes: that of the culled runs
};

// Prints a table and the verdict. True: no map has come apart, and the median ratio of the position errors is within
// the goal.
bool run_culling_study(const CullingStudyOptions& options);

}  // namespace pptam::laboratory
