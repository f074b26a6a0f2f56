// What each cause of harder pictures does to tracking: the same explorations with each cause alone, and with all.
#pragma once

#include <string>
#include <vector>

#include "platform/run/run.h"
#include "sim_phone/phone_camera.h"

namespace pptam::laboratory {

struct HarshStudyOptions {
  std::vector<std::string> scenes;  // empty: desk
  int seeds = 5;                    // 1 to seeds
  int jobs = 1;
  sim::PhoneOptions phone;  // but for scene, seed and what is harsh
  platform::RunOptions run;
};

// Prints a table for each scene. False when not all runs could be finished.
bool run_harsh_study(const HarshStudyOptions& options);

}  // namespace pptam::laboratory
