#include "geometry/plane.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

namespace pptam {

namespace {

// Smallest cross product of two sides of a sampled triangle, in squared sizes: less has no direction. Not swept.
constexpr float kMinTriangleCross = 1e-3f;
// How far beyond a plane a point speaks against its being a ground, in thresholds. Not swept.
constexpr float kFarBeyond = 2.0f;
// Fixed pseudo-random sequence of 32 bits, x <- a x + c, of which the upper 24 bits are used.
constexpr uint32_t kSequenceFactor = 1664525u, kSequenceIncrement = 1013904223u;
constexpr int kSequenceShift = 8;

Plane away_from_origin(const Vector3f& normal, float offset) {
  return offset < 0 ? Plane{-normal, -offset, true} : Plane{normal, offset, true};
}

}  // namespace

Plane PlaneSampler::next() {
  if (points_.empty()) return {};
  size_t chosen[3];
  for (size_t& i : chosen) {
    state_ = state_ * kSequenceFactor + kSequenceIncrement;
    i = (state_ >> kSequenceShift) % static_cast<uint32_t>(points_.size());
  }
  const Vector3f p = points_[chosen[0]];
  const Vector3f cross = (points_[chosen[1]] - p).cross(points_[chosen[2]] - p);
  if (!(cross.norm() > kMinTriangleCross * size_ * size_)) return {};
  const Vector3f normal = cross.normalized();
  return away_from_origin(normal, normal.dot(p));
}

PlaneSupport support_of(std::span<const Vector3f> points, const Plane& plane, float threshold) {
  PlaneSupport support;
  for (const Vector3f& p : points) {
    const float beyond = plane.beyond(p);
    support.on += std::abs(beyond) < threshold;
    support.near += std::max(1.0f - std::abs(beyond) / threshold, 0.0f);
    support.beyond += beyond > kFarBeyond * threshold;
  }
  return support;
}

bool fit_plane(std::span<const Vector3f> points, std::span<const float> weights, float threshold, Plane* plane) {
  const auto near = [&](const Vector3f& p) { return !(std::abs(plane->beyond(p)) > threshold); };
  const auto weight_of = [&](size_t i) { return weights.empty() ? 1.0f : weights[i]; };
  Vector3f mean = Vector3f::Zero();
  float sum = 0;
  int inliers = 0;
  for (size_t i = 0; i < points.size(); ++i) {
    if (!near(points[i])) continue;
    mean += weight_of(i) * points[i];
    sum += weight_of(i);
    ++inliers;
  }
  if (inliers < kMinFittedPoints || !(sum > 0)) return false;
  mean /= sum;
  Matrix3f scatter = Matrix3f::Zero();
  for (size_t i = 0; i < points.size(); ++i) {
    if (!near(points[i])) continue;
    const Vector3f& p = points[i];
    scatter += weight_of(i) * ((p - mean) * (p - mean).transpose());
  }
  const Eigen::SelfAdjointEigenSolver<Matrix3f> solver(scatter);
  if (solver.info() != Eigen::Success) return false;
  const Vector3f normal = solver.eigenvectors().col(0);
  *plane = away_from_origin(normal, normal.dot(mean));
  return true;
}

}  // namespace pptam
