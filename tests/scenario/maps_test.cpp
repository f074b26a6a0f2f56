// Lost is not the end: with Config::auto_start a camera that stays lost begins a new map, and goes on in the old one as
// soon as that one's views return.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <string>
#include <vector>

#include "platform/files.h"
#include "platform/run/evaluation.h"
#include "platform/run/run.h"
#include "sim_phone/laboratory/reach_study.h"
#include "tests/support/recording.h"
#include "tests/support/sample.h"
#include "tests/support/scratch_folder.h"

namespace pptam {
namespace {

using platform::FrameLog;
using platform::RunLog;
using platform::RunOptions;
using test::Recording;
using test::Replay;

constexpr int kFramesPerSecond = 15;
// In the first scene; in another one, in its midst and then from its beginning, where a hand holds still and moves
// sideways as for a start; in the first again.
constexpr int kHome_s = 9, kMidst_s = 4, kAnew_s = 9, kBack_s = 6, kAway_s = kMidst_s + kAnew_s;
constexpr int kAwayFrom = kHome_s * kFramesPerSecond, kBackFrom = kAwayFrom + kAway_s * kFramesPerSecond;

Recording record(const std::string& scene, uint64_t seed, double duration_s) {
  sim::PhoneOptions options;
  options.scene = scene;
  options.seed = seed;
  options.duration_s = duration_s;
  return test::record(options);
}

void append(const Recording& more, int from, int to, Recording* recording) {
  for (int i = from; i < to; ++i) {
    const size_t at = static_cast<size_t>(i);
    recording->images.push_back(more.images[at]);
    recording->timestamps_ns.push_back(static_cast<int64_t>(recording->images.size()) * 1'000'000'000 /
                                       kFramesPerSecond);
    for (const platform::StampedPose& pose : more.truth) {
      if (pose.timestamp_ns == more.timestamps_ns[at])
        recording->truth.push_back({recording->timestamps_ns.back(), pose.T_wc});
    }
  }
}

// As if the phone had been carried to another room and back.
Recording home_away_and_back(uint64_t seed) {
  const Recording home = record("desk", seed, kHome_s + kBack_s + 1);
  const Recording away = record("boxes", seed + 100, kAnew_s + kMidst_s + 1);
  Recording all;
  all.info = home.info;
  append(home, 0, kAwayFrom, &all);
  append(away, kAnew_s * kFramesPerSecond, (kAnew_s + kMidst_s) * kFramesPerSecond, &all);
  append(away, 0, kAnew_s * kFramesPerSecond, &all);
  append(home, kAwayFrom, kAwayFrom + kBack_s * kFramesPerSecond, &all);
  return all;
}

RunLog run(const Recording& recording, const RunOptions& options) {
  Replay camera(recording);
  return platform::run_sequence(
      camera, options, [](const platform::CameraInfo&) {},
      [](const Frame&, const TrackResult& result, const RunLog&) { EXPECT_TRUE(result.status.ok()); });
}

RunOptions starting_by_itself() {
  RunOptions options;
  options.auto_start = true;
  return options;
}

// Of the frames from..to - 1 the share with a pose in that map.
double share(const RunLog& log, int from, int to, int map) {
  int count = 0;
  for (const FrameLog& frame : log.frames)
    count += frame.index >= from && frame.index < to && frame.pose_valid && frame.map == map;
  return static_cast<double>(count) / (to - from);
}

double error_percent(const RunLog& log, const Recording& recording, int map, int from, int to) {
  platform::Trajectory truth;
  for (int i = from; i < to; ++i) truth.push_back(recording.truth[static_cast<size_t>(i)]);
  return platform::evaluate(log.trajectory_in(map), truth, "map", "truth").ate_percent();
}

TEST(Maps, ANewOneBeginsElsewhereAndTheOldOneGoesOn) {
  for (int seed = 1; seed <= test::sampled(2, 10); ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    const Recording recording = home_away_and_back(static_cast<uint64_t>(seed));
    const RunLog log = run(recording, starting_by_itself());
    const int end = recording.size();
    std::printf("seed %d: at home %.2f, away %.2f in a new map, back %.2f in the old one\n", seed,
                share(log, 0, kAwayFrom, 1), share(log, kAwayFrom, kBackFrom, 2), share(log, kBackFrom, end, 1));
    // A hand holds still for a second, then moves sideways for about three.
    EXPECT_GT(share(log, 5 * kFramesPerSecond, kAwayFrom, 1), 0.95);
    // As at home.
    EXPECT_GT(share(log, kAwayFrom + (kMidst_s + 5) * kFramesPerSecond, kBackFrom, 2), 0.95);
    EXPECT_EQ(share(log, kAwayFrom, kBackFrom, 1), 0) << "a pose in the first map while the camera is elsewhere";
    // Found within a second.
    EXPECT_GT(share(log, kBackFrom + kFramesPerSecond, end, 1), 0.9);
    // The first map's world is the same before and after: one alignment serves both.
    EXPECT_LT(error_percent(log, recording, 1, 0, end), 1);
    EXPECT_EQ(log.frames.back().maps, 2);
  }
}

// The control: without auto_start nothing begins, and the camera is found at home again.
TEST(Maps, NoNewOneBeginsWithoutAutoStart) {
  const Recording recording = home_away_and_back(1);
  const RunLog log = run(recording, RunOptions());
  EXPECT_EQ(log.maps(), std::vector<int>{1});
  EXPECT_EQ(share(log, kAwayFrom, kBackFrom, 1), 0);
  EXPECT_GT(share(log, kBackFrom + kFramesPerSecond, recording.size(), 1), 0.9);
}

// A file holds all maps; a camera that begins in it is found in either.
TEST(Maps, AreSavedAndLoadedTogether) {
  const Recording recording = home_away_and_back(1);
  RunOptions options = starting_by_itself();
  options.save_map = true;
  const RunLog session = run(test::part_of(recording, 0, kBackFrom), options);
  ASSERT_FALSE(session.saved_map.empty()) << session.save_trouble;
  MapInfo info;
  ASSERT_TRUE(System::map_info(session.saved_map, &info).ok());
  EXPECT_EQ(info.maps, 2);
  const test::ScratchFolder folder;
  const std::string file = (folder / "two.map").string();
  platform::write_atomically(file, session.saved_map);
  RunOptions second;
  second.load_map = file;
  const int away = kBackFrom - 3 * kFramesPerSecond;
  const RunLog at_home = run(test::part_of(recording, kBackFrom, recording.size()), second);
  EXPECT_GT(share(at_home, kFramesPerSecond, recording.size() - kBackFrom, 1), 0.9);
  const RunLog elsewhere = run(test::part_of(recording, away, kBackFrom), second);
  EXPECT_GT(share(elsewhere, kFramesPerSecond, kBackFrom - away, 2), 0.9);
  // And saved again.
  second.save_map = true;
  const RunLog again = run(test::part_of(recording, kBackFrom, kBackFrom + 1), second);
  ASSERT_TRUE(System::map_info(again.saved_map, &info).ok());
  EXPECT_EQ(info.maps, 2);
}

// More places than maps are kept: the oldest and smallest give way, images are taken from erased keyframes of others,
// and the run is the same twice.
TEST(Maps, GiveWayWhenThereAreTooMany) {
  Recording all;
  const char* const scenes[] = {"desk", "boxes", "walls", "clutter"};
  for (int i = 0; i < 4; ++i) {
    const Recording part = record(scenes[i], static_cast<uint64_t>(i) + 1, 15);
    if (i == 0) all.info = part.info;
    append(part, 0, 14 * kFramesPerSecond, &all);
  }
  RunOptions options = starting_by_itself();
  options.max_keyframes = 6;
  options.max_erased_keyframes = 20;
  options.save_map = true;
  const RunLog log = run(all, options), again = run(all, options);
  EXPECT_GE(log.maps().size(), 3u);
  EXPECT_TRUE(log.saved_map == again.saved_map) << "two runs differ";
  MapInfo info;
  ASSERT_TRUE(System::map_info(log.saved_map, &info).ok());
  EXPECT_LT(info.maps, static_cast<int>(log.maps().size())) << "none has given way";
  EXPECT_LE(info.keyframes + info.erased_keyframes, 6 + 20 + 1) << "more images than there are";
}

// From a map of one place: views turned and nearer, in four directions each. The study (sim --study reach) has 24 of 24
// at each of these; turned by half a circle nothing may be found.
TEST(Relocalisation, ReachesTurnedAndNearerViews) {
  sim::PhoneOptions phone;
  phone.scene = "desk";
  for (const uint64_t seed : {1u, 2u}) {
    phone.seed = seed;
    const std::vector<laboratory::ReachCount> counts =
        laboratory::measure_reach(phone, {}, {{0, 0}, {10, 0}, {0, 0.3}, {180, 0}}, 4);
    ASSERT_EQ(counts.size(), 4u) << "no map";
    for (const laboratory::ReachCount& count : counts) {
      EXPECT_EQ(count.wrong, 0) << count.at.turned_degrees << " degrees, " << count.at.nearer << " nearer";
      EXPECT_EQ(count.found, count.at.turned_degrees < 90 ? count.attempts : 0)
          << count.at.turned_degrees << " degrees, " << count.at.nearer << " nearer, seed " << seed;
    }
  }
}

}  // namespace
}  // namespace pptam
