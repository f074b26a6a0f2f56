// What a frame of the model-based tracker costs on the phone's ARM1176, counted: a box that sways, 320x240, its sites
// 200 on average in the finest level; then one half of it covered, then all of it.
#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

#include "tests/budget/count_table.h"
#include "tests/support/rendered_object.h"
#include "tests/support/tracker_in_memory.h"

namespace pptam {
namespace {

using test::Counts;

TEST(Budget, OfAModelFrame) {
  if (!test::kPhone || !test::counter_available())
    GTEST_SKIP() << "nothing counts instructions here: tests/run.sh runs this on an emulated ARM1176";
  test::RenderedObject object;
  object.add_box(Vector3f::Zero(), Vector3f(0.2f, 0.15f, 0.1f));
  ModelTrackerConfig config;
  config.camera.model.width = 320;
  config.camera.model.height = 240;
  config.camera.model.fx = config.camera.model.fy = 320;
  config.camera.model.cx = 159.5f;
  config.camera.model.cy = 119.5f;
  config.camera.model.prepare();
  config.model = object.model();
  const auto pose = [](int i) {
    const float t = static_cast<float>(i);
    Vector6f mu;
    mu << 0, 0, 0, 0.5f + 0.012f * t, 0.5f - 0.01f * t, 0.004f * t;
    SE3 T = SE3::exp(mu);
    T.t = Vector3f(0.002f * t - 0.02f, 0.0015f * t - 0.02f, 0.48f);
    return T;
  };
  test::TrackerInMemory tracker(config);
  ASSERT_TRUE(tracker->start(pose(0)).ok());
  std::vector<Counts> frames;
  Counts start;
  int sites = 0;
  constexpr int kFrames = 12;
  for (int i = 0; i < kFrames; ++i) {
    const std::vector<uint8_t> image = object.render(config.camera, pose(i));
    ModelResult r;
    const Counts spent = test::count([&] { r = tracker.track(image); });
    ASSERT_TRUE(r.pose_valid);
    if (i == 0) {
      start = spent;
      continue;
    }
    frames.push_back(spent);
    sites += r.sites_visible;
  }
  EXPECT_NEAR(sites / (kFrames - 1), 200, 10);
  // A grey bar comes before the left half: six searches from other poses and farther are tried, until it has gone.
  std::vector<Counts> covered, lost;
  int poses = 0;
  for (int i = kFrames; i < kFrames + 8; ++i) {
    std::vector<uint8_t> image = object.render(config.camera, pose(i));
    for (int y = 0; y < 240; ++y) std::fill_n(&image[static_cast<size_t>(y * 320)], 150, uint8_t{128});
    ModelResult r;
    covered.push_back(test::count([&] { r = tracker.track(image); }));
    poses += r.pose_valid;
  }
  EXPECT_EQ(poses, 8);
  const std::vector<uint8_t> nothing(320 * 240, 90);
  for (int i = 0; i < 10; ++i) {
    ModelResult r;
    const Counts spent = test::count([&] { r = tracker.track(nothing); });
    if (i >= 4 && r.state == ModelState::kLost) lost.push_back(spent);
  }
  ASSERT_EQ(lost.size(), 6u);
  test::Table table("a model's frame on an ARM1176, 200 sites");
  table.add("frame, median", test::median(frames), 2.5e6);
  table.add("frame, worst", test::worst(frames), 2.5e6);
  table.add("half covered, median", test::median(covered), 13e6);
  table.add("half covered, worst", test::worst(covered), 14e6);
  table.add("lost, median", test::median(lost), 24e6);
  table.add("start", start, 60e6);
  table.print();
  table.check(PPTAM_EDGE_COUNTS);
}

}  // namespace
}  // namespace pptam
