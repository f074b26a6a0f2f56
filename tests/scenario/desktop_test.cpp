// The desktop profile (Config::desktop) and the stories made for it.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <span>
#include <vector>

#include <pocket_ptam/inspection.h>
#include "platform/run/evaluation.h"
#include "platform/run/run.h"
#include "sim_phone/desktop_stories.h"
#include "sim_phone/hand.h"
#include "tests/support/recording.h"

namespace pptam {
namespace {

using platform::RunLog;
using test::Recording;

// [ptam 7.3]: 600 frames, 18.2 m, 3 m from the walls, the walls at right angles, no return.
TEST(DesktopStories, CornerIsThePapers) {
  const sim::PhoneOptions phone = sim::phone_for_desktop_story("corner2007", 1);
  EXPECT_EQ(phone.width, 600);
  EXPECT_EQ(phone.height, 480);
  EXPECT_EQ(phone.readout_s, 0);
  EXPECT_EQ(std::lround(phone.duration_s * phone.frames_per_s), 600);
  sim::Scene empty;
  empty.stage.kind = sim::Stage::Kind::kCorner;
  const sim::Story story = sim::make_desktop_story("corner2007", empty.stage, 1);
  double length = 0, least = 1e9;
  for (int i = 1; i < 600; ++i) {
    const sim::Vector3d before = story.curve((i - 1) / 30.0).translation(), now = story.curve(i / 30.0).translation();
    length += (now - before).norm();
    least = std::min({least, now.x(), now.y()});
    EXPECT_LE(now.x(), before.x() + 1e-9);  // no return
    EXPECT_GE(now.y(), before.y() - 1e-9);
    EXPECT_EQ(now.z(), 0);
    EXPECT_LT(sim::angle_between(story.curve((i - 1) / 30.0), story.curve(i / 30.0)), 0.03) << i;
  }
  EXPECT_NEAR(length, 18.2, 0.02);
  EXPECT_NEAR(least, 3, 1e-6);
  const sim::Vector3d first = story.curve(0).linear().col(2), last = story.curve(20).linear().col(2);
  EXPECT_NEAR(first.dot(-sim::Vector3d::UnitY()), 1, 1e-9);
  EXPECT_NEAR(last.dot(-sim::Vector3d::UnitX()), 1, 1e-9);
}

// [ptam 7.1]: 1600 frames; from far and from near; one shake, whose view returns.
TEST(DesktopStories, DeskIsSeenFromFarAndNearAndShaken) {
  for (uint64_t seed = 1; seed <= 6; ++seed) {
    const sim::PhoneOptions phone = sim::phone_for_desktop_story("desk2007", seed);
    EXPECT_EQ(std::lround(phone.duration_s * phone.frames_per_s), 1600);
    sim::Scene empty;
    empty.stage.azimuth_rad = 0.7 * static_cast<double>(seed);
    empty.stage.min_height_m = 0.36;
    const sim::Story story = sim::make_desktop_story("desk2007", empty.stage, seed);
    ASSERT_EQ(story.lost.size(), 1u);
    double nearest = 1e9, farthest = 0, shaken = 0, calm = 0;
    for (int i = 1; i < 1600; ++i) {
      const double t = i / 30.0;
      const Eigen::Isometry3d T = story.curve(t);
      const double rate = 30 * sim::angle_between(story.curve(t - 1 / 30.0), T);
      const bool shake = t > story.lost[0].from_s && t < story.lost[0].to_s;
      (shake ? shaken : calm) = std::max(shake ? shaken : calm, rate);
      if (shake) continue;
      const double distance = -T.translation().z() / T.linear()(2, 2);
      nearest = std::min(nearest, distance);
      farthest = std::max(farthest, distance);
    }
    EXPECT_LT(nearest, 0.5) << seed;
    EXPECT_GT(farthest, 0.9) << seed;
    EXPECT_GT(shaken / sim::kDegree, 150) << seed;
    EXPECT_LT(calm / sim::kDegree, 75) << seed;
  }
}

const Recording& corner() {
  static const Recording made = [] {
    sim::PhoneOptions options = sim::phone_for_desktop_story("corner2007", 1);
    options.duration_s = 5;
    return test::record(options);
  }();
  return made;
}

RunLog run(platform::SystemProfile profile) {
  test::Replay camera(corner());
  platform::RunOptions options;
  options.profile = profile;
  options.drop_late = false;
  return platform::run_sequence(
      camera, options, [](const platform::CameraInfo&) {}, nullptr);
}

// Five seconds along a wall: the map grows by hundreds of points, and the pose is found from many times those that the
// phone searches, more accurately. The phone's profile on the same images is the control.
TEST(DesktopProfile, MapsAWallDensely) {
  const RunLog desktop = run(platform::SystemProfile::kDesktop), phone = run(platform::SystemProfile::kPhone);
  ASSERT_NE(desktop.first_tracked(), nullptr);
  EXPECT_EQ(desktop.tracked_fraction(), 1);
  EXPECT_GT(desktop.map_points.size(), 500u);
  EXPECT_GT(desktop.map_points.size(), 2 * phone.map_points.size());
  EXPECT_GT(desktop.frames.back().points_inliers, 120);
  EXPECT_LE(phone.frames.back().points_inliers, 50);
  EXPECT_EQ(desktop.map_parts, 1);
  const double error = platform::evaluate(desktop.trajectory(), corner().truth, "desktop", "truth").ate_rmse;
  EXPECT_LT(error, 0.006) << "metres: the paper's over the whole path";
  EXPECT_LT(error, platform::evaluate(phone.trajectory(), corner().truth, "phone", "truth").ate_rmse);
}

TEST(DesktopProfile, GivesTheSameBitsEachTime) {
  const RunLog a = run(platform::SystemProfile::kDesktop), b = run(platform::SystemProfile::kDesktop);
  EXPECT_EQ(a.map_hash, b.map_hash);
  ASSERT_EQ(a.frames.size(), b.frames.size());
  for (size_t i = 0; i < a.frames.size(); ++i) EXPECT_TRUE(a.frames[i].T_wc.matrix() == b.frames[i].T_wc.matrix()) << i;
}

// At 640x480 the sizes that the profile is for [ptam 4].
TEST(DesktopProfile, FitsItsMemory) {
  CameraModel model = corner().info.model;
  model.width = 640;
  model.height = 480;
  model.prepare();
  const Config config = Config::desktop(model);
  EXPECT_TRUE(config.validate().ok());
  EXPECT_EQ(config.max_keyframes, 100);
  EXPECT_EQ(config.max_map_points, 5000);
  EXPECT_LE(System::required_bytes(config), size_t{64} << 20);
  Config larger = config;
  larger.max_keyframes = 150;
  larger.max_map_points = 6000;
  larger.max_measurements = 59000 - 2 * 6000;
  EXPECT_LE(System::required_bytes(larger), size_t{96} << 20);
  Config absurd = config;
  absurd.max_coarse_points = absurd.max_measured_points + 1;
  EXPECT_FALSE(absurd.validate().ok());
}

// A map of the desktop profile is saved and loaded, levels of its patches included, and tracks.
TEST(DesktopProfile, ASavedMapTracks) {
  Config config = Config::desktop(corner().info.model);
  config.camera.shutter = corner().info.shutter;
  test::Phone first(config);
  first->tap();
  for (int i = 0; i < corner().size(); ++i) {
    (void)first->track(corner().frame(i));
    while (first->has_work()) first->work_slice();
  }
  std::vector<std::byte> file(first->map_bytes());
  size_t bytes = 0;
  ASSERT_TRUE(first->save_map(file, &bytes).ok());
  test::Phone second(config);
  const Status status = second->load_map(std::span(file).first(bytes));
  ASSERT_TRUE(status.ok()) << status.message();
  EXPECT_EQ(map_hash(*second), map_hash(*first));
  std::vector<std::byte> again(second->map_bytes());
  ASSERT_TRUE(second->save_map(again, &bytes).ok());
  EXPECT_EQ(again, file);
  int tracked = 0;
  for (int i = corner().size() - 30; i < corner().size(); ++i) tracked += second->track(corner().frame(i)).pose_valid;
  EXPECT_GE(tracked, 27);  // found in the second frame, confirmed in the third
}

}  // namespace
}  // namespace pptam
