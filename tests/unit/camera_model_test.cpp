// Every distortion model against a double-precision reference over the whole image, and what validate() refuses.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <limits>
#include <string>
#include <utility>

#include <pocket_ptam/camera_model.h>
#include "tests/support/random.h"

namespace pptam {
namespace {

constexpr double kEps = 0x1p-24;
constexpr double kPi = 3.14159265358979323846;

CameraModel make_camera(int width, int height, float fx, float fy, float cx, float cy, Distortion distortion,
                        std::initializer_list<float> coeffs) {
  CameraModel camera;
  camera.width = width;
  camera.height = height;
  camera.fx = fx;
  camera.fy = fy;
  camera.cx = cx;
  camera.cy = cy;
  camera.distortion = distortion;
  int i = 0;
  for (const float c : coeffs) camera.coeffs[i++] = c;
  return camera;
}

struct NamedCamera {
  const char* name;
  CameraModel camera;
};

const NamedCamera kCameras[] = {
    // 37x48 degrees: f = 120 / tan(18.5 deg), the phone of the paper, held upright.
    {"pinhole phone", make_camera(240, 320, 358.6f, 358.6f, 119.5f, 159.5f, Distortion::kNone, {})},
    {"FOV phone", make_camera(240, 320, 357.0f, 359.0f, 121.3f, 157.2f, Distortion::kFov, {0.2f})},
    {"FOV almost none", make_camera(240, 320, 357.0f, 359.0f, 121.3f, 157.2f, Distortion::kFov, {1e-4f})},
    {"FOV wide", make_camera(640, 480, 325.0f, 327.0f, 322.0f, 236.0f, Distortion::kFov, {0.93f})},
    {"FOV very wide", make_camera(640, 480, 230.0f, 230.0f, 320.0f, 240.0f, Distortion::kFov, {0.8f})},
    {"radtan VGA wide", make_camera(752, 480, 458.654f, 457.296f, 367.215f, 248.375f, Distortion::kRadTan,
                                    {-0.28340811f, 0.07395907f, 0.00019359f, 1.76187114e-05f})},
    {"radtan S3 phone", make_camera(640, 480, 525.06f, 524.245f, 308.649f, 236.536f, Distortion::kRadTan,
                                    {0.1065f, -0.1816f, 0.0f, 0.0f})},
    {"radtan five", make_camera(640, 480, 517.3f, 516.5f, 318.6f, 255.3f, Distortion::kRadTan,
                                {0.2624f, -0.9531f, -0.0054f, 0.0026f, 1.1633f})},
    {"fisheye", make_camera(848, 800, 480.0f, 481.0f, 424.5f, 398.7f, Distortion::kEquidistant,
                            {-0.0073f, 0.0419f, -0.0403f, 0.0072f})},
    {"fisheye narrow",
     make_camera(640, 480, 430.0f, 430.0f, 330.0f, 230.0f, Distortion::kEquidistant, {0.03f, -0.01f, 0.005f, -0.002f})},
};

// The models as their papers print them, in double precision, with nothing rearranged.
Eigen::Vector2d project_double(const CameraModel& camera, const Eigen::Vector3d& p) {
  const double x = p.x() / p.z();
  const double y = p.y() / p.z();
  const double r = std::hypot(x, y);
  double c[5];
  for (int i = 0; i < 5; ++i) c[i] = static_cast<double>(camera.coeffs[i]);
  double xd = x;
  double yd = y;
  if (camera.distortion == Distortion::kFov && r > 0) {
    const double rd = std::atan(2 * r * std::tan(c[0] / 2)) / c[0];
    xd = x * rd / r;
    yd = y * rd / r;
  }
  if (camera.distortion == Distortion::kRadTan) {
    const double radial = 1 + c[0] * std::pow(r, 2) + c[1] * std::pow(r, 4) + c[4] * std::pow(r, 6);
    xd = x * radial + 2 * c[2] * x * y + c[3] * (r * r + 2 * x * x);
    yd = y * radial + c[2] * (r * r + 2 * y * y) + 2 * c[3] * x * y;
  }
  if (camera.distortion == Distortion::kEquidistant && r > 0) {
    const double a = std::atan(r);
    const double rd =
        a * (1 + c[0] * std::pow(a, 2) + c[1] * std::pow(a, 4) + c[2] * std::pow(a, 6) + c[3] * std::pow(a, 8));
    xd = x * rd / r;
    yd = y * rd / r;
  }
  return {static_cast<double>(camera.fx) * xd + static_cast<double>(camera.cx),
          static_cast<double>(camera.fy) * yd + static_cast<double>(camera.cy)};
}

Vector3f ray(const Vector2f& x) {
  return x.homogeneous();
}

class CameraModelTest : public ::testing::TestWithParam<int> {
 protected:
  void SetUp() override {
    camera_ = kCameras[GetParam()].camera;
    ASSERT_TRUE(camera_.validate().ok()) << camera_.validate().message();
    camera_.prepare();
  }
  // A grid over the whole image, its borders and the principal point with its close neighbourhood included.
  template <class Check>
  void for_grid(Check check) {
    constexpr int kGrid = 24;
    for (int j = 0; j <= kGrid; ++j)
      for (int i = 0; i <= kGrid; ++i)
        check(Vector2f(static_cast<float>(camera_.width - 1) * static_cast<float>(i) / kGrid,
                       static_cast<float>(camera_.height - 1) * static_cast<float>(j) / kGrid));
    for (const float offset : {0.0f, 1e-4f, 1e-2f, 1.0f, 3.0f, 10.0f, 12.0f})
      for (int k = 0; k < 8; ++k)
        check(Vector2f(camera_.cx + offset * static_cast<float>(std::cos(0.8 * k)),
                       camera_.cy + offset * static_cast<float>(std::sin(0.8 * k))));
  }
  // Rounding of a pixel coordinate: the result's own (up to 1024), and about 8 more of the distorted coordinate times
  // f.
  double pixel_rounding() const { return kEps * (1024.0 + 8.0 * 1.2 * static_cast<double>(camera_.fx)); }

  CameraModel camera_;
};

TEST_P(CameraModelTest, UnprojectThenProjectReturnsThePixel) {
  double worst = 0;
  for_grid([&](const Vector2f& px) {
    const Vector2f x = camera_.unproject(px);
    Vector2f back;
    ASSERT_TRUE(camera_.project(2.5f * ray(x), &back)) << px.transpose();
    worst = std::max(worst, static_cast<double>((back - px).norm()));
    // A wrong pixel is seen as wrong: a tenth of a pixel away comes back a tenth of a pixel away.
    ASSERT_TRUE(camera_.project(camera_.unproject(px + Vector2f(0.1f, 0.0f)).homogeneous(), &back));
    EXPECT_NEAR((back - px).norm(), 0.1, 2e-3);
  });
  RecordProperty("worst_px", std::to_string(worst));
  EXPECT_LT(worst, 1e-3);  // the requirement; rounding alone is pixel_rounding(), 2e-4 to 6e-4
}

TEST_P(CameraModelTest, ProjectionMatchesTheDoublePrecisionReference) {
  double worst = 0;
  for_grid([&](const Vector2f& px) {
    const Vector2f x = camera_.unproject(px);
    for (const float z : {0.1f, 1.0f, 40.0f}) {
      const Vector3f p = z * ray(x);
      Vector2f projected;
      ASSERT_TRUE(camera_.project(p, &projected));
      worst = std::max(worst, (projected.cast<double>() - project_double(camera_, p.cast<double>())).norm());
    }
  });
  RecordProperty("worst_px", std::to_string(worst));
  EXPECT_LT(worst, pixel_rounding());
}

TEST_P(CameraModelTest, JacobianMatchesCentralDifferences) {
  double worst = 0;
  for_grid([&](const Vector2f& px) {
    for (const float z : {0.1f, 1.0f, 40.0f}) {
      const Vector3f p = z * ray(camera_.unproject(px));
      Vector2f projected;
      Vector2f same;
      Matrix23f J;
      ASSERT_TRUE(camera_.project(p, &projected, &J));
      ASSERT_TRUE(camera_.project(p, &same));
      EXPECT_EQ(projected, same);
      for (int k = 0; k < 3; ++k) {
        const double h = 1e-5 * static_cast<double>(z);
        Eigen::Vector3d step = Eigen::Vector3d::Zero();
        step(k) = h;
        const Eigen::Vector2d column =
            (project_double(camera_, p.cast<double>() + step) - project_double(camera_, p.cast<double>() - step)) /
            (2 * h);
        // Relative to the pixels of one radian, f / z.
        const double unit = static_cast<double>(camera_.fx / z);
        worst = std::max(worst, (J.col(k).cast<double>() - column).norm() / unit);
      }
    }
  });
  RecordProperty("worst_roundings", std::to_string(worst / kEps));
  // The exact slope d(gain)/d(r)/r just above the series' limit r^2 = 1e-3 has cancelled to 3 roundings / 1e-3, times
  // r^2 again: 3 roundings of the gain. About 12 roundings for the rest, times up to (1 + r^2) <= 6 in the z column;
  // the differences leave h^2 = 1e-10 and 1e-16 * 1e3 px / (1e-5 * 500 px) = 2e-11.
  EXPECT_LT(worst, 15 * 6 * kEps);
}

TEST_P(CameraModelTest, AWrongCoefficientShows) {
  // Negative control of the three tests above: one per cent of f, or 0.02 more of the first coefficient, moves the
  // corner visibly.
  CameraModel wrong = camera_;
  if (camera_.distortion == Distortion::kNone || camera_.coeffs[0] < 1e-3f)
    wrong.fx *= 1.01f;
  else
    wrong.coeffs[0] += 0.02f;
  wrong.prepare();
  const Vector2f corner(0.0f, 0.0f);
  Vector2f right;
  Vector2f moved;
  const Vector3f p = camera_.unproject(corner).homogeneous();
  ASSERT_TRUE(camera_.project(p, &right) && wrong.project(p, &moved));
  EXPECT_GT((right - moved).norm(), 0.01f);  // ten times what they allow
}

TEST_P(CameraModelTest, RefusesPointsBehindAndFarOutside) {
  Vector2f px(-7.0f, -8.0f);
  Matrix23f J = Matrix23f::Constant(3.0f);
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const float radius = std::sqrt(camera_.max_radius_sq);
  const Vector3f refused[] = {{0, 0, 0},      {0, 0, -1},  {1, 1, -1e-3f}, {1, 0, 1e-7f}, {radius * 1.001f, 0, 1},
                              {nan, 0, 1},    {0, 0, nan}, {0, nan, 1},    {1e30f, 0, 1}, {0, -1.001f * radius, 1},
                              {0, 0, -1e-30f}};
  for (const Vector3f& p : refused) {
    EXPECT_FALSE(camera_.project(p, &px)) << p.transpose();
    EXPECT_FALSE(camera_.project(p, &px, &J)) << p.transpose();
  }
  EXPECT_EQ(px, Vector2f(-7.0f, -8.0f));
  EXPECT_EQ(J, Matrix23f::Constant(3.0f));
  EXPECT_TRUE(camera_.project({0.999f * radius, 0, 1}, &px));
}

TEST_P(CameraModelTest, RadiusLimitIsOneAndAHalfTimesTheCornerOrTheFold) {
  double corner = 0;
  for (int i = 0; i < 4; ++i) {
    const Vector2f px(i % 2 ? static_cast<float>(camera_.width - 1) : 0.0f,
                      i / 2 ? static_cast<float>(camera_.height - 1) : 0.0f);
    corner = std::max(corner, static_cast<double>(camera_.unproject(px).norm()));
  }
  const double limit = std::sqrt(static_cast<double>(camera_.max_radius_sq));
  EXPECT_LE(limit, 1.5 * corner * (1 + 8 * kEps));
  EXPECT_GT(limit, corner);
  // Up to the limit the image moves outwards with the radius, in every direction.
  for (int k = 0; k < 16; ++k) {
    double previous = -1;
    for (int i = 0; i <= 200; ++i) {
      const double r = limit * i / 200.0 * 0.9999;
      const Eigen::Vector3d p(r * std::cos(k * kPi / 8), r * std::sin(k * kPi / 8), 1);
      const Eigen::Vector2d px = project_double(camera_, p);
      const Eigen::Vector2d from_centre((px.x() - static_cast<double>(camera_.cx)) / static_cast<double>(camera_.fx),
                                        (px.y() - static_cast<double>(camera_.cy)) / static_cast<double>(camera_.fy));
      // 1 % of the radius: fold detection looks at eight directions in steps of 1 %.
      if (r < 0.99 * limit) {
        EXPECT_GT(from_centre.norm(), previous) << "r " << r << " direction " << k;
      }
      previous = from_centre.norm();
    }
  }
}

TEST_P(CameraModelTest, FarPixelsUnprojectToSomethingFinite) {
  for (const float scale : {-1e6f, -3000.0f, 3000.0f, 1e6f}) {
    const Vector2f x = camera_.unproject(Vector2f(scale, 0.3f * scale));
    EXPECT_TRUE(x.allFinite());
    if (camera_.distortion != Distortion::kNone) {
      EXPECT_LE(x.squaredNorm(), camera_.max_radius_sq * 1.001f);
    }
  }
}

INSTANTIATE_TEST_SUITE_P(All, CameraModelTest, ::testing::Range(0, static_cast<int>(std::size(kCameras))),
                         [](const auto& test) {
                           std::string name = kCameras[test.param].name;
                           for (char& c : name)
                             if (c == ' ') c = '_';
                           return name;
                         });

TEST(CameraModelValidate, RefusesNonsense) {
  const CameraModel good = kCameras[0].camera;
  ASSERT_TRUE(good.validate().ok());
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const float infinity = std::numeric_limits<float>::infinity();
  const auto refused = [&](auto change) {
    CameraModel camera = good;
    change(camera);
    const Status status = camera.validate();
    return status.code() == StatusCode::kInvalidArgument && std::string(status.message()).size() > 10;
  };
  for (const float bad : {nan, infinity, -infinity, 0.0f, -300.0f}) {
    EXPECT_TRUE(refused([&](CameraModel& c) { c.fx = bad; })) << bad;
    EXPECT_TRUE(refused([&](CameraModel& c) { c.fy = bad; })) << bad;
  }
  for (const float bad : {nan, infinity, -1.0f, 1e6f}) {
    EXPECT_TRUE(refused([&](CameraModel& c) { c.cx = bad; })) << bad;
    EXPECT_TRUE(refused([&](CameraModel& c) { c.cy = bad; })) << bad;
  }
  for (const int bad : {0, -240, 8193, std::numeric_limits<int>::max(), std::numeric_limits<int>::min()}) {
    EXPECT_TRUE(refused([&](CameraModel& c) { c.width = bad; })) << bad;
    EXPECT_TRUE(refused([&](CameraModel& c) { c.height = bad; })) << bad;
  }
  EXPECT_TRUE(refused([&](CameraModel& c) { c.cx = 240.0f; }));
  EXPECT_FALSE(refused([&](CameraModel& c) { c.cx = 239.0f; }));
  EXPECT_TRUE(refused([&](CameraModel& c) { c.distortion = static_cast<Distortion>(9); }));
  for (int i = 0; i < 5; ++i) {
    EXPECT_TRUE(refused([&](CameraModel& c) { c.coeffs[i] = nan; }));
    EXPECT_TRUE(refused([&](CameraModel& c) {
      c.distortion = Distortion::kRadTan;
      c.coeffs[i] = infinity;
    }));
  }
}

TEST(CameraModelValidate, AnImageOfOnePixelIsACamera) {
  for (const auto& [distortion, coefficient] :
       {std::pair(Distortion::kNone, 0.0f), std::pair(Distortion::kFov, 0.5f), std::pair(Distortion::kRadTan, -0.1f),
        std::pair(Distortion::kEquidistant, 0.1f)}) {
    CameraModel camera = make_camera(1, 1, 50, 50, 0, 0, distortion, {coefficient});
    ASSERT_TRUE(camera.validate().ok()) << static_cast<int>(distortion);
    camera.prepare();
    EXPECT_GT(camera.max_radius_sq, 0.0f);
    Vector2f px;
    EXPECT_TRUE(camera.project(Vector3f(0.01f, 0, 1), &px));
    EXPECT_FALSE(camera.project(Vector3f(1, 0, 1), &px)) << "fifty pixels beside the image";
  }
}

TEST(CameraModelValidate, RefusesAbsurdFovParameters) {
  CameraModel camera = kCameras[1].camera;
  camera.fx = camera.fy = 600.0f;  // the corner at 0.33, so that w = 3 is still under 90 degrees
  for (const float w : {0.0f, -0.5f, 3.1f, 3.2f, 100.0f}) {
    camera.coeffs[0] = w;
    EXPECT_FALSE(camera.validate().ok()) << w;
  }
  for (const float w : {1e-6f, 1e-3f, 0.5f, 1.5f, 3.0f}) {
    camera.coeffs[0] = w;
    EXPECT_TRUE(camera.validate().ok()) << w << camera.validate().message();
  }
}

TEST(CameraModelValidate, FieldOfViewUnder170Degrees) {
  // The corner of a 201x201 image with the centre at 100 has radius 141.4 px: f puts it at a chosen angle.
  for (const double degrees : {60.0, 84.0, 84.9, 85.1, 86.0, 89.0}) {
    CameraModel pinhole = make_camera(201, 201, 1, 1, 100, 100, Distortion::kNone, {});
    pinhole.fx = pinhole.fy = static_cast<float>(100 * std::sqrt(2.0) / std::tan(degrees * kPi / 180));
    EXPECT_EQ(pinhole.validate().ok(), degrees < 85) << degrees;
    CameraModel fisheye = make_camera(201, 201, 1, 1, 100, 100, Distortion::kEquidistant, {});
    fisheye.fx = fisheye.fy = static_cast<float>(100 * std::sqrt(2.0) / (degrees * kPi / 180));
    EXPECT_EQ(fisheye.validate().ok(), degrees < 85) << degrees;
    const double w = 1.0;
    CameraModel fov = make_camera(201, 201, 1, 1, 100, 100, Distortion::kFov, {static_cast<float>(w)});
    const double rd = std::atan(2 * std::tan(degrees * kPi / 180) * std::tan(w / 2)) / w;
    fov.fx = fov.fy = static_cast<float>(100 * std::sqrt(2.0) / rd);
    EXPECT_EQ(fov.validate().ok(), degrees < 85) << degrees;
  }
}

TEST(CameraModelValidate, RefusesDistortionThatFoldsOverInsideTheImage) {
  // r (1 + k1 r^2) turns at r = 1/sqrt(-3 k1), where the distorted radius is 2/3 of that. The corner's distorted radius
  // is fixed at 0.7 by f.
  for (const double fold_distorted : {0.3, 0.6, 0.69, 0.75, 1.0}) {
    const double r = 1.5 * fold_distorted;
    CameraModel camera = make_camera(201, 201, 1, 1, 100, 100, Distortion::kRadTan, {});
    camera.fx = camera.fy = static_cast<float>(100 * std::sqrt(2.0) / 0.7);
    camera.coeffs[0] = static_cast<float>(-1 / (3 * r * r));
    EXPECT_EQ(camera.validate().ok(), fold_distorted > 0.7) << fold_distorted;
    if (fold_distorted == 0.3) {
      EXPECT_NE(std::string(camera.validate().message()).find("folds"), std::string::npos);
    }
    // The same turning point for the equidistant angle.
    camera.distortion = Distortion::kEquidistant;
    EXPECT_EQ(camera.validate().ok(), fold_distorted > 0.7) << fold_distorted;
  }
  CameraModel tangential = kCameras[6].camera;
  tangential.coeffs[2] = 0.5f;
  EXPECT_FALSE(tangential.validate().ok());
}

TEST(CameraModelValidate, NeverAcceptsACameraThatCannotProjectItsOwnImage) {
  test::Random random;
  int accepted = 0;
  for (int i = 0; i < 2000; ++i) {
    CameraModel camera = make_camera(random.integer(2, 2000), random.integer(2, 2000), 0, 0, 0, 0,
                                     static_cast<Distortion>(random.integer(0, 3)), {});
    camera.fx = static_cast<float>(camera.width * random.uniform(0.1, 3));
    camera.fy = static_cast<float>(static_cast<double>(camera.fx) * random.uniform(0.8, 1.2));
    camera.cx = static_cast<float>((camera.width - 1) * random.uniform(0.3, 0.7));
    camera.cy = static_cast<float>((camera.height - 1) * random.uniform(0.3, 0.7));
    if (camera.distortion == Distortion::kFov) camera.coeffs[0] = static_cast<float>(random.uniform(0.01, 3));
    if (camera.distortion == Distortion::kRadTan || camera.distortion == Distortion::kEquidistant)
      for (float& c : camera.coeffs) c = static_cast<float>(random.uniform(-0.2, 0.2));
    if (!camera.validate().ok()) continue;
    ++accepted;
    camera.prepare();
    for (int k = 0; k < 9; ++k) {
      const Vector2f px(static_cast<float>((camera.width - 1) * (k % 3)) / 2.0f,
                        static_cast<float>((camera.height - 1) * (k / 3)) / 2.0f);
      Vector2f back(-1e9f, -1e9f);
      EXPECT_TRUE(camera.project(camera.unproject(px).homogeneous(), &back));
      EXPECT_LT((back - px).norm(), 0.01) << i;  // validate()'s promise for the border
    }
  }
  EXPECT_GT(accepted, 300);
  EXPECT_LT(accepted, 1900);
}

}  // namespace
}  // namespace pptam
