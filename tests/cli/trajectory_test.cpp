// Files of poses as people have them: units of time, order, separators, headers; and the truth beside a recording.
#include "platform/trajectory.h"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <functional>
#include <string>
#include <vector>

#include "platform/camera/ground_truth.h"
#include "platform/input_error.h"
#include "platform/text.h"
#include "tests/support/scratch_folder.h"

namespace pptam::platform {
namespace {

namespace fs = std::filesystem;

class TrajectoryFiles : public ::testing::Test {
 protected:
  fs::path written(const std::string& name, const std::string& text) const {
    fs::create_directories((folder_ / name).parent_path());
    std::ofstream(folder_ / name, std::ios::binary) << text;
    return folder_ / name;
  }
  // The message, or "" when f threw nothing.
  static std::string refusal(const std::function<void()>& f) {
    try {
      f();
    } catch (const InputError& error) {
      EXPECT_EQ(std::string(error.what()).find('\n'), std::string::npos);
      return error.what();
    }
    return "";
  }
  std::string refusal_of(const std::string& text) const {
    std::vector<std::string> warnings;
    const fs::path file = written("bad.txt", text);
    return refusal([&] { (void)read_tum_trajectory(file, &warnings); });
  }

  const test::ScratchFolder scratch_;
  const fs::path& folder_ = scratch_.path();
};

bool holds(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

// Poses every step_s from origin_s on, for seconds_s; stamps printed as numbers of 1e-9 * 10^shift s.
std::string poses_text(double origin_s, double step_s, double seconds_s, int shift) {
  std::string text = "# timestamp tx ty tz qx qy qz qw\n";
  const auto origin_ns = static_cast<int64_t>(origin_s) * 1'000'000'000;
  for (int i = 0; i * step_s <= seconds_s; ++i) {
    const int64_t ns = origin_ns + std::llround(1e9 * i * step_s);
    const auto unit = static_cast<int64_t>(std::pow(10, shift));
    text += std::to_string(ns / unit);
    if (shift > 0) text += format(".%0*lld", shift, static_cast<long long>(ns % unit));
    text += format(" %.6f 0 0 0 0 0 1\n", 0.1 * i);
  }
  return text;
}

TEST_F(TrajectoryFiles, UnitsOfTimeAreRecognised) {
  struct Unit {
    int shift;
    const char* name;
  };
  constexpr Unit kUnits[] = {{9, "seconds"}, {6, "milliseconds"}, {3, "microseconds"}, {0, "nanoseconds"}};
  for (const double origin_s : {0.0, 1305031102.0}) {
    for (const double truth_step_s : {0.005, 1 / 30.0, 0.1, 1.0, 2.0}) {
      for (const Unit& of_truth : kUnits) {
        for (const Unit& of_estimate : kUnits) {
          const fs::path estimate = written("estimate.txt", poses_text(origin_s, 1 / 30.0, 6, of_estimate.shift));
          const fs::path truth = written("truth.txt", poses_text(origin_s, truth_step_s, 8, of_truth.shift));
          std::vector<std::string> warnings;
          const TrajectoryPair read = read_trajectories(estimate, truth, &warnings);
          const std::string what =
              format("%g s from %g, ", truth_step_s, origin_s) + of_estimate.name + " and " + of_truth.name;
          const auto last_ns = [&](const Trajectory& t) { return t.back().timestamp_ns - t.front().timestamp_ns; };
          EXPECT_EQ(read.estimate.front().timestamp_ns, std::llround(origin_s) * 1'000'000'000) << what;
          EXPECT_EQ(last_ns(read.estimate), 6'000'000'000) << what;
          EXPECT_EQ(last_ns(read.truth), 8'000'000'000) << what;
          std::vector<std::string> expected;
          if (of_estimate.shift != 9) expected.push_back(estimate.string() + ": the stamps are not seconds");
          if (of_truth.shift != 9) expected.push_back(truth.string() + ": the stamps are not seconds");
          ASSERT_EQ(warnings.size(), expected.size()) << what;
          for (size_t i = 0; i < warnings.size(); ++i) EXPECT_TRUE(holds(warnings[i], expected[i])) << warnings[i];
          if (of_truth.shift != 9) {
            EXPECT_TRUE(holds(warnings.back(), of_truth.name)) << warnings.back();
          }
        }
      }
    }
  }
}

TEST_F(TrajectoryFiles, SecondsStaySeconds) {
  struct Seconds {
    double estimate_step_s, estimate_s, truth_step_s, truth_s;
  };
  for (const double origin_s : {0.0, 1305031102.0}) {
    for (const Seconds& s : {Seconds{4, 100, 0.01, 100}, Seconds{1 / 30.0, 8, 1, 3600}, Seconds{4, 100, 4, 100},
                             Seconds{9, 100, 1 / 30.0, 100}, Seconds{1 / 30.0, 0.4, 0.004, 100}}) {
      std::vector<std::string> warnings;
      const TrajectoryPair read =
          read_trajectories(written("e.txt", poses_text(origin_s, s.estimate_step_s, s.estimate_s, 9)),
                            written("t.txt", poses_text(origin_s, s.truth_step_s, s.truth_s, 9)), &warnings);
      EXPECT_TRUE(warnings.empty()) << warnings[0];
      EXPECT_NEAR(1e-9 * static_cast<double>(read.truth[1].timestamp_ns - read.truth[0].timestamp_ns), s.truth_step_s,
                  1e-8);
    }
  }
}

// Every 2 s for two hours, or 500 per second in milliseconds: beside 7 s of an estimate both are possible.
TEST_F(TrajectoryFiles, AnAmbiguousUnitIsRefused) {
  const fs::path estimate = written("e.txt", poses_text(0, 0.05, 7, 9));
  const fs::path truth = written("t.txt", poses_text(0, 2, 7200, 9));
  std::vector<std::string> warnings;
  const std::string message = refusal([&] { (void)read_trajectories(estimate, truth, &warnings); });
  EXPECT_TRUE(holds(message, "the stamps are not seconds")) << message;
  EXPECT_TRUE(holds(message, "t.txt") && holds(message, "7200")) << message;
}

TEST_F(TrajectoryFiles, UnorderedAndDoubledStampsAreToldAndMended) {
  const fs::path file = written("t.txt",
                                "1 1 0 0 0 0 0 1\n2 2 0 0 0 0 0 1\n2 9 0 0 0 0 0 1\n\n5 5 0 0 0 0 0 1\n"
                                "3 3 0 0 0 0 0 1\n4 4 0 0 0 0 0 1\n4.0 9 0 0 0 0 0 1\n6 nan nan nan 0 0 0 1\n"
                                "7 7 0 0 0 0 0 0\n8 8 0 0 0 0 0 1\n");
  std::vector<std::string> warnings;
  const Trajectory read = read_tum_trajectory(file, &warnings);
  ASSERT_EQ(read.size(), 6u);
  const int expected[] = {1, 2, 3, 4, 5, 8};
  for (size_t i = 0; i < read.size(); ++i) {
    EXPECT_EQ(read[i].timestamp_ns, int64_t{expected[i]} * 1'000'000'000);
    EXPECT_EQ(read[i].T_wc.translation().x(), expected[i]);  // of a doubled stamp the first
  }
  ASSERT_EQ(warnings.size(), 3u);
  EXPECT_TRUE(holds(warnings[0], "t.txt: poses of NaN or zeros (lost?), left out: 2")) << warnings[0];
  EXPECT_TRUE(holds(warnings[0], "the first in line 9")) << warnings[0];
  EXPECT_TRUE(holds(warnings[1], "t.txt: doubled time stamps, left out: 2")) << warnings[1];
  EXPECT_TRUE(holds(warnings[1], "the first in line 3")) << warnings[1];
  EXPECT_TRUE(holds(warnings[2], "t.txt: time stamps before the one above, sorted: 1")) << warnings[2];
  EXPECT_TRUE(holds(warnings[2], "in line 6")) << warnings[2];
  EXPECT_TRUE(holds(refusal([&] { (void)read_tum_trajectory(file); }), "t.txt:9: ")) << "strict without warnings";

  // 1.305031e+09 for every pose: nothing is left of the times.
  std::string coarse;
  for (int i = 0; i < 20; ++i) coarse += format("%.6e %d 0 0 0 0 0 1\n", 1305031102.0 + 0.03 * i, i);
  EXPECT_TRUE(holds(refusal_of(coarse), "19 of 20 time stamps are doubled"));
}

TEST_F(TrajectoryFiles, SeparatorsAndHeaders) {
  // x, y, z, and a turn by 90 degrees about x.
  constexpr double kHalf = 0.7071068;
  struct Sample {
    const char* text;
    size_t warnings;
  };
  const Sample samples[] = {
      {"1.5 1 2 3 0.7071068 0 0 0.7071068\n", 0},
      {"1.5\t1\t2\t3\t0.7071068\t0\t0\t0.7071068\n", 0},
      {"# t, tx, ty, tz, qx, qy, qz, qw\n1.5,1,2,3,0.7071068,0,0,0.7071068\n", 0},
      {"# timestamp tx ty tz qx qy qz qw\n1.5; 1; 2; 3; 0.7071068; 0; 0; 0.7071068;\r\n", 0},
      {"1.5,1,2,3,0.7071068,0,0,0.7071068\n", 1},
      {"timestamp tx ty tz qx qy qz qw\n1.5 1 2 3 0.7071068 0 0 0.7071068\n", 1},
      {"timestamp,tx,ty,tz,qw,qx,qy,qz\n1.5,1,2,3,0.7071068,0.7071068,0,0\n", 1},
      {"# timestamp tx ty tz qw qx qy qz\n1.5 1 2 3 0.7071068 0.7071068 0 0\n", 0},
      {"\xef\xbb\xbf# a comment\r\n\r\n1.5 1 2 3 0.7071068 0 0 +0.7071068\r\n", 0},
  };
  for (const Sample& sample : samples) {
    std::vector<std::string> warnings;
    const Trajectory read = read_tum_trajectory(written("t.txt", sample.text), &warnings);
    ASSERT_EQ(read.size(), 1u) << sample.text;
    EXPECT_EQ(read[0].timestamp_ns, 1'500'000'000) << sample.text;
    EXPECT_EQ(read[0].T_wc.translation(), Eigen::Vector3d(1, 2, 3)) << sample.text;
    EXPECT_NEAR(read[0].T_wc.linear()(2, 1), 2 * kHalf * kHalf, 1e-6) << sample.text;
    EXPECT_EQ(warnings.size(), sample.warnings) << sample.text;
  }
}

TEST_F(TrajectoryFiles, EurocTablesAreKnownByTheirHeader) {
  const std::string row = "1403636580838555648,1,2,3,0.7071068,0.7071068,0,0,0.1,0.2,0.3,1,2,3,4,5,6\n";
  const fs::path truth = written(
      "data.csv",
      "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], v_RS_R_x [m "
      "s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1], b_w_RS_S_x [rad s^-1], b_w_RS_S_y [rad s^-1], b_w_RS_S_z [rad "
      "s^-1], b_a_RS_S_x [m s^-2], b_a_RS_S_y [m s^-2], b_a_RS_S_z [m s^-2]\n" +
          row + "1403636580843555648" + row.substr(19) + "1403636580848555648" + row.substr(19));
  const fs::path estimate = written("e.txt", "1403636580.8 0 0 0 0 0 0 1\n1403636580.85 0 0 0 0 0 0 1\n");
  std::vector<std::string> warnings;
  const TrajectoryPair read = read_trajectories(estimate, truth, &warnings);
  ASSERT_EQ(read.truth.size(), 3u);
  EXPECT_EQ(read.truth[0].timestamp_ns, 1403636580838555648);
  EXPECT_NEAR(read.truth[0].T_wc.linear()(2, 1), 1, 1e-6);
  ASSERT_EQ(warnings.size(), 1u);
  EXPECT_TRUE(holds(warnings[0], "nanoseconds")) << warnings[0];
  EXPECT_TRUE(holds(refusal_of(row), "header"));
  EXPECT_TRUE(holds(refusal_of("1403636580838555648,1,2,3,0.7071068,0.7071068,0,0\n"), "header"));
}

TEST_F(TrajectoryFiles, OtherFormatsAreRefusedByName) {
  EXPECT_TRUE(holds(refusal_of("1 0 0 0 0 1 0 0 0 0 1 0\n"), "bad.txt:1: 12 numbers are a matrix, as KITTI"));
  EXPECT_TRUE(holds(refusal_of("0.5 1 0 0 0 0 1 0 0 0 0 1 0\n"), "KITTI"));
  EXPECT_TRUE(holds(refusal_of("1,5;0,1;0;0;0;0;0;1\n"), "number of seconds"));
  EXPECT_TRUE(holds(refusal_of("1;0,1;0;0;0;0;0;1\n"), "points, not commas"));
  EXPECT_TRUE(holds(refusal_of("1 0 0 0 0 0 1\n"), "has 7 columns"));
  EXPECT_TRUE(holds(refusal_of("1,,0,0,0,0,0,1\n"), "expected 8 finite numbers"));
  EXPECT_TRUE(holds(refusal_of("1 0 0 0 0 0 0 2\n"), "unit length"));
  EXPECT_TRUE(holds(refusal_of("nan 0 0 0 0 0 0 1\n"), "timestamp"));
  EXPECT_TRUE(holds(refusal_of("9223372037 0 0 0 0 0 0 1\n"), "timestamp"));
  EXPECT_TRUE(holds(refusal_of("a b c d e f g h\na b c d e f g h\n"), "bad.txt:2: "));
  EXPECT_TRUE(holds(refusal_of(std::string(100'000, '1')), "64 kB"));
}

// ---- The truth beside a recording --------------------------------------------------------------------------------

class GroundTruth : public TrajectoryFiles {
 protected:
  struct Found {
    Trajectory trajectory;
    std::vector<std::string> warnings;
  };
  static Found read(const GroundTruthFile& file, TimeSpan images = {0, 8'000'000'000}) {
    Found found;
    found.trajectory = read_ground_truth(file, images, &found.warnings);
    return found;
  }
};

TEST_F(GroundTruth, WhatIsWrongWithItIsAWarning) {
  const std::string good = poses_text(0, 0.1, 8, 9);
  EXPECT_TRUE(find_tum_ground_truth(folder_).tum.empty());
  written("groundtruth.txt", good);
  const GroundTruthFile file = find_tum_ground_truth(folder_);
  EXPECT_TRUE(read(file).warnings.empty());
  EXPECT_EQ(read(file).trajectory.size(), 81u);
  EXPECT_TRUE(read({}).warnings.empty());

  // Mended: one warning, and the poses.
  for (const std::string& text :
       {good + "8 1 0 0 0 0 0 1\n", "timestamp tx ty tz qx qy qz qw\n" + good.substr(good.find('\n')),
        good + "9 nan nan nan nan nan nan nan\n", poses_text(0, 0.1, 8, 6)}) {
    written("groundtruth.txt", text);
    const Found found = read(file);
    EXPECT_EQ(found.warnings.size(), 1u);
    EXPECT_EQ(found.trajectory.size(), 81u);
    EXPECT_EQ(found.trajectory.back().timestamp_ns, 8'000'000'000);
  }
  // Of no use: one warning that names it, and nothing thrown.
  for (const std::string& text : {std::string("1 2 3\n"), std::string("\x00\x01", 2), good + "9 0 0 0 0 0 0 3\n",
                                  good + "x\n", std::string("1 0 0 0 0 1 0 0 0 0 1 0\n")}) {
    written("groundtruth.txt", text);
    const Found found = read(file);
    ASSERT_EQ(found.warnings.size(), 1u);
    EXPECT_TRUE(holds(found.warnings[0], "ground truth left out: ")) << found.warnings[0];
    EXPECT_TRUE(holds(found.warnings[0], "groundtruth.txt")) << found.warnings[0];
    EXPECT_TRUE(found.trajectory.empty());
  }
  fs::remove(folder_ / "groundtruth.txt");
  fs::create_directories(folder_ / "groundtruth.txt");
  EXPECT_EQ(read(file).warnings.size(), 1u);
}

TEST_F(GroundTruth, OfABodyNeedsThePlaceOfTheCamera) {
  const fs::path camera = folder_ / "mav0/cam0";
  fs::create_directories(camera);
  EXPECT_TRUE(find_euroc_ground_truth(camera).euroc.empty());
  const std::string rows = "1000000000,10,20,30,0,0,0,1\n1100000000,10,20,30,0,0,0,1\n";  // no header
  const fs::path mocap = written("mav0/mocap0/data.csv", rows);
  Found found = read(find_euroc_ground_truth(camera));
  ASSERT_EQ(found.warnings.size(), 1u);
  EXPECT_TRUE(holds(found.warnings[0], "left out") && holds(found.warnings[0], "T_BS")) << found.warnings[0];
  EXPECT_TRUE(found.trajectory.empty());

  written("mav0/cam0/sensor.yaml", "sensor_type: camera\n");
  found = read(find_euroc_ground_truth(camera));
  ASSERT_EQ(found.warnings.size(), 1u);
  EXPECT_TRUE(holds(found.warnings[0], "T_BS")) << found.warnings[0];
  EXPECT_TRUE(found.trajectory.empty());

  written("mav0/cam0/sensor.yaml", "T_BS:\n  data: [1,0,0,1, 0,1,0,2, 0,0,1,3, 0,0,0,1]\n");
  found = read(find_euroc_ground_truth(camera));
  ASSERT_EQ(found.warnings.size(), 1u);
  EXPECT_TRUE(holds(found.warnings[0], mocap.string() + ": taken for the ground truth")) << found.warnings[0];
  ASSERT_EQ(found.trajectory.size(), 2u);
  EXPECT_EQ(found.trajectory[0].timestamp_ns, 1'000'000'000);
  EXPECT_LT((found.trajectory[0].T_wc.translation() - Eigen::Vector3d(10 - 1, 20 - 2, 30 + 3)).norm(), 1e-12);

  // Kalibr tells it the other way round, for each camera.
  const fs::path chain = written("camchain.yaml",
                                 "cam0:\n  T_cam_imu:\n  - [1,0,0,-1]\n  - [0,1,0,-2]\n  - [0,0,1,-3]\n"
                                 "  - [0,0,0,1]\n");
  const Found chained = read({.euroc = mocap, .euroc_sensor = chain});
  ASSERT_EQ(chained.trajectory.size(), 2u);
  EXPECT_LT((chained.trajectory[0].T_wc.translation() - found.trajectory[0].T_wc.translation()).norm(), 1e-12);

  written("mav0/state_groundtruth_estimate0/data.csv", rows + "1100000000,1,2,3,0,0,0,1\n");  // goes first
  found = read(find_euroc_ground_truth(camera));
  EXPECT_EQ(found.trajectory.size(), 2u);
  ASSERT_EQ(found.warnings.size(), 1u);
  EXPECT_TRUE(holds(found.warnings[0], "doubled time stamps")) << found.warnings[0];
}

}  // namespace
}  // namespace pptam::platform
