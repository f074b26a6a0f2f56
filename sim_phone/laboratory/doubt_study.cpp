#include "sim_phone/laboratory/doubt_study.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "platform/calibrate/camera_search.h"
#include "platform/run/console.h"
#include "platform/run/evaluation.h"
#include "platform/run/interruption.h"
#include "platform/run/jobs.h"
#include "platform/run/names.h"
#include "platform/run/statistics.h"
#include "platform/text.h"
#include "sim_phone/hand.h"
#include "sim_phone/laboratory/keeping_camera.h"

namespace pptam::laboratory {
namespace {

using namespace platform;
using Axis = RollingShutter::Axis;

constexpr double kMaxError_percent = 5, kMaxError_deg = 5;  // beyond, a run is wrong
constexpr double kWantedTold = 0.95;                        // of the wrong runs
constexpr int kWantedFalse_percent = 1;                     // fewer of the right runs

// What is told of the camera, relative to the truth.
struct Told {
  double focal = 1;
  double readout = 1;  // signed
  bool other_axis = false;
};

// 36: each of many focal lengths, each of many shutters, and some of both.
std::vector<Told> wrong_cameras() {
  std::vector<Told> told;
  for (const double focal : {0.5, 0.6, 0.7, 0.8, 0.9, 1.1, 1.2, 1.3, 1.45, 1.6, 1.8, 2.0}) told.push_back({focal, 1});
  for (const double readout : {-1.0, -0.5, 0.0, 0.5, 1.5, 2.0}) told.push_back({1, readout});
  for (const double readout : {-1.0, -0.5, 0.5, 1.0}) told.push_back({1, readout, true});
  for (const double focal : {0.6, 0.8, 1.3, 1.8}) {
    for (const double readout : {-1.0, 0.0}) told.push_back({focal, readout});
    told.push_back({focal, 1, true});
  }
  told.push_back({0.5, -0.5});
  told.push_back({2, 2});
  return told;
}

std::string title_of(const Told& told) {
  return format("focal x%.2f, readout x%.1f%s", told.focal, told.readout, told.other_axis ? ", other axis" : "");
}

struct DoubtRun {
  bool tracked = false;  // anything that can be judged
  double error_percent = kNone, error_deg = kNone;
  CameraDoubts doubts;
  bool wrong() const { return tracked && (error_percent > kMaxError_percent || error_deg > kMaxError_deg); }
  bool doubted() const { return doubts.focal || doubts.readout; }
};

DoubtRun run_told(KeepingCamera* camera, const CameraInfo& truth, const Trajectory& path, const RunOptions& options,
                  const Told& told) {
  CameraModel model = truth.model;
  model.fx *= static_cast<float>(told.focal);
  model.fy *= static_cast<float>(told.focal);
  Axis axis = truth.shutter.axis;
  if (told.other_axis) axis = axis == Axis::kRows ? Axis::kColumns : Axis::kRows;
  camera->again_as(model, shutter_of(axis, told.readout * readout_of(truth.shutter, truth.model), model));
  PointTracks tracks;
  const RunLog log = run_sequence(
      *camera, options, [](const CameraInfo&) {},
      [&](const Frame&, const TrackResult& result, const RunLog&) { tracks.add(result); });
  tracks.finish(log.map_points);
  DoubtRun run;
  run.doubts = doubt_camera(tracks, log.camera.model, log.camera.shutter);
  try {
    const Evaluation evaluation = evaluate(log.trajectory(), path, "run", "ground truth");
    run.tracked = evaluation.poses.size() >= kFewPoses;
    run.error_percent = evaluation.ate_percent();
    std::vector<double> turns;
    for (const AssociatedPose& pose : evaluation.poses) {
      const Eigen::AngleAxisd turn(pose.truth_T_wc.linear().transpose() * evaluation.alignment.R * pose.T_wc.linear());
      turns.push_back(turn.angle() / sim::kDegree);
    }
    run.error_deg = percentile(turns, 0.9);
  } catch (const InputError&) {  // nothing was tracked
  }
  return run;
}

}  // namespace

bool run_doubt_study(const DoubtStudyOptions& options) {
  std::vector<std::string> scenes = options.scenes;
  if (scenes.empty()) scenes = {"desk", "boxes", "walls", "clutter", "plane", "front"};
  const std::vector<Told> told = wrong_cameras();
  const size_t seeds = static_cast<size_t>(options.seeds);
  for (const std::string& scene : scenes) {
    sim::PhoneOptions phone = options.phone;
    phone.scene = scene;
    sim::check_phone_options(phone);
  }
  stop_on_signals();
  std::vector<DoubtRun> right(scenes.size() * seeds), wrong(scenes.size() * told.size());
  const std::vector<bool> done = run_jobs(options.jobs, right.size(), [&](size_t i) {
    sim::PhoneOptions phone = options.phone;
    phone.scene = scenes[i / seeds];
    phone.seed = 1 + i % seeds;
    KeepingCamera camera(sim::make_phone_camera(phone));
    const CameraInfo info = camera.info();
    const Trajectory path = camera.ground_truth();
    right[i] = run_told(&camera, info, path, options.run, Told());
    for (size_t k = 0; phone.seed == 1 && k < told.size() && !interrupted(); ++k)
      wrong[i / seeds * told.size() + k] = run_told(&camera, info, path, options.run, told[k]);
    return phone.scene + ", seed " + std::to_string(phone.seed);
  });

  const auto cell = [](const char* pattern, double value) {
    return std::isnan(value) ? std::string("-") : format(pattern, value);
  };
  const auto row = [&](const std::string& name, const DoubtRun& run) {
    std::string says;
    if (run.doubts.focal) says += format("focal x%.2f ", run.doubts.fit.focal.value);
    if (run.doubts.readout) says += readout_text(run.doubts.fit.axis, run.doubts.fit.readout_s.value);
    return std::vector<std::string>{name, cell("%.1f", run.error_percent), cell("%.1f", run.error_deg),
                                    run.doubted() ? says : "-"};
  };
  std::vector<std::vector<std::string>> rows;
  int wrong_runs = 0, wrong_told = 0, right_runs = 0, right_told = 0;
  for (size_t i = 0; i < wrong.size(); ++i) {
    const DoubtRun& run = wrong[i];
    wrong_runs += run.wrong();
    wrong_told += run.wrong() && run.doubted();
    rows.push_back(row(scenes[i / told.size()] + ", " + title_of(told[i % told.size()]), run));
    rows.back().push_back(run.wrong() ? (run.doubted() ? "wrong, told" : "WRONG, NOT TOLD") : "");
  }
  for (size_t i = 0; i < right.size(); ++i) {
    right_runs += right[i].tracked;
    right_told += right[i].doubted();
    if (!right[i].doubted()) continue;
    rows.push_back(row(scenes[i / seeds] + format(", seed %zu, right camera", 1 + i % seeds), right[i]));
    rows.back().push_back("RIGHT, DOUBTED");
  }
  print_table({"run", "ATE %", "degrees", "says", ""}, rows);
  print_line(
      format("\nof %d runs that are wrong by over %g %% of the path or %g degrees %d say so; of %d runs told the "
             "right camera %d doubt it",
             wrong_runs, kMaxError_percent, kMaxError_deg, wrong_told, right_runs, right_told));
  const size_t missing = static_cast<size_t>(std::count(done.begin(), done.end(), false));
  if (missing > 0) print_error(interruption() + format(": %zu of %zu clips are missing", missing, done.size()));
  return wrong_told >= kWantedTold * wrong_runs && 100 * right_told < kWantedFalse_percent * std::max(1, right_runs) &&
         missing == 0;
}

}  // namespace pptam::laboratory
