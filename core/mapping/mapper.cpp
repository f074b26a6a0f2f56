#include "mapping/mapper.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

#include "geometry/robust.h"
#include "geometry/two_view.h"
#include "map/patch_search.h"
#include "mapping/neighbours.h"

namespace pptam {

namespace {

constexpr size_t kFrameBytes = 24 * 1024;  // nested jobs' frames: run > insert_keyframe > ..., run > bundle > ...
constexpr int kMostPosePoints = 250;       // of a keyframe, to find its velocity
constexpr uint8_t kCornerLevel = 1;        // how precisely a partial point's corner is known
constexpr int kBundleIterations = 12;
constexpr int kInitialIterations = 30;
constexpr int kLocatingPoints = 40;                       // of each initial view's pose, before bundle adjustment
constexpr float kInitialVelocitySigmaTranslation = 0.1f;  // depths/s, of the velocity during an initial view's readout
constexpr float kInitialVelocitySigmaRotation = 0.15f;    // radians/s
constexpr float kMaxInitialSigma = 1.0f;                  // 2 px: a right map fits to under 1 px
constexpr int kFullFromKeyframes = 8;  // below, local and full adjustment are nearly the same problem
constexpr float kMinCornerDistance_px = 10.0f;
constexpr float kMaxPromotionError_px = 4.0f;
constexpr float kMinParallax_rad = 0.015f;
constexpr float kMaxRelativeDepthSigma = 0.15f;
constexpr float kMeasurementNoise_px = 0.8f;  // sub-pixel noise and what the rolling shutter's correction leaves
constexpr float kMinReliability = 0.3f;
constexpr int kMinAttempts = 20;
// Of a point with two measurements: nothing but searches can show that its depth is wrong.
constexpr int kMinAttemptsOfTwo = 6;
constexpr int kPlaneTrials = 100;
// Instructions, as counted for the ARM1176.
constexpr int64_t kPredictionInstructions = 700;      // of a point in a keyframe
constexpr int64_t kTriangulationInstructions = 3500;  // of a partial point, with its checks
constexpr int kVelocityRounds = 3;  // bundle adjustments with re-estimated velocities after each keyframe

}  // namespace

Mapper::Mapper(Arena& arena, const Config& config, Map& map, WorkMeter& meter)
    : Background(arena, kFrameBytes, meter),
      config_(config),
      map_(map),
      bundle_(arena, config, map, meter, *this),
      culler_(arena, config, map, meter, *this),
      corner_detector_(arena, config.camera.model.width, config.camera.model.height),
      finder_(map, config.camera, meter),
      pose_points_(arena, kMostPosePoints),
      pose_(arena, kMostPosePoints, config.camera.shutter.line_time_s != 0, meter),
      occupied_(arena, config.max_map_points + config.max_partial_points) {}

bool Mapper::has_work() const {
  if (!map_.exists() || (map_.locked() && map_.ready())) return false;
  return epoch_ != map_.epoch() || !resting_ || map_.queue().waiting() > 0 || !map_.ready();
}

void Mapper::work_slice() {
  if (!has_work()) return;
  if (epoch_ != map_.epoch()) {
    // The map that the paused job worked on is gone, or has another scale.
    epoch_ = map_.epoch();
    abandon();
    task_ = Task<>();
    local_pending_ = false;
    full_pending_ = map_.ready();
    newest_ = -1;
    velocity_rounds_ = 0;
    tidy_next_ = tidy_left_ = 0;
    task_ = run();
    resting_ = false;
    task_.start();
    map_.check_consistency();
    return;
  }
  resting_ = false;
  resume();
  map_.check_consistency();
}

Task<> Mapper::run() {
  co_await cull_surplus_measurements();  // an insertion may have been given up half-way
  for (;;) {
    if (map_.exists() && !map_.ready()) {
      co_await finish_initial_map();
    } else if (map_.live_count() > config_.max_keyframes) {  // an insertion was given up half-way
      co_await make_room();
    } else if (map_.erased_count() > config_.max_erased_keyframes) {  // likewise
      co_await culler_.forget_surplus();
    } else if (map_.queue().waiting() > 0) {
      co_await insert_keyframe();
    } else if (local_pending_) {
      local_pending_ = false;
      co_await bundle_.run(newest_, true, kBundleIterations);
    } else if (full_pending_) {
      full_pending_ = false;
      co_await bundle_.run(-1, true, kBundleIterations);
      if (!bundle_.result().converged) full_pending_ = true;
      if (bundle_.result().converged) {
        co_await discard_unreliable_points();
        tidy_left_ = map_.points().size();
        if (map_.live_count() > kMaxVelocityCameras && velocity_rounds_ < kVelocityRounds) {
          ++velocity_rounds_;
          co_await update_velocities();
          full_pending_ = true;
        }
      }
    } else if (tidy_left_ > 0) {
      co_await tidy_points();
    } else {
      resting_ = true;
      co_await rest();
    }
  }
}

// What is measured in a keyframe, at most so many, into pose_points_.
Task<> Mapper::gather_pose_points(int keyframe, int most) {
  pose_points_.clear();
  for (const MapPoint& point : map_.points()) {
    if (pose_points_.size() >= most) break;
    if (point.id == 0) continue;
    co_await spend(Work::kOther, 50 + 20LL * point.measurements.size());
    for (const Measurement& m : map_.measurements(point)) {
      if (m.keyframe != keyframe) continue;
      PosePoint p;
      p.p_w = point.p_w;
      p.found = m.at;
      pose_points_.push_back(p);
      break;
    }
  }
}

// Poses of the initial views between the first and the last, backwards, each starting at its successor's.
Task<bool> Mapper::locate_initial_views() {
  const int count = map_.keyframes().size();
  for (int k = count - 2; k > 0; --k) {
    co_await gather_pose_points(k, kLocatingPoints);
    VelocityPrior prior;
    prior.sigma_translation = kInitialVelocitySigmaTranslation * map_.keyframes()[k].mean_depth;
    prior.sigma_rotation = kInitialVelocitySigmaRotation;
    const PosePoints points(config_.camera, pose_points_);
    pose_.start(map_.keyframes()[k + 1].T_kw, prior, points);
    while (!pose_.advance()) co_await slice();
    const PoseUpdate& update = pose_.result();
    if (!update.ok || !(update.sigma < kMaxInitialSigma)) co_return false;
    map_.move_keyframe(k, update.T_cw);
    map_.set_velocity(k, update.velocity);
  }
  co_return true;
}

// The velocities in the initial keyframes from the poses of the frames next to them [phone 6]: central differences. At
// either end, where only one side is known, its mean velocity is carried on to the keyframe by the difference to the
// next keyframe's.
Task<> Mapper::measure_initial_velocities() {
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
      pose_points_.clear();
      for (const KeyframeMeasurement& m : neighbour.measurements) {
        const MapPoint& point = map_.points()[m.point];
        if (point.id != m.point_id || pose_points_.size() >= kLocatingPoints) continue;
        PosePoint p;
        p.p_w = point.p_w;
        p.found = m.at;
        pose_points_.push_back(p);
      }
      VelocityPrior prior;
      prior.mean = keyframe.velocity;
      prior.sigma_translation = kVelocitySigmaTranslation * keyframe.mean_depth;
      prior.sigma_rotation = kVelocitySigmaRotation;
      const float dt_s = static_cast<float>(neighbour.timestamp_ns - keyframe.timestamp_ns) * 1e-9f;
      const PosePoints points(config_.camera, pose_points_);
      pose_.start(pose_at(keyframe.T_kw, keyframe.velocity, dt_s), prior, points);
      while (!pose_.advance()) co_await slice();
      const PoseUpdate& update = pose_.result();
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

Task<> Mapper::finish_initial_map() {
  bool good = co_await locate_initial_views();
  for (int round = 0; good && round < 2; ++round) {  // again without the outliers of the first
    co_await measure_initial_velocities();
    co_await bundle_.run(-1, true, kInitialIterations);
  }
  good = good && !(bundle_.result().sigma > kMaxInitialSigma) && map_.point_count() >= kMinInitialPoints;
  if (good) good = co_await align_to_dominant_plane();
  if (!good) {
    map_.clear();
    meter_.charge(Work::kOther, 100LL * map_.points().size());
    resting_ = true;
    co_await rest();  // the next slice starts afresh: the epoch has changed
    co_return;
  }
  map_.finish();
  newest_ = map_.keyframes().size() - 1;
  co_await add_partial_points(newest_);
}

// Dominant plane to z = 0 with z towards the camera, origin where the first keyframe's axis meets it, x along the first
// camera's x; the first view is config.initial_plane_distance away from the plane, or the initial views reach
// config.initial_baseline from the first [ptam 6.1].
Task<bool> Mapper::align_to_dominant_plane() {
  const SE3 T_1w = map_.keyframes()[0].T_kw;
  const float depth = map_.keyframes()[0].mean_depth;
  const float threshold = 0.02f * depth;
  int16_t indices[512];
  int count = 0;
  for (int i = 0; i < map_.points().size() && count < 512; ++i)
    if (map_.points()[i].id != 0) indices[count++] = static_cast<int16_t>(i);
  const auto p_1 = [&](int i) -> Vector3f { return T_1w * map_.points()[indices[i]].p_w; };
  // Three points at a time, by a fixed sequence: the same plane on every run and target.
  uint32_t state = 12345;
  const auto next = [&state](int n) {
    state = state * 1664525u + 1013904223u;
    return static_cast<int>((state >> 8) % static_cast<uint32_t>(n));
  };
  Vector3f normal = Vector3f::UnitZ();
  float offset = depth, best_cost = 1e30f;
  for (int trial = 0; trial < kPlaneTrials; ++trial) {
    const int i = next(count);
    const int j = next(count);
    const int k = next(count);
    co_await spend(Work::kOther, 75LL * count);
    const Vector3f cross = (p_1(j) - p_1(i)).cross(p_1(k) - p_1(i));
    if (!(cross.norm() > 1e-3f * depth * depth)) continue;
    const Vector3f n = cross.normalized();
    const float d = n.dot(p_1(i));
    float cost = 0;
    for (int m = 0; m < count; ++m) cost += std::min(std::abs(n.dot(p_1(m)) - d), threshold);
    if (cost < best_cost) {
      best_cost = cost;
      normal = n;
      offset = d;
    }
  }
  if (best_cost > 1e29f) co_return false;
  // Least squares over the inliers.
  for (int round = 0; round < 3; ++round) {
    Vector3f mean = Vector3f::Zero();
    int inliers = 0;
    for (int m = 0; m < count; ++m) {
      if (std::abs(normal.dot(p_1(m)) - offset) > threshold) continue;
      mean += p_1(m);
      ++inliers;
    }
    if (inliers < 6) co_return false;
    mean /= static_cast<float>(inliers);
    Matrix3f scatter = Matrix3f::Zero();
    for (int m = 0; m < count; ++m) {
      const Vector3f p = p_1(m);
      if (std::abs(normal.dot(p) - offset) > threshold) continue;
      scatter += (p - mean) * (p - mean).transpose();
    }
    const Eigen::SelfAdjointEigenSolver<Matrix3f> solver(scatter);
    if (solver.info() != Eigen::Success) co_return false;
    normal = solver.eigenvectors().col(0);
    offset = normal.dot(mean);
    co_await spend(Work::kOther, 250LL * count);
  }
  if (offset < 0) {
    normal = -normal;
    offset = -offset;
  }
  // Up is from the plane to the camera, which sits at the origin of its own frame.
  const Vector3f z = -normal;
  if (!(normal.z() > 0.05f)) co_return false;  // the axis does not meet it
  const Vector3f origin = Vector3f::UnitZ() * (offset / normal.z());
  const Vector3f x = (Vector3f::UnitX() - z * z.x()).normalized();
  const Vector3f y = z.cross(x);
  Matrix3f R;  // first camera to world
  R.row(0) = x.transpose();
  R.row(1) = y.transpose();
  R.row(2) = z.transpose();
  float baseline = 0;  // of the initial views, the longest from the first
  for (const Keyframe& keyframe : map_.keyframes())
    baseline = std::max(baseline, (keyframe.T_kw.centre() - map_.keyframes()[0].T_kw.centre()).norm());
  if (!(baseline > 1e-6f) || !R.allFinite()) co_return false;
  Similarity S;
  S.T = SE3(R, -(R * origin)) * T_1w;
  S.scale = config_.initial_plane_distance > 0 ? config_.initial_plane_distance / offset
                                               : config_.initial_baseline / baseline;
  map_.apply(S);
  // Patches on the plane get its normal; it is known much better now than from the homography.
  for (int m = 0; m < count; ++m) {
    const MapPoint& point = map_.points()[indices[m]];
    if (std::abs(point.p_w.z()) < threshold * S.scale)
      map_.set_normal(indices[m], map_.keyframes()[point.source.keyframe].T_kw.R.col(2));
  }
  meter_.charge(Work::kOther, 60LL * map_.points().size() + 500LL * map_.keyframes().size());
  co_return true;
}

bool Mapper::predict_in_keyframe(int keyframe, const Vector3f& p_w, PredictedPoint* predicted) const {
  const Keyframe& k = map_.keyframes()[keyframe];
  return config_.camera.project_rolling(k.T_kw, k.velocity, p_w, predicted) &&
         config_.camera.in_image(predicted->px, kSearchBorder_px);
}

Task<> Mapper::insert_keyframe() {
  KeyframeCandidate& candidate = map_.queue().front();
  const int keyframe = map_.add_keyframe(candidate.frame);
  if (keyframe < 0) {
    map_.queue().pop();
    co_return;
  }
  for (const KeyframeMeasurement& m : candidate.measurements)
    if (map_.points()[m.point].id == m.point_id) map_.add_measurement(m.point, {m.at, static_cast<int16_t>(keyframe)});
  meter_.charge(Work::kOther, 60LL * candidate.measurements.size());
  map_.queue().pop();
  if (map_.live_count() > config_.max_keyframes) co_await make_room();
  if (!map_.keyframes()[keyframe].live()) co_return;
  co_await cull_surplus_measurements();
  newest_ = keyframe;
  co_await measure_remaining_points(keyframe);
  co_await promote_partial_points(keyframe);
  co_await add_partial_points(keyframe);
  local_pending_ = map_.live_count() >= kFullFromKeyframes;
  full_pending_ = true;
  velocity_rounds_ = 0;
}

// One keyframe too many: the least useful one goes [phone 3.3]. If none can, the newest one does, and the map is full.
Task<> Mapper::make_room() {
  int gone = co_await culler_.choose();
  if (gone >= 0) {
    map_.set_full(false);
    co_await culler_.erase(gone);
    co_await culler_.forget_surplus();
    co_return;
  }
  map_.set_full(true);
  for (int k = 0; k < map_.keyframes().size(); ++k)
    if (map_.keyframes()[k].live() && (gone < 0 || map_.keyframes()[k].id > map_.keyframes()[gone].id)) gone = k;
  map_.erase_keyframe(gone);
  map_.forget_keyframe(gone);
  meter_.charge(Work::kOther, 50LL * map_.points().size());
}

// A new keyframe's measurements are taken over before it is known whether the keyframe stays.
Task<> Mapper::cull_surplus_measurements() {
  for (int i = 0; i < map_.points().size(); ++i) {
    cull_measurements(map_, i, config_.camera, meter_);
    co_await spend(Work::kOther, 30);
  }
}

// The tracker measures 50 points of a frame; the others that should be visible are searched now.
Task<> Mapper::measure_remaining_points(int keyframe) {
  SearchOptions options;
  options.radius_px = 3;
  options.max_relative_zmssd = 0.3f;
  for (int i = 0; i < map_.points().size(); ++i) {
    const MapPoint& point = map_.points()[i];
    if (point.id == 0) continue;
    co_await slice();
    const bool measured = map_.measured_in(point, keyframe);
    meter_.charge(Work::kOther, 100);
    if (measured) continue;
    PredictedPoint predicted;
    meter_.charge(Work::kOther, kPredictionInstructions);
    if (!predict_in_keyframe(keyframe, point.p_w, &predicted)) continue;
    ImagePoint found;
    const SearchOutcome outcome =
        finder_.find(point.source, point.p_w, predicted, map_.keyframes()[keyframe].pyramid, options, &found);
    if (outcome != SearchOutcome::kNotVisible) map_.count_search(i, outcome == SearchOutcome::kFound);
    if (outcome == SearchOutcome::kFound) {
      map_.add_measurement(i, {found, static_cast<int16_t>(keyframe)});
      cull_measurements(map_, i, config_.camera, meter_);
    }
  }
}

// Partial points that the new keyframe sees are triangulated from their original keyframe and become map points; what
// the filter knew was good for finding them only [phone 5.2]. One whose keyframe has been erased is measured in the
// live keyframe nearest to that as well: it needs two.
Task<> Mapper::promote_partial_points(int keyframe) {
  for (int i = 0; i < map_.partial_points().size(); ++i) {
    const PartialPoint& partial = map_.partial_points()[i];
    if (partial.id == 0 || partial.source.keyframe == keyframe) continue;
    co_await slice();
    if (partial.id == 0) continue;  // the tracker may have dropped it meanwhile
    const Keyframe& source = map_.keyframes()[partial.source.keyframe];
    const Keyframe& target = map_.keyframes()[keyframe];
    const SE3 T_ws = source.T_kw.inverse();
    Vector3f p_w = T_ws * Vector3f(partial.ray / partial.inverse_depth);
    PredictedPoint predicted;
    meter_.charge(Work::kOther, 2 * kPredictionInstructions);
    if (!predict_in_keyframe(keyframe, p_w, &predicted)) continue;
    // Along the epipolar line as far as two sigma of the depth reach, from either side.
    const float sigma_q = partial.information > 0 ? 1.0f / std::sqrt(partial.information) : partial.inverse_depth;
    PredictedPoint further;
    SearchOptions options;
    options.radius_px = 4;
    if (predict_in_keyframe(keyframe, T_ws * Vector3f(partial.ray / (partial.inverse_depth + sigma_q)), &further))
      options.radius_px = std::clamp(2.0f + (further.px - predicted.px).norm(), 3.0f, 8.0f);
    ImagePoint found;
    const SearchOutcome outcome = finder_.find(partial.source, p_w, predicted, target.pyramid, options, &found);
    if (outcome == SearchOutcome::kNotVisible) continue;
    map_.count_partial_search(i, outcome == SearchOutcome::kFound);
    if (outcome == SearchOutcome::kNotFound) continue;
    meter_.charge(Work::kOther, kTriangulationInstructions);
    const Vector2f px_source = config_.camera.global_shutter_px(source.velocity, source.T_kw * p_w, partial.source.px);
    const Vector2f px_target = config_.camera.global_shutter_px(target.velocity, target.T_kw * p_w, found.px);
    const SE3 T_ts = target.T_kw * T_ws;
    Triangulated triangulated;
    if (!triangulate(T_ts, config_.camera.unproject(px_source), config_.camera.unproject(px_target), kMinParallax_rad,
                     &triangulated))
      continue;
    const float relative_sigma =
        triangulated.sigma_inverse_depth * triangulated.p_1.z() * kMeasurementNoise_px / config_.camera.model.fx;
    if (!(relative_sigma < kMaxRelativeDepthSigma)) continue;
    Vector2f check_source, check_target;
    if (!config_.camera.project(triangulated.p_1, &check_source) ||
        !config_.camera.project(T_ts * triangulated.p_1, &check_target) ||
        (check_source - px_source).norm() > kMaxPromotionError_px ||
        (check_target - px_target).norm() > kMaxPromotionError_px) {
      map_.count_partial_search(i, false);  // off the epipolar line: another patch
      continue;
    }
    p_w = T_ws * triangulated.p_1;
    Measurement first{{partial.source.px, kCornerLevel}, partial.source.keyframe};
    if (!source.live()) {
      first.keyframe = static_cast<int16_t>(map_.nearest_live(partial.source.keyframe, keyframe));
      options.radius_px = 4;
      if (!predict_in_keyframe(first.keyframe, p_w, &predicted) ||
          finder_.find(partial.source, p_w, predicted, map_.keyframes()[first.keyframe].pyramid, options, &first.at) !=
              SearchOutcome::kFound ||
          (first.at.px - predicted.px).norm() > kMaxPromotionError_px) {
        map_.count_partial_search(i, false);
        continue;
      }
    }
    const int point = map_.add_point(p_w, partial.source);
    if (point < 0) co_return;
    map_.add_measurement(point, first);
    map_.add_measurement(point, {found, static_cast<int16_t>(keyframe)});
    map_.remove_partial_point(i);
  }
}

// Up to max_new_partial_points corners of the keyframe, far enough from what is there [phone 5.2].
Task<> Mapper::add_partial_points(int keyframe) {
  const Keyframe& frame = map_.keyframes()[keyframe];
  occupied_.clear();
  for (const MapPoint& point : map_.points()) {
    if (point.id == 0) continue;
    PredictedPoint predicted;
    if (predict_in_keyframe(keyframe, point.p_w, &predicted)) occupied_.push_back(predicted.px);
    co_await spend(Work::kOther, kPredictionInstructions);
  }
  for (const PartialPoint& partial : map_.partial_points()) {
    if (partial.id == 0) continue;
    const SE3 T_ws = map_.keyframes()[partial.source.keyframe].T_kw.inverse();
    PredictedPoint predicted;
    if (predict_in_keyframe(keyframe, T_ws * Vector3f(partial.ray / partial.inverse_depth), &predicted))
      occupied_.push_back(predicted.px);
    co_await spend(Work::kOther, kPredictionInstructions);
  }
  corner_detector_.start(frame.pyramid, CornerParams());
  int added = 0, pixels = 0, steps = 0;
  Corner corner;
  while (added < config_.max_new_partial_points) {
    const CornerProgress progress = corner_detector_.advance(&corner);
    meter_.charge(Work::kCornerPixel, corner_detector_.scored_pixels() - pixels);
    meter_.charge(Work::kCornerAscent, corner_detector_.ascent_steps() - steps);
    pixels = corner_detector_.scored_pixels();
    steps = corner_detector_.ascent_steps();
    co_await slice();
    if (progress == CornerProgress::kEnd) break;
    if (progress != CornerProgress::kFound) continue;
    const Vector2f px(static_cast<float>(corner.x), static_cast<float>(corner.y));
    bool free = true;
    for (const Vector2f& other : occupied_)
      free = free && (other - px).squaredNorm() > kMinCornerDistance_px * kMinCornerDistance_px;
    meter_.charge(Work::kOther, 6LL * occupied_.size());
    if (!free) continue;
    const Vector2f normalised = config_.camera.unproject(px);
    const Vector3f ray(normalised.x(), normalised.y(), 1.0f);
    const PatchSource source{static_cast<int16_t>(keyframe), px, -ray.normalized()};
    if (map_.add_partial_point(source, ray, 1.0f / frame.mean_depth) < 0) co_return;
    occupied_.push_back(px);
    ++added;
  }
}

// Camera velocities during the keyframes' readout, against the present map [phone 6].
Task<> Mapper::update_velocities() {
  if (config_.camera.shutter.line_time_s == 0) co_return;
  for (int k = 0; k < map_.keyframes().size(); ++k) {
    const Keyframe& keyframe = map_.keyframes()[k];
    if (!keyframe.live()) continue;
    co_await gather_pose_points(k, pose_points_.capacity());
    VelocityPrior prior;
    prior.mean = keyframe.velocity_prior;
    prior.sigma_translation = kVelocitySigmaTranslation * keyframe.mean_depth;
    prior.sigma_rotation = kVelocitySigmaRotation;
    const PosePoints points(config_.camera, pose_points_);
    pose_.start(keyframe.T_kw, prior, points);
    while (!pose_.advance()) co_await slice();
    if (pose_.result().ok) map_.set_velocity(k, pose_.result().velocity);
    co_await slice();
  }
}

// Points that are expected to be seen and are not found. One that only two keyframes have measured is on trial: a wrong
// match that happened to lie on the epipolar line is found nowhere else.
Task<> Mapper::discard_unreliable_points() {
  for (int i = 0; i < map_.points().size(); ++i) {
    const MapPoint& point = map_.points()[i];
    const int enough = point.measurements.size() > 2 ? kMinAttempts : kMinAttemptsOfTwo;
    if (point.id != 0 && point.attempts >= enough &&
        static_cast<float>(point.found) < kMinReliability * static_cast<float>(point.attempts))
      map_.remove_point(i);
  }
  co_await spend(Work::kOther, 10LL * map_.points().size());
}

// Every point and its neighbours, in turn: what is one point becomes one, and the patch lies as they do.
Task<> Mapper::tidy_points() {
  for (; tidy_left_ > 0 && map_.queue().waiting() == 0; --tidy_left_) {
    const int i = tidy_next_;
    tidy_next_ = (tidy_next_ + 1) % map_.points().size();
    const MapPoint& point = map_.points()[i];
    if (point.id == 0) continue;
    const Neighbours neighbours = find_neighbours(map_, i);
    meter_.charge(Work::kOther, 12LL * map_.points().size() + 5000);
    Vector3f normal_k;
    if (fit_patch_normal(map_, neighbours, &normal_k)) map_.set_normal(i, normal_k);
    for (int n = 1; n < neighbours.size() && point.id != 0; ++n) merge_if_same(i, neighbours[n]);
    co_await spend(Work::kOther, 400LL * neighbours.size());
  }
}

// If they are the same physical point the one measured more often takes over the other's measurements.
void Mapper::merge_if_same(int a, int b) {
  const bool a_stays = map_.points()[a].measurements.size() >= map_.points()[b].measurements.size();
  const int stays = a_stays ? a : b, goes = a_stays ? b : a;
  if (!explains(map_, config_.camera, map_.points()[stays], map_.points()[goes])) return;
  // Taken out first: their places may be needed.
  Measurement taken[kMostMeasurements + 1];
  int count = 0;
  for (const Measurement& m : map_.measurements(map_.points()[goes]))
    if (!map_.measured_in(map_.points()[stays], m.keyframe)) taken[count++] = m;
  map_.remove_point(goes);
  for (int i = 0; i < count; ++i) {
    map_.add_measurement(stays, taken[i]);
    cull_measurements(map_, stays, config_.camera, meter_);
  }
}

}  // namespace pptam
