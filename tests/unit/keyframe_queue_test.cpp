// The queue through which the tracker hands over keyframes: who waits, who is held, and whose images are whose.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstring>
#include <utility>
#include <vector>

#include "image/pyramid.h"
#include "map/keyframe.h"
#include "tests/support/map_building.h"
#include "tests/support/phone_camera.h"
#include "tests/support/random.h"

namespace pptam {
namespace {

class KeyframeQueueTest : public ::testing::Test {
 protected:
  static constexpr int kMeasurements = 10;
  KeyframeQueueTest()
      : block_([&](Arena& arena) {
          queue_ = KeyframeQueue(arena, test::phone_camera(), kMeasurements);
          for (Keyframe& keyframe : others_) keyframe = Keyframe(arena, test::phone_camera());
        }) {}
  // Says who it is in all that changes hands.
  static void fill(KeyframeCandidate& candidate, int number) {
    candidate.frame.timestamp_ns = number;
    candidate.frame.storage.level[0].at(3, 4) = candidate.frame.small.at(5, 6) = static_cast<uint8_t>(number);
    KeyframeMeasurement m;
    m.point = number;
    candidate.measurements.push_back(m);
  }
  static bool is(const KeyframeCandidate& candidate, int number) {
    return is(candidate.frame, number) && candidate.measurements.size() == 1 &&
           candidate.measurements[0].point == number;
  }
  static bool is(const Keyframe& frame, int number) {
    return frame.timestamp_ns == number && frame.storage.level[0].at(3, 4) == static_cast<uint8_t>(number) &&
           frame.small.at(5, 6) == static_cast<uint8_t>(number);
  }

  KeyframeQueue queue_;
  Keyframe others_[3];  // of a map
  test::Block block_;
};

TEST_F(KeyframeQueueTest, TheOldestComesFirst) {
  EXPECT_EQ(queue_.waiting(), 0);
  ASSERT_TRUE(queue_.can_hold());
  fill(queue_.hold(), 1);
  EXPECT_TRUE(queue_.holding());
  EXPECT_FALSE(queue_.can_hold()) << "one at a time";
  EXPECT_EQ(queue_.waiting(), 0) << "it does not wait yet";
  EXPECT_TRUE(is(queue_.held(), 1));
  queue_.release();
  EXPECT_FALSE(queue_.holding());
  EXPECT_EQ(queue_.waiting(), 1);
  ASSERT_TRUE(queue_.can_hold());
  fill(queue_.hold(), 2);
  EXPECT_TRUE(is(queue_.front(), 1));
  EXPECT_EQ(queue_.all().size(), 2u);
  queue_.release();
  EXPECT_EQ(queue_.waiting(), 2);
  EXPECT_FALSE(queue_.can_hold()) << "full";
  EXPECT_TRUE(is(queue_.waiting(0), 1));
  EXPECT_TRUE(is(queue_.waiting(1), 2));
  queue_.pop();
  EXPECT_TRUE(is(queue_.front(), 2));
  EXPECT_EQ(queue_.waiting(), 1);
  fill(queue_.hold(), 3);
  queue_.pop();  // while one is held
  EXPECT_EQ(queue_.waiting(), 0);
  ASSERT_TRUE(queue_.holding());
  EXPECT_TRUE(is(queue_.held(), 3)) << "what it measured was forgotten when it was held, and it has stayed";
  queue_.release();
  EXPECT_TRUE(is(queue_.front(), 3));
  fill(queue_.hold(), 4);
  queue_.clear();
  EXPECT_EQ(queue_.waiting(), 0);
  EXPECT_FALSE(queue_.holding());
  EXPECT_TRUE(queue_.all().empty());
  EXPECT_EQ(queue_.hold().measurements.size(), 0);
}

TEST_F(KeyframeQueueTest, EverybodyKeepsStorageOfTheirOwn) {
  test::Random random;
  // All there is: two places here, three keyframes elsewhere; that the places not in use are whole shows when they are.
  int next = 1, last_popped = 0;
  int elsewhere[3] = {};
  for (Keyframe& keyframe : others_) {
    keyframe.timestamp_ns = 0;
    keyframe.storage.level[0].at(3, 4) = keyframe.small.at(5, 6) = 0;
  }
  int popped = 0;
  for (int step = 0; step < 2000; ++step) {
    const int what = random.integer(0, 2);
    if (what == 0 && queue_.can_hold()) fill(queue_.hold(), next++);
    if (what == 1 && queue_.holding()) queue_.release();
    if (what == 2 && queue_.waiting() > 0) {
      EXPECT_EQ(queue_.front().frame.timestamp_ns, last_popped + 1) << "in the order in which they came";
      ++last_popped;
      const int slot = random.integer(0, 2);
      elsewhere[slot] = static_cast<int>(queue_.front().frame.timestamp_ns);
      std::swap(others_[slot], queue_.front().frame);  // as Map::add_keyframe
      queue_.pop();
      ++popped;
    }
    int number = last_popped;
    for (const KeyframeCandidate& candidate : queue_.all()) ASSERT_TRUE(is(candidate, ++number)) << step;
    for (int i = 0; i < 3; ++i) ASSERT_TRUE(is(others_[i], elsewhere[i])) << step;
    std::vector<const uint8_t*> blocks;
    for (const KeyframeCandidate& candidate : queue_.all()) blocks.push_back(candidate.frame.storage.level[0].data);
    for (const Keyframe& keyframe : others_) blocks.push_back(keyframe.storage.level[0].data);
    std::sort(blocks.begin(), blocks.end());
    ASSERT_EQ(std::adjacent_find(blocks.begin(), blocks.end()), blocks.end()) << step;
  }
  EXPECT_GT(popped, 100);
}

TEST_F(KeyframeQueueTest, AChangeOfCoordinatesMovesTheHeldOneToo) {
  test::Random random;
  const auto twist = [&](double size) {
    Vector6f v;
    for (int i = 0; i < 6; ++i) v[i] = static_cast<float>(size * random.gaussian());
    return v;
  };
  const auto fill_pose = [&](Keyframe& frame) {
    frame.T_kw = SE3::exp(twist(0.3));
    frame.velocity = twist(0.5);
    frame.velocity_prior = twist(0.5);
    frame.mean_depth = 1.5f;
  };
  fill_pose(queue_.hold().frame);
  queue_.release();
  fill_pose(queue_.hold().frame);
  std::vector<Keyframe> before;
  for (const KeyframeCandidate& candidate : queue_.all()) before.push_back(candidate.frame);
  ASSERT_EQ(before.size(), 2u);
  Similarity S;
  S.T = SE3::exp(twist(0.5));
  S.scale = 3.7f;
  queue_.apply(S);
  // A dozen roundings of coordinates of up to 8 units.
  const float tolerance = 12 * 8 * 6e-8f;
  for (int i = 0; i < 2; ++i) {
    const Keyframe& frame = queue_.all()[static_cast<size_t>(i)].frame;
    const Keyframe& old = before[static_cast<size_t>(i)];
    const Vector3f p_w(0.2f, -0.3f, 1.1f);
    EXPECT_LT((frame.T_kw * (S * p_w) - S.scale * (old.T_kw * p_w)).norm(), tolerance) << i;
    EXPECT_GT((frame.T_kw.t - old.T_kw.t).norm(), tolerance) << i;
    for (const auto& [now, then] :
         {std::pair(frame.velocity, old.velocity), std::pair(frame.velocity_prior, old.velocity_prior)}) {
      EXPECT_LT((now.head<3>() - S.scale * then.head<3>()).norm(), tolerance) << i;
      EXPECT_EQ(now.tail<3>(), then.tail<3>()) << i;
    }
    EXPECT_FLOAT_EQ(frame.mean_depth, S.scale * old.mean_depth) << i;
  }
  // A free place is nobody's.
  queue_.pop();
  const SE3 held = queue_.held().frame.T_kw;
  queue_.clear();
  queue_.apply(S);
  EXPECT_EQ(queue_.hold().frame.T_kw.t, held.t);
}

TEST_F(KeyframeQueueTest, ImagesAreCopied) {
  test::Random random;
  Keyframe& from = others_[0];
  const GreyImage& image = from.storage.level[0];
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x) image.at(x, y) = static_cast<uint8_t>(random.integer(0, 255));
  from.pyramid = build_pyramid(image, from.storage);
  make_small_image(from.pyramid, from.small);
  Keyframe& to = queue_.hold().frame;
  to.set_images(from.pyramid, from.small);
  const auto same = [&] {
    bool all = true;
    const auto compare = [&](const GreyView& a, const GreyView& b) {
      ASSERT_TRUE(a.width == b.width && a.height == b.height);
      ASSERT_NE(a.data, b.data);
      for (int y = 0; y < a.height; ++y)
        all = all && std::memcmp(a.row(y), b.row(y), static_cast<size_t>(a.width)) == 0;
    };
    for (int l = 0; l < kPyramidLevels; ++l) compare(from.pyramid.level[l], to.pyramid.level[l]);
    compare(from.small, to.small);
    return all;
  };
  EXPECT_TRUE(same());
  from.small.at(7, 8) = static_cast<uint8_t>(from.small.at(7, 8) + 1);
  EXPECT_FALSE(same()) << "copies, not views";
}

}  // namespace
}  // namespace pptam
