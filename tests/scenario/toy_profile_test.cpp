// A profile that core knows nothing of: an initialiser, a point source and a culling of its own, larger images, other
// levels. What Config promises is that such a one is written and built without a changed line in core/, and that the
// parts which it does not name are not linked (tests/structure/unlinked_parts.cmake looks at this executable).
//
// Two views with known poses start the map; every new keyframe's corners are searched along their epipolar lines in the
// nearest one and become map points at once, as in the 2007 PTAM. 640x480, 60 degrees, global shutter, 200 measured
// points; corners in L0, new points' second measurements in L1, tracking in L2, wide searches in L3.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <pocket_ptam/pocket_ptam.h>
#include "geometry/two_view.h"
#include "image/corner_source.h"
#include "map/patch_search.h"
#include "mapping/keyframe_culling.h"
#include "mapping/point_source.h"
#include "sim_phone/scene.h"
#include "tests/support/alignment.h"
#include "tests/support/recording.h"
#include "tracking/initialiser.h"

namespace pptam {
namespace {

using Eigen::Vector3d;

// ---- the toy profile ----

constexpr uint8_t kCornerLevel = 0, kNewPointLevel = 1, kSearchLevel = 2, kCoarseLevel = 3;
constexpr float kFinalError_px = 4.0f;  // a triangulated point's from what was measured: one pixel of L2, as tracked

// The map's start for a camera that runs on a rail before a plane, z = 0 of the rail's world, and says where it stands.
// Parts are built by functions of fixed signature, so that the rail is told past Config.
const platform::Trajectory* rail = nullptr;

class RailInitialiser final : public Initialiser {
 public:
  RailInitialiser(Arena& arena, const Config& config, WorkMeter& meter, CornerSource* corner_source)
      : config_(config),
        meter_(meter),
        corner_source_(corner_source),
        corners_(arena, config.max_initial_points),
        first_(arena, config.camera.model),
        last_(arena, config.camera.model) {}

  Hint start(const FrameInput& frame, const Vector3f&) override {
    corners_.resize(corners_.capacity());
    corners_.resize(corner_source_->detect(frame.pyramid(), corners_));
    if (corners_.size() < kMinInitialPoints) return Hint::kTooLittleTexture;
    take(frame, &first_);
    previous_ = first_.T_kw;
    report_ = {};
    active_ = true;
    return Hint::kNone;
  }
  Progress track(const FrameInput& frame, const Matrix3f&) override {
    const SE3 T_cw = pose(frame.timestamp_ns());
    velocity_ = (T_cw * previous_.inverse()).log() / frame.dt_s();
    previous_ = T_cw;
    report_.hint = Hint::kMoveSideways;
    report_.progress = std::min(1.0f, (T_cw.centre() - first_.T_kw.centre()).norm() / (kBaseline * first_.mean_depth));
    if (report_.progress < 1) return Progress::kTracking;
    take(frame, &last_);
    return Progress::kDone;
  }
  bool build(Map& map, SE3* T_cw, Vector6f* velocity) override {
    *T_cw = last_.T_kw;
    *velocity = velocity_;
    if (map.add_keyframe(first_) == 0 && map.add_keyframe(last_) == 1 && add_points(map) >= kMinInitialPoints)
      return true;
    map.clear();
    return false;
  }
  void reset() override { active_ = false; }
  bool active() const override { return active_; }
  const Report& report() const override { return report_; }

 private:
  static constexpr float kBaseline = 0.1f;  // depths: a search's 0.3 px are 0.5 % of a depth there

  static SE3 pose(int64_t timestamp_ns) {
    for (const platform::StampedPose& stamped : *rail)
      if (stamped.timestamp_ns == timestamp_ns) {
        const Eigen::Isometry3d T_cw = stamped.T_wc.inverse();
        return {T_cw.linear().cast<float>(), T_cw.translation().cast<float>()};
      }
    ADD_FAILURE() << "not on the rail at " << timestamp_ns << " ns";
    return {};
  }
  // Where a pixel's ray meets the plane, world.
  Vector3f on_plane(const SE3& T_cw, const Vector2f& px) const {
    const Vector2f x = config_.camera.unproject(px);
    const Vector3f ray_w = T_cw.R.transpose() * Vector3f(x.x(), x.y(), 1);
    return T_cw.centre() - ray_w * (T_cw.centre().z() / ray_w.z());
  }
  void take(const FrameInput& frame, Keyframe* view) {
    view->timestamp_ns = frame.timestamp_ns();
    view->T_kw = pose(frame.timestamp_ns());
    const CameraModel& model = config_.camera.model;
    view->mean_depth = (view->T_kw * on_plane(view->T_kw, {model.cx, model.cy})).z();
    view->set_images(frame.pyramid(), frame.small());
  }
  // Those of the first view's corners that are found in the last view where the plane puts them.
  int add_points(Map& map) {
    const PatchFinder finder(map, config_, meter_);
    const Keyframe& first = map.keyframes()[0];
    int count = 0;
    for (const Corner& corner : corners_) {
      const Vector2f px(corner.x, corner.y);
      const Vector3f p_w = on_plane(first.T_kw, px);
      const PatchSource source{0, px, first.T_kw.R * Vector3f::UnitZ()};
      SearchOptions options;
      options.level = kNewPointLevel;
      PredictedPoint predicted;
      ImagePoint found;
      if (!predict_in_keyframe(map, config_, 1, p_w, &predicted) ||
          finder.find(source, p_w, predicted, map.keyframes()[1].pyramid, options, &found) != SearchOutcome::kFound)
        continue;
      const int point = map.add_point(p_w, source);
      if (point < 0) break;
      map.add_measurement(point, {{px, kCornerLevel}, 0});
      map.add_measurement(point, {found, 1});
      ++count;
    }
    return count;
  }

  const Config& config_;
  WorkMeter& meter_;
  CornerSource* corner_source_;
  FixedVector<Corner> corners_;
  Keyframe first_, last_;
  SE3 previous_;  // T_cw of the frame before
  Vector6f velocity_ = Vector6f::Zero();
  Report report_;
  bool active_ = false;
};

// New points of every keyframe, triangulated at once with the keyframe most like it.
class EpipolarSource final : public PointSource {
 public:
  EpipolarSource(Arena& arena, const Config& config, Map& map, WorkMeter& meter, Background& background,
                 CornerSource* corner_source)
      : config_(config),
        map_(map),
        meter_(meter),
        background_(background),
        corner_source_(corner_source),
        finder_(map, config, meter),
        known_(arena, config.max_map_points) {}

  Task<> grow(int keyframe) override {
    known_.clear();
    PredictedPoint predicted;
    for (const MapPoint& point : map_.points()) {
      if (point.id != 0 && predict_in_keyframe(map_, config_, keyframe, point.p_w, &predicted))
        known_.push_back(predicted.px);
      co_await background_.spend(Work::kOther, kPredictionInstructions);
    }
    const int other = map_.nearest_live(keyframe);
    corner_source_->start(map_.keyframes()[keyframe].pyramid);
    Corner corner;
    for (CornerProgress p; (p = corner_source_->advance(&corner)) != CornerProgress::kEnd;) {
      co_await background_.slice();
      const Vector2f px(corner.x, corner.y);
      if (p != CornerProgress::kFound || !far_from_known(px)) continue;
      if (!add(keyframe, other, px)) co_return;
    }
  }

  FrameStack& frames() { return background_.frames(); }

 private:
  static constexpr float kMinDistance_px = 10.0f;
  static constexpr float kMinParallax_rad = 0.01f;  // with 0.3 px of noise: 5 % of the depth
  // Along the epipolar line, inverse depths of so many times the scene's mean.
  static constexpr std::array<float, 3> kInverseDepths = {1.0f, 0.65f, 1.5f};

  bool far_from_known(const Vector2f& px) {
    meter_.charge(Work::kOther, 6LL * known_.size());
    return std::none_of(known_.begin(), known_.end(), [&](const Vector2f& other) {
      return (other - px).squaredNorm() < kMinDistance_px * kMinDistance_px;
    });
  }
  // From coarse to fine: what each level finds is where the next one looks.
  bool search(const PatchSource& source, const Vector3f& p_w, int other, ImagePoint* found) const {
    PredictedPoint predicted;
    if (!predict_in_keyframe(map_, config_, other, p_w, &predicted)) return false;
    SearchOptions options;
    for (options.level = kCoarseLevel; options.level >= kNewPointLevel; --options.level) {
      if (finder_.find(source, p_w, predicted, map_.keyframes()[other].pyramid, options, found) !=
          SearchOutcome::kFound)
        return false;
      predicted.px = found->px;
      options.radius_px = 2;
    }
    return true;
  }
  // False when the map is full.
  bool add(int keyframe, int other, const Vector2f& px) {
    const Keyframe& here = map_.keyframes()[keyframe];
    const SE3 T_wk = here.T_kw.inverse(), T_ok = map_.keyframes()[other].T_kw * T_wk;
    const Vector2f x = config_.camera.unproject(px);
    const Vector3f ray(x.x(), x.y(), 1);
    const PatchSource source{static_cast<int16_t>(keyframe), px, -ray.normalized()};
    for (const float inverse_depth : kInverseDepths) {
      ImagePoint found;
      Triangulated triangulated;
      Vector2f px_here, px_other;
      if (!search(source, T_wk * (ray * (here.mean_depth / inverse_depth)), other, &found) ||
          !triangulate(T_ok, x, config_.camera.unproject(found.px), kMinParallax_rad, &triangulated) ||
          !config_.camera.project(triangulated.p_1, &px_here) ||
          !config_.camera.project(T_ok * triangulated.p_1, &px_other) || (px_here - px).norm() > kFinalError_px ||
          (px_other - found.px).norm() > kFinalError_px)
        continue;
      const int point = map_.add_point(T_wk * triangulated.p_1, source);
      if (point < 0) return false;
      map_.add_measurement(point, {{px, kCornerLevel}, static_cast<int16_t>(keyframe)});
      map_.add_measurement(point, {found, static_cast<int16_t>(other)});
      return true;
    }
    return true;
  }

  const Config& config_;
  Map& map_;
  WorkMeter& meter_;
  Background& background_;
  CornerSource* corner_source_;
  PatchFinder finder_;
  FixedVector<Vector2f> known_;  // level-0 pixels at which the keyframe sees a map point
};

// Adds nothing: the point source's control.
class NoPoints final : public PointSource {
 public:
  NoPoints(Arena&, Background& background) : background_(background) {}
  Task<> grow(int) override { co_return; }
  FrameStack& frames() { return background_.frames(); }

 private:
  Background& background_;
};

// Every keyframe stays, until the map is full.
class NoCulling final : public KeyframeCulling {
 public:
  NoCulling(Arena&, Background& background) : background_(background) {}
  Task<int> choose() override { co_return -1; }
  FrameStack& frames() { return background_.frames(); }

 private:
  Background& background_;
};

Initialiser* create_rail_initialiser(Arena& arena, const Config& config, WorkMeter& meter,
                                     CornerSource* corner_source) {
  return arena.create<RailInitialiser>(config, meter, corner_source);
}
PointSource* create_epipolar_source(Arena& arena, const Config& config, Map& map, WorkMeter& meter,
                                    Background& background, CornerSource* corner_source) {
  return arena.create<EpipolarSource>(config, map, meter, background, corner_source);
}
PointSource* create_no_points(Arena& arena, const Config&, Map&, WorkMeter&, Background& background, CornerSource*) {
  return arena.create<NoPoints>(background);
}
KeyframeCulling* create_no_culling(Arena& arena, const Config&, Map&, WorkMeter&, Background& background) {
  return arena.create<NoCulling>(background);
}

Config toy(const CameraModel& model) {
  Config config;
  config.corner_source = create_shi_tomasi_corners;
  config.initialiser = create_rail_initialiser;
  config.point_source = create_epipolar_source;
  config.culling = create_no_culling;
  config.camera.model = model;
  config.max_keyframes = 20;
  config.max_erased_keyframes = 0;
  config.max_map_points = 3000;
  config.max_measurements = 30000;
  config.max_partial_points = config.max_partial_searches = config.max_new_partial_points = 0;
  config.max_initial_points = 250;
  config.max_measured_points = 200;
  config.cells_x = 16;
  config.cells_y = 12;
  config.search_level = kSearchLevel;
  config.coarse_search_level = kCoarseLevel;
  return config;
}

// ---- its rides ----

constexpr uint64_t kSceneSeed = 1;

// Boxes on a table. 6 frames/s: rendering takes nearly all of the test's time.
test::Recording record_ride(uint64_t seed, std::shared_ptr<const sim::Scene> scene) {
  sim::PhoneOptions options;
  options.scene = "boxes";
  options.scene_seed = kSceneSeed;
  options.seed = seed;
  options.duration_s = 6;
  options.frames_per_s = 6;
  options.width = 640;
  options.height = 480;
  options.horizontal_fov_degrees = 60;
  options.readout_s = 0;
  options.exposure_s = 0.01;
  return test::record(options, std::move(scene));
}

struct Ride {
  Hint last_hint = Hint::kNone;
  uint32_t limits_hit = 0;
  int frames = 0;                 // from the first pose on
  std::vector<int> tracked;       // of these, by their place in the recording
  std::vector<int> inliers;       // of each frame tracked
  std::vector<Vector3d> centres;  // likewise, in the map's world
  // Of the map at the first pose and at the last.
  int first_points = 0, points = 0, first_keyframes = 0, keyframes = 0;
  std::array<int, kPyramidLevels> measurements = {};  // in the map at the end, by level

  int most_inliers() const { return *std::max_element(inliers.begin(), inliers.end()); }
  int median_inliers() const {
    std::vector<int> sorted = inliers;
    std::sort(sorted.begin(), sorted.end());
    return sorted[sorted.size() / 2];
  }
};

// told: what the rail says of itself.
Ride ride(const Config& config, const test::Recording& recording, const platform::Trajectory& told) {
  rail = &told;
  test::Phone phone(config);
  phone->tap();
  Ride ride;
  for (int i = 0; i < recording.size(); ++i) {
    const TrackResult result = phone->track(recording.frame(i));
    EXPECT_TRUE(result.status.ok()) << result.status.message();
    ride.last_hint = result.hint;
    ride.limits_hit |= result.limits_hit;
    if (result.pose_valid) {
      if (ride.tracked.empty()) {
        ride.first_points = result.map_points;
        ride.first_keyframes = result.keyframes;
      }
      ride.points = result.map_points;
      ride.keyframes = result.keyframes;
      ride.tracked.push_back(i);
      ride.inliers.push_back(result.points_inliers);
      ride.centres.push_back(result.T_cw.centre().cast<double>());
    }
    ride.frames += !ride.tracked.empty();
    phone.drain();
  }
  std::vector<MeasurementInfo> measurements(static_cast<size_t>(phone->measurements({})));
  phone->measurements(measurements);
  for (const MeasurementInfo& m : measurements)
    for (uint8_t level = 0; level < kPyramidLevels; ++level)
      ride.measurements[level] += m.sigma == ImagePoint{m.px, level}.sigma();
  rail = nullptr;
  return ride;
}

// Root mean square distance of the camera from where it was `late` frames later, metres.
double position_error_m(const Ride& ride, const platform::Trajectory& truth, int late) {
  std::vector<Vector3d> centres, true_centres;
  for (size_t i = 0; i < ride.tracked.size(); ++i) {
    const auto frame = static_cast<size_t>(ride.tracked[i] + late);
    if (frame >= truth.size()) continue;
    centres.push_back(ride.centres[i]);
    true_centres.push_back(truth[frame].T_wc.translation());
  }
  return test::distance_after_similarity(centres, true_centres);
}

// Of the table along the optical axis, metres, mean over the frames tracked.
double mean_distance_m(const Ride& ride, const platform::Trajectory& truth) {
  double sum = 0;
  for (const int frame : ride.tracked) {
    const Eigen::Isometry3d& T_wc = truth[static_cast<size_t>(frame)].T_wc;
    sum -= T_wc.translation().z() / T_wc.linear()(2, 2);
  }
  return sum / static_cast<double>(ride.tracked.size());
}

TEST(ToyProfile, TracksAndMaps) {
  const auto scene = std::make_shared<const sim::Scene>(sim::make_scene("boxes", kSceneSeed));
  for (const uint64_t seed : {1, 2, 3}) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    const test::Recording recording = record_ride(seed, scene);
    const platform::Trajectory& truth = recording.truth;
    const Config config = toy(recording.info.model);

    const Ride r = ride(config, recording, truth);
    ASSERT_GT(r.tracked.size(), 10u);
    const double error_m = position_error_m(r, truth, 0);
    std::printf(
        "seed %d: tracked %zu of %d frames, %d inliers (median; at most %d), error %.2f mm, keyframes %d to %d, points "
        "%d to %d, measurements in L0 %d, L1 %d, L2 %d\n",
        static_cast<int>(seed), r.tracked.size(), r.frames, r.median_inliers(), r.most_inliers(), 1000 * error_m,
        r.first_keyframes, r.keyframes, r.first_points, r.points, r.measurements[0], r.measurements[1],
        r.measurements[2]);
    EXPECT_GE(static_cast<double>(r.tracked.size()), 0.95 * r.frames);
    // More are visible than the 200 that are measured. The phone's profile has 50: twice as many are found and fit in
    // half of the frames, three times as many in the best one.
    EXPECT_NE(r.limits_hit & kLimitMeasuredPoints, 0u);
    EXPECT_GT(r.median_inliers(), 100);
    EXPECT_GT(r.most_inliers(), 150);
    // A point is found to a quarter of a pixel of L2, which is 1 px: that shifts a camera that sees nothing else by
    // distance / f. A hundred points leave a tenth of it; the rest is for the map's own error.
    const double tolerance_m = mean_distance_m(r, truth) / config.camera.model.fx;
    EXPECT_LT(error_m, tolerance_m);
    EXPECT_GT(position_error_m(r, truth, 1), tolerance_m) << "one frame late is an error";
    // The map grows by ten points for every keyframe at least: the borders that come into view, 10 px apart.
    EXPECT_GE(r.keyframes, r.first_keyframes + 3);
    EXPECT_GT(r.points, r.first_points + 10 * (r.keyframes - r.first_keyframes));
    // Corners, new points and tracking have a level each. What was found in L3 has been refined below: without it there
    // is no new point.
    for (const int level : {kCornerLevel, kNewPointLevel, kSearchLevel}) EXPECT_GT(r.measurements[level], 0) << level;
    EXPECT_EQ(r.measurements[kPyramidLevels - 1], 0);

    // It is the point source that makes the map grow.
    Config without = config;
    without.point_source = create_no_points;
    const Ride poor = ride(without, recording, truth);
    ASSERT_FALSE(poor.tracked.empty());
    EXPECT_GT(poor.keyframes, poor.first_keyframes);
    EXPECT_LE(poor.points, poor.first_points);
    EXPECT_LT(poor.most_inliers(), r.median_inliers());

    // It is the initialiser that starts it: of a rail that runs the other way there is no map.
    platform::Trajectory mirrored = truth;
    for (platform::StampedPose& pose : mirrored)
      pose.T_wc.translation() = 2 * truth.front().T_wc.translation() - pose.T_wc.translation();
    const Ride lost = ride(config, recording, mirrored);
    EXPECT_TRUE(lost.tracked.empty());
    EXPECT_EQ(lost.last_hint, Hint::kStartLost);
  }
}

CameraModel any_camera() {
  CameraModel camera;
  camera.width = 640;
  camera.height = 480;
  camera.fx = camera.fy = 554;
  camera.cx = 319.5f;
  camera.cy = 239.5f;
  return camera;
}

TEST(ToyProfile, EveryPartMustBeNamed) {
  const Config config = toy(any_camera());
  EXPECT_TRUE(config.validate().ok()) << config.validate().message();
  const auto expect_refused = [](const Config& incomplete, const char* name) {
    EXPECT_EQ(incomplete.validate().code(), StatusCode::kInvalidArgument) << name;
    EXPECT_NE(std::string(incomplete.validate().message()).find(name), std::string::npos)
        << name << ": " << incomplete.validate().message();
    EXPECT_EQ(System::required_bytes(incomplete), 0u) << name;
  };
  Config incomplete = config;
  incomplete.corner_source = nullptr;
  expect_refused(incomplete, "corner_source");
  incomplete = config;
  incomplete.initialiser = nullptr;
  expect_refused(incomplete, "initialiser");
  incomplete = config;
  incomplete.point_source = nullptr;
  expect_refused(incomplete, "point_source");
  incomplete = config;
  incomplete.culling = nullptr;
  expect_refused(incomplete, "culling");
  expect_refused(Config(), "corner_source");
}

TEST(ToyProfile, PartsAreMeasuredBeforeTheyAreBuilt) {
  const Config config = toy(any_camera());
  const size_t bytes = System::required_bytes(config);
  Config without = config;
  without.point_source = create_no_points;
  EXPECT_GE(bytes, System::required_bytes(without) + static_cast<size_t>(config.max_map_points) * sizeof(Vector2f));
  const std::unique_ptr<std::max_align_t[]> memory(new std::max_align_t[bytes / sizeof(std::max_align_t) + 1]);
  auto* block = reinterpret_cast<std::byte*>(memory.get());
  System* system = nullptr;
  EXPECT_EQ(System::create(config, {block, bytes - 1}, &system).code(), StatusCode::kOutOfMemory);
  EXPECT_TRUE(System::create(config, {block, bytes}, &system).ok());
}

}  // namespace
}  // namespace pptam
