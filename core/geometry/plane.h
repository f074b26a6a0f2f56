// Planes among points by consensus [ptam 6.1]: planes through three points are tried, and the best one is fitted to the
// points near it.
#pragma once

#include <cstdint>
#include <span>

#include <pocket_ptam/se3.h>

namespace pptam {

// normal . p = offset, with a unit normal that points away from the origin (offset >= 0).
struct Plane {
  Vector3f normal = Vector3f::UnitZ();
  float offset = 0;
  bool found = false;

  float beyond(const Vector3f& p) const { return normal.dot(p) - offset; }  // signed distance; > 0: on the far side
};

// Planes through three of the points, chosen by a fixed sequence, so that every run and every target finds the same.
class PlaneSampler {
 public:
  // size: of the points' distribution, such as their mean depth. The points must outlive the sampler.
  PlaneSampler(std::span<const Vector3f> points, float size) : points_(points), size_(size) {}
  // Not found where the three points lie nearly in a line, or where there are no points.
  Plane next();

 private:
  std::span<const Vector3f> points_;
  float size_;
  uint32_t state_ = 12345;
};

// Of the points for a plane.
struct PlaneSupport {
  int on = 0;      // points nearer than the threshold
  int beyond = 0;  // points on the far side, by more than kFarBeyond thresholds
  float near = 0;  // sum of their nearness, 1 on the plane and 0 at the threshold
};
PlaneSupport support_of(std::span<const Vector3f> points, const Plane& plane, float threshold);

// One least-squares fit to the points nearer than the threshold. weights: of each point; empty: all alike. False, with
// nothing changed, when there are fewer than kMinFittedPoints of them.
constexpr int kMinFittedPoints = 6;
bool fit_plane(std::span<const Vector3f> points, std::span<const float> weights, float threshold, Plane* plane);

}  // namespace pptam
