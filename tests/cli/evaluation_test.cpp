// The judge itself: known errors go in, the same errors must come out.
#include "platform/run/evaluation.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>
#include <string>

#include "platform/camera.h"
#include "tests/support/random.h"

namespace pptam::platform {
namespace {

using Eigen::AngleAxisd;
using Eigen::Matrix3d;
using Eigen::Vector3d;
using platform::InputError;
using platform::StampedPose;
using platform::Trajectory;

constexpr double kRadians = std::numbers::pi / 180;
constexpr int64_t kFrameNs = 50'000'000;  // 20 Hz

// A hand's path: about one unit wide, curved in all directions, the camera turning a little.
StampedPose wavy_pose(double seconds, int64_t timestamp_ns) {
  StampedPose pose;
  pose.timestamp_ns = timestamp_ns;
  pose.T_wc.translation() =
      Vector3d(0.5 * std::sin(seconds), 0.3 * std::cos(0.7 * seconds), 1 + 0.1 * std::sin(1.3 * seconds));
  pose.T_wc.linear() = (AngleAxisd(0.2 * std::sin(seconds), Vector3d::UnitX()) *
                        AngleAxisd(0.3 * std::cos(0.5 * seconds), Vector3d::UnitZ()))
                           .toRotationMatrix();
  return pose;
}
Trajectory wavy_path(int poses) {
  Trajectory path;
  for (int i = 0; i < poses; ++i) path.push_back(wavy_pose(0.05 * i, i * kFrameNs));
  return path;
}
// The same path at another rate, and not at the same times.
Trajectory wavy_path_at(double per_s, double from_s, double to_s) {
  Trajectory path;
  for (double t = from_s; t <= to_s; t += 1 / per_s) path.push_back(wavy_pose(t, std::llround(1e9 * t)));
  return path;
}

Trajectory transformed(const Trajectory& path, double scale, const Matrix3d& R, const Vector3d& t) {
  Trajectory moved = path;
  for (StampedPose& pose : moved) {
    pose.T_wc.linear() = R * pose.T_wc.linear();
    pose.T_wc.translation() = scale * (R * pose.T_wc.translation()) + t;
  }
  return moved;
}

Evaluation judge(const Trajectory& estimate, const Trajectory& truth) {
  return evaluate(estimate, truth, "estimate.txt", "truth.txt");
}

std::string refusal(const Trajectory& estimate, const Trajectory& truth) {
  try {
    judge(estimate, truth);
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

// Double arithmetic on numbers of order 10 through an SVD: 1e-13 or so; 1e-9 leaves room and is far below any error
// that matters.
constexpr double kExact = 1e-9;

TEST(Evaluation, KnownSimilarityGivesZeroError) {
  test::Random random;
  for (int round = 0; round < 20; ++round) {
    const Trajectory truth = wavy_path(200);
    const Vector3d axis(random.gaussian(), random.gaussian(), random.gaussian());
    const Matrix3d R = AngleAxisd(random.uniform(-3, 3), axis.normalized()).toRotationMatrix();
    const double scale = random.uniform(0.05, 20);
    const Vector3d t(random.uniform(-5, 5), random.uniform(-5, 5), random.uniform(-5, 5));
    const Evaluation e = judge(transformed(truth, scale, R, t), truth);
    EXPECT_EQ(e.poses.size(), truth.size());
    EXPECT_NEAR(e.ate_max, 0, kExact);
    EXPECT_NEAR(e.alignment.scale * scale, 1, kExact);
    EXPECT_NEAR((e.alignment.R * R - Matrix3d::Identity()).norm(), 0, kExact);
    EXPECT_NEAR(e.relative_translation, 0, kExact);
    EXPECT_NEAR(e.relative_rotation_deg, 0, 1e-5);  // an angle from a matrix near identity: sqrt(1e-16) radians
    EXPECT_EQ(e.relative_pairs, 180);               // 200 poses, steps of 20
    EXPECT_EQ(e.wrong_poses, 0);
    EXPECT_DOUBLE_EQ(e.covered_fraction, 1);
  }
}

TEST(Evaluation, WhatNoSimilarityExplainsShows) {  // negative control of the test above
  const Trajectory truth = wavy_path(200);
  Trajectory stretched = truth;
  for (StampedPose& pose : stretched) pose.T_wc.translation().x() *= 1.05;
  const Evaluation e = judge(stretched, truth);
  EXPECT_GT(e.ate_rmse, 1e-3);
  EXPECT_GT(e.relative_translation, 1e-3);
}

TEST(Evaluation, PositionNoiseComesBackAsItsRms) {
  test::Random random;
  constexpr int kPoses = 2000;
  const Trajectory truth = wavy_path(kPoses);
  const auto measured = [&](double sigma) {
    Trajectory noisy = truth;
    for (StampedPose& pose : noisy) {
      pose.T_wc.translation() += sigma * Vector3d(random.gaussian(), random.gaussian(), random.gaussian());
    }
    return judge(noisy, truth);
  };
  // The rms of 3 n Gaussian residuals, of which the alignment takes 7, is sigma sqrt(3 - 7/n) within a relative
  // standard deviation of 1/sqrt(6 n) = 0.9 %. Five of them: 4.6 %.
  constexpr double kSigma = 0.003;
  const double expected = kSigma * std::sqrt(3.0 - 7.0 / kPoses);
  const Evaluation e = measured(kSigma);
  EXPECT_NEAR(e.ate_rmse / expected, 1, 0.046);
  // The median of the norm of a 3-D Gaussian is 1.5382 sigma; its relative standard deviation is about
  // 1/(2 f m sqrt(n)) = 1.3 % with density f = 0.57 at m. Five of them: 7 %.
  EXPECT_NEAR(e.ate_median / (1.5382 * kSigma), 1, 0.07);
  // Two poses' noise in every relative step: sqrt(2) times.
  EXPECT_NEAR(e.relative_translation / (std::sqrt(6.0) * kSigma), 1, 0.046);
  EXPECT_EQ(e.wrong_poses, 0);
  EXPECT_GT(std::abs(measured(1.2 * kSigma).ate_rmse / expected - 1), 0.046);  // the tolerance can fail
}

TEST(Evaluation, InjectedWrongPosesAreCountedAndDoNotSpoilTheOthers) {
  test::Random random;
  const Trajectory truth = wavy_path(300);
  for (const double share : {0.05, 0.2, 0.4}) {
    Trajectory estimate = transformed(truth, 0.3, AngleAxisd(0.8, Vector3d::UnitY()).toRotationMatrix(), {1, 2, 3});
    int injected = 0;
    for (StampedPose& pose : estimate) {
      if (random.uniform(0, 1) > share) continue;
      pose.T_wc.translation() += Vector3d(random.uniform(1, 4), random.uniform(1, 4), random.uniform(-4, 4));
      ++injected;
    }
    const Evaluation e = judge(estimate, truth);
    EXPECT_EQ(e.wrong_poses, injected) << share;
    EXPECT_NEAR(e.robust_alignment.scale * 0.3, 1, 1e-6) << share;
    EXPECT_GT(std::abs(e.alignment.scale * 0.3 - 1), 0.1) << "the plain alignment should be spoiled";
  }
}

TEST(Evaluation, ALongRestAtAWrongPlaceDoesNotOutvoteThePath) {
  Trajectory truth = wavy_path(100);
  for (int i = 100; i < 400; ++i) {
    truth.push_back(truth[99]);
    truth.back().timestamp_ns = i * kFrameNs;
  }
  Trajectory estimate = transformed(truth, 0.3, AngleAxisd(0.8, Vector3d::UnitY()).toRotationMatrix(), {1, 2, 3});
  for (size_t i = 100; i < 400; ++i) estimate[i].T_wc.translation().x() += 0.3;  // one unit of the truth
  const Evaluation e = judge(estimate, truth);
  EXPECT_EQ(e.wrong_poses, 300);
  for (size_t i = 0; i < 100; ++i) EXPECT_FALSE(e.poses[i].wrong) << i;
}

TEST(Evaluation, TurnedPosesAreWrongBeyondTheLimitOnly) {
  const Trajectory truth = wavy_path(200);
  const auto wrong_with_turns_of = [&](double degrees) {
    Trajectory estimate = truth;
    for (size_t i = 0; i < estimate.size(); i += 10) {
      estimate[i].T_wc.rotate(AngleAxisd(degrees * kRadians, Vector3d(1, 2, 2) / 3));
    }
    return judge(estimate, truth).wrong_poses;
  };
  EXPECT_EQ(wrong_with_turns_of(kWrongRotationDeg - 0.1), 0);
  EXPECT_EQ(wrong_with_turns_of(kWrongRotationDeg + 0.1), 20);
}

TEST(Evaluation, ShiftedPosesAreWrongBeyondTheLimitOnly) {
  const Trajectory truth = wavy_path(200);
  const double extent = judge(truth, truth).extent;
  const auto wrong_with_shift_of = [&](double extents) {
    Trajectory estimate = truth;
    for (size_t i = 0; i < estimate.size(); i += 10) estimate[i].T_wc.translation().z() += extents * extent;
    return judge(estimate, truth).wrong_poses;
  };
  EXPECT_EQ(wrong_with_shift_of(kWrongExtentFraction - 0.01), 0);
  EXPECT_EQ(wrong_with_shift_of(kWrongExtentFraction + 0.01), 20);
}

TEST(Evaluation, SteadyTurningIsTheRelativeRotation) {
  Trajectory truth = wavy_path(200);
  Trajectory estimate = truth;
  for (size_t i = 0; i < truth.size(); ++i) {
    truth[i].T_wc.linear().setIdentity();
    const double seconds = 1e-9 * static_cast<double>(truth[i].timestamp_ns);
    estimate[i].T_wc.linear() = AngleAxisd(0.3 * kRadians * seconds, Vector3d::UnitY()).toRotationMatrix();
  }
  EXPECT_NEAR(judge(estimate, truth).relative_rotation_deg, 0.3, 1e-6);
}

TEST(Evaluation, VerticalErrorIsTheTiltOfTheWorld) {
  const Trajectory truth = wavy_path(200);
  const auto vertical_after = [&](const Vector3d& axis, double degrees) {
    const Matrix3d R = AngleAxisd(degrees * kRadians, axis).toRotationMatrix();
    return judge(transformed(truth, 2, R, Vector3d::Zero()), truth).vertical_error_deg;
  };
  EXPECT_NEAR(vertical_after(Vector3d::UnitX(), 7), 7, 1e-6);
  EXPECT_NEAR(vertical_after(Vector3d::UnitZ(), 70), 0, 1e-6);  // north is free
}

TEST(Evaluation, StraightPathsHaveADirectionToo) {
  Trajectory truth = wavy_path(100);
  for (size_t i = 0; i < truth.size(); ++i) truth[i].T_wc.translation() = Vector3d(0.01 * static_cast<double>(i), 0, 1);
  const Matrix3d R = AngleAxisd(0.5, Vector3d(1, 1, 0).normalized()).toRotationMatrix();
  const Evaluation e = judge(transformed(truth, 0.1, R, {1, 1, 1}), truth);
  EXPECT_NEAR(e.ate_max, 0, kExact);
  EXPECT_EQ(e.wrong_poses, 0);
  EXPECT_NEAR(e.vertical_error_deg, 0.5 / kRadians, 1e-6);  // a turn about a horizontal axis
}

// The path accelerates by 0.57 at most: between poses 0.01 s apart a chord leaves it by 0.57 * 0.01^2 / 8 = 7e-6. The
// nearest pose is off by up to 5 ms at a speed of 0.5: 2.5e-3.
TEST(Evaluation, ADenserTruthIsInterpolated) {
  const Evaluation e = judge(wavy_path_at(30, 0.5, 19.5), wavy_path_at(100, 0.0033, 20));
  EXPECT_EQ(e.poses.size(), e.estimate_poses);
  EXPECT_LT(e.ate_max, 8e-6);
  EXPECT_LT(e.relative_rotation_deg, 1e-3);
  // A clock that is late shows: 24 ms at a speed of about 0.35 leave some millimetres that no similarity explains.
  Trajectory late = wavy_path(200);
  for (StampedPose& pose : late) pose.timestamp_ns += 24'000'000;
  EXPECT_GT(judge(late, wavy_path(200)).ate_max, 1e-3);
}

TEST(Evaluation, AcrossAHoleOnlyPosesWithin20MillisecondsCount) {
  const auto compared_with_pose_at = [](int64_t into_hole_ns) {
    Trajectory truth = wavy_path(200);
    truth.erase(truth.begin() + 101, truth.begin() + 120);  // 0.95 s
    Trajectory estimate = wavy_path(100);
    estimate.push_back(wavy_pose(5, 100 * kFrameNs + into_hole_ns));
    return judge(estimate, truth).poses.size();
  };
  EXPECT_EQ(compared_with_pose_at(19'000'000), 101u);
  EXPECT_EQ(compared_with_pose_at(21'000'000), 100u);
}

// An estimate that strays slowly, judged by truths of many rates: the same answer each time. The alignment takes 7 of
// 3 n coordinates, with 30 poses 4 % of the rms; where the poses fall takes about as much.
TEST(Evaluation, ASparserTruthGivesTheSameAnswer) {
  Trajectory estimate = wavy_path_at(30, 0, 60);
  for (StampedPose& pose : estimate) {
    const double t = 1e-9 * static_cast<double>(pose.timestamp_ns);
    pose.T_wc.translation() += 0.004 * Vector3d(std::sin(0.9 * t), std::cos(1.7 * t), std::sin(2.3 * t));
  }
  estimate = transformed(estimate, 0.3, AngleAxisd(0.8, Vector3d::UnitY()).toRotationMatrix(), {1, 2, 3});
  const Evaluation dense = judge(estimate, wavy_path_at(30, 0, 60));
  EXPECT_FALSE(dense.at_truth_times);
  EXPECT_EQ(dense.poses.size(), estimate.size());
  for (const double rate : {100.0, 25.0, 10.0, 5.0, 2.0, 1.0, 0.5}) {
    const Trajectory truth = wavy_path_at(rate, 0.0, 60);
    const Evaluation e = judge(estimate, truth);
    EXPECT_EQ(e.at_truth_times, rate < 20) << rate;
    EXPECT_EQ(e.poses.size(), rate < 20 ? truth.size() : estimate.size()) << rate;
    EXPECT_NEAR(e.ate_percent() / dense.ate_percent(), 1, 0.08) << rate;
    EXPECT_NEAR(e.path_length / dense.path_length, 1, 0.02) << rate;
    EXPECT_NEAR(e.extent / dense.extent, 1, 0.05) << rate;
    EXPECT_EQ(e.wrong_poses, 0) << rate;
    EXPECT_NEAR(e.covered_fraction, 1, 1e-9) << rate;
    if (rate >= 1) {
      EXPECT_GT(e.relative_pairs, 50) << rate;
      EXPECT_NEAR(e.relative_translation / dense.relative_translation, 1, 0.1) << rate;
    } else {
      EXPECT_EQ(e.relative_pairs, 0) << "two seconds are not one";
    }
  }
  double chords = 0;  // what the path of the sparse truth itself would be
  const Trajectory sparse = wavy_path_at(0.5, 0, 60);
  for (size_t i = 1; i < sparse.size(); ++i) {
    chords += (sparse[i].T_wc.translation() - sparse[i - 1].T_wc.translation()).norm();
  }
  EXPECT_LT(chords, 0.95 * dense.path_length) << "the test above could not fail";
}

TEST(Evaluation, WithASparseTruthJumpsOfTheEstimateAreNoPath) {
  const Trajectory truth = wavy_path_at(1, 0, 60);
  const Trajectory right = wavy_path_at(30, 0, 60);
  const double path = judge(right, truth).path_length;
  Trajectory jumping = right;  // away and back between two poses of the truth
  for (size_t i = 45; i < jumping.size(); i += 150) {
    for (size_t k = 0; k < 5; ++k) jumping[i + k].T_wc.translation().x() += 7;
  }
  const Evaluation jumped = judge(jumping, truth);
  EXPECT_EQ(jumped.wrong_poses, 0);
  EXPECT_LT(jumped.path_length / path, 1.01);
  Trajectory elsewhere = right;  // 15 of 60 s, of them 15 of 61 poses
  for (size_t i = 465; i < 465 + 450; ++i) elsewhere[i].T_wc.translation().y() += 9;
  const Evaluation lost = judge(elsewhere, truth);
  EXPECT_EQ(lost.wrong_poses, 15);
  EXPECT_LT(lost.path_length / path, 1.01);
}

TEST(Evaluation, DroppedFramesDoNotMakeTheTruthTheSparserOne) {
  const Trajectory truth = wavy_path(200);
  Trajectory estimate;
  for (size_t i = 0; i < truth.size(); i += i % 5 == 0 ? 1 : 2) estimate.push_back(truth[i]);
  const Evaluation e = judge(estimate, truth);
  EXPECT_FALSE(e.at_truth_times);
  ASSERT_EQ(e.poses.size(), estimate.size());
  for (size_t i = 0; i < estimate.size(); ++i) {
    EXPECT_EQ(e.poses[i].timestamp_ns, estimate[i].timestamp_ns);
    EXPECT_EQ(e.poses[i].truth_T_wc.matrix(), estimate[i].T_wc.matrix()) << "bit for bit where the times agree";
  }
}

TEST(Evaluation, FewPosesAreNotCalledWrongByChance) {
  test::Random random;
  const Trajectory estimate = wavy_path_at(30, 0, 20);
  for (int poses = 4; poses < static_cast<int>(kFewPoses); ++poses) {
    Trajectory truth = wavy_path_at((poses - 1) / 19.0, 0.3, 19.4);
    for (StampedPose& pose : truth) {  // a hundredth of the extent
      pose.T_wc.translation() += 0.01 * Vector3d(random.gaussian(), random.gaussian(), random.gaussian());
    }
    EXPECT_EQ(judge(estimate, truth).wrong_poses, 0) << poses;
  }
}

TEST(Evaluation, NumbersThatOverflowAreRefused) {
  const Trajectory truth = wavy_path(100);
  for (const double number : {1e307, 1e200, 1e16, std::numeric_limits<double>::infinity(), std::nan("")}) {
    Trajectory bad = truth;
    bad[50].T_wc.translation().y() = number;
    EXPECT_NE(refusal(bad, truth).find("estimate.txt: the pose at 2.5"), std::string::npos) << number;
    EXPECT_NE(refusal(truth, bad).find("truth.txt: the pose at 2.5"), std::string::npos) << number;
  }
  for (const double scale : {1e-8, 1e14}) {  // far apart, but finite
    const Trajectory scaled = transformed(truth, scale, Matrix3d::Identity(), Vector3d::Zero());
    EXPECT_TRUE(std::isfinite(judge(scaled, truth).ate_percent())) << scale;
    EXPECT_TRUE(std::isfinite(judge(truth, scaled).ate_percent())) << scale;
  }
}

TEST(Evaluation, CoverageLeavesGapsOut) {
  const Trajectory truth = wavy_path(201);  // 10 s
  Trajectory estimate(truth.begin() + 40, truth.end());
  estimate.erase(estimate.begin() + 60, estimate.begin() + 99);  // 40 steps missing: 2 s
  EXPECT_NEAR(judge(estimate, truth).covered_fraction, 0.6, kExact);
}

TEST(Evaluation, RefusesWhatCannotBeCompared) {
  const Trajectory truth = wavy_path(100);
  EXPECT_NE(refusal({}, truth).find("estimate.txt: holds no poses"), std::string::npos);
  EXPECT_NE(refusal(truth, {}).find("truth.txt: holds no poses"), std::string::npos);

  Trajectory later = truth;
  for (StampedPose& pose : later) pose.timestamp_ns += 1'000'000'000'000;
  EXPECT_NE(refusal(later, truth).find("same origin"), std::string::npos);
  EXPECT_NE(refusal(later, truth).find("from 1000.000 to 1004.950 s"), std::string::npos) << refusal(later, truth);
  EXPECT_NE(refusal(later, truth).find("from 0.000 to 4.950 s"), std::string::npos);
  const Trajectory slow = wavy_path_at(1, 0.5, 4);
  EXPECT_NE(refusal(slow, wavy_path_at(2, 0.25, 4)).find("interpolate"), std::string::npos);

  const Trajectory two(truth.begin(), truth.begin() + 2);
  EXPECT_NE(refusal(two, truth).find("at least 3"), std::string::npos);

  Trajectory still = truth;
  for (StampedPose& pose : still) pose.T_wc.translation() = Vector3d(1, 2, 3);
  EXPECT_NE(refusal(truth, still).find("truth.txt: the camera does not move"), std::string::npos);
  EXPECT_NE(refusal(still, truth).find("estimate.txt: the camera does not move"), std::string::npos);

  EXPECT_EQ(refusal(Trajectory(truth.begin(), truth.begin() + 3), truth), "");
}

// Times at the two ends of int64_t are far apart; their difference, wrapped round, would be a millisecond.
TEST(Evaluation, PosesAtTheTwoEndsOfTimeAreNotTakenForNeighbours) {
  Trajectory estimate = wavy_path(4);
  Trajectory truth = estimate;
  for (int i = 0; i < 4; ++i) {
    estimate[static_cast<size_t>(i)].timestamp_ns = std::numeric_limits<int64_t>::min() + i * 100'000;
    truth[static_cast<size_t>(i)].timestamp_ns = std::numeric_limits<int64_t>::max() - (3 - i) * 100'000;
  }
  EXPECT_NE(refusal(estimate, truth).find("no pose lies within"), std::string::npos) << refusal(estimate, truth);
  Trajectory both = estimate;
  both.insert(both.end(), truth.begin(), truth.end());
  EXPECT_LT(judge(both, both).ate_rmse, kExact);
}

}  // namespace
}  // namespace pptam::platform
