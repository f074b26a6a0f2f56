// The map: change of coordinates, hash, capacities, rolling-shutter correction.
#include "map/map.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <memory>
#include <vector>

#include "tests/support/map_building.h"
#include "tests/support/phone_camera.h"
#include "tests/support/random.h"

namespace pptam {
namespace {

Config small_config() {
  Config config = Config::phone(test::phone_camera());
  config.max_keyframes = 10;
  config.max_map_points = 100;
  config.max_partial_points = 5;
  return config;
}

const PatchSource kFromTheFirst = {0, Vector2f::Zero(), -Vector3f::UnitZ()};  // keyframe

class MapTest : public ::testing::Test {
 protected:
  MapTest() : config_(small_config()) {
    Arena measure;
    Map measured(measure, config_);
    block_.resize(measure.used() + 16);
    void* start = block_.data();
    size_t space = block_.size();
    std::align(16, measure.used(), start, space);
    arena_ = Arena({static_cast<std::byte*>(start), measure.used()});
    map_ = Map(arena_, config_);
  }

  Vector6f random_twist(double translation, double rotation) {
    Vector6f mu;
    for (int i = 0; i < 3; ++i) {
      mu(i) = static_cast<float>(translation * random_.gaussian());
      mu(i + 3) = static_cast<float>(rotation * random_.gaussian());
    }
    return mu;
  }

  // Points one unit in front of cameras that all look at them.
  void fill(int keyframes, int points) {
    for (int k = 0; k < keyframes; ++k) ASSERT_EQ(test::add_keyframe(map_, SE3::exp(random_twist(0.06, 0.03))), k);
    for (int i = 0; i < points; ++i) {
      const Vector3f p_w(static_cast<float>(random_.uniform(-0.15, 0.15)),
                         static_cast<float>(random_.uniform(-0.2, 0.2)), static_cast<float>(random_.uniform(0.8, 1.2)));
      ASSERT_EQ(map_.add_point(p_w, kFromTheFirst), i);
      for (int k = 0; k < keyframes; ++k) map_.add_measurement(i, test::measure_exactly(map_, config_.camera, k, p_w));
    }
  }

  test::Random random_;
  Config config_;
  std::vector<std::byte> block_;
  Arena arena_;
  Map map_;
};

TEST_F(MapTest, ChangeOfCoordinatesKeepsTheImages) {
  fill(4, 20);
  const int slot = map_.add_partial_point({1, Vector2f::Zero(), -Vector3f::UnitZ()}, Vector3f(0.1f, -0.05f, 1), 0.9f);
  ASSERT_GE(slot, 0);
  map_.set_depth(slot, 0.9f, 25);
  const PartialPoint& partial = map_.partial_points()[slot];
  map_.set_velocity(2, random_twist(0.2, 0.5));
  // One keyframe waits, another one is held.
  map_.queue().hold().frame.T_kw = SE3::exp(random_twist(0.06, 0.03));
  map_.queue().release();
  map_.queue().hold().frame.T_kw = SE3::exp(random_twist(0.06, 0.03));

  // Everything that the map can show: pixels of points, of moving keyframes and of partial points.
  const auto images = [&](const Map& map, const std::vector<Vector3f>& points) {
    std::vector<Vector2f> all;
    Vector2f px;
    for (const Vector3f& p : points) {
      for (const Keyframe& k : map.keyframes()) {
        EXPECT_TRUE(config_.camera.project(k.T_kw * p, &px));
        all.push_back(px);
        EXPECT_TRUE(config_.camera.project(pose_at(k.T_kw, k.velocity, 0.03f) * p, &px));
        all.push_back(px);
      }
      for (const KeyframeCandidate& candidate : map.queue().all()) {
        EXPECT_TRUE(config_.camera.project(candidate.frame.T_kw * p, &px));
        all.push_back(px);
      }
    }
    const Vector3f p_w = map.keyframes()[1].T_kw.inverse() * Vector3f(partial.ray / partial.inverse_depth);
    EXPECT_TRUE(config_.camera.project(map.keyframes()[2].T_kw * p_w, &px));
    all.push_back(px);
    return all;
  };
  const auto positions = [&] {
    std::vector<Vector3f> all;
    for (const MapPoint& point : map_.points())
      if (point.id != 0) all.push_back(point.p_w);
    return all;
  };
  const std::vector<Vector2f> before = images(map_, positions());
  const float relative_sigma = 1 / (std::sqrt(partial.information) * partial.inverse_depth);
  const float relative_depth = map_.keyframes()[0].mean_depth / map_.keyframes()[0].T_kw.t.norm();

  Similarity S;
  S.T = SE3::exp(random_twist(0.5, 0.8));
  S.scale = 3.7f;
  map_.apply(S);

  // Three products of rotations and two sums of coordinates of up to 8 units, seen from 3: some 20 roundings of 6e-8,
  // times 8 / 3, times f.
  const double tolerance_px = 20 * 6e-8 * 2.7 * 360;
  const std::vector<Vector2f> after = images(map_, positions());
  for (size_t i = 0; i < before.size(); ++i) EXPECT_LT((after[i] - before[i]).norm(), tolerance_px) << i;
  EXPECT_NEAR(1 / (std::sqrt(partial.information) * partial.inverse_depth), relative_sigma, 1e-6f);
  const Keyframe& first = map_.keyframes()[0];
  EXPECT_NEAR(first.mean_depth / (first.T_kw.t + S.scale * (first.T_kw.R * S.T.t)).norm(), relative_depth,
              1e-4f * relative_depth);
  // The same change with a scale that is off by a hundredth would show in the moving keyframe.
  MapAccess::keyframe(map_, 2).velocity.head<3>() *= 1.01f;
  const std::vector<Vector2f> wrong = images(map_, positions());
  double worst = 0;
  for (size_t i = 0; i < before.size(); ++i) worst = std::max<double>(worst, (wrong[i] - before[i]).norm());
  EXPECT_GT(worst, tolerance_px);
}

TEST_F(MapTest, ChangesOfCoordinatesAddUpUntilTheyAreTaken) {
  fill(2, 10);
  std::vector<Vector3f> before;
  for (const MapPoint& point : map_.points())
    if (point.id != 0) before.push_back(point.p_w);
  Similarity S, first, second;
  EXPECT_FALSE(map_.take_transform(&S));
  first.T = SE3::exp(random_twist(0.5, 0.8));
  first.scale = 3.7f;
  second.T = SE3::exp(random_twist(0.5, 0.8));
  second.scale = 0.2f;
  map_.apply(first);
  map_.apply(second);
  ASSERT_TRUE(map_.take_transform(&S));
  EXPECT_FALSE(map_.take_transform(&S)) << "taken once";
  // A dozen roundings of coordinates up to 4 units.
  const float tolerance = 12 * 4 * 6e-8f;
  float worst_last = 0;
  for (size_t i = 0; i < before.size(); ++i) {
    const Vector3f& after = map_.points()[static_cast<int>(i)].p_w;
    EXPECT_LT((S * before[i] - after).norm(), tolerance);
    worst_last = std::max(worst_last, (second * before[i] - after).norm());
  }
  EXPECT_GT(worst_last, tolerance) << "the last change alone is not enough";
  map_.apply(first);
  map_.clear();
  EXPECT_FALSE(map_.take_transform(&S)) << "of a map that is gone";
}

TEST_F(MapTest, ScalesThatLeaveTheUsableNumbersAreKnown) {
  fill(2, 10);
  EXPECT_TRUE(map_.can_change_scale(1));
  EXPECT_TRUE(map_.can_change_scale(1e7f));
  EXPECT_TRUE(map_.can_change_scale(1e-7f));
  // Points at a distance of about 1, a mean depth of 1.
  EXPECT_FALSE(map_.can_change_scale(2e8f));
  EXPECT_FALSE(map_.can_change_scale(0.5e-8f));
  MapAccess::keyframe(map_, 1).velocity[2] = 1000;
  EXPECT_FALSE(map_.can_change_scale(1e7f)) << "a speed of 1e10";
  MapAccess::keyframe(map_, 1).velocity[2] = 0;
  const int slot = map_.add_partial_point(kFromTheFirst, Vector3f::UnitZ(), 100);
  EXPECT_FALSE(map_.can_change_scale(1e-7f)) << "an inverse depth of 1e9";
  map_.set_depth(slot, 1, 1e20f);
  EXPECT_FALSE(map_.can_change_scale(1e7f)) << "an information of 1e34";
}

TEST_F(MapTest, HashSeesEveryBit) {
  fill(3, 10);
  const uint64_t hash = map_.hash();
  EXPECT_EQ(map_.hash(), hash);
  const auto flip = [&](float& value, const char* what) {
    uint32_t bits;
    std::memcpy(&bits, &value, 4);
    for (int bit = 0; bit < 32; ++bit) {
      const uint32_t flipped = bits ^ (1u << bit);
      std::memcpy(&value, &flipped, 4);
      EXPECT_NE(map_.hash(), hash) << what << ", bit " << bit;
    }
    std::memcpy(&value, &bits, 4);
  };
  flip(MapAccess::keyframe(map_, 1).T_kw.R(2, 1), "rotation");
  flip(MapAccess::keyframe(map_, 2).T_kw.t.z(), "translation");
  flip(MapAccess::point(map_, 9).p_w.y(), "position");
  flip(MapAccess::measurement(map_, 3, 2).at.px.x(), "measurement");
  MapAccess::measurement(map_, 3, 2).keyframe = 0;
  EXPECT_NE(map_.hash(), hash);
  MapAccess::measurement(map_, 3, 2).keyframe = 2;
  EXPECT_EQ(map_.hash(), hash);
  map_.remove_measurement(4, 1);
  EXPECT_NE(map_.hash(), hash);
  map_.remove_point(7);
  const uint64_t without = map_.hash();
  map_.remove_point(7);
  EXPECT_EQ(map_.hash(), without);
}

TEST_F(MapTest, FullPoolsSayWhichOne) {
  EXPECT_EQ(map_.limits_hit(), 0u);
  fill(2, config_.max_map_points);
  EXPECT_EQ(map_.point_count(), config_.max_map_points);
  EXPECT_EQ(map_.limits_hit(), 0u);
  EXPECT_EQ(map_.add_point(Vector3f::Zero(), kFromTheFirst), -1);
  EXPECT_EQ(map_.limits_hit(), static_cast<uint32_t>(kLimitMapPoints));
  const uint32_t id = map_.points()[5].id;
  map_.remove_point(5);
  EXPECT_EQ(map_.add_point(Vector3f::Zero(), kFromTheFirst), 5) << "a free slot is used again";
  EXPECT_GT(map_.points()[5].id, id) << "an id never";
  EXPECT_EQ(map_.points()[5].measurements.size(), 0);

  const auto add_partial_point = [&] { return map_.add_partial_point(kFromTheFirst, Vector3f::UnitZ(), 1); };
  for (int i = 0; i < config_.max_partial_points; ++i) EXPECT_EQ(add_partial_point(), i);
  EXPECT_EQ(add_partial_point(), -1);
  EXPECT_EQ(map_.limits_hit(), kLimitMapPoints | kLimitPartialPoints);

  for (int k = map_.keyframes().size(); k < map_.keyframes().capacity(); ++k)
    EXPECT_EQ(test::add_keyframe(map_, SE3()), k);
  EXPECT_FALSE(map_.full());
  EXPECT_EQ(test::add_keyframe(map_, SE3()), -1);
  EXPECT_TRUE(map_.full());
  EXPECT_EQ(map_.limits_hit(), kLimitMapPoints | kLimitPartialPoints | kLimitKeyframes);

  const uint32_t epoch = map_.epoch();
  const uint32_t next_id = MapAccess::next_id(map_);
  map_.clear();
  EXPECT_EQ(map_.epoch(), epoch + 1);
  EXPECT_EQ(map_.limits_hit(), 0u);
  EXPECT_EQ(map_.point_count(), 0);
  EXPECT_FALSE(map_.exists());
  EXPECT_FALSE(map_.ready());
  EXPECT_FALSE(map_.full());
  EXPECT_EQ(MapAccess::next_id(map_), next_id);
}

// What a full pool of measurements refuses is all that is lost.
TEST_F(MapTest, AFullMeasurementPoolSaysSo) {
  config_.max_measurements = 30;  // ten points, five of each: three more than they need
  test::Block block([&](Arena& arena) { map_ = Map(arena, config_); });
  fill(5, 10);
  EXPECT_EQ(map_.limits_hit(), 0u);
  const int keyframe = test::add_keyframe(map_, SE3::exp(random_twist(0.06, 0.03)));
  const uint64_t hash = map_.hash();
  const auto measure = [&](int i) {
    return test::measure_exactly(map_, config_.camera, keyframe, map_.points()[i].p_w);
  };
  for (int i = 0; i < 10; ++i) {
    map_.add_measurement(i, measure(i));
    EXPECT_EQ(map_.limits_hit(), static_cast<uint32_t>(kLimitMeasurements)) << i;
    EXPECT_EQ(map_.points()[i].measurements.size(), 5) << i;
  }
  EXPECT_EQ(map_.hash(), hash);
  map_.check_consistency();
  // Room again, for all that a point measured.
  map_.remove_point(3);
  for (int i : {0, 1, 2}) {
    map_.add_measurement(i, measure(i));
    EXPECT_EQ(map_.points()[i].measurements.size(), 6) << i;
    EXPECT_TRUE(map_.measured_in(map_.points()[i], keyframe)) << i;
  }
  map_.add_measurement(6, measure(6));
  EXPECT_EQ(map_.points()[6].measurements.size(), 5) << "full again";
  // A new point has places for the two that it needs all the same.
  const int point = map_.add_point(map_.points()[0].p_w, map_.points()[0].source);
  ASSERT_EQ(point, 3);
  for (const int k : {0, 1, 2})
    map_.add_measurement(point, test::measure_exactly(map_, config_.camera, k, map_.points()[point].p_w));
  EXPECT_EQ(map_.points()[point].measurements.size(), 2);
  map_.check_consistency();
  map_.clear();
  EXPECT_EQ(map_.limits_hit(), 0u);
  fill(5, 10);
  EXPECT_EQ(map_.limits_hit(), 0u) << "all places are there again";
}

TEST_F(MapTest, APointHasOneMeasurementTooManyAtMost) {
  fill(3, 1);
  for (int i = 0; i < 20; ++i) map_.add_measurement(0, map_.measurements(map_.points()[0])[0]);
  EXPECT_EQ(map_.points()[0].measurements.size(), config_.max_measurements_per_point + 1);
  EXPECT_EQ(map_.limits_hit(), 0u) << "culling makes room";
}

// Every keyframe's storage, the queue's too, must stay distinct however often they are swapped.
bool storage_is_distinct(const Map& map) {
  std::vector<const uint8_t*> blocks;
  const auto add = [&](const Keyframe& keyframe) {
    blocks.push_back(keyframe.storage.level[0].data);
    blocks.push_back(keyframe.small.data);
  };
  for (const Keyframe& keyframe : map.keyframes()) add(keyframe);
  for (const KeyframeCandidate& candidate : map.queue().all()) add(candidate.frame);
  std::sort(blocks.begin(), blocks.end());
  return std::adjacent_find(blocks.begin(), blocks.end()) == blocks.end() && blocks.front() != nullptr;
}

TEST_F(MapTest, KeyframesKeepTheirOwnImagesThroughTheQueue) {
  for (int k = 0; k < config_.max_keyframes; ++k) {
    Keyframe& frame = map_.queue().hold().frame;
    frame.timestamp_ns = 100 + k;
    frame.storage.level[0].at(3, 4) = static_cast<uint8_t>(k);
    map_.queue().release();
    // Another one is on its way meanwhile, and given up.
    map_.queue().hold().frame.storage.level[0].at(3, 4) = 200;
    EXPECT_TRUE(storage_is_distinct(map_));
    ASSERT_EQ(map_.add_keyframe(map_.queue().front().frame), k);
    EXPECT_TRUE(storage_is_distinct(map_));
    map_.queue().pop();
    EXPECT_EQ(map_.queue().waiting(), 0);
    EXPECT_TRUE(map_.queue().holding());
    map_.queue().clear();
  }
  for (int k = 0; k < config_.max_keyframes; ++k) {
    EXPECT_EQ(map_.keyframes()[k].timestamp_ns, 100 + k);
    EXPECT_EQ(map_.keyframes()[k].storage.level[0].at(3, 4), k);
  }
}

// What was made since an id goes as if it had never been: keyframes, live and erased, what was measured in them, points
// and partial points that only they saw, and what waits in the queue. What was there before stays.
TEST_F(MapTest, KeyframesSinceAnIdAreDropped) {
  fill(3, 20);
  map_.add_partial_point(kFromTheFirst, Vector3f::UnitZ(), 1);
  const uint64_t before = map_.hash();
  const uint32_t id = map_.next_id(), epoch = map_.epoch();
  for (int k = 3; k < 6; ++k) {
    ASSERT_EQ(test::add_keyframe(map_, SE3::exp(random_twist(0.06, 0.03))), k);
    for (int i = 0; i < 20; ++i)
      map_.add_measurement(i, test::measure_exactly(map_, config_.camera, k, map_.points()[i].p_w));
  }
  const Vector3f seen_late(0.1f, 0, 1);
  const int late = map_.add_point(seen_late, {4, Vector2f::Zero(), -Vector3f::UnitZ()});
  for (const int k : {2, 4}) map_.add_measurement(late, test::measure_exactly(map_, config_.camera, k, seen_late));
  const int partial = map_.add_partial_point({3, Vector2f::Zero(), -Vector3f::UnitZ()}, Vector3f::UnitZ(), 1);
  map_.erase_keyframe(5);
  map_.queue().hold();
  map_.queue().release();
  EXPECT_NE(map_.hash(), before) << "control";

  map_.set_full(true);
  EXPECT_EQ(map_.drop_keyframes_since(id), 3);
  EXPECT_FALSE(map_.full()) << "there is room again";
  map_.check_consistency();
  EXPECT_EQ(map_.hash(), before);
  EXPECT_EQ(map_.live_count(), 3);
  EXPECT_EQ(map_.erased_count(), 0);
  EXPECT_EQ(map_.partial_points()[partial].id, 0u);
  EXPECT_NE(map_.partial_points()[0].id, 0u);
  EXPECT_EQ(map_.queue().waiting(), 0);
  EXPECT_EQ(map_.epoch(), epoch + 1) << "a paused job of the mapper knows the old ones";
  EXPECT_EQ(map_.drop_keyframes_since(map_.next_id()), 0);
  EXPECT_EQ(map_.epoch(), epoch + 1) << "nothing has changed";
}

// ---- several maps ----

TEST_F(MapTest, AnotherMapIsLeftAsItIs) {
  fill(4, 20);
  map_.finish();
  EXPECT_EQ(map_.number(), 1u);
  const uint64_t hash = map_.hash();
  const uint32_t epoch = map_.epoch();
  map_.set_aside();
  EXPECT_NE(map_.epoch(), epoch) << "jobs in the old map are dropped";
  EXPECT_FALSE(map_.exists());
  EXPECT_EQ(map_.point_count(), 0);
  EXPECT_EQ(map_.number(), 0u);
  EXPECT_EQ(map_.aside_count(), 1);
  fill(3, 10);
  map_.check_consistency();
  const uint64_t other = map_.hash();
  int place = 0;
  while (!map_.is_aside(place)) ++place;
  map_.exchange(place);
  EXPECT_EQ(map_.hash(), hash);
  EXPECT_EQ(map_.number(), 1u);
  map_.check_consistency();
  map_.exchange(place);
  EXPECT_EQ(map_.hash(), other);
  map_.finish();
  EXPECT_EQ(map_.number(), 2u);
  map_.exchange(place);
  map_.settle(place);
  EXPECT_EQ(map_.hash(), hash);
  EXPECT_EQ(map_.aside_count(), 1) << "a finished map is kept";
  EXPECT_EQ(map_.number_aside(place), 2u);
  map_.clear_all();
  EXPECT_EQ(map_.aside_count(), 0);
  EXPECT_FALSE(map_.exists());
  fill(3, 10);
  map_.finish();
  EXPECT_EQ(map_.number(), 3u) << "a number is not given twice";
}

TEST_F(MapTest, AStartThatIsLeftIsGivenUp) {
  fill(4, 20);
  map_.finish();
  map_.set_aside();
  fill(3, 10);  // not finished
  int place = 0;
  while (!map_.is_aside(place)) ++place;
  map_.exchange(place);
  map_.settle(place);
  EXPECT_EQ(map_.number(), 1u);
  EXPECT_EQ(map_.aside_count(), 0);
  map_.check_consistency();
}

// All images are taken: a new keyframe has those of the oldest erased keyframe of a map that is set aside, whose points
// then have another source or are gone; when there is none the map is full.
TEST_F(MapTest, ImagesComeFromErasedKeyframesOfOtherMaps) {
  const int slots = keyframe_slots(config_.max_keyframes, config_.max_erased_keyframes);
  fill(8, 20);
  while (map_.keyframes().size() < slots) ASSERT_GE(test::add_keyframe(map_, SE3()), 0);
  for (int k = 8; k < slots; ++k) map_.erase_keyframe(k);
  map_.finish();
  map_.set_aside();
  int made = 0;
  for (; made < slots; ++made) {
    if (test::add_keyframe(map_, SE3()) < 0) break;
    map_.check_consistency();
  }
  EXPECT_EQ(made, slots - 8);
  EXPECT_TRUE(map_.full());
  EXPECT_EQ(map_.max_live(), config_.max_keyframes);
  int place = 0;
  while (!map_.is_aside(place)) ++place;
  map_.exchange(place);
  map_.check_consistency();
  EXPECT_EQ(map_.live_count(), 8);
  EXPECT_EQ(map_.erased_count(), 0);
  EXPECT_EQ(map_.point_count(), 20);
}

}  // namespace
}  // namespace pptam
