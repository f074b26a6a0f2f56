// What a stretch of bad pictures does to a finished map: frames out of order, shifted, zoomed, frozen or of another
// scene for two seconds, in explorations that are whole before and after. Judged by ground truth: whether the map
// has kept its size, and whether a wrong pose is called good afterwards.
#pragma once

#include <string>
#include <vector>

#include "platform/run/run.h"
#include "sim_phone/phone_camera.h"

namespace pptam::laboratory {

// Of one run.
struct StretchRun {
  std::string name;
  bool begun = false;          // there was a map before
  double scale_percent;        // change of the map's scale by the end; NaN: no map was left, or too little of it
  double tracked_percent = 0;  // of the frames from one second after the stretch on
  int judged = 0;              // poses there that are called good
  int wrong_good = 0;          // wrong ones among them, as Evaluation defines them, by the map before
  double largest_percent;      // error of the position there, of the extent; NaN: no pose
  int misfits_before = 0, misfits_within = 0;  // frames told as misfits, before the stretch and in it
  StretchRun();
};

// none, shuffled, shifted, zoomed, frozen, backwards, foreign
std::vector<std::string> stretch_kinds();
// phone: kMinStretchRun_s or longer. kind: one of stretch_kinds(). Throws InputError on others.
constexpr double kMinStretchRun_s = 18;
StretchRun run_stretch(const sim::PhoneOptions& phone, const platform::RunOptions& options, const std::string& kind);

struct StretchStudyOptions {
  std::vector<std::string> scenes;  // empty: desk, boxes, walls
  int seeds = 5;                    // of each kind of stretch in each scene: 1 to seeds
  int jobs = 1;
  sim::PhoneOptions phone;  // but for scene and seed
  platform::RunOptions run;
};

// Prints a row for each run and each kind's worst. False when not all runs could be finished, or a goal is missed.
bool run_stretch_study(const StretchStudyOptions& options);

}  // namespace pptam::laboratory
