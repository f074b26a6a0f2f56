// FAST-10 and the corner source made of it: against the definition, at the extremes, and on pictures whose corners are
// known.
#include "image/fast.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

#include "image/kernels.h"
#include "tests/kernels/test_images.h"
#include "tests/support/random.h"

namespace pptam {
namespace {

bool ten_by_definition(uint32_t bits) {
  for (int first = 0; first < 16; ++first) {
    int run = 0;
    while (run < 10 && (bits >> ((first + run) % 16) & 1) != 0) ++run;
    if (run == 10) return true;
  }
  return false;
}

TEST(Fast, TenNeighbouringBitsOfSixteen) {
  for (uint32_t bits = 0; bits < 65536; ++bits) ASSERT_EQ(ten_in_a_row(bits), ten_by_definition(bits)) << bits;
}

// Angles of the circle's pixels ascend by 16 to 27 degrees, and all are three pixels away, to half a pixel.
TEST(Fast, TheCircleIsOne) {
  constexpr int kStride = 100;
  const FastCircle circle(kStride);
  double last = -1;
  for (const int offset : circle.offset) {
    const int y = (offset + 3 * kStride + 50) / kStride - 3, x = offset - y * kStride;
    EXPECT_NEAR(std::hypot(x, y), 3, 0.5);
    const double angle = std::atan2(x, -y) + (x < 0 ? 2 * 3.14159265358979 : 0);  // clockwise from the top
    EXPECT_GT(angle, last + (last < 0 ? 0 : 0.28));
    EXPECT_LT(angle, last + (last < 0 ? 1.1 : 0.48));
    last = angle;
  }
}

TEST(Fast, RowsHaveTheCornersOfTheDefinition) {
  test::Random random;
  int corners = 0;
  for (int trial = 0; trial < test::trials(300); ++trial) {
    const int width = random.integer(7, 80), threshold = random.integer(0, 60);
    // Blocks: random pixels have hardly any corners.
    const test::OwnedImage noise = test::random_image(random, width / 5 + 1, 7);
    test::OwnedImage image(width, 7);
    image.fill([&](int x, int y) { return noise.view().at(x / 5, y / 4); });
    const GreyView view = image.view();
    std::vector<int16_t> expected, found(static_cast<size_t>(width));
    for (int x = 3; x < width - 3; ++x) {
      uint32_t brighter = 0, darker = 0;
      for (int i = 0; i < 16; ++i) {
        const double angle = i * 3.14159265358979 / 8;
        const int dx = static_cast<int>(std::lround(3.1 * std::sin(angle)));
        const int dy = static_cast<int>(std::lround(-3.1 * std::cos(angle)));
        const int difference = view.at(x + dx, 3 + dy) - view.at(x, 3);
        brighter |= uint32_t{difference > threshold} << i;
        darker |= uint32_t{difference < -threshold} << i;
      }
      if (ten_by_definition(brighter) || ten_by_definition(darker)) expected.push_back(static_cast<int16_t>(x));
    }
    const int count = kernel::fast_row(view.row(3), view.stride, 3, width - 4, threshold, found.data());
    found.resize(static_cast<size_t>(count));
    ASSERT_EQ(found, expected) << "trial " << trial;
    corners += count;
  }
  EXPECT_GT(corners, 100);  // there was something to compare
}

// A black or white middle: the bounds beyond 0 and 255 are never passed.
TEST(Fast, ExtremesOfGreyLevels) {
  for (const int middle : {0, 255}) {
    test::OwnedImage image(40, 7);
    image.fill([&](int x, int y) { return x % 20 == 10 && y == 3 ? middle : 255 - middle; });
    std::vector<int16_t> found(40);
    EXPECT_EQ(kernel::fast_row(image.view().row(3), 40, 3, 36, 254, found.data()), 2);
    EXPECT_EQ(found[0], 10);
    EXPECT_EQ(found[1], 30);
  }
}

struct Found {
  std::vector<Corner> corners;
  std::vector<size_t> ends;  // of each level
};

Found detect(const GreyView& image) {
  std::vector<std::byte> memory(1 << 22);
  Arena arena(memory);
  WorkMeter meter;
  FastCorners source(arena, image.width, image.height, meter);
  const PyramidStorage storage(arena, image.width, image.height, 1);
  source.start(build_pyramid(image, storage));
  Found found;
  Corner corner;
  for (;;) {
    const CornerProgress progress = source.advance(&corner);
    if (progress == CornerProgress::kFound) found.corners.push_back(corner);
    if (progress == CornerProgress::kWeaker || progress == CornerProgress::kEnd)
      found.ends.push_back(found.corners.size());
    if (progress == CornerProgress::kEnd) return found;
  }
}

// A bright square of 40 pixels on black: in every level corners at its four corners, within what FAST's circle and the
// score's window blur (4 pixels of the level), and nowhere else.
TEST(FastCorners, OfASquare) {
  constexpr int kLow = 100, kHigh = 139;
  test::OwnedImage image(320, 240);
  image.fill([](int x, int y) { return x >= kLow && x <= kHigh && y >= kLow && y <= kHigh ? 200 : 20; });
  const Found found = detect(image.view());
  ASSERT_EQ(found.ends.size(), 4u);
  int seen[kPyramidLevels][4] = {};
  for (const Corner& corner : found.corners) {
    const float x = corner.px().x(), y = corner.px().y(), reach = 4.0f * static_cast<float>(1 << corner.level);
    int at = -1;
    for (int i = 0; i < 4; ++i)
      if (std::abs(x - (i % 2 ? kHigh : kLow)) <= reach && std::abs(y - (i / 2 ? kHigh : kLow)) <= reach) at = i;
    ASSERT_GE(at, 0) << x << " " << y << " L" << int{corner.level};
    ++seen[corner.level][at];
  }
  for (int level = 0; level < 3; ++level)
    for (const int count : seen[level]) EXPECT_GE(count, 1) << "L" << level;
}

TEST(FastCorners, LevelsInTheirOrderTheBestOfACellFirst) {
  test::Random random;
  const test::Texture texture(random, 50, 0.05, 0.8);
  test::OwnedImage image(320, 240);
  image.fill([&](int x, int y) { return 128 + texture.value(x, y); });
  const Found found = detect(image.view());
  ASSERT_EQ(found.ends.size(), 4u);
  const int order[4] = {1, 0, 2, 3};
  size_t first = 0;
  for (size_t i = 0; i < 4; first = found.ends[i++]) {
    float best = 0;
    for (size_t k = first; k < found.ends[i]; ++k) {
      const Corner& corner = found.corners[k];
      EXPECT_EQ(corner.level, order[i]);
      EXPECT_GE(corner.score, FastCorners::kMinScore);
      best = std::max(best, corner.score);
      for (size_t m = first; m < k; ++m)  // never adjacent
        EXPECT_GT(std::max(std::abs(corner.x - found.corners[m].x), std::abs(corner.y - found.corners[m].y)), 1);
    }
    if (first < found.ends[i]) {
      EXPECT_EQ(found.corners[first].score, best);
    }
  }
  EXPECT_GT(found.ends[1], 100u);
}

// The sensor's noise, 2 grey levels, on a flat area: no corners; with 40 there are.
TEST(FastCorners, NoiseHasNone) {
  for (const double sigma : {2.0, 40.0}) {
    test::Random random;
    test::OwnedImage image(320, 240);
    image.fill([&](int, int) {
      double sum = 0;
      for (int i = 0; i < 12; ++i) sum += random.uniform(-0.5, 0.5);
      return 128 + sigma * sum;
    });
    EXPECT_EQ(detect(image.view()).corners.empty(), sigma == 2.0);
  }
}

TEST(FastCorners, AnImageThatIsTooSmallHasNone) {
  test::Random random;
  const test::OwnedImage image = test::random_image(random, 64, 64);  // L3 has 8x8 pixels
  for (const Corner& corner : detect(image.view()).corners) EXPECT_LT(corner.level, 3);
}

}  // namespace
}  // namespace pptam
