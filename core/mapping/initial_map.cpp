#include "mapping/initial_map.h"

#include <algorithm>
#include <cmath>

namespace pptam {

namespace {

// Accepted steps of one adjustment at most: more than later, since the start is further away from the minimum and the
// map is shown afterwards. Not swept.
constexpr int kInitialIterations = 30;
constexpr int kBundleRounds = 2;  // adjustments: the second without the outliers of the first
// Points for the pose of a view, or of a frame next to a view: bounds its time. Not swept.
constexpr int kLocatingPoints = 40;
// Prior of the velocity during an initial view's readout, whose mean is 0: 1-sigma of each component, in depths/s and
// radians/s. Not swept.
constexpr float kInitialVelocitySigmaTranslation = 0.1f;
constexpr float kInitialVelocitySigmaRotation = 0.15f;
// Robust scale of a map that is accepted, units of a measurement's sigma (2 px): a right map fits to under half of it.
// Not swept.
constexpr float kMaxInitialSigma = 1.0f;

}  // namespace

InitialMap::InitialMap(const Config& config, Map& map, Background& background, BundleAdjuster& bundle,
                       KeyframePose& pose, Ground& ground)
    : config_(config), map_(map), background_(background), bundle_(bundle), pose_(pose), ground_(ground) {}

Task<bool> InitialMap::finish() {
  bool good = co_await locate_views();
  for (int round = 0; good && round < kBundleRounds; ++round) {
    co_await measure_velocities();
    co_await bundle_.run(-1, true, kInitialIterations);
  }
  good = good && !(bundle_.result().sigma > kMaxInitialSigma) && map_.point_count() >= kMinInitialPoints;
  if (good) good = co_await ground_.align_new_map();
  co_return good;
}

// Finds the poses of the views between the first and the last, in descending order: each starts at the next view's
// pose.
Task<bool> InitialMap::locate_views() {
  const int count = map_.keyframes().size();
  for (int k = count - 2; k > 0; --k) {
    co_await pose_.gather(k, kLocatingPoints);
    VelocityPrior prior;
    prior.sigma_translation = kInitialVelocitySigmaTranslation * map_.keyframes()[k].mean_depth;
    prior.sigma_rotation = kInitialVelocitySigmaRotation;
    const PoseUpdate update = co_await pose_.find(map_.keyframes()[k + 1].T_kw, prior);
    if (!update.ok || !(update.sigma < kMaxInitialSigma)) co_return false;
    map_.move_keyframe(k, update.T_cw);
    map_.set_velocity(k, update.velocity);
  }
  co_return true;
}

// Velocities of the initial keyframes by central differences of the poses of the frames next to them [phone 6]. Where
// only one of these frames is known, as at either end, the difference is the velocity at another time than the
// keyframe's. It is extrapolated to the keyframe's time with the difference to the neighbouring keyframe's velocity.
Task<> InitialMap::measure_velocities() {
  if (config_.camera.shutter.line_time_s == 0) co_return;
  const int count = std::min(map_.keyframes().size(), kMaxInitialKeyframes);
  Vector6f mean[kMaxInitialKeyframes];
  float mean_s[kMaxInitialKeyframes];  // middle of the interval of each mean, seconds after the first keyframe
  const int64_t start_ns = map_.keyframes()[0].timestamp_ns;
  for (int k = 0; k < count; ++k) {
    const Keyframe& keyframe = map_.keyframes()[k];
    SE3 T_first = keyframe.T_kw, T_last = keyframe.T_kw;
    int64_t first_ns = keyframe.timestamp_ns, last_ns = keyframe.timestamp_ns;
    for (const NeighbourFrame& neighbour : map_.neighbours()) {
      if (neighbour.keyframe != k) continue;
      pose_.gather(neighbour, kLocatingPoints);
      const float dt_s = static_cast<float>(neighbour.timestamp_ns - keyframe.timestamp_ns) * 1e-9f;
      const PoseUpdate update = co_await pose_.find(pose_at(keyframe.T_kw, keyframe.velocity, dt_s),
                                                    pose_.prior_of(keyframe, keyframe.velocity));
      if (update.ok && dt_s < 0) {
        T_first = update.T_cw;
        first_ns = neighbour.timestamp_ns;
      } else if (update.ok) {
        T_last = update.T_cw;
        last_ns = neighbour.timestamp_ns;
      }
    }
    const float dt_s = static_cast<float>(last_ns - first_ns) * 1e-9f;
    mean[k] = dt_s > 0 ? Vector6f((T_last * T_first.inverse()).log() / dt_s) : keyframe.velocity;
    mean_s[k] = static_cast<float>(first_ns - start_ns) * 1e-9f + 0.5f * dt_s;
  }
  for (int k = 0; k < count; ++k) {
    const Keyframe& keyframe = map_.keyframes()[k];
    const int other = k > 0 ? k - 1 : std::min(1, count - 1);
    const float late_s = static_cast<float>(keyframe.timestamp_ns - start_ns) * 1e-9f - mean_s[k];
    const float apart_s = mean_s[other] - mean_s[k];
    const float share = std::abs(apart_s) > std::abs(late_s) ? late_s / apart_s : 0;
    const Vector6f velocity = mean[k] + share * (mean[other] - mean[k]);
    map_.set_velocity(k, velocity);
    map_.set_velocity_prior(k, velocity);
  }
}

}  // namespace pptam
