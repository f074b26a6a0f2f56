// Many runs on the emulated phone, scenes times seeds, as one table: the program's own yardstick.
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "platform/app/run.h"
#include "sim_phone/phone_camera.h"

namespace pptam::app {

struct SuiteOptions {
  std::vector<std::string> scenes = {"desk", "boxes", "walls"};
  int seeds = 5;            // 1 to seeds
  int jobs = 1;             // threads; the results do not depend on it with the work clock
  sim::PhoneOptions phone;  // but for scene and seed
  RunOptions run;
  std::filesystem::path out;  // suite.csv and suite.html are written here
  std::string command, version;
};

// Prints the table; throws InputError on options that make no sense, before anything is written. Returns the number of
// runs that broke.
int run_suite(const SuiteOptions& options);

// job(0) to job(count - 1) on so many threads; each returns what the progress line shall say when it is done.
void run_jobs(int threads, size_t count, const std::function<std::string(size_t)>& job);

// Is the truth's z = 0 the dominant plane of this scene?
bool ground_plane_known(const std::string& scene);

}  // namespace pptam::app
