#include "mapping/ground.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

namespace pptam {

namespace {

constexpr int kPlaneTrials = 100;  // planes through three points that are tried; not swept
constexpr int kRefineRounds = 3;   // least-squares fits, each to the inliers of the one before; not swept
// Distance from the plane up to which a point lies on it, in mean depths of the first view. Not swept.
constexpr float kPlaneThreshold = 0.02f;
// A ground: how far its normal must face up in the first image, a cosine (it is seen from above by 70 degrees at most);
// the distance up to which a point lies on it, in mean depths, since such points are few and far in a new map; the
// least share of the points that lie on it, and the largest of those below. In six maps of a cube on a table the table
// holds a fifth to a third of the points. Not swept, but for the distance: with 0.02 two of the six are off by over 10
// degrees.
constexpr float kMinFacingUp = 0.34f, kGroundThreshold = 0.03f;
constexpr float kMinGroundShare = 0.15f, kMaxBelowShare = 0.15f;
constexpr int kGroundTrials = 400;  // planes through three points that are tried; not swept
// Cosine of the angle between the view's axis, or the chosen pixel's ray, and the plane's normal: at over 87 degrees it
// hardly meets the plane. Not swept.
constexpr float kMinCosAxis = 0.05f;
constexpr float kMaxAlongX = 0.9f;     // cosine between the camera's x and the normal; not swept
constexpr float kMinBaseline = 1e-6f;  // of the initial views, in the start's units: guards a division
constexpr float kInfiniteCost = 1e30f;

// The plane at a pixel. Points round it, by the distance of their rays: planes are tried through three of kNear, those
// of kNearest decide, at least half of which must lie on it. Not swept.
constexpr int kNear = 24, kNearest = 12, kChoiceTrials = 200;
// The planes of a map: least share of its points and least number of them on each. Not swept.
constexpr float kMinListedShare = 0.08f;
constexpr int kMinListedPoints = 12;

// ARMv6 instructions, estimates. The sum over a run's mapping is within 10 % of the count (tests/budget).
constexpr int64_t kTrialInstructions = 75;    // of one point in one trial
constexpr int64_t kSampleInstructions = 300;  // of three points
constexpr int64_t kRefineInstructions = 250;  // of one point in one fit
constexpr int64_t kTransformPointInstructions = 60, kTransformKeyframeInstructions = 500;

// The change of coordinates that makes the plane, in the frame of the camera at T_cw, z = 0, with its origin where the
// ray meets the plane. False when it does not, or nearly so.
bool onto(const Plane& plane, const SE3& T_cw, const Vector3f& ray, Similarity* S) {
  const float along = plane.normal.dot(ray);
  if (!(along > kMinCosAxis * ray.norm())) return false;
  const Vector3f z = -plane.normal;  // to the camera, which is the origin of its own frame
  const Vector3f origin = ray * (plane.offset / along);
  // Along the camera's x; along its axis where x stands on the plane.
  const Vector3f along_x = std::abs(z.x()) < kMaxAlongX ? Vector3f::UnitX() : Vector3f::UnitZ();
  const Vector3f x = (along_x - z * z.dot(along_x)).normalized();
  Matrix3f R;  // camera to world
  R.row(0) = x.transpose();
  R.row(1) = z.cross(x).transpose();
  R.row(2) = z.transpose();
  if (!R.allFinite()) return false;
  S->T = SE3(R, -(R * origin)) * T_cw;
  S->scale = 1;
  return true;
}

}  // namespace

Ground::Ground(Arena& arena, const Config& config, Map& map, WorkMeter& meter, Background& background)
    : config_(config),
      map_(map),
      meter_(meter),
      background_(background),
      points_(arena, config.max_map_points),
      order_(arena, config.max_map_points),
      weights_(arena, config.max_map_points) {}

void Ground::gather(const FixedVector<MapPoint>& points, const SE3& T_cw) {
  points_.clear();
  for (const MapPoint& point : points)
    if (point.id != 0) points_.push_back(T_cw * point.p_w);
}

Task<bool> Ground::align_new_map() {
  const float depth = map_.keyframes()[0].mean_depth, threshold = kPlaneThreshold * depth;
  gather(map_.points(), map_.keyframes()[0].T_kw);
  Plane plane = co_await sample_dominant_plane(threshold);
  if (plane.found) plane = co_await refine(plane, threshold);
  if (plane.found && !faces_up(plane)) {
    const float coarse = kGroundThreshold * depth;
    Plane ground = co_await sample_ground(coarse);
    if (ground.found) ground = co_await refine(ground, coarse);
    const auto share = [&](float of) { return of * static_cast<float>(points_.size()); };
    const PlaneSupport support = support_of(points_, ground, coarse);
    meter_.charge(Work::kOther, kTrialInstructions * points_.size());
    if (ground.found && faces_up(ground) && ground.normal.z() > kMinCosAxis &&
        static_cast<float>(support.on) >= share(kMinGroundShare) &&
        static_cast<float>(support.beyond) <= share(kMaxBelowShare))
      plane = ground;
  }
  const bool aligned = plane.found && align_to(plane, threshold);
  co_return aligned;
}

// Whether the plane's upper side is seen by a camera that is held upright. A front that stands on a ground does not
// face up, unless the camera itself looks up by over 20 degrees; a ground seen from straight above does not either, and
// then there is no front.
bool Ground::faces_up(const Plane& plane) const {
  return plane.normal.y() > kMinFacingUp;  // from the camera to the plane: down in the image
}

// Among planes through three points, the one with the lowest sum of point distances, each cut off at the threshold.
Task<Plane> Ground::sample_dominant_plane(float threshold) {
  PlaneSampler sampler(points_, map_.keyframes()[0].mean_depth);
  Plane best;
  float best_cost = kInfiniteCost;
  for (int trial = 0; trial < kPlaneTrials; ++trial) {
    co_await background_.spend(Work::kOther, kTrialInstructions * points_.size());
    const Plane plane = sampler.next();
    if (!plane.found) continue;
    float cost = 0;
    for (const Vector3f& p : points_) cost += std::min(std::abs(plane.beyond(p)), threshold);
    if (cost < best_cost) {
      best_cost = cost;
      best = plane;
    }
  }
  co_return best;
}

// Among planes through three points that face up, the one with the most points near it, and few below.
Task<Plane> Ground::sample_ground(float threshold) {
  PlaneSampler sampler(points_, map_.keyframes()[0].mean_depth);
  Plane best;
  float best_cost = kInfiniteCost;
  for (int trial = 0; trial < kGroundTrials; ++trial) {
    co_await background_.spend(Work::kOther, kSampleInstructions);
    const Plane plane = sampler.next();
    if (!plane.found || !faces_up(plane) || !(plane.normal.z() > kMinCosAxis)) continue;
    const PlaneSupport support = support_of(points_, plane, threshold);
    co_await background_.spend(Work::kOther, kTrialInstructions * points_.size());
    const float cost = static_cast<float>(support.beyond) - support.near;
    if (cost < best_cost) {
      best_cost = cost;
      best = plane;
    }
  }
  co_return best;
}

Task<Plane> Ground::refine(Plane plane, float threshold) {
  for (int round = 0; plane.found && round < kRefineRounds; ++round) {
    plane.found = fit_plane(points_, {}, threshold, &plane);
    co_await background_.spend(Work::kOther, kRefineInstructions * points_.size());
  }
  co_return plane;
}

// The origin is where the first keyframe's axis meets the plane. Scale: the first view is
// Config::initial_plane_distance away from the plane, if that is set; otherwise the largest distance of an initial view
// from the first is Config::initial_baseline. False, with nothing changed, when the axis does not meet the plane.
bool Ground::align_to(const Plane& plane, float threshold) {
  const SE3 T_1w = map_.keyframes()[0].T_kw;
  Similarity S;
  if (!onto(plane, T_1w, Vector3f::UnitZ(), &S)) return false;
  float baseline = 0;  // largest distance of an initial view from the first
  for (const Keyframe& keyframe : map_.keyframes())
    baseline = std::max(baseline, (keyframe.T_kw.centre() - T_1w.centre()).norm());
  if (!(baseline > kMinBaseline)) return false;
  S.scale = config_.initial_plane_distance > 0 ? config_.initial_plane_distance / plane.offset
                                               : config_.initial_baseline / baseline;
  map_.apply(S);
  // Patches on the plane get the plane's normal, which is better known now than from the homography.
  for (int i = 0; i < map_.points().size(); ++i) {
    const MapPoint& point = map_.points()[i];
    if (point.id != 0 && std::abs(point.p_w.z()) < threshold * S.scale)
      map_.set_normal(i, map_.keyframes()[point.source.keyframe].T_kw.R.col(2));
  }
  meter_.charge(Work::kOther, kTransformPointInstructions * map_.points().size() +
                                  kTransformKeyframeInstructions * map_.keyframes().size());
  return true;
}

// Copies the points whose rays are nearest to the one through (ray.x, ray.y, 1), nearest first, and sets the weights of
// all: one half for the last of those that decide. Returns how many were copied.
int Ground::choose_near(const Vector2f& ray, std::span<Vector3f> near) {
  weights_.clear();
  order_.clear();
  for (int i = 0; i < points_.size(); ++i) {
    const Vector3f& p = points_[i];
    const bool ahead = p.z() > 0;
    weights_.push_back(ahead ? (p.head<2>() / p.z() - ray).squaredNorm() : kInfiniteCost);
    if (ahead) order_.push_back(static_cast<int16_t>(i));
  }
  const int count = std::min(static_cast<int>(near.size()), order_.size());
  std::partial_sort(order_.begin(), order_.begin() + count, order_.end(), [&](int16_t a, int16_t b) {
    return weights_[a] < weights_[b] || (weights_[a] == weights_[b] && a < b);
  });
  for (int i = 0; i < count; ++i) near[static_cast<size_t>(i)] = points_[order_[i]];
  if (count == 0) return 0;
  const float half_sq = std::max(weights_[order_[std::min(count, kNearest) - 1]], 1e-12f);
  for (float& weight : weights_) weight = 1 / (1 + weight / half_sq);
  return count;
}

Status Ground::choose(const SE3& T_cw, const Vector2f& px, Similarity* change) {
  if (!config_.camera.in_image(px, 0))  // refuses NaN, too
    return {StatusCode::kInvalidArgument, "set_ground: the pixel is not within the image"};
  const Vector2f ray = config_.camera.unproject(px);
  gather(map_.points(), T_cw);
  std::array<Vector3f, kNear> near_points;
  const int count = choose_near(ray, near_points);
  const std::span<const Vector3f> near(near_points.data(), static_cast<size_t>(count));
  const std::span<const Vector3f> nearest = near.first(static_cast<size_t>(std::min(count, kNearest)));
  float depth = 0;
  for (const Vector3f& p : nearest) depth += p.z() / static_cast<float>(nearest.size());
  const float threshold = kPlaneThreshold * depth;
  PlaneSampler sampler(near, depth);
  Plane plane;
  float most = 0;
  for (int trial = 0; trial < kChoiceTrials; ++trial) {
    const Plane tried = sampler.next();
    if (!tried.found) continue;
    const float support = support_of(near, tried, threshold).near + support_of(nearest, tried, threshold).near;
    if (support > most) {
      most = support;
      plane = tried;
    }
  }
  // First where it was asked for, then with all that lies on it: the farther its points reach, the better it is known.
  bool fits = plane.found && fit_plane(near, {}, threshold, &plane);
  for (int round = 0; fits && round < kRefineRounds; ++round) fits = fit_plane(points_, weights_, threshold, &plane);
  meter_.charge(Work::kOther, kChoiceTrials * (kSampleInstructions + kTrialInstructions * (kNear + kNearest)) +
                                  kRefineRounds * kRefineInstructions * points_.size());
  Similarity S;
  if (!fits || 2 * support_of(nearest, plane, threshold).on < kNearest)
    return {StatusCode::kInvalidArgument, "set_ground: the map points round this pixel do not lie on one plane"};
  if (!onto(plane, T_cw, ray.homogeneous(), &S))
    return {StatusCode::kInvalidArgument, "set_ground: the plane at this pixel is seen nearly edge-on"};
  map_.change_coordinates(S);
  meter_.charge(Work::kOther, kTransformPointInstructions * map_.points().size() +
                                  kTransformKeyframeInstructions * map_.keyframes().size());
  if (change) *change = S;
  return {};
}

int Ground::planes(const MapAccess::Part& part, std::span<PlaneInfo> out) {
  const Keyframe& view = (*part.keyframes)[0];  // the datum
  gather(*part.points, view.T_kw);
  const float threshold = kPlaneThreshold * view.mean_depth;
  const float least = std::max(kMinListedShare * static_cast<float>(points_.size()), 1.0f * kMinListedPoints);
  int count = 0;
  for (; count < kMostPlanes; ++count) {
    PlaneSampler sampler(points_, view.mean_depth);
    Plane plane;
    float most = 0;
    for (int trial = 0; trial < kGroundTrials; ++trial) {
      const Plane tried = sampler.next();
      const float near = tried.found ? support_of(points_, tried, threshold).near : 0;
      if (near > most) {
        most = near;
        plane = tried;
      }
    }
    meter_.charge(Work::kOther, kGroundTrials * (kSampleInstructions + kTrialInstructions * points_.size()));
    bool fits = plane.found;
    for (int round = 0; fits && round < kRefineRounds; ++round) fits = fit_plane(points_, {}, threshold, &plane);
    if (!fits) break;
    const auto on = [&](const Vector3f& p) { return std::abs(plane.beyond(p)) < threshold; };
    Vector3f sum = Vector3f::Zero();
    int members = 0;
    for (const Vector3f& p : points_) {
      if (!on(p)) continue;
      sum += p;
      ++members;
    }
    if (static_cast<float>(members) < least) break;
    const SE3 T_wk = view.T_kw.inverse();
    if (static_cast<size_t>(count) < out.size()) {
      out[static_cast<size_t>(count)] = {T_wk.R * -plane.normal, T_wk * (sum / static_cast<float>(members)), threshold,
                                         members};
    }
    points_.resize(static_cast<int>(std::remove_if(points_.begin(), points_.end(), on) - points_.begin()));
  }
  const size_t copied = std::min(static_cast<size_t>(count), out.size());
  for (size_t i = 1; i < copied; ++i)  // of the same number of points, that which was found first
    for (size_t k = i; k > 0 && out[k].points > out[k - 1].points; --k) std::swap(out[k], out[k - 1]);
  return count;
}

}  // namespace pptam
