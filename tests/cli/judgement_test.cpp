// The judge of the suite's runs: runs with known faults go in, the same faults must come out.
#include "sim_phone/laboratory/judgement.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <set>

#include "platform/run/statistics.h"
#include "sim_phone/laboratory/suite.h"
#include "tests/support/random.h"

namespace pptam::laboratory {
namespace {

using Eigen::AngleAxisd;
using Eigen::Vector3d;
using platform::FrameLog;
using platform::percentile;
using platform::RunLog;

constexpr double kDegree = std::numbers::pi / 180;
constexpr int kFrames = 300;
constexpr int64_t kFrameNs = 66'666'667;

// A hand about half a metre wide, at rest from frame to_rest on.
Eigen::Isometry3d true_pose(int i, int to_rest = kFrames) {
  const double t = 0.03 * std::min(i, to_rest);
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.translation() = Vector3d(0.25 * std::sin(t), 0.2 * std::cos(0.7 * t), 1 + 0.05 * std::sin(1.3 * t));
  T.linear() = AngleAxisd(0.2 * std::sin(t), Vector3d::UnitX()).toRotationMatrix();
  return T;
}

// A run that starts at frame 30 and tracks everything, in a world of another unit and place.
constexpr double kScale = 0.2;  // of the estimate's world, units a metre

struct EmulatedRun {
  RunLog log;
  platform::Trajectory truth;
  sim::Story story;

  explicit EmulatedRun(int to_rest = kFrames) {
    story.move_s = 1;
    for (int i = 0; i < kFrames; ++i) {
      truth.push_back({i * kFrameNs, true_pose(i, to_rest)});
      FrameLog frame;
      frame.timestamp_ns = i * kFrameNs;
      if (i >= 30) {
        frame.state = TrackingState::kTracking;
        frame.quality = TrackingQuality::kGood;
        frame.pose_valid = true;
        frame.instructions = 2'000'000 + 1000 * i;
      }
      log.frames.push_back(frame);
    }
    for (int i = 30; i < kFrames; ++i) set_pose(i, truth[static_cast<size_t>(i)].T_wc);
  }
  FrameLog& frame(int i) { return log.frames[static_cast<size_t>(i)]; }
  void set_pose(int i, const Eigen::Isometry3d& T_wc) {
    frame(i).T_wc = T_wc;
    frame(i).T_wc.translation() = kScale * T_wc.translation() + Vector3d(1, 2, 3);
  }
  void lose(int from, int to) {
    for (int i = from; i < to; ++i) {
      frame(i).pose_valid = false;
      frame(i).state = TrackingState::kLost;
    }
  }
  void spoil(int from, int to, TrackingQuality quality) {
    for (int i = from; i < to; ++i) {
      frame(i).T_wc.translation().x() += 0.5 * kScale;
      frame(i).quality = quality;
    }
  }
  Judgement judged() const { return judge(log, truth, story, 0.09); }
};

TEST(Judge, APerfectRun) {
  const Judgement j = EmulatedRun().judged();
  EXPECT_TRUE(j.initialised);
  EXPECT_NEAR(j.initialised_s, 30 / 15.0 - 1, 1e-6);
  EXPECT_EQ(j.expected, 270);
  EXPECT_EQ(j.tracked, 270);
  EXPECT_EQ(j.poses, 270);
  EXPECT_EQ(j.wrong, 0);
  EXPECT_EQ(j.false_relocalisations, 0);
  EXPECT_EQ(j.losses, 0);
  EXPECT_LT(j.ate_percent, 1e-6);
  EXPECT_EQ(j.minstructions.size(), 270u);
  EXPECT_NEAR(percentile(j.minstructions, 0.5), 2.165, 0.001);
  EXPECT_TRUE(std::isnan(j.jitter_mm) && std::isnan(j.lag_frames) && std::isnan(j.recovery_s));
}

TEST(Judge, ARunThatNeverBegan) {
  EmulatedRun run;
  run.lose(0, kFrames);
  const Judgement j = run.judged();
  EXPECT_FALSE(j.initialised);
  EXPECT_TRUE(std::isnan(j.tracked_percent()) && std::isnan(j.ate_percent));
}

TEST(Judge, LossesAtAKnownViewCountUntilARightPose) {
  EmulatedRun run;
  run.lose(100, 110);  // the view moves 25 cm/s at most and is never far from where it was
  Judgement j = run.judged();
  EXPECT_EQ(j.expected, 270);
  EXPECT_EQ(j.tracked, 260);
  EXPECT_EQ(j.losses, 1);
  EXPECT_EQ(j.recovered, 1);
  EXPECT_NEAR(j.recovery_s, 10 / 15.0, 0.01);
  EXPECT_EQ(j.false_relocalisations, 0);

  run.spoil(110, 120, TrackingQuality::kPoor);  // found again, but wrongly
  j = run.judged();
  EXPECT_EQ(j.wrong, 10);
  EXPECT_EQ(j.wrong_good, 0);
  EXPECT_EQ(j.false_relocalisations, 1);
  EXPECT_EQ(j.losses, 1);
  EXPECT_EQ(j.recovered, 0) << "a right pose came after 1.3 s";
  EXPECT_NEAR(j.recovery_s, 20 / 15.0, 0.01);

  EmulatedRun never;
  never.lose(250, kFrames);
  j = never.judged();
  EXPECT_EQ(j.losses, 1);
  EXPECT_EQ(j.recovered, 0);
  EXPECT_TRUE(std::isnan(j.recovery_s));
  EmulatedRun too_late;
  too_late.lose(290, kFrames);
  EXPECT_EQ(too_late.judged().losses, 0) << "the run ends before it can be told";
}

TEST(Judge, AViewIsNotBackWhileSomethingIsInTheWay) {
  EmulatedRun run;
  run.lose(100, 117);  // 1.13 s
  EXPECT_EQ(run.judged().recovered, 0);
  run.story.obstructed = {{95 / 15.0, 105 / 15.0}};
  const Judgement j = run.judged();
  EXPECT_EQ(j.losses, 1);
  EXPECT_EQ(j.recovered, 1);
  EXPECT_NEAR(j.recovery_s, 11 / 15.0, 0.01);  // from frame 106, the first that sees nothing of it
  EXPECT_EQ(j.expected, 270) << "tracking is expected all the same";
}

TEST(Judge, WrongPosesReportedAsGood) {
  EmulatedRun run;
  run.spoil(200, 220, TrackingQuality::kGood);
  run.spoil(220, 230, TrackingQuality::kPoor);
  const Judgement j = run.judged();
  EXPECT_EQ(j.wrong, 30);
  EXPECT_EQ(j.wrong_good, 20);
  EXPECT_NEAR(j.wrong_good_percent(), 100 * 20 / 270.0, 1e-9);
  EXPECT_EQ(j.false_relocalisations, 0) << "it was never lost";
}

TEST(Judge, AScaleJumpIsWrongFromThereOn) {
  EmulatedRun run;
  for (int i = 200; i < kFrames; ++i) {
    Eigen::Isometry3d T = true_pose(i);
    const Vector3d from = true_pose(200).translation();
    T.translation() = from + 2.5 * (T.translation() - from);
    run.set_pose(i, T);
  }
  const Judgement j = run.judged();
  EXPECT_GT(j.wrong, 60);
  EXPECT_LE(j.wrong, 100) << "the part before it is right";
}

TEST(Judge, DeliberateLossesAreNotExpectedAndHaveASecond) {
  EmulatedRun run;
  run.story.lost = {{100 / 15.0, 120 / 15.0}};
  run.lose(101, 125);
  Judgement j = run.judged();
  // Frames that see a part of it: 0.045 s before and after; 100 to 120.
  EXPECT_EQ(j.expected, 270 - 21);
  EXPECT_EQ(j.tracked, 270 - 21 - 4);
  EXPECT_EQ(j.losses, 1);
  EXPECT_EQ(j.recovered, 1);
  EXPECT_NEAR(j.recovery_s, 5 / 15.0 - 0.045, 0.01);
  run.lose(101, 140);
  j = run.judged();
  EXPECT_EQ(j.losses, 1) << "not one more";
  EXPECT_EQ(j.recovered, 0);
}

TEST(Judge, JitterAndLagOfAStandstill) {
  test::Random random;
  constexpr int kRest = 100;  // frame; the step is at frame 250
  EmulatedRun run(kRest);
  sim::Standstill still;
  still.from_s = kRest / 15.0;
  still.step_from_s = 250 / 15.0;
  still.step_to_s = 253 / 15.0;
  run.story.standstill = still;
  Eigen::Isometry3d stepped = true_pose(kRest);
  stepped.translation() += Vector3d(0.05, 0, 0);
  stepped.linear() = stepped.linear() * AngleAxisd(5 * kDegree, Vector3d::UnitY()).toRotationMatrix();
  for (int i = 253; i < kFrames; ++i) run.truth[static_cast<size_t>(i)].T_wc = stepped;
  constexpr double kNoise_m = 0.0002, kTurn = 0.02 * kDegree;
  constexpr int kLag = 3;
  for (int i = kRest; i < kFrames; ++i) {
    Eigen::Isometry3d T = i < 253 + kLag ? true_pose(kRest) : stepped;
    const Vector3d turn = kTurn * Vector3d(random.gaussian(), random.gaussian(), random.gaussian());
    T.translation() += kNoise_m * Vector3d(random.gaussian(), random.gaussian(), random.gaussian());
    T.linear() = T.linear() * AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix();
    run.set_pose(i, T);
    run.frame(i).position_sigma = kScale * 0.5 * kNoise_m * std::sqrt(3.0);  // half of the truth
    run.frame(i).rotation_sigma = kTurn * std::sqrt(3.0);
  }
  const Judgement j = run.judged();
  // 135 frames of three axes: the rms is known within 1 / sqrt(2 * 405) = 3.5 %; four of them.
  EXPECT_NEAR(j.jitter_mm / (1000 * kNoise_m * std::sqrt(3.0)), 1, 0.14);
  EXPECT_NEAR(j.jitter_deg / (0.02 * std::sqrt(3.0)), 1, 0.14);
  EXPECT_NEAR(j.jitter_mm_ratio, 2, 0.28);
  EXPECT_NEAR(j.jitter_deg_ratio, 1, 0.14);
  EXPECT_EQ(j.lag_frames, kLag);
  EXPECT_LE(j.wrong, kLag) << "the late ones are 5 degrees off";

  for (int i = 253; i < kFrames; ++i) run.frame(i).T_wc = run.frame(250).T_wc;  // frozen for ever
  EXPECT_TRUE(std::isnan(run.judged().lag_frames));
}

TEST(Suite, ShardsCoverEveryRunOnce) {
  for (const size_t runs : {1u, 7u, 80u}) {
    for (const int count : {1, 2, 3, 8}) {
      std::multiset<size_t> all;
      for (int number = 1; number <= count; ++number) {
        for (const size_t i : runs_of({number, count}, runs)) all.insert(i);
      }
      EXPECT_EQ(all.size(), runs);
      EXPECT_EQ(std::set<size_t>(all.begin(), all.end()).size(), runs);
      EXPECT_EQ(*all.rbegin(), runs - 1);
    }
  }
  EXPECT_EQ(parse_shard("2/3").number, 2);
  EXPECT_EQ(parse_shard("2/3").count, 3);
  for (const char* bad : {"", "2", "0/4", "3/2", "1/0", "-1/2", "1/2 ", "a/b", "1/2/3"}) {
    EXPECT_THROW(parse_shard(bad), platform::InputError) << bad;
  }
}

}  // namespace
}  // namespace pptam::laboratory
