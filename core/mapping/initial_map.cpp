#include "mapping/initial_map.h"

#include <Eigen/Eigenvalues>
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

// The plane of the world's z = 0.
// Points among which the plane is sought: more than an initial map has. Bounds the memory.
constexpr int kMaxPlanePoints = 512;
constexpr int kPlaneTrials = 100;    // planes through three points that are tried; not swept
constexpr int kRefineRounds = 3;     // least-squares fits, each to the inliers of the one before; not swept
constexpr int kMinPlaneInliers = 6;  // points for a fit; not swept
// Distance from the plane up to which a point lies on it, in mean depths of the first view. Not swept.
constexpr float kPlaneThreshold = 0.02f;
// Smallest cross product of two sides of a sampled triangle, in squared mean depths: less has no direction. Not swept.
constexpr float kMinTriangleCross = 1e-3f;
// A ground: how far its normal must face up in the first image, a cosine (it is seen from above by 70 degrees at most);
// the distance up to which a point lies on it, in mean depths, since such points are few and far in a new map; how far
// below it a point speaks against it, in that distance; the least share of the points that lie on it, and the largest
// of those below. In six maps of a cube on a table the table holds a fifth to a third of the points. Not swept, but for
// the distance: with 0.02 two of the six are off by over 10 degrees.
constexpr float kMinFacingUp = 0.34f, kGroundThreshold = 0.03f, kBelow = 2.0f;
constexpr float kMinGroundShare = 0.15f, kMaxBelowShare = 0.15f;
constexpr int kGroundTrials = 400;  // planes through three points that are tried; not swept
// Cosine of the angle between the first view's axis and the plane's normal: at over 87 degrees the axis hardly meets
// the plane. Not swept.
constexpr float kMinCosAxis = 0.05f;
constexpr float kMinBaseline = 1e-6f;  // of the initial views, in the start's units: guards a division
constexpr float kInfiniteCost = 1e30f;
// Fixed pseudo-random sequence of 32 bits, x <- a x + c, of which the upper 24 bits are used: the same points are
// sampled in every run and on every target.
constexpr uint32_t kSequenceStart = 12345, kSequenceFactor = 1664525u, kSequenceIncrement = 1013904223u;
constexpr int kSequenceShift = 8;

// ARMv6 instructions, estimates. The sum over a run's mapping is within 10 % of the count (tests/budget).
constexpr int64_t kTrialInstructions = 75;    // of one point in one trial
constexpr int64_t kSampleInstructions = 300;  // of three points
constexpr int64_t kRefineInstructions = 250;  // of one point in one fit
constexpr int64_t kTransformPointInstructions = 60, kTransformKeyframeInstructions = 500;

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
  for (int round = 0; good && round < kBundleRounds; ++round) {
    co_await measure_velocities();
    co_await bundle_.run(-1, true, kInitialIterations);
  }
  good = good && !(bundle_.result().sigma > kMaxInitialSigma) && map_.point_count() >= kMinInitialPoints;
  if (good) good = co_await align_to_ground();
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

Vector3f InitialMap::p_1(int i) const {
  return map_.keyframes()[0].T_kw * map_.points()[points_[i]].p_w;
}

// z = 0 is the ground: the dominant plane, unless that is an upright front and there is something for it to stand on.
Task<bool> InitialMap::align_to_ground() {
  const float depth = map_.keyframes()[0].mean_depth, threshold = kPlaneThreshold * depth;
  points_.clear();
  for (int i = 0; i < map_.points().size(); ++i)
    if (map_.points()[i].id != 0) points_.push_back(static_cast<int16_t>(i));
  Plane plane = co_await sample_dominant_plane(threshold);
  if (plane.found) plane = co_await refine(plane, threshold);
  if (plane.found && !faces_up(plane)) {
    const float coarse = kGroundThreshold * depth;
    Plane ground = co_await sample_ground(coarse);
    if (ground.found) ground = co_await refine(ground, coarse);
    const auto share = [&](float of) { return of * static_cast<float>(points_.size()); };
    const Support support = support_of(ground, coarse);
    meter_.charge(Work::kOther, kTrialInstructions * points_.size());
    if (ground.found && faces_up(ground) && ground.normal.z() > kMinCosAxis &&
        static_cast<float>(support.on) >= share(kMinGroundShare) &&
        static_cast<float>(support.below) <= share(kMaxBelowShare))
      plane = ground;
  }
  const bool aligned = plane.found && align_to(plane, threshold);
  co_return aligned;
}

// Whether the plane's upper side is seen by a camera that is held upright. A front that stands on a ground does not
// face up, unless the camera itself looks up by over 20 degrees; a ground seen from straight above does not either, and
// then there is no front.
bool InitialMap::faces_up(const Plane& plane) const {
  return plane.normal.y() > kMinFacingUp;  // from the camera to the plane: down in the image
}

InitialMap::Support InitialMap::support_of(const Plane& plane, float threshold) const {
  Support support;
  for (int m = 0; m < points_.size(); ++m) {
    const float beyond = plane.normal.dot(p_1(m)) - plane.offset;
    support.on += std::abs(beyond) < threshold;
    support.near += std::max(1.0f - std::abs(beyond) / threshold, 0.0f);
    support.below += beyond > kBelow * threshold;
  }
  return support;
}

// The next plane through three points, away from the first camera; not found where they lie nearly in a line. The
// points are chosen by a fixed sequence, so that every run and every target finds the same planes.
InitialMap::Plane InitialMap::next_plane(uint32_t* state) const {
  const float depth = map_.keyframes()[0].mean_depth;
  int chosen[3];
  for (int& i : chosen) {
    *state = *state * kSequenceFactor + kSequenceIncrement;
    i = static_cast<int>((*state >> kSequenceShift) % static_cast<uint32_t>(points_.size()));
  }
  const Vector3f p = p_1(chosen[0]);
  const Vector3f cross = (p_1(chosen[1]) - p).cross(p_1(chosen[2]) - p);
  if (!(cross.norm() > kMinTriangleCross * depth * depth)) return {};
  const Vector3f n = cross.normalized();
  const float d = n.dot(p);
  return d < 0 ? Plane{-n, -d, true} : Plane{n, d, true};
}

// Among planes through three points, the one with the lowest sum of point distances, each cut off at the threshold.
Task<InitialMap::Plane> InitialMap::sample_dominant_plane(float threshold) {
  uint32_t state = kSequenceStart;
  Plane best;
  float best_cost = kInfiniteCost;
  for (int trial = 0; trial < kPlaneTrials; ++trial) {
    co_await background_.spend(Work::kOther, kTrialInstructions * points_.size());
    const Plane plane = next_plane(&state);
    if (!plane.found) continue;
    float cost = 0;
    for (int m = 0; m < points_.size(); ++m)
      cost += std::min(std::abs(plane.normal.dot(p_1(m)) - plane.offset), threshold);
    if (cost < best_cost) {
      best_cost = cost;
      best = plane;
    }
  }
  co_return best;
}

// Among planes through three points that face up, the one with the most points near it, and few below.
Task<InitialMap::Plane> InitialMap::sample_ground(float threshold) {
  uint32_t state = kSequenceStart;
  Plane best;
  float best_cost = kInfiniteCost;
  for (int trial = 0; trial < kGroundTrials; ++trial) {
    co_await background_.spend(Work::kOther, kSampleInstructions);
    const Plane plane = next_plane(&state);
    if (!plane.found || !faces_up(plane) || !(plane.normal.z() > kMinCosAxis)) continue;
    const Support support = support_of(plane, threshold);
    co_await background_.spend(Work::kOther, kTrialInstructions * points_.size());
    const float cost = static_cast<float>(support.below) - support.near;
    if (cost < best_cost) {
      best_cost = cost;
      best = plane;
    }
  }
  co_return best;
}

// Fits the plane to its inliers by least squares, and turns the normal so that the offset is positive.
Task<InitialMap::Plane> InitialMap::refine(Plane plane, float threshold) {
  const int count = points_.size();
  plane.found = false;
  for (int round = 0; round < kRefineRounds; ++round) {
    Vector3f mean = Vector3f::Zero();
    int inliers = 0;
    for (int m = 0; m < count; ++m) {
      if (std::abs(plane.normal.dot(p_1(m)) - plane.offset) > threshold) continue;
      mean += p_1(m);
      ++inliers;
    }
    if (inliers < kMinPlaneInliers) co_return plane;
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
    co_await background_.spend(Work::kOther, kRefineInstructions * count);
  }
  if (plane.offset < 0) {
    plane.normal = -plane.normal;
    plane.offset = -plane.offset;
  }
  plane.found = true;
  co_return plane;
}

// Changes the world's coordinates [ptam 6.1]. The plane becomes z = 0, with z towards the camera; the origin is where
// the first keyframe's axis meets the plane; x is along the first camera's x. Scale: the first view is
// Config::initial_plane_distance away from the plane, if that is set; otherwise the largest distance of an initial view
// from the first is Config::initial_baseline. False, with nothing changed, when the axis does not meet the plane.
bool InitialMap::align_to(const Plane& plane, float threshold) {
  const SE3 T_1w = map_.keyframes()[0].T_kw;
  // z of the world points from the plane to the camera, which is the origin of its own frame.
  const Vector3f z = -plane.normal;
  if (!(plane.normal.z() > kMinCosAxis)) return false;
  const Vector3f origin = Vector3f::UnitZ() * (plane.offset / plane.normal.z());
  const Vector3f x = (Vector3f::UnitX() - z * z.x()).normalized();
  const Vector3f y = z.cross(x);
  Matrix3f R;  // first camera to world
  R.row(0) = x.transpose();
  R.row(1) = y.transpose();
  R.row(2) = z.transpose();
  float baseline = 0;  // largest distance of an initial view from the first
  for (const Keyframe& keyframe : map_.keyframes())
    baseline = std::max(baseline, (keyframe.T_kw.centre() - T_1w.centre()).norm());
  if (!(baseline > kMinBaseline) || !R.allFinite()) return false;
  Similarity S;
  S.T = SE3(R, -(R * origin)) * T_1w;
  S.scale = config_.initial_plane_distance > 0 ? config_.initial_plane_distance / plane.offset
                                               : config_.initial_baseline / baseline;
  map_.apply(S);
  // Patches on the plane get the plane's normal, which is better known now than from the homography.
  for (const int16_t i : points_) {
    const MapPoint& point = map_.points()[i];
    if (std::abs(point.p_w.z()) < threshold * S.scale)
      map_.set_normal(i, map_.keyframes()[point.source.keyframe].T_kw.R.col(2));
  }
  meter_.charge(Work::kOther, kTransformPointInstructions * map_.points().size() +
                                  kTransformKeyframeInstructions * map_.keyframes().size());
  return true;
}

}  // namespace pptam
