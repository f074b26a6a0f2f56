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

// Distances from the contours at T_co; each site chooses among its edges.
void Servoing::measure(const SE3& T_co, float nearness, FixedVector<EdgeMeasurement>* measurements) {
  placed_.clear();
  int contour = -1;
  for (EdgeMeasurement& m : *measurements) {
    if (m.contour != contour) {
      contour = m.contour;
      Placed next;
      PlacedContour place;
      next.ok = view_.place(contour, T_co, &place);
      next.straight = place.straight;
      if (next.ok)
        next.ok = place.straight ? next.line.set(place.a, place.b) : next.ellipse.set(place.a, place.b, place.radius);
      placed_.push_back(next);
    }
    const Placed& placed = placed_.back();
    float best = INFINITY;
    m.distance_px = INFINITY;
    for (int k = 0; k < m.candidates && placed.ok; ++k) {
      const float x = m.ray[k].x(), y = m.ray[k].y();
      const float d = focal_ * (placed.straight ? placed.line.distance(x, y) : placed.ellipse.distance(x, y));
      const float cost = nearness * d * d - m.edge[k].likelihood;
      if (cost < best) {
        best = cost;
        m.chosen = static_cast<uint8_t>(k);
        m.distance_px = d;
      }
    }
  }
}

ServoingResult Servoing::run(const SE3& T_start, const ServoingOptions& options,
                             FixedVector<EdgeMeasurement>* measurements) {
  ServoingResult result;
  result.T_co = T_start;
  if (measurements->size() < kFewest) return result;
  SE3 T = T_start;
  const float last = static_cast<float>(std::max(options.iterations - 1, 1));
  for (int iteration = 0;; ++iteration) {
    const float progress = std::min(static_cast<float>(iteration) / last, 1.0f);
    const float nearness =
        (kNearnessFirst + (kNearnessLast - kNearnessFirst) * progress) / (options.range_px * options.range_px);
    measure(T, nearness, measurements);
    // The scale is that of likely edges; of all, where these are few.
    int seen = 0;
    for (const float least : {kLikely, 0.0f}) {
      squared_.clear();
      seen = 0;
      for (const EdgeMeasurement& m : *measurements) {
        if (!(m.distance_px < INFINITY)) continue;
        ++seen;
        if (m.edge[m.chosen].likelihood >= least) squared_.push_back(m.distance_px * m.distance_px);
      }
      if (squared_.size() >= std::max(kFewest, seen / 5)) break;
    }
    if (seen < kFewest) return result;
    const float sigma = std::max(robust_sigma_1d(squared_), kLeastSigma_px);
    result.sigma_px = std::max(sigma, options.sigma_floor_px);
    const Tukey tukey(result.sigma_px, kTukeyCutoff1d);

    const Vector3f c = T * parts_.middle();  // turns are about the object's middle
    const float depth = std::max(c.z(), 0.1f * parts_.extent());
    equations_.clear();
    const float unit = focal_ / result.sigma_px;
    int index = -1, contour = -1;
    result.inliers = 0;
    float weights = 0;
    for (EdgeMeasurement& m : *measurements) {
      if (m.contour != contour) {
        contour = m.contour;
        ++index;
      }
      m.weight = m.distance_px < INFINITY ? tukey.weight(m.distance_px * m.distance_px) : 0;
      if (m.weight == 0) continue;
      ++result.inliers;
      float L[6];
      const Vector2f& ray = m.ray[m.chosen];
      const Placed& placed = placed_[index];
      if (placed.straight)
        placed.line.interaction(ray.x(), ray.y(), L);
      else
        placed.ellipse.interaction(ray.x(), ray.y(), L);
      // (v, w) about the camera's centre -> shift of the middle in depths, turn about it: L_w + L_v x c.
      const Vector3f L_v(L[0], L[1], L[2]);
      const Vector3f L_w = Vector3f(L[3], L[4], L[5]) + L_v.cross(c);
      const float row[6] = {unit * depth * L_v.x(), unit * depth * L_v.y(), unit * depth * L_v.z(),
                            unit * L_w.x(),         unit * L_w.y(),         unit * L_w.z()};
      const float w = m.weight * m.edge[m.chosen].likelihood;
      equations_.add(row, m.distance_px / result.sigma_px, w * w);
      weights += w * w;
    }
    if (result.inliers < kFewest) return result;
    const Vector3f shift_back = (options.T_prior * parts_.middle() - c) / depth;
    const Vector3f turn_back = so3_log(options.T_prior.R * T.R.transpose());
    for (int i = 0; i < 3; ++i) {
      const float on_shift = 1 / (options.prior_shift * options.prior_shift);
      const float on_turn = 1 / (options.prior_turn * options.prior_turn);
      equations_.A(i, i) += on_shift;
      equations_.b(i) += on_shift * shift_back(i);
      equations_.A(i + 3, i + 3) += on_turn;
      equations_.b(i + 3) += on_turn * turn_back(i);
    }
    float x[6];
    if (!equations_.solve(kMinPivot, x)) return result;
    const Matrix3f turn_to_shift = hat(c);  // mu_v = depth x_v + c x x_w
    Matrix6f to_mu = Matrix6f::Identity();
    to_mu.topLeftCorner<3, 3>() *= depth;
    to_mu.topRightCorner<3, 3>() = turn_to_shift;
    if (iteration == options.iterations) {  // the last one only weights
      Matrix6f covariance;
      for (int i = 0; i < 6; ++i) {
        float column[6];
        equations_.covariance_column(i, 0, column);
        for (int j = 0; j < 6; ++j) covariance(j, i) = column[j];
      }
      // The equations are in units of the scale's floor, and their weights are relative.
      const float unit_sq = sigma * sigma / (result.sigma_px * result.sigma_px);
      const float mean_weight = weights / static_cast<float>(result.inliers);
      result.covariance = to_mu * covariance * to_mu.transpose() * (unit_sq * mean_weight);
      result.T_co = T;
      result.ok = true;
      return result;
    }
    Vector6f step;
    for (int i = 0; i < 6; ++i) step(i) = x[i];
    const float turn = std::sqrt(step.tail<3>().squaredNorm());
    const float shift = std::sqrt(step.head<3>().squaredNorm());
    const float largest = std::max(turn, shift);
    if (largest > kMaxTurn) step *= kMaxTurn / largest;
    T = SE3::exp(to_mu * step) * T;
    T.R = orthonormalised(T.R);
    const float moved_px = focal_ * (shift + turn * parts_.extent() / depth);
    if (moved_px < kConverged_px && iteration + 1 < options.iterations) iteration = options.iterations - 1;
  }
}

}  // namespace pptam
