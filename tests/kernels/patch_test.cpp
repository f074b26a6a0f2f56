#include "image/patch.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <algorithm>
#include <climits>
#include <cstdio>
#include <cstring>
#include <limits>
#include <vector>

#include "tests/kernels/test_images.h"

namespace pptam {
namespace {

using Eigen::Matrix2d;
using Eigen::Matrix2f;
using Eigen::Vector2d;
using Eigen::Vector2f;
using test::golden_image;
using test::OwnedImage;
using test::Random;
using test::random_image;
using test::Texture;

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
const Matrix2f kIdentity = Matrix2f::Identity();

PatchTemplate cut(const GreyView& image, int x, int y) {  // the 8x8 whose top-left pixel is (x, y)
  PatchTemplate patch;
  EXPECT_TRUE(warp_patch(image, Vector2f(x + kPatchCentre, y + kPatchCentre), kIdentity, &patch));
  return patch;
}

// ---------------------------------------------------------------------------------------------------------------- warp

double bilinear(const GreyView& image, double x, double y) {
  const int x0 = std::min(static_cast<int>(std::floor(x)), image.width - 2);
  const int y0 = std::min(static_cast<int>(std::floor(y)), image.height - 2);
  const double a = x - x0, b = y - y0;
  return (1 - b) * ((1 - a) * image.at(x0, y0) + a * image.at(x0 + 1, y0)) +
         b * ((1 - a) * image.at(x0, y0 + 1) + a * image.at(x0 + 1, y0 + 1));
}

// Largest difference from the double-precision reference over random affine warps; false if none was inside.
double largest_warp_error(Random& random, const GreyView& image, double reference_shift) {
  double worst = 0;
  int inside = 0;
  for (int trial = 0; trial < 300; ++trial) {
    const Vector2f centre(static_cast<float>(random.uniform(0, image.width)),
                          static_cast<float>(random.uniform(0, image.height)));
    Matrix2f J;
    for (int i = 0; i < 4; ++i) J.data()[i] = static_cast<float>(random.uniform(-1.5, 1.5));
    PatchTemplate patch;
    if (!warp_patch(image, centre, J, &patch)) continue;
    ++inside;
    int32_t sum = 0, sum_sq = 0;
    for (int j = -1; j <= kPatchSize; ++j) {
      for (int i = -1; i <= kPatchSize; ++i) {
        const Vector2d at = centre.cast<double>() + J.cast<double>() * Vector2d(i - 3.5, j - 3.5);
        const int value = patch.px[(j + 1) * kPatchFramed + i + 1];
        const double x = std::clamp(at.x() + reference_shift, 0.0, image.width - 1.0);
        worst = std::max(worst, std::abs(value - bilinear(image, x, std::clamp(at.y(), 0.0, image.height - 1.0))));
        if (i >= 0 && j >= 0 && i < kPatchSize && j < kPatchSize) {
          sum += value;
          sum_sq += value * value;
        }
      }
    }
    EXPECT_EQ(patch.sum, sum);
    EXPECT_EQ(patch.sum_sq, sum_sq);
  }
  EXPECT_GT(inside, 50);
  return worst;
}

// Every sum that there can be, by every number of templates, as a division has it.
TEST(TemplateMean, IsRoundedAsADivision) {
  for (int count = 1; count <= TemplateMean::kMost; ++count) {
    PatchTemplate patch;
    for (int sum = 0; sum <= 255 * count; sum += static_cast<int>(sizeof patch.px)) {
      TemplateMean mean;
      for (int n = 0; n < count; ++n) {
        for (int k = 0; k < static_cast<int>(sizeof patch.px); ++k)  // adds up to sum + k, 255 at once
          patch.px[k] = static_cast<uint8_t>(std::clamp(sum + k - 255 * n, 0, 255));
        mean.add(patch);
      }
      mean.write(count, &patch);
      for (int k = 0; k < static_cast<int>(sizeof patch.px) && sum + k <= 255 * count; ++k)
        ASSERT_EQ(patch.px[k], (sum + k + count / 2) / count) << sum + k << " by " << count;
      PatchTemplate added = patch;
      added.sum = added.sum_sq = -1;
      added.add_up();
      ASSERT_EQ(patch.sum, added.sum);
      ASSERT_EQ(patch.sum_sq, added.sum_sq);
    }
  }
}

TEST(PatchWarp, IdentityCopiesPixelsUpToTheBorder) {
  Random random;
  const OwnedImage image = random_image(random, 23, 17, 29);
  for (int y = 1; y + kPatchSize < 17; ++y) {
    for (int x = 1; x + kPatchSize < 23; ++x) {
      const PatchTemplate patch = cut(image.view(), x, y);
      for (int j = 0; j < kPatchFramed; ++j)
        for (int i = 0; i < kPatchFramed; ++i)
          ASSERT_EQ(patch.px[j * kPatchFramed + i], image.view().at(x - 1 + i, y - 1 + j)) << x << " " << y;
    }
  }
}

// A weight is rounded to 1/256, wrong by up to 1/512 along each axis; the result by up to 1/2. With neighbours that
// differ by at most g the error is at most 2 g / 512 + 1/2 + g x 2 x 11 x 2^-16 (position: 1 of the centre, 9 + 1 of
// the steps). For g = 115 that is 0.99, within one grey level; for g = 255, 1.58.
double warp_bound(double g) {
  return 2 * g / 512 + 0.5 + g * 22 / 65536;
}

TEST(PatchWarp, IsWithinOneGreyLevelOfDoublePrecision) {
  Random random;
  const OwnedImage image = OwnedImage(61, 47, 64).fill([&](int, int) { return random.integer(70, 185); });
  EXPECT_LE(warp_bound(185 - 70), 1.0);
  EXPECT_LE(largest_warp_error(random, image.view(), 0), warp_bound(185 - 70));
  // Control: a reference moved by 1/32 px is told apart.
  EXPECT_GT(largest_warp_error(random, image.view(), 1.0 / 32), warp_bound(185 - 70));
}

TEST(PatchWarp, MaxContrastDoesNotOverflow) {
  Random random;
  const OwnedImage checkers = OwnedImage(40, 40).fill([](int x, int y) { return (x + y) % 2 ? 255 : 0; });
  EXPECT_LE(largest_warp_error(random, checkers.view(), 0), warp_bound(255));
  const OwnedImage white = OwnedImage(40, 40).fill([](int, int) { return 255; });
  EXPECT_EQ(largest_warp_error(random, white.view(), 0), 0);
  const PatchTemplate patch = cut(white.view(), 10, 10);
  EXPECT_EQ(patch.sum, 64 * 255);
  EXPECT_EQ(patch.sum_sq, 64 * 255 * 255);
  EXPECT_EQ(patch.energy(), 0);
  EXPECT_EQ(cut(checkers.view(), 10, 10).energy(), 64 * 255 * 255 / 4);
}

TEST(PatchWarp, RefusesSamplesOutside) {
  Random random;
  const OwnedImage image = random_image(random, 20, 16);
  PatchTemplate patch = cut(image.view(), 5, 5);
  const PatchTemplate before = patch;
  const auto refused = [&](float x, float y, const Matrix2f& J) {
    const bool ok = warp_patch(image.view(), Vector2f(x, y), J, &patch);
    EXPECT_EQ(0, std::memcmp(&patch, &before, sizeof(patch))) << "changed although refused";
    return !ok;
  };
  EXPECT_TRUE(refused(4.49f, 8, kIdentity));
  EXPECT_TRUE(refused(14.51f, 8, kIdentity));
  EXPECT_TRUE(refused(8, 4.49f, kIdentity));
  EXPECT_TRUE(refused(8, 10.51f, kIdentity));
  EXPECT_TRUE(refused(9, 8, kIdentity * 2.5f));
  EXPECT_TRUE(refused(9, 8, kIdentity * 1e9f));
  EXPECT_TRUE(refused(1e9f, 8, kIdentity));
  EXPECT_TRUE(refused(kNaN, 8, kIdentity));
  EXPECT_TRUE(refused(9, 8, kIdentity * kNaN));
  EXPECT_FALSE(warp_patch({image.view().data, 1, 16, 20}, Vector2f(0, 8), Matrix2f::Zero(), &patch));
  EXPECT_TRUE(warp_patch(image.view(), Vector2f(4.5f, 4.5f), kIdentity, &patch));
  EXPECT_TRUE(warp_patch(image.view(), Vector2f(14.5f, 10.5f), kIdentity, &patch));
}

// -------------------------------------------------------------------------------------------------------------- search

int32_t naive_zmssd(const GreyView& image, const PatchTemplate& patch, int x, int y) {
  double mean = 0, sum = 0;  // 64ths: exact in double
  for (int r = 0; r < kPatchSize; ++r)
    for (int c = 0; c < kPatchSize; ++c) mean += image.at(x + c, y + r) - patch.px[(r + 1) * kPatchFramed + c + 1];
  mean /= 64;
  for (int r = 0; r < kPatchSize; ++r) {
    for (int c = 0; c < kPatchSize; ++c) {
      const double d = image.at(x + c, y + r) - patch.px[(r + 1) * kPatchFramed + c + 1] - mean;
      sum += d * d;
    }
  }
  return static_cast<int32_t>(std::floor(sum));
}

bool naive_search(const GreyView& image, const PatchTemplate& patch, const Vector2f& predicted, float radius,
                  int32_t max_zmssd, PatchHit* hit) {
  bool found = false;
  hit->candidates = 0;
  hit->zmssd = max_zmssd;
  for (int y = 0; y + kPatchSize <= image.height; ++y) {
    for (int x = 0; x + kPatchSize <= image.width; ++x) {
      const float dx = static_cast<float>(x) - (predicted.x() - kPatchCentre);
      const float dy = static_cast<float>(y) - (predicted.y() - kPatchCentre);
      if (dx * dx + dy * dy > radius * radius) continue;
      ++hit->candidates;
      const int32_t zmssd = naive_zmssd(image, patch, x, y);
      if (found ? zmssd >= hit->zmssd : zmssd > max_zmssd) continue;
      found = true;
      hit->x = x;
      hit->y = y;
      hit->zmssd = zmssd;
    }
  }
  return found;
}

TEST(PatchSearch, EqualsNaiveDoubleLoop) {
  Random random;
  int found = 0, missed = 0, near_border = 0;
  for (int trial = 0; trial < 400; ++trial) {
    const int width = random.integer(8, 40), height = random.integer(8, 40);
    const int contrast = random.integer(0, 3) * 40 + 7;  // weak and strong ones, so that the early out is exercised
    const OwnedImage image = OwnedImage(width, height, width + random.integer(0, 5)).fill([&](int x, int) {
      return 120 + (x % 16 < 8 ? random.integer(-contrast, contrast) : random.integer(-3, 3));
    });
    const OwnedImage source = random_image(random, 10, 10);
    PatchTemplate patch = cut(source.view(), 1, 1);
    if (width > 12 && height > 12 && trial % 2)
      patch = cut(image.view(), random.integer(1, width - 9), random.integer(1, height - 9));
    const Vector2f predicted(static_cast<float>(random.uniform(-3, width + 3)),
                             static_cast<float>(random.uniform(-3, height + 3)));
    const auto radius = static_cast<float>(random.uniform(0, 9));
    const int32_t max_zmssd = trial % 3 ? INT_MAX : random.integer(0, 200000);
    PatchHit hit, naive;
    const bool ok = search_patch(image.view(), patch, predicted, radius, max_zmssd, &hit);
    ASSERT_EQ(ok, naive_search(image.view(), patch, predicted, radius, max_zmssd, &naive));
    ASSERT_EQ(hit.candidates, naive.candidates);
    (ok ? found : missed) += 1;
    near_border += hit.candidates > 0 && hit.candidates < 3 * radius * radius;
    if (!ok) continue;
    ASSERT_EQ(hit.x, naive.x);
    ASSERT_EQ(hit.y, naive.y);
    ASSERT_EQ(hit.zmssd, naive.zmssd);
  }
  EXPECT_GT(found, 100);
  EXPECT_GT(missed, 30);
  EXPECT_GT(near_border, 30);
}

TEST(PatchSearch, FindsThePatchExactlyWithGainOfMean) {
  Random random;
  OwnedImage image = OwnedImage(60, 50).fill([&](int, int) { return random.integer(0, 200); });
  const PatchTemplate patch = cut(image.view(), 31, 22);
  image.fill([&, copy = image](int x, int y) { return copy.view().at(x, y) + 55; });  // a brighter frame
  PatchHit hit;
  ASSERT_TRUE(search_patch(image.view(), patch, Vector2f(36, 24), 4, 0, &hit));
  EXPECT_EQ(hit.x, 31);
  EXPECT_EQ(hit.y, 22);
  EXPECT_EQ(hit.zmssd, 0);
  EXPECT_FALSE(search_patch(image.view(), patch, Vector2f(41, 24), 4, 1000, &hit));  // out of reach
}

TEST(PatchSearch, AmongRepeatsTheFirstInRowMajorOrderWins) {
  Random random;
  const OwnedImage tile = random_image(random, 4, 4);
  const OwnedImage image = OwnedImage(50, 50).fill([&](int x, int y) { return tile.view().at(x % 4, y % 4); });
  const PatchTemplate patch = cut(image.view(), 20, 20);
  PatchHit hit;
  ASSERT_TRUE(search_patch(image.view(), patch, Vector2f(20 + kPatchCentre, 20 + kPatchCentre), 4, 100, &hit));
  EXPECT_EQ(hit.y, 16);  // the circle's topmost position, exactly 4 px away, repeats the pattern
  EXPECT_EQ(hit.x, 20);
  EXPECT_EQ(hit.zmssd, 0);
  ASSERT_TRUE(search_patch(image.view(), patch, Vector2f(20 + kPatchCentre, 20 + kPatchCentre), 3.9f, 100, &hit));
  EXPECT_EQ(hit.y, 20);
  EXPECT_EQ(hit.x, 20);
}

TEST(PatchSearch, MaxContrastDoesNotOverflow) {
  const OwnedImage checkers = OwnedImage(30, 30).fill([](int x, int y) { return (x / 8 + y / 8) % 2 ? 255 : 0; });
  const OwnedImage inverse = OwnedImage(30, 30).fill([](int x, int y) { return (x / 8 + y / 8) % 2 ? 0 : 255; });
  const OwnedImage white = OwnedImage(30, 30).fill([](int, int) { return 255; });
  const OwnedImage black = OwnedImage(30, 30).fill([](int, int) { return 0; });
  PatchHit hit;
  // Half of the patch black, half white, against its inverse: every pixel differs by 255, mean 0.
  ASSERT_TRUE(search_patch(inverse.view(), cut(checkers.view(), 4, 8), Vector2f(7.5f, 11.5f), 0, INT_MAX, &hit));
  EXPECT_EQ(hit.candidates, 1);
  EXPECT_EQ(hit.zmssd, 64 * 255 * 255);
  // Uniform against uniform: only the mean differs, by the most it can.
  ASSERT_TRUE(search_patch(black.view(), cut(white.view(), 8, 8), Vector2f(11.5f, 11.5f), 0, INT_MAX, &hit));
  EXPECT_EQ(hit.zmssd, 0);
  ASSERT_TRUE(search_patch(white.view(), cut(checkers.view(), 4, 8), Vector2f(11.5f, 11.5f), 0, INT_MAX, &hit));
  EXPECT_EQ(hit.zmssd, 64 * 255 * 255 / 4);
}

TEST(PatchSearch, ThresholdIsInclusiveAndOddArgumentsFindNothing) {
  Random random;
  const OwnedImage image = random_image(random, 30, 30);
  const PatchTemplate patch = cut(random_image(random, 10, 10).view(), 1, 1);
  const Vector2f middle(15.5f, 15.5f);
  PatchHit hit;
  ASSERT_TRUE(search_patch(image.view(), patch, middle, 4, INT_MAX, &hit));
  const int32_t best = hit.zmssd;
  EXPECT_TRUE(search_patch(image.view(), patch, middle, 4, best, &hit));
  EXPECT_FALSE(search_patch(image.view(), patch, middle, 4, best - 1, &hit));
  EXPECT_EQ(hit.candidates, 49);  // integer points of a circle of radius 4
  EXPECT_FALSE(search_patch(image.view(), patch, middle, 4, -1, &hit));
  for (const Vector2f& bad : {Vector2f(kNaN, 15), Vector2f(15, kNaN), Vector2f(1e30f, 15), Vector2f(15, -1e30f),
                              Vector2f(200, 15), Vector2f(15, -100)}) {
    hit.candidates = -1;
    EXPECT_FALSE(search_patch(image.view(), patch, bad, 4, INT_MAX, &hit));
    EXPECT_EQ(hit.candidates, 0);
  }
  EXPECT_FALSE(search_patch(image.view(), patch, middle, kNaN, INT_MAX, &hit));
  EXPECT_FALSE(search_patch(image.view(), patch, middle, -1, INT_MAX, &hit));
  EXPECT_FALSE(search_patch({image.view().data, 7, 30, 30}, patch, Vector2f(3, 15), 4, INT_MAX, &hit));
  // Any radius is safe; it is cut to kMaxSearchRadius.
  const OwnedImage large = random_image(random, 120, 110);
  PatchHit cut_hit, naive;
  ASSERT_TRUE(search_patch(large.view(), patch, Vector2f(60, 55), 1e9f, INT_MAX, &cut_hit));
  ASSERT_TRUE(naive_search(large.view(), patch, Vector2f(60, 55), kMaxSearchRadius, INT_MAX, &naive));
  EXPECT_EQ(cut_hit.candidates, naive.candidates);
  EXPECT_EQ(cut_hit.zmssd, naive.zmssd);
}

// ---------------------------------------------------------------------------------------------------------- refinement

struct RefineStatistics {
  int failures = 0;
  double rms = 0;       // px per axis
  double to_bound = 0;  // rms error over the Cramer-Rao bound's, measured in the bound's own metric
  Vector2d bias = Vector2d::Zero();
  double bias_tolerance = 0;  // 4 standard deviations of the mean
  double steps = 0;
  double residual = 0;     // mean of the reported rms difference
  double information = 0;  // reported over true, mean ratio of traces
};

struct RefineCase {
  int trials = test::trials(600);
  double contrast =
      50;  // standard deviation of the texture: gradients of about 20 per px, as at a desk's usual corners
  double noise = 2;
  double max_warp = 0;  // entries of J - 1
  double shift = 0;     // control: the image is not where it is said to be
  int blur_error = 0;   // control: the template claims another blur
};

// Renders a texture twice: as the source, through an affine warp J near the identity, and in the search image at a
// sub-pixel position; adds noise to both; warps, searches and refines.
RefineStatistics measure(Random& random, const RefineCase& c) {
  RefineStatistics s;
  for (int trial = 0; trial < c.trials; ++trial) {
    const Texture texture(random, c.contrast, 0.2, 0.9);  // wavelengths of 7 to 31 px
    Matrix2d J = Matrix2d::Identity();
    for (int i = 0; i < 4; ++i) J.data()[i] += random.uniform(-c.max_warp, c.max_warp);
    const Matrix2d J_inverse = J.inverse();
    Vector2d centre(15.5, 15.5), truth;
    if (c.max_warp > 0)
      for (int i = 0; i < 2; ++i) centre[i] = random.uniform(14, 16);
    for (int i = 0; i < 2; ++i) truth[i] = random.uniform(14, 16);
    const OwnedImage source = OwnedImage(31, 31).fill([&](int x, int y) {
      const Vector2d at = J_inverse * (Vector2d(x, y) - centre);
      return 128 + texture.value(at.x(), at.y()) + c.noise * random.gaussian();
    });
    const OwnedImage image = OwnedImage(31, 31).fill([&](int x, int y) {
      return 128 + texture.value(x - truth.x() - c.shift, y - truth.y()) + c.noise * random.gaussian();
    });
    Matrix2d information = Matrix2d::Zero();
    Vector2d mean = Vector2d::Zero();
    for (int y = 0; y < kPatchSize; ++y) {
      for (int x = 0; x < kPatchSize; ++x) {
        Vector2d g;
        texture.gradient(x - 3.5, y - 3.5, &g.x(), &g.y());
        information += g * g.transpose();
        mean += g;
      }
    }
    information -= mean * mean.transpose() / 64;

    PatchTemplate patch;
    PatchHit hit;
    RefinedPatch refined;
    if (!warp_patch(source.view(), centre.cast<float>(), J.cast<float>(), &patch) ||
        !search_patch(image.view(), patch, (truth + Vector2d(1.3, -0.8)).cast<float>(), 3, INT_MAX, &hit)) {
      ++s.failures;
      continue;
    }
    patch.x_blur += c.blur_error;
    patch.y_blur += c.blur_error;
    const Vector2f start(static_cast<float>(hit.x) + kPatchCentre, static_cast<float>(hit.y) + kPatchCentre);
    if (!refine_patch(image.view(), patch, start, 10, &refined)) {
      ++s.failures;
      continue;
    }
    const Vector2d error = refined.position.cast<double>() - truth;
    s.bias += error;
    s.rms += error.squaredNorm() / 2;
    // Both images carry the noise and the rounding to whole grey levels.
    s.to_bound += error.dot(information * error) / (2 * (c.noise * c.noise + 1.0 / 12)) / 2;
    s.steps += refined.steps;
    s.residual += static_cast<double>(refined.residual);
    s.information += static_cast<double>(refined.information.trace()) / information.trace();
  }
  const int good = c.trials - s.failures;
  s.rms = std::sqrt(s.rms / good);
  s.to_bound = std::sqrt(s.to_bound / good);
  s.bias /= good;
  s.bias_tolerance = 4 * s.rms / std::sqrt(good);
  s.steps /= good;
  s.residual /= good;
  s.information /= good;
  std::printf(
      "contrast %.0f, noise %.0f, warp %.2f: rms %.4f px, %.2f of the bound, bias %.4f %.4f, %.2f steps, "
      "residual %.2f, information %.2f, %d of %d failed\n",
      c.contrast, c.noise, c.max_warp, s.rms, s.to_bound, s.bias.x(), s.bias.y(), s.steps, s.residual, s.information,
      s.failures, c.trials);
  return s;
}

// The bound: no unbiased estimate has a smaller covariance than 2 (sigma^2 + 1/12) H^-1, H the true gradients' 2x2
// information with the mean eliminated. Interpolation averages some of the image's noise away, so the ratio may fall a
// little under 1; 600 trials of 2 axes leave it uncertain by 1 / sqrt(2 x 1200) = 2 %.
TEST(PatchRefine, IsNearTheBoundAtEveryContrast) {
  Random random;
  for (const double contrast : {10.0, 20.0, 50.0}) {
    for (const double warp : {0.0, 0.15}) {
      const RefineStatistics s = measure(random, {.contrast = contrast, .max_warp = warp});
      EXPECT_LE(s.to_bound, 1.3);
      EXPECT_GE(s.to_bound, 0.8);
      EXPECT_LE(s.bias.cwiseAbs().maxCoeff(), s.bias_tolerance);
      if (contrast == 50) {
        EXPECT_LE(s.rms, 0.03);
      }
      EXPECT_LE(s.failures, 6);  // wrong hits among 600; at most 3 were seen, at the lowest contrast
      EXPECT_LE(s.steps, 3.5);
      // Central differences of frequencies w see sin(w) / w of the gradient: at 0.2 to 0.9 rad/px 0.99 to 0.87, squared
      // and weighted by the gradient 0.8 to 0.9; noise adds 2 x sigma^2 / 8 of 1/2 w^2 contrast^2: 4 % at contrast 10.
      EXPECT_NEAR(s.information, 0.85, 0.08);
      // Noise of variance sigma^2 + 1/12 in both images, sqrt(2) x 2.02 = 2.86, if nothing smoothed it. A bilinear mean
      // of random fraction leaves 4/9 of the variance: 1.90 if both are smoothed so, less 2 % for the two parameters
      // fitted and up to 10 % because the mean of roots is taken.
      EXPECT_GT(s.residual, 1.65);
      EXPECT_LT(s.residual, 2.86);
    }
  }
}

TEST(PatchRefine, WithoutNoiseOnlyInterpolationRemains) {
  Random random;
  // Rounding of both images, 2/12 grey^2, over 64 gradients of 20 per px: 0.0026 px. What exceeds it is interpolation.
  const RefineStatistics exact = measure(random, {.noise = 0});
  EXPECT_LE(exact.rms, 0.01);
  EXPECT_LE(exact.bias.cwiseAbs().maxCoeff(), exact.bias_tolerance);
  EXPECT_LE(measure(random, {.noise = 0, .max_warp = 0.15}).rms, 0.02);
  // Control: a template that claims to be blurred by half a pixel is matched worse.
  EXPECT_GT(measure(random, {.noise = 0, .blur_error = 16384}).rms, 0.015);
  // Control: a bias of 0.01 px is seen.
  EXPECT_GT(measure(random, {.noise = 0, .shift = 0.01}).bias.x(), exact.bias_tolerance);
}

TEST(PatchRefine, RefusesDriftFlatPatchesAndBorders) {
  Random random;
  const Texture texture(random, 40, 0.2, 0.5);
  const OwnedImage image = OwnedImage(40, 36, 43).fill([&](int x, int y) { return 128 + texture.value(x, y); });
  const PatchTemplate patch = cut(image.view(), 15, 15);
  RefinedPatch refined;
  const Vector2f truth(18.5f, 18.5f);
  ASSERT_TRUE(refine_patch(image.view(), patch, truth, 10, &refined));
  EXPECT_EQ(refined.position, truth);  // the same pixels: no step at all
  EXPECT_EQ(refined.steps, 1);
  EXPECT_EQ(refined.residual, 0);
  EXPECT_TRUE(refine_patch(image.view(), patch, truth + Vector2f(0.7f, -0.6f), 10, &refined));
  EXPECT_LT((refined.position - truth).norm(), 0.03f);
  EXPECT_FALSE(refine_patch(image.view(), patch, truth + Vector2f(1.8f, 0), 10, &refined));  // the answer is too far
  EXPECT_FALSE(refine_patch(image.view(), patch, truth, 0, &refined));

  // The framed 10x10 must lie inside: the reference point between 4.5 and size - 5.5.
  for (const Vector2f& corner :
       {Vector2f(4.5f, 4.5f), Vector2f(34.5f, 4.5f), Vector2f(4.5f, 30.5f), Vector2f(34.5f, 30.5f)}) {
    const PatchTemplate at_corner =
        cut(image.view(), static_cast<int>(corner.x() - kPatchCentre), static_cast<int>(corner.y() - kPatchCentre));
    EXPECT_TRUE(refine_patch(image.view(), at_corner, corner, 10, &refined));
    EXPECT_EQ(refined.position, corner);
    const Vector2f outwards(corner.x() < 18 ? -0.01f : 0.01f, corner.y() < 18 ? -0.01f : 0.01f);
    EXPECT_FALSE(refine_patch(image.view(), at_corner, corner + outwards, 10, &refined));
  }
  for (const float bad : {kNaN, 1e30f, -1e30f}) {
    EXPECT_FALSE(refine_patch(image.view(), patch, Vector2f(bad, 18), 10, &refined));
    EXPECT_FALSE(refine_patch(image.view(), patch, Vector2f(18, bad), 10, &refined));
  }
  EXPECT_FALSE(refine_patch({image.view().data, 10, 36, 43}, patch, Vector2f(4.5f, 18.5f), 10, &refined));

  const OwnedImage flat = OwnedImage(30, 30).fill([](int, int) { return 90; });
  EXPECT_FALSE(refine_patch(flat.view(), cut(flat.view(), 10, 10), Vector2f(13.5f, 13.5f), 10, &refined));
  const OwnedImage edge =
      OwnedImage(30, 30).fill([](int x, int y) { return 128 + 60 * std::tanh((x + y - 27) / 3.0); });
  EXPECT_FALSE(refine_patch(edge.view(), cut(edge.view(), 10, 10), Vector2f(13.5f, 13.5f), 10, &refined));
}

TEST(PatchRefine, MaxContrastDoesNotOverflow) {
  // Period 4 of 0 0 255 255 along one diagonal in the upper half and the other in the lower: every central difference
  // is
  // +-255, so that both diagonal sums are the largest that 8-bit images can give.
  const OwnedImage image =
      OwnedImage(20, 20).fill([](int x, int y) { return (x + (y < 10 ? y : -y) + 40) % 4 < 2 ? 0 : 255; });
  const PatchTemplate patch = cut(image.view(), 6, 6);
  RefinedPatch refined;
  ASSERT_TRUE(refine_patch(image.view(), patch, Vector2f(9.5f, 9.5f), 1, &refined));
  double xx = 0, yy = 0, x_sum = 0, y_sum = 0;
  for (int y = 6; y < 14; ++y) {
    for (int x = 6; x < 14; ++x) {
      const double gx = (image.view().at(x + 1, y) - image.view().at(x - 1, y)) / 2.0;
      const double gy = (image.view().at(x, y + 1) - image.view().at(x, y - 1)) / 2.0;
      xx += gx * gx;
      yy += gy * gy;
      x_sum += gx;
      y_sum += gy;
    }
  }
  EXPECT_GT(xx * 32 * 32 * 4, INT_MAX);  // two more bits would not fit
  // Exact integers rounded once to float: 2^-24 relative.
  EXPECT_NEAR(refined.information(0, 0), xx - x_sum * x_sum / 64, xx * 0x1p-23);
  EXPECT_NEAR(refined.information(1, 1), yy - y_sum * y_sum / 64, yy * 0x1p-23);

  // The right half inverted: there the residuals are +-255 and J is 0, on the left J is as before and the residuals 0.
  const OwnedImage half = OwnedImage(20, 20).fill(
      [&](int x, int y) { return x < 10 ? image.view().at(x, y) : 255 - image.view().at(x, y); });
  PatchTemplate extreme = cut(half.view(), 6, 6);
  ASSERT_TRUE(refine_patch(image.view(), extreme, Vector2f(9.5f, 9.5f), 1, &refined));
  EXPECT_NEAR(refined.residual, 255 / std::sqrt(2), 1);
  // The largest blur that a template can claim: second differences of +-255 along x and y, each weighted by 1/4.
  extreme.x_blur = extreme.y_blur = 32768;
  ASSERT_TRUE(refine_patch(image.view(), extreme, Vector2f(9.5f, 9.5f), 1, &refined));
  EXPECT_GT(refined.residual, 255 / std::sqrt(2));
  EXPECT_LE(refined.residual, 255 * 1.5);
}

// A patch under a band whose brightness falls by up to 4 % a line: refined with the template's light matched it is
// found as exactly as in steady light, refined without it is not.
TEST(PatchLight, BandsDoNotMoveThePatch) {
  Random random;
  double sum_sq = 0, sum_sq_unmatched = 0;
  constexpr int kTrials = 200;
  for (int trial = 0; trial < kTrials; ++trial) {
    const Texture texture(random, 1, 0.3, 0.9);
    const bool rows = trial % 2 == 0;
    const double slope = random.uniform(-0.04, 0.04);
    const double dx = random.uniform(-0.5, 0.5), dy = random.uniform(-0.5, 0.5);
    const OwnedImage source =
        OwnedImage(40, 40).fill([&](int x, int y) { return 110 + 25 * texture.value(x, y) + random.gaussian(); });
    const OwnedImage lit = OwnedImage(40, 40).fill([&](int x, int y) {
      const double line = (rows ? y : x) - 20.0;
      return (1 + slope * line) * (110 + 25 * texture.value(x - dx, y - dy)) + random.gaussian();
    });
    const PatchTemplate patch = cut(source.view(), 16, 16);
    const Vector2f start(16 + kPatchCentre, 16 + kPatchCentre);
    const Vector2d truth = start.cast<double>() + Vector2d(dx, dy);
    RefinedPatch refined, unmatched;
    Vector2f at = start;
    bool found = true;
    for (int round = 0; round < 2 && found; ++round) {
      PatchTemplate matched = patch;
      match_light(lit.view(), at, rows ? LampLines::kRows : LampLines::kColumns, &matched);
      found = refine_patch(lit.view(), matched, at, 8, &refined);
      at = refined.position;
    }
    if (!found || !refine_patch(lit.view(), patch, start, 8, &unmatched)) continue;
    sum_sq += (refined.position.cast<double>() - truth).squaredNorm() / kTrials;
    sum_sq_unmatched += (unmatched.position.cast<double>() - truth).squaredNorm() / kTrials;
  }
  std::printf("under bands: %.3f px rms, unmatched %.3f\n", std::sqrt(sum_sq), std::sqrt(sum_sq_unmatched));
  EXPECT_LT(std::sqrt(sum_sq), 0.2);
  EXPECT_GT(sum_sq_unmatched, 4 * sum_sq);  // control
}

TEST(PatchGolden, HashOfWarpSearchAndRefinement) {
  const auto hash = [](const GreyView& image) {
    test::Fnv fnv;
    for (int y = 12; y + 20 < image.height; y += 9) {
      for (int x = 12; x + 20 < image.width; x += 7) {
        Matrix2f J;
        J << 1.0f, 0.125f * static_cast<float>(x % 3), -0.0625f * static_cast<float>(y % 5), 0.875f;
        const Vector2f centre(static_cast<float>(x) + 0.375f, static_cast<float>(y) + 0.8125f);
        PatchTemplate patch;
        PatchHit hit;
        RefinedPatch refined;
        if (!warp_patch(image, centre, J, &patch)) continue;
        fnv.add(patch.px, sizeof(patch.px));
        fnv.add_value(patch.x_blur);
        fnv.add_value(patch.y_blur);
        if (!search_patch(image, patch, centre + Vector2f(1, -2), 4, INT_MAX, &hit)) continue;
        fnv.add_value(hit.x);
        fnv.add_value(hit.y);
        fnv.add_value(hit.zmssd);
        const Vector2f start(static_cast<float>(hit.x) + kPatchCentre, static_cast<float>(hit.y) + kPatchCentre);
        if (!refine_patch(image, patch, start, 8, &refined)) continue;
        fnv.add_value(refined.position.x());
        fnv.add_value(refined.position.y());
        fnv.add_value(refined.residual);
        fnv.add(refined.information.data(), 4 * sizeof(float));
      }
    }
    return fnv.value();
  };
  OwnedImage image = golden_image(97, 83);
  constexpr uint64_t kExpected = 0x95e183d4c94e448u;
  EXPECT_EQ(hash(image.view()), kExpected);
  image.image().at(50, 40) ^= 1;  // control
  EXPECT_NE(hash(image.view()), kExpected);
}

}  // namespace
}  // namespace pptam
