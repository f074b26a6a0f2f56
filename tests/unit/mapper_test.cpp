// What the map maker does with a map in idle time when no keyframe waits: bad points go, duplicates become one, patches
// turn as they lie.
#include "mapping/mapper.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <memory>
#include <vector>

#include "mapping/neighbours.h"
#include "tests/budget/painted_run.h"
#include "tests/budget/parts.h"
#include "tests/support/map_building.h"
#include "tests/support/random.h"
#include "tests/support/small_map.h"

namespace pptam {
namespace {

using test::SmallMap;

// The wall, seen by a global shutter: all measurements are where its points are.
Config global_shutter_config() {
  Config config = test::small_map_config();
  config.camera.shutter.line_time_s = 0;
  return config;
}

// With points as far from each other as real ones, patches that face their cameras, and a mapper.
class World {
 public:
  explicit World(uint64_t seed) : small_(seed, global_shutter_config()), meter_(small_.config.profile) {
    for (int i = 0; i < map().points().size(); ++i) {
      MapPoint& point = MapAccess::point(map(), i);
      bool apart = true;  // 0.07 are 7 px: over any sigma
      for (int j = 0; j < i; ++j)
        apart &= map().points()[j].id == 0 || (map().points()[j].p_w - point.p_w).norm() > 0.07f;
      if (point.id == 0 || !apart) {
        map().remove_point(i);
        continue;
      }
      point.attempts = point.found = 0;
      point.source.normal = -(map().keyframes()[point.source.keyframe].T_kw * point.p_w).normalized();
    }
    Arena measure;
    const Mapper measured(measure, small_.config, small_.map, meter_,
                          small_.config.corner_source(measure, small_.config, meter_));
    memory_.resize(measure.used() / sizeof(std::max_align_t) + 1);
    Arena arena({reinterpret_cast<std::byte*>(memory_.data()), measure.used()});
    mapper_ = std::make_unique<Mapper>(arena, small_.config, small_.map, meter_,
                                       small_.config.corner_source(arena, small_.config, meter_));
  }
  void run() {
    while (mapper_->has_work()) mapper_->work_slice();
  }
  Map& map() { return small_.map; }
  const Config& config() const { return small_.config; }
  // One with so many measurements, of those that have their patch from a live keyframe.
  int point_with(int measurements) const {
    for (int i = 10; i < small_.map.points().size(); ++i)
      if (small_.map.points()[i].id != 0 && small_.map.points()[i].measurements.size() == measurements) return i;
    return -1;
  }

 private:
  SmallMap small_;
  WorkMeter meter_;
  std::vector<std::max_align_t> memory_;
  std::unique_ptr<Mapper> mapper_;
};

class MapperTest : public ::testing::Test {
 protected:
  MapperTest() : world_(random_.seed()) {}
  Map& map() { return world_.map(); }
  void run() { world_.run(); }

  test::Random random_;
  World world_;
};

TEST_F(MapperTest, AGoodMapKeepsItsPoints) {
  const int before = map().point_count();
  run();
  EXPECT_EQ(map().point_count(), before);
}

TEST_F(MapperTest, PatchesOfAWallTurnToLieOnIt) {
  int judged = 0;
  const auto worst = [&] {
    float angle_rad = 0;
    for (int i = 0; i < map().points().size(); ++i) {
      const MapPoint& point = map().points()[i];
      if (point.id == 0 || find_neighbours(map(), i).size() < 6) continue;
      ++judged;
      const Vector3f normal = -map().keyframes()[point.source.keyframe].T_kw.R.col(2);  // of the wall z = 1
      angle_rad =
          std::max(angle_rad, std::atan2(point.source.normal.cross(normal).norm(), point.source.normal.dot(normal)));
    }
    return angle_rad;
  };
  const float before = worst();
  run();
  const float after = worst();
  EXPECT_GT(judged, 10);
  EXPECT_GT(before, 0.1f) << "control: at 0.25 beside the axis and a distance of 1 a patch faces 14 degrees elsewhere";
  // The images of the points are exact to float32's rounding, 1e-5 px; what is left of it is far below a degree.
  EXPECT_LT(after, 0.02f);
}

TEST_F(MapperTest, DuplicatesBecomeOnePoint) {
  const int a = world_.point_with(2);
  ASSERT_GE(a, 0);
  const MapPoint& point = map().points()[a];
  const uint32_t id = point.id;
  // The same corner, cut from another keyframe, found within half a pixel in two keyframes, of which one is new to it.
  const auto measurements = map().measurements(point);
  int seen[2] = {measurements[1].keyframe, -1};
  for (int k = 0; k < 3; ++k)
    if (k != measurements[0].keyframe && k != seen[0]) seen[1] = k;
  const auto measure = [&](int k) {
    Measurement m = test::measure_exactly(map(), world_.config().camera, k, point.p_w);
    m.at.px += Vector2f(0.3f, -0.3f);
    return m;
  };
  const int b = map().add_point(point.p_w, {static_cast<int16_t>(seen[0]), measure(seen[0]).at.px, Vector3f(0, 0, -1)});
  ASSERT_GE(b, 0);
  for (const int k : seen) map().add_measurement(b, measure(k));
  const int before = map().point_count();
  run();
  EXPECT_EQ(map().point_count(), before - 1);
  const MapPoint& left = map().points()[map().points()[a].id == id ? a : b];
  ASSERT_EQ(left.measurements.size(), 3) << "what the other was measured in besides is taken over";
  for (int k = 0; k < 3; ++k) {
    int count = 0;
    for (const Measurement& m : map().measurements(left)) count += m.keyframe == k;
    EXPECT_EQ(count, 1) << k;
  }
}

TEST_F(MapperTest, NeighboursStayTwoPoints) {
  const int a = world_.point_with(3);
  ASSERT_GE(a, 0);
  const MapPoint& point = map().points()[a];
  // 0.05 at a distance of 1 and a focal length of 100 px: 5 px beside it, sigma is at most 4.
  Vector3f p_w = point.p_w;
  p_w.x() += p_w.x() > 0 ? -0.05f : 0.05f;
  PatchSource source = point.source;
  const Camera& camera = world_.config().camera;
  source.px = test::measure_exactly(map(), camera, source.keyframe, p_w).at.px;
  const int b = map().add_point(p_w, source);
  ASSERT_GE(b, 0);
  for (const Measurement& m : map().measurements(point))
    map().add_measurement(b, test::measure_exactly(map(), camera, m.keyframe, p_w));
  for (int i = 0; i < map().points().size(); ++i)  // nobody else there
    if (i != a && i != b && map().points()[i].id != 0 && (map().points()[i].p_w - p_w).norm() < 0.07f)
      map().remove_point(i);
  const int before = map().point_count();
  run();
  EXPECT_EQ(map().point_count(), before);
}

TEST_F(MapperTest, PointsThatAreNotFoundGo) {
  const auto stays = [&](int measurements, int attempts, int found) {
    World world(random_.seed());
    const int i = world.point_with(measurements);
    EXPECT_GE(i, 0);
    MapPoint& point = MapAccess::point(world.map(), i);
    point.attempts = static_cast<uint16_t>(attempts);
    point.found = static_cast<uint16_t>(found);
    const uint32_t id = point.id;
    world.run();
    return point.id == id;
  };
  EXPECT_TRUE(stays(3, 19, 0));
  EXPECT_FALSE(stays(3, 20, 5));
  EXPECT_TRUE(stays(3, 20, 6));
  EXPECT_TRUE(stays(2, 5, 0));
  EXPECT_FALSE(stays(2, 6, 1)) << "two measurements: on trial";
  EXPECT_TRUE(stays(2, 6, 2));
}

// An outlier among good measurements is sought again; where nothing is found it goes.
TEST_F(MapperTest, OutliersHaveASecondChance) {
  // How far from its place the point is measured at the end in the keyframe that had it wrong, level-0 pixels; negative
  // if it is not measured there any more.
  const auto error_px = [&](int trial, bool visible, int keyframes) {
    World world(random_.seed() + static_cast<uint64_t>(trial));
    Map& map = world.map();
    const int wrong = 4;  // erased; lives again
    MapAccess::keyframe(map, wrong).erased = false;
    MapAccess::keyframe(map, wrong).anchor = -1;
    int middle = -1;  // the point with most image around it
    for (int i = 0; i < map.points().size(); ++i) {
      const MapPoint& point = map.points()[i];
      if (point.id == 0 || point.source.keyframe == wrong) {
        map.remove_point(i);
        continue;
      }
      if (middle < 0 || point.p_w.head<2>().norm() < map.points()[middle].p_w.head<2>().norm()) middle = i;
      test::remove_measurements(map, i);
      for (int k : {0, 1, 2, wrong})
        map.add_measurement(i, test::measure_exactly(map, world.config().camera, k, point.p_w));
    }
    const MapPoint& point = map.points()[middle];
    const Vector2f right_px = map.measurements(point)[3].at.px;
    MapAccess::measurement(map, middle, 3).at.px += Vector2f(9, -9);
    for (int j = 2; j >= 0 && point.measurements.size() > keyframes; --j)
      if (map.measurements(point)[j].keyframe != point.source.keyframe) map.remove_measurement(middle, j);
    if (!visible) {
      Keyframe& keyframe = MapAccess::keyframe(map, wrong);
      const GreyImage& image = keyframe.storage.level[0];
      for (int y = 0; y < image.height; ++y) std::fill_n(image.row(y), image.width, uint8_t{100});
      keyframe.pyramid = build_pyramid(image, keyframe.storage);
    }
    const uint32_t id = point.id;
    world.run();
    EXPECT_EQ(point.id, id);
    for (const Measurement& m : map.measurements(point))
      if (m.keyframe == wrong) return (m.at.px - right_px).norm();
    return -1.0f;
  };
  constexpr int kTrials = 20;
  int found = 0;
  for (int trial = 0; trial < kTrials; ++trial) {
    const float found_px = error_px(trial, true, 4);
    found += found_px >= 0;
    // The wall is sampled without smoothing, up to half a pixel beside in either image, along both axes: 1 px at most.
    EXPECT_LT(found_px, 1.0f);
    EXPECT_EQ(error_px(trial, false, 4), -1) << "control: nothing to be seen there";
    EXPECT_EQ(error_px(trial, true, 3), -1) << "two good measurements do not say enough";
  }
  // One wall in twenty is too plain at the point: seven of twenty that are happen in one run of 30000.
  EXPECT_GE(found, 14);
}

// However few measurements a map may keep, what it keeps is sound: checked after every slice, where assertions are.
TEST(Mapper, AFullPoolOfMeasurementsLeavesASoundMap) {
  for (const int max_measurements : {0, 60, 250}) {
    test::PaintedRun run;
    Config config = run.config();
    config.max_map_points = 100;
    config.max_measurements = max_measurements;
    test::Parts parts(config);
    uint32_t limits = 0;
    int poses = 0;
    for (int i = 0; i < 60; ++i) {
      const TrackResult result = parts.tracker->track(run.frame(i), nullptr);
      limits |= result.limits_hit;
      poses += result.pose_valid;
      for (int s = 0; s < 60 && parts.mapper->has_work(); ++s) {
        parts.mapper->work_slice();
        for (const MapPoint& point : parts.map.points()) {
          if (point.id == 0) continue;
          ASSERT_GE(point.measurements.size(), 2) << max_measurements;
        }
      }
    }
    EXPECT_TRUE(limits & kLimitMeasurements) << max_measurements;
    if (max_measurements == 250) {  // with fewer no initial map is good enough
      EXPECT_GT(poses, 10);
    }
  }
}

}  // namespace
}  // namespace pptam
