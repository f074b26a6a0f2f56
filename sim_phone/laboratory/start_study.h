// The initialisation study: hundreds of short starts on the emulated phone, judged by ground truth.
//
// A trial holds still, moves sideways (some turn on the spot first) and goes on for a few seconds with the map. It
// succeeds when a pose is reported within 4 s of the first sideways movement. Trials are numbered; number and kind fix
// everything, and each can be looked at with `pocket-ptam sim` and the options that its row in study.csv names.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "platform/run/run.h"
#include "sim_phone/motion.h"
#include "sim_phone/phone_camera.h"

namespace pptam::laboratory {

constexpr double kStudyLimit_s = 4;       // from the first sideways movement to the map
constexpr double kWrongPlane_deg = 10;    // the other solution of a homography is usually off by 20 and more
constexpr double kRightDepth = 0.1;       // relative
constexpr double kRightDepthShare = 0.8;  // of the map's points, for a right map
constexpr double kRightPoses = 0.95;

// A row of study.csv: what was done and all that is judged of it, hence so many members.
struct StudyTrial {
  std::string kind;
  uint64_t seed = 0;
  sim::PhoneOptions phone;  // everything to repeat it
  sim::Start start;

  bool initialised = false;  // in time
  bool early = false;        // a map, right or wrong, before the sideways movement
  double time_s = 0;         // from the first sideways movement to the first pose
  double baseline_m = 0;     // truth: from the first view (of the last tap) to the first pose
  double plane_share = 0;    // of the first view's points: on the plane that explains most of them, within 2 %
  int restarts = 0;
  double worst_minstructions = 0;  // of the frames before the first pose
  Hint last_hint = Hint::kNone;    // before the first pose

  // Scenes with a known plane: angle between its normal and the map's z axis, at the first pose and at the end.
  bool plane_known = false;
  double normal_deg = 0, normal_end_deg = 0;
  double depth_share = 0;     // of the map's points at the end: depth right within 10 % but for one common scale
  bool judged = false;        // there are enough poses for the next two
  double ate_percent = 0;     // of the path of the following seconds
  double wrong_fraction = 0;  // of their poses
  double tracked_fraction = 0;
  std::string trouble;

  bool wrong_plane() const { return initialised && plane_known && normal_deg > kWrongPlane_deg; }
  bool refused() const { return !initialised && last_hint == Hint::kTooLittleTexture; }  // honestly
  // The map that the user wanted.
  bool right() const {
    return initialised && !early && !wrong_plane() && depth_share >= kRightDepthShare && judged &&
           wrong_fraction <= 1 - kRightPoses;
  }
};

// Kinds of trials: "planar", "steep", "cameras", "rotation", "corners", "sparse", "repeated".
std::vector<std::string> study_kinds();

// One trial; follow_s: how long it goes on after the first pose. scene: painted before, or null. shutter_told: what the
// system is told of the shutter's line time, as a factor of the truth: 1 but for tests of the judge.
StudyTrial run_study_trial(const std::string& kind, uint64_t seed, double follow_s,
                           std::shared_ptr<const sim::Scene> scene = nullptr, float shutter_told = 1);
// The scene of a trial, which ten successive seeds share.
std::shared_ptr<const sim::Scene> study_scene(const std::string& kind, uint64_t seed);

struct StudyOptions {
  std::vector<std::string> kinds = study_kinds();
  int seeds = 20;  // of each kind, 1 to seeds
  int jobs = 1;
  double follow_s = 5;
  std::filesystem::path out;  // study.csv and study.html are written here
  std::string command, version;
};

// Prints the table; throws InputError on options that make no sense. Returns the number of trials that broke.
int run_study(const StudyOptions& options);

}  // namespace pptam::laboratory
