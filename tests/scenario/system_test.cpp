// Stories on the emulated phone, with the truth beside them: start, explore, rotate only, lose the view and find it
// again.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <functional>
#include <tuple>
#include <utility>

#include "platform/run/evaluation.h"
#include "platform/run/run.h"
#include "tests/support/phone_camera.h"
#include "tests/support/random.h"
#include "tests/support/recording.h"

namespace pptam {
namespace {

using platform::RunLog;
using test::Phone;
using test::Recording;
using test::Replay;

constexpr double kMaxStart_s = 5;

Recording record(const std::string& scene, const std::string& motion, uint64_t seed, double duration_s,
                 double drop_probability = 0) {
  sim::PhoneOptions options;
  options.scene = scene;
  options.motion = motion;
  options.seed = seed;
  options.duration_s = duration_s;
  options.drop_probability = drop_probability;
  return test::record(options);
}

RunLog run(const Recording& recording) {
  Replay camera(recording);
  return platform::run_sequence(
      camera, {}, [](const platform::CameraInfo&) {},
      [](const Frame&, const TrackResult& result, const RunLog&) {
        EXPECT_TRUE(result.status.ok());
        EXPECT_TRUE(!result.pose_valid || result.state == TrackingState::kTracking);
      });
}

// From the third second on the hand has moved 5 cm or more sideways; a map must stand by the fifth. After that every
// pose must be right, which leaves a tenth of the path's extent; as a root mean square it must be three times better:
// at half a metre a pixel is 1.4 mm, and 30 mm would be an error of 20 pixels.
void expect_good(const Recording& recording, const RunLog& log) {
  ASSERT_NE(log.first_tracked(), nullptr) << "no map was made";
  EXPECT_LT(log.seconds(log.first_tracked()->timestamp_ns), kMaxStart_s);
  const platform::Evaluation evaluation = platform::evaluate(log.trajectory(), recording.truth, "run", "truth");
  EXPECT_EQ(evaluation.wrong_poses, 0);
  EXPECT_LT(evaluation.ate_rmse, evaluation.extent / 30);
  EXPECT_GT(log.tracked_fraction(), 0.9);
  // The same measures on a trajectory that stands still, which is what a tracker that sees nothing would report.
  platform::Trajectory frozen = log.trajectory();
  test::Random random;
  for (platform::StampedPose& pose : frozen) {
    pose.T_wc = frozen.front().T_wc;
    for (int i = 0; i < 3; ++i) pose.T_wc.translation()(i) += 1e-3 * random.gaussian();
  }
  EXPECT_GT(platform::evaluate(frozen, recording.truth, "frozen", "truth").ate_rmse, evaluation.extent / 30);
}

class Explore : public ::testing::TestWithParam<std::tuple<const char*, uint64_t>> {};

TEST_P(Explore, StartsInTimeAndTracksTruly) {
  const Recording recording = record(std::get<0>(GetParam()), "calm", std::get<1>(GetParam()), 9);
  const RunLog log = run(recording);
  expect_good(recording, log);
  EXPECT_EQ(log.dropped, 0) << "the phone keeps up";
  EXPECT_GE(log.keyframes.size(), 3u);
}

INSTANTIATE_TEST_SUITE_P(Scenes, Explore,
                         ::testing::Combine(::testing::Values("desk", "boxes", "walls"), ::testing::Values(1, 2)),
                         [](const auto& suite_info) {
                           return std::string(std::get<0>(suite_info.param)) + "_" +
                                  std::to_string(std::get<1>(suite_info.param));
                         });

TEST(System, SurvivesAThirdOfTheFramesDropped) {
  const Recording recording = record("desk", "calm", 1, 9, 0.3);
  const RunLog log = run(recording);
  expect_good(recording, log);
}

// Where depth cannot be seen no map may be made, however long it goes on.
TEST(System, RotationAloneMakesNoMap) {
  for (const char* scene : {"desk", "walls"}) {
    const RunLog log = run(record(scene, "pure_rotation", 1, 8));
    EXPECT_EQ(log.first_tracked(), nullptr) << scene;
    EXPECT_TRUE(log.keyframes.empty()) << scene;
    bool told = false;
    for (const platform::FrameLog& frame : log.frames) told = told || frame.hint == Hint::kOnlyRotating;
    EXPECT_TRUE(told) << scene << ": the user is told";
  }
}

// Under a wrong field of view turning looks like motion past a plane: without the check that is for it, a map is made
// within three seconds in each of these.
TEST(System, RotationAloneMakesNoMapUnderAWrongFocalLength) {
  for (const char* scene : {"desk", "walls"}) {
    Recording recording = record(scene, "pure_rotation", 1, 8);
    const CameraModel model = recording.info.model;
    for (const float factor : {0.5f, 0.8f, 1.25f, 2.0f}) {
      recording.info.model.fx = factor * model.fx;
      recording.info.model.fy = factor * model.fy;
      const RunLog log = run(recording);
      EXPECT_EQ(log.first_tracked(), nullptr) << scene << ", " << factor;
      EXPECT_TRUE(log.keyframes.empty()) << scene << ", " << factor;
    }
  }
}

TEST(System, HoldingStillMakesNoMap) {
  for (const char* scene : {"desk", "boxes"}) {
    const RunLog log = run(record(scene, "still", 1, 6));
    EXPECT_EQ(log.first_tracked(), nullptr) << scene;
    EXPECT_TRUE(log.keyframes.empty()) << scene;
    bool initialising = false;
    for (const platform::FrameLog& frame : log.frames) initialising |= frame.state == TrackingState::kInitialising;
    EXPECT_TRUE(initialising) << scene << ": it waits for the user to move";
  }
}

// Two seconds without a view in the middle of tracking: a covered lens, a lamp, noise. Then the last good view returns.
TEST(System, LosesTheViewSaysSoAndFindsItAgain) {
  const Recording recording = record("desk", "calm", 2, 8);
  const int last = recording.size() - 1;
  for (const char* cover : {"black", "white", "noise"}) {
    SCOPED_TRACE(cover);
    test::Random random;
    Phone phone(test::config_for(recording));
    phone->tap();
    SE3 T_before;
    bool tracked = false;
    for (int i = 0; i <= last; ++i) {
      const TrackResult result = phone->track(recording.frame(i));
      phone.drain();
      tracked = result.pose_valid;
      if (result.pose_valid) T_before = result.T_cw;
    }
    ASSERT_TRUE(tracked);

    Recording covered = recording;
    int64_t now_ns = recording.timestamps_ns.back();
    const int64_t frame_ns = now_ns / last;
    int lost_after = -1;
    for (int i = 0; i < 30; ++i) {
      for (uint8_t& pixel : covered.images[0]) {
        pixel = cover[0] == 'b' ? 0 : cover[0] == 'w' ? 255 : static_cast<uint8_t>(random.integer(0, 255));
      }
      now_ns += frame_ns;
      const TrackResult result = phone->track(covered.frame(0, now_ns));
      phone.drain();
      EXPECT_FALSE(result.pose_valid) << i;
      EXPECT_FALSE(result.keyframe_added) << i;
      if (lost_after < 0 && result.state == TrackingState::kLost) lost_after = i;
      if (lost_after >= 0) {
        EXPECT_EQ(result.state, TrackingState::kLost) << i;
      }
      if (lost_after >= 0) {
        EXPECT_EQ(result.hint, Hint::kReturnToKnownView) << i;
      }
    }
    // Three bad frames make a lost view; half a second is what a user would call at once.
    EXPECT_GE(lost_after, 0);
    EXPECT_LE(lost_after, 7);

    int found_after = -1;
    for (int i = 0; i < 15; ++i) {
      now_ns += frame_ns;
      const TrackResult result = phone->track(recording.frame(last, now_ns));
      phone.drain();
      if (!result.pose_valid) continue;
      if (found_after < 0) found_after = i;
      // The same image has the same pose, up to the rolling shutter: the view that moved at up to 0.2 m/s and 24
      // degrees/s now comes with a rotation measured as zero. Half a readout of that is 6 mm and 0.7 degrees; the map
      // has kept on settling besides: a twentieth of the distance (3 cm at half a metre) and 2 degrees.
      const float height = std::abs(T_before.centre().z());
      EXPECT_LT((result.T_cw.centre() - T_before.centre()).norm(), 0.05f * height) << i;
      EXPECT_LT(so3_log(result.T_cw.R * T_before.R.transpose()).norm(), 0.035f) << i;
    }
    EXPECT_GE(found_after, 0) << "within a second of the view's return";
  }
}

// Frames that no scene makes, between frames of a map that is tracked: nothing is believed of them that is not there, a
// frozen picture keeps its pose, and tracking goes on afterwards where it should.
TEST(System, HostileFramesAreNotBelieved) {
  sim::PhoneOptions options;
  options.scene = "desk";
  options.duration_s = 8;
  const test::Recording recording = test::record(options);
  constexpr int kFirst = 75, kHostile = 8;
  const size_t pixels = recording.images[0].size();
  test::Random random;
  const auto run = [&](const std::function<std::vector<uint8_t>(int)>& image, std::vector<TrackResult>* hostile) {
    test::Phone phone(test::config_for(recording));
    phone->tap();
    int64_t shift_ns = 0;
    std::vector<TrackResult> results;
    const auto step = [&](Frame frame) {
      const TrackResult result = phone->track(frame);
      phone.drain();
      return result;
    };
    for (int i = 0; i < recording.size(); ++i) {
      const int64_t timestamp_ns = recording.timestamps_ns[static_cast<size_t>(i)];
      if (i == kFirst && image) {
        for (int k = 0; k < kHostile; ++k) {
          const std::vector<uint8_t> made = image(k);
          Frame frame = recording.frame(i, timestamp_ns + shift_ns);
          frame.data = made.data();
          hostile->push_back(step(frame));
          shift_ns += 66'666'667;
        }
      }
      results.push_back(step(recording.frame(i, timestamp_ns + shift_ns)));
    }
    return results;
  };
  const std::vector<TrackResult> control = run(nullptr, nullptr);
  ASSERT_TRUE(control[kFirst - 1].pose_valid);
  ASSERT_TRUE(control.back().pose_valid);

  const struct {
    const char* name;
    std::function<std::vector<uint8_t>(int)> image;
    bool frozen;
  } cases[] = {
      {"black", [&](int) { return std::vector<uint8_t>(pixels, 0); }, false},
      {"white", [&](int) { return std::vector<uint8_t>(pixels, 255); }, false},
      {"noise",
       [&](int) {
         std::vector<uint8_t> made(pixels);
         for (uint8_t& p : made) p = static_cast<uint8_t>(random.uniform(0, 255.9));
         return made;
       },
       false},
      {"frozen", [&](int) { return recording.images[kFirst - 1]; }, true},
  };
  for (const auto& hostile_case : cases) {
    SCOPED_TRACE(hostile_case.name);
    std::vector<TrackResult> hostile;
    const std::vector<TrackResult> results = run(hostile_case.image, &hostile);
    ASSERT_EQ(hostile.size(), static_cast<size_t>(kHostile));
    for (const TrackResult& result : hostile) EXPECT_TRUE(result.status.ok());
    for (const TrackResult& result : hostile) EXPECT_EQ(result.pose_valid, hostile_case.frozen);
    if (hostile_case.frozen) {
      // The picture's own pose, to the bit: nothing was searched in it.
      for (const TrackResult& result : hostile) {
        EXPECT_TRUE(result.repeated);
        EXPECT_EQ(result.T_cw.t, control[kFirst - 1].T_cw.t);
      }
      EXPECT_FALSE(results[kFirst].repeated);
    } else {
      EXPECT_EQ(hostile.back().state, TrackingState::kLost);
      EXPECT_EQ(hostile.back().hint, Hint::kReturnToKnownView);
    }
    // Back within a second, at the same place as without the interruption, to the error that two maps of one scene may
    // differ by: 2 % of the distance to the table; a pose of any other keyframe is off by more.
    const size_t later = kFirst + 15;
    EXPECT_TRUE(results[later].pose_valid);
    const float distance = std::abs(control[later].T_cw.centre().z());
    std::printf(
        "  %s: off by %.2f %%\n", hostile_case.name,
        static_cast<double>(100 * (results[later].T_cw.centre() - control[later].T_cw.centre()).norm() / distance));
    EXPECT_LT((results[later].T_cw.centre() - control[later].T_cw.centre()).norm(), 0.02f * distance);
    EXPECT_GT((results[later].T_cw.centre() - control[kFirst - 40].T_cw.centre()).norm(), 0.02f * distance)
        << "control: the measure can fail";
  }
}

TEST(System, ThePhoneFitsInTenAndAHalfMebibytes) {
  const size_t bytes = System::required_bytes(Config::phone(test::phone_camera()));
  EXPECT_GT(bytes, 35u * 240 * 320) << "the keyframes' images alone take that";
  EXPECT_LE(bytes, 21u << 19);
  RecordProperty("bytes", std::to_string(bytes));
}

TEST(System, TheTinyProfileFitsInOneAndAHalfMegabytes) {
  for (const auto& [width, height] : {std::pair(192, 144), {144, 192}, {176, 144}, {160, 120}, {120, 160}}) {
    CameraModel camera = test::phone_camera();
    camera.width = width;
    camera.height = height;
    camera.cx = 0.5f * static_cast<float>(width - 1);
    camera.cy = 0.5f * static_cast<float>(height - 1);
    const size_t bytes = System::required_bytes(Config::tiny(camera));
    EXPECT_GT(bytes, size_t{10} * width * height) << "the keyframes' images alone take that";
    EXPECT_LE(bytes, 3u << 19) << width << "x" << height;
  }
}

// Seen by such a camera the emulated desk starts, is mapped, and is tracked to its end at the right place.
TEST(System, TheTinyProfileTracksADesk) {
  sim::PhoneOptions options;
  options.duration_s = 8;
  options.width = 120;
  options.height = 160;
  const test::Recording desk = test::record(options);
  Config config = Config::tiny(desk.info.model);
  config.camera.shutter = desk.info.shutter;
  config.exposure_s = desk.info.exposure_s;
  test::Phone phone(config);
  phone->tap();
  int poses = 0, since_first = 0;
  for (int i = 0; i < desk.size(); ++i) {
    const TrackResult result = phone->track(desk.frame(i));
    poses += result.pose_valid;
    since_first += poses > 0;
    for (int slice = 0; slice < 60 && phone->has_work(); ++slice) phone->work_slice();
  }
  EXPECT_GT(poses, 60);
  EXPECT_GE(poses, since_first * 95 / 100);

  // Control: with the phone profile, whose patches are searched in an image of 60x80, there are too few corners.
  test::Phone other(test::config_for(desk));
  other->tap();
  int others = 0;
  for (int i = 0; i < desk.size(); ++i) {
    others += other->track(desk.frame(i)).pose_valid;
    for (int slice = 0; slice < 60 && other->has_work(); ++slice) other->work_slice();
  }
  EXPECT_LT(others, poses);
}

}  // namespace
}  // namespace pptam
