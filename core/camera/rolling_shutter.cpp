#include <cmath>

#include <pocket_ptam/camera.h>

namespace pptam {

namespace {

constexpr int kLinePasses = 2;  // fixed-point passes for a point's line; what they leave stands in camera.h

}  // namespace

float Camera::readout_s() const {
  const int lines = shutter.axis == RollingShutter::Axis::kColumns ? model.width : model.height;
  return std::abs(shutter.line_time_s) * static_cast<float>(lines);
}

bool Camera::project_rolling(const SE3& T_cw, const Vector6f& velocity, const Vector3f& p_w,
                             PredictedPoint* seen) const {
  seen->T_cw = T_cw;
  seen->velocity = velocity;
  const Vector3f q = T_cw * p_w;
  if (!project(q, &seen->px)) return false;
  if (shutter.line_time_s == 0) return true;
  float dt = 0;
  for (int pass = 0; pass < kLinePasses; ++pass) {
    dt = dt_s(seen->px);
    if (!project(moved_point(q, velocity, dt), &seen->px)) return false;
  }
  seen->T_cw = pose_at(T_cw, velocity, dt);
  return true;
}

Vector2f Camera::global_shutter_px(const Vector6f& velocity, const Vector3f& p_c, const Vector2f& px) const {
  if (shutter.line_time_s == 0) return px;
  Vector2f projected;
  Matrix23f J;
  if (!project(p_c, &projected, &J)) return px;
  return px - J * (se3_point_jacobian(p_c) * velocity) * dt_s(px);
}

}  // namespace pptam
