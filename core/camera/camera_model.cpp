#include <cmath>

#include <pocket_ptam/camera_model.h>
#include "base/assert.h"
#include "base/deterministic_math.h"

namespace pptam {
namespace {

constexpr float kMaxSize = 8192.0f;         // pixels across or down; not swept
constexpr float kMaxFovW = 3.1f;            // radians; at pi the FOV model's tan(w/2) is infinite
constexpr float kMaxCornerRadius = 11.43f;  // tan(85 degrees): the field of view is under 170 degrees. Not swept
// Ratio of the largest radius that project() accepts to that of the farthest image corner. Not swept.
constexpr float kRadiusMargin = 1.5f;
constexpr float kMinRadius_px = 1.0f;  // pixels, for an image of one pixel, whose corner is its centre
constexpr float kMaxRadius = kMaxCornerRadius * kRadiusMargin;  // normalised, of any model
// Ratio of a corner's radius to the fold's: a corner this near to the fold lies on or beyond it, as undistort() stops
// there. Below 1 by more than the scan step of fold_radius().
constexpr float kFoldFraction = 0.98f;
// Newton's method stops after a step from this error (normalised coordinates, squared) or after kNewtonSteps. It
// converges quadratically, so what is left is under 1e-7 even where the distortion's slope is 0.05. Real lenses take
// two or three steps.
constexpr float kNewtonErrorSq = 1e-10f;
constexpr int kNewtonSteps = 10;
constexpr float kMaxRoundTripErrorSq = 1e-4f;  // (0.01 px)^2 at the border, well under the noise of a measurement
// Squared radius (times k^2 for the FOV model) below which gain and slope come from a series, because the exact slope
// is a difference of nearly equal numbers. The terms left out are below 1e-9 for coefficients of order 1.
constexpr float kMaxSeriesRadiusSq = 1e-3f;
constexpr float kMinFoldDeterminant = 1e-6f;  // of d(distorted)/d(x), 0 at the fold: Newton stops there. Not swept
constexpr float kMinDistortedRadius = 1e-6f;  // normalised; nearer to the centre the gain is that of the centre

// A radial distortion maps normalised x to gain * x. slope = d(gain)/d(radius) / radius, so that
// d(distorted)/d(x) = gain I + slope x x^T.
struct Radial {
  float gain;
  float slope;
};

// FOV model [ptam eq. 5]: r' = atan(k r) / w with k = 2 tan(w/2), as a series in (k r)^2 near the centre.
Radial fov_radial(float r_sq, float w, float k) {
  const float s = k * k * r_sq;
  if (s < kMaxSeriesRadiusSq) {
    const float k_w = k / w;
    return {k_w * (1.0f - s * (1.0f / 3.0f - s * 0.2f)), k_w * k * k * (-2.0f / 3.0f + s * (0.8f - s * (6.0f / 7.0f)))};
  }
  const float r = std::sqrt(r_sq);
  const float gain = det_atan(k * r) / (w * r);
  return {gain, (k / (w * (1.0f + s)) - gain) / r_sq};
}

// Radial part of the radial-tangential model: 1 + k1 r^2 + k2 r^4 + k3 r^6.
Radial radtan_radial(float r_sq, const float* c) {
  return {1.0f + r_sq * (c[0] + r_sq * (c[1] + r_sq * c[4])), 2.0f * c[0] + r_sq * (4.0f * c[1] + r_sq * 6.0f * c[4])};
}

// Distorted angle of the equidistant model, theta (1 + k1 theta^2 + ...), and its derivative.
float equidistant_angle(float theta, const float* c) {
  const float s = theta * theta;
  return theta * (1.0f + s * (c[0] + s * (c[1] + s * (c[2] + s * c[3]))));
}
float equidistant_angle_derivative(float theta, const float* c) {
  const float s = theta * theta;
  return 1.0f + s * (3.0f * c[0] + s * (5.0f * c[1] + s * (7.0f * c[2] + s * 9.0f * c[3])));
}

// Equidistant model: r' = angle(atan(r)), as a series to r^4 near the centre.
Radial equidistant_radial(float r_sq, const float* c) {
  if (r_sq < kMaxSeriesRadiusSq) {
    const float a = c[0] - 1.0f / 3.0f;  // coefficient of r^2
    const float b = c[1] - c[0] + 0.2f;  // coefficient of r^4
    return {1.0f + r_sq * (a + r_sq * b), 2.0f * a + r_sq * 4.0f * b};
  }
  const float r = std::sqrt(r_sq);
  const float theta = det_atan(r);
  const float gain = equidistant_angle(theta, c) / r;
  return {gain, (equidistant_angle_derivative(theta, c) / (1.0f + r_sq) - gain) / r_sq};
}

// Distorted normalised coordinates of x. D, unless null, is d(distorted)/d(x).
Vector2f distort(const CameraModel& camera, const Vector2f& x, Matrix2f* D) {
  const float r_sq = x.dot(x);
  const float* c = camera.coeffs;
  Radial radial = {1.0f, 0.0f};
  if (camera.distortion == Distortion::kFov) radial = fov_radial(r_sq, c[0], camera.fov_gain);
  if (camera.distortion == Distortion::kRadTan) radial = radtan_radial(r_sq, c);
  if (camera.distortion == Distortion::kEquidistant) radial = equidistant_radial(r_sq, c);
  Vector2f distorted = radial.gain * x;
  if (D) *D = radial.gain * Matrix2f::Identity() + radial.slope * (x * x.transpose());
  if (camera.distortion == Distortion::kRadTan) {
    const float p1 = c[2];
    const float p2 = c[3];
    distorted.x() += 2.0f * p1 * x.x() * x.y() + p2 * (r_sq + 2.0f * x.x() * x.x());
    distorted.y() += p1 * (r_sq + 2.0f * x.y() * x.y()) + 2.0f * p2 * x.x() * x.y();
    if (D) {
      const float diagonal = 2.0f * (p1 * x.x() + p2 * x.y());
      (*D)(0, 0) += 2.0f * p1 * x.y() + 6.0f * p2 * x.x();
      (*D)(0, 1) += diagonal;
      (*D)(1, 0) += diagonal;
      (*D)(1, 1) += 6.0f * p1 * x.y() + 2.0f * p2 * x.x();
    }
  }
  return distorted;
}

// 2 tan(w / 2) for the FOV model, else 0.
float fov_gain_of(const CameraModel& camera) {
  if (camera.distortion != Distortion::kFov) return 0.0f;
  const float half = 0.5f * camera.coeffs[0];
  return 2.0f * det_sin(half) / det_cos(half);
}

// Undistorted radius, at most kMaxRadius, within which the distortion does not fold over: its Jacobian is positive
// definite along eight directions.
float fold_radius(const CameraModel& camera) {
  if (camera.distortion == Distortion::kNone || camera.distortion == Distortion::kFov) return kMaxRadius;
  constexpr float kFirstRadius = 0.01f;  // normalised, half a degree; not swept
  constexpr float kStep = 1.01f;         // ratio of successive radii; see kFoldFraction
  constexpr float kDirections[8][2] = {{1.0f, 0.0f},  {0.7f, 0.7f},   {0.0f, 1.0f},  {-0.7f, 0.7f},
                                       {-1.0f, 0.0f}, {-0.7f, -0.7f}, {0.0f, -1.0f}, {0.7f, -0.7f}};
  float inside = 0.0f;
  for (float r = kFirstRadius; r < kMaxRadius; r *= kStep) {
    for (const float* direction : kDirections) {
      Matrix2f D;
      distort(camera, Vector2f(r * direction[0], r * direction[1]), &D);
      const float determinant = D(0, 0) * D(1, 1) - D(0, 1) * D(1, 0);
      if (!(determinant > 0.0f) || !(D(0, 0) + D(1, 1) > 0.0f)) return inside;
    }
    inside = r;
  }
  return kMaxRadius;
}

// Inverse of distort(); the result's radius is at most the root of max_radius_sq.
Vector2f undistort(const CameraModel& camera, const Vector2f& distorted, float max_radius_sq) {
  const float* c = camera.coeffs;
  if (camera.distortion == Distortion::kNone) return distorted;
  if (camera.distortion == Distortion::kRadTan) {
    Vector2f x = distorted;
    bool converged = false;
    for (int i = 0;; ++i) {
      const float r_sq = x.dot(x);
      if (r_sq > max_radius_sq) x *= std::sqrt(max_radius_sq / r_sq);
      if (converged || i == kNewtonSteps) return x;
      Matrix2f D;
      const Vector2f error = distort(camera, x, &D) - distorted;
      const float determinant = D(0, 0) * D(1, 1) - D(0, 1) * D(1, 0);
      if (!(determinant > kMinFoldDeterminant)) return x;  // at the fold, beyond which nothing projects
      x.x() -= (D(1, 1) * error.x() - D(0, 1) * error.y()) / determinant;
      x.y() -= (D(0, 0) * error.y() - D(1, 0) * error.x()) / determinant;
      converged = error.dot(error) < kNewtonErrorSq;
    }
  }
  const float r_distorted = std::sqrt(distorted.dot(distorted));
  if (!(r_distorted > kMinDistortedRadius)) {  // the gain at the centre is k / w for the FOV model, else 1
    return camera.distortion == Distortion::kFov ? Vector2f(distorted * (c[0] / camera.fov_gain)) : distorted;
  }
  const float max_theta =
      det_atan(std::sqrt(max_radius_sq) * (camera.distortion == Distortion::kFov ? camera.fov_gain : 1.0f));
  float theta = 0.0f;  // the undistorted radius is tan(theta), or tan(theta) / k for the FOV model
  if (camera.distortion == Distortion::kFov) {
    theta = r_distorted * c[0];
  } else {
    theta = r_distorted;
    for (int i = 0; i < kNewtonSteps; ++i) {
      if (theta > max_theta) theta = max_theta;
      const float error = equidistant_angle(theta, c) - r_distorted;
      theta -= error / equidistant_angle_derivative(theta, c);
      if (error * error < kNewtonErrorSq) break;
    }
  }
  if (theta > max_theta) theta = max_theta;
  float r = det_sin(theta) / det_cos(theta);
  if (camera.distortion == Distortion::kFov) r /= camera.fov_gain;
  return distorted * (r / r_distorted);
}

// Normalised, still distorted coordinates of a pixel.
Vector2f distorted_coordinates(const CameraModel& camera, const Vector2f& px) {
  return {(px.x() - camera.cx) / camera.fx, (px.y() - camera.cy) / camera.fy};
}

// Undistorted radius of the farthest image corner, at most fold.
float corner_radius(const CameraModel& camera, float fold) {
  float radius_sq = 0.0f;
  for (int i = 0; i < 4; ++i) {
    const Vector2f corner(i % 2 == 0 ? 0.0f : static_cast<float>(camera.width - 1),
                          i / 2 == 0 ? 0.0f : static_cast<float>(camera.height - 1));
    const Vector2f x = undistort(camera, distorted_coordinates(camera, corner), fold * fold);
    const float corner_sq = x.dot(x);
    if (!(corner_sq <= radius_sq)) radius_sq = corner_sq;
  }
  return std::sqrt(radius_sq);
}

bool finite(float value) {
  return value - value == 0.0f;  // NaN for infinities and NaN
}

Status invalid(const char* message) {
  return {StatusCode::kInvalidArgument, message};
}

}  // namespace

Status CameraModel::validate() const {
  if (width < 1 || height < 1 || static_cast<float>(width) > kMaxSize || static_cast<float>(height) > kMaxSize)
    return invalid("camera: width and height must be from 1 to 8192 pixels");
  if (!finite(fx) || !finite(fy) || fx <= 0.0f || fy <= 0.0f)
    return invalid("camera: fx and fy must be finite and positive, in pixels");
  if (!(cx >= 0.0f && cx <= static_cast<float>(width - 1) && cy >= 0.0f && cy <= static_cast<float>(height - 1)))
    return invalid("camera: the principal point (cx, cy) must lie inside the image");
  for (const float c : coeffs)
    if (!finite(c)) return invalid("camera: distortion coefficients must be finite");
  if (distortion > Distortion::kEquidistant) return invalid("camera: unknown distortion model");
  if (distortion == Distortion::kFov && !(coeffs[0] > 0.0f && coeffs[0] < kMaxFovW))
    return invalid("camera: the FOV model's w must lie in (0, 3.1) radians");

  CameraModel camera = *this;
  camera.fov_gain = fov_gain_of(camera);
  const float fold = fold_radius(camera);
  const float corner = corner_radius(camera, fold);
  if (!(corner < kFoldFraction * fold) && fold < kMaxRadius)
    return invalid("camera: the distortion folds over inside the image; check the order and sign of its coefficients");
  if (!(corner < kMaxCornerRadius)) return invalid("camera: the field of view must be under 170 degrees");
  camera.prepare();
  for (int i = 0; i < 9; ++i) {  // corners, middles of the sides, centre
    const int column = i % 3;
    const int row = i / 3;
    const Vector2f px(0.5f * static_cast<float>((width - 1) * column), 0.5f * static_cast<float>((height - 1) * row));
    Vector2f back;
    if (!camera.project(camera.unproject(px).homogeneous(), &back) ||
        !((back - px).dot(back - px) < kMaxRoundTripErrorSq))
      return invalid("camera: the distortion is too strong to be undone at the image's border");
  }
  return {};
}

void CameraModel::prepare() {
  fov_gain = fov_gain_of(*this);
  const float fold = fold_radius(*this);
  const float one_pixel = kMinRadius_px / (fx < fy ? fx : fy);
  const float corner = corner_radius(*this, fold);
  const float radius = kRadiusMargin * (corner > one_pixel ? corner : one_pixel);
  max_radius_sq = radius < fold ? radius * radius : fold * fold;
}

bool CameraModel::project(const Vector3f& p_c, Vector2f* px) const {
  PPTAM_ASSERT(max_radius_sq > 0.0f);
  if (!(p_c.z() > 0.0f)) return false;
  const Vector2f x(p_c.x() / p_c.z(), p_c.y() / p_c.z());
  if (!(x.dot(x) <= max_radius_sq)) return false;
  const Vector2f distorted = distortion == Distortion::kNone ? x : distort(*this, x, nullptr);
  *px = Vector2f(fx * distorted.x() + cx, fy * distorted.y() + cy);
  return true;
}

bool CameraModel::project(const Vector3f& p_c, Vector2f* px, Matrix23f* J_px_p) const {
  PPTAM_ASSERT(max_radius_sq > 0.0f);
  if (!(p_c.z() > 0.0f)) return false;
  const Vector2f x(p_c.x() / p_c.z(), p_c.y() / p_c.z());
  if (!(x.dot(x) <= max_radius_sq)) return false;
  if (distortion == Distortion::kNone) {  // gives the bits of the general case, in less time
    *px = Vector2f(fx * x.x() + cx, fy * x.y() + cy);
    const float inverse_z = 1.0f / p_c.z();
    *J_px_p << fx * inverse_z, 0.0f, fx * x.x() * -inverse_z, 0.0f, fy * inverse_z, fy * x.y() * -inverse_z;
    return true;
  }
  Matrix2f D;
  const Vector2f distorted = distort(*this, x, &D);
  *px = Vector2f(fx * distorted.x() + cx, fy * distorted.y() + cy);
  // Chain rule: d(px)/d(x) times d(x)/d(p) = [I, -x] / z.
  Matrix2f J_px_x;
  J_px_x.row(0) = fx * D.row(0);
  J_px_x.row(1) = fy * D.row(1);
  const float inverse_z = 1.0f / p_c.z();
  J_px_p->leftCols<2>() = J_px_x * inverse_z;
  J_px_p->col(2) = (J_px_x * x) * -inverse_z;
  return true;
}

Vector2f CameraModel::unproject(const Vector2f& px) const {
  PPTAM_ASSERT(max_radius_sq > 0.0f);
  return undistort(*this, distorted_coordinates(*this, px), max_radius_sq);
}

}  // namespace pptam
