// Frames that do not fit the map: told from the usual noise, and learnt when they last.

#include "tracking/frame_fit.h"

#include <gtest/gtest.h>

#include "tests/support/random.h"

namespace pptam {
namespace {

constexpr float kFrame_s = 1.0f / 15;

TEST(FrameFit, UsualFramesFitWhateverTheCamera) {
  test::Random random;
  for (const float usual_px : {0.1f, 0.4f}) {
    FrameFit fit;
    for (int i = 0; i < 600; ++i) {
      // Within 25 % of the usual value: from the smallest to the largest by 1.67, under the limit of 1.7 whatever the
      // first frame was.
      EXPECT_TRUE(fit.fits(usual_px * static_cast<float>(random.uniform(0.75, 1.25)), kFrame_s, 1))
          << usual_px << " " << i;
    }
  }
}

TEST(FrameFit, AJumpDoesNotFitAndTheOldOnesDoAfterwards) {
  FrameFit fit;
  for (int i = 0; i < 30; ++i) fit.fits(0.2f, kFrame_s, 1);
  for (int i = 0; i < 30; ++i) EXPECT_FALSE(fit.fits(0.6f, kFrame_s, 1)) << i;  // 2 s
  for (int i = 0; i < 30; ++i) EXPECT_TRUE(fit.fits(0.2f, kFrame_s, 1)) << i;
}

TEST(FrameFit, WhatIsMadeInAMisfitIsDoubtedUntilItIsOver) {
  FrameFit fit;
  for (uint32_t id = 1; id <= 30; ++id) fit.fits(0.2f, kFrame_s, id);
  EXPECT_EQ(fit.doubted_since(), 0u);
  for (uint32_t id = 31; id <= 45; ++id) {  // a second
    fit.fits(0.6f, kFrame_s, id);
    EXPECT_EQ(fit.doubted_since(), 31u);
  }
  for (uint32_t id = 46; id <= 59; ++id) fit.fits(0.2f, kFrame_s, id);
  EXPECT_EQ(fit.doubted_since(), 31u) << "it has not fitted for as long";
  for (uint32_t id = 60; id <= 61; ++id) fit.fits(0.2f, kFrame_s, id);
  EXPECT_EQ(fit.doubted_since(), 0u);
  fit.fits(0.6f, kFrame_s, 62);
  EXPECT_EQ(fit.doubted_since(), 62u);
  for (uint32_t id = 63; id <= 63 + 45; ++id) fit.fits(0.6f, kFrame_s, id);
  EXPECT_EQ(fit.doubted_since(), 0u) << "what lasts has become usual";
}

TEST(FrameFit, TellsWhatIsUsualWithoutLearning) {
  FrameFit fit;
  EXPECT_TRUE(fit.is_usual(100)) << "nothing is known";
  for (int i = 0; i < 30; ++i) fit.fits(0.2f, kFrame_s, 1);
  for (int i = 0; i < 100; ++i) {
    EXPECT_TRUE(fit.is_usual(0.49f));  // 2.5 times at most
    EXPECT_FALSE(fit.is_usual(0.51f));
  }
  EXPECT_EQ(fit.doubted_since(), 0u);
}

TEST(FrameFit, SlowChangesAreFollowedAtAnyFrameRate) {
  for (const float frame_s : {1.0f / 60, 1.0f / 15}) {
    FrameFit slow, quick;
    bool all_fit = true, all_fit_quick = true;
    for (float t_s = 0; t_s < 20; t_s += frame_s) {
      all_fit &= slow.fits(0.2f * (1 + 0.1f * t_s), frame_s, 1);  // 10 % a second at most: slower than what is learnt
      all_fit_quick &= quick.fits(0.2f * (1 + 1.2f * t_s), frame_s, 1);  // 2.5 times what is learnt after 1.8 s
    }
    EXPECT_TRUE(all_fit) << frame_s;
    EXPECT_FALSE(all_fit_quick) << frame_s;
  }
}

TEST(FrameFit, WhatLastsBecomesUsual) {
  FrameFit fit;
  for (int i = 0; i < 30; ++i) fit.fits(0.2f, kFrame_s, 1);
  int refused = 0;
  while (refused < 1000 && !fit.fits(0.6f, kFrame_s, 1)) ++refused;
  EXPECT_NEAR(static_cast<float>(refused) * kFrame_s, 3.0f, 2 * kFrame_s);
}

TEST(FrameFit, APauseTeachesNothing) {
  for (const float before_px : {0.19f, 0.21f}) {
    FrameFit fit;
    for (int i = 0; i < 30; ++i) fit.fits(0.2f, kFrame_s, 1);
    EXPECT_TRUE(fit.fits(before_px, 3600, 1)) << "an hour's pause";
    EXPECT_FALSE(fit.fits(0.6f, kFrame_s, 1)) << "usual is still 0.2";
    EXPECT_TRUE(fit.fits(0.2f, kFrame_s, 1));
    EXPECT_FALSE(fit.fits(0.6f, 3600, 1));
    EXPECT_FALSE(fit.fits(0.6f, kFrame_s, 1)) << "one frame after a pause is not a misfit that lasts";
  }
}

TEST(FrameFit, APerfectFirstFrameDoesNotBlockTheMap) {
  FrameFit fit;
  int refused = 0;
  for (int i = 0; i < 60; ++i) refused += !fit.fits(i == 0 ? 0.0f : 0.2f, kFrame_s, 1);
  EXPECT_EQ(refused, 0);  // nothing is learnt from a residual of zero
}

}  // namespace
}  // namespace pptam
