#include "image/pyramid.h"

#include <gtest/gtest.h>

#include <cstddef>
#include <vector>

#include "tests/kernels/test_images.h"

namespace pptam {
namespace {

using test::OwnedImage;
using test::Random;

TEST(Pyramid, HalfSampleIsTheRoundedMeanForEverySizeAndStride) {
  Random random;
  for (int width = 0; width <= 40; ++width) {
    for (int height = 0; height <= 5; ++height) {
      const OwnedImage src = test::random_image(random, width, height, width + random.integer(1, 6));
      OwnedImage dst(width / 2, height / 2, width / 2 + random.integer(1, 4));
      half_sample(src.view(), dst.image());
      for (int y = 0; y < height / 2; ++y) {
        for (int x = 0; x < width / 2; ++x) {
          const int sum = src.view().at(2 * x, 2 * y) + src.view().at(2 * x + 1, 2 * y) +
                          src.view().at(2 * x, 2 * y + 1) + src.view().at(2 * x + 1, 2 * y + 1);
          ASSERT_EQ(dst.view().at(x, y), (sum + 2) / 4) << width << "x" << height << " at " << x << " " << y;
        }
      }
      ASSERT_TRUE(dst.guards_intact());
    }
  }
}

TEST(Pyramid, ExtremesDoNotOverflow) {
  // White blocks among black ones: a carry out of one 16-bit lane would show in its neighbour.
  const OwnedImage src = OwnedImage(32, 2).fill([](int x, int) { return x / 2 % 2 ? 255 : 0; });
  OwnedImage dst(16, 1);
  half_sample(src.view(), dst.image());
  for (int x = 0; x < 16; ++x) EXPECT_EQ(dst.view().at(x, 0), x % 2 ? 255 : 0);
}

// Rounding half up adds 1/8 grey a level on average (of the four remainders 0 to 3 of a sum by 4, the error is 0, -1/4,
// +1/2, +1/4: mean 1/8). The sample mean over the 4800 pixels of L2 of an image of noise with sigma 30 is uncertain by
// 30 / sqrt(76800) = 0.11 for the image, which is common to both, and 0.3 / sqrt(4800) = 0.005 for the rounding.
TEST(Pyramid, RoundingBiasIsOneEighthOfAGreyLevelPerLevel) {
  Random random;
  const OwnedImage image = OwnedImage(240, 320).fill([&](int, int) { return 128 + 30 * random.gaussian(); });
  std::vector<std::byte> memory(60000);
  Arena arena(memory);
  const Pyramid pyramid = build_pyramid(image.view(), PyramidStorage(arena, 240, 320, 1));
  const auto mean = [](const GreyView& view) {
    double sum = 0;
    for (int y = 0; y < view.height; ++y)
      for (int x = 0; x < view.width; ++x) sum += view.at(x, y);
    return sum / view.width / view.height;
  };
  EXPECT_NEAR(mean(pyramid.level[2]) - mean(pyramid.level[0]), 2 * 0.125, 0.025);
}

TEST(Pyramid, LevelsHaveTheStatedSizesInOneAllocation) {
  Arena measure;
  PyramidStorage(measure, 240, 320, 1);
  const size_t levels_1_to_4 = 120 * 160 + 60 * 80 + 30 * 40 + 15 * 20;
  EXPECT_EQ(measure.used(), levels_1_to_4);
  std::vector<std::byte> memory(levels_1_to_4 + 15 + 240 * 320 + levels_1_to_4);
  Arena arena(memory);
  const PyramidStorage storage(arena, 240, 320, 1);
  const PyramidStorage keyframe(arena, 240, 320, 0);
  ASSERT_FALSE(arena.overflowed());
  EXPECT_EQ(storage.level[0].data, nullptr);
  const OwnedImage image = test::golden_image(240, 320);
  const Pyramid pyramid = build_pyramid(image.view(), storage);
  EXPECT_EQ(pyramid.level[0].data, image.view().data);
  EXPECT_EQ(pyramid.level[4].width, 15);
  EXPECT_EQ(pyramid.level[4].height, 20);

  const Pyramid copy = copy_pyramid(pyramid, keyframe);
  for (int l = 0; l < kPyramidLevels; ++l) {
    ASSERT_EQ(copy.level[l].data, keyframe.level[l].data);
    ASSERT_EQ(copy.level[l].width, 240 >> l);
    ASSERT_EQ(copy.level[l].height, 320 >> l);
    for (int y = 0; y < copy.level[l].height; ++y)
      for (int x = 0; x < copy.level[l].width; ++x)
        ASSERT_EQ(copy.level[l].at(x, y), pyramid.level[l].at(x, y)) << l << " " << x << " " << y;
  }
}

// A texture sampled at a level's pixel centres, mapped by to_level0(), equals the level up to the box mean's own
// smoothing: 1 - (w 2^l)^2 / 24 of each frequency w, 1.5 % of contrast 40 at 0.15 rad/px and l = 2, plus rounding of
// the levels (3 x 1/2). A convention wrong by half a level-2 pixel would show as gradient x 2 px = 40 x 0.15 x 2 = 12.
TEST(Pyramid, PixelCentresFollowTheConvention) {
  Random random;
  const test::Texture texture(random, 40, 0.1, 0.15);
  const OwnedImage image = OwnedImage(101, 91).fill([&](int x, int y) { return 128 + texture.value(x, y); });
  std::vector<std::byte> memory(10000);
  Arena arena(memory);
  const Pyramid pyramid = build_pyramid(image.view(), PyramidStorage(arena, 101, 91, 1));
  EXPECT_EQ(pyramid.level[2].width, 25);
  EXPECT_EQ(pyramid.level[2].height, 22);
  double worst = 0, worst_shifted = 0;
  for (int y = 0; y < 22; ++y) {
    for (int x = 0; x < 25; ++x) {
      const double x0 = static_cast<double>(to_level0(static_cast<float>(x), 2));
      const double y0 = static_cast<double>(to_level0(static_cast<float>(y), 2));
      worst = std::max(worst, std::abs(pyramid.level[2].at(x, y) - 128 - texture.value(x0, y0)));
      worst_shifted = std::max(worst_shifted, std::abs(pyramid.level[2].at(x, y) - 128 - texture.value(4 * x, 4 * y)));
    }
  }
  EXPECT_LT(worst, 1.5 + 0.015 * 3 * 40);
  EXPECT_GT(worst_shifted, 6);  // control
}

TEST(Pyramid, GoldenHash) {
  const auto hash = [](const GreyView& image) {
    std::vector<std::byte> memory(10000);
    Arena arena(memory);
    const Pyramid pyramid = build_pyramid(image, PyramidStorage(arena, image.width, image.height, 1));
    test::Fnv fnv;
    for (int l = 1; l < kPyramidLevels; ++l) fnv.add_image(pyramid.level[l]);
    return fnv.value();
  };
  OwnedImage image = test::golden_image(163, 119);
  constexpr uint64_t kExpected = 0xc1c470e802d171dbu;
  EXPECT_EQ(hash(image.view()), kExpected);
  image.image().at(80, 60) ^= 4;  // control: one pixel by 4, 1 in L1
  EXPECT_NE(hash(image.view()), kExpected);
}

}  // namespace
}  // namespace pptam
