#include "mapping/bundle_adjustment.h"

#include <algorithm>
#include <cmath>

#include "base/assert.h"
#include "camera/pose_update.h"
#include "geometry/robust.h"

namespace pptam {

namespace {

constexpr int kLocalCameras = 5;  // the newest keyframe and the four nearest to it [ptam 6.3]
constexpr int kMinPoints = 6;     // points without which nothing is adjusted; not swept

// Second search of an outlier [ptam 6.4]. Good measurements that the point must have: two always agree along their
// epipolar lines, so that before repeated texture they would confirm a wrong point.
constexpr int kMinGoodToSearch = 3;
// Radius of the second search, pixels of the level searched. One pixel reaches the nearest whole positions; the upper
// bound is well below the tracker's 4, so that the outlier itself is not found again. Not swept.
constexpr float kMinSecondSearch_px = 1.0f, kMaxSecondSearch_px = 1.5f;
// SearchOptions::max_relative_zmssd of the second search, stricter than the first one's. Not swept.
constexpr float kSecondSearchZmssd = 0.3f;
// Measurements from which on a keyframe is adjusted. With fewer it keeps its tracked pose: a camera that turns towards
// new scenery measures hardly any map point, and the keyframe would move where nothing holds it. Pans on the spot,
// eight emulated runs: adjusted all the same, one is off by 14 % of the depth; with 6 to 10, 2.7 at most.
constexpr int kMinMeasurements = 10;
// Live keyframes up to which a map is still taking shape: its points move against its cameras, and holding their size
// would change that of the path. In a video of a cube on a table one of eleven starts is bent so.
constexpr int kMaxGrowingKeyframes = 16;
constexpr int kScalePoints = 256;  // that tell a finished map's scale, at most twice as many; bounds a slice
// Measurements from which on a point is settled: two agree wherever it lies along its epipolar lines.
constexpr int kSettledMeasurements = 3;
// Change of the scale, relative, that is undone: some ten times float32's rounding, since undoing rounds every number
// again, and a perfect map would never be seen to converge. A thousand steps of it are 0.1 %.
constexpr float kMinScaleChange = 1e-6f;
constexpr float kMinExtent = 1e-3f;  // of an adjusted map, relative to before: a smaller one has collapsed; not swept

// ARMv6 instructions, estimates. The sum over a run's mapping is within 10 % of the count (tests/budget).
constexpr int64_t kCopyCameraInstructions = 400;       // a keyframe into the engine
constexpr int64_t kCopyObservationInstructions = 215;  // a measurement into the engine
constexpr int64_t kTestObservationInstructions = 20;   // a measurement of a point that no free keyframe sees
constexpr int64_t kCountMeasurementInstructions = 10;  // a measurement counted for its keyframe
constexpr int64_t kViewInstructions = 300;             // a keyframe compared, in one round of choosing the local ones
constexpr int64_t kCommitPointInstructions = 20;
constexpr int64_t kCompareDistanceInstructions = 130;  // a point's distances compared, and its share of the median
constexpr int64_t kMovePointInstructions = 40, kMoveKeyframeInstructions = 400;  // into other coordinates
constexpr int64_t kFollowAnchorInstructions = 200;  // an erased keyframe that follows its anchor
constexpr int64_t kWeighPointInstructions = 30, kWeighObservationInstructions = 25;  // discard_outliers()

Vector6f prior_information(float mean_depth) {
  const float translation = kVelocitySigmaTranslation * mean_depth;
  Vector6f information;
  information << Vector3f::Constant(1.0f / (translation * translation)),
      Vector3f::Constant(1.0f / (kVelocitySigmaRotation * kVelocitySigmaRotation));
  return information;
}

BundleCapacity capacity(const Config& config) {
  BundleCapacity capacity;
  // One camera for each slot of Map::keyframes(), so that indices are the same. Cameras of erased keyframes and empty
  // slots are neither free nor observed.
  capacity.cameras = keyframe_slots(config.max_keyframes, config.max_erased_keyframes);
  capacity.points = config.max_map_points;
  capacity.observations = measurements_of_one_map(config);
  capacity.observations_per_point = config.max_measurements_per_point + 1;
  capacity.columns = std::max(config.max_keyframes, 2 * kMaxVelocityCameras);
  return capacity;
}

}  // namespace

BundleAdjuster::BundleAdjuster(Arena& arena, const Config& config, Map& map, WorkMeter& meter, Background& background)
    : config_(config),
      map_(map),
      meter_(meter),
      background_(background),
      finder_(map, config, meter),
      engine_(arena, capacity(config), Projection{&config.camera.model}, meter, background),
      measured_(arena, keyframe_slots(config.max_keyframes, config.max_erased_keyframes)),
      point_indices_(arena, config.max_map_points),
      ratios_(arena, config.max_map_points) {}

Task<> BundleAdjuster::run(int newest, bool velocities, int max_iterations) {
  result_ = BundleResult();
  const bool few = newest >= 0 || map_.live_count() <= kMaxVelocityCameras;
  scale_ = 1;
  co_await gather(newest, velocities && few && config_.camera.shutter.line_time_s != 0);
  if (!engine_.assign_columns() || engine_.columns() == 0 || engine_.points().size() < kMinPoints) {
    result_.converged = true;  // there is nothing to adjust: asking again would not change that
    co_return;
  }
  co_await engine_.start(BundleOptions());
  while (!result_.converged && result_.iterations < max_iterations) {
    co_await engine_.linearise();
    if (result_.iterations == 0) result_.initial_cost = engine_.cost();
    result_.final_cost = engine_.cost();
    result_.sigma = engine_.sigma();
    co_await engine_.attempt();
    const BundleOutcome outcome = engine_.outcome();
    if (outcome == BundleOutcome::kAccepted || outcome == BundleOutcome::kConverged) {
      ++result_.iterations;
      result_.final_cost = engine_.cost();
      if (!map_.ready()) {
        hold_initial_scale();
      } else if (newest < 0 && map_.live_count() > kMaxGrowingKeyframes) {
        note_scale();  // in a local adjustment fixed keyframes hold it, where they see its points
      }
      commit();
    }
    result_.converged = outcome == BundleOutcome::kConverged || outcome == BundleOutcome::kExhausted;
    if (!result_.converged && map_.queue().waiting() > 0) break;  // the new keyframe comes first
    if (!result_.converged) co_await background_.slice();
  }
  if (std::abs(scale_ - 1.0f) > kMinScaleChange) {
    co_await background_.slice();
    restore_scale();
  }
  if (result_.converged) co_await discard_outliers();
}

// Copies the map into the engine. Several slices may pass meanwhile: only the mapper changes the map's geometry, and it
// waits for this coroutine.
Task<> BundleAdjuster::gather(int newest, bool velocities) {
  engine_.clear();
  point_indices_.clear();
  for (const Keyframe& keyframe : map_.keyframes()) {
    Engine::Camera camera;
    camera.now = {keyframe.T_kw.R, keyframe.T_kw.t, keyframe.velocity};
    camera.velocity_prior = keyframe.velocity_prior;
    camera.prior_information = prior_information(keyframe.mean_depth);
    engine_.cameras().push_back(camera);
  }
  meter_.charge(Work::kOther, kCopyCameraInstructions * map_.keyframes().size());
  co_await count_measurements();
  co_await free_cameras(newest, velocities);
  for (int i = 0; i < map_.points().size(); ++i) {
    const MapPoint& point = map_.points()[i];
    if (point.id == 0) continue;
    bool seen_by_free = false;
    for (const Measurement& m : map_.measurements(point)) {
      const Engine::Camera& camera = engine_.cameras()[m.keyframe];
      seen_by_free |= camera.pose_free || camera.velocity_free;
    }
    if (!seen_by_free) {
      co_await background_.spend(Work::kOther, kTestObservationInstructions * point.measurements.size());
      continue;
    }
    Engine::Point entry;
    entry.first = engine_.observations().size();
    entry.p = point.p_w;
    const Measurement* sorted[kMaxMeasurementsPerPoint + 1];  // by ascending keyframe
    int16_t tags[kMaxMeasurementsPerPoint + 1];
    int count = 0;
    for (const Measurement& m : map_.measurements(point)) {
      int at = count;
      for (; at > 0 && sorted[at - 1]->keyframe > m.keyframe; --at) {
        sorted[at] = sorted[at - 1];
        tags[at] = tags[at - 1];
      }
      sorted[at] = &m;
      tags[at] = static_cast<int16_t>(count++);
    }
    for (int k = 0; k < count; ++k) {
      Engine::Observation observation;
      observation.px = sorted[k]->at.px;
      observation.inverse_sigma = 1.0f / sorted[k]->at.sigma();
      observation.dt_s = config_.camera.dt_s(sorted[k]->at.px);
      observation.camera = sorted[k]->keyframe;
      observation.tag = tags[k];
      if (!engine_.observations().push_back(observation)) break;
    }
    entry.count = engine_.observations().size() - entry.first;
    engine_.points().push_back(entry);
    point_indices_.push_back(i);
    co_await background_.spend(Work::kOther, kCopyObservationInstructions * entry.count);
  }
}

Task<> BundleAdjuster::count_measurements() {
  measured_.resize(map_.keyframes().size());
  std::fill(measured_.begin(), measured_.end(), 0);
  for (const MapPoint& point : map_.points()) {
    if (point.id == 0) continue;
    for (const Measurement& m : map_.measurements(point)) ++measured_[m.keyframe];
    co_await background_.spend(Work::kOther, kCountMeasurementInstructions * point.measurements.size());
  }
}

// Frees all live keyframes with enough measurements, or `newest` and the nearest to it. In a map that is not ready all
// of them, since hold_initial_scale() moves all. The first keyframe's pose is the datum and never free; its velocity
// may be free.
Task<> BundleAdjuster::free_cameras(int newest, bool velocities) {
  FixedVector<Engine::Camera>& cameras = engine_.cameras();
  if (newest < 0) {
    for (int k = 0; k < cameras.size(); ++k) {
      const bool live = map_.keyframes()[k].live() && (!map_.ready() || measured_[k] >= kMinMeasurements);
      cameras[k].pose_free = live && k > 0;
      cameras[k].velocity_free = live && velocities;
    }
    co_return;
  }
  const Vector3f centre = map_.keyframes()[newest].T_kw.centre();
  for (int count = 0; count < kLocalCameras; ++count) {
    int best = -1;
    float best_distance = 0;
    for (int k = 1; k < cameras.size(); ++k) {
      if (cameras[k].pose_free || !map_.keyframes()[k].live() || measured_[k] < kMinMeasurements) continue;
      const float distance = k == newest ? -1 : (map_.keyframes()[k].T_kw.centre() - centre).squaredNorm();
      if (best < 0 || distance < best_distance) {
        best = k;
        best_distance = distance;
      }
    }
    if (best < 0) break;
    cameras[best].pose_free = true;
    cameras[best].velocity_free = velocities;
    co_await background_.spend(Work::kOther, kViewInstructions * cameras.size());
  }
}

// Called before a step is committed. Nothing else fixes the scale of a full adjustment. In a map that is not ready yet
// the last camera keeps its distance from the first after each step: the tracker already tracks at that scale.
void BundleAdjuster::hold_initial_scale() {
  FixedVector<Engine::Camera>& cameras = engine_.cameras();
  const auto centre = [](const Engine::State& camera) { return Vector3f(-(camera.R.transpose() * camera.t)); };
  const Vector3f origin = centre(cameras[0].now);
  const SE3& T_last = map_.keyframes()[map_.keyframes().size() - 1].T_kw;
  const float before = (T_last.centre() - origin).norm(), after = (centre(cameras.back().now) - origin).norm();
  if (!(before > 0) || !(after > kMinExtent * before)) return;
  const float scale = before / after;
  for (Engine::Camera& camera : cameras) {
    camera.now.t = -(camera.now.R * (origin + scale * (centre(camera.now) - origin)));
    camera.now.velocity.head<3>() *= scale;
  }
  for (Engine::Point& point : engine_.points()) point.p = origin + scale * (point.p - origin);
}

// Likewise in a finished map: notes by how much the step changes its scale. The middle one of the settled points'
// distances from the datum tells, so that neither a camera nor a minority of points can pull at it.
void BundleAdjuster::note_scale() {
  const Vector3f origin = map_.keyframes()[0].T_kw.centre();
  ratios_.clear();
  const int stride = 1 + point_indices_.size() / kScalePoints;
  for (int i = 0; i < point_indices_.size(); i += stride) {
    const Engine::Point& entry = engine_.points()[i];
    if (entry.count < kSettledMeasurements) continue;
    const float before_sq = (map_.points()[point_indices_[i]].p_w - origin).squaredNorm();
    if (before_sq > 0) ratios_.push_back((entry.p - origin).squaredNorm() / before_sq);
  }
  meter_.charge(Work::kOther, kCompareDistanceInstructions * ratios_.size());
  if (ratios_.size() < kMinPoints) return;
  const float change = std::sqrt(median_of(ratios_));
  if (change > kMinExtent && change < 1 / kMinExtent) scale_ *= change;
}

// Undoes what note_scale() has noted, about the datum's centre: a change of the world's coordinates, which the
// keyframes in the queue and the tracker follow. Not in every step: velocities have priors that know the scale, and
// adjustment would not converge.
void BundleAdjuster::restore_scale() {
  Similarity S;
  S.scale = 1.0f / scale_;
  S.T.t = map_.keyframes()[0].T_kw.centre() * (scale_ - 1.0f);
  map_.apply(S);
  meter_.charge(Work::kOther,
                kMovePointInstructions * map_.points().size() + kMoveKeyframeInstructions * map_.keyframes().size());
}

// Writes one accepted step into the map, as a whole.
void BundleAdjuster::commit() {
  for (int k = 0; k < engine_.cameras().size(); ++k) {
    const Engine::Camera& camera = engine_.cameras()[k];
    if (camera.pose_free) map_.move_keyframe(k, {camera.now.R, camera.now.t});
    if (camera.velocity_free || !map_.ready()) map_.set_velocity(k, camera.now.velocity);
  }
  for (int i = 0; i < point_indices_.size(); ++i) map_.move_point(point_indices_[i], engine_.points()[i].p);
  map_.follow_anchors();
  meter_.charge(Work::kOther,
                kCommitPointInstructions * point_indices_.size() + kFollowAnchorInstructions * map_.erased_count());
}

// Measures an outlier a second time [ptam 6.4], within an inlier's distance of the point's prediction. The first
// measurement lies further away than that, so that it is not found again.
bool BundleAdjuster::measure_again(const MapPoint& point, Measurement* measurement) {
  const Keyframe& keyframe = map_.keyframes()[measurement->keyframe];
  PredictedPoint predicted;
  meter_.charge(Work::kOther, kPredictionInstructions);
  if (!config_.camera.project_rolling(keyframe.T_kw, keyframe.velocity, point.p_w, &predicted)) return false;
  SearchOptions options;
  options.level = level_of_points(config_);
  // A measurement's sigma is one pixel of the level searched, so the engine's sigma is in pixels of that level.
  options.radius_px = std::clamp(kTukeyCutoff * engine_.sigma(), kMinSecondSearch_px, kMaxSecondSearch_px);
  options.max_relative_zmssd = kSecondSearchZmssd;

  ImagePoint found;
  if (finder_.find(point.source, point.p_w, predicted, keyframe.pyramid, options, &found) != SearchOutcome::kFound ||
      !(tukey_weight((found.px - predicted.px).squaredNorm() / (found.sigma() * found.sigma()), engine_.sigma()) > 0))
    return false;
  *measurement = {found, measurement->keyframe};
  return true;
}

// Stores the weights of all measurements. Measurements of zero weight are replaced by a second search or removed. A
// point is removed when its source's measurement has zero weight, or when it is left with fewer than two measurements.
Task<> BundleAdjuster::discard_outliers() {
  for (int i = 0; i < point_indices_.size(); ++i) {
    const Engine::Point& entry = engine_.points()[i];
    const int index = point_indices_[i];
    const MapPoint& point = map_.points()[index];
    PPTAM_ASSERT(entry.count == point.measurements.size());  // keyframes are inserted between two adjustments
    float weights[kMaxMeasurementsPerPoint + 1];
    bool source_is_outlier = false;
    int good = 0;
    for (int k = entry.first; k < entry.first + entry.count; ++k) {
      const Engine::Observation& o = engine_.observations()[k];
      weights[o.tag] = o.weight;
      good += o.weight != 0;
      source_is_outlier |= o.weight == 0 && o.camera == point.source.keyframe;
    }
    map_.set_weights(index, weights);
    for (int j = point.measurements.size() - 1; j >= 0 && !source_is_outlier; --j) {
      if (weights[j] != 0) continue;
      Measurement again = map_.measurements(point)[j];
      if (good >= kMinGoodToSearch && measure_again(point, &again)) {
        map_.set_measurement(index, j, again);
      } else {
        map_.remove_measurement(index, j);
      }
    }
    if (source_is_outlier || point.measurements.size() < 2) map_.remove_point(index);
    co_await background_.spend(Work::kOther, kWeighPointInstructions + kWeighObservationInstructions * entry.count);
  }
}

}  // namespace pptam
