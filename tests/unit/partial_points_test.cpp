// Where a new corner's depth is sought first.
#include "mapping/partial_points.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "tests/support/random.h"

namespace pptam {
namespace {

// On a plane the depth is right at once, but for the share of the slopes that the pull towards an even depth takes. Of
// a grid with mean squares of 0.045 and 0.089 that is 0.002 / 0.047 and 0.002 / 0.091; at its corner, with slopes of up
// to 0.6 of the inverse depth, 0.6 (0.3 x 0.043 + 0.4 x 0.022) = 0.013. Control: without points only the mean is known.
TEST(SeenSurface, IsThePlaneThroughTheMapsPoints) {
  test::Random random;
  float worst_empty = 0;
  for (int trial = 0; trial < 100; ++trial) {
    const auto q_0 = static_cast<float>(random.uniform(0.5, 2));
    const Vector2f slope =
        0.6f * q_0 * Vector2f(static_cast<float>(random.uniform(-1, 1)), static_cast<float>(random.uniform(-1, 1)));
    const auto q_at = [&](const Vector2f& at) { return q_0 + slope.dot(at); };  // 1/z over (x/z, y/z)
    std::vector<Vector2f> grid;
    for (int x = -2; x <= 2; ++x)
      for (int y = -3; y <= 3; y += 2)
        grid.emplace_back(0.15f * static_cast<float>(x), 0.4f / 3 * static_cast<float>(y));
    SeenSurface surface, empty;
    surface.clear();
    for (const Vector2f& at : grid) surface.add(at.homogeneous() / q_at(at));
    surface.fit(q_0);
    empty.clear();
    empty.fit(q_0);
    for (const Vector2f& at : grid) {
      EXPECT_NEAR(surface.inverse_depth(at), q_at(at), 0.0135f * q_0) << trial;
      worst_empty = std::max(worst_empty, std::abs(empty.inverse_depth(at) - q_at(at)) / q_0);
    }
  }
  EXPECT_GT(worst_empty, 0.2f);
}

// Few points, points all in one place and points on a line leave the mean or a pulled plane: never a depth out of
// bounds.
TEST(SeenSurface, StaysWithinBounds) {
  test::Random random;
  for (int points = 0; points < 30; ++points) {
    SeenSurface surface;
    surface.clear();
    for (int i = 0; i < points; ++i) {
      const float x = points % 3 == 0 ? 0.1f : static_cast<float>(random.uniform(-0.3, 0.3));
      const float z = static_cast<float>(random.uniform(0.05, 20));  // no plane at all
      surface.add({x * z, x * z, z});
    }
    surface.fit(1);
    for (const float x : {-10.0f, -0.3f, 0.0f, 0.3f, 10.0f}) {
      const float q = surface.inverse_depth({x, x});
      EXPECT_GE(q, 0.5f);
      EXPECT_LE(q, 2.0f);
      if (points < 8) {
        EXPECT_EQ(q, 1.0f);
      }
    }
  }
}

}  // namespace
}  // namespace pptam
