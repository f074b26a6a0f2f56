#include "edges/servoing.h"

#include <algorithm>
#include <cmath>

#include "geometry/robust.h"

namespace pptam {

namespace {

constexpr float kMinPivot = 1e-6f;
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

Servoing::Servoing(Arena& arena, const ModelView& view, const ModelParts& parts, const Camera& camera, int max_sites)
    : view_(view),
      parts_(parts),
      focal_(0.5f * (camera.model.fx + camera.model.fy)),
      placed_(arena, max_sites),
      squared_(arena, max_sites) {}

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
  for (const float least : {kLikely, 0.0f}) {
    squared_.clear();
    for (const EdgeMeasurement& m : *measurements_)
      if (m.distance_px < INFINITY && m.edge[m.chosen].likelihood >= least)
        squared_.push_back(m.distance_px * m.distance_px);
    if (squared_.size() >= std::max(kFewest, seen_ / 5)) break;
  }
  sigma_px_ = std::max(robust_sigma_1d(squared_), kLeastSigma_px);
  result_.sigma_px = std::max(sigma_px_, options_.sigma_floor_px);
  result_.inliers = 0;
  weights_ = 0;
  middle_ = T_ * parts_.middle();
  depth_ = std::max(middle_.z(), 0.1f * parts_.extent());
  equations_.clear();
}

void Servoing::sum(int from, int to) {
  const Tukey tukey(result_.sigma_px, kTukeyCutoff1d);
  const float unit = focal_ / result_.sigma_px;
  int index = -1, contour = -1;
  for (int i = from; i < to; ++i) {
    EdgeMeasurement& m = (*measurements_)[i];
    if (m.contour != contour) {
      contour = m.contour;
      ++index;
    }
    m.weight = m.distance_px < INFINITY ? tukey.weight(m.distance_px * m.distance_px) : 0;
    if (m.weight == 0) continue;
    ++result_.inliers;
    float L[6];
    const Vector2f& ray = m.ray[m.chosen];
    const Placed& placed = placed_[index];
    if (placed.straight)
      placed.line.interaction(ray.x(), ray.y(), L);
    else
      placed.ellipse.interaction(ray.x(), ray.y(), L);
    // (v, w) about the camera's centre -> shift of the middle in depths, turn about it: L_w + L_v x c.
    const Vector3f L_v(L[0], L[1], L[2]);
    const Vector3f L_w = Vector3f(L[3], L[4], L[5]) + L_v.cross(middle_);
    const float row[6] = {unit * depth_ * L_v.x(), unit * depth_ * L_v.y(), unit * depth_ * L_v.z(),
                          unit * L_w.x(),          unit * L_w.y(),          unit * L_w.z()};
    const float w = m.weight * m.edge[m.chosen].likelihood;
    equations_.add(row, m.distance_px / result_.sigma_px, w * w);
    weights_ += w * w;
  }
}

void Servoing::add_prior() {
  const Vector3f shift = (options_.T_prior * parts_.middle() - middle_) / depth_;
  const Vector3f turn = so3_log(options_.T_prior.R * T_.R.transpose());
  const float on_shift = 1 / (options_.prior_shift * options_.prior_shift);
  const float on_turn = 1 / (options_.prior_turn * options_.prior_turn);
  for (int i = 0; i < 3; ++i) {
    equations_.A(i, i) += on_shift;
    equations_.b(i) += on_shift * shift(i);
    equations_.A(i + 3, i + 3) += on_turn;
    equations_.b(i + 3) += on_turn * turn(i);
  }
}

FitStep Servoing::step(int iteration) {
  if (result_.inliers < kFewest) return FitStep::kFailed;
  add_prior();
  Vector6f x;
  if (!equations_.solve(kMinPivot, x.data())) return FitStep::kFailed;
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

// The equations are in units of the scale's floor, and their weights are relative.
void Servoing::finish(const Matrix6f& to_mu) {
  Matrix6f covariance;
  for (int i = 0; i < 6; ++i) {
    float column[6];
    equations_.covariance_column(i, 0, column);
    for (int j = 0; j < 6; ++j) covariance(j, i) = column[j];
  }
  const float unit_sq = sigma_px_ * sigma_px_ / (result_.sigma_px * result_.sigma_px);
  const float mean_weight = weights_ / static_cast<float>(result_.inliers);
  result_.covariance = to_mu * covariance * to_mu.transpose() * (unit_sq * mean_weight);
  result_.T_co = T_;
}

}  // namespace pptam
