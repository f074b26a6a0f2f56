// Times of frames: what stamps become, lists of any form, and folders of images named by time.

#include "platform/camera/frame_times.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "platform/camera/recorded_camera.h"
#include "platform/text.h"
#include "tests/support/scratch_folder.h"

namespace pptam::platform {
namespace {

namespace fs = std::filesystem;

constexpr int64_t kMs = 1000000;

std::vector<int64_t> accepted(FrameTimes* times, const std::vector<int64_t>& stamps_ms) {
  std::vector<int64_t> result;
  for (const int64_t stamp : stamps_ms) {
    if (const std::optional<int64_t> time_ns = times->next(stamp * kMs)) result.push_back(*time_ns / kMs);
  }
  return result;
}

std::string all(const std::vector<std::string>& lines) {
  std::string text;
  for (const std::string& line : lines) text += line + "\n";
  return text;
}

::testing::AssertionResult has(const std::string& text, const std::string& part) {
  if (text.find(part) != std::string::npos) return ::testing::AssertionSuccess();
  return ::testing::AssertionFailure() << "\"" << part << "\" is not in \"" << text << "\"";
}

TEST(FrameTimes, GoodOnesStayAsTheyAre) {
  FrameTimes times;
  const std::vector<int64_t> stamps = {-40, -7, 27, 60, 93, 127, 160, 227, 293, 360, 427, 560};  // 30, 15 and 7.5 per s
  EXPECT_EQ(accepted(&times, stamps), stamps);
  EXPECT_EQ(times.remarks(), std::vector<std::string>());
}

TEST(FrameTimes, DoubledAndBackwardFramesAreLeftOut) {
  FrameTimes times;
  EXPECT_EQ(accepted(&times, {0, 33, 67, 67, 100, 80, 133, 167}), (std::vector<int64_t>{0, 33, 67, 100, 133, 167}));
  EXPECT_TRUE(has(all(times.remarks()), "2 of 8 frames are left out"));
  EXPECT_TRUE(has(all(times.remarks()), "(first: 4)"));
}

TEST(FrameTimes, AClockSetBackGoesOnBehind) {
  FrameTimes times;
  // The third stamp that rises from the new base follows one usual step (33 ms) behind the last one accepted.
  EXPECT_EQ(accepted(&times, {5000, 5033, 5066, 5099, 0, 33, 66, 99, 132, 165}),
            (std::vector<int64_t>{5000, 5033, 5066, 5099, 5132, 5165, 5198, 5231}));
  EXPECT_TRUE(has(all(times.remarks()), "jump back at frame 7"));
  // Two are not enough: both are bad ones.
  FrameTimes two;
  EXPECT_EQ(accepted(&two, {5000, 5033, 0, 33, 5066}), (std::vector<int64_t>{5000, 5033, 5066}));
}

TEST(FrameTimes, GapsAreTold) {
  FrameTimes times;
  std::vector<int64_t> stamps;
  for (int i = 0; i < 40; ++i) stamps.push_back(33 * i + (i >= 20 ? 300 : 0) + (i >= 30 ? 900 : 0));
  EXPECT_EQ(accepted(&times, stamps), stamps);
  EXPECT_TRUE(has(all(times.remarks()), "at 2 places, the longest gap has 0.933 s (1.26 s after the start)"));
}

TEST(FrameTimes, EndsOfTheRangeAreNoTrouble) {
  for (const std::vector<int64_t>& stamps : {std::vector<int64_t>{INT64_MIN, INT64_MAX},
                                             {INT64_MIN, -1, INT64_MAX},
                                             {INT64_MAX, INT64_MIN, INT64_MIN + 1, INT64_MIN + 2, INT64_MIN + 3},
                                             {0, INT64_MAX, 1, 2, 3, 4}}) {
    FrameTimes times;
    std::optional<int64_t> before;
    for (const int64_t stamp : stamps) {
      const std::optional<int64_t> time_ns = times.next(stamp);
      EXPECT_TRUE(!time_ns || !before || *time_ns > *before);
      if (time_ns) before = time_ns;
    }
    EXPECT_FALSE(times.remarks().empty());
    (void)evened_out(stamps);
    (void)order_in_time(stamps);
  }
}

TEST(FrameTimes, UnitsAreRecognised) {
  const auto unit_of = [](const std::vector<std::string>& stamps, TimeUnit documented) {
    std::string remark;
    const TimeUnit unit = recognised_unit(stamps, documented, &remark);
    EXPECT_EQ(remark.empty(), unit == documented) << remark;
    return unit;
  };
  constexpr auto kS = TimeUnit::kSeconds;
  constexpr auto kNs = TimeUnit::kNanoseconds;
  EXPECT_EQ(unit_of({"0", "0.033", "0.066"}, kS), kS);
  EXPECT_EQ(unit_of({"0", "33.3", "66.6"}, kS), TimeUnit::kMilliseconds);
  EXPECT_EQ(unit_of({"0", "33333", "66666"}, kS), TimeUnit::kMicroseconds);
  EXPECT_EQ(unit_of({"0", "33333333", "66666666"}, kS), kNs);
  EXPECT_EQ(unit_of({"1403636579763555584", "1403636579813555584"}, kS), kNs);  // does not even fit as seconds
  EXPECT_EQ(unit_of({"1.403636579763555584e+18", "1.403636579813555584e+18"}, kS), kNs);
  EXPECT_EQ(unit_of({"1403636579.7635", "1403636579.8135"}, kNs), kS);
  EXPECT_EQ(unit_of({"1403636579763555", "1403636579813555"}, kNs), TimeUnit::kMicroseconds);
  EXPECT_EQ(unit_of({"1700000000", "1700000005"}, kS), kS);               // slow, but since 1970: not milliseconds
  EXPECT_EQ(unit_of({"2000000033333333", "2000000066666666"}, kS), kNs);  // 23 days of uptime, not 2033 in microseconds
  EXPECT_EQ(unit_of({"7"}, kS), kS);
  std::string remark;
  (void)recognised_unit({"0", "33.3", "66.6"}, kS, &remark);
  EXPECT_EQ(remark, "its times mean 0.03 frames/s as seconds: read as milliseconds");
}

TEST(FrameTimes, StampsAreExactInEveryUnit) {
  int64_t ns = 0;
  EXPECT_TRUE(parse_stamp("1403636579763555584", TimeUnit::kNanoseconds, &ns) && ns == 1403636579763555584);
  EXPECT_TRUE(parse_stamp("1403636579763.555584", TimeUnit::kMilliseconds, &ns) && ns == 1403636579763555584);
  EXPECT_TRUE(parse_stamp("1.403636579763555584e18", TimeUnit::kNanoseconds, &ns) && ns == 1403636579763555584);
  for (const char* bad : {"", "e", "1e", "1e99999999999", "x", "1e5x", "1_0", "nan", "--1"}) {
    EXPECT_FALSE(parse_stamp(bad, TimeUnit::kMilliseconds, &ns)) << bad;
  }
}

TEST(FrameTimes, BurstsAreEvenedOut) {
  std::vector<int64_t> arrival;
  for (int i = 0; i < 60; ++i) arrival.push_back(kMs * (i % 2 == 0 ? 33 * (i + 1) : 33 * i + 1));  // pairs, 1 ms apart
  EXPECT_TRUE(in_bursts(arrival));
  const std::vector<int64_t> evened = evened_out(arrival);
  for (size_t i = 5; i + 4 < evened.size(); ++i) EXPECT_NEAR(double(evened[i] - evened[i - 1]) / kMs, 33, 1e-3) << i;
  std::vector<int64_t> even;
  for (int i = 0; i < 60; ++i) even.push_back(33 * kMs * i);
  EXPECT_FALSE(in_bursts(even));
  EXPECT_EQ(evened_out(even), even);
}

TEST(FrameTimes, OrderIsSortedUnlessTheClockWasSetBack) {
  const auto sorts = [](const std::vector<int64_t>& stamps_ms) {
    std::vector<int64_t> stamps;
    for (const int64_t stamp : stamps_ms) stamps.push_back(stamp * kMs);
    const std::vector<size_t> order = order_in_time(stamps);
    return !std::is_sorted(order.begin(), order.end());
  };
  EXPECT_FALSE(sorts({0, 33, 66, 99}));
  EXPECT_TRUE(sorts({0, 66, 33, 99, 132, 165}));                              // two exchanged
  EXPECT_TRUE(sorts({165, 0, 99, 33, 132, 66}));                              // shuffled
  EXPECT_TRUE(sorts({99, 132, 165, 198, 0, 33, 66}));                         // the second part first
  EXPECT_FALSE(sorts({0, 33, 66, 99, 132, 165, 10, 43, 76, 109, 142, 175}));  // two clocks
}

// ---- Lists and folders -------------------------------------------------------------------------------------------

class ImageTimesTest : public ::testing::Test {
 protected:
  void write(const std::string& name, const std::string& text) const {
    fs::create_directories((folder_ / name).parent_path());
    std::ofstream(folder_ / name, std::ios::binary) << text;
  }
  // Its grey tells which image was read.
  void image(const std::string& name, int grey) const {
    write(name, "P5\n64 48\n255\n" + std::string(size_t{64} * 48, static_cast<char>(grey)));
  }
  // "grey@microseconds" for each frame. Warnings but that of the missing calibration are collected.
  std::string frames(const fs::path& source, double fps = 0) {
    RecordingOptions options;
    options.source = source;
    options.fov_degrees = 60;
    options.fps = fps;
    std::vector<std::string> warnings;
    std::string text;
    try {
      auto camera = open_recording(options, &warnings);
      for (Frame frame; camera->read(&frame);) {
        text += format("%s%d@%lld", text.empty() ? "" : " ", frame.data[0],
                       static_cast<long long>(frame.timestamp_ns / 1000));
      }
      remarks_ = all(camera->remarks());
    } catch (const InputError& error) {
      text = error.what();
    }
    warnings_.clear();
    for (const std::string& warning : warnings) {
      if (!warning.starts_with("no calibration")) warnings_ += warning + "\n";
    }
    return text;
  }

  const test::ScratchFolder scratch_;
  const fs::path& folder_ = scratch_.path();
  std::string warnings_;
  std::string remarks_;
};

TEST_F(ImageTimesTest, ListsOfAnyForm) {
  image("a.pgm", 10);
  image("my dir/b 2.pgm", 20);
  image("depth/c.pgm", 90);
  const std::string expected = "10@1000000 20@1040000";
  struct Case {
    const char* name;
    std::string text;
    const char* warning;  // empty: none
  };
  const std::string absolute = (folder_ / "a.pgm").string();
  const Case cases[] = {
      {"rgb.txt", "1.0 a.pgm\n1.04 my dir/b 2.pgm\n", ""},
      {"rgb.txt", "1.0\ta.pgm\n1.04\tmy dir/b 2.pgm\n", ""},
      {"rgb.txt", "timestamp filename\n1.0 a.pgm\n1.04 \"my dir/b 2.pgm\"\n", ""},
      {"rgb.txt", "1.0," + absolute + "\n1.04,my dir/b 2.pgm\n", ""},
      {"rgb.txt", "1.0 a.pgm 1.01 depth/c.pgm\n1.04 my dir/b 2.pgm 1.05 depth/c.pgm\n", ""},
      {"rgb.txt", "0.9 depth/c.pgm 1.0 a.pgm\n1.03 depth/c.pgm 1.04 my dir/b 2.pgm\n", ""},
      {"rgb.txt", "1.0 a.pgm\n1.04 my dir\\b 2.pgm\n", "backslashes"},
      {"rgb.txt", "1.04 my dir/b 2.pgm\n1.0 a.pgm\n", "sorted"},
      {"rgb.txt", "1.0 a.pgm\n1.04 my dir/b 2.pgm\n1.04 a.pgm\n", "1 of 3 frames are left out"},
      {"rgb.txt", "1000 a.pgm\n1040 my dir/b 2.pgm\n", "read as milliseconds"},
      {"rgb.txt", "1000000000 a.pgm\n1040000000 my dir/b 2.pgm\n", "read as nanoseconds"},
      {"list.csv", "#timestamp [ns],filename\n1000000000,a.pgm\n1040000000,my dir/b 2.pgm\n", ""},
      {"list.csv", "timestamp [ns],filename,exposure\r\n1000000000,\"a.pgm\",8\r\n1040000000, my dir/b 2.pgm ,8\r\n",
       ""},
      {"list.csv", "1000000000,8,a.pgm\n1040000000,8,my dir/b 2.pgm\n", ""},
      {"list.csv", "1000000,a.pgm\n1040000,my dir/b 2.pgm\n", "read as microseconds"},
      {"list.csv", "1.0,a.pgm\n1.04,my dir/b 2.pgm\n", "read as seconds"},
  };
  for (const Case& c : cases) {
    write(c.name, c.text);
    EXPECT_EQ(frames(folder_ / c.name), expected) << c.text;
    EXPECT_TRUE(*c.warning == '\0' ? warnings_.empty() : has(warnings_, c.warning)) << c.text << warnings_;
    fs::remove(folder_ / c.name);
  }
}

TEST_F(ImageTimesTest, NumbersOfImagesAreNoTimes) {
  for (int i = 0; i < 3; ++i) image(std::to_string(i) + ".pgm", 10 + i);
  // An index before the stamp.
  write("rgb.txt", "7 1.0 0.pgm\n8 1.04 1.pgm\n9 1.08 2.pgm\n");
  EXPECT_EQ(frames(folder_ / "rgb.txt"), "10@1000000 11@1040000 12@1080000");
  EXPECT_TRUE(has(warnings_, "its first column numbers the images"));
  // Nothing but an index: one a second is what the file says; the user may know better.
  write("list.csv", "0,0.pgm\n1,1.pgm\n2,2.pgm\n");
  EXPECT_EQ(frames(folder_ / "list.csv", 25), "10@0 11@40000 12@80000");
  write("rgb.txt", "0 0.pgm\n1 1.pgm\n2 2.pgm\n");
  EXPECT_EQ(frames(folder_ / "rgb.txt", 25), "10@0 11@40000 12@80000");
  EXPECT_EQ(frames(folder_ / "rgb.txt"), "10@0 11@1000000 12@2000000");
  EXPECT_TRUE(has(warnings_, "give their rate with --fps"));
  // Times for certain: the given rate is ignored, and so is the second number.
  write("rgb.txt", "1.0 5 0.pgm\n1.04 6 1.pgm\n1.08 7 2.pgm\n");
  EXPECT_EQ(frames(folder_ / "rgb.txt", 25), "10@1000000 11@1040000 12@1080000");
  EXPECT_TRUE(has(warnings_, "frame rate is ignored"));
}

TEST_F(ImageTimesTest, FoldersOfSeveralCamerasAreNoFilm) {
  const auto folder_with = [&](const std::string& sub, const std::vector<std::string>& names) {
    for (const std::string& name : names) image(sub + "/" + name + ".pgm", 10);
    return frames(folder_ / sub);
  };
  for (const std::vector<std::string>& names :
       {std::vector<std::string>{"left_0001", "left_0002", "right_0001", "right_0002"},
        {"0001_L", "0001_R", "0002_L", "0002_R"},
        {"cam0_10", "cam0_11", "cam1_10", "cam1_11"},
        {"17.25-color", "17.50-color", "17.25-depth", "17.50-depth"}}) {
    const std::string said = folder_with(names[0], names);
    EXPECT_TRUE(has(said, "holds images of several kinds, such as ")) << names[0];
    EXPECT_TRUE(has(said, "move all but one kind to another folder")) << names[0];
  }
  EXPECT_EQ(folder_with("w", {"IMG_1", "IMG_2", "DSC_1", "DSC_2"}).find("several"), std::string::npos);
  EXPECT_TRUE(has(warnings_, "holds images of several kinds"));
  // One kind, and a stray one.
  for (const std::vector<std::string>& names :
       {std::vector<std::string>{"cam0001", "cam0002", "cam1001", "cam1002"},
        {"left_1", "left_2", "left_3", "left_4", "left_5", "left_6", "left_7", "right_1", "right_2"},
        {"20240101_120000", "20240101_120001"},
        {"1.5", "2", "2.5", "3", "3.5"}}) {
    (void)folder_with("one" + names[0], names);
    EXPECT_EQ(warnings_.find("several"), std::string::npos) << names[0] << warnings_;
  }
}

TEST_F(ImageTimesTest, FoldersNamedByTime) {
  const auto named = [&](const std::string& sub, const std::vector<std::string>& names) {
    for (size_t i = 0; i < names.size(); ++i) image(sub + "/" + names[i] + ".pgm", 10 + static_cast<int>(i));
    return frames(folder_ / sub);
  };
  // As many decimals as needed: .1 comes after .07.
  EXPECT_EQ(named("a", {"1700000000.0", "1700000000.03", "1700000000.07", "1700000000.1"}),
            "10@1700000000000000 11@1700000000030000 12@1700000000070000 13@1700000000100000");
  EXPECT_EQ(warnings_, "");
  EXPECT_EQ(named("b", {"cam0_9.96", "cam0_10", "cam0_10.04"}), "10@9960000 11@10000000 12@10040000");
  EXPECT_EQ(named("c", {"1700000000000", "1700000000033"}), "10@1700000000000000 11@1700000000033000");
  EXPECT_EQ(named("d", {"f1700000000000000", "f1700000000033000"}), "10@1700000000000000 11@1700000000033000");
  EXPECT_EQ(named("e", {"1700000000000000000", "1700000000033000000"}), "10@1700000000000000 11@1700000000033000");
  EXPECT_EQ(named("f", {"33000", "66000", "99000"}), "10@33000 11@66000 12@99000");
  EXPECT_EQ(warnings_, "");
  EXPECT_EQ(named("j", {"86400000000000", "86400033333000"}), "10@86400000000 11@86400033333") << "a day of uptime, ns";
  EXPECT_NE(warnings_.find("read as nanoseconds"), std::string::npos) << warnings_;
  // Counts are no times, and neither are numbers in names that differ otherwise.
  EXPECT_EQ(named("g", {"img1", "img2", "img10"}), "10@0 11@33333 12@66666");
  EXPECT_TRUE(has(warnings_, "come without times: assuming 30 frames/s; give the true rate with --fps"));
  EXPECT_EQ(named("h", {"a1.5", "b1.2"}), "10@0 11@33333");
  EXPECT_EQ(named("i", {"shot1.0001", "shot1.0002", "shot1.0003"}), "10@0 11@33333 12@66666");
  // The user knows better than names; then there is nothing to warn of.
  EXPECT_EQ(frames(folder_ / "a", 10), "10@0 11@100000 12@200000 13@300000");
  EXPECT_EQ(frames(folder_ / "g", 10), "10@0 11@100000 12@200000");
  EXPECT_EQ(warnings_, "");
}

TEST_F(ImageTimesTest, KittisTimesAndFoldersWithinAreFound) {
  for (int i = 0; i < 3; ++i) image("00/image_0/00000" + std::to_string(i) + ".pgm", 10 + i);
  write("00/times.txt", "0.000000e+00\n1.038400e-01\n2.077100e-01\n");
  EXPECT_EQ(frames(folder_ / "00/image_0"), "10@0 11@103840 12@207710");
  EXPECT_EQ(frames(folder_ / "00/image_0/"), "10@0 11@103840 12@207710");
  EXPECT_EQ(warnings_, "");
  EXPECT_TRUE(has(frames(folder_ / "00"), "give " + (folder_ / "00/image_0").string()));
  write("00/times.txt", "0.0\n0.1\n");  // of other images
  EXPECT_EQ(frames(folder_ / "00/image_0"), "10@0 11@33333 12@66666");
}

TEST_F(ImageTimesTest, RepeatedImagesAreTold) {
  for (int i = 0; i < 6; ++i) image("v/" + std::to_string(i) + ".pgm", i < 3 ? 10 : 10 + i);
  (void)frames(folder_ / "v");
  EXPECT_TRUE(has(remarks_, "2 of 6 frames repeat the one before bit for bit"));
  for (int i = 0; i < 3; ++i) image("same/" + std::to_string(i) + ".pgm", 10);
  (void)frames(folder_ / "same");
  EXPECT_TRUE(has(remarks_, "all 3 frames are the same image"));
  for (int i = 0; i < 3; ++i) image("differ/" + std::to_string(i) + ".pgm", 10 + i);
  (void)frames(folder_ / "differ");
  EXPECT_EQ(remarks_, "");
}

}  // namespace
}  // namespace pptam::platform
