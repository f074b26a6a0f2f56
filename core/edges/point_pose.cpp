#include "edges/point_pose.h"

#include <algorithm>
#include <cmath>

#include "geometry/normal_equations.h"

namespace pptam {

namespace {

constexpr float kMinPointPivot = 1e-7f;
constexpr int kNewtonSteps = 15, kServoingSteps = 20;

// A frame on three points: first axis along the first side, third axis normal to them.
Matrix3f frame_of(const Vector3f (&p)[3]) {
  Matrix3f R;
  const Vector3f x = (p[1] - p[0]).normalized();
  const Vector3f z = x.cross(p[2] - p[0]).normalized();
  R.col(0) = x;
  R.col(1) = z.cross(x);
  R.col(2) = z;
  return R;
}

// Newton's method on the three distances; false when it does not end at a solution before the camera.
bool solve_distances(const Vector3f (&f)[3], const float (&side_sq)[3], Vector3f* l) {
  constexpr int kFirst[3] = {0, 1, 2}, kSecond[3] = {1, 2, 0};
  const float scale = std::max(side_sq[0], std::max(side_sq[1], side_sq[2]));
  for (int step = 0;; ++step) {
    Vector3f e;
    Matrix3f J = Matrix3f::Zero();
    for (int k = 0; k < 3; ++k) {
      const int i = kFirst[k], j = kSecond[k];
      const float cosine = f[i].dot(f[j]), li = (*l)(i), lj = (*l)(j);
      e(k) = li * li + lj * lj - 2 * li * lj * cosine - side_sq[k];
      J(k, i) = 2 * (li - lj * cosine);
      J(k, j) = 2 * (lj - li * cosine);
    }
    if (step == kNewtonSteps) return e.squaredNorm() < 1e-6f * scale * scale && l->minCoeff() > 0;
    const Vector3f a = J.row(0), b = J.row(1), c = J.row(2);
    const float det = a.dot(b.cross(c));
    if (!(std::abs(det) > 0)) return false;
    const Vector3f change = (e(0) * b.cross(c) + e(1) * c.cross(a) + e(2) * a.cross(b)) / det;
    const float largest = 0.5f * l->norm(), length = change.norm();
    if (!(length <= 1e6f * largest)) return false;
    *l -= length > largest ? Vector3f(change * (largest / length)) : change;
  }
}

// Sum of squared distances from the pixels, each at most limit_sq; the largest one.
float cost_of(const Camera& camera, const SE3& T, std::span<const Vector3f> points_o, std::span<const Vector2f> px,
              float* largest_sq) {
  float sum = 0;
  *largest_sq = 0;
  for (size_t i = 0; i < points_o.size(); ++i) {
    Vector2f at;
    const float e = camera.project(T * points_o[i], &at) ? (at - px[i]).squaredNorm() : 1e8f;
    sum += e;
    *largest_sq = std::max(*largest_sq, e);
  }
  return sum;
}

SE3 servoed(const Camera& camera, SE3 T, std::span<const Vector3f> points_o, std::span<const Vector2f> px) {
  float unused;
  float cost = cost_of(camera, T, points_o, px, &unused);
  for (int step = 0; step < kServoingSteps; ++step) {
    NormalEquations<6> equations;
    equations.clear();
    const Vector3f c = T * points_o[0];
    for (size_t i = 0; i < points_o.size(); ++i) {
      const Vector3f p = T * points_o[i];
      Vector2f at;
      Matrix23f J_px_p;
      if (!camera.project(p, &at, &J_px_p)) continue;
      const Matrix26f J = J_px_p * se3_point_jacobian(p - c);  // about the first point
      for (int k = 0; k < 2; ++k) {
        float row[6];
        for (int j = 0; j < 6; ++j) row[j] = J(k, j);
        equations.add(row, px[i](k) - at(k), 1);
      }
    }
    Vector6f mu;
    if (!equations.solve(kMinPointPivot, mu.data())) return T;
    mu.head<3>() += c.cross(mu.tail<3>());
    SE3 next = SE3::exp(mu) * T;
    next.R = orthonormalised(next.R);
    const float next_cost = cost_of(camera, next, points_o, px, &unused);
    if (!(next_cost < cost)) return T;
    T = next;
    cost = next_cost;
  }
  return T;
}

}  // namespace

bool pose_from_points(const Camera& camera, std::span<const Vector3f> points_o, std::span<const Vector2f> px,
                      float max_error_px, SE3* T_co) {
  const size_t count = points_o.size();
  if (count < 4 || px.size() != count) return false;
  // The three whose triangle is largest in the image.
  size_t chosen[3] = {0, 1, 2};
  float largest = 0;
  for (size_t i = 0; i < count; ++i)
    for (size_t j = i + 1; j < count; ++j)
      for (size_t k = j + 1; k < count; ++k) {
        const Vector2f a = px[j] - px[i], b = px[k] - px[i];
        const Vector3f normal = (points_o[j] - points_o[i]).cross(points_o[k] - points_o[i]);
        const float area = std::abs(a.x() * b.y() - a.y() * b.x());
        if (!(area > largest) || !(normal.squaredNorm() > 0)) continue;
        largest = area;
        chosen[0] = i;
        chosen[1] = j;
        chosen[2] = k;
      }
  if (!(largest > 1)) return false;
  Vector3f p[3], f[3];
  for (int i = 0; i < 3; ++i) {
    p[i] = points_o[chosen[i]];
    const Vector2f ray = camera.unproject(px[chosen[i]]);
    f[i] = Vector3f(ray.x(), ray.y(), 1).normalized();
  }
  const float side_sq[3] = {(p[1] - p[0]).squaredNorm(), (p[2] - p[1]).squaredNorm(), (p[0] - p[2]).squaredNorm()};
  // As far away as the longest side at a right angle to the ray would be.
  float distance = 0;
  for (int k = 0; k < 3; ++k) {
    const float angle = std::sqrt((f[(k + 1) % 3] - f[k]).squaredNorm());
    if (angle > 0) distance = std::max(distance, std::sqrt(side_sq[k]) / angle);
  }
  float least = INFINITY;
  const Matrix3f from = frame_of(p);
  for (int start = 0; start < 27; ++start) {
    const int near[3] = {start % 3, start / 3 % 3, start / 9};
    Vector3f l;
    for (int k = 0; k < 3; ++k) l(k) = distance * (0.7f + 0.3f * static_cast<float>(near[k]));
    if (!solve_distances(f, side_sq, &l)) continue;
    const Vector3f q[3] = {f[0] * l(0), f[1] * l(1), f[2] * l(2)};
    SE3 T;
    T.R = frame_of(q) * from.transpose();
    T.t = q[0] - T.R * p[0];
    T = servoed(camera, T, points_o, px);
    float largest_sq;
    const float cost = cost_of(camera, T, points_o, px, &largest_sq);
    if (cost < least && largest_sq <= max_error_px * max_error_px) {
      least = cost;
      *T_co = T;
    }
  }
  return least < INFINITY;
}

}  // namespace pptam
