// Long life on the emulated phone: a closed path is rendered once and seen again and again, for an hour if need be,
// with cuts to other places of it and with a covered lens, but in the minutes that are compared: the second and the
// last. Does the map stay small, the cost flat, the pose right?
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "platform/run/run.h"
#include "sim_phone/phone_camera.h"

namespace pptam::laboratory {

struct EnduranceOptions {
  int minutes = 60;
  sim::PhoneOptions phone;  // scene, seed, camera; motion and duration are those of one lap of a minute
  platform::RunOptions run;
  bool twice = false;  // a second run must give the same map at the end of every minute
};

struct EnduranceMinute {
  int frames = 0, expected = 0, tracked = 0;      // expected: not covered, nor within a second after a cover or a cut
  int losses = 0, recovered = 0;                  // covers and cuts; found within a second
  double ate_mm = 0;                              // of all valid poses, by the second minute's alignment
  double minstructions = 0, minstructions99 = 0;  // of a tracked frame: mean and 99th percentile
  double mapping_minstructions = 0;               // of idle time, per frame
  int keyframes = 0, erased_keyframes = 0, map_points = 0;  // at its end
  uint32_t limits_hit = 0;
  uint64_t map_hash = 0;  // at its end
};

struct EnduranceReport {
  std::vector<EnduranceMinute> minutes;
  int64_t memory_bytes = 0;
  int dropped = 0;
  int map_parts = 0;
  bool same_twice = true;
  std::vector<std::string> faults;  // the criteria that are not met
};

// Throws InputError on options that make no sense. quiet: no progress on the terminal.
EnduranceReport endure(const EnduranceOptions& options, bool quiet);

// Runs, prints the table and the verdict. True: all criteria are met.
bool run_endurance(const EnduranceOptions& options);

}  // namespace pptam::laboratory
