#include "edges/servoing.h"

#include <algorithm>
#include <cmath>

#include "geometry/robust.h"

namespace pptam {

namespace {

constexpr float kMinPivot = 1e-6f;  // smaller ones are float32's rounding
// 1-sigma of the covariance's prior: radians, and shares of the distance.
constexpr float kUntold = 0.5f;
// A step that moves the object's outline less than this, pixels, is the last.
constexpr float kConverged_px = 0.03f;
constexpr int kFewest = 6;               // measurements
constexpr float kLeastSigma_px = 0.05f;  // of the covariance: what sub-pixel refinement leaves
constexpr float kLikely = 0.2f;          // likelihood of an edge that takes part in the scale. Not swept
constexpr float kMaxTurn = 0.35f;        // radians in one step
// How much more a site's distance counts than its likelihood when it chooses among its edges: at first the likely, in
// the end the near. Not swept.
constexpr float kNearnessFirst = 0.3f, kNearnessLast = 3;

}  // namespace

Servoing::Servoing(Arena& arena, const ModelView& view, const ModelParts& parts, const ModelTrackerConfig& config)
    : view_(view),
      parts_(parts),
      method_(config.method),
      focal_(0.5f * (config.camera.model.fx + config.camera.model.fy)),
      placed_(arena, config.max_sites),
      squared_(arena, config.max_sites),
      first_rows_(arena, method_.constant_jacobian ? config.max_sites : 0) {}

ServoingResult Servoing::run(const SE3& T_start, const ServoingOptions& options,
                             FixedVector<EdgeMeasurement>* measurements) {
  options_ = options;
  measurements_ = measurements;
  result_ = {};
  result_.T_co = T_ = T_start;
  last_ = false;
  result_.ok = fit_.run(*this, std::max(measurements->size(), 1));
  return result_;
}

void Servoing::place(int contour) {
  Placed next;
  PlacedContour at;
  next.ok = view_.place(contour, T_, &at);
  next.straight = at.straight;
  if (next.ok) next.ok = at.straight ? next.line.set(at.a, at.b) : next.ellipse.set(at.a, at.b, at.radius);
  placed_.push_back(next);
}

// Distances from the contours; each site chooses among its edges.
bool Servoing::errors(int iteration) {
  iteration_ = iteration;
  const float progress =
      std::min(static_cast<float>(iteration) / static_cast<float>(std::max(options_.iterations - 1, 1)), 1.0f);
  const float nearness =
      (kNearnessFirst + (kNearnessLast - kNearnessFirst) * progress) / (options_.range_px * options_.range_px);
  placed_.clear();
  seen_ = 0;
  int contour = -1;
  for (EdgeMeasurement& m : *measurements_) {
    if (m.contour != contour) {
      contour = m.contour;
      place(contour);
    }
    const Placed& placed = placed_.back();
    m.placed = static_cast<uint16_t>(placed_.size() - 1);
    m.distance_px = INFINITY;
    if (!placed.ok) continue;
    ++seen_;
    float best = INFINITY;
    for (uint8_t k = 0; k < m.candidates; ++k) {
      const Vector2f& ray = m.ray[k];
      const float d = focal_ * (placed.straight ? placed.line.distance(ray.x(), ray.y())
                                                : placed.ellipse.distance(ray.x(), ray.y()));
      const float cost = nearness * d * d - m.edge[k].likelihood;
      if (!(cost < best)) continue;
      best = cost;
      m.chosen = k;
      m.distance_px = d;
    }
  }
  return seen_ >= kFewest;
}

// That of likely edges; of all, where these are few.
void Servoing::scale() {
  if (iteration_ == 0 || !method_.scale_once) {
    for (const float least : {kLikely, 0.0f}) {
      squared_.clear();
      for (const EdgeMeasurement& m : *measurements_)
        if (m.distance_px < INFINITY && m.edge[m.chosen].likelihood >= least)
          squared_.push_back(m.distance_px * m.distance_px);
      if (squared_.size() >= std::max(kFewest, seen_ / 5)) break;
    }
    sigma_px_ = std::max(robust_sigma_1d(squared_), kLeastSigma_px);
    result_.sigma_px = std::max(sigma_px_, options_.sigma_floor_px);
  }
  result_.inliers = 0;
  weights_ = 0;
  middle_ = T_ * parts_.middle();
  depth_ = std::max(middle_.z(), 0.1f * parts_.extent());
  equations_.clear();
}

// Of the edge that the site has chosen; of a constant Jacobian, in the first iteration.
void Servoing::interaction(int measurement, float (&L)[6]) {
  if (iteration_ > 0 && method_.constant_jacobian) {
    std::copy_n(first_rows_[measurement].data(), 6, L);
    return;
  }
  const EdgeMeasurement& m = (*measurements_)[measurement];
  const Vector2f& ray = m.ray[m.chosen];
  const Placed& placed = placed_[m.placed];
  if (placed.straight)
    placed.line.interaction(ray.x(), ray.y(), L);
  else
    placed.ellipse.interaction(ray.x(), ray.y(), L);
  if (method_.constant_jacobian) std::copy_n(L, 6, first_rows_[measurement].data());
}

void Servoing::sum(int from, int to) {
  const Tukey tukey(result_.sigma_px, kTukeyCutoff1d);
  const float unit = focal_ / result_.sigma_px;
  if (method_.constant_jacobian) first_rows_.resize(measurements_->size());
  for (int i = from; i < to; ++i) {
    EdgeMeasurement& m = (*measurements_)[i];
    const bool seen = m.distance_px < INFINITY;
    m.weight = !seen ? 0 : method_.no_weights ? 1 : tukey.weight(m.distance_px * m.distance_px);
    if (m.weight == 0 && !(seen && method_.constant_jacobian)) {
      if (method_.constant_jacobian && iteration_ == 0) first_rows_[i] = {};
      continue;
    }
    result_.inliers += m.weight > 0 ? 1 : 0;
    float L[6];
    interaction(i, L);
    // (v, w) about the camera's centre -> shift of the middle in depths, turn about it: L_w + L_v x c.
    const Vector3f L_v(L[0], L[1], L[2]);
    const Vector3f L_w = Vector3f(L[3], L[4], L[5]) + L_v.cross(middle_);
    const float row[6] = {unit * depth_ * L_v.x(), unit * depth_ * L_v.y(), unit * depth_ * L_v.z(),
                          unit * L_w.x(),          unit * L_w.y(),          unit * L_w.z()};
    const float likelihood = m.edge[m.chosen].likelihood, threshold = method_.likelihood_threshold;
    const float by_likelihood = threshold > 0 ? (likelihood >= threshold ? 1.0f : 0.0f) : likelihood;
    const float w = method_.no_weights ? 1 : m.weight * by_likelihood;
    const float d = m.distance_px / result_.sigma_px;
    weights_ += w * w;
    if (method_.constant_jacobian)
      equations_.add(row, w * d, 1);
    else
      equations_.add(row, d, w * w);
  }
}

// Adds the prior, that of the covariance in the last iteration, and solves. Where edges tell so little of a direction
// that float32 cannot tell it from none, the prior is tightened until it can.
bool Servoing::solve(Vector6f* x) {
  const Vector3f shift = (options_.T_prior * parts_.middle() - middle_) / depth_;
  const Vector3f turn = so3_log(options_.T_prior.R * T_.R.transpose());
  const float prior_shift = last_ ? kUntold : options_.prior_shift, prior_turn = last_ ? kUntold : options_.prior_turn;
  const NormalEquations<6> edges = equations_;
  for (float tighter = 1; tighter < 1e9f; tighter *= 10) {
    const float on_shift = tighter / (prior_shift * prior_shift), on_turn = tighter / (prior_turn * prior_turn);
    equations_ = edges;
    for (int i = 0; i < 3; ++i) {
      equations_.A(i, i) += on_shift;
      equations_.b(i) += on_shift * shift(i);
      equations_.A(i + 3, i + 3) += on_turn;
      equations_.b(i + 3) += on_turn * turn(i);
    }
    if (equations_.solve(kMinPivot, x->data())) return true;
  }
  return false;
}

// The equations are in units of the scale's floor, and their weights are relative. For the covariance: in units of the
// noise, with weights of 1 on average.
void Servoing::to_noise() {
  const float floor_sq = result_.sigma_px * result_.sigma_px / (sigma_px_ * sigma_px_);
  const float factor = floor_sq * static_cast<float>(result_.inliers) / std::max(weights_, 1e-6f);
  for (int i = 0; i < 6; ++i)
    for (int j = 0; j <= i; ++j) equations_.A(i, j) *= factor;
}

FitStep Servoing::step(int iteration) {
  if (result_.inliers < kFewest) return FitStep::kFailed;
  if (last_) to_noise();
  Vector6f x;
  if (!solve(&x)) return FitStep::kFailed;
  Matrix6f to_mu = Matrix6f::Identity();  // mu_v = depth x_v + c x x_w
  to_mu.topLeftCorner<3, 3>() *= depth_;
  to_mu.topRightCorner<3, 3>() = hat(middle_);
  if (last_) {
    finish(to_mu);
    return FitStep::kConverged;
  }
  const float turn = std::sqrt(x.tail<3>().squaredNorm()), shift = std::sqrt(x.head<3>().squaredNorm());
  const float largest = std::max(turn, shift);
  if (largest > kMaxTurn) x *= kMaxTurn / largest;
  T_ = SE3::exp(to_mu * x) * T_;
  T_.R = orthonormalised(T_.R);
  const float moved_px = focal_ * (shift + turn * parts_.extent() / depth_);
  last_ = moved_px < kConverged_px || iteration + 1 >= options_.iterations;
  return FitStep::kAgain;
}

void Servoing::finish(const Matrix6f& to_mu) {
  Matrix6f covariance;
  for (int i = 0; i < 6; ++i) {
    float column[6];
    equations_.covariance_column(i, 0, column);
    for (int j = 0; j < 6; ++j) covariance(j, i) = column[j];
  }
  result_.covariance = to_mu * covariance * to_mu.transpose();
  result_.T_co = T_;
}

}  // namespace pptam
