#include "sim_phone/laboratory/culling_study.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

#include "platform/input_error.h"
#include "platform/run/console.h"
#include "platform/run/evaluation.h"
#include "platform/run/interruption.h"
#include "platform/run/jobs.h"
#include "platform/run/statistics.h"
#include "platform/text.h"
#include "sim_phone/laboratory/judgement.h"
#include "sim_phone/laboratory/keeping_camera.h"

namespace pptam::laboratory {
namespace {

using namespace platform;

constexpr int kEnoughKeyframes = 150;
constexpr double kGoalRatio = 1.15;

struct Seen {
  double tracked_percent = 0, ate_percent = std::numeric_limits<double>::quiet_NaN(), mapping_minstructions = 0;
  int keyframes = 0, erased = 0, points = 0, parts = 0;
  bool full = false;
};

Seen see(KeepingCamera& camera, const RunOptions& options, const platform::Trajectory& truth) {
  camera.again();
  const RunLog log = run_sequence(
      camera, options, [](const platform::CameraInfo&) {}, nullptr);
  Seen seen;
  seen.tracked_percent = 100 * log.tracked_fraction();
  seen.keyframes = static_cast<int>(log.keyframes.size());
  seen.erased = log.frames.empty() ? 0 : log.frames.back().erased_keyframes;
  seen.points = static_cast<int>(log.map_points.size());
  seen.parts = log.map_parts;
  for (const FrameLog& frame : log.frames) {
    seen.mapping_minstructions += 1e-9 * static_cast<double>(frame.mapping_ns) *
                                  static_cast<double>(PhoneProfile().clock_mhz) /
                                  static_cast<double>(PhoneProfile().cycles_per_instruction);
    seen.full = seen.full || (frame.limits_hit & kLimitKeyframes);
  }
  seen.mapping_minstructions /= static_cast<double>(std::max<size_t>(1, log.frames.size()));
  try {
    seen.ate_percent = evaluate(log.trajectory(), truth, "trajectory", "ground truth").ate_percent();
  } catch (const platform::InputError&) {  // too little was tracked: there is no error
  }
  return seen;
}

struct Pair {
  std::string name;
  Seen culled, all;
};

}  // namespace

bool run_culling_study(const CullingStudyOptions& options) {
  std::vector<std::string> scenes = options.scenes;
  if (scenes.empty()) scenes = {"desk", "walls"};
  const auto seeds = static_cast<size_t>(options.seeds);
  for (const std::string& scene : scenes) {
    sim::PhoneOptions phone = options.phone;
    phone.scene = scene;
    sim::check_phone_options(phone);
  }
  stop_on_signals();
  std::vector<Pair> all(scenes.size() * seeds);
  const std::vector<bool> done = run_jobs(options.jobs, all.size(), [&](size_t i) {
    sim::PhoneOptions phone = options.phone;
    phone.scene = scenes[i / seeds];
    phone.seed = 1 + i % seeds;
    KeepingCamera camera(sim::make_phone_camera(phone));
    const platform::Trajectory truth = camera.ground_truth();
    Pair& pair = all[i];
    pair.name = phone.scene + " " + std::to_string(phone.seed);
    pair.culled = see(camera, options.run, truth);
    RunOptions enough = options.run;
    enough.max_keyframes = kEnoughKeyframes;
    pair.all = see(camera, enough, truth);
    return pair.name;
  });
  std::vector<Pair> pairs;  // those that a signal has not cut short
  for (size_t i = 0; i < all.size(); ++i) {
    if (done[i]) pairs.push_back(all[i]);
  }

  std::vector<std::vector<std::string>> rows;
  std::vector<double> ratios, culled_errors, all_errors;
  int split = 0, lost = 0;
  for (const Pair& pair : pairs) {
    const Seen &a = pair.culled, &b = pair.all;
    rows.push_back({pair.name, format("%d", a.keyframes), format("%d", a.erased), format("%d", a.points),
                    format("%d", a.parts), a.full ? "full" : "", format("%.1f", a.tracked_percent),
                    format("%.3f", a.ate_percent), format("%.2f", a.mapping_minstructions), format("%d", b.keyframes),
                    format("%d", b.points), format("%.1f", b.tracked_percent), format("%.3f", b.ate_percent),
                    format("%.2f", b.mapping_minstructions), format("%.2f", a.ate_percent / b.ate_percent)});
    split += a.parts > 1;
    if (std::isnan(a.ate_percent) || std::isnan(b.ate_percent)) {
      ++lost;
      continue;
    }
    ratios.push_back(a.ate_percent / b.ate_percent);
    culled_errors.push_back(a.ate_percent);
    all_errors.push_back(b.ate_percent);
  }
  print_table({"run", "keyfr.", "erased", "points", "parts", "", "tracked", "ATE %", "map M", "| keyfr.", "points",
               "tracked", "ATE %", "map M", "ratio"},
              rows);
  const double ratio = percentile(ratios, 0.5);
  const bool met = split == 0 && ratio <= kGoalRatio;
  std::printf(
      "\nLeft with culling, right with up to %d keyframes. ATE: of the path. map M: million modelled instructions of "
      "mapping a frame.\nATE, median: %.3f %% with, %.3f %% without; median of the ratios %.2f, 90th percentile %.2f; "
      "goal for the median %.2f.\nmaps that came apart: %d of %zu; without a result: %d\n%s\n",
      kEnoughKeyframes, percentile(culled_errors, 0.5), percentile(all_errors, 0.5), ratio, percentile(ratios, 0.9),
      kGoalRatio, split, pairs.size(), lost, met ? "the goals are met" : "the goals are NOT met");
  std::fflush(stdout);
  if (pairs.size() < all.size())
    print_error(interruption() + format(": %zu of %zu pairs are missing", all.size() - pairs.size(), all.size()));
  return met && pairs.size() == all.size();
}

}  // namespace pptam::laboratory
