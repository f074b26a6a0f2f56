#include "edges/contour.h"

#include <cmath>

namespace pptam {

namespace {

// A line whose nearest point is this much closer than one of its points is seen end-on, squared ratio: 0.06 degrees.
constexpr float kEndOnSq = 1e-6f;
// tan of the angle between the axis and a line's plane through the centre, below which the line is outside any image.
constexpr float kFlattest = 0.05f;
// Ratio of a circle's distance to its plane and to its centre, below which it is seen edge-on: 0.6 degrees.
constexpr float kEdgeOn = 0.01f;

}  // namespace

bool LineContour::set(const Vector3f& a, const Vector3f& b) {
  const Vector3f n = a.cross(b);
  const Vector3f along = b - a;
  const float length_sq = along.squaredNorm();
  // n = |nearest| |along|: of the line's nearest point.
  const float far_sq = a.squaredNorm() > b.squaredNorm() ? a.squaredNorm() : b.squaredNorm();
  if (!(n.squaredNorm() > kEndOnSq * length_sq * far_sq)) return false;
  const float h = std::sqrt(n.x() * n.x() + n.y() * n.y());
  if (!(h > kFlattest * std::abs(n.z()))) return false;
  c = n.x() / h;
  s = n.y() / h;
  rho = -n.z() / h;
  // The plane through the line whose normal is the line's nearest point: A X + B Y + C Z + D = 0.
  const Vector3f plane = a - along * (along.dot(a) / length_sq);
  const float D = -plane.squaredNorm();
  const float l_theta = (plane.x() * s - plane.y() * c) / D;
  const float l_rho = (plane.x() * rho * c + plane.y() * rho * s + plane.z()) / D;
  const float theta_row[6] = {l_theta * c, l_theta * s, -l_theta * rho, -rho * c, -rho * s, -1};
  const float rho_row[6] = {l_rho * c, l_rho * s, -l_rho * rho, (1 + rho * rho) * s, -(1 + rho * rho) * c, 0};
  for (int i = 0; i < 6; ++i) {
    L_theta[i] = theta_row[i];
    L_rho[i] = rho_row[i];
  }
  return true;
}

void LineContour::interaction(float x, float y, float (&L)[6]) const {
  const float alpha = x * s - y * c;
  for (int i = 0; i < 6; ++i) L[i] = L_rho[i] + alpha * L_theta[i];
}

// The viewing cone of the circle is x^T M x = 0, M = k^2 I - k (Q n' + n Q') + (Q.Q - r^2) n n', k = n.Q; with M's
// upper left block A2 and right column b the ellipse has the centre -A2^-1 b and the squared axes -(m33 + b.g) A2^-1.
// Lengths are divided by the centre's distance first: their fourth powers would leave float32's range.
bool EllipseContour::set(const Vector3f& centre, const Vector3f& n, float radius) {
  const float unit = 1 / std::sqrt(centre.squaredNorm());
  const Vector3f Q = centre * unit;
  const float r = radius * unit;
  const float k = n.dot(Q);
  if (!(k * k > kEdgeOn * kEdgeOn)) return false;
  const float distance_sq = Q.squaredNorm();
  const float in_plane = r * std::sqrt(n.x() * n.x() + n.y() * n.y());  // its points' largest change of Z
  if (!(Q.z() > in_plane)) return false;
  const float e = distance_sq - r * r;
  const float m11 = k * k - 2 * k * Q.x() * n.x() + e * n.x() * n.x();
  const float m22 = k * k - 2 * k * Q.y() * n.y() + e * n.y() * n.y();
  const float m33 = k * k - 2 * k * Q.z() * n.z() + e * n.z() * n.z();
  const float m12 = -k * (Q.x() * n.y() + n.x() * Q.y()) + e * n.x() * n.y();
  const float m13 = -k * (Q.x() * n.z() + n.x() * Q.z()) + e * n.x() * n.z();
  const float m23 = -k * (Q.y() * n.z() + n.y() * Q.z()) + e * n.y() * n.z();
  const float det = m11 * m22 - m12 * m12;
  if (!(det > 0)) return false;
  xg = -(m22 * m13 - m12 * m23) / det;
  yg = -(m11 * m23 - m12 * m13) / det;
  const float scale = -(m33 + m13 * xg + m23 * yg) / det;
  mu20 = scale * m22;
  mu11 = -scale * m12;
  mu02 = scale * m11;
  if (!(mu20 > 0 && mu02 > 0 && mu20 * mu02 > mu11 * mu11)) return false;
  const float A = n.x() / k * unit, B = n.y() / k * unit, C = n.z() / k * unit;
  const float z = A * xg + B * yg + C;
  const float rows[5][6] = {{-z, 0, xg * z + A * mu20 + B * mu11, xg * yg + mu11, -(1 + xg * xg + mu20), yg},
                            {0, -z, yg * z + A * mu11 + B * mu02, 1 + yg * yg + mu02, -(xg * yg + mu11), -xg},
                            {-2 * (A * mu20 + B * mu11), 0, 2 * ((z + A * xg) * mu20 + B * xg * mu11),
                             2 * (xg * mu11 + yg * mu20), -4 * xg * mu20, 2 * mu11},
                            {-(A * mu11 + B * mu02), -(A * mu20 + B * mu11),
                             A * (3 * xg * mu11 + yg * mu20) + B * (xg * mu02 + 3 * yg * mu11) + 2 * C * mu11,
                             xg * mu02 + 3 * yg * mu11, -(3 * xg * mu11 + yg * mu20), mu02 - mu20},
                            {0, -2 * (A * mu11 + B * mu02), 2 * ((z + B * yg) * mu02 + A * yg * mu11), 4 * yg * mu02,
                             -2 * (xg * mu02 + yg * mu11), -2 * mu11}};
  for (int i = 0; i < 5; ++i)
    for (int j = 0; j < 6; ++j) L[i][j] = rows[i][j];
  return true;
}

float EllipseContour::algebraic(float x, float y) const {
  const float dx = x - xg, dy = y - yg;
  return mu02 * dx * dx + mu20 * dy * dy - 2 * mu11 * dx * dy + mu11 * mu11 - mu20 * mu02;
}

namespace {

// Length of the algebraic distance's gradient; at the centre, where it vanishes, that of a point near it.
float gradient(const EllipseContour& e, float dx, float dy) {
  const float gx = 2 * (e.mu02 * dx - e.mu11 * dy), gy = 2 * (e.mu20 * dy - e.mu11 * dx);
  const float least = 0.01f * (e.mu20 + e.mu02) * std::sqrt(e.mu20 + e.mu02);
  const float length = std::sqrt(gx * gx + gy * gy);
  return length > least ? length : least;
}

}  // namespace

float EllipseContour::distance(float x, float y) const {
  return algebraic(x, y) / gradient(*this, x - xg, y - yg);
}

void EllipseContour::interaction(float x, float y, float (&L_d)[6]) const {
  const float dx = x - xg, dy = y - yg;
  const float unit = 1 / gradient(*this, dx, dy);
  const float to_ellipse[5] = {2 * (mu11 * dy - mu02 * dx) * unit, 2 * (mu11 * dx - mu20 * dy) * unit,
                               (dy * dy - mu02) * unit, 2 * (mu11 - dx * dy) * unit, (dx * dx - mu20) * unit};
  for (int j = 0; j < 6; ++j) {
    L_d[j] = 0;
    for (int i = 0; i < 5; ++i) L_d[j] += to_ellipse[i] * L[i][j];
  }
}

bool cylinder_limb(const Vector3f& a, const Vector3f& b, float radius, int side, Vector3f* limb_a, Vector3f* limb_b) {
  const Vector3f u = (b - a) / std::sqrt((b - a).squaredNorm());
  const Vector3f P = a - u * u.dot(a);  // the axis' nearest point
  const float P_sq = P.squaredNorm();
  const float rest = P_sq - radius * radius;
  if (!(rest > 0.01f * radius * radius)) return false;
  const float root = std::sqrt(rest) * (side == 0 ? 1.0f : -1.0f);
  const Vector3f n = (radius * P + root * u.cross(P)) / P_sq;  // unit normal of the tangent plane
  *limb_a = a - n * n.dot(a);
  *limb_b = b - n * n.dot(b);
  return true;
}

bool sphere_outline(const Vector3f& centre, float radius, Vector3f* Q, Vector3f* n, float* r) {
  const float distance_sq = centre.squaredNorm();
  const float rest = distance_sq - radius * radius;
  if (!(rest > 0.01f * radius * radius)) return false;
  *Q = centre * (rest / distance_sq);
  *n = centre / std::sqrt(distance_sq);
  *r = radius * std::sqrt(rest / distance_sq);
  return true;
}

}  // namespace pptam
