#include "sim_phone/laboratory/stretch_study.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <map>
#include <optional>
#include <utility>

#include "platform/input_error.h"
#include "platform/run/console.h"
#include "platform/run/evaluation.h"
#include "platform/run/interruption.h"
#include "platform/run/jobs.h"
#include "platform/run/statistics.h"
#include "platform/text.h"
#include "sim_phone/hand.h"
#include "sim_phone/laboratory/keeping_camera.h"
#include "sim_phone/random.h"

namespace pptam::laboratory {
namespace {

using namespace platform;

constexpr double kStretch_s = 2, kSettle_s = 1;    // how long it lasts; what follows it and is not judged
constexpr double kEarliest_s = 9, kLatest_s = 13;  // when it begins: the map is finished
constexpr double kMaxScaleChange_percent = 1;      // wanted
constexpr int kSettledMeasurements = 3;            // of a point that tells the map's scale
constexpr uint64_t kForeignSeed = 1000;            // added, for the other scene's frames
constexpr std::array kStretches = {"none", "shuffled", "shifted", "zoomed", "frozen", "backwards", "foreign"};
// In the same order.
enum Stretch : uint8_t { kNothing, kShuffled, kShifted, kZoomed, kFrozen, kBackwards, kForeign };

using Pixels = std::vector<uint8_t>;

size_t index_of(const Frame& frame, int x, int y) {
  return static_cast<size_t>(y) * static_cast<size_t>(frame.stride_bytes) + static_cast<size_t>(x);
}

// Shifted round the edges, as by a stabiliser that jumps.
Pixels shifted(const Pixels& from, const Frame& frame, int dx, int dy) {
  Pixels pixels(from.size());
  for (int y = 0; y < frame.height; ++y) {
    const int from_y = (y + dy + frame.height) % frame.height;
    for (int x = 0; x < frame.width; ++x) {
      const int from_x = (x + dx + frame.width) % frame.width;
      pixels[index_of(frame, x, y)] = from[index_of(frame, from_x, from_y)];
    }
  }
  return pixels;
}

// Magnified about its middle.
Pixels zoomed(const Pixels& from, const Frame& frame, double factor) {
  Pixels pixels(from.size());
  const double middle_x = 0.5 * (frame.width - 1), middle_y = 0.5 * (frame.height - 1);
  for (int y = 0; y < frame.height; ++y) {
    for (int x = 0; x < frame.width; ++x) {
      const double u = middle_x + (x - middle_x) / factor, v = middle_y + (y - middle_y) / factor;
      const int x0 = std::clamp(static_cast<int>(u), 0, frame.width - 2);
      const int y0 = std::clamp(static_cast<int>(v), 0, frame.height - 2);
      const auto at = [&](int dx, int dy) { return static_cast<double>(from[index_of(frame, x0 + dx, y0 + dy)]); };
      const double a = u - x0, b = v - y0;
      const double grey = (1 - b) * ((1 - a) * at(0, 0) + a * at(1, 0)) + b * ((1 - a) * at(0, 1) + a * at(1, 1));
      pixels[index_of(frame, x, y)] = static_cast<uint8_t>(std::lround(std::clamp(grey, 0.0, 255.0)));
    }
  }
  return pixels;
}

// Change of the map's scale in percent: of the distances of the points that are in both from their middle. NaN when
// there are too few.
double scale_change_percent(const std::vector<MapPointInfo>& before, const std::vector<MapPointInfo>& after) {
  constexpr size_t kEnough = 20;
  std::map<uint32_t, Eigen::Vector3d> later;
  for (const MapPointInfo& point : after) later[point.id] = point.p_w.cast<double>();
  std::vector<Eigen::Vector3d> a, b;
  for (const MapPointInfo& point : before) {
    const auto found = later.find(point.id);
    if (found == later.end() || point.measurements < kSettledMeasurements) continue;
    a.push_back(point.p_w.cast<double>());
    b.push_back(found->second);
  }
  if (a.size() < kEnough) return kNone;
  const auto middle = [](const std::vector<Eigen::Vector3d>& points) {
    Eigen::Vector3d m;
    for (int i = 0; i < 3; ++i) {
      std::vector<double> values(points.size());
      for (size_t k = 0; k < points.size(); ++k) values[k] = points[k][i];
      m[i] = percentile(values, 0.5);
    }
    return m;
  };
  const Eigen::Vector3d middle_a = middle(a), middle_b = middle(b);
  std::vector<double> ratios;
  for (size_t i = 0; i < a.size(); ++i) ratios.push_back((b[i] - middle_b).norm() / (a[i] - middle_a).norm());
  return 100 * (percentile(ratios, 0.5) - 1);
}

// Frames [from, to) are spoiled; their times stay. foreign: only for kForeign.
void spoil(Stretch kind, size_t from, size_t to, KeepingCamera* foreign, sim::Random* random, KeepingCamera* camera) {
  std::vector<Pixels> good;
  for (size_t i = from; i < to; ++i) good.push_back(camera->pixels(i));
  std::vector<size_t> order(good.size());
  for (size_t i = 0; i < order.size(); ++i) order[i] = i;
  for (size_t i = order.size(); i > 1; --i) {
    std::swap(order[i - 1], order[static_cast<size_t>(random->integer(0, static_cast<int>(i) - 1))]);
  }
  const int width = camera->info().model.width, height = camera->info().model.height;
  const int dx = random->integer(-width / 3, width / 3), dy = random->integer(-height / 3, height / 3);
  const double zoom = random->uniform(1.15, 2);
  const double ramp_s = random->uniform(0, 1);  // of the shift or zoom, until it is whole
  for (size_t i = 0; i < good.size(); ++i) {
    const Frame& frame = camera->frame(from + i);
    Pixels& pixels = camera->pixels(from + i);
    const double since_s = 1e-9 * static_cast<double>(frame.timestamp_ns - camera->frame(from).timestamp_ns);
    const double share = since_s < ramp_s ? since_s / ramp_s : 1;
    switch (kind) {
      case kNothing:
        break;
      case kShuffled:
        pixels = good[order[i]];
        break;
      case kShifted:
        pixels = shifted(good[i], frame, static_cast<int>(share * dx), static_cast<int>(share * dy));
        break;
      case kZoomed:
        pixels = zoomed(good[i], frame, std::pow(zoom, share));
        break;
      case kFrozen:
        pixels = good.front();
        break;
      case kBackwards:
        pixels = good[good.size() - 1 - i];
        break;
      case kForeign:
        pixels = foreign->pixels(std::min(from + i, foreign->count() - 1));
        break;
    }
  }
}

void judge_after(const RunLog& log, const platform::Trajectory& truth, double from_s, double to_s, StretchRun* run) {
  platform::Trajectory before, after;
  for (const auto& pose : log.trajectory()) {
    const double t_s = 1e-9 * static_cast<double>(pose.timestamp_ns);
    if (t_s < from_s) before.push_back(pose);
    if (t_s > to_s + kSettle_s) after.push_back(pose);
  }
  int frames_after = 0;
  for (const FrameLog& frame : log.frames) {
    frames_after += 1e-9 * static_cast<double>(frame.timestamp_ns) > to_s + kSettle_s;
  }
  run->tracked_percent = 100.0 * static_cast<double>(after.size()) / std::max(1, frames_after);
  Evaluation known;
  try {
    known = evaluate(before, truth, "run", "ground truth");
    run->begun = true;
  } catch (const platform::InputError&) {  // no map before
  }
  if (!run->begun) return;
  size_t next = 0;
  for (const FrameLog& frame : log.frames) {
    const double t_s = 1e-9 * static_cast<double>(frame.timestamp_ns);
    while (next < truth.size() && truth[next].timestamp_ns < frame.timestamp_ns) ++next;
    if (t_s <= to_s + kSettle_s || !frame.pose_valid || frame.quality != TrackingQuality::kGood) continue;
    if (next == truth.size() || truth[next].timestamp_ns != frame.timestamp_ns) continue;
    const double error = (known.alignment * frame.T_wc.translation() - truth[next].T_wc.translation()).norm();
    const double turned =
        Eigen::AngleAxisd(truth[next].T_wc.linear().transpose() * known.alignment.R * frame.T_wc.linear()).angle() /
        sim::kDegree;
    ++run->judged;
    run->wrong_good += error > kWrongExtentFraction * known.extent || turned > kWrongRotationDeg;
    run->largest_percent = std::fmax(run->largest_percent, 100 * error / known.extent);
  }
}

}  // namespace

StretchRun::StretchRun() : scale_percent(kNone), largest_percent(kNone) {}

std::vector<std::string> stretch_kinds() {
  return {kStretches.begin(), kStretches.end()};
}

StretchRun run_stretch(const sim::PhoneOptions& phone, const RunOptions& options, const std::string& kind_name) {
  const auto found = std::find(kStretches.begin(), kStretches.end(), kind_name);
  if (found == kStretches.end()) throw platform::InputError("there is no stretch named " + kind_name);
  if (phone.duration_s < kMinStretchRun_s)
    throw platform::InputError(format("a run with a bad stretch takes %g s or more", kMinStretchRun_s));
  const auto kind = static_cast<Stretch>(found - kStretches.begin());
  sim::Random random(phone.seed, 90 + kind);
  KeepingCamera camera(sim::make_phone_camera(phone));
  const platform::Trajectory truth = camera.ground_truth();
  camera.keep_all();
  std::optional<KeepingCamera> foreign;
  if (kind == kForeign) {
    sim::PhoneOptions other = phone;
    other.seed += kForeignSeed;
    other.scene = phone.scene == "boxes" ? "desk" : "boxes";
    foreign.emplace(sim::make_phone_camera(other));
    foreign->keep_all();
  }
  const double begin_s = random.uniform(kEarliest_s, kLatest_s);
  const auto seconds = [&](size_t i) { return 1e-9 * static_cast<double>(camera.frame(i).timestamp_ns); };
  const auto index_at = [&](double t_s) {
    size_t i = 0;
    while (i + 1 < camera.count() && seconds(i) - seconds(0) < t_s) ++i;
    return i;
  };
  const size_t from = index_at(begin_s), to = index_at(begin_s + kStretch_s);
  const double from_s = seconds(from), to_s = seconds(to - 1);
  // The same bits up to there.
  const auto ignore = [](const platform::CameraInfo&) {};
  camera.again(from);
  const RunLog until = run_sequence(camera, options, ignore, nullptr);
  spoil(kind, from, to, foreign ? &*foreign : nullptr, &random, &camera);
  camera.again();
  const RunLog log = run_sequence(camera, options, ignore, nullptr);
  StretchRun run;
  run.name = phone.scene + ", " + kind_name + ", seed " + std::to_string(phone.seed);
  judge_after(log, truth, from_s, to_s, &run);
  for (const FrameLog& frame : log.frames) {
    const double t_s = 1e-9 * static_cast<double>(frame.timestamp_ns);
    run.misfits_before += frame.misfit && t_s < from_s;
    run.misfits_within += frame.misfit && t_s >= from_s && t_s <= to_s;
  }
  if (run.begun) run.scale_percent = scale_change_percent(until.map_points, log.map_points);
  return run;
}

bool run_stretch_study(const StretchStudyOptions& options) {
  std::vector<std::string> scenes = options.scenes;
  if (scenes.empty()) scenes = {"desk", "boxes", "walls"};
  const auto seeds = static_cast<size_t>(options.seeds);
  for (const std::string& scene : scenes) {
    sim::PhoneOptions phone = options.phone;
    phone.scene = scene;
    sim::check_phone_options(phone);
    if (phone.duration_s < kMinStretchRun_s)
      throw platform::InputError(
          format("--study stretches: give it %g seconds or more (--duration)", kMinStretchRun_s));
  }
  stop_on_signals();
  std::vector<StretchRun> all(scenes.size() * kStretches.size() * seeds);
  const std::vector<bool> done = run_jobs(options.jobs, all.size(), [&](size_t i) {
    sim::PhoneOptions phone = options.phone;
    phone.scene = scenes[i / seeds / kStretches.size()];
    phone.seed = 1 + i % seeds;
    all[i] = run_stretch(phone, options.run, kStretches[i / seeds % kStretches.size()]);
    return all[i].name;
  });

  const auto cell = [](const char* pattern, double value) {
    return std::isnan(value) ? std::string("-") : format(pattern, value);
  };
  std::vector<std::vector<std::string>> rows;
  size_t missing = 0;
  int scale_missed = 0, wrong_runs = 0, not_begun = 0;
  for (size_t i = 0; i < all.size(); ++i) {
    missing += !done[i];
    const StretchRun& run = all[i];
    not_begun += done[i] && !run.begun;
    if (!done[i] || i / seeds % kStretches.size() == kNothing || !run.begun) continue;
    scale_missed += !(std::abs(run.scale_percent) <= kMaxScaleChange_percent);  // no map is left: likewise
    wrong_runs += run.wrong_good > 0;
    if (std::abs(run.scale_percent) > kMaxScaleChange_percent || run.wrong_good > 0 || std::isnan(run.scale_percent)) {
      rows.push_back({run.name, cell("%+.2f", run.scale_percent), format("%d of %d", run.wrong_good, run.judged),
                      format("%.0f", run.tracked_percent), cell("%.1f", run.largest_percent)});
    }
  }
  if (!rows.empty()) {
    print_line("Runs that miss a goal, or have no pose afterwards:");
    print_table({"run", "scale %", "wrong as good", "tracked %", "largest %"}, rows);
    print_line("");
  }
  std::vector<std::vector<std::string>> kinds;
  for (size_t kind = 0; kind < kStretches.size(); ++kind) {
    std::vector<double> scales, tracked, largest;
    int runs = 0, wrong = 0, judged = 0;
    for (size_t i = 0; i < all.size(); ++i) {
      if (!done[i] || i / seeds % kStretches.size() != kind || !all[i].begun) continue;
      ++runs;
      if (!std::isnan(all[i].scale_percent)) scales.push_back(std::abs(all[i].scale_percent));
      tracked.push_back(all[i].tracked_percent);
      if (!std::isnan(all[i].largest_percent)) largest.push_back(all[i].largest_percent);
      wrong += all[i].wrong_good;
      judged += all[i].judged;
    }
    kinds.push_back({kStretches[kind], format("%d", runs), cell("%.2f", percentile(scales, 0.5)),
                     cell("%.2f", percentile(scales, 1)), format("%d of %d", wrong, judged),
                     cell("%.1f", percentile(tracked, 0.5)), cell("%.0f", percentile(tracked, 0)),
                     cell("%.1f", percentile(largest, 0.5)), cell("%.1f", percentile(largest, 1))});
  }
  print_table({"stretch", "runs", "scale %", "worst", "wrong as good", "tracked %", "worst", "largest %", "worst"},
              kinds);
  const bool met = scale_missed == 0 && wrong_runs == 0 && not_begun == 0;
  print_line(
      format("\nscale: change of the map's scale, median and worst of the runs; from %g s after the stretch: wrong as "
             "good: poses;\ntracked: frames; largest: error of a good pose, in percent of the extent. Goals: "
             "the scale changes by at most %g %%, nothing wrong is good.",
             kSettle_s, kMaxScaleChange_percent));
  print_line(met ? "the goals are met"
                 : format("the goals are NOT met: the scale in %d runs, wrong poses in %d; %d runs had no map before",
                          scale_missed, wrong_runs, not_begun));
  if (missing > 0) print_error(interruption() + format(": %zu of %zu runs are missing", missing, all.size()));
  return met && missing == 0;
}

}  // namespace pptam::laboratory
