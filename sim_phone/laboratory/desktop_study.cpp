#include "sim_phone/laboratory/desktop_study.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <memory>

#include "platform/input_error.h"
#include "platform/run/console.h"
#include "platform/run/evaluation.h"
#include "platform/run/interruption.h"
#include "platform/run/jobs.h"
#include "platform/run/statistics.h"
#include "platform/text.h"
#include "sim_phone/desktop_stories.h"
#include "sim_phone/laboratory/judgement.h"
#include "sim_phone/phone_camera.h"
#include "sim_phone/story.h"

namespace pptam::laboratory {
namespace {

using namespace platform;

// A map point farther from every surface than this share of the depth at which the cameras see the scene is an outlier.
constexpr double kDesktopOutlierShare = 0.01;

struct DesktopValue {
  const char* name;
  const char* pattern;
  double worst_share;  // percentile that is the worst
};
enum DesktopValueId {
  kDesktopTracked,
  kDesktopRecovery,
  kDesktopError,
  kDesktopErrorPercent,
  kDesktopKeyframes,
  kDesktopPoints,
  kDesktopOutliers,
  kDesktopFrame,
  kDesktopDropped,
  kDesktopValueCount
};
constexpr DesktopValue kDesktopValues[kDesktopValueCount] = {
    {"tracked %", "%.1f", 0}, {"found s", "%.2f", 1},  {"ATE mm", "%.2f", 1},
    {"ATE %", "%.4f", 1},     {"keyfr.", "%.0f", 0},   {"points", "%.0f", 0},
    {"out %", "%.2f", 1},     {"frame ms", "%.2f", 1}, {"dropped", "%.0f", 1}};

struct DesktopRun {
  std::string name;
  double values[kDesktopValueCount];
};

double distance_from_surface(const sim::Surface& s, const sim::Vector3d& p) {
  const sim::Vector3d from = p - s.origin;
  const double u = std::clamp(from.dot(s.u_axis), 0.0, s.width_m), v = std::clamp(from.dot(s.v_axis), 0.0, s.height_m);
  return (from - u * s.u_axis - v * s.v_axis).norm();
}

double outlier_percent(const RunLog& log, const Evaluation& evaluation, const sim::Scene& scene) {
  std::vector<double> depths;
  for (const AssociatedPose& pose : evaluation.poses) {
    const double depth = sim::first_hit(scene, pose.truth_T_wc.translation(), pose.truth_T_wc.linear().col(2));
    if (std::isfinite(depth)) depths.push_back(depth);
  }
  const double limit = kDesktopOutlierShare * percentile(depths, 0.5);
  int outliers = 0;
  for (const MapPointInfo& point : log.map_points) {
    const sim::Vector3d p = evaluation.alignment * point.p_w.cast<double>();
    double nearest = std::numeric_limits<double>::infinity();
    for (const sim::Surface& surface : scene.surfaces) nearest = std::min(nearest, distance_from_surface(surface, p));
    outliers += nearest > limit;
  }
  return 100.0 * outliers / static_cast<double>(std::max<size_t>(1, log.map_points.size()));
}

DesktopRun see_desktop(const sim::PhoneOptions& phone, const RunOptions& run) {
  DesktopRun seen;
  seen.name = phone.story + " " + std::to_string(phone.seed);
  std::fill(std::begin(seen.values), std::end(seen.values), kNone);
  const auto scene = std::make_shared<const sim::Scene>(sim::make_scene(phone));
  const std::unique_ptr<platform::Camera> camera = sim::make_phone_camera(phone, scene);
  const Trajectory truth = camera->ground_truth();
  const RunLog log = run_sequence(
      *camera, run, [](const CameraInfo&) {}, nullptr);
  const auto exposed_s = static_cast<double>(log.camera.exposure_s) + std::abs(phone.readout_s);
  const Judgement judged = judge(log, truth, sim::story_of(phone, *scene), exposed_s);
  seen.values[kDesktopTracked] = judged.tracked_percent();
  seen.values[kDesktopRecovery] = judged.recovery_s;
  seen.values[kDesktopKeyframes] = static_cast<double>(log.keyframes.size());
  seen.values[kDesktopPoints] = static_cast<double>(log.map_points.size());
  seen.values[kDesktopFrame] = cost_of(log).mean_ms;
  seen.values[kDesktopDropped] = log.dropped;
  try {
    const Evaluation evaluation = evaluate(log.trajectory(), truth, "trajectory", "ground truth");
    seen.values[kDesktopError] = 1e3 * evaluation.ate_rmse;
    seen.values[kDesktopErrorPercent] = evaluation.ate_percent();
    seen.values[kDesktopOutliers] = outlier_percent(log, evaluation, *scene);
  } catch (const InputError&) {  // too little was tracked: there is no error
  }
  return seen;
}

std::vector<std::string> desktop_row(const std::string& name, const double* values) {
  std::vector<std::string> row = {name};
  for (int i = 0; i < kDesktopValueCount; ++i)
    row.push_back(std::isnan(values[i]) ? "-" : format(kDesktopValues[i].pattern, values[i]));
  return row;
}

// The median and the worst of the values that there are.
void add_desktop_summary(const std::string& story, const std::vector<DesktopRun>& runs,
                         std::vector<std::vector<std::string>>* rows) {
  double medians[kDesktopValueCount], worst[kDesktopValueCount];
  for (int i = 0; i < kDesktopValueCount; ++i) {
    std::vector<double> values;
    for (const DesktopRun& seen : runs)
      if (!std::isnan(seen.values[i])) values.push_back(seen.values[i]);
    medians[i] = percentile(values, 0.5);
    worst[i] = percentile(values, kDesktopValues[i].worst_share);
  }
  rows->push_back(desktop_row(story + ", median", medians));
  rows->push_back(desktop_row(story + ", worst", worst));
}

}  // namespace

bool run_desktop_study(const DesktopStudyOptions& options) {
  std::vector<std::string> stories = options.stories;
  if (stories.empty())
    for (const sim::DesktopStory& story : sim::desktop_stories()) stories.emplace_back(story.name);
  const auto seeds = static_cast<size_t>(options.seeds);
  std::vector<sim::PhoneOptions> phones;
  for (const std::string& story : stories) {
    if (!sim::is_desktop_story(story))
      throw InputError("--study desktop: --story " + story + " is not one of the desktop system");
    for (size_t seed = 1; seed <= seeds; ++seed) {
      sim::PhoneOptions phone = sim::phone_for_desktop_story(story, seed);
      options.adjust_story(&phone);
      sim::check_phone_options(phone);
      phones.push_back(phone);
    }
  }
  stop_on_signals();
  std::vector<DesktopRun> all(phones.size());
  const std::vector<bool> done = run_jobs(options.jobs, all.size(), [&](size_t i) {
    all[i] = see_desktop(phones[i], options.run);
    return all[i].name;
  });
  std::vector<std::vector<std::string>> rows;
  size_t missing = 0;
  for (size_t s = 0; s < stories.size(); ++s) {
    std::vector<DesktopRun> runs;
    for (size_t i = s * seeds; i < (s + 1) * seeds; ++i) {
      if (!done[i]) {
        ++missing;
        continue;
      }
      runs.push_back(all[i]);
      rows.push_back(desktop_row(all[i].name, all[i].values));
    }
    add_desktop_summary(stories[s], runs, &rows);
  }
  std::vector<std::string> head = {"run"};
  for (const DesktopValue& value : kDesktopValues) head.emplace_back(value.name);
  print_table(head, rows);
  std::printf(
      "\ntracked: of the frames from the first pose on in which tracking can be expected. found: after a loss, from "
      "the "
      "view's return.\nATE: rms after a similarity, and of the path. out: points over %g %% of the usual depth away "
      "from "
      "every surface.\nframe: mean tracking time of the modelled processor.\n",
      100 * kDesktopOutlierShare);
  std::fflush(stdout);
  if (missing > 0) print_error(interruption() + format(": %zu of %zu runs are missing", missing, all.size()));
  return missing == 0;
}

}  // namespace pptam::laboratory
