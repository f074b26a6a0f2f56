#include "sim_phone/laboratory/reach_study.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>

#include "platform/input_error.h"
#include "platform/run/console.h"
#include "platform/run/evaluation.h"
#include "platform/run/interruption.h"
#include "platform/run/jobs.h"
#include "platform/run/statistics.h"
#include "platform/text.h"
#include "sim_phone/hand.h"
#include "sim_phone/laboratory/keeping_camera.h"
#include "sim_phone/sensor.h"

namespace pptam::laboratory {
namespace {

using namespace platform;

constexpr double kMapping_s = 6;  // of a start, until the map is made and has grown a little
constexpr int kTurnDirections = 4;
// A pose is right within this share of the distance to the scene and so many degrees. A relocalised pose is a tracked
// one: it is a hundred times better or it is another place.
constexpr double kRightShare = 0.05, kRightDegrees = 3;
constexpr double kWantedShare = 0.9;
const std::vector<Displacement> kReachPlaces = {{0, 0},    {10, 0},  {15, 0},  {20, 0},    {25, 0},   {30, 0},
                                                {0, 0.15}, {0, 0.3}, {0, 0.4}, {10, 0.15}, {20, 0.3}, {0, -0.3}};

// The map that a start makes, and where its last view was.
struct Mapped {
  std::shared_ptr<const sim::Scene> scene;
  CameraInfo camera;
  std::vector<std::byte> map;
  platform::Similarity to_truth;
  Eigen::Isometry3d last_view = Eigen::Isometry3d::Identity();  // T_wc
  double distance = 0;                                          // from it to the scene, along the axis
};

bool make_map(const sim::PhoneOptions& phone, const RunOptions& options, Mapped* mapped) {
  mapped->scene = std::make_shared<const sim::Scene>(sim::make_scene(phone));
  const std::unique_ptr<platform::Camera> camera = sim::make_phone_camera(phone, mapped->scene);
  mapped->camera = camera->info();
  RunOptions saving = options;
  saving.save_map = true;
  const RunLog log = run_sequence(
      *camera, saving, [](const CameraInfo&) {}, nullptr);
  const Trajectory estimate = log.trajectory(), truth = camera->ground_truth();
  if (log.saved_map.empty() || estimate.size() < kFewPoses) return false;
  const Evaluation evaluation = evaluate(estimate, truth, "run", "ground truth");
  if (evaluation.wrong_poses > 0) return false;
  mapped->map = log.saved_map;
  // By the last pose's orientation: positions nearly in a line say little of the rotation between the worlds.
  const AssociatedPose& last = evaluation.poses.back();
  mapped->to_truth.scale = evaluation.alignment.scale;
  mapped->to_truth.R = last.truth_T_wc.linear() * last.T_wc.linear().transpose();
  mapped->to_truth.t =
      last.truth_T_wc.translation() - mapped->to_truth.scale * (mapped->to_truth.R * last.T_wc.translation());
  mapped->last_view = truth.back().T_wc;
  std::vector<double> depths;
  for (const MapPointInfo& point : log.map_points) {
    const double z = (mapped->last_view.inverse() * (mapped->to_truth * point.p_w.cast<double>())).z();
    if (z > 0) depths.push_back(z);
  }
  mapped->distance = percentile(depths, 0.5);
  return true;
}

void attempt(const Mapped& mapped, const sim::PhoneOptions& phone, const RunOptions& options,
             const Eigen::Isometry3d& T_wc, ReachCount* count) {
  const sim::Unrest unrest(phone.seed + 77, 1);
  sim::SensorOptions sensor_options;
  sensor_options.model = mapped.camera.model;
  sensor_options.shutter = mapped.camera.shutter;
  sensor_options.exposure_s = phone.exposure_s;
  sensor_options.noise = phone.noise;
  sensor_options.seed = phone.seed + 77;
  const sim::MotionCurve curve = [&](double t_s) { return unrest.applied(T_wc, t_s, 1); };
  sim::Sensor sensor(*mapped.scene, curve, sensor_options);
  RunOptions looking = options;
  looking.lock_map = true;
  const Session session = make_session(mapped.camera, looking);
  if (!session.system->load_map(mapped.map).ok()) throw InputError("the study's map cannot be loaded");
  std::vector<uint8_t> pixels(static_cast<size_t>(phone.width) * static_cast<size_t>(phone.height));
  ++count->attempts;
  for (int i = 0; i < kReachFrames; ++i) {
    const double t_s = i / phone.frames_per_s;
    sensor.expose(t_s, static_cast<uint64_t>(i), pixels.data());
    const TrackResult result = session.system->track(
        {pixels.data(), phone.width, phone.height, phone.width, PixelFormat::kGrey, std::llround(1e9 * t_s)});
    if (!result.pose_valid) continue;
    const Eigen::Isometry3d found = camera_to_world(result.T_cw), truth = curve(t_s);
    const double off = (mapped.to_truth * found.translation() - truth.translation()).norm();
    const double turned =
        Eigen::AngleAxisd(truth.linear().transpose() * mapped.to_truth.R * found.linear()).angle() / sim::kDegree;
    if (off < kRightShare * mapped.distance && turned < kRightDegrees) {
      ++count->found;
      count->frames += i + 1;
    } else {
      ++count->wrong;
    }
    return;
  }
}

}  // namespace

std::vector<ReachCount> measure_reach(const sim::PhoneOptions& asked, const RunOptions& options,
                                      const std::vector<Displacement>& places, int directions) {
  sim::PhoneOptions phone = asked;
  phone.motion = "start";
  phone.duration_s = kMapping_s;
  Mapped mapped;
  std::vector<ReachCount> counts;
  if (!make_map(phone, options, &mapped)) return counts;
  counts.reserve(places.size());
  for (const Displacement& place : places) {
    ReachCount count;
    count.at = place;
    for (int k = 0; k < directions; ++k) {
      const double angle = 2 * std::numbers::pi * (k + 0.25) / directions;
      Eigen::Isometry3d T_wc = mapped.last_view;
      T_wc.translate(Eigen::Vector3d(0, 0, place.nearer * mapped.distance));
      T_wc.rotate(
          Eigen::AngleAxisd(place.turned_degrees * sim::kDegree, Eigen::Vector3d(std::cos(angle), std::sin(angle), 0)));
      attempt(mapped, phone, options, T_wc, &count);
    }
    if (count.found > 0) count.frames /= count.found;
    counts.push_back(count);
  }
  return counts;
}

bool run_reach_study(const ReachStudyOptions& options) {
  std::vector<std::string> scenes = options.scenes;
  if (scenes.empty()) scenes = {"desk", "boxes", "clutter"};
  const auto seeds = static_cast<size_t>(options.seeds);
  for (const std::string& scene : scenes) {
    sim::PhoneOptions phone = options.phone;
    phone.scene = scene;
    sim::check_phone_options(phone);
  }
  stop_on_signals();
  std::vector<std::vector<ReachCount>> all(scenes.size() * seeds);
  const std::vector<bool> done = run_jobs(options.jobs, all.size(), [&](size_t i) {
    sim::PhoneOptions phone = options.phone;
    phone.scene = scenes[i / seeds];
    phone.seed = 1 + i % seeds;
    all[i] = measure_reach(phone, options.run, kReachPlaces, kTurnDirections);
    return phone.scene + ", seed " + std::to_string(phone.seed) + (all[i].empty() ? ": no map" : "");
  });
  std::vector<std::vector<std::string>> rows;
  bool met = true;
  for (size_t p = 0; p < kReachPlaces.size(); ++p) {
    std::vector<std::string> row = {format("%g degrees", kReachPlaces[p].turned_degrees),
                                    format("%g %%", 100 * kReachPlaces[p].nearer)};
    ReachCount sum;
    for (size_t s = 0; s < scenes.size(); ++s) {
      int attempts = 0, found = 0;
      for (size_t i = s * seeds; i < (s + 1) * seeds; ++i) {
        if (!done[i] || all[i].empty()) continue;
        const ReachCount& count = all[i][p];
        attempts += count.attempts;
        found += count.found;
        sum.wrong += count.wrong;
        sum.frames += count.frames * count.found;
      }
      sum.attempts += attempts;
      sum.found += found;
      row.push_back(format("%d of %d", found, attempts));
    }
    const bool asked =
        (kReachPlaces[p].turned_degrees <= 20 && kReachPlaces[p].nearer == 0) ||
        (kReachPlaces[p].turned_degrees == 0 && kReachPlaces[p].nearer >= 0 && kReachPlaces[p].nearer <= 0.3);
    met = met && sum.attempts > 0 && sum.wrong == 0 && (!asked || sum.found >= kWantedShare * sum.attempts);
    row.push_back(format("%d", sum.wrong));
    row.push_back(sum.found > 0 ? format("%.1f", sum.frames / sum.found) : "-");
    rows.push_back(row);
  }
  std::vector<std::string> head = {"turned", "nearer"};
  head.insert(head.end(), scenes.begin(), scenes.end());
  head.insert(head.end(), {"wrong", "frames"});
  print_table(head, rows);
  print_line(
      format("\nfound: of places seen for %d frames each, from a map of one place; frames: until then, mean. "
             "Goals: 90 %% up to 20 degrees and up to\n30 %% nearer, nothing wrong.",
             kReachFrames));
  size_t missing = 0, without = 0;
  for (size_t i = 0; i < all.size(); ++i) {
    missing += !done[i];
    without += done[i] && all[i].empty();
  }
  if (without > 0) print_line(format("%zu runs made no right map and are not counted", without));
  print_line(met ? "the goals are met" : "the goals are NOT met");
  if (missing > 0) print_error(interruption() + format(": %zu of %zu runs are missing", missing, all.size()));
  return met && missing == 0;
}

}  // namespace pptam::laboratory
