// New points by epipolar search: before a wall with a step, whose depths are known.
#include "mapping/epipolar_points.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>

#include "image/fast.h"
#include "tests/kernels/test_images.h"
#include "tests/support/map_building.h"
#include "tests/support/random.h"

namespace pptam {
namespace {

constexpr int kWidth = 320, kHeight = 240;
constexpr float kFocal_px = 280;
// Two walls that face the camera: world x < 0.1 lies at depth 1, the rest at 1.25. The step's edges are seen by none of
// the cameras as a surface of its own.
constexpr float kNearDepth = 1, kFarDepth = 1.25f, kEdge = 0.1f;

class Job : public Background {
 public:
  Job(Arena& arena, WorkMeter& meter) : Background(arena, 8192, meter) {}
  void grow(PointSource& source, int keyframe) {
    done_ = false;
    resume();
    task_ = Task<>();  // frames go back last in, first out
    task_ = work(source, keyframe);
    task_.start();
    while (!done_) resume();
  }

 private:
  Task<> work(PointSource& source, int keyframe) {
    co_await source.grow(keyframe);
    done_ = true;
  }
  bool done_ = false;
  Task<> task_;
};

CameraModel camera_model() {
  CameraModel model;
  model.width = kWidth;
  model.height = kHeight;
  model.fx = model.fy = kFocal_px;
  model.cx = 0.5f * (kWidth - 1);
  model.cy = 0.5f * (kHeight - 1);
  model.prepare();
  return model;
}

// Cameras that look along z, at (x, y, 0).
class World {
 public:
  explicit World(int max_points = 2000) : config_(Config::desktop(camera_model())), texture_(random_, 45, 20, 160) {
    config_.max_keyframes = 6;
    config_.max_map_points = max_points;
    block_ = std::make_unique<test::Block>([&](Arena& arena) { parts_.emplace(arena, config_, meter_); });
  }

  int add_view(float x, float y, double contrast = 1) {
    test::OwnedImage image(kWidth, kHeight);
    image.fill([&](int u, int v) {
      const double a = (u - 0.5 * (kWidth - 1)) / static_cast<double>(kFocal_px);
      const double b = (v - 0.5 * (kHeight - 1)) / static_cast<double>(kFocal_px);
      const auto cx = static_cast<double>(x), cy = static_cast<double>(y);
      const auto depth = static_cast<double>(
          cx + a * static_cast<double>(kNearDepth) < static_cast<double>(kEdge) ? kNearDepth : kFarDepth);
      return 128 + contrast * texture_.value(cx + a * depth, cy + b * depth);
    });
    SE3 T_kw;
    T_kw.t = Vector3f(-x, -y, 0);
    const int index = test::add_keyframe(map(), T_kw);
    Keyframe& keyframe = MapAccess::keyframe(map(), index);
    const GreyImage& level = keyframe.storage.level[0];
    for (int row = 0; row < kHeight; ++row) std::copy_n(image.view().row(row), kWidth, &level.at(0, row));
    keyframe.pyramid = build_pyramid(level, keyframe.storage);
    return index;
  }
  void grow(int keyframe) { parts_->job.grow(parts_->source, keyframe); }
  Map& map() { return parts_->map; }

  struct Count {
    int points = 0, right = 0, of_level[kPointLevels] = {}, measurements = 0;
  };
  // Right: within `sigmas` of what 0.4 px of the level tell of the depth at this baseline, on either wall.
  Count count(float baseline, float sigmas = 4) {
    Count count;
    for (const MapPoint& point : map().points()) {
      if (point.id == 0) continue;
      ++count.points;
      ++count.of_level[point.source.level];
      count.measurements += point.measurements.size();
      const float depth = point.p_w.x() < kEdge ? kNearDepth : kFarDepth;
      const float sigma = 0.4f * static_cast<float>(1 << point.source.level) * depth * depth / (kFocal_px * baseline);
      count.right += std::abs(point.p_w.z() - depth) < sigmas * sigma;
    }
    return count;
  }

 private:
  struct Parts {
    Parts(Arena& arena, const Config& config, WorkMeter& meter)
        : map(arena, config),
          job(arena, meter),
          corners(arena, config.camera.model.width, config.camera.model.height, meter),
          source(arena, config, map, meter, job, &corners) {}
    Map map;
    Job job;
    FastCorners corners;
    EpipolarPoints source;
  };
  test::Random random_;
  Config config_;
  test::Texture texture_;
  WorkMeter meter_;
  std::unique_ptr<test::Block> block_;
  std::optional<Parts> parts_;
};

// From two views: hundreds of points, in three levels at least, on the walls; two measurements each. 98 % within four
// sigmas of what the measurements' noise tells of the depth: the rest lies across the step.
TEST(EpipolarPoints, LieOnTheWalls) {
  World world;
  world.add_view(0, 0);
  world.grow(world.add_view(0.08f, 0.02f));
  const World::Count count = world.count(0.08f);
  EXPECT_GT(count.points, 250);
  EXPECT_GT(count.right, 0.98 * count.points);
  EXPECT_EQ(count.measurements, 2 * count.points);
  for (int level = 0; level < 3; ++level) EXPECT_GT(count.of_level[level], 1) << "L" << level;
  world.map().check_consistency();
}

// A third view confirms what two have found, and its measurements are taken.
TEST(EpipolarPoints, AreMeasuredInOtherKeyframes) {
  World world;
  world.add_view(-0.08f, 0);
  world.add_view(0, 0);
  world.grow(world.add_view(0.08f, 0));
  const World::Count count = world.count(0.08f);
  EXPECT_GT(count.points, 250);
  EXPECT_GT(count.right, 0.98 * count.points);
  EXPECT_GT(count.measurements, 2.7 * count.points);
}

// A view of something else contradicts what two views alone would make: left are points beyond its edge, 45 px of 320.
// Control: the test above.
TEST(EpipolarPoints, WhatOtherKeyframesContradictIsNotAdded) {
  World world;
  world.add_view(-0.08f, 0, -1);  // its negative
  world.add_view(0, 0);
  world.grow(world.add_view(0.08f, 0));
  EXPECT_LT(world.count(0.08f).points, 80);
}

TEST(EpipolarPoints, AgainTheyAreNotAddedTwice) {
  World world;
  world.add_view(0, 0);
  const int second = world.add_view(0.08f, 0);
  world.grow(second);
  const int points = world.count(0.08f).points;
  world.grow(second);
  EXPECT_LT(world.count(0.08f).points, 1.02 * points);  // those whose neighbours' cells were free
}

TEST(EpipolarPoints, NeedABaseline) {
  World world;
  world.add_view(0, 0);
  world.grow(world.add_view(0.01f, 0));
  EXPECT_EQ(world.count(0.01f).points, 0);
}

TEST(EpipolarPoints, EndWhereTheMapIsFull) {
  World world(120);
  world.add_view(0, 0);
  world.grow(world.add_view(0.08f, 0));
  EXPECT_EQ(world.count(0.08f).points, 120);
  world.map().check_consistency();
}

}  // namespace
}  // namespace pptam
