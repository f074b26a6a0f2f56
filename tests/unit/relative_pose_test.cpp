// The relative pose of two views from the epipolar constraint: exact and noisy data, outliers, and what is refused.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "geometry/two_view.h"
#include "tests/support/random.h"

namespace pptam {
namespace {

constexpr int kSteps = 12;
constexpr float kFloor = 1e-4f;

struct Scene {
  SE3 T_21;  // |t| = 1
  std::vector<Correspondence> correspondences;
};

Vector3f random_direction(test::Random& random) {
  Vector3f v;
  do {
    for (int i = 0; i < 3; ++i) v(i) = static_cast<float>(random.uniform(-1, 1));
  } while (v.norm() > 1 || v.norm() < 0.1f);
  return v.normalized();
}

// Points 4 to 12 baselines away (parallax 5 to 14 degrees), over a view of 41 x 53 degrees; turned by up to 11 degrees.
Scene random_scene(test::Random& random, int count, double noise) {
  Scene scene;
  Vector3f t = random_direction(random);
  t.z() *= 0.5f;  // mostly sideways: forward motion tells little about its own direction near the epipole
  scene.T_21 = SE3(so3_exp(random_direction(random) * static_cast<float>(random.uniform(0, 0.2))), t.normalized());
  while (static_cast<int>(scene.correspondences.size()) < count) {
    const double z = random.uniform(4, 12);
    const Eigen::Vector3d p_1 = Eigen::Vector3d(random.uniform(-0.37, 0.37), random.uniform(-0.5, 0.5), 1) * z;
    const Eigen::Vector3d p_2 = scene.T_21.R.cast<double>() * p_1 + scene.T_21.t.cast<double>();
    if (p_2.z() < 1) continue;
    Correspondence c;
    const Eigen::Vector2d e1(random.gaussian(), random.gaussian()), e2(random.gaussian(), random.gaussian());
    c.x1 = (Eigen::Vector2d(p_1.hnormalized()) + noise * e1).cast<float>();
    c.x2 = (Eigen::Vector2d(p_2.hnormalized()) + noise * e2).cast<float>();
    scene.correspondences.push_back(c);
  }
  return scene;
}

SE3 disturbed(test::Random& random, const SE3& T, float rotation, float direction) {
  const Vector3f t = so3_exp(T.t.cross(random_direction(random)).normalized() * direction) * T.t;
  return SE3(so3_exp(random_direction(random) * rotation) * T.R, t);
}

RelativePose refine(const Scene& scene, const SE3& T_start) {
  std::vector<float> scratch(scene.correspondences.size());
  return refine_relative_pose(scene.correspondences, T_start, kSteps, kFloor, scratch);
}

double rotation_error(const Scene& scene, const RelativePose& pose) {
  return static_cast<double>(so3_log(pose.T_21.R * scene.T_21.R.transpose()).norm());
}
double direction_error(const Scene& scene, const RelativePose& pose) {
  return std::atan2(pose.T_21.t.cross(scene.T_21.t).norm(), pose.T_21.t.dot(scene.T_21.t));
}

TEST(RelativePose, ExactDataGiveTheExactMotion) {
  test::Random random;
  for (int trial = 0; trial < 200; ++trial) {
    const Scene scene = random_scene(random, 60, 0);
    const RelativePose pose = refine(scene, disturbed(random, scene.T_21, 0.03f, 0.15f));
    ASSERT_TRUE(pose.ok) << trial;
    EXPECT_EQ(pose.inliers, 60);
    EXPECT_NEAR(pose.T_21.t.norm(), 1, 1e-6);
    // float32 leaves a few 1e-7 in each distance to a line. sigma_t at the floor of 1e-4 tells how distances turn into
    // the direction: 4 sigma at 100 times less noise (1e-6), and the rotation is better known than the direction.
    const double tolerance = 4 * static_cast<double>(pose.sigma_t_rad) / 100 + 2e-6;
    EXPECT_LT(direction_error(scene, pose), tolerance) << trial;
    EXPECT_LT(rotation_error(scene, pose), tolerance) << trial;
    const RelativePose slipped{SE3(so3_exp(Vector3f(0, 0.01f, 0)) * pose.T_21.R, pose.T_21.t), 0, 0, 0, 0, true};
    EXPECT_GT(rotation_error(scene, slipped), tolerance) << "the measure must be able to fail";
  }
}

// Mean of (direction error)^2 / sigma_t^2: sigma_t is the worst of two directions, so the mean lies between 1 (one
// direction is much worse) and 2 (both alike) when the noise is as claimed.
TEST(RelativePose, NoiseSpreadsTheDirectionAsPromised) {
  test::Random random;
  const int trials = 400;
  double sum = 0, sigma = 0;
  int bad = 0;
  for (int trial = 0; trial < trials; ++trial) {
    const Scene scene = random_scene(random, 100, 1e-3);  // 0.36 px of the phone
    const RelativePose pose = refine(scene, disturbed(random, scene.T_21, 0.02f, 0.1f));
    if (!pose.ok) {
      ++bad;
      continue;
    }
    const double ratio = direction_error(scene, pose) / static_cast<double>(pose.sigma_t_rad);
    sum += std::min(ratio * ratio, 25.0) / trials;
    sigma += static_cast<double>(pose.sigma) / trials;
  }
  EXPECT_EQ(bad, 0);
  // Equal noise in both views: the distance is scaled to have the noise of one coordinate. Five parameters from 100
  // equations shrink it by 2.5 %; the median's own error averages out over 400 trials.
  EXPECT_NEAR(sigma, 1e-3, 5e-5);
  // Between 1 and 2, times 0.85 to 1.15: mean weight and efficiency of the robust fit, as the reported covariance
  // divides by the weights; the mean of 400 is good to 4 x sqrt(2 x 2 / 400) = 0.4.
  EXPECT_GT(sum, 0.85 - 0.3);
  EXPECT_LT(sum, 2.3 + 0.4);
  EXPECT_GT(4 * sum, 2.3 - 0.1) << "a sigma twice too small must show";
}

TEST(RelativePose, ThirtyPerCentOutliersAreRejected) {
  test::Random random;
  for (int trial = 0; trial < 200; ++trial) {
    Scene scene = random_scene(random, 100, 5e-4);
    for (size_t i = 0; i < 30; ++i)
      scene.correspondences[i].x2 = Vector2f(static_cast<float>(random.uniform(-0.4, 0.4)),  //
                                             static_cast<float>(random.uniform(-0.5, 0.5)));
    const RelativePose pose = refine(scene, disturbed(random, scene.T_21, 0.01f, 0.08f));
    ASSERT_TRUE(pose.ok) << trial;
    // All that is good, less the 3e-6 of a Gaussian beyond 4.685 sigma; a wrong point agrees by chance where its line
    // passes: a strip of +-1.4 x 4.685 sigma of the image's height, under 2 x 0.0033 / 0.8 of 30 points, half of these
    // in front: fewer than 4 of 30 in any of 200 trials.
    EXPECT_GE(pose.inliers, 68) << trial;
    EXPECT_LE(pose.inliers, 75) << trial;
    // 5 sigma, the worst of 200 trials of two coordinates being at 4.1.
    EXPECT_LT(direction_error(scene, pose), 5 * static_cast<double>(pose.sigma_t_rad)) << trial;
    EXPECT_LT(rotation_error(scene, pose), 5 * static_cast<double>(pose.sigma_t_rad)) << trial;
  }
}

TEST(RelativePose, TheCamerasSeeThePointsInFront) {
  test::Random random;
  for (int trial = 0; trial < 100; ++trial) {
    const Scene scene = random_scene(random, 60, 5e-4);
    SE3 T_start = disturbed(random, scene.T_21, 0.01f, 0.08f);
    const RelativePose pose = refine(scene, T_start);
    T_start.t *= -7;  // sign and length of the start mean nothing
    const RelativePose mirrored = refine(scene, T_start);
    ASSERT_TRUE(pose.ok);
    ASSERT_TRUE(mirrored.ok);
    EXPECT_GT(pose.T_21.t.dot(scene.T_21.t), 0.5f);
    EXPECT_GT(mirrored.T_21.t.dot(scene.T_21.t), 0.5f);
    EXPECT_EQ(pose.inliers, mirrored.inliers);
  }
}

TEST(RelativePose, PureRotationHasNoDirection) {
  test::Random random;
  int sure = 0;
  for (int trial = 0; trial < 100; ++trial) {
    Scene scene = random_scene(random, 100, 0);
    for (Correspondence& c : scene.correspondences) {
      const Vector3f turned = scene.T_21.R * c.x1.homogeneous();
      c.x2 = turned.hnormalized();
      for (int k = 0; k < 2; ++k) c.x2(k) += static_cast<float>(1e-3 * random.gaussian());
    }
    const RelativePose pose = refine(scene, disturbed(random, scene.T_21, 0.02f, 0.5f));
    // The noise's own parallax of 1e-3 rad is all there is: a direction from it would have a sigma of the order of
    // 1 / sqrt(100) at best; what a map needs is ten times less.
    sure += pose.ok && pose.sigma_t_rad < 0.05f;
  }
  EXPECT_EQ(sure, 0);
}

TEST(RelativePose, RefusesWhatHasNoMotion) {
  test::Random random;
  const Scene good = random_scene(random, 60, 0);
  std::vector<float> scratch(60);
  const auto ok = [&](const Scene& scene, const SE3& T_start) { return refine(scene, T_start).ok; };
  EXPECT_TRUE(ok(good, good.T_21));
  EXPECT_FALSE(ok(good, SE3(good.T_21.R, Vector3f::Zero()))) << "no direction to start from";
  Scene scene = good;
  scene.correspondences.resize(7);
  EXPECT_FALSE(ok(scene, scene.T_21)) << "seven points";
  scene.correspondences.clear();
  EXPECT_FALSE(ok(scene, scene.T_21)) << "none";
  scene = good;
  for (Correspondence& c : scene.correspondences) c = good.correspondences[0];
  EXPECT_FALSE(ok(scene, scene.T_21)) << "one point sixty times";
  scene = good;
  for (Correspondence& c : scene.correspondences) c.x2 = (scene.T_21.R * c.x1.homogeneous()).hnormalized();
  EXPECT_FALSE(ok(scene, scene.T_21)) << "exact rotation";
  const float nan = std::numeric_limits<float>::quiet_NaN();
  scene = good;
  for (Correspondence& c : scene.correspondences) c.x1.x() = nan;
  EXPECT_FALSE(ok(scene, scene.T_21)) << "not finite";
  EXPECT_FALSE(ok(good, SE3(Matrix3f::Constant(nan), good.T_21.t)));
  EXPECT_FALSE(ok(good, SE3(good.T_21.R, Vector3f::Constant(nan))));
  // The scratch bounds what is read: with room for seven there are too few.
  EXPECT_FALSE(refine_relative_pose(good.correspondences, good.T_21, kSteps, kFloor, std::span(scratch).first(7)).ok);
}

}  // namespace
}  // namespace pptam
