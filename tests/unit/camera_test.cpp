// Where a point of the world appears in the images of a rolling shutter.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include <pocket_ptam/camera.h>
#include "tests/support/phone_camera.h"
#include "tests/support/random.h"

namespace pptam {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

Vector6f random_twist(test::Random& random, double translation, double rotation) {
  Vector6f mu;
  for (int i = 0; i < 6; ++i) mu[i] = static_cast<float>((i < 3 ? translation : rotation) * random.gaussian());
  return mu;
}

// exp(dt velocity) q, by the series of the matrix exponential, in double.
Vector3d moved(const Vector6f& velocity, double dt_s, const Vector3d& q) {
  const Vector3d v = velocity.head<3>().cast<double>(), omega = velocity.tail<3>().cast<double>();
  Vector3d term = q, sum = q;
  for (int n = 1; n < 20; ++n) {
    term = dt_s / n * (omega.cross(term) + (n == 1 ? v : Vector3d::Zero()));
    sum += term;
  }
  return sum;
}

// By the definition, in double: without distortion, or with the field-of-view model's [ptam eq. 3-5].
Vector2d project(const CameraModel& model, const Vector3d& p) {
  Vector2d x(p.x() / p.z(), p.y() / p.z());
  if (model.distortion == Distortion::kFov) {
    const double w = static_cast<double>(model.coeffs[0]), r = x.norm();
    if (r > 1e-9) x *= std::atan(2 * r * std::tan(w / 2)) / (w * r);
  }
  return {static_cast<double>(model.fx) * x.x() + static_cast<double>(model.cx),
          static_cast<double>(model.fy) * x.y() + static_cast<double>(model.cy)};
}

// The pixel whose own line sees p_w there: a fixed point, which each pass is nearer to by the image's speed times the
// line's time, under 0.2 here; 40 passes leave nothing.
Vector2d exact_pixel(const Camera& camera, const SE3& T_cw, const Vector6f& velocity, const Vector3f& p_w) {
  const Vector3d q = T_cw.R.cast<double>() * p_w.cast<double>() + T_cw.t.cast<double>();
  const bool columns = camera.shutter.axis == RollingShutter::Axis::kColumns;
  const double middle = 0.5 * ((columns ? camera.model.width : camera.model.height) - 1);
  double dt_s = 0;
  Vector2d px;
  for (int pass = 0; pass < 40; ++pass) {
    px = project(camera.model, moved(velocity, dt_s, q));
    dt_s = static_cast<double>(camera.shutter.line_time_s) * (px[columns ? 0 : 1] - middle);
  }
  return px;
}

TEST(Camera, ReadoutIsAllOfTheLines) {
  Camera camera = {test::phone_camera(), {}};
  EXPECT_EQ(camera.readout_s(), 0);
  for (const float line_time_s : {0.0001f, -0.0002f}) {
    camera.shutter = {RollingShutter::Axis::kColumns, line_time_s};
    EXPECT_FLOAT_EQ(camera.readout_s(), 240 * std::abs(line_time_s));
    camera.shutter.axis = RollingShutter::Axis::kRows;
    EXPECT_FLOAT_EQ(camera.readout_s(), 320 * std::abs(line_time_s));
    // From the first line to the last, a line less.
    EXPECT_NEAR(std::abs(camera.dt_s({0, 319}) - camera.dt_s({0, 0})), camera.readout_s() - std::abs(line_time_s),
                1e-8f);
  }
}

TEST(Camera, ImagePointsSigmaIsAPixelOfTheLevel) {
  for (uint8_t level = 0; level < 5; ++level)
    EXPECT_EQ((ImagePoint{Vector2f::Zero(), level}).sigma(), std::pow(2.0f, static_cast<float>(level)));
}

TEST(Camera, SettlesOnTheLineThatSeesThePoint) {
  test::Random random;
  Camera camera = {test::phone_camera(), {}};
  for (const float w : {0.0f, 0.9f}) {
    camera.model.distortion = w == 0 ? Distortion::kNone : Distortion::kFov;
    camera.model.coeffs[0] = w;
    camera.model.prepare();
    const double gain = w == 0 ? 1 : 2 * std::tan(0.5 * static_cast<double>(w)) / static_cast<double>(w);
    for (const auto axis : {RollingShutter::Axis::kColumns, RollingShutter::Axis::kRows}) {
      for (const double speed : {-1.0, 0.1, 0.6, 1.0}) {  // radians/s; negative: with the lines in the other order
        const int lines = axis == RollingShutter::Axis::kColumns ? 240 : 320;
        camera.shutter = {axis, static_cast<float>((speed < 0 ? 0.060 : -0.060) / lines)};
        double worst = 0;
        for (int trial = 0; trial < test::trials(300); ++trial) {
          const SE3 T_cw = SE3::exp(random_twist(random, 0.3, 0.5));
          const Vector2f ray = camera.unproject(
              Vector2f(static_cast<float>(random.uniform(60, 180)), static_cast<float>(random.uniform(100, 220))));
          const Vector3f p_w = T_cw.inverse() * Vector3f(ray.x(), ray.y(), 1);
          const double a = random.uniform(0, 6.28318), b = random.uniform(0, 6.28318);
          Vector6f velocity = Vector6f::Zero();
          velocity[0] = static_cast<float>(0.2 * speed * std::cos(b));
          velocity[1] = static_cast<float>(0.2 * speed * std::sin(b));
          velocity[3] = static_cast<float>(speed * std::cos(a));
          velocity[4] = static_cast<float>(speed * std::sin(a));
          PredictedPoint seen;
          ASSERT_TRUE(camera.project_rolling(T_cw, velocity, p_w, &seen));
          worst = std::max(worst, (seen.px.cast<double>() - exact_pixel(camera, T_cw, velocity, p_w)).norm());
          Vector2f again;
          ASSERT_TRUE(camera.project(seen.T_cw * p_w, &again));
          // The third-order motion leaves (30 mrad)^4 / 24, under 1e-4 px; the rest is float32's, of a point that the
          // world's coordinates round by up to a unit's 6e-8 three times: 1e-4 px.
          EXPECT_LT((again - seen.px).norm(), 4e-4f) << "px is the image under T_cw";
        }
        // The start is off by the motion until the point's line, up to 60 px of them and a little more for the points
        // that move outwards: s x 70 px with s = image speed x line time. Each pass multiplies by s. 3e-4 px for
        // float32, as above.
        const double s = std::abs(speed) * 358.6 * gain * (1.2 + 0.2) * 0.060 / lines;
        EXPECT_LT(worst, 70 * s * s * s + 3e-4) << speed << " w " << w;
        EXPECT_GT(30 * s, 70 * s * s * s + 3e-4) << "without any pass the start's error would be seen";
      }
    }
  }
}

TEST(Camera, AGlobalShutterSeesEveryLineAtOnce) {
  test::Random random;
  const Camera camera = {test::phone_camera(), {}};
  for (int trial = 0; trial < 100; ++trial) {
    const SE3 T_cw = SE3::exp(random_twist(random, 0.3, 0.5));
    const Vector3f p_c(static_cast<float>(random.uniform(-0.3, 0.3)), static_cast<float>(random.uniform(-0.3, 0.3)), 1);
    const Vector3f p_w = T_cw.inverse() * p_c;
    PredictedPoint seen;
    ASSERT_TRUE(camera.project_rolling(T_cw, random_twist(random, 1, 1), p_w, &seen));
    Vector2f px;
    ASSERT_TRUE(camera.project(T_cw * p_w, &px));
    EXPECT_EQ(seen.px, px);
    EXPECT_EQ(seen.T_cw.R, T_cw.R);
    EXPECT_EQ(seen.T_cw.t, T_cw.t);
    for (const RollingShutter& shutter : {RollingShutter{}, test::phone_shutter()})
      EXPECT_FALSE((Camera{camera.model, shutter})
                       .project_rolling(T_cw, Vector6f::Zero(), T_cw.inverse() * Vector3f(-p_c), &seen))
          << "behind the camera";
  }
}

TEST(Camera, GlobalShutterCorrectionIsExactToFirstOrder) {
  test::Random random;
  const Camera camera = {test::phone_camera(), test::phone_shutter()};
  const Camera global = {camera.model, {}};
  for (int trial = 0; trial < 300; ++trial) {
    const Vector2f ray = camera.unproject(
        Vector2f(static_cast<float>(random.uniform(20, 220)), static_cast<float>(random.uniform(20, 300))));
    const Vector3f p_c(ray.x(), ray.y(), 1);
    const Vector6f velocity = random_twist(random, 0.1, 0.3);
    Vector2f still;
    PredictedPoint moving;
    ASSERT_TRUE(camera.project(p_c, &still));
    ASSERT_TRUE(camera.project_rolling(SE3(), velocity, p_c, &moving));
    const double error = (camera.global_shutter_px(velocity, p_c, moving.px) - still).norm();
    // The second order of a motion of d px: d^2 / f, for rotation and translation at unit depth, with a factor of 1.5
    // for the view's edge; and what two fixed-point passes leave, each the image's movement during one column of it.
    const double speed = 358 * static_cast<double>(velocity.head<3>().norm() + velocity.tail<3>().norm());
    const double d = speed * std::abs(static_cast<double>(camera.dt_s(moving.px)));
    const double column = speed * std::abs(static_cast<double>(camera.shutter.line_time_s));
    EXPECT_LT(error, 1.5 * d * d / 358 + d * column * column + 1e-3) << d;
    EXPECT_EQ(global.global_shutter_px(velocity, p_c, moving.px), moving.px);
  }
}

}  // namespace
}  // namespace pptam
