#include "mapping/initial_map.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

namespace pptam {

namespace {

constexpr int kBundleIterations = 30;
constexpr int kLocatingPoints = 40;                       // of each view's pose, before bundle adjustment
constexpr float kInitialVelocitySigmaTranslation = 0.1f;  // depths/s, of the velocity during an initial view's readout
constexpr float kInitialVelocitySigmaRotation = 0.15f;    // radians/s
constexpr float kMaxInitialSigma = 1.0f;                  // 2 px: a right map fits to under 1 px
constexpr int kMaxPlanePoints = 512;
constexpr int kPlaneTrials = 100;

}  // namespace

InitialMap::InitialMap(Arena& arena, const Config& config, Map& map, WorkMeter& meter, Background& background,
                       BundleAdjuster& bundle, KeyframePose& pose)
    : config_(config),
      map_(map),
      meter_(meter),
      background_(background),
      bundle_(bundle),
      pose_(pose),
      points_(arena, std::min(config.max_map_points, kMaxPlanePoints)) {}

Task<bool> InitialMap::finish() {
  bool good = co_await locate_views();
  for (int round = 0; good && round < 2; ++round) {  // again without the outliers of the first
    co_await measure_velocities();
    co_await bundle_.run(-1, true, kBundleIterations);
  }
  good = good && !(bundle_.result().sigma > kMaxInitialSigma) && map_.point_count() >= kMinInitialPoints;
  if (good) good = co_await align_to_dominant_plane();
  co_return good;
}

// Poses of the views between the first and the last, backwards, each starting at its successor's.
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

// The velocities in the initial keyframes from the poses of the frames next to them [phone 6]: central differences. At
// either end, where only one side is known, its mean velocity is carried on to the keyframe by the difference to the
// next keyframe's.
Task<> InitialMap::measure_velocities() {
  if (config_.camera.shutter.line_time_s == 0) co_return;
  const int count = std::min(map_.keyframes().size(), kMaxInitialKeyframes);
  Vector6f mean[kMaxInitialKeyframes];
  float mean_s[kMaxInitialKeyframes];  // the time of which it is the mean, from the first keyframe's
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

Vector3f InitialMap::p_1(int i) const {
  return map_.keyframes()[0].T_kw * map_.points()[points_[i]].p_w;
}

Task<bool> InitialMap::align_to_dominant_plane() {
  const float threshold = 0.02f * map_.keyframes()[0].mean_depth;
  points_.clear();
  for (int i = 0; i < map_.points().size(); ++i)
    if (map_.points()[i].id != 0) points_.push_back(static_cast<int16_t>(i));
  Plane plane = co_await sample_planes(threshold);
  if (plane.found) plane = co_await refine(plane, threshold);
  co_return plane.found&& lay_on(plane, threshold);
}

// The plane to which the points are nearest, of those through three of them: by a fixed sequence, so that every run and
// every target finds the same.
Task<InitialMap::Plane> InitialMap::sample_planes(float threshold) {
  const float depth = map_.keyframes()[0].mean_depth;
  const int count = points_.size();
  uint32_t state = 12345;
  const auto next = [&state](int n) {
    state = state * 1664525u + 1013904223u;
    return static_cast<int>((state >> 8) % static_cast<uint32_t>(n));
  };
  Plane best;
  float best_cost = 1e30f;
  for (int trial = 0; trial < kPlaneTrials; ++trial) {
    const int i = next(count);
    const int j = next(count);
    const int k = next(count);
    co_await background_.spend(Work::kOther, 75LL * count);
    const Vector3f cross = (p_1(j) - p_1(i)).cross(p_1(k) - p_1(i));
    if (!(cross.norm() > 1e-3f * depth * depth)) continue;
    const Vector3f n = cross.normalized();
    const float d = n.dot(p_1(i));
    float cost = 0;
    for (int m = 0; m < count; ++m) cost += std::min(std::abs(n.dot(p_1(m)) - d), threshold);
    if (cost < best_cost) {
      best_cost = cost;
      best = {n, d, true};
    }
  }
  co_return best;
}

// Least squares over the inliers.
Task<InitialMap::Plane> InitialMap::refine(Plane plane, float threshold) {
  const int count = points_.size();
  plane.found = false;
  for (int round = 0; round < 3; ++round) {
    Vector3f mean = Vector3f::Zero();
    int inliers = 0;
    for (int m = 0; m < count; ++m) {
      if (std::abs(plane.normal.dot(p_1(m)) - plane.offset) > threshold) continue;
      mean += p_1(m);
      ++inliers;
    }
    if (inliers < 6) co_return plane;
    mean /= static_cast<float>(inliers);
    Matrix3f scatter = Matrix3f::Zero();
    for (int m = 0; m < count; ++m) {
      const Vector3f p = p_1(m);
      if (std::abs(plane.normal.dot(p) - plane.offset) > threshold) continue;
      scatter += (p - mean) * (p - mean).transpose();
    }
    const Eigen::SelfAdjointEigenSolver<Matrix3f> solver(scatter);
    if (solver.info() != Eigen::Success) co_return plane;
    plane.normal = solver.eigenvectors().col(0);
    plane.offset = plane.normal.dot(mean);
    co_await background_.spend(Work::kOther, 250LL * count);
  }
  if (plane.offset < 0) {
    plane.normal = -plane.normal;
    plane.offset = -plane.offset;
  }
  plane.found = true;
  co_return plane;
}

// The plane to z = 0 with z towards the camera, origin where the first keyframe's axis meets it, x along the first
// camera's x; the first view is Config::initial_plane_distance away from the plane, or the initial views reach
// Config::initial_baseline from the first [ptam 6.1]. False when the axis does not meet the plane.
bool InitialMap::lay_on(const Plane& plane, float threshold) {
  const SE3 T_1w = map_.keyframes()[0].T_kw;
  // Up is from the plane to the camera, which sits at the origin of its own frame.
  const Vector3f z = -plane.normal;
  if (!(plane.normal.z() > 0.05f)) return false;
  const Vector3f origin = Vector3f::UnitZ() * (plane.offset / plane.normal.z());
  const Vector3f x = (Vector3f::UnitX() - z * z.x()).normalized();
  const Vector3f y = z.cross(x);
  Matrix3f R;  // first camera to world
  R.row(0) = x.transpose();
  R.row(1) = y.transpose();
  R.row(2) = z.transpose();
  float baseline = 0;  // of the initial views, the longest from the first
  for (const Keyframe& keyframe : map_.keyframes())
    baseline = std::max(baseline, (keyframe.T_kw.centre() - T_1w.centre()).norm());
  if (!(baseline > 1e-6f) || !R.allFinite()) return false;
  Similarity S;
  S.T = SE3(R, -(R * origin)) * T_1w;
  S.scale = config_.initial_plane_distance > 0 ? config_.initial_plane_distance / plane.offset
                                               : config_.initial_baseline / baseline;
  map_.apply(S);
  // Patches on the plane get its normal; it is known much better now than from the homography.
  for (const int16_t i : points_) {
    const MapPoint& point = map_.points()[i];
    if (std::abs(point.p_w.z()) < threshold * S.scale)
      map_.set_normal(i, map_.keyframes()[point.source.keyframe].T_kw.R.col(2));
  }
  meter_.charge(Work::kOther, 60LL * map_.points().size() + 500LL * map_.keyframes().size());
  return true;
}

}  // namespace pptam
