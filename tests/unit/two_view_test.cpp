// Triangulation: exact points, least reprojection error, the promised variance, and what is refused.
#include "geometry/two_view.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <limits>

#include "tests/support/random.h"

namespace pptam {
namespace {

constexpr double kEps = 0x1p-24;

Eigen::Vector2d project(const Eigen::Vector3d& p) {
  return p.hnormalized();
}

// A second camera up to half a unit away and turned by up to 0.4 rad, and a point that both see.
struct TwoViews {
  SE3 T_21;
  Eigen::Vector3d p_1;
  Eigen::Vector2d x1;
  Eigen::Vector2d x2;
  Eigen::Vector3d in_second(const Eigen::Vector3d& p) const {
    return T_21.R.cast<double>() * p + T_21.t.cast<double>();
  }
};

TwoViews random_views(test::Random& random) {
  TwoViews views;
  double parallax = 0;
  do {
    Vector6f mu;
    for (int i = 0; i < 3; ++i) {
      mu(i) = static_cast<float>(random.uniform(-0.3, 0.3));
      mu(i + 3) = static_cast<float>(random.uniform(-0.25, 0.25));
    }
    views.T_21 = SE3::exp(mu);
    const double z = std::exp(random.uniform(-1, 2));
    views.p_1 = Eigen::Vector3d(random.uniform(-0.5, 0.5), random.uniform(-0.6, 0.6), 1) * z;
    views.x1 = project(views.p_1);
    const Eigen::Vector3d p_2 = views.in_second(views.p_1);
    views.x2 = project(p_2);
    const Eigen::Vector3d ray_1 = views.T_21.R.cast<double>() * views.p_1;
    parallax = p_2.z() < 0.2 ? 0.0 : std::atan2(ray_1.cross(p_2).norm(), ray_1.dot(p_2));
  } while (parallax < 0.02 || views.x2.norm() > 1);
  return views;
}

TEST(Triangulate, ExactRaysGiveTheExactPoint) {
  test::Random random;
  double worst = 0;
  for (int i = 0; i < 3000; ++i) {
    const TwoViews views = random_views(random);
    Triangulated out;
    ASSERT_TRUE(triangulate(views.T_21, views.x1.cast<float>(), views.x2.cast<float>(), 0.01f, &out)) << i;
    // Rounding of x1, R x1 and x2: about 8 roundings of coordinates up to 1.5, through 1/|d(x2)/d(1/z)|.
    const double tolerance = 12 * kEps * static_cast<double>(out.sigma_inverse_depth);
    const double error = std::fabs(1 / static_cast<double>(out.p_1.z()) - 1 / views.p_1.z());
    worst = std::max(worst, error / tolerance);
    EXPECT_LT(error, tolerance + 2 * kEps / views.p_1.z()) << i;
    EXPECT_LT((project(out.p_1.cast<double>()) - views.x1).norm(), 12 * kEps);
    const Eigen::Vector3d ray_1 = views.T_21.R.cast<double>() * views.p_1;
    const Eigen::Vector3d p_2 = views.in_second(views.p_1);
    EXPECT_NEAR(out.parallax_rad, std::atan2(ray_1.cross(p_2).norm(), ray_1.dot(p_2)), 16 * kEps);
  }
  RecordProperty("worst_of_tolerance", std::to_string(worst));
}

TEST(Triangulate, SigmaIsTheInverseSlopeOfTheSecondView) {
  test::Random random;
  for (int i = 0; i < 500; ++i) {
    const TwoViews views = random_views(random);
    Triangulated out;
    ASSERT_TRUE(triangulate(views.T_21, views.x1.cast<float>(), views.x2.cast<float>(), 0.01f, &out));
    // Central difference over 1e-5 of 1/z along the first ray: error 1e-10 relative, below the 1e-5 that float32's
    // cancellation leaves in the slope at 0.02 rad of parallax (12 roundings / 0.02 = 4e-5).
    const double q = 1 / views.p_1.z();
    const double h = 1e-5 * q;
    const Eigen::Vector3d ray = views.x1.homogeneous();
    const double slope =
        (project(views.in_second(ray / (q + h))) - project(views.in_second(ray / (q - h)))).norm() / (2 * h);
    EXPECT_NEAR(static_cast<double>(out.sigma_inverse_depth) * slope, 1.0, 1e-4);
  }
}

TEST(Triangulate, NoOtherPointHasASmallerReprojectionError) {
  test::Random random;
  for (int i = 0; i < 500; ++i) {
    TwoViews views = random_views(random);
    const double noise = 0.003;  // one pixel
    for (int k = 0; k < 2; ++k) {
      views.x1(k) += noise * random.gaussian();
      views.x2(k) += noise * random.gaussian();
    }
    Triangulated out;
    if (!triangulate(views.T_21, views.x1.cast<float>(), views.x2.cast<float>(), 0.01f, &out)) continue;
    const auto cost = [&](const Eigen::Vector3d& p) {
      return (project(p) - views.x1).squaredNorm() + (project(views.in_second(p)) - views.x2).squaredNorm();
    };
    const Eigen::Vector3d p = out.p_1.cast<double>();
    // A step that moves an image by d raises the cost by about d^2: the float32 optimum is off by some 1e-6, the steps
    // move the images by 1e-4 or more, except along the ray where the slope makes it so.
    const double along_ray = 1e-4 * static_cast<double>(out.sigma_inverse_depth) * p.z();
    const Eigen::Vector3d steps[] = {Eigen::Vector3d(1e-4 * p.z(), 0, 0), Eigen::Vector3d(0, 1e-4 * p.z(), 0),
                                     p * along_ray};
    for (const Eigen::Vector3d& step : steps) {
      EXPECT_GT(cost(p + step), cost(p)) << i;
      EXPECT_GT(cost(p - step), cost(p)) << i;
    }
  }
}

// Standard deviation of 1/z over many noisy measurements, divided by the noise.
double scatter(test::Random& random, const TwoViews& views, double sigma_1, double sigma_2, int trials) {
  double sum_sq = 0;
  for (int i = 0; i < trials; ++i) {
    const Eigen::Vector2d x1 = views.x1 + sigma_1 * Eigen::Vector2d(random.gaussian(), random.gaussian());
    const Eigen::Vector2d x2 = views.x2 + sigma_2 * Eigen::Vector2d(random.gaussian(), random.gaussian());
    Triangulated out;
    if (!triangulate(views.T_21, x1.cast<float>(), x2.cast<float>(), 0.001f, &out)) ADD_FAILURE();
    const double error = 1 / static_cast<double>(out.p_1.z()) - 1 / views.p_1.z();
    sum_sq += error * error;
  }
  return std::sqrt(sum_sq / trials);
}

TEST(Triangulate, NoiseSpreadsInverseDepthAsPromised) {
  test::Random random;
  const int trials = 1500;
  const double sigma = 2e-4;  // small against the parallax, so that the first order holds within a few per cent
  // A standard deviation from 1500 samples is itself good to 1/sqrt(3000) = 1.8 %; four of them, and curvature.
  const double tolerance = 0.09;
  for (int i = 0; i < 10; ++i) {
    const TwoViews views = random_views(random);
    Triangulated out;
    ASSERT_TRUE(triangulate(views.T_21, views.x1.cast<float>(), views.x2.cast<float>(), 0.01f, &out));
    const double promised = sigma * static_cast<double>(out.sigma_inverse_depth);
    const double second_only = scatter(random, views, 0, sigma, trials);
    EXPECT_NEAR(second_only / promised, 1.0, tolerance) << i;
    EXPECT_GT(std::fabs(second_only / (1.2 * promised) - 1.0), tolerance) << "a promise 20 % off must show";
    // Equal noise in both views: the least-squares covariance of (u, v, 1/z), Jacobian by central differences.
    Eigen::Matrix<double, 2, 3> J;
    for (int k = 0; k < 3; ++k) {
      const auto second_view = [&](double h) {
        Eigen::Vector3d unknowns(views.x1.x(), views.x1.y(), 1 / views.p_1.z());
        unknowns(k) += h;
        return project(views.in_second(Eigen::Vector3d(unknowns.x(), unknowns.y(), 1) / unknowns.z()));
      };
      J.col(k) = (second_view(1e-6) - second_view(-1e-6)) / 2e-6;
    }
    Eigen::Matrix3d information = J.transpose() * J;
    information(0, 0) += 1;
    information(1, 1) += 1;
    const double expected_both = sigma * std::sqrt(information.inverse()(2, 2));
    EXPECT_NEAR(scatter(random, views, sigma, sigma, trials) / expected_both, 1.0, tolerance) << i;
  }
}

TEST(Triangulate, RefusesWhatHasNoPoint) {
  const SE3 sideways(Matrix3f::Identity(), Vector3f(-0.1f, 0, 0));  // the second camera 0.1 to the right
  Triangulated out;
  out.p_1 = Vector3f(7, 7, 7);
  const Vector2f centre(0, 0);
  EXPECT_TRUE(triangulate(sideways, centre, Vector2f(-0.1f, 0), 0.01f, &out));
  EXPECT_LT((out.p_1 - Vector3f(0, 0, 1)).norm(), 8 * kEps);
  out.p_1 = Vector3f(7, 7, 7);
  EXPECT_FALSE(triangulate(sideways, centre, centre, 0.01f, &out));                // parallel
  EXPECT_FALSE(triangulate(sideways, centre, Vector2f(-0.009f, 0), 0.01f, &out));  // nearly
  EXPECT_FALSE(triangulate(sideways, centre, Vector2f(0.1f, 0), 0.01f, &out));     // meets behind
  EXPECT_FALSE(triangulate(SE3(), centre, Vector2f(0.1f, 0), 0.01f, &out));        // no baseline
  EXPECT_FALSE(triangulate(SE3(Matrix3f::Identity(), Vector3f(0, 0, -2)), Vector2f(0.5f, 0), Vector2f(-0.5f, 0), 0.01f,
                           &out));  // the point z = 1 is behind the second camera
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const float infinity = std::numeric_limits<float>::infinity();
  for (const float bad : {nan, infinity, -infinity, 1e30f}) {
    EXPECT_FALSE(triangulate(sideways, Vector2f(bad, 0), Vector2f(-0.1f, 0), 0.01f, &out)) << bad;
    EXPECT_FALSE(triangulate(sideways, centre, Vector2f(bad, 0), 0.01f, &out)) << bad;
    EXPECT_FALSE(triangulate(SE3(Matrix3f::Identity(), Vector3f(bad, 0, 0)), centre, Vector2f(-0.1f, 0), 0.01f, &out));
    EXPECT_FALSE(
        triangulate(SE3(Matrix3f::Constant(bad), Vector3f(-1, 0, 0)), centre, Vector2f(-0.1f, 0), 0.01f, &out));
  }
  EXPECT_EQ(out.p_1, Vector3f(7, 7, 7));
}

TEST(Triangulate, ScaleOfTheBaselineScalesThePoint) {
  test::Random random;
  for (int i = 0; i < 100; ++i) {
    const TwoViews views = random_views(random);
    for (const float scale : {1e-3f, 1e3f}) {
      Triangulated a;
      Triangulated b;
      SE3 scaled = views.T_21;
      scaled.t *= scale;
      ASSERT_TRUE(triangulate(views.T_21, views.x1.cast<float>(), views.x2.cast<float>(), 0.01f, &a));
      ASSERT_TRUE(triangulate(scaled, views.x1.cast<float>(), views.x2.cast<float>(), 0.01f, &b));
      // t / |t| differs by three roundings, amplified by the same slope as above (in units of the baseline).
      const double relative =
          12 * kEps * static_cast<double>(a.sigma_inverse_depth) * static_cast<double>(a.p_1.z()) + 8 * kEps;
      EXPECT_LT((b.p_1 / scale - a.p_1).norm() / a.p_1.norm(), relative);
      EXPECT_NEAR(b.sigma_inverse_depth * scale / a.sigma_inverse_depth, 1.0, 1e-4);
    }
  }
}

}  // namespace
}  // namespace pptam
