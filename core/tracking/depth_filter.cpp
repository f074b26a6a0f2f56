#include "tracking/depth_filter.h"

#include <algorithm>
#include <cmath>

namespace pptam {

namespace {

// Failed searches after which a point that was missed more often than found is removed. Not swept.
constexpr int kMaxFailures = 12;
// Inverse depths are sought within mean / range to mean * range, mean being the scene's: a ratio, not swept. Larger
// values search longer lines and find more accidental matches; smaller ones lose near and far points.
constexpr float kInverseDepthRange = 2.5f;
constexpr int kRangeSigmas = 2;        // half length of the search along the line, in sigmas of the inverse depth
constexpr float kUnknownSigma = 1e9f;  // sigma of an unknown inverse depth, world units^-1: as good as infinite
// Radius of the search, pixels of the level searched: half of the line's length plus a margin for the pose's error.
// Not swept.
constexpr float kMargin_px = 2.0f, kMinRadius_px = 3.0f, kMaxRadius_px = 8.0f;
// Largest distance from the epipolar line, level-0 pixels: more than the pose's error is another patch. Not swept.
constexpr float kMaxAcross_px = 3.0f;
constexpr float kMinSlope_sq = 1e-12f;  // |d(px)/dq|^2 under which the line has no direction; guards a division
constexpr float kMinRange = 1e-6f;      // of inverse depths, relative to the mean; guards a division

}  // namespace

void DepthFilter::update(const Pyramid& pyramid, const MotionModel& motion, FixedVector<ObservedPoint>* observed,
                         TrackResult* result) {
  const int slots = map_.partial_points().size();
  for (int step = 0; step < slots && result->partial_attempted < config_.max_partial_searches; ++step) {
    const int slot = next_;
    next_ = (next_ + 1) % slots;
    if (map_.partial_points()[slot].id != 0) search(slot, pyramid, motion, observed, result);
  }
}

void DepthFilter::search(int slot, const Pyramid& pyramid, const MotionModel& motion,
                         FixedVector<ObservedPoint>* observed, TrackResult* result) {
  const PartialPoint& partial = map_.partial_points()[slot];
  const float mean_q = 1.0f / motion.mean_depth();
  const SE3 T_wk = map_.keyframes()[partial.source.keyframe].T_kw.inverse();
  const float sigma = partial.information > 0 ? 1.0f / std::sqrt(partial.information) : kUnknownSigma;
  const float q_near = std::min(partial.inverse_depth + kRangeSigmas * sigma, kInverseDepthRange * mean_q);
  const float q_far = std::max(partial.inverse_depth - kRangeSigmas * sigma, mean_q / kInverseDepthRange);
  if (!(q_near >= q_far)) {
    map_.remove_partial_point(slot);  // its depth is outside of the scene's range
    return;
  }
  const auto project_at = [&](float q, PredictedPoint* predicted) {
    return config_.camera.project_rolling(motion.T_cw(), motion.readout_velocity(), T_wk * Vector3f(partial.ray / q),
                                          predicted);
  };
  PredictedPoint predicted, nearest, farthest;
  const float q = std::clamp(partial.inverse_depth, q_far, q_near);
  if (!project_at(q, &predicted) || !project_at(q_near, &nearest) || !project_at(q_far, &farthest) ||
      !config_.camera.in_image(predicted.px, kSearchBorder_px))
    return;
  // J = d(px)/dq along the epipolar line: difference quotient over the range's ends.
  const Vector2f J = (nearest.px - farthest.px) / std::max(q_near - q_far, kMinRange * mean_q);
  SearchOptions options;
  options.level = config_.search_level;
  const float half_length = 0.5f * (nearest.px - farthest.px).norm() / static_cast<float>(1 << options.level);
  options.radius_px = std::clamp(half_length + kMargin_px, kMinRadius_px, kMaxRadius_px);
  ImagePoint at;
  const SearchOutcome outcome =
      finder_.find(partial.source, T_wk * Vector3f(partial.ray / q), predicted, pyramid, options, &at);
  if (outcome == SearchOutcome::kNotVisible) return;
  ++result->partial_attempted;
  bool accepted = false;
  if (outcome == SearchOutcome::kFound) {
    const Vector2f e = at.px - predicted.px;
    const float J_sq = J.squaredNorm();
    const float across = J_sq > kMinSlope_sq ? std::abs(e.x() * J.y() - e.y() * J.x()) / std::sqrt(J_sq) : e.norm();
    accepted = across < kMaxAcross_px;
    if (accepted) {
      ++result->partial_found;
      // lambda += J^2 / sigma^2, q += J e / (sigma^2 lambda)
      const float variance = at.sigma() * at.sigma();
      const float information = partial.information + J_sq / variance;
      float inverse_depth = partial.inverse_depth;
      if (information > 0) {
        const float gain = 1.0f / (variance * information);
        inverse_depth = std::clamp(q + gain * J.dot(e), q_far, q_near);
      }
      map_.set_depth(slot, inverse_depth, information);
      ObservedPoint seen;
      seen.px = at.px;
      seen.predicted_px = predicted.px;
      seen.point_id = partial.id;
      seen.kind = ObservedKind::kPartial;
      seen.level = at.level;
      observed->push_back(seen);
    }
  }
  map_.count_partial_search(slot, accepted);
  if (partial.attempts - partial.found > kMaxFailures && partial.found * 2 < partial.attempts)
    map_.remove_partial_point(slot);
}

}  // namespace pptam
