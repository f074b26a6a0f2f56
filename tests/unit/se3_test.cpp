// Exponential maps against double-precision series, round trips at identity, tiny, random and near pi, Jacobians.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>

#include <pocket_ptam/se3.h>
#include "tests/support/random.h"

namespace pptam {
namespace {

constexpr double kPi = 3.14159265358979323846;
// One float32 rounding of a number near 1.
constexpr double kEps = 0x1p-24;

// exp of a square matrix in double precision: the series of A/2^10, squared ten times.
template <int N>
Eigen::Matrix<double, N, N> matrix_exp(const Eigen::Matrix<double, N, N>& A) {
  using M = Eigen::Matrix<double, N, N>;
  const M scaled = A * 0x1p-10;
  M term = M::Identity();
  M sum = M::Identity();
  for (int k = 1; k < 20; ++k) {
    term = M(term * scaled / k);
    sum += term;
  }
  for (int i = 0; i < 10; ++i) sum = M(sum * sum);
  return sum;
}

Eigen::Matrix3d hat_double(const Eigen::Vector3d& a) {
  Eigen::Matrix3d m;
  m << 0, -a.z(), a.y(), a.z(), 0, -a.x(), -a.y(), a.x(), 0;
  return m;
}

Eigen::Matrix4d se3_exp_double(const Vector6f& mu) {
  Eigen::Matrix4d A = Eigen::Matrix4d::Zero();
  A.topLeftCorner<3, 3>() = hat_double(mu.tail<3>().cast<double>());
  A.topRightCorner<3, 1>() = mu.head<3>().cast<double>();
  return matrix_exp<4>(A);
}

Vector3f random_direction(test::Random& random) {
  Vector3f v;
  do {
    for (int i = 0; i < 3; ++i) v(i) = static_cast<float>(random.gaussian());
  } while (v.norm() < 0.1f);
  return v.normalized();
}

// Angles that exercise each branch: zero, denormal-ish, the series, its edge, ordinary ones, next to pi.
const double kAngles[] = {0, 1e-20, 1e-8, 1e-4, 0.00999, 0.01001, 0.1, 1, 2, 3, kPi - 0.02, kPi - 1e-3, kPi - 1e-5};

TEST(SO3, ExpMatchesTheSeries) {
  test::Random random;
  for (const double angle : kAngles)
    for (int i = 0; i < 50; ++i) {
      const Vector3f omega = random_direction(random) * static_cast<float>(angle);
      const Eigen::Matrix3d expected = matrix_exp<3>(hat_double(omega.cast<double>()));
      // Elements are at most 1, sums of three terms; angle up to pi is itself rounded to 2 kEps: 12 roundings.
      EXPECT_LT((so3_exp(omega).cast<double>() - expected).cwiseAbs().maxCoeff(), 12 * kEps) << "angle " << angle;
    }
  EXPECT_EQ(so3_exp(Vector3f::Zero()), Matrix3f::Identity());
}

TEST(SO3, ExpIsARotation) {
  test::Random random;
  for (const double angle : kAngles)
    for (int i = 0; i < 50; ++i) {
      const Matrix3f R = so3_exp(random_direction(random) * static_cast<float>(angle));
      EXPECT_LT((R * R.transpose() - Matrix3f::Identity()).cwiseAbs().maxCoeff(), 24 * kEps);
      EXPECT_NEAR(R.determinant(), 1.0, 24 * kEps);
    }
}

TEST(SO3, LogInvertsExp) {
  test::Random random;
  for (const double angle : kAngles)
    for (int i = 0; i < 50; ++i) {
      const Vector3f omega = random_direction(random) * static_cast<float>(angle);
      const Vector3f back = so3_log(so3_exp(omega));
      // The quaternion's components carry about 12 roundings of R's elements, and the angle is up to pi times them;
      // near zero the skew part of R has full relative precision.
      const double tolerance = angle < 0.01 ? 8 * kEps * angle + 1e-30 : 40 * kEps;
      EXPECT_LT((back - omega).norm(), tolerance) << "angle " << angle;
    }
}

TEST(SO3, LogAtExactlyHalfATurn) {
  // (diag of a half turn) = 2 a a^T - I; the axis' sign is free there.
  test::Random random;
  for (int i = 0; i < 100; ++i) {
    const Vector3f axis = i < 3 ? Vector3f(Vector3f::Unit(i)) : random_direction(random);
    const Matrix3f R = 2.0f * axis * axis.transpose() - Matrix3f::Identity();
    const Vector3f omega = so3_log(R);
    EXPECT_NEAR(omega.norm(), kPi, 40 * kEps);
    EXPECT_NEAR(std::fabs(omega.normalized().dot(axis)), 1.0, 40 * kEps);
  }
}

TEST(SO3, OrthonormalisedRepairsDrift) {
  test::Random random;
  for (int i = 0; i < 200; ++i) {
    const Matrix3f R = so3_exp(random_direction(random) * static_cast<float>(random.uniform(0, 3)));
    Matrix3f noisy = R;
    for (int k = 0; k < 9; ++k) noisy(k) += static_cast<float>(random.uniform(-1e-3, 1e-3));
    const Matrix3f repaired = orthonormalised(noisy);
    EXPECT_LT((repaired * repaired.transpose() - Matrix3f::Identity()).cwiseAbs().maxCoeff(), 12 * kEps);
    EXPECT_GT((noisy * noisy.transpose() - Matrix3f::Identity()).cwiseAbs().maxCoeff(), 12 * kEps);  // it was broken
    EXPECT_GT(repaired.determinant(), 0.0f);
    // Gram-Schmidt moves a row by its own error and those of the rows before it: three rows of sqrt(3) 1e-3.
    EXPECT_LT((repaired - R).norm(), 3 * 1.74e-3 * 1.74);
  }
}

TEST(SE3, ExpMatchesTheSeriesAndLogInvertsIt) {
  test::Random random;
  for (const double angle : kAngles)
    for (int i = 0; i < 50; ++i) {
      Vector6f mu;
      mu.head<3>() = random_direction(random) * static_cast<float>(random.uniform(0, 3));
      mu.tail<3>() = random_direction(random) * static_cast<float>(angle);
      const SE3 T = SE3::exp(mu);
      const Eigen::Matrix4d expected = se3_exp_double(mu);
      EXPECT_LT((T.R.cast<double>() - expected.topLeftCorner<3, 3>()).cwiseAbs().maxCoeff(), 12 * kEps);
      // t = V translation, |translation| <= 3, three terms with coefficients up to angle^2 c <= pi: 3 * 3 * 4
      // roundings.
      EXPECT_LT((T.t.cast<double>() - expected.topRightCorner<3, 1>()).norm(), 36 * kEps) << "angle " << angle;
      // V^-1 has norm up to pi/2 at pi, and the rotation comes back within 40 roundings times |t|.
      EXPECT_LT((T.log() - mu).norm(), 300 * kEps) << "angle " << angle;
    }
}

TEST(SE3, GroupIdentities) {
  test::Random random;
  for (int i = 0; i < 200; ++i) {
    Vector6f a;
    Vector6f b;
    for (int k = 0; k < 6; ++k) {
      a(k) = static_cast<float>(random.uniform(-1, 1));
      b(k) = static_cast<float>(random.uniform(-1, 1));
    }
    const SE3 T_a = SE3::exp(a);
    const SE3 T_b = SE3::exp(b);
    const Vector3f p = random_direction(random) * 2.0f;
    // Values up to 6 after two transforms, a few roundings each.
    EXPECT_LT(((T_a * T_b) * p - T_a * (T_b * p)).norm(), 6 * 8 * kEps);
    EXPECT_LT(((T_a * T_a.inverse()) * p - p).norm(), 6 * 8 * kEps);
    EXPECT_LT((T_a * T_a.centre()).norm(), 6 * 8 * kEps);
    EXPECT_GT(((T_a * T_b) * p - T_b * (T_a * p)).norm(), 1e-4);  // order matters, so the first line can fail
  }
}

TEST(SE3, PointJacobianMatchesCentralDifferences) {
  test::Random random;
  for (int i = 0; i < 100; ++i) {
    const Vector3f p = random_direction(random) * static_cast<float>(random.uniform(0.1, 5));
    const Eigen::Matrix<float, 3, 6> J = se3_point_jacobian(p);
    for (int k = 0; k < 6; ++k) {
      // Differences in double: h = 1e-5 leaves h^2/6 |p| = 1e-10 and rounding 1e-16/1e-5 = 1e-11.
      const double h = 1e-5;
      Vector6f step = Vector6f::Zero();
      step(k) = 1.0f;
      Eigen::Vector4d p4;
      p4 << p.cast<double>(), 1.0;
      Eigen::Matrix4d A = Eigen::Matrix4d::Zero();
      A.topLeftCorner<3, 3>() = hat_double(step.tail<3>().cast<double>());
      A.topRightCorner<3, 1>() = step.head<3>().cast<double>();
      const Eigen::Vector4d column =
          (matrix_exp<4>(Eigen::Matrix4d(A * h)) * p4 - matrix_exp<4>(Eigen::Matrix4d(A * -h)) * p4) / (2 * h);
      EXPECT_LT((J.col(k).cast<double>() - column.head<3>()).norm(), 1e-8);
    }
  }
}

TEST(SL3, ExpMatchesTheSeriesAndHasUnitDeterminant) {
  test::Random random;
  for (int i = 0; i < 400; ++i) {
    const double size = i < 100 ? 1e-6 : i < 200 ? 1e-2 : i < 300 ? 0.3 : 1.0;
    Vector8f x;
    for (int k = 0; k < 8; ++k) x(k) = static_cast<float>(random.uniform(-size, size));
    const Eigen::Matrix3d expected = matrix_exp<3>(Eigen::Matrix3d(sl3_algebra(x).cast<double>()));
    const Matrix3f H = sl3_exp(x);
    // Each squaring doubles the relative error; |A| <= 5 needs 4 of them: 16 times about 6 roundings, of the norm. The
    // same goes for the determinant, a sum of products that may cancel from norm^3.
    const double norm = expected.norm();
    EXPECT_LT((H.cast<double>() - expected).norm(), 100 * kEps * norm) << "size " << size;
    EXPECT_NEAR(H.cast<double>().determinant(), 1.0, 8 * kEps * norm * norm * norm + 8 * kEps);
  }
  EXPECT_EQ(sl3_exp(Vector8f::Zero()), Matrix3f::Identity());
}

TEST(SL3, GeneratorsAreIndependentAndTraceless) {
  Eigen::Matrix<float, 9, 8> basis;
  for (int k = 0; k < 8; ++k) {
    const Matrix3f G = sl3_algebra(Vector8f::Unit(k));
    EXPECT_EQ(G.trace(), 0.0f);
    for (int e = 0; e < 9; ++e) basis(e, k) = G(e);
  }
  EXPECT_EQ(basis.fullPivLu().rank(), 8);
}

TEST(SL3, NormalisedForAnyScaleAndSign) {
  test::Random random;
  for (const float scale : {1e-12f, 1e-3f, 1.0f, -1.0f, 1e12f}) {
    Vector8f x;
    for (int k = 0; k < 8; ++k) x(k) = static_cast<float>(random.uniform(-0.3, 0.3));
    const Matrix3f H = sl3_exp(x);
    // The scale and its cube root are exact to 2 roundings each, the determinant to about 8.
    EXPECT_LT((normalised_sl3(scale * H) - H).norm(), 24 * kEps);
  }
}

}  // namespace
}  // namespace pptam
