// One hash of the model-based tracker's poses, the same on every target.
#include <gtest/gtest.h>

#include <cstdint>
#include <cstring>

#include "tests/support/rendered_object.h"
#include "tests/support/tracker_in_memory.h"

namespace pptam {
namespace {

uint64_t hash_of(const SE3& T, uint64_t hash) {
  const auto add = [&](float v) {
    uint32_t bits;
    std::memcpy(&bits, &v, sizeof bits);
    hash = (hash ^ bits) * 1099511628211ull;
  };
  for (int i = 0; i < 9; ++i) add(T.R(i / 3, i % 3));
  for (int i = 0; i < 3; ++i) add(T.t(i));
  return hash;
}

Camera tiny_camera() {
  Camera camera;
  camera.model.width = 160;
  camera.model.height = 120;
  camera.model.fx = camera.model.fy = 160;
  camera.model.cx = 79.5f;
  camera.model.cy = 59.5f;
  camera.model.prepare();
  return camera;
}

SE3 swaying(float t) {
  Vector6f mu;
  mu << 0, 0, 0, 0.5f + 0.012f * t, 0.5f - 0.01f * t, 0.004f * t;
  SE3 T = SE3::exp(mu);
  T.t = Vector3f(0.002f * t - 0.02f, 0.0015f * t - 0.02f, 0.55f);
  return T;
}

TEST(EdgeBits, AreTheSameOnEveryTarget) {
  test::RenderedObject object;
  object.add_box(Vector3f::Zero(), Vector3f(0.2f, 0.15f, 0.1f));
  object.points.emplace_back(-0.15f, -0.09f, 0.0f);
  object.points.emplace_back(-0.15f, 0.09f, 0.0f);
  object.cylinders.push_back({8, 9, 0.03f, 0});
  object.spheres.push_back({Vector3f(0.15f, 0, 0), 0.03f});
  const Camera camera = tiny_camera();
  const auto run = [&](float last) {
    ModelTrackerConfig config;
    config.camera = camera;
    config.model = object.model();
    config.max_sites = 300;
    test::TrackerInMemory tracker(config);
    EXPECT_TRUE(tracker->start(swaying(0)).ok());
    uint64_t hash = 14695981039346656037ull;
    for (int i = 0; i < 6; ++i) {
      const ModelResult r = tracker.track(object.render(camera, swaying(i == 5 ? last : static_cast<float>(i))));
      EXPECT_TRUE(r.pose_valid) << i;
      hash = hash_of(r.T_co, hash);
    }
    return hash;
  };
  constexpr uint64_t kGolden = 6997000154784067796ull;
  EXPECT_EQ(run(5), kGolden) << "new hash: " << run(5);
  EXPECT_NE(run(5.01f), kGolden) << "the hash must notice another image";
}

}  // namespace
}  // namespace pptam
