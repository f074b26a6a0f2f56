// The pose update: exact data, the promised covariance, outliers, the rolling shutter, and what is refused.
#include "camera/pose_update.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <vector>

#include "tests/support/phone_camera.h"
#include "tests/support/random.h"

namespace pptam {
namespace {

constexpr float kFloor = 0.15f;
constexpr int kPoints = 50;

using test::phone_camera;
using test::phone_shutter;

Vector6f random_twist(test::Random& random, double translation, double rotation) {
  Vector6f mu;
  for (int i = 0; i < 3; ++i) {
    mu(i) = static_cast<float>(translation * random.gaussian());
    mu(i + 3) = static_cast<float>(rotation * random.gaussian());
  }
  return mu;
}

struct View {
  SE3 T_cw;
  Vector6f velocity = Vector6f::Zero();
  std::vector<PosePoint> points;
};

// Where the point is seen when its own line is exposed; the iteration contracts by the image speed times the line's
// time, under 0.2 here, so that 20 passes leave 1e-12 px.
Eigen::Vector2d rolling_pixel(const CameraModel& camera, const RollingShutter& shutter, const SE3& T_cw,
                              const Vector6f& velocity, const Vector3f& p_w) {
  Vector2f px = Vector2f::Zero();
  Vector2f line(camera.cx, camera.cy);
  for (int pass = 0; pass < 20; ++pass) {
    const SE3 T_line = pose_at(T_cw, velocity, shutter.dt_s(line, camera.width, camera.height));
    if (!camera.project(T_line * p_w, &px)) ADD_FAILURE() << "the test's point is not visible";
    line = px;
  }
  return px.cast<double>();
}

// A random pose and points 0.7 to 1.5 away all over the image, measured with noise of `noise` sigmas.
View random_view(test::Random& random, const RollingShutter& shutter, const Vector6f& velocity, double noise) {
  const CameraModel camera = phone_camera();
  View view;
  view.T_cw = SE3::exp(random_twist(random, 0.5, 0.7));
  view.velocity = velocity;
  const SE3 T_wc = view.T_cw.inverse();
  for (int i = 0; i < kPoints; ++i) {
    const Vector2f ray = camera.unproject(
        Vector2f(static_cast<float>(random.uniform(15, 225)), static_cast<float>(random.uniform(15, 305))));
    const float z = static_cast<float>(random.uniform(0.7, 1.5));
    PosePoint point;
    point.p_w = T_wc * Vector3f(ray.x() * z, ray.y() * z, z);
    point.sigma = 2;
    point.px = rolling_pixel(camera, shutter, view.T_cw, velocity, point.p_w).cast<float>();
    for (int k = 0; k < 2; ++k) point.px(k) += static_cast<float>(noise * 2 * random.gaussian());
    view.points.push_back(point);
  }
  return view;
}

// Root mean square over the points of how far two poses' images of them lie apart, level-0 pixels.
double image_error(const View& view, const SE3& T_cw) {
  const CameraModel camera = phone_camera();
  double sum = 0;
  for (const PosePoint& point : view.points) {
    Vector2f a, b;
    if (!camera.project(view.T_cw * point.p_w, &a) || !camera.project(T_cw * point.p_w, &b)) return 1e9;
    sum += (a - b).cast<double>().squaredNorm();
  }
  return std::sqrt(sum / static_cast<double>(view.points.size()));
}

PoseUpdate update(View& view, const RollingShutter& shutter, const SE3& T_start, const VelocityPrior& prior,
                  float floor = kFloor) {
  WorkMeter meter;
  return update_pose(phone_camera(), shutter, T_start, prior, view.points, floor, meter);
}

bool same_bits(const SE3& a, const SE3& b) {
  return std::memcmp(a.R.data(), b.R.data(), sizeof(float) * 9) == 0 &&
         std::memcmp(a.t.data(), b.t.data(), sizeof(float) * 3) == 0;
}

TEST(PoseUpdate, ExactMeasurementsGiveTheTruePose) {
  test::Random random;
  // Each entry of R and t is rounded in every one of up to ten updates: 10 x 6e-8 x f = 2e-4 px; the measured pixel
  // itself to 1.5e-5 px and its projection by a few of these. Twice that.
  const double tolerance_px = 5e-4;
  for (int trial = 0; trial < 200; ++trial) {
    View view = random_view(random, {}, Vector6f::Zero(), 0);
    const SE3 T_start = SE3::exp(random_twist(random, 0.02, 0.02)) * view.T_cw;  // about 7 px each
    const PoseUpdate pose = update(view, {}, T_start, {});
    ASSERT_TRUE(pose.ok) << trial;
    EXPECT_EQ(pose.inliers, kPoints);
    EXPECT_LT(image_error(view, pose.T_cw), tolerance_px) << trial;
    Vector6f slip = Vector6f::Zero();
    slip(4) = 5e-6f;  // a turn of a millionth of a circle
    EXPECT_GT(image_error(view, SE3::exp(slip) * pose.T_cw), tolerance_px) << "the measure must be able to fail";
  }
}

// Mean over many trials of mu^T C^-1 mu, which has 6 degrees of freedom when the covariance C is right.
double mean_nees(test::Random& random, bool rolling, int trials) {
  const RollingShutter shutter = rolling ? phone_shutter() : RollingShutter{};
  double sum = 0;
  for (int trial = 0; trial < trials; ++trial) {
    VelocityPrior prior;
    Vector6f velocity = Vector6f::Zero();
    if (rolling) {
      prior.mean = random_twist(random, 0.1, 0.3);
      prior.sigma_translation = 0.06f;
      prior.sigma_rotation = 0.15f;
      velocity = prior.mean + random_twist(random, prior.sigma_translation, prior.sigma_rotation);
    }
    View view = random_view(random, shutter, velocity, 0.5);
    const SE3 T_start = SE3::exp(random_twist(random, 0.01, 0.01)) * view.T_cw;
    const PoseUpdate pose = update(view, shutter, T_start, prior);
    if (!pose.ok) {
      ADD_FAILURE() << "no pose in trial " << trial;
      return 0;
    }
    const Eigen::Matrix<double, 6, 1> mu = (pose.T_cw * view.T_cw.inverse()).log().cast<double>();
    const Eigen::Matrix<double, 6, 6> covariance = pose.covariance.cast<double>();
    sum += mu.dot(covariance.ldlt().solve(mu));
  }
  return sum / trials;
}

// What to expect of the mean: the reported covariance divides by the mean Tukey weight of Gaussian residuals, 0.859 at
// the cut-off of 5.12 sigma, the estimator's own is 1/0.95 of least squares: 6 x 0.859 / 0.95 = 5.4. The residuals'
// scale is too small by the fitted parameters (6 to 12 of 100 equations): 5.8 to 6.2. A trial's value has a variance
// of 12, and some for the scale's own 20 %: the mean of 400 is good to 0.2. Four of these and 0.3 for curvature.
constexpr double kNeesLow = 4.7, kNeesHigh = 7.1;

TEST(PoseUpdate, ErrorsMatchTheReportedCovariance) {
  test::Random random;
  for (const bool rolling : {false, true}) {
    const double nees = mean_nees(random, rolling, 400);
    EXPECT_GT(nees, kNeesLow) << "rolling " << rolling;
    EXPECT_LT(nees, kNeesHigh) << "rolling " << rolling;
    // A covariance that is wrong by a factor of 1.6 (a standard deviation by 1.26) must show.
    EXPECT_GT(nees * 1.6, kNeesHigh);
    EXPECT_LT(nees / 1.6, kNeesLow);
  }
}

TEST(PoseUpdate, FortyPerCentOutliersAreRejected) {
  test::Random random;
  double worst = 0, least_squares = 0;
  const int trials = 200;
  int lost_inliers = 0;
  for (int trial = 0; trial < trials; ++trial) {
    View view = random_view(random, {}, Vector6f::Zero(), 0.5);
    const int outliers = kPoints * 2 / 5;
    for (int i = 0; i < outliers; ++i) {
      const double angle = random.uniform(0, 6.28318), size = random.uniform(20, 60);
      view.points[static_cast<size_t>(i)].px += Vector2f(static_cast<float>(size * std::cos(angle)),  //
                                                         static_cast<float>(size * std::sin(angle)));
    }
    const SE3 T_start = SE3::exp(random_twist(random, 0.005, 0.005)) * view.T_cw;
    const PoseUpdate pose = update(view, {}, T_start, {});
    ASSERT_TRUE(pose.ok) << trial;
    // With 40 % outliers the median sits at 0.83 of the good ones: a scale 1.6 times too large, 5.12 of which are 8 px;
    // even beside a pose error of 1.5 px and noise of 4 sigma none of 20 px is within.
    for (int i = 0; i < outliers; ++i) EXPECT_EQ(view.points[static_cast<size_t>(i)].weight, 0.0f) << trial;
    for (int i = outliers; i < kPoints; ++i) lost_inliers += view.points[static_cast<size_t>(i)].weight == 0;
    worst = std::max(worst, image_error(view, pose.T_cw));
    View plain = view;
    // An enormous floor makes all weights equal: least squares.
    least_squares += image_error(view, update(plain, {}, T_start, {}, 1e3f).T_cw) / trials;
  }
  // 30 points of 1 px: rms over the image sqrt(6 / 60) = 0.32 px (at two coordinates: x sqrt 2 = 0.45); the worst of
  // 200 trials at sqrt(chi2_6 / 6) = 2.1 times that.
  EXPECT_LT(worst, 1.3);
  EXPECT_EQ(lost_inliers, 0);
  EXPECT_GT(least_squares, 2.6) << "least squares must fail here, or the outliers were too easy";
}

TEST(PoseUpdate, RecoversTheVelocityDuringTheReadout) {
  test::Random random;
  const CameraModel camera = phone_camera();
  const RollingShutter shutter = phone_shutter();
  double with_prior = 0, without = 0, flow_error = 0, prior_flow_error = 0;
  const int trials = 100;
  for (int trial = 0; trial < trials; ++trial) {
    // 0.6 radians/s about axes in the image plane, 0.15 units/s sideways: some 270 px/s.
    const double a = random.uniform(0, 6.28318), b = random.uniform(0, 6.28318);
    Vector6f velocity;
    velocity << static_cast<float>(0.15 * std::cos(b)), static_cast<float>(0.15 * std::sin(b)), 0,
        static_cast<float>(0.6 * std::cos(a)), static_cast<float>(0.6 * std::sin(a)), 0.1f;
    View view = random_view(random, shutter, velocity, 0.15);
    const SE3 T_start = SE3::exp(random_twist(random, 0.005, 0.005)) * view.T_cw;
    VelocityPrior prior;
    prior.sigma_translation = 0.06f;
    prior.sigma_rotation = 0.15f;
    prior.mean = velocity + random_twist(random, prior.sigma_translation, prior.sigma_rotation);
    View ignorant = view;
    const PoseUpdate pose = update(view, shutter, T_start, prior);
    const PoseUpdate global = update(ignorant, {}, T_start, {});
    ASSERT_TRUE(pose.ok);
    ASSERT_TRUE(global.ok);
    with_prior += image_error(view, pose.T_cw) / trials;
    without += image_error(view, global.T_cw) / trials;
    // Image motion during half the readout, by the estimated and by the prior's velocity.
    for (const PosePoint& point : view.points) {
      const Vector3f p_c = view.T_cw * point.p_w;
      Vector2f px;
      Matrix23f J;
      ASSERT_TRUE(camera.project(p_c, &px, &J));
      const Matrix26f J_v = J * se3_point_jacobian(p_c) * 0.030f;
      flow_error += (J_v * (pose.velocity - velocity)).squaredNorm() / (trials * kPoints);
      prior_flow_error += (J_v * (prior.mean - velocity)).squaredNorm() / (trials * kPoints);
    }
  }
  // Twelve parameters from 100 equations of 0.3 px: the fitted images are good to 0.3 sqrt(2 x 12 / 100) = 0.15 px; the
  // pose alone and the flow over half the readout are the middle and the ends of that fit, at most twice as bad.
  EXPECT_LT(with_prior, 0.30);
  EXPECT_LT(std::sqrt(flow_error), 0.30);
  EXPECT_GT(std::sqrt(prior_flow_error), 1.2) << "the prior must have been wrong";
  EXPECT_GT(without, 4 * with_prior);
}

TEST(PoseUpdate, FixedVelocityStaysAsGiven) {
  test::Random random;
  VelocityPrior prior;
  prior.mean = random_twist(random, 0.1, 0.3);
  View view = random_view(random, phone_shutter(), prior.mean, 0);
  const PoseUpdate pose = update(view, phone_shutter(), view.T_cw, prior);
  ASSERT_TRUE(pose.ok);
  EXPECT_EQ(pose.velocity, prior.mean);
  EXPECT_LT(image_error(view, pose.T_cw), 5e-4);  // as for exact measurements without a rolling shutter
}

void expect_refused(View view, const char* why) {
  const SE3 T_start = SE3::exp(Vector6f::Constant(0.001f)) * view.T_cw;
  VelocityPrior prior;
  prior.sigma_translation = 0.06f;
  prior.sigma_rotation = 0.15f;
  for (const RollingShutter& shutter : {RollingShutter{}, phone_shutter()}) {
    const PoseUpdate pose = update(view, shutter, T_start, prior);
    EXPECT_FALSE(pose.ok) << why;
    EXPECT_TRUE(same_bits(pose.T_cw, T_start)) << why;
  }
}

TEST(PoseUpdate, RefusesWhatDoesNotGiveAPose) {
  test::Random random;
  const View good = random_view(random, {}, Vector6f::Zero(), 0.1);
  View view = good;
  view.points.clear();
  expect_refused(view, "no points");
  view.points.assign(good.points.begin(), good.points.begin() + 5);
  expect_refused(view, "five points");
  view = good;
  for (PosePoint& point : view.points) point.p_w = view.T_cw.inverse() * -(view.T_cw * point.p_w);
  expect_refused(view, "all behind");
  for (size_t i = 0; i < 5; ++i) view.points[i] = good.points[i];
  expect_refused(view, "five in front, the others behind");
  view = good;
  for (PosePoint& point : view.points) point = view.points[0];
  expect_refused(view, "one point fifty times");
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const float infinity = std::numeric_limits<float>::infinity();
  for (const float bad : {nan, infinity, -infinity}) {
    view = good;
    for (PosePoint& point : view.points) point.px.x() = bad;
    expect_refused(view, "measurements not finite");
    view = good;
    for (PosePoint& point : view.points) point.p_w.y() = bad;
    expect_refused(view, "points not finite");
    view = good;
    for (PosePoint& point : view.points) point.sigma = nan;
    expect_refused(view, "sigma not finite");
  }
}

TEST(PoseUpdate, OneBadNumberAmongManyNeverGivesAWildPose) {
  test::Random random;
  const float nan = std::numeric_limits<float>::quiet_NaN();
  for (int trial = 0; trial < 200; ++trial) {
    View view = random_view(random, {}, Vector6f::Zero(), 0.1);
    PosePoint& victim = view.points[static_cast<size_t>(random.integer(0, kPoints - 1))];
    (trial % 2 ? victim.px.x() : victim.p_w.x()) = nan;
    const SE3 T_start = SE3::exp(random_twist(random, 0.005, 0.005)) * view.T_cw;
    const PoseUpdate pose = update(view, {}, T_start, {});
    EXPECT_EQ(victim.weight, 0.0f) << trial;
    view.points.erase(view.points.begin() + (&victim - view.points.data()));
    if (pose.ok) {
      EXPECT_LT(image_error(view, pose.T_cw), 0.5) << trial;  // ten sigma of 0.2 px x sqrt(6 / 50)
    } else {
      EXPECT_TRUE(same_bits(pose.T_cw, T_start)) << trial;
    }
  }
}

TEST(ProjectRolling, SettlesOnTheLineThatSeesThePoint) {
  test::Random random;
  const CameraModel camera = phone_camera();
  const RollingShutter shutter = phone_shutter();
  for (const double speed : {0.1, 0.6, 1.0}) {  // radians/s
    double worst = 0;
    for (int trial = 0; trial < 300; ++trial) {
      const Vector2f ray = camera.unproject(
          Vector2f(static_cast<float>(random.uniform(60, 180)), static_cast<float>(random.uniform(60, 260))));
      const Vector3f p(ray.x(), ray.y(), 1);
      Vector6f velocity = Vector6f::Zero();
      const double angle = random.uniform(0, 6.28318);
      velocity(3) = static_cast<float>(speed * std::cos(angle));
      velocity(4) = static_cast<float>(speed * std::sin(angle));
      Vector2f px;
      SE3 T_line;
      ASSERT_TRUE(project_rolling(camera, shutter, SE3(), velocity, p, &px, &T_line));
      const Eigen::Vector2d exact = rolling_pixel(camera, shutter, SE3(), velocity, p);
      worst = std::max(worst, (px.cast<double>() - exact).norm());
      Vector2f again;
      ASSERT_TRUE(camera.project(T_line * p, &again));
      // The third-order motion leaves (30 mrad)^4 / 24, under 1e-4 px; the rest is float32's.
      EXPECT_LT((again - px).norm(), 3e-4f) << "px is the image under T_line";
    }
    // The start is off by the motion until the point's line, up to 60 px / 240 px of the readout and a little more for
    // the points that move outwards: s x 70 px with s = image speed x line time, f (1 + 0.2) rad/s / (4000 px/s) at the
    // most. Each pass multiplies by s. 2e-4 px for float32.
    const double s = speed * 358.6 * 1.2 / 4000;
    EXPECT_LT(worst, 70 * s * s * s + 2e-4) << speed;
    // Without any pass the start's error would be seen.
    EXPECT_GT(30 * s, 70 * s * s * s + 2e-4);
  }
}

}  // namespace
}  // namespace pptam
