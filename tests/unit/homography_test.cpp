// Decomposition of random plane motions, its certainty against double precision and against simulation, Jacobians.
#include "geometry/homography.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "tests/support/random.h"

namespace pptam {
namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kDegree = kPi / 180;
constexpr double kEps = 0x1p-24;
// Focal length, in pixels, of a 240x320 image that spans 41x53 degrees: 120 / tan(20.5 deg) = 160 / tan(26.5 deg).
constexpr double kFocal = 320.9;

Vector3f ray(const Vector2f& x) {
  return x.homogeneous();
}

Eigen::Vector3d random_direction(test::Random& random) {
  Eigen::Vector3d v;
  do {
    for (int i = 0; i < 3; ++i) v(i) = random.gaussian();
  } while (v.norm() < 0.1);
  return v.normalized();
}

Vector2f random_point(test::Random& random) {
  return {static_cast<float>(random.uniform(-120, 120) / kFocal),
          static_cast<float>(random.uniform(-160, 160) / kFocal)};
}

// A plane, a motion and points of the plane that both cameras see, in double precision.
struct Scene {
  Eigen::Matrix3d R;
  Eigen::Vector3d t;
  Eigen::Vector3d n;
  std::vector<Vector2f> points;
  double margin = 1e9;  // smallest sine of the angle between a point's ray and the plane, in either view

  Eigen::Matrix3d H() const { return R + t * n.transpose(); }
  PlaneMotion motion() const {
    PlaneMotion motion;
    motion.T_21 = SE3(R.cast<float>(), t.cast<float>());
    motion.n_1 = n.cast<float>();
    return motion;
  }
};

Scene random_scene(test::Random& random, double slant, double baseline, double max_rotation, int count) {
  Scene scene;
  do {
    const double azimuth = random.uniform(0, 2 * kPi);
    scene.n = {std::sin(slant) * std::cos(azimuth), std::sin(slant) * std::sin(azimuth), std::cos(slant)};
    scene.t = random_direction(random) * baseline;
    scene.R = Eigen::AngleAxisd(random.uniform(0, max_rotation), random_direction(random)).toRotationMatrix();
    scene.points.clear();
    scene.margin = 1e9;
    for (int i = 0; i < 20 * count && static_cast<int>(scene.points.size()) < count; ++i) {
      const Vector2f x = random_point(random);
      const Eigen::Vector3d x1 = ray(x).cast<double>();
      const Eigen::Vector3d x2 = scene.H() * x1;
      const double sine_1 = scene.n.dot(x1) / x1.norm();
      const double sine_2 = (scene.R * scene.n).dot(x2) / x2.norm();
      if (sine_1 < 0.02 || sine_2 < 0.02 || x2.z() < 0.1) continue;
      scene.margin = std::min({scene.margin, sine_1, sine_2});
      scene.points.push_back(x);
    }
  } while (static_cast<int>(scene.points.size()) < count);
  return scene;
}

// Of a symmetric matrix, ascending: Jacobi rotations until nothing is left beside the diagonal. Eigen's own take
// the compiler three seconds for each size.
std::vector<double> eigenvalues(Eigen::MatrixXd A) {
  const Eigen::Index n = A.rows();
  for (int sweep = 0; sweep < 30; ++sweep) {
    for (Eigen::Index p = 0; p < n; ++p) {
      for (Eigen::Index q = p + 1; q < n; ++q) {
        const double angle = 0.5 * std::atan2(2 * A(p, q), A(q, q) - A(p, p));
        const double c = std::cos(angle), s = std::sin(angle);
        for (Eigen::Index i = 0; i < n; ++i) {
          const double x = A(i, p), y = A(i, q);
          A(i, p) = c * x - s * y;
          A(i, q) = s * x + c * y;
        }
        for (Eigen::Index i = 0; i < n; ++i) {
          const double x = A(p, i), y = A(q, i);
          A(p, i) = c * x - s * y;
          A(q, i) = s * x + c * y;
        }
      }
    }
  }
  std::vector<double> values(A.diagonal().begin(), A.diagonal().end());
  std::sort(values.begin(), values.end());
  return values;
}

// Descending.
std::vector<double> singular_values(const Eigen::Matrix3d& H) {
  std::vector<double> values = eigenvalues(H.transpose() * H);
  for (double& value : values) value = std::sqrt(value);
  return {values.rbegin(), values.rend()};
}

// Of eight unknowns; the compiler takes a minute to unroll matrices of fixed size.
using Unknowns = Eigen::VectorXd;
using Information = Eigen::MatrixXd;

TEST(TheTestsOwnEigenvalues, AreThoseThatAMatrixWasMadeOf) {
  test::Random random;
  for (int trial = 0; trial < 50; ++trial) {
    // Reflected by random planes: Q diag Q^T.
    std::vector<double> made;
    Information A = Information::Zero(8, 8);
    for (int i = 0; i < 8; ++i) {
      made.push_back(std::exp(random.uniform(-10, 3)));
      A(i, i) = made.back();
    }
    for (int k = 0; k < 8; ++k) {
      Unknowns v(8);
      for (double& x : v) x = random.gaussian();
      const Unknowns Av = A.lazyProduct(v) * (2 / v.squaredNorm());
      const double vAv = v.dot(Av) * (2 / v.squaredNorm());
      for (int i = 0; i < 8; ++i)
        for (int j = 0; j < 8; ++j) A(i, j) += vAv * v[i] * v[j] - Av[i] * v[j] - v[i] * Av[j];
    }
    std::sort(made.begin(), made.end());
    const std::vector<double> found = eigenvalues(A);
    // A hundred roundings of the largest.
    for (size_t i = 0; i < 8; ++i) EXPECT_NEAR(found[i], made[i], 100 * 2.2e-16 * made[7]) << i;
  }
}

struct Tolerance {
  double normal;
  double translation;
  double rotation;
};

// Gaps between squared singular values below the code's kRounding are taken as zero.
constexpr double kRounding = 2e-6;

// How far an error delta of the squared singular values (d2 = 1) moves the solution. With g = d1^2 - d3^2 and the
// smaller of the two gaps d1^2 - 1 and 1 - d3^2 called s: x1 or x3 = sqrt(s / g) moves by delta / (2 sqrt(s g)), the
// singular vectors turn by delta / s within their pair, which the normal sees times sqrt(s / g); where s itself is lost
// in delta or kRounding, by the square root of that over g. The other pair adds delta / g. R and t follow from the
// normal through t n^T, |t| at most about g.
Tolerance tolerance_of(const Eigen::Matrix3d& H, double delta) {
  std::vector<double> d = singular_values(H);
  const double middle = d[1];
  for (double& value : d) value /= middle;
  const double g = d[0] * d[0] - d[2] * d[2];
  const double s = std::min(d[0] * d[0] - 1, 1 - d[2] * d[2]);
  const double lost = delta + kRounding;
  const double turn = delta / g + (s < 2 * lost ? std::sqrt(2 * lost / g) : 1.5 * delta / std::sqrt(s * g));
  return {turn, delta + g * turn, delta + g * turn};
}

// Distance of a solution from the truth in units of the tolerance.
double distance(const Scene& scene, const PlaneMotion& solution, const Tolerance& tolerance) {
  return std::max({(solution.n_1.cast<double>() - scene.n).norm() / tolerance.normal,
                   (solution.T_21.t.cast<double>() - scene.t).norm() / tolerance.translation,
                   (solution.T_21.R.cast<double>() - scene.R).norm() / std::sqrt(2.0) / tolerance.rotation});
}

double nearest(const Scene& scene, const Decomposition& decomposition, const Tolerance& tolerance) {
  double best = 1e9;
  for (int i = 0; i < decomposition.count; ++i)
    best = std::min(best, distance(scene, decomposition.solutions[i], tolerance));
  return best;
}

// Rounding of the nine elements of H to float32, of H^T H and of the Jacobi rotations: about 16 roundings of the
// squared singular values.
constexpr double kExactDelta = 16 * kEps;

TEST(Homography, TheTrueMotionIsAlwaysAmongTheSolutions) {
  test::Random random;
  int two = 0;
  double worst = 0;
  const int trials = 5000;
  for (int i = 0; i < trials; ++i) {
    const Scene scene = random_scene(random, random.uniform(0, 70) * kDegree,
                                     0.03 * std::pow(17.0, random.uniform(0, 1)), 30 * kDegree, 10);
    const double scale = std::exp(random.uniform(-5, 5)) * (random.integer(0, 1) ? 1 : -1);
    const Decomposition d = decompose_homography((scene.H() * scale).cast<float>(), scene.points, 1e-4f);
    ASSERT_GE(d.count, 1) << i;
    ASSERT_FALSE(d.pure_rotation) << i;
    const Tolerance tolerance = tolerance_of(scene.H(), kExactDelta);
    // Only a plane seen nearly edge-on may be dropped for a rounding: the margin is 0.02.
    const double found = nearest(scene, d, tolerance);
    worst = std::max(worst, found);
    EXPECT_LT(found, 1.0) << i << " normal tolerance " << tolerance.normal;
    two += d.count == 2;
    // Every solution, the false one too, explains H and is a rotation, a unit normal, a plane in front.
    const Eigen::Matrix3d H = scene.H() / singular_values(scene.H())[1];
    for (int k = 0; k < d.count; ++k) {
      const PlaneMotion& solution = d.solutions[k];
      const Eigen::Matrix3d again = (solution.T_21.R + solution.T_21.t * solution.n_1.transpose()).cast<double>();
      EXPECT_LT((again - H).norm(), 48 * kEps + kRounding);  // rounding of three matrix products
      EXPECT_LT((solution.T_21.R * solution.T_21.R.transpose() - Matrix3f::Identity()).norm(), 16 * kEps);
      EXPECT_GT(solution.T_21.R.determinant(), 0.0f);
      EXPECT_NEAR(solution.n_1.norm(), 1.0, 4 * kEps);
      for (const Vector2f& x : scene.points) EXPECT_GT(solution.n_1.dot(ray(x)), 0.0f);
    }
    if (d.count == 2) {
      EXPECT_GE(d.solutions[0].n_1.z(), d.solutions[1].n_1.z());
    }
    EXPECT_GE(d.singular_values[0], 1.0f);
    EXPECT_EQ(d.singular_values[1], 1.0f);
    EXPECT_LE(d.singular_values[2], 1.0f);
  }
  RecordProperty("worst_of_tolerance", std::to_string(worst));
  RecordProperty("two_solutions_percent", std::to_string(100 * two / trials));
  EXPECT_GT(two, trials / 10);  // the ambiguity is real
}

TEST(Homography, AWrongMotionIsNotAmongTheSolutions) {
  // Negative control: the same comparison refuses a truth that is off by a tenth of the normal's tilt or a degree.
  test::Random random;
  for (int i = 0; i < 200; ++i) {
    Scene scene = random_scene(random, random.uniform(20, 60) * kDegree, random.uniform(0.1, 0.3), 30 * kDegree, 10);
    const Decomposition d = decompose_homography(scene.H().cast<float>(), scene.points, 1e-4f);
    const Tolerance tolerance = tolerance_of(scene.H(), kExactDelta);
    const Eigen::Vector3d n = scene.n;
    scene.n = (n + 0.1 * random_direction(random).cross(n).normalized()).normalized();
    if (d.count == 1) {
      EXPECT_GT(nearest(scene, d, tolerance), 1.0);
    }
    scene.n = n;
    scene.R = Eigen::AngleAxisd(1 * kDegree, Eigen::Vector3d::UnitZ()).toRotationMatrix() * scene.R;
    if (d.count == 1) {
      EXPECT_GT(nearest(scene, d, tolerance), 1.0);
    }
  }
}

TEST(Homography, TheTrueMotionSurvivesNoiseInH) {
  test::Random random;
  int tested = 0;
  double worst = 0;
  for (int i = 0; i < 5000; ++i) {
    const double baseline = 0.03 * std::pow(17.0, random.uniform(0, 1));
    const Scene scene = random_scene(random, random.uniform(0, 70) * kDegree, baseline, 30 * kDegree, 10);
    // One per cent of t/d in every element; the norm of the error E is at most 3 times that, and the squared singular
    // values (d1 up to 1.5) move by at most 2 d1 |E|, relative to the middle one twice that.
    const double noise = 0.01 * baseline;
    Eigen::Matrix3d H = scene.H();
    for (int k = 0; k < 9; ++k) H(k) += random.uniform(-noise, noise);
    const Tolerance tolerance = tolerance_of(scene.H(), 2 * 2 * 1.5 * 3 * noise / std::sqrt(3.0));
    if (scene.margin < tolerance.normal) continue;  // noise may put the plane's horizon between the points
    ++tested;
    const Decomposition d = decompose_homography(H.cast<float>(), scene.points, 1e-4f);
    ASSERT_GE(d.count, 1);
    const double found = nearest(scene, d, tolerance);
    worst = std::max(worst, found);
    EXPECT_LT(found, 1.0) << i;
  }
  RecordProperty("worst_of_tolerance", std::to_string(worst));
  EXPECT_GT(tested, 2000);
}

TEST(Homography, PureRotationIsRecognised) {
  test::Random random;
  for (int i = 0; i < 500; ++i) {
    const Scene scene = random_scene(random, 0, 0.0, 30 * kDegree, 10);
    const Decomposition d = decompose_homography((scene.R * -3.7).cast<float>(), scene.points, i % 2 ? 0.005f : 0.0f);
    EXPECT_TRUE(d.pure_rotation);
    ASSERT_EQ(d.count, 1);
    EXPECT_LT((d.solutions[0].T_21.R.cast<double>() - scene.R).norm(), 32 * kEps);
    EXPECT_EQ(d.solutions[0].T_21.t, Vector3f::Zero());
  }
}

TEST(Homography, RotationToleranceSeparatesRotationFromTranslation) {
  // d1 / d3 - 1 is |t| (1 + O(|t|)) for a translation perpendicular to the normal, or along it.
  test::Random random;
  for (int i = 0; i < 200; ++i) {
    Scene scene = random_scene(random, 0.3, 0.02, 20 * kDegree, 10);
    scene.t = scene.R * (i % 2 ? Eigen::Vector3d(scene.n.unitOrthogonal() * 0.02) : Eigen::Vector3d(scene.n * 0.02));
    const Matrix3f H = scene.H().cast<float>();
    EXPECT_TRUE(decompose_homography(H, scene.points, 0.021f).pure_rotation);
    EXPECT_FALSE(decompose_homography(H, scene.points, 0.019f).pure_rotation);
  }
}

// Turning seen by a camera whose focal length is k times the one assumed. k is the square root of the ratio of two
// elements' lengths, at least sin(3 degrees) / 2 here, of which the rounding of H leaves a few parts in 10^6.
TEST(Homography, RotationIsRecognisedWithAnotherFocalLength) {
  test::Random random;
  int told_as_motion = 0;
  constexpr int kTrials = 500;
  for (int i = 0; i < kTrials; ++i) {
    const double k = std::exp(random.uniform(std::log(0.5), std::log(2.0)));
    Eigen::Vector3d axis = random_direction(random);
    axis.z() *= 0.3;
    axis.normalize();
    const Eigen::Matrix3d R = Eigen::AngleAxisd(random.uniform(3, 25) * kDegree, axis).matrix();
    const Eigen::Vector3d D(k, k, 1);
    const Matrix3f H = (0.4 * (D.asDiagonal() * R * D.cwiseInverse().asDiagonal())).cast<float>();
    ASSERT_NEAR(focal_of_rotation(H, 2.1f, 1e-3f), k, 1e-5 * k) << i;
    EXPECT_EQ(focal_of_rotation(H, static_cast<float>(0.99 * std::max(k, 1 / k)), 1e-3f), 0) << "out of the range";
    told_as_motion += !decompose_homography(H, {}, 0.02f).pure_rotation;
  }
  EXPECT_GT(told_as_motion, kTrials / 2) << "control: with the focal length assumed most are motion past a plane";
}

// A plane's homography has another form, but where the camera moves along the plane while it turns the same way.
TEST(Homography, SidewaysMotionIsNoRotationOfAnyFocalLength) {
  test::Random random;
  int alike = 0;
  constexpr int kTrials = 500;
  for (int i = 0; i < kTrials; ++i) {
    Scene scene = random_scene(random, 20 * kDegree, 0.1, 0, 10);
    const Eigen::Vector3d along = random_direction(random);
    scene.t = 0.1 * (along - along.dot(scene.n) * scene.n).normalized();
    EXPECT_EQ(focal_of_rotation(scene.H().cast<float>(), 2.2f, 0.02f), 0) << i;
    const Eigen::Vector3d axis = Eigen::Vector3d::UnitZ().cross(scene.t).normalized();  // its flow is that of t
    scene.R = Eigen::AngleAxisd(0.1, axis).matrix();
    scene.n = Eigen::Vector3d::UnitZ();
    scene.t.z() = 0;
    alike += focal_of_rotation(scene.H().cast<float>(), 2.2f, 0.02f) > 0;
  }
  EXPECT_GT(alike, kTrials / 2) << "control: what can not be told from a rotation";
}

TEST(Homography, NoFocalLengthComesOfNonsense) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  EXPECT_EQ(focal_of_rotation(Matrix3f::Zero(), 2.2f, 0.02f), 0);
  EXPECT_EQ(focal_of_rotation(Matrix3f::Identity(), 2.2f, 0.02f), 0) << "it has none";
  EXPECT_EQ(focal_of_rotation(Matrix3f::Constant(nan), 2.2f, 0.02f), 0);
  EXPECT_EQ(focal_of_rotation(Matrix3f::Constant(1e30f), 2.2f, 0.02f), 0);
}

TEST(Homography, SmallBaselineIsAccurateInFloat32) {
  test::Random random;
  double worst = 0;
  for (int i = 0; i < 1000; ++i) {
    Scene scene = random_scene(random, random.uniform(10, 50) * kDegree, 0.02, 20 * kDegree, 10);
    scene.t = scene.R * scene.n.unitOrthogonal() * 0.02;  // gaps d1^2 - 1 and 1 - d3^2 of about 0.02 each
    const Decomposition d = decompose_homography(scene.H().cast<float>(), scene.points, 1e-4f);
    double best = 1e9;
    for (int k = 0; k < d.count; ++k) best = std::min(best, (d.solutions[k].n_1.cast<double>() - scene.n).norm());
    worst = std::max(worst, best);
  }
  RecordProperty("worst_normal_rad", std::to_string(worst));
  // 16 roundings over sqrt(0.02 * 0.04), twice: 7e-5 rad, far below the 5 degrees of one pixel of noise.
  EXPECT_LT(worst, 2 * 16 * kEps / std::sqrt(0.02 * 0.04));
}

TEST(Homography, EqualSingularValuesGiveOneSolution) {
  // Translation along the normal: H = R (I + a n n^T) has two equal singular values, whichever the sign of a.
  test::Random random;
  for (int i = 0; i < 500; ++i) {
    Scene scene = random_scene(random, random.uniform(0, 50) * kDegree, 0.0, 20 * kDegree, 10);
    const double a = random.uniform(0.05, 0.4) * (i % 2 ? 1 : -1);
    scene.t = scene.R * scene.n * a;
    const Decomposition d = decompose_homography(scene.H().cast<float>(), scene.points, 1e-3f);
    ASSERT_GE(d.count, 1);
    // sqrt(delta / g) with g about 2 |a|: the normal is known to 6e-3 at worst even here.
    EXPECT_LT(nearest(scene, d, tolerance_of(scene.H(), kExactDelta)), 1.0);
    if (d.count == 2) {
      const double apart = (d.solutions[0].n_1 - d.solutions[1].n_1).norm();
      EXPECT_LT(apart, 2 * std::sqrt(2 * (kExactDelta + kRounding) / (2 * std::fabs(a))));
    }
  }
  const Decomposition d = decompose_homography(Vector3f(1.0f, 1.0f, 1.25f).asDiagonal().toDenseMatrix(), {}, 1e-3f);
  ASSERT_EQ(d.count, 1);
  EXPECT_LT((d.solutions[0].n_1 - Vector3f::UnitZ()).norm(), 4 * kEps);
  EXPECT_LT((d.solutions[0].T_21.t - Vector3f(0, 0, 0.25f)).norm(), 4 * kEps);
}

void expect_finite(const Decomposition& d) {
  for (int k = 0; k < 2; ++k) {
    EXPECT_TRUE(d.solutions[k].T_21.R.allFinite());
    EXPECT_TRUE(d.solutions[k].T_21.t.allFinite());
    EXPECT_TRUE(d.solutions[k].n_1.allFinite());
    EXPECT_TRUE(std::isfinite(d.singular_values[k]));
  }
}

TEST(Homography, DegenerateInputGivesNoSolution) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const float infinity = std::numeric_limits<float>::infinity();
  const std::array<Vector2f, 3> points = {Vector2f(0, 0), Vector2f(0.2f, 0.1f), Vector2f(-0.1f, 0.3f)};
  const auto count = [&](const Matrix3f& H) {
    const Decomposition d = decompose_homography(H, points, 1e-3f);
    expect_finite(d);
    return d.count;
  };
  const Matrix3f good = Matrix3f::Identity() + Vector3f(0.1f, 0, 0) * Vector3f(0, 0, 1).transpose();
  EXPECT_GT(count(good), 0);
  EXPECT_GT(count(good * 1e-20f), 0);
  EXPECT_GT(count(good * 1e20f), 0);
  EXPECT_EQ(count(Matrix3f::Zero()), 0);
  for (int k = 0; k < 9; ++k) {
    for (const float bad : {nan, infinity, -infinity}) {
      Matrix3f H = good;
      H(k) = bad;
      EXPECT_EQ(count(H), 0);
    }
  }
  EXPECT_EQ(count(Vector3f(1, 1, 0).asDiagonal().toDenseMatrix()), 0);   // rank 2
  EXPECT_EQ(count(Vector3f(0, 0, 1).asDiagonal().toDenseMatrix()), 0);   // rank 1
  EXPECT_EQ(count(Matrix3f::Constant(1.0f)), 0);                         // rank 1
  EXPECT_EQ(count(Vector3f(-1, 1, 1).asDiagonal().toDenseMatrix()), 0);  // a mirror image: seen from behind
  Matrix3f horizon = Matrix3f::Identity();  // the points fall on both sides of the second camera
  horizon(2, 0) = -20.0f;
  horizon(2, 2) = 0.5f;
  EXPECT_EQ(count(horizon), 0);
  const std::array<Vector2f, 1> bad_point = {Vector2f(nan, 0)};
  EXPECT_EQ(decompose_homography(good, bad_point, 1e-3f).count, 0);
}

TEST(Homography, RandomMatricesNeverGiveNan) {
  test::Random random;
  for (int i = 0; i < 20000; ++i) {
    Matrix3f H;
    for (int k = 0; k < 9; ++k) {
      const int kind = random.integer(0, 5);
      H(k) = kind == 0   ? 0.0f
             : kind == 1 ? static_cast<float>(random.integer(-1, 1))
                         : static_cast<float>(random.gaussian() * std::pow(10.0, random.uniform(-i % 40, 0)));
    }
    std::vector<Vector2f> points;
    for (int k = random.integer(0, 3); k > 0; --k) points.push_back(random_point(random));
    const Decomposition d = decompose_homography(H, points, 1e-3f);
    expect_finite(d);
    for (int k = 0; k < d.count; ++k) {
      const DecompositionQuality quality = decomposition_quality(d.solutions[k], points, 0.003f);
      EXPECT_TRUE(std::isfinite(quality.eigenvalue_ratio) && std::isfinite(quality.sigma_n_rad));
    }
  }
}

TEST(Homography, PointJacobianMatchesCentralDifferences) {
  test::Random random;
  for (int i = 0; i < 500; ++i) {
    const Scene scene = random_scene(random, 0.7, 0.3, 0.5, 1);
    const Matrix3f H = scene.H().cast<float>();
    const Eigen::Matrix3d Hd = H.cast<double>();
    const Vector2f x = scene.points[0];
    const Matrix2f J = homography_point_jacobian(H, x);
    for (int k = 0; k < 2; ++k) {
      // h^2/6 times the third derivative (6 |H20|^2 / w^4, w > 0.1): below 1e-12 * 1e5; the float32 Jacobian has eight
      // roundings of terms up to 1/w^2.
      const double h = 1e-6;
      const Eigen::Vector2d step = Eigen::Vector2d::Unit(k) * h;
      const Eigen::Vector2d column = ((Hd * (x.cast<double>() + step).homogeneous()).hnormalized() -
                                      (Hd * (x.cast<double>() - step).homogeneous()).hnormalized()) /
                                     (2 * h);
      const double w = static_cast<double>(homography_depth(H, x));
      EXPECT_LT((J.col(k).cast<double>() - column).norm(), 24 * kEps / (w * w) + 1e-7);
    }
    const Vector2f y = apply_homography(H, x);
    EXPECT_LT((y.cast<double>() - (Hd * x.cast<double>().homogeneous()).hnormalized()).norm(), 1e-5);
  }
}

TEST(Homography, SL3JacobianMatchesCentralDifferences) {
  test::Random random;
  for (int i = 0; i < 200; ++i) {
    const Vector2f y(static_cast<float>(random.uniform(-1, 1)), static_cast<float>(random.uniform(-1, 1)));
    const Eigen::Matrix<float, 2, 8> J = homography_sl3_jacobian(y);
    for (int k = 0; k < 8; ++k) {
      // exp(h G) = I + h G + h^2 G^2 / 2 + O(h^3) in double: the difference's error is O(h^2) = 1e-10 times about 10.
      const double h = 1e-5;
      const Eigen::Matrix3d G = sl3_algebra(Vector8f::Unit(k)).cast<double>();
      const Eigen::Matrix3d plus = Eigen::Matrix3d::Identity() + h * G + 0.5 * h * h * G * G;
      const Eigen::Matrix3d minus = Eigen::Matrix3d::Identity() - h * G + 0.5 * h * h * G * G;
      const Eigen::Vector3d y3 = y.cast<double>().homogeneous();
      const Eigen::Vector2d column = ((plus * y3).hnormalized() - (minus * y3).hnormalized()) / (2 * h);
      EXPECT_LT((J.col(k).cast<double>() - column).norm(), 4 * 3 * kEps + 1e-8) << "generator " << k;
    }
  }
}

// The 8x8 information in double precision, its Jacobian by central differences of the projections.
Information information_double(const Scene& scene) {
  const Eigen::Vector3d tangent_1 = scene.n.unitOrthogonal();
  const Eigen::Vector3d tangent_2 = scene.n.cross(tangent_1);
  Information information = Information::Zero(8, 8);
  for (const Vector2f& x : scene.points) {
    const auto project = [&](int k, double h) {
      Scene moved = scene;
      if (k < 3) moved.R = Eigen::AngleAxisd(h, Eigen::Vector3d::Unit(k)).toRotationMatrix() * scene.R;
      if (k >= 3 && k < 6) moved.t(k - 3) += h;
      if (k == 6) moved.n = Eigen::AngleAxisd(h, scene.n.cross(tangent_1)).toRotationMatrix() * scene.n;
      if (k == 7) moved.n = Eigen::AngleAxisd(h, scene.n.cross(tangent_2)).toRotationMatrix() * scene.n;
      return Eigen::Vector2d((moved.H() * x.cast<double>().homogeneous()).hnormalized());
    };
    Eigen::Matrix2Xd J(2, 8);
    for (int k = 0; k < 8; ++k) J.col(k) = (project(k, 1e-6) - project(k, -1e-6)) / 2e-6;
    information += J.transpose().lazyProduct(J);
  }
  return information;
}

TEST(DecompositionQuality, MatchesDoublePrecision) {
  test::Random random;
  double worst = 0;
  for (int i = 0; i < 300; ++i) {
    const double baseline = 0.03 * std::pow(17.0, random.uniform(0, 1));
    const Scene scene = random_scene(random, random.uniform(0, 60) * kDegree, baseline, 20 * kDegree, 30);
    const double sigma = 1 / kFocal;
    const Information A = information_double(scene);
    const std::vector<double> eigen = eigenvalues(A);
    // The inverse's lower right corner.
    const Information last_two = A.ldlt().solve(Information::Identity(8, 8).rightCols(2));
    const Information covariance = last_two.bottomRows(2);
    const double expected = std::min(static_cast<double>(DecompositionQuality().sigma_n_rad),
                                     sigma * std::sqrt(eigenvalues(covariance)[1]));
    const Unknowns unit = A.diagonal().cwiseSqrt().cwiseInverse();
    const Information scaled = unit.asDiagonal() * A * unit.asDiagonal();
    const std::vector<double> scaled_eigen = eigenvalues(scaled);
    const double condition = scaled_eigen[7] / scaled_eigen[0];
    // Relative error of a float32 eigenvalue: its roundings (some 8 effective) times the condition number of the
    // matrix scaled to a unit diagonal. Beyond 1e5 (motion towards the plane) float32 only says "badly".
    if (condition > 1e5) continue;
    const double tolerance = 8 * kEps * condition + 1e-4;
    const DecompositionQuality quality = decomposition_quality(scene.motion(), scene.points, static_cast<float>(sigma));
    EXPECT_NEAR(quality.sigma_n_rad / expected, 1.0, tolerance) << condition;
    EXPECT_NEAR(quality.eigenvalue_ratio / (eigen[0] / eigen[7]), 1.0, tolerance);
    worst = std::max(worst, std::fabs(static_cast<double>(quality.sigma_n_rad) / expected - 1));
  }
  RecordProperty("worst_relative", std::to_string(worst));
}

double mean_sigma_degrees(test::Random& random, double slant, const Vector3f& t) {
  double sum = 0;
  const int layouts = 50;
  for (int i = 0; i < layouts; ++i) {
    std::vector<Vector2f> points;
    for (int k = 0; k < 50; ++k) points.push_back(random_point(random));
    PlaneMotion motion;
    motion.n_1 = Vector3f(static_cast<float>(std::sin(slant)), 0.0f, static_cast<float>(std::cos(slant)));
    motion.T_21.t = t;
    sum += static_cast<double>(decomposition_quality(motion, points, static_cast<float>(1 / kFocal)).sigma_n_rad);
  }
  return sum / layouts / kDegree;
}

TEST(DecompositionQuality, FiguresOfTheDesign) {
  // 50 points, 1 px of noise, 41x53 degrees, sideways motion; 20 % for the random layouts' mean and the field of view
  // being "about" that.
  test::Random random;
  const double expected[][2] = {{0.03, 5.1}, {0.05, 3.1}, {0.10, 1.6}};
  for (const auto& [baseline, degrees] : expected) {
    for (int axis = 0; axis < 2; ++axis) {
      const Vector3f t = Vector3f::Unit(axis) * static_cast<float>(baseline);
      EXPECT_NEAR(mean_sigma_degrees(random, 0, t), degrees, 0.2 * degrees);
    }
    // Slanted by 45 degrees about the y axis, moving along x: about double.
    const double slanted = mean_sigma_degrees(random, 45 * kDegree, Vector3f(static_cast<float>(baseline), 0, 0));
    EXPECT_NEAR(slanted, 2 * degrees, 0.2 * 2 * degrees);
  }
}

TEST(DecompositionQuality, TooLittleInformationIsTotalUncertainty) {
  const DecompositionQuality nothing;
  PlaneMotion motion;
  motion.T_21.t = Vector3f(0.1f, 0, 0);
  const std::vector<Vector2f> three = {{0.1f, 0.1f}, {-0.1f, 0.2f}, {0.2f, -0.2f}};
  for (const DecompositionQuality& quality :
       {decomposition_quality(motion, {}, 0.003f), decomposition_quality(motion, three, 0.003f)}) {
    EXPECT_NEAR(quality.eigenvalue_ratio, 0.0, 1e-7);  // rounding may leave a tiny positive eigenvalue
    EXPECT_GT(quality.sigma_n_rad, 0.5f);
  }
  motion.T_21.t.setZero();
  std::vector<Vector2f> many;
  test::Random random;
  for (int i = 0; i < 50; ++i) many.push_back(random_point(random));
  EXPECT_EQ(decomposition_quality(motion, many, 0.003f).sigma_n_rad, nothing.sigma_n_rad);  // pure rotation
  motion.T_21.t.x() = std::numeric_limits<float>::quiet_NaN();
  EXPECT_EQ(decomposition_quality(motion, many, 0.003f).sigma_n_rad, nothing.sigma_n_rad);
}

// The whole chain: H fitted to noisy points with homography_sl3_jacobian, decomposed; the scatter of the normal is what
// decomposition_quality promised.
TEST(DecompositionQuality, PromisesTheScatterOfFittedNormals) {
  test::Random random;
  const double sigma = 0.5 / kFocal;
  for (const double slant : {20.0, 45.0}) {
    const Scene scene = [&] {
      Scene s = random_scene(random, slant * kDegree, 0.1, 10 * kDegree, 50);
      // Within the plane, across the slant: d1 and d3 equally far from 1, the other solution's normal along t, unseen.
      s.t = s.R * Eigen::Vector3d::UnitZ().cross(s.n).normalized() * 0.15;
      return s;
    }();
    const int trials = 600;
    Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
    for (int trial = 0; trial < trials; ++trial) {
      std::vector<Vector2f> measured;
      for (const Vector2f& x : scene.points) {
        const Eigen::Vector2d y = (scene.H() * x.cast<double>().homogeneous()).hnormalized();
        measured.push_back((y + sigma * Eigen::Vector2d(random.gaussian(), random.gaussian())).cast<float>());
      }
      Matrix3f H = scene.H().cast<float>();
      for (int step = 0; step < 4; ++step) {
        Information A = Information::Zero(8, 8);
        Unknowns b = Unknowns::Zero(8);
        for (size_t k = 0; k < measured.size(); ++k) {
          const Vector2f y = apply_homography(H, scene.points[k]);
          const Eigen::Matrix2Xd J = homography_sl3_jacobian(y).cast<double>();
          A += J.transpose().lazyProduct(J);
          b += J.transpose().lazyProduct((measured[k] - y).cast<double>());
        }
        const Vector8f update = A.ldlt().solve(b).cast<float>();
        H = sl3_exp(update) * H;
      }
      const Decomposition d = decompose_homography(H, scene.points, 1e-3f);
      double best = 1e9;
      Eigen::Vector3d error = Eigen::Vector3d::Zero();
      for (int k = 0; k < d.count; ++k) {
        const Eigen::Vector3d e = d.solutions[k].n_1.cast<double>() - scene.n;
        if (e.norm() < best) {
          best = e.norm();
          error = e;
        }
      }
      ASSERT_LT(best, 1.0);
      scatter += error * error.transpose() / trials;
    }
    const double measured_sigma = std::sqrt(eigenvalues(scatter)[2]);
    const double promised =
        static_cast<double>(decomposition_quality(scene.motion(), scene.points, static_cast<float>(sigma)).sigma_n_rad);
    // The standard deviation of a scatter of 600 is 1/sqrt(1200) = 2.9 %; four of them, and curvature of a few per
    // cent.
    EXPECT_NEAR(measured_sigma / promised, 1.0, 0.15) << "slant " << slant << " promised " << promised / kDegree;
  }
}

}  // namespace
}  // namespace pptam
