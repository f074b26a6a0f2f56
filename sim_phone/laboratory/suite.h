// Many runs on the emulated phone, stories times seeds, as one table: the program's own yardstick, with its goals.
#pragma once

#include <cstddef>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "platform/run/run.h"
#include "sim_phone/phone_camera.h"

namespace pptam::laboratory {

struct Shard {
  int number = 1;  // 1 to count
  int count = 1;
};
// "2/4". Throws InputError.
Shard parse_shard(const std::string& text);
// Those of so many runs that belong to a shard: every count-th, so that each shard gets a share of every story.
std::vector<size_t> runs_of(const Shard& shard, size_t runs);

struct SuiteOptions {
  std::vector<std::string> stories;  // of sim::stories()
  std::vector<std::string> scenes;   // of sim::scene_names(), with the phone's motion
  int seeds = 5;                     // 1 to seeds
  int jobs = 1;                      // threads; the results do not depend on it with the work clock
  Shard shard;
  bool compare = false;     // also with a global shutter, and with a rolling one that the system is not told of
  sim::PhoneOptions phone;  // for scenes, but for scene and seed
  std::function<void(sim::PhoneOptions*)> adjust_story = [](sim::PhoneOptions*) {};  // what is to be unlike the story's
  platform::RunOptions run;
  std::filesystem::path out;  // suite.csv and suite.html are written here
  std::string command, version;
  std::string repeat_options;  // of the command, to repeat one run
};

// Prints the table; throws InputError on options that make no sense, before anything is written. Returns the number of
// runs that broke.
int run_suite(const SuiteOptions& options);

}  // namespace pptam::laboratory
