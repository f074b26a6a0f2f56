// What a point's neighbours say of it: who they are, the plane that they lie on, and whether two points are one.
#include "mapping/neighbours.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "tests/support/map_building.h"
#include "tests/support/random.h"
#include "tests/support/small_map.h"

namespace pptam {
namespace {

using test::SmallMap;

// Angle between two unit vectors. Not by acos: near 1 a rounding of 6e-8 would be 3e-4 radians.
float angle_rad(const Vector3f& a, const Vector3f& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b));
}

// A map whose points are all gone but for new ones, all cut from keyframe 0.
struct EmptyMap : SmallMap {
  explicit EmptyMap(uint64_t seed) : SmallMap(seed) {
    for (int i = 0; i < map.points().size(); ++i) map.remove_point(i);
  }
  int add(const Vector3f& p_w) { return map.add_point(p_w, {0, Vector2f::Zero(), -Vector3f::UnitZ()}); }
  Neighbours neighbours(int i) const { return find_neighbours(map, i); }
};

TEST(Neighbours, AreTheNearestByDistance) {
  test::Random random;
  for (int trial = 0; trial < test::trials(100); ++trial) {
    EmptyMap small(random.seed() + static_cast<uint64_t>(trial));
    const int points = random.integer(1, 100);
    for (int i = 0; i < points; ++i)
      small.add({static_cast<float>(random.uniform(-0.3, 0.3)), static_cast<float>(random.uniform(-0.3, 0.3)),
                 static_cast<float>(random.uniform(0.9, 1.1))});
    for (int gone = 0; gone < points / 10; ++gone) small.map.remove_point(random.integer(1, points - 1));
    const Vector3f centre = small.map.keyframes()[0].T_kw.centre();
    const Vector3f middle = small.map.points()[0].p_w;
    std::vector<std::pair<float, int>> near;
    for (int i = 1; i < points; ++i) {
      const float d_sq = (small.map.points()[i].p_w - middle).squaredNorm();
      if (small.map.points()[i].id != 0 && d_sq <= 0.25f * 0.25f * (middle - centre).squaredNorm())
        near.emplace_back(d_sq, i);
    }
    std::sort(near.begin(), near.end());
    const Neighbours found = small.neighbours(0);
    ASSERT_EQ(found.size(), std::min<int>(kNeighbours, 1 + static_cast<int>(near.size())));
    EXPECT_EQ(found[0], 0);
    for (int n = 1; n < found.size(); ++n) EXPECT_EQ(found[n], near[static_cast<size_t>(n - 1)].second);
    if (found.size() < 3) continue;
    small.map.move_point(found[1], middle + Vector3f(1, 0, 0));
    EXPECT_NE(small.neighbours(0)[1], found[1]) << "control: it is not near any more";
  }
}

// Points on a plane through (0, 0, 1), all within reach of each other, each off it by `noise` at most.
std::vector<Vector3f> on_plane(test::Random& random, const Vector3f& normal, int count, double noise) {
  const Vector3f u = normal.cross(Vector3f(0.36f, 0.48f, 0.8f)).normalized(), v = normal.cross(u);
  std::vector<Vector3f> points;
  for (int i = 0; i < count; ++i)
    points.emplace_back(Vector3f(0, 0, 1) + static_cast<float>(random.uniform(-0.08, 0.08)) * u +
                        static_cast<float>(random.uniform(-0.08, 0.08)) * v +
                        static_cast<float>(random.uniform(-noise, noise)) * normal);
  return points;
}
Vector3f slanted(float degrees, double direction) {  // against the view along z
  const float a = degrees * 0.01745329f;
  return {std::sin(a) * static_cast<float>(std::cos(direction)), std::sin(a) * static_cast<float>(std::sin(direction)),
          -std::cos(a)};
}

TEST(PatchNormal, IsThatOfThePlane) {
  test::Random random;
  int fitted = 0;
  const int trials = test::trials(200);
  for (int trial = 0; trial < trials; ++trial) {
    EmptyMap small(random.seed() + static_cast<uint64_t>(trial));
    const Vector3f normal = slanted(static_cast<float>(random.uniform(0, 50)), random.uniform(0, 6.28));
    for (const Vector3f& p : on_plane(random, normal, 30, 0)) small.add(p);
    Vector3f normal_k = Vector3f::Zero();
    if (!fit_patch_normal(small.map, small.neighbours(0), &normal_k)) continue;
    ++fitted;
    const Matrix3f& R_kw = small.map.keyframes()[0].T_kw.R;
    // Coordinates of about 1 are rounded by 6e-8, and so are the ten operations on each: 1e-6 over a spread of at least
    // 0.01 (twelve neighbours within the square; a thinner one is refused as no plane only if it is noisy).
    EXPECT_LT(angle_rad(normal_k, R_kw * normal), 1e-3f);
    EXPECT_NEAR(normal_k.norm(), 1, 1e-6f);  // a map file wants it
    EXPECT_GT(angle_rad(normal_k, R_kw * slanted(60, 0)), 0.01f) << "control: another plane";
  }
  EXPECT_EQ(fitted, trials);
}

TEST(PatchNormal, BearsTheNoiseOfDepths) {
  test::Random random;
  double sum_sq = 0;
  int fitted = 0;
  for (int trial = 0; trial < test::trials(300); ++trial) {
    EmptyMap small(random.seed() + static_cast<uint64_t>(trial));
    const Vector3f normal = slanted(30, random.uniform(0, 6.28));
    for (const Vector3f& p : on_plane(random, normal, 13, 0.004)) small.add(p);
    Vector3f normal_k;
    if (!fit_patch_normal(small.map, small.neighbours(0), &normal_k)) continue;
    ++fitted;
    const float error = angle_rad(normal_k, small.map.keyframes()[0].T_kw.R * normal);
    sum_sq += static_cast<double>(error * error);
  }
  ASSERT_GT(fitted, test::trials(300) * 3 / 4);
  // Noise 0.004 / sqrt(3) = 0.0023 rms over a spread of 0.08 / sqrt(3) = 0.046 rms in each direction, 12 points:
  // slopes good to 0.0023 / 0.046 / sqrt(12 - 3) = 0.017 each, both together 0.024 radians, more where they spread
  // less.
  const double rms = std::sqrt(sum_sq / fitted);
  EXPECT_LT(rms, 0.04);
  EXPECT_GT(rms, 0.01) << "control: noise shows";
}

TEST(PatchNormal, StaysWhereThereIsNoPlane) {
  test::Random random;
  for (int trial = 0; trial < test::trials(50); ++trial) {
    const Vector3f normal = slanted(20, random.uniform(0, 6.28));
    const auto fits = [&](const std::vector<Vector3f>& points) {
      EmptyMap small(random.seed() + static_cast<uint64_t>(trial));
      for (const Vector3f& p : points) small.add(p);
      const Vector3f before(0.1f, 0.2f, 0.3f);
      Vector3f normal_k = before;
      const bool fitted = fit_patch_normal(small.map, small.neighbours(0), &normal_k);
      EXPECT_EQ(fitted, normal_k != before);
      return fitted;
    };
    const std::vector<Vector3f> plane = on_plane(random, normal, 12, 0);
    EXPECT_TRUE(fits(plane));
    EXPECT_TRUE(fits({plane.begin(), plane.begin() + 6}));
    EXPECT_FALSE(fits({plane.begin(), plane.begin() + 5})) << "too few";
    // A cloud 0.06 thick at a distance of 1: 0.035 rms against 0.01.
    EXPECT_FALSE(fits(on_plane(random, normal, 12, 0.06)) && fits(on_plane(random, normal, 12, 0.06)) &&
                 fits(on_plane(random, normal, 12, 0.06)))
        << "a cloud";
    std::vector<Vector3f> line = plane;
    for (Vector3f& p : line) p = Vector3f(0, 0, 1) + (p.x() * Vector3f(0.8f, 0.6f, 0)) + 0.001f * (p - plane[0]);
    for (size_t i = 0; i < line.size(); ++i) line[i].z() += i % 2 == 0 ? 0.001f : -0.001f;
    EXPECT_FALSE(fits(line)) << "a line, a millimetre thick either way";
    EXPECT_FALSE(fits(on_plane(random, slanted(75, random.uniform(0, 6.28)), 12, 0))) << "seen from the side";
  }
}

TEST(SamePoint, ExplainsWhatWasMeasuredOfTheOther) {
  test::Random random;
  for (uint64_t trial = 0; trial < 20; ++trial) {
    SmallMap small(random.seed() + trial);
    const MapPoint& other = small.map.points()[5];
    ASSERT_GE(other.measurements.size(), 2);
    for (int j = 0; j < other.measurements.size(); ++j) {
      Measurement& m = MapAccess::measurement(small.map, 5, j);
      const Keyframe& keyframe = small.map.keyframes()[m.keyframe];
      PredictedPoint seen;
      ASSERT_TRUE(small.config.camera.project_rolling(keyframe.T_kw, keyframe.velocity, other.p_w, &seen));
      m.at = {seen.px, 1};
    }
    MapPoint point = other;
    point.measurements = {};
    EXPECT_TRUE(explains(small.map, small.config.camera, point, other));
    // At a focal length of 100 px and distances of 0.9 to 1.1 plus the poses' noise, 0.012 are 1.0 to 1.5 px, 0.03 are
    // 2.5 to 3.7: inside and outside of sigma.
    point.p_w.x() += 0.012f;
    EXPECT_TRUE(explains(small.map, small.config.camera, point, other));
    point.p_w.x() += 0.018f;
    EXPECT_FALSE(explains(small.map, small.config.camera, point, other));
    point.p_w = -point.p_w;
    EXPECT_FALSE(explains(small.map, small.config.camera, point, other)) << "behind the camera";
  }
}

}  // namespace
}  // namespace pptam
