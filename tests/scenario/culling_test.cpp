// Keyframe culling in use: exploring with few keyframes, and a life of minutes. Heavier: `pocket-ptam sim --study
// culling` and `--endurance 60 --twice`.
#include <gtest/gtest.h>

#include <algorithm>
#include <string>
#include <tuple>

#include "platform/run/evaluation.h"
#include "platform/run/run.h"
#include "sim_phone/laboratory/endurance.h"
#include "tests/support/recording.h"

namespace pptam {
namespace {

using platform::RunLog;

test::Recording explore(const std::string& scene, uint64_t seed) {
  sim::PhoneOptions options;
  options.scene = scene;
  options.seed = seed;
  options.duration_s = 20;
  return test::record(options);
}

RunLog run(const test::Recording& recording, int max_keyframes, int max_erased_keyframes) {
  test::Replay camera(recording);
  platform::RunOptions options;
  options.max_keyframes = max_keyframes;
  options.max_erased_keyframes = max_erased_keyframes;
  return platform::run_sequence(
      camera, options, [](const platform::CameraInfo&) {},
      [&](const Frame&, const TrackResult& result, const RunLog&) {
        EXPECT_TRUE(result.status.ok());
        EXPECT_LE(result.keyframes, max_keyframes);
        EXPECT_LE(result.erased_keyframes, max_erased_keyframes + 1);  // one is chosen in slices
      });
}

class Exploring : public ::testing::TestWithParam<std::tuple<const char*, uint64_t>> {};

TEST_P(Exploring, WithTwelveKeyframesStaysWholeAndTrue) {
  const test::Recording recording = explore(std::get<0>(GetParam()), std::get<1>(GetParam()));
  for (const int most_erased : {30, 2, 0}) {
    const RunLog log = run(recording, 12, most_erased);
    ASSERT_NE(log.first_tracked(), nullptr);
    EXPECT_EQ(log.keyframes.size(), 12u);
    EXPECT_EQ(log.map_parts, 1) << "never split";
    EXPECT_GT(log.tracked_fraction(), 0.95) << most_erased;
    int erased = 0;
    for (const platform::FrameLog& frame : log.frames) erased = std::max(erased, frame.erased_keyframes);
    EXPECT_GE(erased, std::min(most_erased, 2));
    // Right poses throughout; as a root mean square three times better than a wrong one, as in system_test.cpp.
    const platform::Evaluation evaluation = platform::evaluate(log.trajectory(), recording.truth, "run", "truth");
    EXPECT_EQ(evaluation.wrong_poses, 0) << most_erased;
    EXPECT_LT(evaluation.ate_rmse, evaluation.extent / 30) << most_erased;
    // The same bits in the same run.
    if (most_erased == 2) {
      EXPECT_EQ(run(recording, 12, most_erased).map_hash, log.map_hash);
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Scenes, Exploring,
                         ::testing::Values(std::tuple("desk", 1), std::tuple("boxes", 1), std::tuple("walls", 1)));

// Of four keyframes none can be spared: the datum, the two newest, and one that many points need.
TEST(FullMap, SaysSo) {
  const test::Recording recording = explore("walls", 1);
  const auto full = [](const RunLog& log) {
    return std::any_of(log.frames.begin(), log.frames.end(),
                       [](const platform::FrameLog& frame) { return (frame.limits_hit & kLimitKeyframes) != 0; });
  };
  const RunLog log = run(recording, 3, 10);
  EXPECT_TRUE(full(log));
  EXPECT_EQ(log.keyframes.size(), 3u);
  EXPECT_FALSE(full(run(recording, 35, 10)));
}

TEST(Endurance, FourMinutesAreNoBurden) {
  laboratory::EnduranceOptions options;
  options.minutes = 4;
  const laboratory::EnduranceReport report = laboratory::endure(options, true);
  for (const std::string& fault : report.faults) ADD_FAILURE() << fault;
  ASSERT_EQ(report.minutes.size(), 4u);
  EXPECT_EQ(report.map_parts, 1);
  EXPECT_GT(report.minutes[1].erased_keyframes, 0);
  int losses = 0, recovered = 0;
  for (size_t m = 1; m < report.minutes.size(); ++m) {
    const laboratory::EnduranceMinute& minute = report.minutes[m];
    EXPECT_GT(minute.tracked, 0.95 * minute.expected) << m;
    EXPECT_LE(minute.keyframes, 35);
    EXPECT_LE(minute.erased_keyframes, 36);
    EXPECT_NE(minute.map_hash, 0u);
    losses += minute.losses;
    recovered += minute.recovered;
  }
  EXPECT_EQ(losses, 2) << "a view was covered or changed";
  EXPECT_EQ(recovered, losses);
}

}  // namespace
}  // namespace pptam
