#include "tracking/full_frame_rotation.h"

#include <Eigen/Cholesky>
#include <cmath>

namespace pptam {

namespace {

constexpr int kLevel = kPyramidLevels - 1;
constexpr int kMaxIterations = 8;
constexpr float kConverged_rad = 2e-4f;  // 0.02 px of level 4 on the phone: the estimate's own noise is larger
constexpr float kHuber_grey = 8.0f;      // moving objects and borders, against 1-2 grey levels of noise
constexpr float kMaxResidual_grey = 25.0f;
constexpr float kMinGain = 0.4f;  // beyond it the two images do not show the same thing

struct Sample {
  float value, dx, dy;  // grey, grey per small-image pixel
};

// Bilinear value and central-difference gradient at (x, y); the caller keeps 1 <= x < width - 2.
inline Sample sample(const GreyView& image, float x, float y) {
  const int ix = static_cast<int>(x), iy = static_cast<int>(y);
  const float ax = x - static_cast<float>(ix), ay = y - static_cast<float>(iy);
  const uint8_t* r0 = image.row(iy - 1) + ix;
  const uint8_t* r1 = r0 + image.stride;
  const uint8_t* r2 = r1 + image.stride;
  const uint8_t* r3 = r2 + image.stride;
  const auto mix = [](float a, float b, float t) { return a + (b - a) * t; };
  const auto g = [](uint8_t v) { return static_cast<float>(v); };
  Sample s;
  s.value = mix(mix(g(r1[0]), g(r1[1]), ax), mix(g(r2[0]), g(r2[1]), ax), ay);
  s.dx = 0.5f * mix(mix(g(r1[1]) - g(r1[-1]), g(r1[2]) - g(r1[0]), ax),
                    mix(g(r2[1]) - g(r2[-1]), g(r2[2]) - g(r2[0]), ax), ay);
  s.dy = 0.5f *
         mix(mix(g(r2[0]) - g(r0[0]), g(r2[1]) - g(r0[1]), ax), mix(g(r3[0]) - g(r1[0]), g(r3[1]) - g(r1[1]), ax), ay);
  return s;
}

}  // namespace

void make_small_image(const Pyramid& pyramid, const GreyImage& small) {
  const GreyView& source = pyramid.level[kLevel];
  for (int y = 0; y < source.height; ++y) {
    const uint8_t* up = source.row(y > 0 ? y - 1 : 0);
    const uint8_t* mid = source.row(y);
    const uint8_t* down = source.row(y + 1 < source.height ? y + 1 : y);
    for (int x = 0; x < source.width; ++x) {
      const int l = x > 0 ? x - 1 : 0;
      const int r = x + 1 < source.width ? x + 1 : x;
      const int sum = up[l] + 2 * up[x] + up[r] + 2 * (mid[l] + 2 * mid[x] + mid[r]) + down[l] + 2 * down[x] + down[r];
      small.at(x, y) = static_cast<uint8_t>((sum + 8) >> 4);
    }
  }
}

RotationEstimate estimate_rotation(const GreyView& previous, const GreyView& current, const CameraModel& camera,
                                   const Matrix3f& R_start, const Vector3f& t_over_depth) {
  using Matrix5f = Eigen::Matrix<float, 5, 5>;
  using Vector5f = Eigen::Matrix<float, 5, 1>;
  RotationEstimate result;
  result.R_cp = R_start;
  float gain = 1, offset = 0;
  const float px_per_level0 = 1.0f / static_cast<float>(1 << kLevel);
  float last_step = 1;
  // I_c(project(R x + t/d)) = gain * I_p(x) + offset, over the interior pixels of the previous image.
  for (int iteration = 0; iteration < kMaxIterations; ++iteration) {
    Matrix5f A = Matrix5f::Zero();
    Vector5f b = Vector5f::Zero();
    float cost = 0;
    int count = 0;
    for (int y = 1; y + 1 < previous.height; ++y) {
      const uint8_t* up = previous.row(y - 1);
      const uint8_t* mid = previous.row(y);
      const uint8_t* down = previous.row(y + 1);
      for (int x = 1; x + 1 < previous.width; ++x) {
        const Vector2f px0(to_level0(static_cast<float>(x), kLevel), to_level0(static_cast<float>(y), kLevel));
        const Vector2f ray = camera.unproject(px0);
        const Vector3f p = result.R_cp * Vector3f(ray.x(), ray.y(), 1.0f) + t_over_depth;
        Vector2f px;
        Matrix23f J_px_p;
        if (!camera.project(p, &px, &J_px_p)) continue;
        const float xc = from_level0(px.x(), kLevel), yc = from_level0(px.y(), kLevel);
        if (!(xc >= 1 && yc >= 1 && xc < static_cast<float>(current.width - 2) &&
              yc < static_cast<float>(current.height - 2)))
          continue;
        const Sample s = sample(current, xc, yc);
        const float value = static_cast<float>(mid[x]);
        // ESM: mean of the two images' gradients (the previous one's axes turned into the current's by R are nearly
        // parallel for the few degrees between frames).
        const float dx = 0.5f * (s.dx + gain * 0.5f * static_cast<float>(mid[x + 1] - mid[x - 1]));
        const float dy = 0.5f * (s.dy + gain * 0.5f * static_cast<float>(down[x] - up[x]));
        const Eigen::RowVector3f J_p = (dx * J_px_p.row(0) + dy * J_px_p.row(1)) * px_per_level0;
        // d(exp(w) p)/dw = -hat(p): J_p * -hat(p) = (p x J_p)
        const Vector3f J_w = p.cross(J_p.transpose());
        Vector5f J;
        J << J_w, -value, -1.0f;
        const float e = s.value - (gain * value + offset);
        const float abs_e = std::abs(e);
        const float w = abs_e <= kHuber_grey ? 1.0f : kHuber_grey / abs_e;
        A += (w * J) * J.transpose();
        b -= (w * e) * J;
        cost += w * e * e;
        ++count;
      }
    }
    result.iterations = iteration + 1;
    if (count < (previous.width - 2) * (previous.height - 2) / 3) return result;
    result.residual = std::sqrt(cost / static_cast<float>(count));
    // A weak pull of the gain to 1 keeps gain and offset apart in images of little contrast.
    A(3, 3) += 10.0f;
    b(3) += 10.0f * (1.0f - gain);
    const Eigen::LDLT<Matrix5f> ldlt(A);
    if (ldlt.info() != Eigen::Success || !(ldlt.vectorD().minCoeff() > 1e-3f)) return result;
    const Vector5f step = ldlt.solve(b);
    if (!step.allFinite() || step.head<3>().norm() > 0.5f) return result;
    result.R_cp = so3_exp(step.head<3>()) * result.R_cp;
    gain += step[3];
    offset += step[4];
    last_step = step.head<3>().norm();
    if (last_step < kConverged_rad || iteration + 1 == kMaxIterations) {
      const float variance = std::max(result.residual * result.residual, 1.0f);
      const Matrix5f inverse = ldlt.solve(Matrix5f::Identity());
      result.covariance = inverse.topLeftCorner<3, 3>() * variance;
      result.R_cp = orthonormalised(result.R_cp);
      result.ok = last_step < 20 * kConverged_rad && result.residual < kMaxResidual_grey && gain > kMinGain &&
                  gain < 1 / kMinGain;
      return result;
    }
  }
  return result;
}

}  // namespace pptam
