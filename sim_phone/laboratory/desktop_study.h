// The experiments of [ptam 7], with several seeds: accuracy, density and outliers of the map, what is tracked and found
// again.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "platform/run/run.h"
#include "sim_phone/phone_options.h"

namespace pptam::laboratory {

struct DesktopStudyOptions {
  std::vector<std::string> stories;  // of sim::desktop_stories(); empty: all
  int seeds = 5;                     // 1 to seeds
  int jobs = 1;
  std::function<void(sim::PhoneOptions*)> adjust_story = [](sim::PhoneOptions*) {};  // what is to be unlike the story's
  platform::RunOptions run;
};

// Prints a table, with the medians and worst values of each story. False when a signal cut it short.
bool run_desktop_study(const DesktopStudyOptions& options);

}  // namespace pptam::laboratory
