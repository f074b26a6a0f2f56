// Every interaction matrix against central differences of what it is the derivative of, in double, and the geometry of
// limbs and outlines.
#include "edges/contour.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <functional>
#include <vector>

#include "tests/support/random.h"

namespace pptam {
namespace {

using Vector3d = Eigen::Vector3d;
using Vector6d = Eigen::Matrix<double, 6, 1>;

constexpr int kTrials = 200;

Vector3f random_vector(test::Random& random, double size) {
  return Vector3f(static_cast<float>(random.uniform(-size, size)), static_cast<float>(random.uniform(-size, size)),
                  static_cast<float>(random.uniform(-size, size)));
}
Vector3f random_unit(test::Random& random) {
  for (;;) {
    const Vector3f v = random_vector(random, 1);
    if (v.norm() > 0.2f && v.norm() < 1) return v.normalized();
  }
}
Vector3f before_camera(test::Random& random) {
  return random_vector(random, 0.4) + Vector3f(0, 0, static_cast<float>(random.uniform(1, 3)));
}

// Where a point of the object is after the camera's screw (v, w) has acted for a short time: X - v - w x X.
Vector3d moved(const Vector3f& p, const Vector6d& screw) {
  const Vector3d X = p.cast<double>();
  return X - screw.head<3>() - screw.tail<3>().cross(X);
}

// Central differences of f, which takes the camera's screw, by each of its components.
Vector6d differences(const std::function<double(const Vector6d&)>& f) {
  constexpr double kStep = 1e-5;
  Vector6d result;
  for (int i = 0; i < 6; ++i) {
    Vector6d step = Vector6d::Zero();
    step(i) = kStep;
    result(i) = (f(step) - f(-step)) / (2 * kStep);
  }
  return result;
}

// The rows are float32 sums of a few terms that partly cancel: 1e-5 of the largest entry would be usual.
void expect_row(const float (&row)[6], const Vector6d& truth, int trial) {
  const double scale = std::max(1.0, truth.cwiseAbs().maxCoeff());
  for (int i = 0; i < 6; ++i)
    EXPECT_NEAR(static_cast<double>(row[i]), truth(i), 3e-4 * scale) << trial << " entry " << i;
}

// Distance of (x, y) from the line through two points, its sign that of the normal's direction at rest.
double line_distance(const Vector3d& a, const Vector3d& b, double x, double y, const LineContour& at_rest) {
  Vector3d n = a.cross(b);
  n /= std::hypot(n.x(), n.y());
  if (n.x() * static_cast<double>(at_rest.c) + n.y() * static_cast<double>(at_rest.s) < 0) n = -n;
  return -n.z() - (x * n.x() + y * n.y());
}

TEST(Contour, LineDistanceAndItsInteraction) {  // [vvs eq. 16-21]
  test::Random random;
  for (int trial = 0; trial < kTrials; ++trial) {
    const Vector3f a = before_camera(random), b = before_camera(random);
    LineContour line;
    if ((a - b).norm() < 0.2f || !line.set(a, b)) continue;
    const float x = static_cast<float>(random.uniform(-0.5, 0.5)), y = static_cast<float>(random.uniform(-0.5, 0.5));
    const auto d = [&](const Vector6d& screw) {
      return line_distance(moved(a, screw), moved(b, screw), static_cast<double>(x), static_cast<double>(y), line);
    };
    EXPECT_NEAR(static_cast<double>(line.distance(x, y)), d(Vector6d::Zero()), 1e-5) << trial;
    const Vector6d truth = differences(d);
    float row[6];
    line.interaction(x, y, row);
    expect_row(row, truth, trial);
    row[2] = -row[2];  // as (21) is printed
    if (std::abs(truth(2)) > 0.05) {
      EXPECT_GT(std::abs(static_cast<double>(row[2]) - truth(2)), 0.05) << trial;
    }
  }
}

TEST(Contour, ALineThroughTheCameraHasNoImage) {
  LineContour line;
  EXPECT_FALSE(line.set(Vector3f(0.1f, 0.2f, 1), Vector3f(0.2f, 0.4f, 2)));   // end-on
  EXPECT_FALSE(line.set(Vector3f(-1, 0, 1e-5f), Vector3f(1, 0.5f, -1e-5f)));  // in the camera's own plane
  EXPECT_TRUE(line.set(Vector3f(0.1f, 0.2f, 1), Vector3f(0.2f, 0.4f, 1.9f)));
}

// Centre and squared axes of the image of a circle, from the general conic through five of its points, in double.
struct Ellipse {
  double xg, yg, mu20, mu11, mu02;
};
Ellipse ellipse_through(const std::vector<Vector3d>& points) {
  Eigen::Matrix<double, 5, 5> A;
  Eigen::Matrix<double, 5, 1> one = Eigen::Matrix<double, 5, 1>::Ones();
  for (int i = 0; i < 5; ++i) {
    const Vector3d& p = points[static_cast<size_t>(i)];
    const double x = p.x() / p.z(), y = p.y() / p.z();
    A.row(i) << x * x, 2 * x * y, y * y, 2 * x, 2 * y;
  }
  // a x^2 + 2 b x y + c y^2 + 2 d x + 2 e y = 1
  const Eigen::Matrix<double, 5, 1> q = A.fullPivLu().solve(one);
  Eigen::Matrix2d Q;
  Q << q(0), q(1), q(1), q(2);
  const Eigen::Vector2d l(q(3), q(4));
  const Eigen::Vector2d g = -Q.inverse() * l;
  const Eigen::Matrix2d mu = (1 - l.dot(g)) * Q.inverse();  // (x - g)^T mu^-1 (x - g) = 1
  return {g.x(), g.y(), mu(0, 0), mu(0, 1), mu(1, 1)};
}

std::vector<Vector3f> on_circle(const Vector3f& centre, const Vector3f& n, float r) {
  const Vector3f u = n.cross(std::abs(n.x()) < 0.6f ? Vector3f(1, 0, 0) : Vector3f(0, 1, 0)).normalized();
  const Vector3f v = n.cross(u);
  std::vector<Vector3f> points;
  for (int i = 0; i < 5; ++i) {
    const float angle = 1.2566371f * static_cast<float>(i);
    points.push_back(centre + r * (u * std::cos(angle) + v * std::sin(angle)));
  }
  return points;
}

Ellipse moved_ellipse(const std::vector<Vector3f>& points, const Vector6d& screw) {
  std::vector<Vector3d> there;
  for (const Vector3f& p : points) there.push_back(moved(p, screw));
  return ellipse_through(there);
}

double algebraic(const Ellipse& e, double x, double y) {  // (22)
  const double dx = x - e.xg, dy = y - e.yg;
  return e.mu02 * dx * dx + e.mu20 * dy * dy - 2 * e.mu11 * dx * dy + e.mu11 * e.mu11 - e.mu20 * e.mu02;
}

TEST(Contour, CircleParametersAndTheirInteraction) {
  test::Random random;
  int checked = 0;
  for (int trial = 0; trial < kTrials; ++trial) {
    const Vector3f centre = before_camera(random), n = random_unit(random);
    const float r = static_cast<float>(random.uniform(0.1, 0.4));
    EllipseContour e;
    if (std::abs(n.dot(centre)) < 0.3f || !e.set(centre, n, r)) continue;
    ++checked;
    const std::vector<Vector3f> points = on_circle(centre, n, r);
    const auto at = [&](const Vector6d& screw) { return moved_ellipse(points, screw); };
    const Ellipse truth = at(Vector6d::Zero());
    EXPECT_NEAR(static_cast<double>(e.xg), truth.xg, 1e-5) << trial;
    EXPECT_NEAR(static_cast<double>(e.yg), truth.yg, 1e-5) << trial;
    EXPECT_NEAR(static_cast<double>(e.mu20), truth.mu20, 1e-5) << trial;
    EXPECT_NEAR(static_cast<double>(e.mu11), truth.mu11, 1e-5) << trial;
    EXPECT_NEAR(static_cast<double>(e.mu02), truth.mu02, 1e-5) << trial;
    const std::function<double(const Ellipse&)> parts[5] = {
        [](const Ellipse& q) { return q.xg; }, [](const Ellipse& q) { return q.yg; },
        [](const Ellipse& q) { return q.mu20; }, [](const Ellipse& q) { return q.mu11; },
        [](const Ellipse& q) { return q.mu02; }};
    for (int k = 0; k < 5; ++k)
      expect_row(e.L[k], differences([&](const Vector6d& screw) { return parts[k](at(screw)); }), trial);
    // The distance of a point on the ellipse: there the fixed gradient costs nothing.
    const Vector3d p = points[static_cast<size_t>(trial % 5)].cast<double>();
    const double x = p.x() / p.z(), y = p.y() / p.z();
    const double gx = 2 * (truth.mu02 * (x - truth.xg) - truth.mu11 * (y - truth.yg));
    const double gy = 2 * (truth.mu20 * (y - truth.yg) - truth.mu11 * (x - truth.xg));
    float row[6];
    e.interaction(static_cast<float>(x), static_cast<float>(y), row);
    const Vector6d slope =
        differences([&](const Vector6d& screw) { return algebraic(at(screw), x, y); }) / std::hypot(gx, gy);
    expect_row(row, slope, trial);
  }
  EXPECT_GT(checked, kTrials / 3);
}

TEST(Contour, DistanceToAnEllipseIsOneOfLength) {
  // A frontal circle of radius 0.2 at depth 2: radius 0.1 in the image.
  EllipseContour e;
  ASSERT_TRUE(e.set(Vector3f(0, 0, 2), Vector3f(0, 0, -1), 0.2f));
  EXPECT_NEAR(e.mu20, 0.01f, 1e-6f);
  // d_e / |grad| at 1 % beyond the radius r: (x^2 - r^2) / (2 x) is 0.995 of the true distance.
  EXPECT_NEAR(e.distance(0.101f, 0), 0.000995f, 2e-6f);
  EXPECT_NEAR(e.distance(0, -0.099f), -0.001005f, 2e-6f);
  EXPECT_TRUE(std::isfinite(e.distance(0, 0)));
}

TEST(Contour, CirclesThatAreNoEllipsesAreRefused) {
  EllipseContour e;
  EXPECT_FALSE(e.set(Vector3f(0, 0, 1), Vector3f(1, 0, 0), 0.2f));        // edge-on
  EXPECT_FALSE(e.set(Vector3f(0, 0.1f, 0.3f), Vector3f(0, 1, 0), 0.5f));  // reaches behind the camera
  EXPECT_FALSE(e.set(Vector3f(0, 0, -1), Vector3f(0, 0, 1), 0.2f));       // behind it
}

// The outline's rays touch the sphere, and its interaction is that of the moving sphere's own outline.
TEST(Contour, SphereOutlineAndItsInteraction) {
  test::Random random;
  for (int trial = 0; trial < kTrials; ++trial) {
    const Vector3f centre = before_camera(random);
    const float radius = static_cast<float>(random.uniform(0.1, 0.4));
    Vector3f Q, n;
    float r;
    EllipseContour e;
    ASSERT_TRUE(sphere_outline(centre, radius, &Q, &n, &r));
    if (!e.set(Q, n, r)) continue;
    const auto at = [&](const Vector6d& screw) {  // the page's formulas, in double
      const Vector3d P = moved(centre, screw);
      const double R2 = static_cast<double>(radius) * static_cast<double>(radius), w = P.z() * P.z() - R2;
      return Ellipse{P.x() * P.z() / w, P.y() * P.z() / w, R2 * (P.x() * P.x() + w) / (w * w),
                     R2 * P.x() * P.y() / (w * w), R2 * (P.y() * P.y() + w) / (w * w)};
    };
    const Ellipse truth = at(Vector6d::Zero());
    EXPECT_NEAR(static_cast<double>(e.xg), truth.xg, 1e-5) << trial;
    EXPECT_NEAR(static_cast<double>(e.mu20), truth.mu20, 1e-5) << trial;
    EXPECT_NEAR(static_cast<double>(e.mu11), truth.mu11, 1e-5) << trial;
    expect_row(e.L[0], differences([&](const Vector6d& s) { return at(s).xg; }), trial);
    expect_row(e.L[1], differences([&](const Vector6d& s) { return at(s).yg; }), trial);
    expect_row(e.L[2], differences([&](const Vector6d& s) { return at(s).mu20; }), trial);
    expect_row(e.L[3], differences([&](const Vector6d& s) { return at(s).mu11; }), trial);
    expect_row(e.L[4], differences([&](const Vector6d& s) { return at(s).mu02; }), trial);
  }
}

// The limb's plane touches the cylinder, and the limb's interaction is that of the moving cylinder's own limb.
TEST(Contour, CylinderLimbAndItsInteraction) {
  test::Random random;
  for (int trial = 0; trial < kTrials; ++trial) {
    const Vector3f a = before_camera(random), b = before_camera(random);
    const float radius = static_cast<float>(random.uniform(0.05, 0.3));
    if ((a - b).norm() < 0.3f) continue;
    for (int side = 0; side < 2; ++side) {
      Vector3f limb_a, limb_b;
      LineContour line;
      if (!cylinder_limb(a, b, radius, side, &limb_a, &limb_b) || !line.set(limb_a, limb_b)) continue;
      const Vector3f n = limb_a.cross(limb_b).normalized();
      EXPECT_NEAR(std::abs(n.dot(a)), radius, 2e-5f) << trial;
      EXPECT_NEAR(n.dot(limb_a), 0, 2e-5f);
      EXPECT_NEAR((limb_a - a).norm(), radius, 2e-5f);
      const auto limb = [&](const Vector6d& screw) {  // the touching plane's normal, in double
        const Vector3d A = moved(a, screw), B = moved(b, screw), u = (B - A).normalized();
        const Vector3d P = A - u * u.dot(A);
        const double R = static_cast<double>(radius), root = std::sqrt(P.squaredNorm() - R * R);
        Vector3d normal = (R * P + (side == 0 ? root : -root) * u.cross(P)) / P.squaredNorm();
        normal /= std::hypot(normal.x(), normal.y());
        if (normal.x() * static_cast<double>(line.c) + normal.y() * static_cast<double>(line.s) < 0) normal = -normal;
        return normal;
      };
      const float x = static_cast<float>(random.uniform(-0.5, 0.5)), y = static_cast<float>(random.uniform(-0.5, 0.5));
      const auto d = [&](const Vector6d& screw) {
        const Vector3d normal = limb(screw);
        return -normal.z() - (static_cast<double>(x) * normal.x() + static_cast<double>(y) * normal.y());
      };
      EXPECT_NEAR(static_cast<double>(line.distance(x, y)), d(Vector6d::Zero()), 2e-5) << trial;
      float row[6];
      line.interaction(x, y, row);
      const Vector6d truth = differences(d);
      if (truth.cwiseAbs().maxCoeff() < 50) expect_row(row, truth, trial);
    }
  }
  Vector3f unused;
  EXPECT_FALSE(cylinder_limb(Vector3f(0, 0, -1), Vector3f(0, 0, 3), 0.2f, 0, &unused, &unused)) << "inside";
}

}  // namespace
}  // namespace pptam
