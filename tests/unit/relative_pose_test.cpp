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
  int wrong = 0, least_squares_wrong = 0;
  for (int trial = 0; trial < 200; ++trial) {
    Scene scene = random_scene(random, 100, 5e-4);
    for (size_t i = 0; i < 30; ++i) {  // 7 to 30 px off: what a search finds in its circle
      const double angle = random.uniform(0, 6.28318), size = random.uniform(0.02, 0.08);
      scene.correspondences[i].x2 += Vector2f(static_cast<float>(size * std::cos(angle)),  //
                                              static_cast<float>(size * std::sin(angle)));
    }
    // A single start ends in a wrong minimum once in 40 times, the best of a few, compared at one scale, rarely.
    RelativePose pose;
    for (int start = 0; start < 5; ++start) {
      const RelativePose next = refine(scene, disturbed(random, scene.T_21, 0.005f, 0.05f));
      if (next.ok && (!pose.ok || next.cost * next.sigma * next.sigma < pose.cost * pose.sigma * pose.sigma))
        pose = next;
    }
    ASSERT_TRUE(pose.ok) << trial;
    // All that is good; a shift along the epipolar line cannot be seen: within the 4.685 sigma of 5e-4 across it lie,
    // of shifts of 0.02 to 0.08 in any direction, 2 / pi x 1.4 x 0.0023 / 0.045 = 5 %, and to these some that a pose
    // between good and bad lets in.
    EXPECT_GE(pose.inliers, 68) << trial;
    EXPECT_LE(pose.inliers, 78) << trial;
    // 5 sigma: the worst of 200 trials of two coordinates is at 4.1.
    const double bound = 5 * static_cast<double>(pose.sigma_t_rad);
    wrong += direction_error(scene, pose) > bound || rotation_error(scene, pose) > bound;
    // All weights equal: least squares.
    std::vector<float> scratch(scene.correspondences.size());
    const RelativePose plain = refine_relative_pose(scene.correspondences, scene.T_21, kSteps, 10.0f, scratch);
    least_squares_wrong += !plain.ok || direction_error(scene, plain) > bound;
  }
  EXPECT_LE(wrong, 2);  // 1 %: minima that fit as well as the truth
  EXPECT_GT(least_squares_wrong, 100) << "least squares must fail here, or the outliers were too easy";
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
