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
// Radius of the search, pixels of the level searched, within: half of the line's length plus the pose's error. Not
// swept.
constexpr float kMinRadius_px = 3.0f, kMaxRadius_px = 8.0f;
// Largest distance from the epipolar line, level-0 pixels: more than the pose's error is another patch. Not swept.
constexpr float kMaxAcross_px = 3.0f;
constexpr float kMinSlope_sq = 1e-12f;  // |d(px)/dq|^2 under which the line has no direction; guards a division
constexpr float kMinRange = 1e-6f;      // of inverse depths, relative to the mean; guards a division
// ARMv6, of a line's three predictions and its source's pose.
constexpr int64_t kLineInstructions = 3 * kPredictionInstructions + 600;

}  // namespace

void PartialAttempt::set_row(const Camera& camera, const SE3& T_cw, const Vector6f& velocity, PoseRow* row) const {
  row->set_point(camera, T_cw, velocity, p_w, at);
  const float depth_sq = depth_px.squaredNorm();
  if (row->components == 0 || depth_sq < kMinSlope_sq) return;
  // The component along the unit vector u shrinks to `share` of itself.
  const Vector2f u = depth_px / std::sqrt(depth_sq);
  const float sigma = at.sigma();
  const float share = 1 / std::sqrt(1 + depth_sq / (sigma * sigma));
  const auto shrink = [&](float* x, float* y) {
    const float along = (1 - share) * (u.x() * *x + u.y() * *y);
    *x -= along * u.x();
    *y -= along * u.y();
  };
  for (int c = 0; c < 6; ++c) shrink(&row->J[0][c], &row->J[1][c]);
  shrink(&row->e_0[0], &row->e_0[1]);
}

DepthFilter::DepthFilter(Arena& arena, const Config& config, Map& map, WorkMeter& meter)
    : config_(config),
      map_(map),
      meter_(meter),
      finder_(map, config, meter),
      attempts_(arena, config.max_measured_points + config.max_partial_searches) {}

Vector2f DepthFilter::Line::slope() const {
  return (at_near.px - at_far.px) / std::max(near - far, kMinRange * q);
}

DepthFilter::Place DepthFilter::project(const PartialPoint& partial, const SE3& T_cw, const Vector6f& velocity,
                                        float mean_depth, Line* line) const {
  const float mean_q = 1.0f / mean_depth;
  const float sigma = partial.information > 0 ? 1.0f / std::sqrt(partial.information) : kUnknownSigma;
  line->near = std::min(partial.inverse_depth + kRangeSigmas * sigma, kInverseDepthRange * mean_q);
  line->far = std::max(partial.inverse_depth - kRangeSigmas * sigma, mean_q / kInverseDepthRange);
  if (!(line->near >= line->far)) return Place::kOutOfRange;
  meter_.charge(Work::kOther, kLineInstructions);
  line->q = std::clamp(partial.inverse_depth, line->far, line->near);
  line->T_ws = exposed_pose(map_, config_.camera, partial.source);
  const auto at = [&](float q, PredictedPoint* predicted) {
    return config_.camera.project_rolling(T_cw, velocity, line->T_ws * Vector3f(partial.ray / q), predicted);
  };
  const bool visible = at(line->q, &line->at_q) && at(line->near, &line->at_near) && at(line->far, &line->at_far) &&
                       config_.camera.in_image(line->at_q.px, search_border_px(config_));
  return visible ? Place::kVisible : Place::kNotVisible;
}

void DepthFilter::search(const Pyramid& pyramid, const Start& start) {
  attempts_.clear();
  const int slots = map_.partial_points().size();
  const int count = std::min(start.count, attempts_.capacity());
  after_last_ = next_;
  for (int step = 0; step < slots && attempts_.size() < count; ++step) {
    const int slot = after_last_;
    after_last_ = (after_last_ + 1) % slots;
    if (map_.partial_points()[slot].id != 0) try_slot(slot, pyramid, start);
  }
}

void DepthFilter::try_slot(int slot, const Pyramid& pyramid, const Start& start) {
  const PartialPoint& partial = map_.partial_points()[slot];
  Line line;
  PartialAttempt attempt;
  attempt.slot = slot;
  attempt.id = partial.id;
  attempt.known = partial.found > 0;
  switch (project(partial, start.T_cw, start.velocity, start.mean_depth, &line)) {
    case Place::kOutOfRange:
      attempts_.push_back(attempt);  // to be removed
      return;
    case Place::kNotVisible:
      return;
    case Place::kVisible:
      break;
  }
  attempt.p_w = line.T_ws * Vector3f(partial.ray / line.q);
  attempt.predicted_px = line.at_q.px;
  attempt.depth_px = (line.at_near.px - line.at_far.px) / (2 * kRangeSigmas);
  SearchOptions options;
  options.level = start.level;
  const float half_length = 0.5f * (line.at_near.px - line.at_far.px).norm() / static_cast<float>(1 << options.level);
  options.radius_px = std::clamp(half_length + start.margin_px, kMinRadius_px, kMaxRadius_px);
  const SearchOutcome outcome = finder_.find(partial.source, attempt.p_w, line.at_q, pyramid, options, &attempt.at);
  if (outcome == SearchOutcome::kNotVisible) return;
  attempt.outcome =
      outcome == SearchOutcome::kFound ? PartialAttempt::Outcome::kFound : PartialAttempt::Outcome::kMissed;
  attempts_.push_back(attempt);
}

// lambda += J^2 / sigma^2, q += J e / (sigma^2 lambda), J = d(px)/dq along the epipolar line. False when the
// measurement lies off the line.
bool DepthFilter::correct(const PartialAttempt& attempt, const MotionModel& motion) {
  const PartialPoint& partial = map_.partial_points()[attempt.slot];
  Line line;
  if (project(partial, motion.T_cw(), motion.readout_velocity(), motion.mean_depth(), &line) != Place::kVisible)
    return false;
  const Vector2f J = line.slope(), e = attempt.at.px - line.at_q.px;
  const float J_sq = J.squaredNorm();
  const float across = J_sq > kMinSlope_sq ? std::abs(e.x() * J.y() - e.y() * J.x()) / std::sqrt(J_sq) : e.norm();
  if (!(across < kMaxAcross_px * config_.px_scale())) return false;
  const float variance = attempt.at.sigma() * attempt.at.sigma();
  const float information = partial.information + J_sq / variance;
  float inverse_depth = partial.inverse_depth;
  if (information > 0) inverse_depth = std::clamp(line.q + J.dot(e) / (variance * information), line.far, line.near);
  map_.set_depth(attempt.slot, inverse_depth, information);
  return true;
}

void DepthFilter::update(const MotionModel& motion, FixedVector<ObservedPoint>* observed, TrackResult* result) {
  next_ = after_last_;
  for (const PartialAttempt& attempt : attempts_) {
    if (attempt.outcome == PartialAttempt::Outcome::kOutOfRange) {
      map_.remove_partial_point(attempt.slot);  // its depth is outside of the scene's range
      continue;
    }
    ++result->partial_attempted;
    const bool accepted = attempt.outcome == PartialAttempt::Outcome::kFound && correct(attempt, motion);
    if (accepted) {
      ++result->partial_found;
      ObservedPoint seen;
      seen.px = attempt.at.px;
      seen.predicted_px = attempt.predicted_px;
      seen.point_id = attempt.id;
      seen.kind = ObservedKind::kPartial;
      seen.level = attempt.at.level;
      observed->push_back(seen);
    }
    map_.count_partial_search(attempt.slot, accepted);
    const PartialPoint& partial = map_.partial_points()[attempt.slot];
    if (partial.attempts - partial.found > kMaxFailures && partial.found * 2 < partial.attempts)
      map_.remove_partial_point(attempt.slot);
  }
}

}  // namespace pptam
