#include "mapping/neighbours.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

namespace pptam {

namespace {

// Largest distance of a neighbour, as a share of the point's distance from its source camera. Not swept.
constexpr float kReach = 0.25f;
constexpr int kMinOnPlane = 6;  // points, the middle one included, for a plane; not swept
// Points lie on a plane when their rms distance from it is below kMaxOffPlane of the distance from the camera, and
// their spread in the second direction is over kFlatness times that rms distance. Ratios, not swept.
constexpr float kMaxOffPlane = 0.01f;
constexpr float kFlatness = 5.0f;
// Cosine of the angle between viewing ray and plane normal: 66 degrees. At steeper views the normal is poorly known.
// Not swept.
constexpr float kMinCosSlant = 0.4f;

}  // namespace

Neighbours find_neighbours(const Map& map, int point) {
  const MapPoint& middle = map.points()[point];
  const Vector3f from_camera = middle.p_w - map.keyframes()[middle.source.keyframe].T_kw.centre();
  const float reach_sq = kReach * kReach * from_camera.squaredNorm();
  Neighbours near;
  float distance_sq[kNeighbours];
  near.push_back(point);
  distance_sq[0] = -1;
  for (int i = 0; i < map.points().size(); ++i) {
    if (map.points()[i].id == 0 || i == point) continue;
    const float d_sq = (map.points()[i].p_w - middle.p_w).squaredNorm();
    if (d_sq > reach_sq || (near.full() && d_sq >= distance_sq[kNeighbours - 1])) continue;
    if (!near.full()) near.push_back(i);
    int at = near.size() - 1;
    for (; distance_sq[at - 1] > d_sq; --at) {
      near[at] = near[at - 1];
      distance_sq[at] = distance_sq[at - 1];
    }
    near[at] = i;
    distance_sq[at] = d_sq;
  }
  return near;
}

bool fit_patch_normal(const Map& map, const Neighbours& neighbours, Vector3f* normal_k) {
  if (neighbours.size() < kMinOnPlane) return false;
  const float share = 1.0f / static_cast<float>(neighbours.size());
  Vector3f mean = Vector3f::Zero();
  for (const int i : neighbours) mean += share * map.points()[i].p_w;
  Matrix3f scatter = Matrix3f::Zero();
  for (const int i : neighbours) {
    const Vector3f d = map.points()[i].p_w - mean;
    scatter += share * d * d.transpose();
  }
  const Eigen::SelfAdjointEigenSolver<Matrix3f> solver(scatter);
  if (solver.info() != Eigen::Success) return false;
  const MapPoint& point = map.points()[neighbours[0]];
  const SE3& T_kw = map.keyframes()[point.source.keyframe].T_kw;
  const Vector3f p_k = T_kw * point.p_w;
  const float distance = p_k.norm();
  const float off_plane = std::sqrt(std::max(solver.eigenvalues()[0], 0.0f));
  if (!(off_plane < kMaxOffPlane * distance) ||
      !(solver.eigenvalues()[1] > kFlatness * kFlatness * off_plane * off_plane))
    return false;
  Vector3f normal = T_kw.R * solver.eigenvectors().col(0);
  if (normal.dot(p_k) > 0) normal = -normal;
  if (!(-normal.dot(p_k) > kMinCosSlant * distance)) return false;
  *normal_k = normal.normalized();
  return true;
}

bool explains(const Map& map, const Camera& camera, const MapPoint& point, const MapPoint& other) {
  for (const Measurement& m : map.measurements(other)) {
    const Keyframe& keyframe = map.keyframes()[m.keyframe];
    PredictedPoint seen;
    if (!camera.project_rolling(keyframe.T_kw, keyframe.velocity, point.p_w, &seen) ||
        !((seen.px - m.at.px).squaredNorm() < m.at.sigma() * m.at.sigma()))
      return false;
  }
  return true;
}

}  // namespace pptam
