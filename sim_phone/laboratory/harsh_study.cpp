#include "sim_phone/laboratory/harsh_study.h"

#include <cmath>
#include <cstdio>
#include <memory>
#include <utility>

#include "platform/run/console.h"
#include "platform/run/interruption.h"
#include "platform/run/jobs.h"
#include "platform/run/statistics.h"
#include "platform/text.h"
#include "sim_phone/laboratory/judgement.h"
#include "sim_phone/story.h"

namespace pptam::laboratory {
namespace {

using namespace platform;

// Bands need an exposure that is no multiple of the lamp's period, and brisk hands one that leaves something to see.
constexpr double kShortExposure_s = 0.004;

struct HarshCase {
  std::string name;
  sim::Harshness harsh;
  double exposure_s;
};

std::vector<HarshCase> cases_of(const sim::PhoneOptions& phone) {
  std::vector<HarshCase> cases = {{"none", {}, phone.exposure_s},
                                  {format("none, %g s", kShortExposure_s), {}, kShortExposure_s}};
  sim::Harshness all;
  for (const sim::Cause& cause : sim::causes()) {
    HarshCase alone{cause.name, {}, phone.exposure_s};
    alone.harsh.*cause.value = cause.usual;
    if (alone.harsh.flicker > 0 || alone.harsh.haste > 0) {
      alone.exposure_s = kShortExposure_s;
      alone.name += format(", %g s", kShortExposure_s);
    }
    all.*cause.value = cause.usual;
    cases.push_back(alone);
  }
  cases.push_back({"all", all, phone.exposure_s});
  return cases;
}

// Of one run.
struct HarshRun {
  std::vector<double> ratios;  // inliers to points attempted, of each tracked frame
  std::vector<double> lives;   // of each map point: keyframes that measure it
  std::vector<double> points;  // attempted in each tracked frame
  double reprojection_px = kNone, ate_percent = kNone, tracked_percent = 0;
};

HarshRun run_harshly(const HarshStudyOptions& options, const sim::PhoneOptions& phone) {
  const auto scene = std::make_shared<const sim::Scene>(sim::make_scene(phone));
  const std::unique_ptr<platform::Camera> camera = sim::make_phone_camera(phone, scene);
  const platform::Trajectory truth = camera->ground_truth();
  const RunLog log = run_sequence(
      *camera, options.run, [](const platform::CameraInfo&) {}, nullptr);
  const double exposed_s = std::abs(phone.readout_s) + phone.exposure_s;
  const Judgement judgement = judge(log, truth, sim::story_of(phone, *scene), exposed_s);
  HarshRun seen;
  for (const FrameLog& frame : log.frames) {
    if (frame.state != TrackingState::kTracking || frame.points_attempted == 0) continue;
    seen.ratios.push_back(static_cast<double>(frame.points_inliers) / frame.points_attempted);
    seen.points.push_back(frame.points_attempted);
  }
  for (const MapPointInfo& point : log.map_points) seen.lives.push_back(point.measurements);
  if (judgement.initialised) {
    seen.reprojection_px = log.reprojection_px();
    seen.ate_percent = judgement.ate_percent;
    seen.tracked_percent = judgement.tracked_percent();
  }
  return seen;
}

std::vector<std::string> harsh_cells(const std::string& name, const std::vector<HarshRun>& runs) {
  std::vector<double> ratios, lives, points, residuals, errors, tracked;
  for (const HarshRun& seen : runs) {
    ratios.insert(ratios.end(), seen.ratios.begin(), seen.ratios.end());
    lives.insert(lives.end(), seen.lives.begin(), seen.lives.end());
    points.insert(points.end(), seen.points.begin(), seen.points.end());
    tracked.push_back(seen.tracked_percent);
    if (!std::isnan(seen.reprojection_px)) residuals.push_back(seen.reprojection_px);
    if (!std::isnan(seen.ate_percent)) errors.push_back(seen.ate_percent);
  }
  const auto cell = [](const char* pattern, double value) {
    return std::isnan(value) ? std::string("-") : format(pattern, value);
  };
  return {name,
          cell("%.2f", percentile(ratios, 0.5)),
          cell("%.2f", percentile(ratios, 0.1)),
          cell("%.2f", percentile(residuals, 0.5)),
          cell("%.0f", percentile(lives, 0.5)),
          cell("%.0f", percentile(points, 0.1)),
          cell("%.1f", percentile(tracked, 0.5)),
          cell("%.1f", percentile(tracked, 0)),
          cell("%.2f", percentile(errors, 0.5)),
          format("%zu of %zu", errors.size(), runs.size())};
}

}  // namespace

bool run_harsh_study(const HarshStudyOptions& options) {
  std::vector<std::string> scenes = options.scenes;
  if (scenes.empty()) scenes = {"desk"};
  const std::vector<HarshCase> cases = cases_of(options.phone);
  const auto seeds = static_cast<size_t>(options.seeds);
  const auto phone_of = [&](size_t i) {
    sim::PhoneOptions phone = options.phone;
    const HarshCase& now = cases[i / seeds % cases.size()];
    phone.scene = scenes[i / seeds / cases.size()];
    phone.seed = 1 + i % seeds;
    phone.harsh = now.harsh;
    phone.exposure_s = now.exposure_s;
    return phone;
  };
  const size_t count = scenes.size() * cases.size() * seeds;
  for (size_t i = 0; i < count; ++i) sim::check_phone_options(phone_of(i));  // before minutes of work
  stop_on_signals();
  std::vector<HarshRun> all(count);
  const std::vector<bool> done = run_jobs(options.jobs, count, [&](size_t i) {
    const sim::PhoneOptions phone = phone_of(i);
    all[i] = run_harshly(options, phone);
    return phone.scene + ", " + cases[i / seeds % cases.size()].name + ", seed " + std::to_string(phone.seed);
  });

  size_t missing = 0;
  for (size_t scene = 0; scene < scenes.size(); ++scene) {
    std::vector<std::vector<std::string>> rows;
    for (size_t c = 0; c < cases.size(); ++c) {
      std::vector<HarshRun> runs;
      for (size_t seed = 0; seed < seeds; ++seed) {
        const size_t i = (scene * cases.size() + c) * seeds + seed;
        if (done[i]) runs.push_back(std::move(all[i]));
      }
      missing += seeds - runs.size();
      if (!runs.empty()) rows.push_back(harsh_cells(cases[c].name, runs));
    }
    print_line(scenes[scene] + ":");
    print_table({"cause", "ratio", "10 %", "px", "life", "points", "tracked %", "worst", "ATE %", "maps"}, rows);
    print_line("");
  }
  print_line(
      "ratio: inliers of the points attempted in a tracked frame, median and worst tenth; px: residual, rms, median of "
      "the runs;\nlife: keyframes that measure a point, median; points: attempted, worst tenth; tracked, ATE: medians "
      "of the runs; maps: runs that have one.");
  if (missing > 0) print_error(interruption() + format(": %zu of %zu runs are missing", missing, count));
  return missing == 0;
}

}  // namespace pptam::laboratory
