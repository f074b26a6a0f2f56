// Planes among points.
#include "geometry/plane.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "tests/support/random.h"

namespace pptam {
namespace {

// Two thirds of the points lie within `noise` of a plane through `at`, the rest anywhere.
struct Scattered {
  std::vector<Vector3f> points;
  Vector3f normal;
  float offset;
};
Scattered scattered(test::Random& random, int count, double noise) {
  const auto uniform = [&](double low, double high) { return static_cast<float>(random.uniform(low, high)); };
  Scattered s;
  s.normal = Vector3f(uniform(-0.5, 0.5), uniform(-0.5, 0.5), 1).normalized();
  s.offset = uniform(1, 2);
  for (int i = 0; i < count; ++i) {
    Vector3f p(uniform(-1, 1), uniform(-1, 1), uniform(0.5, 3));
    if (i % 3 != 0) p += (s.offset + uniform(-noise, noise) - s.normal.dot(p)) * s.normal;
    s.points.push_back(p);
  }
  return s;
}

TEST(Plane, SamplingAndFittingFindThePlaneAmongOthers) {
  test::Random random;
  for (int round = 0; round < 20; ++round) {
    const Scattered s = scattered(random, 90, 0.01);
    PlaneSampler sampler(s.points, 2);
    Plane best;
    float most = 0;
    for (int trial = 0; trial < 100; ++trial) {
      const Plane plane = sampler.next();
      if (!plane.found) continue;
      const float near = support_of(s.points, plane, 0.02f).near;
      if (near > most) {
        most = near;
        best = plane;
      }
    }
    ASSERT_TRUE(best.found);
    for (int fit = 0; fit < 3; ++fit) ASSERT_TRUE(fit_plane(s.points, {}, 0.02f, &best));
    // 60 points with a deviation of 0.01 / sqrt(3) over an extent of 0.58: 0.0013 radians, of which six; strays within
    // the threshold are some 1 % and weigh as much.
    EXPECT_GT(best.normal.dot(s.normal), std::cos(0.01f));
    EXPECT_NEAR(best.offset, s.offset, 0.01f);
    const PlaneSupport support = support_of(s.points, best, 0.02f);
    EXPECT_GE(support.on, 60);
    EXPECT_GT(support.beyond, 0);
  }
}

TEST(Plane, WeightsChooseBetweenTwoPlanes) {
  std::vector<Vector3f> points;
  std::vector<float> first, second;
  for (int i = 0; i < 40; ++i) {
    const bool upper = i % 2 == 0;
    points.emplace_back(0.1f * static_cast<float>(i % 7), 0.1f * static_cast<float>(i % 5), upper ? 1.0f : 1.1f);
    first.push_back(upper ? 1 : 0);
    second.push_back(upper ? 0 : 1);
  }
  Plane plane = {Vector3f::UnitZ(), 1.05f, true};
  ASSERT_TRUE(fit_plane(points, first, 0.2f, &plane));
  EXPECT_NEAR(plane.offset, 1.0f, 1e-5f);
  plane = {Vector3f::UnitZ(), 1.05f, true};
  ASSERT_TRUE(fit_plane(points, second, 0.2f, &plane));
  EXPECT_NEAR(plane.offset, 1.1f, 1e-5f);
  plane = {Vector3f::UnitZ(), 1.05f, true};
  ASSERT_TRUE(fit_plane(points, {}, 0.2f, &plane));
  EXPECT_NEAR(plane.offset, 1.05f, 0.01f);
}

TEST(Plane, TooFewPointsAndPointsInALineGiveNone) {
  std::vector<Vector3f> line;
  for (int i = 0; i < 30; ++i) line.emplace_back(0.1f * static_cast<float>(i), 0.2f * static_cast<float>(i), 2);
  PlaneSampler sampler(line, 2);
  for (int trial = 0; trial < 50; ++trial) EXPECT_FALSE(sampler.next().found);
  EXPECT_FALSE(PlaneSampler({}, 1).next().found);
  Plane plane = {Vector3f::UnitZ(), 2, true};
  EXPECT_FALSE(fit_plane(std::span(line).first(kMinFittedPoints - 1), {}, 0.1f, &plane));
  EXPECT_EQ(plane.offset, 2) << "nothing has changed";
  const std::vector<float> none(line.size(), 0.0f);
  EXPECT_FALSE(fit_plane(line, none, 0.1f, &plane));
}

TEST(Plane, TheNormalPointsAwayFromTheOrigin) {
  const std::vector<Vector3f> points = {{0, 0, -2}, {1, 0, -2}, {0, 1, -2}, {1, 1, -2}, {2, 1, -2}, {1, 2, -2}};
  PlaneSampler sampler(points, 1);
  for (int trial = 0; trial < 20; ++trial) {
    const Plane plane = sampler.next();
    if (!plane.found) continue;
    EXPECT_GT(plane.offset, 0);
    EXPECT_LT(plane.normal.z(), 0);
    EXPECT_GT(plane.beyond(Vector3f(0, 0, -3)), 0);
  }
}

}  // namespace
}  // namespace pptam
