#include "mapping/partial_points.h"

#include <algorithm>
#include <cmath>

#include "base/sort.h"
#include "mapping/point_triangulation.h"

namespace pptam {

namespace {

// Distance of a new corner from the points in the image, level-0 px: "sufficiently far" [phone 5.2]. Not swept.
constexpr float kMinCornerDistance_px = 10.0f;
// Reprojection error of a triangulated point, level-0 px: two sigma of level 1. More is off the epipolar line. Not
// swept.
constexpr float kMaxPromotionError_px = 4.0f;
// Noise of a measurement, level-0 px: sub-pixel noise and the error of the rolling shutter's correction. Not swept.
constexpr float kMeasurementNoise_px = 0.8f;
// Radius of the search, pixels of the level searched [phone 4]: where the depth is known, or where the line's length is
// not. Otherwise a margin for the pose's error, plus the length that one sigma of the inverse depth has in the image,
// within bounds. The margin and bounds are not swept.
constexpr float kSearchRadius_px = 4;
constexpr float kMargin_px = 2.0f, kMinRadius_px = 3.0f, kMaxRadius_px = 8.0f;
constexpr int64_t kExposedPoseInstructions = 600;  // of one exposed_pose(): an estimate
constexpr int64_t kSurfacePointInstructions = 60;  // of a point of the surface that a keyframe sees: an estimate
// Points from which on a plane is fitted to those of a keyframe; a pull of its slopes towards an even depth, in units
// of a point's share; least pivot (NormalEquations); and bounds of an inverse depth on it, times the mean and its
// inverse. None was swept.
constexpr int kMinPlanePoints = 8;
constexpr float kEvenDepthPull = 0.002f;
constexpr float kMinPlanePivot = 1e-5f;
constexpr float kPlaneRange = 2.0f;
constexpr int64_t kCornerDistanceInstructions = 6;  // of a new corner from one occupied position: an estimate

}  // namespace

void SeenSurface::clear() {
  equations_.clear();
  points_ = 0;
}

void SeenSurface::add(const Vector3f& p_c) {
  const float q = 1 / p_c.z();
  equations_.add({1, p_c.x() * q, p_c.y() * q}, q, 1);
  ++points_;
}

void SeenSurface::fit(float mean_q) {
  mean_q_ = mean_q;
  const float pull = kEvenDepthPull * static_cast<float>(points_);
  equations_.A(1, 1) += pull;
  equations_.A(2, 2) += pull;
  if (points_ >= kMinPlanePoints && equations_.solve(kMinPlanePivot, plane_)) return;
  plane_[0] = mean_q;
  plane_[1] = plane_[2] = 0;
}

float SeenSurface::inverse_depth(const Vector2f& at) const {
  return std::clamp(plane_[0] + plane_[1] * at.x() + plane_[2] * at.y(), mean_q_ / kPlaneRange, mean_q_ * kPlaneRange);
}

PartialPoints::PartialPoints(Arena& arena, const Config& config, Map& map, WorkMeter& meter, Background& background,
                             CornerSource* corner_source)
    : config_(config),
      map_(map),
      meter_(meter),
      background_(background),
      corner_source_(corner_source),
      finder_(map, config, meter),
      occupied_(arena, config.max_map_points + config.max_partial_points),
      out_of_view_(arena, config.max_partial_points) {}

Task<> PartialPoints::grow(int keyframe) {
  co_await promote_all(keyframe);
  co_await add_corners(keyframe);
}

Task<> PartialPoints::promote_all(int keyframe) {
  for (int i = 0; i < map_.partial_points().size(); ++i) {
    const PartialPoint& partial = map_.partial_points()[i];
    if (partial.id == 0 || partial.source.keyframe == keyframe) continue;
    co_await background_.slice();
    if (partial.id != 0 && !promote(i, keyframe)) co_return;  // the tracker may have removed it during the pause
  }
}

// Searches a partial point in the new keyframe. If it is found it is triangulated against its source keyframe and
// becomes a map point; the filter's depth serves for the search only [phone 5.2]. If the source keyframe has been
// erased, the point is also measured in the live keyframe nearest to it, since a map point needs two measurements in
// live keyframes. False when the map can take no more points.
bool PartialPoints::promote(int i, int keyframe) {
  const Camera& camera = config_.camera;
  const PartialPoint& partial = map_.partial_points()[i];
  const Keyframe& source = map_.keyframes()[partial.source.keyframe];
  const Keyframe& target = map_.keyframes()[keyframe];
  const SE3 T_we = exposed_pose(map_, camera, partial.source);
  Vector3f p_w = T_we * Vector3f(partial.ray / partial.inverse_depth);
  PredictedPoint predicted;
  meter_.charge(Work::kOther, 2 * kPredictionInstructions + kExposedPoseInstructions);
  if (!predict_in_keyframe(map_, config_, keyframe, p_w, &predicted)) return true;
  // The search's circle reaches two sigmas of the inverse depth along the epipolar line, on either side.
  const float sigma_q = partial.information > 0 ? 1.0f / std::sqrt(partial.information) : partial.inverse_depth;
  const Vector3f further_w = T_we * Vector3f(partial.ray / (partial.inverse_depth + sigma_q));
  PredictedPoint further;
  SearchOptions options;
  options.level = config_.search_level;
  options.radius_px = kSearchRadius_px;
  if (predict_in_keyframe(map_, config_, keyframe, further_w, &further))
    options.radius_px =
        std::clamp(kMargin_px + (further.px - predicted.px).norm() / config_.px_scale(), kMinRadius_px, kMaxRadius_px);
  ImagePoint found;
  const SearchOutcome outcome = finder_.find(partial.source, p_w, predicted, target.pyramid, options, &found);
  if (outcome == SearchOutcome::kNotVisible) return true;
  map_.count_partial_search(i, outcome == SearchOutcome::kFound);
  if (outcome == SearchOutcome::kNotFound) return true;
  meter_.charge(Work::kOther, kTriangulationInstructions);
  const float noise_px = kMeasurementNoise_px * config_.px_scale();
  const float max_error_px = kMaxPromotionError_px * config_.px_scale();
  const PointMeasurements measured{
      partial.source.keyframe, keyframe, partial.source.px, found.px, noise_px, max_error_px};
  const PointDepth depth = triangulate_point(map_, camera, measured, &p_w);
  if (depth == PointDepth::kOffTheLine) map_.count_partial_search(i, false);  // a wrong match
  if (depth != PointDepth::kKnown) return true;
  Measurement first{{partial.source.px, static_cast<uint8_t>(config_.search_level)}, partial.source.keyframe};
  if (!source.live()) {
    first.keyframe = static_cast<int16_t>(map_.nearest_live(partial.source.keyframe, keyframe));
    options.radius_px = kSearchRadius_px;
    if (!predict_in_keyframe(map_, config_, first.keyframe, p_w, &predicted) ||
        finder_.find(partial.source, p_w, predicted, map_.keyframes()[first.keyframe].pyramid, options, &first.at) !=
            SearchOutcome::kFound ||
        (first.at.px - predicted.px).norm() > max_error_px) {
      map_.count_partial_search(i, false);
      return true;
    }
  }
  const int point = map_.add_point(p_w, partial.source);
  if (point < 0) return false;
  map_.add_measurement(point, first);
  map_.add_measurement(point, {found, static_cast<int16_t>(keyframe)});
  map_.remove_partial_point(i);
  return true;
}

// Collects for add_corners(): where the keyframe measures map points and shows partial points, and the partial points
// that it does not show; and the surface of the measured points. A map point that was not found leaves its place to a
// new one.
Task<> PartialPoints::find_occupied(int keyframe) {
  occupied_.clear();
  out_of_view_.clear();
  surface_.clear();
  const SE3& T_kw = map_.keyframes()[keyframe].T_kw;
  PredictedPoint predicted;
  for (const MapPoint& point : map_.points()) {
    if (point.id == 0 || !map_.measured_in(point, keyframe)) continue;
    if (predict_in_keyframe(map_, config_, keyframe, point.p_w, &predicted)) {
      occupied_.push_back(predicted.px);
      surface_.add(T_kw * point.p_w);
    }
    co_await background_.spend(Work::kOther, kPredictionInstructions + kSurfacePointInstructions);
  }
  for (int i = 0; i < map_.partial_points().size(); ++i) {
    const PartialPoint& partial = map_.partial_points()[i];
    if (partial.id == 0) continue;
    const Vector3f p_w =
        exposed_pose(map_, config_.camera, partial.source) * Vector3f(partial.ray / partial.inverse_depth);
    if (predict_in_keyframe(map_, config_, keyframe, p_w, &predicted)) {
      occupied_.push_back(predicted.px);
    } else {
      out_of_view_.push_back({partial.id, i});
    }
    co_await background_.spend(Work::kOther, kPredictionInstructions + kExposedPoseInstructions);
  }
}

// Removes the oldest partial points out of view until there is room for a keyframe's new ones. They may be seen again;
// the scenery in view is needed now.
void PartialPoints::make_room() {
  int room = 0;
  for (const PartialPoint& partial : map_.partial_points()) room += partial.id == 0;
  sort_list(out_of_view_, [](const OutOfView& a, const OutOfView& b) { return a.id < b.id; });
  for (const OutOfView& old : out_of_view_) {
    if (room >= config_.max_new_partial_points) return;
    if (map_.partial_points()[old.slot].id == old.id) map_.remove_partial_point(old.slot);
    ++room;
  }
}

// Adds up to Config::max_new_partial_points corners of the keyframe that are far enough from all points [phone 5.2].
Task<> PartialPoints::add_corners(int keyframe) {
  const Keyframe& frame = map_.keyframes()[keyframe];
  co_await find_occupied(keyframe);
  make_room();
  surface_.fit(1 / frame.mean_depth);
  corner_source_->start(frame.pyramid);
  const float distance_px = kMinCornerDistance_px * config_.px_scale();
  int added = 0;
  Corner corner;
  while (added < config_.max_new_partial_points) {
    const CornerProgress progress = corner_source_->advance(&corner);
    co_await background_.slice();
    if (progress == CornerProgress::kEnd) break;
    if (progress != CornerProgress::kFound) continue;
    const Vector2f px = corner.px();
    bool free = true;
    for (const Vector2f& other : occupied_) free = free && (other - px).squaredNorm() > distance_px * distance_px;
    meter_.charge(Work::kOther, kCornerDistanceInstructions * occupied_.size());
    if (!free) continue;
    const Vector2f normalised = config_.camera.unproject(px);
    const Vector3f ray(normalised.x(), normalised.y(), 1.0f);
    const PatchSource source{static_cast<int16_t>(keyframe), px, -ray.normalized()};
    if (map_.add_partial_point(source, ray, surface_.inverse_depth(normalised)) < 0) co_return;
    occupied_.push_back(px);
    ++added;
  }
}

PointSource* create_partial_points(Arena& arena, const Config& config, Map& map, WorkMeter& meter,
                                   Background& background, CornerSource* corner_source) {
  return arena.create<PartialPoints>(config, map, meter, background, corner_source);
}

}  // namespace pptam
