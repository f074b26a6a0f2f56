// How far from the views in a map the relocaliser finds the camera: a map of one place is made, and then the camera is
// put elsewhere, turned away and nearer, and the map is loaded anew. Judged by ground truth.
#pragma once

#include <string>
#include <vector>

#include "platform/run/run.h"
#include "sim_phone/phone_camera.h"

namespace pptam::laboratory {

// Where the camera is put: turned by so much about an axis in the image's plane, and nearer by a share of the distance.
struct Displacement {
  double turned_degrees = 0;
  double nearer = 0;
};
// Of all attempts from one such place.
struct ReachCount {
  Displacement at;
  int attempts = 0;
  int found = 0;      // rightly, within kReachFrames
  int wrong = 0;      // a pose was reported that is not right
  double frames = 0;  // until it was found, mean of those found
};

constexpr int kReachFrames = 30;  // two seconds

// phone: a short hold-and-move start (motion "start"). directions: of the turn, spread evenly. Empty without a map.
std::vector<ReachCount> measure_reach(const sim::PhoneOptions& phone, const platform::RunOptions& options,
                                      const std::vector<Displacement>& places, int directions);

struct ReachStudyOptions {
  std::vector<std::string> scenes;  // empty: desk, boxes, clutter
  int seeds = 5;
  int jobs = 1;
  sim::PhoneOptions phone;  // but for scene, seed, motion and duration
  platform::RunOptions run;
};

// Prints a table. False when not all could be finished, or less than 90 % are found at 20 degrees or 30 % nearer, or a
// pose is wrong.
bool run_reach_study(const ReachStudyOptions& options);

}  // namespace pptam::laboratory
