// Partial points' rows of the pose: what their unknown depth leaves to it.
#include "tracking/depth_filter.h"

#include <gtest/gtest.h>

#include <Eigen/LU>

#include "tests/support/phone_camera.h"
#include "tests/support/random.h"

namespace pptam {
namespace {

using Matrix26f = Eigen::Matrix<float, 2, 6>;

// The row is the one of a map point, whitened by the covariance S = sigma^2 I + d d^T: its squared error is e^T S^-1 e
// and its information J^T S^-1 J, for any d. Float: 1e-4 is a thousand roundings.
TEST(PartialRows, AreWhitenedByTheDepthsCovariance) {
  test::Random random;
  const Camera camera{test::phone_camera(), test::phone_shutter()};
  const auto uniform = [&](double from, double to) { return static_cast<float>(random.uniform(from, to)); };
  for (int trial = 0; trial < 200; ++trial) {
    PartialAttempt attempt;
    attempt.p_w = {uniform(-0.2, 0.2), uniform(-0.2, 0.2), uniform(0.8, 1.5)};
    Vector2f px;
    ASSERT_TRUE(camera.project(attempt.p_w, &px));
    attempt.at = {px + Vector2f(uniform(-3, 3), uniform(-3, 3)), static_cast<uint8_t>(random.integer(1, 2))};
    PoseRow plain, row;
    attempt.set_row(camera, SE3(), Vector6f::Zero(), &plain);  // the depth is known
    const float length = trial % 3 == 0 ? 1e4f : uniform(0.1, 20), angle = uniform(0, 6.28);
    attempt.depth_px = length * Vector2f(std::cos(angle), std::sin(angle));
    attempt.set_row(camera, SE3(), Vector6f::Zero(), &row);
    ASSERT_EQ(row.components, 2);

    const auto J_of = [](const PoseRow& from) {
      Matrix26f J;
      for (int k = 0; k < 2; ++k)
        for (int c = 0; c < 6; ++c) J(k, c) = from.J[k][c];
      return J;
    };
    // plain is in sigmas already: S / sigma^2 = I + d d^T / sigma^2.
    const Eigen::Vector2d d = (attempt.depth_px / attempt.at.sigma()).cast<double>();
    const Eigen::Matrix2d S = Eigen::Matrix2d::Identity() + d * d.transpose();
    const Matrix2f S_inverse = S.inverse().cast<float>();
    const Vector2f e(plain.e_0[0], plain.e_0[1]);
    const float error_sq = row.e_0[0] * row.e_0[0] + row.e_0[1] * row.e_0[1];
    const Matrix26f J = J_of(plain), J_row = J_of(row);
    const Matrix6f information = J.transpose() * J;
    const float tolerance = 1e-4f * information.norm();
    EXPECT_NEAR(error_sq, e.dot(S_inverse * e), 1e-4f * e.squaredNorm() + 1e-5f) << trial;
    EXPECT_LT((J_row.transpose() * J_row - J.transpose() * S_inverse * J).norm(), tolerance) << trial;
    // Along the line an unknown depth leaves nothing, across it everything.
    const Vector2f u = attempt.depth_px.normalized(), across(-u.y(), u.x());
    const Vector2f e_row(row.e_0[0], row.e_0[1]);
    EXPECT_NEAR(across.dot(e_row), across.dot(e), 1e-4f * e.norm() + 1e-5f);
    if (length > 100) {
      EXPECT_LT(std::abs(u.dot(e_row)), 1e-3f * e.norm() + 1e-5f);
    }
    EXPECT_GT((J_row.transpose() * J_row - information).norm(), tolerance) << "control: the depth matters";
  }
}

}  // namespace
}  // namespace pptam
