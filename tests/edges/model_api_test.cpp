// The model-based tracker's interface: what it refuses, and any sequence of calls.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include <pocket_ptam/model_tracker.h>
#include "tests/support/random.h"
#include "tests/support/rendered_object.h"
#include "tests/support/tracker_in_memory.h"

namespace pptam {
namespace {

using test::box;
using test::config_of;
using test::RenderedObject;
using test::small_camera;
using test::TrackerInMemory;

TEST(ModelApi, RefusesWhatIsNoInput) {
  const RenderedObject object = box();
  const Camera camera = small_camera();
  ModelTrackerConfig config = config_of(object, camera);
  std::vector<std::byte> memory(ModelTracker::required_bytes(config) + 64);
  ModelTracker* tracker = nullptr;
  EXPECT_EQ(ModelTracker::create(config, std::span(memory).first(1000), &tracker).code(), StatusCode::kOutOfMemory);
  EXPECT_EQ(tracker, nullptr);
  EXPECT_EQ(ModelTracker::create(config, std::span(memory).subspan(1), &tracker).code(), StatusCode::kInvalidArgument)
      << "not aligned";
  ModelTrackerConfig unprepared = config;
  unprepared.camera.model = {};
  unprepared.camera.model.width = camera.model.width;
  unprepared.camera.model.height = camera.model.height;
  unprepared.camera.model.fx = unprepared.camera.model.fy = camera.model.fx;
  unprepared.camera.model.cx = camera.model.cx;
  unprepared.camera.model.cy = camera.model.cy;
  EXPECT_EQ(ModelTracker::required_bytes(unprepared), ModelTracker::required_bytes(config));
  EXPECT_TRUE(ModelTracker::create(unprepared, memory, &tracker).ok());
  ASSERT_TRUE(ModelTracker::create(config, memory, &tracker).ok());
  EXPECT_FALSE(tracker->start(SE3(Matrix3f::Identity() * 2, Vector3f(0, 0, 1))).ok());
  EXPECT_FALSE(tracker->start(SE3(Matrix3f::Identity(), Vector3f(0, 0, -1))).ok()) << "behind the camera";
  EXPECT_FALSE(tracker->start(SE3(Matrix3f::Identity(), Vector3f(0, NAN, 1))).ok());
  EXPECT_FALSE(tracker->start({}, {}).ok());
  const std::vector<uint8_t> image(320 * 240, 0);
  Frame frame;
  frame.data = image.data();
  frame.width = frame.stride_bytes = 320;
  frame.height = 240;
  frame.timestamp_ns = 1000;
  EXPECT_TRUE(tracker->track(frame).status.ok());
  EXPECT_EQ(tracker->track(frame).status.code(), StatusCode::kTimeWentBackwards);
  frame.timestamp_ns = 2000;
  frame.height = 200;
  EXPECT_EQ(tracker->track(frame).status.code(), StatusCode::kInvalidArgument);
  frame.data = nullptr;
  EXPECT_FALSE(tracker->track(frame).status.ok());

  EXPECT_FALSE(ObjectModel().validate().ok()) << "nothing to track";
  RenderedObject wrong = box();
  wrong.corners[5] = 99;
  EXPECT_FALSE(wrong.model().validate().ok());
  EXPECT_EQ(ModelTracker::required_bytes(config_of(wrong, camera)), 0u);
  wrong = box();
  wrong.faces[2].first = std::numeric_limits<int>::max() - 1;
  EXPECT_FALSE(wrong.model().validate().ok());
  wrong = box();
  wrong.points[3] = wrong.points[1];
  EXPECT_FALSE(wrong.model().validate().ok()) << "a side without a length";
  wrong = box();
  wrong.spheres.push_back({Vector3f::Zero(), -1});
  EXPECT_FALSE(wrong.model().validate().ok());
  wrong = box();
  wrong.circles.push_back({Vector3f::Zero(), Vector3f::Zero(), 1});
  EXPECT_FALSE(wrong.model().validate().ok());
  wrong = box();
  wrong.points[0].x() = INFINITY;
  EXPECT_FALSE(wrong.model().validate().ok());
  const std::vector<ModelLine> lines(4097, ModelLine{0, 1, 0});
  ObjectModel many = object.model();
  many.faces = {};
  many.lines = std::span(lines).first(4096);
  EXPECT_TRUE(many.validate().ok());
  many.lines = lines;
  EXPECT_FALSE(many.validate().ok()) << "too many lines, and no faces";
  config.max_sites = 10;
  EXPECT_FALSE(config.validate().ok());
}

// Random objects, poses, images and calls: no assertion (they trap), and poses that are numbers.
TEST(ModelApi, AnySequenceOfCallsIsHarmless) {
  test::Random random;
  Camera camera = small_camera();
  camera.model.width = 96;
  camera.model.height = 64;
  camera.model.fx = camera.model.fy = 80;
  camera.model.cx = 47.5f;
  camera.model.cy = 31.5f;
  camera.model.prepare();
  for (int trial = 0; trial < test::trials(100); ++trial) {
    RenderedObject object;
    const auto any = [&](double size) {
      return Vector3f(static_cast<float>(random.uniform(-size, size)), static_cast<float>(random.uniform(-size, size)),
                      static_cast<float>(random.uniform(-size, size)));
    };
    for (int k = random.integer(0, 2); k > 0; --k)
      object.add_box(any(0.5), any(1).cwiseAbs() + Vector3f::Constant(0.01f));
    for (int k = random.integer(0, 2); k > 0; --k) object.spheres.push_back({any(0.5), 0.3f});
    for (int k = random.integer(0, 2); k > 0; --k)
      object.circles.push_back({any(0.5), any(1), 0.3f, random.integer(0, 1) == 1});
    if (object.points.size() > 1) object.cylinders.push_back({0, 1, 0.2f, 0});
    if (!object.model().validate().ok()) continue;
    if (random.integer(0, 1)) camera.shutter.line_time_s = 1e-4f;
    ModelTrackerConfig config = config_of(object, camera);
    config.max_sites = random.integer(50, 300);
    TrackerInMemory tracker(config);
    std::vector<uint8_t> image(96 * 64);
    for (int call = 0; call < 20; ++call) {
      switch (random.integer(0, 5)) {
        case 0: {
          const SE3 T(so3_exp(any(3)), any(0.5) + Vector3f(0, 0, 1));
          const Status ignored = tracker->start(T);
          (void)ignored;
          break;
        }
        case 1: {
          const std::vector<Vector3f> points = {any(1), any(1), any(1), any(1)};
          const std::vector<Vector2f> px = {any(100).head<2>(), any(100).head<2>(), any(100).head<2>(),
                                            any(100).head<2>()};
          const Status ignored = tracker->start(points, px);
          (void)ignored;
          break;
        }
        case 2:
          if (random.integer(0, 3) == 0) tracker->reset();
          break;
        default: {
          const int kind = random.integer(0, 2);
          for (uint8_t& px : image)
            px = static_cast<uint8_t>(kind == 0 ? random.integer(0, 255) : kind == 1 ? 128 : px / 2 + 50);
          const ModelResult r = tracker.track(image);
          ASSERT_TRUE(r.status.ok());
          if (!r.pose_valid) break;
          ASSERT_TRUE(r.T_co.R.allFinite() && r.T_co.t.allFinite() && r.covariance.allFinite());
          ASSERT_GE(r.quality, 0);
          ASSERT_LE(r.quality, 1.01f);
        }
      }
    }
  }
}

}  // namespace
}  // namespace pptam
