// The same input gives the same bits: run after run, however mapping is cut into slices, whoever looks on.
#include <gtest/gtest.h>

#include <functional>
#include <vector>

#include <pocket_ptam/inspection.h>
#include "platform/run/run.h"
#include "tests/support/recording.h"

namespace pptam {
namespace {

using test::Phone;
using test::Recording;
using test::Trace;

const Recording& recording() {
  static const Recording made = [] {
    sim::PhoneOptions options;
    options.scene = "boxes";
    options.seed = 3;
    options.duration_s = 7;
    return test::record(options);
  }();
  return made;
}

// Everything that came out of a run; idle is called after each frame.
Trace run(const Config& config, const std::function<void(Phone&, int)>& idle, int* slices_or_null = nullptr) {
  Phone phone(config);
  phone->tap();
  Trace trace;
  int poses = 0;
  for (int i = 0; i < recording().size(); ++i) {
    const TrackResult result = phone->track(recording().frame(i));
    trace.add(result);
    poses += result.pose_valid;
    idle(phone, i);
    trace.add_value(static_cast<int64_t>(map_hash(*phone)));
  }
  EXPECT_GT(poses, 20) << "the run must have a map, or nothing is compared";
  if (slices_or_null) *slices_or_null = poses;
  return trace;
}

TEST(Determinism, TwoRunsOfTheProgramAreEqual) {
  const auto go = [] {
    test::Replay camera(recording());
    return platform::run_sequence(
        camera, {}, [](const platform::CameraInfo&) {},
        [](const Frame&, const TrackResult&, const platform::RunLog&) {});
  };
  const platform::RunLog a = go();
  const platform::RunLog b = go();
  ASSERT_NE(a.first_tracked(), nullptr);
  EXPECT_EQ(a.map_hash, b.map_hash);
  ASSERT_EQ(a.frames.size(), b.frames.size());
  for (size_t i = 0; i < a.frames.size(); ++i) {
    EXPECT_EQ(a.frames[i].state, b.frames[i].state) << i;
    EXPECT_EQ(a.frames[i].pose_valid, b.frames[i].pose_valid) << i;
    EXPECT_EQ(a.frames[i].T_wc.matrix(), b.frames[i].T_wc.matrix()) << i;
    EXPECT_EQ(a.frames[i].instructions, b.frames[i].instructions) << i;
    EXPECT_EQ(a.frames[i].idle_slices, b.frames[i].idle_slices) << i;
  }
}

// With enough idle time before every frame the result depends on neither the slices' number nor their ends: a profile
// in which everything costs more or less makes the same work pause a hundred times as often, or hardly ever.
TEST(Determinism, TheCutIntoSlicesDoesNotMatter) {
  const Config config = test::config_for(recording());
  int slices = 0;
  const auto drain = [&slices](Phone& phone, int) { slices += phone.drain(); };
  const Trace usual = run(config, drain);
  const int usual_slices = slices;
  for (const float factor : {0.01f, 10.0f}) {
    Config other = config;
    for (float& cost : other.profile.instructions) cost *= factor;
    slices = 0;
    EXPECT_TRUE(run(other, drain) == usual) << "costs times " << factor;
    if (factor < 1) {
      EXPECT_LT(slices, usual_slices / 3);
    }
    if (factor > 1) {
      EXPECT_GT(slices, usual_slices * 3);
    }
  }
  // The comparison can fail: mapping that does not happen is seen.
  EXPECT_FALSE(run(config, [](Phone& phone, int) {
                 for (int i = 0; i < 200; ++i) phone->work_slice();
               }) == usual);
}

// Fifty slices after each frame, one after the other or with every question asked between them.
TEST(Determinism, LookingOnChangesNothing) {
  const Config config = test::config_for(recording());
  const Trace alone = run(config, [](Phone& phone, int) {
    for (int i = 0; i < 50; ++i) phone->work_slice();
  });
  std::vector<KeyframeInfo> keyframes(35);
  std::vector<MapPointInfo> points(1000);
  const Trace watched = run(config, [&](Phone& phone, int frame) {
    const WorkClock clock(phone->work_meter());
    for (int i = 0; i < 50; ++i) {
      if (phone->has_work()) phone->work_slice();
      phone->keyframes(std::span(keyframes).first(static_cast<size_t>(frame % 36)));
      phone->map_points(points);
      map_hash(*phone);
      phone->set_clock(i % 2 ? &clock : nullptr);
    }
    phone->set_clock(nullptr);
    for (int i = 0; i < 3 && !phone->has_work(); ++i) phone->work_slice();
  });
  EXPECT_TRUE(alone == watched);
}

}  // namespace
}  // namespace pptam
