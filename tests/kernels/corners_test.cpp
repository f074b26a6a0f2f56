#include "image/corners.h"

#include <gtest/gtest.h>

#include <cstddef>
#include <vector>

#include "tests/kernels/test_images.h"

namespace pptam {
namespace {

using test::OwnedImage;
using test::Random;

struct Detected {
  std::vector<Corner> corners;
  int ascent_steps = 0;
  std::vector<std::byte> memory;
  Pyramid pyramid;
};

Detected detect(const GreyView& image, const CornerParams& params = {}, int capacity = 500, int enough = 0) {
  Detected d;
  d.memory.resize(static_cast<size_t>(image.width * image.height * 4 + 4096));
  Arena arena(d.memory);
  const PyramidStorage storage(arena, image.width, image.height, 1);
  CornerDetector detector(arena, image.width, image.height);
  EXPECT_FALSE(arena.overflowed());
  d.pyramid = build_pyramid(image, storage);
  d.corners.resize(static_cast<size_t>(capacity));
  d.corners.resize(static_cast<size_t>(detector.detect(d.pyramid, params, d.corners, enough)));
  d.ascent_steps = detector.ascent_steps();
  return d;
}

// Mean structure tensor in double precision over a window of the given radius, and its smaller eigenvalue.
double reference_score(const GreyView& image, int x, int y, int radius) {
  double xx = 0, xy = 0, yy = 0;
  for (int dy = -radius; dy <= radius; ++dy) {
    for (int dx = -radius; dx <= radius; ++dx) {
      const double gx = (image.at(x + dx + 1, y + dy) - image.at(x + dx - 1, y + dy)) / 2.0;
      const double gy = (image.at(x + dx, y + dy + 1) - image.at(x + dx, y + dy - 1)) / 2.0;
      xx += gx * gx;
      xy += gx * gy;
      yy += gy * gy;
    }
  }
  const double n = (2 * radius + 1) * (2 * radius + 1);
  return (xx + yy - std::sqrt((xx - yy) * (xx - yy) + 4 * xy * xy)) / 2 / n;
}

// Float error as derived beside min_eigenvalue: the sums are exact, the root is rounded twice before it is taken and
// once after, together 1.5 x 2^-24 of at most the larger eigenvalue (65025 here), the rest once more.
constexpr double kScoreTolerance = 4 * 65025.0 * 0x1p-24;

TEST(Corners, ScoreEqualsDoublePrecision) {
  Random random;
  for (int trial = 0; trial < 200; ++trial) {
    const int contrast = random.integer(0, 127);
    const OwnedImage image =
        OwnedImage(11, 13, 14).fill([&](int, int) { return 128 + random.integer(-contrast, contrast); });
    const int x = random.integer(4, 6), y = random.integer(4, 8);
    EXPECT_NEAR(shi_tomasi_score(image.view(), x, y), reference_score(image.view(), x, y, 3), kScoreTolerance);
  }
}

TEST(Corners, ScoreOfMaxContrastDoesNotOverflow) {
  // Period 4 of 0 0 255 255 along both diagonals: every central difference is +-127.5, the most there is.
  const OwnedImage one = OwnedImage(9, 9).fill([](int x, int y) { return (x + y) % 4 < 2 ? 0 : 255; });
  EXPECT_NEAR(shi_tomasi_score(one.view(), 4, 4), 0, kScoreTolerance);  // one direction only
  const OwnedImage both =
      OwnedImage(9, 9).fill([](int x, int y) { return (x + (y < 4 ? y : -y) + 20) % 4 < 2 ? 0 : 255; });
  EXPECT_NEAR(shi_tomasi_score(both.view(), 4, 4), reference_score(both.view(), 4, 4, 3), kScoreTolerance);
  EXPECT_GT(shi_tomasi_score(both.view(), 4, 4), 0.5 * 127.5 * 127.5);
}

// The L0 part of the score is that of the reported position: with an image whose L0 gradients are the weakest (soft, so
// that levels 1 and 2 see two and four times the slope per pixel) the reported score is exactly shi_tomasi_score.
TEST(Corners, ReportedScoreIsTheSmallestOfTheLevels) {
  Random random;
  const test::Texture texture(random, 50, 0.1, 0.25);
  const OwnedImage image = OwnedImage(240, 240).fill([&](int x, int y) { return 128 + texture.value(x, y); });
  const Detected d = detect(image.view());
  ASSERT_GT(d.corners.size(), 20u);
  int equal = 0;
  for (const Corner& corner : d.corners) {
    EXPECT_GE(corner.score, CornerParams().min_score);
    EXPECT_LE(corner.score, shi_tomasi_score(image.view(), corner.x, corner.y));
    equal += corner.score == shi_tomasi_score(image.view(), corner.x, corner.y);
  }
  EXPECT_GT(equal, static_cast<int>(d.corners.size()) * 3 / 4);
}

// Dark squares on grey, far enough apart that every corner has its own L2 maximum: each is found, to 2 px (the 7x7
// window's maximum lies inside the square's corner), and nothing else is. The image ends far enough from the last
// square for the border.
TEST(Corners, SquaresAreFoundAtTheirCorners) {
  const auto dark = [](int x, int y) { return x % 60 >= 20 && x % 60 < 44 && y % 60 >= 20 && y % 60 < 44; };
  const OwnedImage image = OwnedImage(264, 324).fill([&](int x, int y) { return dark(x, y) ? 60 : 180; });
  const Detected d = detect(image.view());
  EXPECT_EQ(d.corners.size(), 4u * 5u * 4u);
  for (const Corner& corner : d.corners) {
    const double ex = std::min(std::abs(corner.x % 60 - 19.5), std::abs(corner.x % 60 - 43.5));
    const double ey = std::min(std::abs(corner.y % 60 - 19.5), std::abs(corner.y % 60 - 43.5));
    EXPECT_LE(ex, 2.5) << corner.x << " " << corner.y;
    EXPECT_LE(ey, 2.5) << corner.x << " " << corner.y;
  }
}

// Noise of 2 grey levels has gradients of variance 2 (2^2 x 2 / 4) in L0, 0.5 in L1 and 0.125 in L2: a flat grey area
// passes nowhere near min_score. A dim, lightly textured one (gradients of about 4 grey levels per pixel) does.
TEST(Corners, NoiseGivesNoneAndADimDeskGivesSixty) {
  Random random;
  const OwnedImage flat = OwnedImage(240, 320).fill([&](int, int) { return 110 + 2 * random.gaussian(); });
  EXPECT_EQ(detect(flat.view()).corners.size(), 0u);
  CornerParams careless;
  careless.min_score = 0.1f;
  EXPECT_GT(detect(flat.view(), careless).corners.size(), 60u);  // control: a threshold under the noise

  const test::Texture texture(random, 15, 0.1, 0.6);
  const OwnedImage dim =
      OwnedImage(240, 320).fill([&](int x, int y) { return 50 + texture.value(x, y) + 2 * random.gaussian(); });
  EXPECT_GE(detect(dim.view()).corners.size(), 60u);
}

TEST(Corners, EveryLevelMustPass) {
  // A fine checkerboard vanishes in L1; a broad, soft blob pattern has hardly any gradient in L0.
  const OwnedImage fine = OwnedImage(240, 240).fill([](int x, int y) { return (x + y) % 2 ? 220 : 30; });
  EXPECT_EQ(detect(fine.view()).corners.size(), 0u);
  const OwnedImage soft =
      OwnedImage(240, 240).fill([](int x, int y) { return 128 + 16 * (std::cos(0.2 * x) + std::cos(0.2 * y)); });
  const Detected d = detect(soft.view());
  bool passes_l2 = false;
  for (int y = 8; y < 52; ++y)
    for (int x = 8; x < 52; ++x)
      passes_l2 |= reference_score(d.pyramid.level[2], x, y, 1) > static_cast<double>(CornerParams().min_score);
  EXPECT_TRUE(passes_l2);
  EXPECT_EQ(d.corners.size(), 0u);
}

// Squares of 4 px on a grid of 20 with a contrast of c = 10 grey levels. In L2 a square is one pixel, whose gradients
// of c / 2 in two of nine pixels score c^2 / 18 = 5.6, under the threshold of 6; in L1 and L0 it is 2 c^2 / 25 = 8 or
// more. Corners of one level only follow where those of all levels are not enough, and none lies near another.
TEST(Corners, WeakerOnesFollowWhereThereAreNotEnough) {
  const OwnedImage image = OwnedImage(240, 320).fill([](int x, int y) { return x % 20 < 4 && y % 20 < 4 ? 118 : 128; });
  const size_t strong = detect(image.view()).corners.size();
  const Detected all = detect(image.view(), {}, 500, 500);
  std::printf("%zu corners of all levels, %zu with those of L1\n", strong, all.corners.size());
  EXPECT_EQ(strong, 0u);
  EXPECT_GE(all.corners.size(), 100u);  // of 130 squares that are far enough from the border
  EXPECT_EQ(detect(image.view(), {}, 500, static_cast<int>(strong)).corners.size(), strong);  // enough is enough
  for (size_t i = 0; i < all.corners.size(); ++i) {
    for (size_t j = 0; j < i; ++j) {
      const int dx = all.corners[i].x - all.corners[j].x, dy = all.corners[i].y - all.corners[j].y;
      EXPECT_GE(dx * dx + dy * dy, 36);
    }
  }
}

TEST(Corners, AreSpreadApartAndTakenInTurns) {
  Random random;
  // Strong texture in the left third, weak elsewhere.
  const test::Texture texture(random, 1, 0.1, 0.5);
  const OwnedImage image =
      OwnedImage(240, 320).fill([&](int x, int y) { return 128 + (x < 80 ? 40 : 12) * texture.value(x, y); });
  const Detected d = detect(image.view(), {}, 48);
  ASSERT_EQ(d.corners.size(), 48u);
  int left = 0;
  for (size_t i = 0; i < d.corners.size(); ++i) {
    left += d.corners[i].x < 80;
    for (size_t j = 0; j < i; ++j) {
      const int dx = d.corners[i].x - d.corners[j].x, dy = d.corners[i].y - d.corners[j].y;
      EXPECT_GE(dx * dx + dy * dy, 36);
    }
  }
  EXPECT_LE(left, 24);  // a third of the cells, and a turn more where others are empty
  CornerParams one_bucket;
  one_bucket.cells_x = one_bucket.cells_y = 1;
  const Detected best = detect(image.view(), one_bucket, 48);
  int best_left = 0;
  for (const Corner& corner : best.corners) best_left += corner.x < 80;
  EXPECT_GE(best_left, 40);  // control: without buckets the strong texture takes nearly all
}

// A plateau of equal scores (an exactly periodic or symmetric picture) gives one corner each: the first in row-major
// order; detection twice gives the same list.
TEST(Corners, AnyOddSizeAndStrideIsSafeAndRepeatable) {
  Random random;
  int with_corners = 0;
  for (int trial = 0; trial < 60; ++trial) {
    const int width = random.integer(1, 90), height = random.integer(1, 90);
    const test::Texture texture(random, 45, 0.1, 0.7);
    const OwnedImage image = OwnedImage(width, height, width + random.integer(0, 5)).fill([&](int x, int y) {
      return 128 + texture.value(x, y);
    });
    CornerParams params;
    params.border = random.integer(0, 7);
    params.max_ascent_steps = random.integer(1, 5);
    const Detected d = detect(image.view(), params);
    const Detected again = detect(image.view(), params);
    ASSERT_EQ(d.corners.size(), again.corners.size());
    with_corners += !d.corners.empty();
    for (size_t i = 0; i < d.corners.size(); ++i) {
      ASSERT_EQ(d.corners[i].x, again.corners[i].x);
      ASSERT_EQ(d.corners[i].y, again.corners[i].y);
      ASSERT_TRUE(d.corners[i].x >= 4 && d.corners[i].x < width - 4) << d.corners[i].x << " of " << width;
      ASSERT_TRUE(d.corners[i].y >= 4 && d.corners[i].y < height - 4);
    }
  }
  EXPECT_GT(with_corners, 10);
  EXPECT_EQ(detect(test::golden_image(163, 119).view(), {}, 0).corners.size(), 0u);
}

TEST(Corners, GoldenHash) {
  const auto hash = [](const GreyView& image) {
    const Detected d = detect(image);
    test::Fnv fnv;
    for (const Corner& corner : d.corners) {
      fnv.add_value(corner.x);
      fnv.add_value(corner.y);
      fnv.add_value(corner.score);
    }
    fnv.add_value(d.ascent_steps);
    return fnv.value();
  };
  OwnedImage image = test::golden_image(163, 119);
  constexpr uint64_t kExpected = 0x5ecbb20ee9422ec9u;
  EXPECT_EQ(hash(image.view()), kExpected);
  const Corner first = detect(image.view()).corners.front();
  image.image().at(first.x + 1, first.y) ^= 8;  // control: one pixel in the window of one corner
  EXPECT_NE(hash(image.view()), kExpected);
}

}  // namespace
}  // namespace pptam
