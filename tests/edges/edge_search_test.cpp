// The edge search: where an edge lies, at every angle; the ranges promised; what is remembered.
#include "edges/edge_search.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "tests/support/random.h"

namespace pptam {
namespace {

constexpr int kSize = 64;

struct Picture {
  std::vector<uint8_t> px = std::vector<uint8_t>(kSize * kSize);
  GreyView view() const { return {px.data(), kSize, kSize, kSize}; }
};

// An edge through `at` with the given normal: `low` before it and `high` beyond. As in a camera each pixel is the mean
// light of 16x16 points, encoded by a gamma of 2.
Picture edge_picture(const Vector2f& at, const Vector2f& normal, float low, float high) {
  Picture picture;
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) {
      int beyond = 0;
      for (int k = 0; k < 256; ++k) {
        const Vector2f p(static_cast<float>(x) + (static_cast<float>(k % 16) - 7.5f) / 16,
                         static_cast<float>(y) + (static_cast<float>(k / 16) - 7.5f) / 16);
        beyond += normal.dot(p - at) > 0;
      }
      picture.px[static_cast<size_t>(y * kSize + x)] = static_cast<uint8_t>(
          std::lround(std::sqrt(low * low + (high * high - low * low) * static_cast<float>(beyond) / 256)));
    }
  }
  return picture;
}

TEST(EdgeSearch, FindsAnEdgeWhereItIs) {
  test::Random random;
  double sum_sq = 0;
  const int trials = test::trials(300);
  for (int trial = 0; trial < trials; ++trial) {
    const float angle = static_cast<float>(random.uniform(0, 6.2831853));
    const Vector2f normal(std::cos(angle), std::sin(angle));
    const float offset = static_cast<float>(random.uniform(-4, 4));
    const Vector2f from(32, 31.5f);
    const Picture picture = edge_picture(from + offset * normal, normal, 50, 150);
    constexpr int kRange = 5;
    ASSERT_TRUE(profile_inside(picture.view(), from, normal, kRange + kMatchHalf));
    int16_t profile[kMaxProfile];
    sample_profile(picture.view(), from, normal, kRange + kMatchHalf, profile);
    EdgeCandidate found[kMaxCandidates];
    ASSERT_EQ(find_edges(profile, kRange, SiteMemory(), found), 1) << trial;
    // A parabola through a step's responses 1 3 3 1 is off by up to 0.13 px; the image's own sampling adds to that.
    EXPECT_NEAR(found[0].offset, offset, 0.2f) << trial;
    sum_sq += static_cast<double>((found[0].offset - offset) * (found[0].offset - offset));
    EXPECT_NEAR(found[0].likelihood, 100.0f / 110, 0.03f) << "of 100 grey values' contrast";
  }
  // Evenly between -0.13 and 0.13 the rms would be 0.075; that of 30 trials, on ARM, is good to a seventh.
  EXPECT_LT(std::sqrt(sum_sq / trials), 0.1);
}

TEST(EdgeSearch, StaysWithinItsRanges) {
  test::Random random;
  int largest = 0, steepest = 0;
  for (int trial = 0; trial < 300; ++trial) {
    Picture picture;
    for (uint8_t& px : picture.px) px = trial == 0 || random.uniform(0, 1) < 0.5 ? 255 : 0;
    const float angle = static_cast<float>(random.uniform(0, 6.2831853));
    int16_t profile[kMaxProfile];
    constexpr int kHalf = kMaxRange + kMatchHalf;
    sample_profile(picture.view(), Vector2f(32, 32), Vector2f(std::cos(angle), std::sin(angle)), kHalf, profile);
    for (int i = 0; i <= 2 * kHalf; ++i) {
      ASSERT_GE(profile[i], 0);
      largest = std::max<int>(largest, profile[i]);
    }
    for (int i = 2; i <= 2 * kHalf - 2; ++i) steepest = std::max(steepest, std::abs(convolution(profile, i)));
  }
  EXPECT_EQ(largest, 12240) << "white gives the largest value";
  EXPECT_LE(steepest, 36720);
  EXPECT_GT(steepest, 12240);
}

// By hand or not, in all directions, at all fractions of a pixel, noise as well as black and white.
TEST(EdgeSearch, EveryFormGivesThePlainOnesBits) {
  test::Random random;
  for (int trial = 0; trial < test::trials(3000); ++trial) {
    Picture picture;
    for (uint8_t& px : picture.px) {
      const int noise = random.integer(0, 255);
      px = static_cast<uint8_t>(trial % 2 == 0 ? noise : (noise & 1) * 255);
    }
    const float angle = static_cast<float>(random.uniform(0, 6.2831853));
    const Vector2f normal(std::cos(angle), std::sin(angle));
    const Vector2f at(static_cast<float>(random.uniform(20, 43)), static_cast<float>(random.uniform(20, 43)));
    const int half = random.integer(1, 17);
    if (!profile_inside(picture.view(), at, normal, half)) continue;
    int16_t profile[kMaxProfile], specified[kMaxProfile];
    sample_profile(picture.view(), at, normal, half, profile);
    plain::sample_profile(picture.view(), at, normal, half, specified);
    for (int i = 0; i <= 2 * half; ++i) ASSERT_EQ(profile[i], specified[i]) << trial;
    picture.px[static_cast<size_t>(std::lround(at.y()) * kSize + std::lround(at.x()))] ^= 255;
    plain::sample_profile(picture.view(), at, normal, half, specified);
    EXPECT_FALSE(std::equal(profile, profile + 2 * half + 1, specified)) << "the comparison must see a pixel";
  }
}

// Whatever profile_inside() allows is read within the image: rows before and after would be seen by the sanitizer, and
// a value of another grey here.
TEST(EdgeSearch, ReadsOnlyTheImage) {
  test::Random random;
  std::vector<uint8_t> memory(3 * kSize * kSize, 255);
  GreyView image{memory.data() + kSize * kSize, kSize / 2, kSize, kSize};
  for (int y = 0; y < kSize; ++y)
    for (int x = 0; x < kSize / 2; ++x) memory[static_cast<size_t>(kSize * kSize + y * kSize + x)] = 0;
  int inside = 0;
  for (int trial = 0; trial < 20000; ++trial) {
    const float angle = static_cast<float>(random.uniform(0, 6.2831853));
    const Vector2f normal(std::cos(angle), std::sin(angle));
    const Vector2f px(static_cast<float>(random.uniform(0, kSize / 2)), static_cast<float>(random.uniform(0, kSize)));
    const int half = random.integer(1, 17);
    if (!profile_inside(image, px, normal, half)) continue;
    ++inside;
    int16_t profile[kMaxProfile];
    sample_profile(image, px, normal, half, profile);
    for (int i = 0; i <= 2 * half; ++i) ASSERT_EQ(profile[i], 0) << trial;
  }
  EXPECT_GT(inside, 1000);
}

TEST(EdgeSearch, RemembersWhatASiteHasShown) {
  test::Random random;
  int16_t shown[kMatchSize], other[kMatchSize];
  for (int trial = 0; trial < 100; ++trial) {
    SiteMemory memory;
    for (int k = 0; k < kMatchSize; ++k) {
      shown[k] = static_cast<int16_t>(random.integer(1000, 6000));
      other[k] = static_cast<int16_t>(random.integer(1000, 6000));
    }
    EXPECT_EQ(likeness(shown, kMatchHalf, memory).shape, kUnknown) << "nothing is remembered";
    learn(shown, kMatchHalf, &memory);
    EXPECT_NEAR(likeness(shown, kMatchHalf, memory).shape, 1, 1e-5);
    int16_t brighter[kMatchSize], inverse[kMatchSize];
    for (int k = 0; k < kMatchSize; ++k) {
      brighter[k] = static_cast<int16_t>(shown[k] / 2 + 700);
      inverse[k] = static_cast<int16_t>(7000 - shown[k]);
    }
    EXPECT_GT(likeness(brighter, kMatchHalf, memory).shape, 0.99f) << "of other light";
    EXPECT_NEAR(likeness(brighter, kMatchHalf, memory).contrast, 0.5f, 0.01f);
    EXPECT_EQ(likeness(inverse, kMatchHalf, memory).shape, 0) << "of the other polarity";
    for (int k = 0; k < 30; ++k) learn(other, kMatchHalf, &memory);
    EXPECT_GT(likeness(other, kMatchHalf, memory).shape, 0.99f) << "it learns anew";
  }
}

TEST(EdgeSearch, TheLikeliestEdgeIsTheRememberedOne) {
  const Vector2f normal(1, 0), from(32, 32);
  // A weak edge at +3 and a strong one of the other polarity at -2.
  Picture picture = edge_picture(from + 3.2f * normal, normal, 100, 130);
  for (int y = 0; y < kSize; ++y)
    for (int x = 0; x < 30; ++x) picture.px[static_cast<size_t>(y * kSize + x)] = 240;
  constexpr int kRange = 5;
  int16_t profile[kMaxProfile];
  sample_profile(picture.view(), from, normal, kRange + kMatchHalf, profile);
  EdgeCandidate found[kMaxCandidates];
  ASSERT_GE(find_edges(profile, kRange, SiteMemory(), found), 2);
  EXPECT_NEAR(found[0].offset, -2.5f, 0.3f) << "the strongest, when nothing is known";
  const EdgeCandidate weak = found[1];
  EXPECT_NEAR(weak.offset, 3.2f, 0.3f);
  SiteMemory memory;
  learn(profile, weak.index, &memory);
  ASSERT_GE(find_edges(profile, kRange, memory, found), 2);
  EXPECT_EQ(found[0].index, weak.index);
}

TEST(EdgeSearch, PlainAndNoisyProfilesHaveNoEdge) {
  int16_t profile[kMaxProfile];
  std::fill(std::begin(profile), std::end(profile), int16_t{3000});
  EdgeCandidate found[kMaxCandidates];
  EXPECT_EQ(find_edges(profile, kMaxRange, SiteMemory(), found), 0);
  for (int i = 0; i < kMaxProfile; ++i) profile[i] = static_cast<int16_t>(3000 + (i % 2) * 40);
  EXPECT_EQ(find_edges(profile, kMaxRange, SiteMemory(), found), 0);
}

}  // namespace
}  // namespace pptam
