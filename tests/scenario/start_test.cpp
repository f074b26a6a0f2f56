// Initialisation judged by ground truth: a small version of the initialisation study, the automatic start, the hints,
// the scale that a user gives.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include <pocket_ptam/inspection.h>
#include "platform/run/evaluation.h"
#include "platform/run/ground_view.h"
#include "platform/run/run.h"
#include "sim_phone/laboratory/start_study.h"
#include "sim_phone/phone_camera.h"
#include "tests/support/random.h"
#include "tests/support/recording.h"
#include "tests/support/sample.h"

namespace pptam {
namespace {

using laboratory::StudyTrial;
using test::Phone;
using test::Recording;
using test::sampled;

constexpr double kFollow_s = 1.5;

std::vector<StudyTrial> trials(const std::string& kind, int count, float shutter_told = 1) {
  std::vector<StudyTrial> result;
  std::shared_ptr<const sim::Scene> scene;
  for (int i = 0; i < count; ++i) {
    const uint64_t seed = static_cast<uint64_t>(i) + 1;
    if (i % 10 == 0) scene = laboratory::study_scene(kind, seed);  // shared by ten successive seeds
    result.push_back(laboratory::run_study_trial(kind, seed, kFollow_s, scene, shutter_told));
  }
  return result;
}

double median_normal_deg(const std::vector<StudyTrial>& all) {
  std::vector<double> errors;
  for (const StudyTrial& trial : all)
    if (trial.initialised) errors.push_back(trial.normal_deg);
  if (errors.empty()) return 180;
  std::sort(errors.begin(), errors.end());
  return errors[errors.size() / 2];
}

// What must hold in every trial, and how many may end without a map: of 20 trials at the wanted rate of 98 % at most
// one fails with a probability of 94 %, at a rate of 80 % with one of 7 %. Of 8 trials, the daily sample, none fails
// with 85 % and 17 %: seeds are fixed, so that a failure is a change and not chance.
void expect_good_starts(const std::vector<StudyTrial>& all, int may_fail) {
  int failed = 0;
  for (const StudyTrial& trial : all) {
    SCOPED_TRACE(trial.kind + " " + std::to_string(trial.seed));
    EXPECT_EQ(trial.trouble, "");
    EXPECT_FALSE(trial.early) << "a map without a sideways movement";
    EXPECT_FALSE(trial.wrong_plane()) << trial.normal_deg << " degrees off";
    if (trial.initialised && !trial.plane_known) {
      EXPECT_GE(trial.depth_share, laboratory::kRightDepthShare);
    }
    EXPECT_LT(trial.worst_minstructions, 6) << "a frame's budget";
    failed += trial.initialised ? 0 : 1;
  }
  EXPECT_LE(failed, may_fail);
}

// Two degrees are wanted of the median. A shutter told to run the other way and twice as long leaves three readouts of
// shear, up to 3 x 60 ms x 20 degrees/s = 3.6 degrees across the view: on the same trials that must show.
TEST(StartStudy, PlanesAreRightAndAWrongShutterIsNoticed) {
  const std::vector<StudyTrial> all = trials("planar", sampled(8, 20));
  expect_good_starts(all, sampled(0, 1));
  EXPECT_LT(median_normal_deg(all), 2);
  const int wrong = sampled(5, 10);
  const std::vector<StudyTrial> told_right(all.begin(), all.begin() + wrong);
  EXPECT_GT(median_normal_deg(trials("planar", wrong, -2)), 1.5 * median_normal_deg(told_right));
}

// A new map whose keyframes' velocities are not known well is bent, and right only after some more keyframes, or does
// not come about: with velocities from the differences between the keyframes, several frames apart, 12 % of the first
// of these runs' poses were wrong and the second had no map.
TEST(StartStudy, AnAcceleratingStartIsNotBent) {
  for (const uint64_t seed : {10u, 25u}) {
    const StudyTrial trial = laboratory::run_study_trial("planar", seed, 5, laboratory::study_scene("planar", seed));
    EXPECT_TRUE(trial.initialised) << seed;
    EXPECT_LT(trial.wrong_fraction, 0.05) << seed;
  }
}

// Half of the view is an upright board with more texture than the table that it stands on.
TEST(Ground, IsBelowAnUprightFront) {
  int maps = 0, wrong = 0;
  const int count = sampled(6, 40);
  for (int seed = 1; seed <= count; ++seed) {
    sim::PhoneOptions phone;
    phone.scene = "front";
    phone.seed = static_cast<uint64_t>(seed);
    phone.duration_s = 7;
    const std::unique_ptr<platform::Camera> camera = sim::make_phone_camera(phone);
    const platform::Trajectory truth = camera->ground_truth();
    const platform::RunLog log = platform::run_sequence(
        *camera, {}, [](const platform::CameraInfo&) {}, nullptr);
    if (log.trajectory().size() < platform::kFewPoses) continue;
    ++maps;
    wrong += platform::evaluate(log.trajectory(), truth, "run", "truth").vertical_error_deg > 10;
  }
  EXPECT_GE(maps, count - 1);
  EXPECT_LE(wrong, sampled(0, 2));  // 95 % are wanted
}

// Of a view of a board on a table both can be the ground, by the pixels that the report names. Angles of the found
// normals against the truth's, whose ground is the table.
TEST(Ground, IsWhatTheUserChooses) {
  int tables = 0, boards = 0;
  for (const uint64_t seed : {1u, 2u, 3u}) {
    sim::PhoneOptions phone;
    phone.scene = "front";
    phone.seed = seed;
    phone.duration_s = 7;
    platform::GroundView view;
    const auto run = [&](const platform::RunOptions& options) {
      const std::unique_ptr<platform::Camera> camera = sim::make_phone_camera(phone);
      return platform::run_sequence(
          *camera, options, [](const platform::CameraInfo&) {},
          [&](const Frame& frame, const TrackResult& result, const platform::RunLog&) { view.add(frame, result); });
    };
    const platform::Trajectory truth = sim::make_phone_camera(phone)->ground_truth();
    const platform::RunLog log = run({});
    const double usual_deg = platform::evaluate(log.trajectory(), truth, "run", "truth").vertical_error_deg;
    const std::vector<platform::GroundView::Choice> choices = view.choices(log);
    ASSERT_FALSE(choices.empty()) << seed;
    for (const platform::GroundView::Choice& choice : choices) {
      // Of the chosen plane as it is known at the end, which is turned by what the first ground was wrong by.
      const float cosine = log.planes[choice.plane].normal_w.z();
      const bool table = cosine > 0.9f;
      if (!table && cosine > 0.3f) continue;  // neither: a plane by chance
      platform::RunOptions options;
      options.ground = choice.px;
      const platform::RunLog chosen = run(options);
      EXPECT_TRUE(chosen.warnings.empty()) << seed << ": " << chosen.warnings.front();
      ASSERT_GT(chosen.trajectory().size(), static_cast<size_t>(platform::kFewPoses));
      const double error_deg = platform::evaluate(chosen.trajectory(), truth, "run", "truth").vertical_error_deg;
      // The first ground is right within 10 degrees of most maps, and a choice by a dozen points and more is as good.
      EXPECT_NEAR(error_deg, table ? 0 : 90, 10) << seed << ", first " << usual_deg;
      ++(table ? tables : boards);
    }
  }
  EXPECT_GE(tables, 2);
  EXPECT_GE(boards, 2);
}

TEST(StartStudy, OtherCamerasStartToo) {
  const std::vector<StudyTrial> all = trials("cameras", sampled(5, 10));
  expect_good_starts(all, sampled(0, 1));
  EXPECT_LT(median_normal_deg(all), 2);
}

TEST(StartStudy, TurningGivesNoMapAndMovingAfterwardsDoes) {
  expect_good_starts(trials("rotation", sampled(8, 20)), sampled(0, 1));
}

TEST(StartStudy, ScenesWithoutADominantPlane) {
  const std::vector<StudyTrial> all = trials("corners", sampled(8, 20));
  expect_good_starts(all, sampled(0, 1));
  int without_plane = 0;
  for (const StudyTrial& trial : all) without_plane += trial.plane_share < 0.6 ? 1 : 0;
  EXPECT_GT(2 * without_plane, static_cast<int>(all.size())) << "otherwise the trials do not test what they are for";
}

// The full-frame rotation is noise there. Where it was believed, three of these were wrong or gave no map.
TEST(StartStudy, TilesAllAlike) {
  constexpr uint64_t kFirst = 11;  // the seeds with such a table begin here
  std::vector<StudyTrial> all;
  const std::shared_ptr<const sim::Scene> scene = laboratory::study_scene("repeated", kFirst);
  for (int i = 0; i < sampled(5, 8); ++i)
    all.push_back(laboratory::run_study_trial("repeated", kFirst + static_cast<uint64_t>(i), 5, scene));
  expect_good_starts(all, 0);
  for (const StudyTrial& trial : all) {
    EXPECT_EQ(trial.phone.scene, "same_tiles");
    EXPECT_TRUE(trial.right()) << trial.seed;
  }
}

const Recording& desk() {
  static const Recording made = [] {
    sim::PhoneOptions options;
    options.scene = "desk";
    options.seed = 1;
    options.duration_s = 7;
    return test::record(options);
  }();
  return made;
}

Frame flat_frame(const Recording& recording, std::vector<uint8_t>* pixels, int64_t timestamp_ns) {
  pixels->assign(recording.images[0].size(), 128);
  Frame frame = recording.frame(0, timestamp_ns);
  frame.data = pixels->data();
  return frame;
}

// A camera that stands still, and a printed thing, 30 or 39 % of the picture, that is moved before it by up to 50 px.
// Of the scene behind the larger one too little is found to tell by what rests among the found points alone.
TEST(Start, AMovingThingBeforeAStandingCameraIsNotTheScene) {
  constexpr int kFrames = 90;
  struct Case {
    int width, height;
    bool background;
  };
  test::Random random;
  for (const auto& [width, height, background] : {Case{132, 176, true}, {150, 200, true}, {132, 176, false}}) {
    Config config = test::config_for(desk());
    config.camera.shutter = {};
    Phone phone(config);
    phone->tap();
    bool mapped = false;
    for (int i = 0; i < kFrames; ++i) {
      std::vector<uint8_t> pixels = background ? desk().images[0] : std::vector<uint8_t>(desk().images[0].size(), 128);
      const std::vector<uint8_t>& print = desk().images[60];
      const double turn = 6.283185 * std::max(i - 10, 0) / 75;
      const int aside = std::min((240 - width) / 2, 50);
      const int left = (240 - width) / 2 + static_cast<int>((aside - 1) * std::sin(turn)),
                top = (320 - height) / 2 + static_cast<int>(20 * std::sin(1.5 * turn));
      for (int y = 0; y < height; ++y)
        std::copy_n(print.begin() + (y + 70) * 240 + 50, width, pixels.begin() + (y + top) * 240 + left);
      for (uint8_t& pixel : pixels) pixel = static_cast<uint8_t>(std::clamp(pixel + random.integer(-2, 2), 0, 255));
      Frame frame = desk().frame(0, i * 66'666'667ll + 1);
      frame.data = pixels.data();
      const TrackResult result = phone->track(frame);
      ASSERT_TRUE(result.status.ok());
      phone.drain();
      mapped |= result.pose_valid;
    }
    EXPECT_EQ(mapped, !background) << (background ? ""
                                                  : "control: before nothing, its motion is as good as the camera's");
  }
}

// Without a tap: only with auto_start, after a rest of 0.3 s, and again after the first view was lost.
TEST(Start, BeginsByItselfWhenAskedTo) {
  for (const bool auto_start : {true, false}) {
    Config config = test::config_for(desk());
    config.auto_start = auto_start;
    Phone phone(config);
    int first_initialising = -1, first_pose = -1;
    for (int i = 0; i < desk().size(); ++i) {
      const TrackResult result = phone->track(desk().frame(i));
      phone.drain();
      if (first_initialising < 0 && result.state == TrackingState::kInitialising) first_initialising = i;
      if (first_pose < 0 && result.pose_valid) first_pose = i;
      if (!auto_start) {
        EXPECT_EQ(result.state, TrackingState::kWaiting) << i;
        EXPECT_EQ(result.hint, Hint::kTap) << i;
      } else if (first_initialising < 0) {
        EXPECT_EQ(result.hint, Hint::kHoldStill) << i;
      }
    }
    if (!auto_start) continue;
    // 0.3 s are five intervals at 15 frames/s, the first of them ends with the second frame.
    EXPECT_GE(first_initialising, 5);
    EXPECT_LE(first_initialising, 10);
    EXPECT_GT(first_pose, 0);
  }
}

TEST(Start, BeginsAgainByItselfAfterTheFirstViewWasLost) {
  Config config = test::config_for(desk());
  config.auto_start = true;
  Phone phone(config);
  std::vector<uint8_t> flat;
  std::set<Hint> hints;
  const int64_t frame_ns = desk().timestamps_ns[1];
  int64_t now_ns = 0;
  TrackingState state = TrackingState::kWaiting;
  for (int i = 0; i < 12; ++i, now_ns += frame_ns) state = phone->track(desk().frame(i, now_ns)).state;
  EXPECT_EQ(state, TrackingState::kInitialising);
  for (int i = 0; i < 20; ++i, now_ns += frame_ns) {  // a covered lens
    const TrackResult result = phone->track(flat_frame(desk(), &flat, now_ns));
    state = result.state;
    hints.insert(result.hint);
  }
  EXPECT_EQ(state, TrackingState::kWaiting);
  EXPECT_TRUE(hints.count(Hint::kStartLost)) << "the user is told";
  EXPECT_TRUE(hints.count(Hint::kTooLittleTexture)) << "and why it does not begin again";
  bool tracked = false;
  for (int i = 0; i < desk().size(); ++i, now_ns += frame_ns) {
    tracked |= phone->track(desk().frame(i, now_ns)).pose_valid;
    phone.drain();
  }
  EXPECT_TRUE(tracked);
}

// The hand holds still for a second, then moves: at four times the speed (the same frames, a quarter of the time
// between them) the first view cannot be taken on the way, and what follows is blurred.
TEST(Start, SaysHoldStillAndTooFast) {
  const auto hints_at = [](int first, int64_t slower) {
    Phone phone(test::config_for(desk()));
    std::set<Hint> hints;
    for (int i = first; i < 40; ++i) {
      if (i == first + 1) phone->tap();
      hints.insert(phone->track(desk().frame(i, desk().timestamps_ns[static_cast<size_t>(i)] * slower / 4)).hint);
    }
    return hints;
  };
  EXPECT_TRUE(hints_at(22, 1).count(Hint::kHoldStill));
  EXPECT_FALSE(hints_at(2, 4).count(Hint::kHoldStill)) << "a calm hand at rest";
  EXPECT_TRUE(hints_at(10, 1).count(Hint::kTooFast));
  EXPECT_FALSE(hints_at(10, 4).count(Hint::kTooFast)) << "a calm hand's movement";
}

// A first view that nothing comes of is replaced after ten seconds; then the story goes on as if nothing had happened.
TEST(Start, TenSecondsOfRestDoNoHarm) {
  Phone phone(test::config_for(desk()));
  phone->tap();
  const int64_t frame_ns = desk().timestamps_ns[1];
  int64_t now_ns = 0;
  for (int i = 0; i < 170; ++i, now_ns += frame_ns) {  // 11 s: the first second forth and back
    const int k = i % 20 < 10 ? i % 10 : 9 - i % 10;
    const TrackResult result = phone->track(desk().frame(k, now_ns));
    ASSERT_EQ(result.state, TrackingState::kInitialising) << i;
    ASSERT_EQ(result.keyframes, 0) << i;
  }
  bool tracked = false;
  for (int i = 0; i < desk().size(); ++i, now_ns += frame_ns) {
    tracked |= phone->track(desk().frame(i, now_ns)).pose_valid;
    phone.drain();
  }
  EXPECT_TRUE(tracked);
}

// The desk's plane is z = 0 in the truth: the first camera's height is its distance. The tap comes with the first
// frame.
TEST(Start, KnownPlaneDistanceSetsTheScale) {
  const double height = desk().truth.front().T_wc.translation().z();
  for (const bool known : {true, false}) {
    Config config = test::config_for(desk());
    if (known) config.initial_plane_distance = static_cast<float>(height);
    Phone phone(config);
    phone->tap();
    int poses = 0;
    double worst = 0;
    for (int i = 0; i < desk().size(); ++i) {
      const TrackResult result = phone->track(desk().frame(i));
      phone.drain();
      if (!result.pose_valid) continue;
      ++poses;
      const double truth = desk().truth[static_cast<size_t>(i)].T_wc.translation().z();
      worst = std::max(worst, std::abs(static_cast<double>(result.T_cw.centre().z()) / truth - 1));
    }
    EXPECT_GT(poses, 30);
    // A normal off by 2 degrees at a slant of up to 42 changes the distance to the plane by tan(42) * 0.035 = 3 %, and
    // the same again as the camera moves.
    if (known) {
      EXPECT_LT(worst, 0.06);
    } else {
      EXPECT_GT(worst, 0.06) << "the baseline of 0.1 says nothing about metres";
    }
  }
}

TEST(Start, KnownLengthBetweenTwoPointsRescalesTheWorld) {
  Phone phone(test::config_for(desk()));
  EXPECT_FALSE(phone->set_length(1, 2, 1.0f).ok()) << "there is no map";
  phone->tap();
  const int middle = 75;
  SE3 T_before;
  for (int i = 0; i < middle; ++i) {
    const TrackResult result = phone->track(desk().frame(i));
    phone.drain();
    if (result.pose_valid) T_before = result.T_cw;
  }
  std::vector<MapPointInfo> points(static_cast<size_t>(phone->map_points({})));
  ASSERT_GE(phone->map_points(points), 20);
  const uint32_t a = points.front().id, b = points.back().id;
  const float present = (points.front().p_w - points.back().p_w).norm();
  const uint64_t hash = map_hash(*phone);
  EXPECT_FALSE(phone->set_length(a, a, 1.0f).ok());
  EXPECT_FALSE(phone->set_length(a, 4000000000u, 1.0f).ok());
  EXPECT_FALSE(phone->set_length(a, b, std::nanf("")).ok());
  EXPECT_FALSE(phone->set_length(a, b, -1.0f).ok());
  EXPECT_FALSE(phone->set_length(a, b, 0.0f).ok());
  EXPECT_EQ(map_hash(*phone), hash) << "refused: nothing has changed";

  // Twice, between two frames: both count.
  EXPECT_TRUE(phone->set_length(a, b, 3 * present).ok());
  EXPECT_TRUE(phone->set_length(a, b, 5 * present).ok());
  int tracked = 0;
  SE3 T_after;
  for (int i = middle; i < desk().size(); ++i) {
    const TrackResult result = phone->track(desk().frame(i));
    phone.drain();
    if (!result.pose_valid) continue;
    if (tracked++ == 0) T_after = result.T_cw;
  }
  EXPECT_EQ(tracked, desk().size() - middle) << "tracking goes on";
  // One frame's movement is at most 0.2 m/s / 15 = 13 mm of the half metre to the desk.
  EXPECT_LT((T_after.centre() / 5 - T_before.centre()).norm(), 0.05f * T_before.centre().norm());
  EXPECT_GT((T_after.centre() - T_before.centre()).norm(), 1.0f * T_before.centre().norm());
}

TEST(Ground, ChangesOnlyTheCoordinates) {
  Phone phone(test::config_for(desk()));
  const Vector2f middle_px(120, 160);
  EXPECT_EQ(phone->set_ground(middle_px).code(), StatusCode::kNotReady) << "there is no map";
  phone->tap();
  const int middle = 75;
  TrackResult before;
  for (int i = 0; i < middle; ++i) {
    before = phone->track(desk().frame(i));
    phone.drain();
  }
  ASSERT_TRUE(before.pose_valid);
  EXPECT_EQ(before.world_changes, 0);
  std::vector<MapPointInfo> old_points(static_cast<size_t>(phone->map_points({})));
  phone->map_points(old_points);
  const uint64_t hash = map_hash(*phone);
  for (const Vector2f& px : {Vector2f(-1, 5), Vector2f(5, 320), Vector2f(std::nanf(""), 5), Vector2f(5, INFINITY)})
    EXPECT_EQ(phone->set_ground(px).code(), StatusCode::kInvalidArgument) << px.transpose();
  EXPECT_EQ(map_hash(*phone), hash) << "refused: nothing has changed";

  Similarity change;
  ASSERT_TRUE(phone->set_ground(middle_px, &change).ok());
  EXPECT_EQ(change.scale, 1);
  std::vector<MapPointInfo> points(static_cast<size_t>(phone->map_points({})));
  phone->map_points(points);
  ASSERT_EQ(points.size(), old_points.size());
  const float depth = before.T_cw.centre().norm();
  for (size_t i = 0; i < points.size(); ++i)
    EXPECT_LT((points[i].p_w - change * old_points[i].p_w).norm(), 1e-5f * depth);  // rounding of a few operations
  // The origin is at the pixel, z towards the camera.
  const SE3 T_now = change.moved(before.T_cw);
  PredictedPoint seen;
  ASSERT_TRUE(phone->config().camera.project_rolling(T_now, before.velocity, Vector3f::Zero(), &seen));
  EXPECT_LT((seen.px - middle_px).norm(), 0.05f);  // what project_rolling() leaves (camera.h)
  EXPECT_GT(T_now.centre().z(), 0.1f * depth);
  // The desk's plane is the ground already: z hardly turns. Its points scatter by some hundredths of the depth.
  EXPECT_GT(change.T.R(2, 2), 0.99f);
  PlaneInfo planes[2];
  ASSERT_GE(phone->planes(planes), 1);
  EXPECT_GT(planes[0].normal_w.z(), 0.99f);
  EXPECT_LT(std::abs(planes[0].middle_w.z()), planes[0].threshold);

  for (int i = middle; i < desk().size(); ++i) {
    const TrackResult result = phone->track(desk().frame(i));
    phone.drain();
    ASSERT_TRUE(result.pose_valid) << i;
    EXPECT_EQ(result.world_changes, 1);
    if (i == middle) {  // 13 mm a frame
      EXPECT_LT((result.T_cw.centre() - T_now.centre()).norm(), 0.05f * depth);
    }
  }
}

// The slice that finishes the map changes its coordinates, and the length does so again before the next frame.
TEST(Start, LengthSetDirectlyAfterTheMapIsFinishedKeepsTheView) {
  Phone phone(test::config_for(desk()));
  phone->tap();
  bool set = false;
  int after = 0, tracked = 0;
  for (int i = 0; i < desk().size(); ++i) {
    const TrackResult result = phone->track(desk().frame(i));
    after += set;
    tracked += set && result.pose_valid;
    while (phone->has_work()) {
      phone->work_slice();
      if (set || phone->map_bytes() == 0) continue;
      std::vector<MapPointInfo> points(static_cast<size_t>(phone->map_points({})));
      phone->map_points(points);
      const float present = (points.front().p_w - points.back().p_w).norm();
      set = phone->set_length(points.front().id, points.back().id, 7 * present).ok();
      ASSERT_TRUE(set);
    }
  }
  EXPECT_GT(after, 30);
  EXPECT_EQ(tracked, after);
}

// A millionth and a million times are accepted once; what would leave the usable numbers is refused, and what is
// accepted can be tracked and saved.
TEST(Start, LengthsThatLeaveTheUsableNumbersAreRefused) {
  for (const float factor : {1e-5f, 1e5f}) {
    Phone phone(test::config_for(desk()));
    phone->tap();
    const int middle = 75;
    for (int i = 0; i < middle; ++i) {
      phone->track(desk().frame(i));
      phone.drain();
    }
    std::vector<MapPointInfo> points(static_cast<size_t>(phone->map_points({})));
    ASSERT_GE(phone->map_points(points), 20);
    float length = (points.front().p_w - points.back().p_w).norm();
    Status status;
    int accepted = 0;
    for (; accepted < 10; ++accepted) {
      status = phone->set_length(points.front().id, points.back().id, length * factor);
      if (!status.ok()) break;
      length *= factor;
    }
    EXPECT_EQ(accepted, 1) << "1e-10 and 1e10 are beyond the limits of 1e-8 and 1e8";
    EXPECT_NE(std::string(status.message()).find("another unit"), std::string::npos) << status.message();
    int tracked = 0;
    for (int i = middle; i < desk().size(); ++i) {
      tracked += phone->track(desk().frame(i)).pose_valid;
      phone.drain();
    }
    EXPECT_EQ(tracked, desk().size() - middle) << factor;
    std::vector<std::byte> file(phone->map_bytes());
    size_t bytes = 0;
    EXPECT_TRUE(phone->save_map(file, &bytes).ok()) << factor;
  }
}

}  // namespace
}  // namespace pptam
