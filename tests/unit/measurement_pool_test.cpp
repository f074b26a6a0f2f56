// The pool of measurements: lists keep their order, places are used again, a full pool refuses and loses nothing.
#include "map/measurement_pool.h"

#include <gtest/gtest.h>

#include <vector>

#include "tests/support/map_building.h"
#include "tests/support/random.h"

namespace pptam {
namespace {

Measurement numbered(int number) {
  Measurement m;
  m.at.px = Vector2f(static_cast<float>(number), 0.5f);
  m.keyframe = static_cast<int16_t>(number % 1000);
  return m;
}
int number_of(const Measurement& m) {
  return static_cast<int>(m.at.px.x());
}

class MeasurementPoolTest : public ::testing::Test {
 protected:
  static constexpr int kCapacity = 40;
  MeasurementPoolTest() : block_([&](Arena& arena) { pool_ = MeasurementPool(arena, kCapacity); }) {}

  std::vector<int> numbers(const MeasurementPool::List& list) const {
    std::vector<int> all;
    for (const Measurement& m : pool_.range(list)) all.push_back(number_of(m));
    EXPECT_EQ(static_cast<int>(all.size()), list.size());
    EXPECT_EQ(pool_.range(list).size(), list.size());
    for (int i = 0; i < list.size(); ++i) EXPECT_EQ(number_of(pool_.range(list)[i]), all[static_cast<size_t>(i)]);
    return all;
  }
  void fill(MeasurementPool::List* list, int count) {
    for (int i = 0; i < count; ++i) ASSERT_TRUE(pool_.push_back(list, numbered(i)));
  }

  MeasurementPool pool_;
  test::Block block_;
};

TEST_F(MeasurementPoolTest, ListsKeepTheirOrder) {
  MeasurementPool::List list;
  EXPECT_EQ(numbers(list), std::vector<int>());
  fill(&list, 6);
  EXPECT_EQ(numbers(list), (std::vector<int>{0, 1, 2, 3, 4, 5}));
  pool_.erase(&list, 2);
  EXPECT_EQ(numbers(list), (std::vector<int>{0, 1, 3, 4, 5}));
  pool_.erase(&list, 4);  // the last
  pool_.erase(&list, 0);  // the first
  EXPECT_EQ(numbers(list), (std::vector<int>{1, 3, 4}));
  ASSERT_TRUE(pool_.push_back(&list, numbered(9)));
  EXPECT_EQ(numbers(list), (std::vector<int>{1, 3, 4, 9})) << "at the end, wherever its place was";
  pool_.at(&list, 1) = numbered(7);
  EXPECT_EQ(numbers(list), (std::vector<int>{1, 7, 4, 9}));
  pool_.erase_all(&list);
  EXPECT_EQ(list.size(), 0);
  EXPECT_EQ(numbers(list), std::vector<int>());
}

TEST_F(MeasurementPoolTest, AFullPoolRefusesAndLosesNothing) {
  MeasurementPool::List a, b;
  fill(&a, kCapacity - 1);
  fill(&b, 1);
  const std::vector<int> in_a = numbers(a);
  EXPECT_FALSE(pool_.push_back(&a, numbered(99)));
  EXPECT_FALSE(pool_.push_back(&b, numbered(99)));
  EXPECT_EQ(numbers(a), in_a);
  EXPECT_EQ(numbers(b), std::vector<int>{0});
  pool_.erase(&a, 5);
  EXPECT_TRUE(pool_.push_back(&b, numbered(99))) << "one list's place is another's";
  EXPECT_FALSE(pool_.push_back(&b, numbered(99)));
  EXPECT_EQ(numbers(b), (std::vector<int>{0, 99}));
  MeasurementPool none;
  EXPECT_FALSE(none.push_back(&a, numbered(0)));
}

TEST_F(MeasurementPoolTest, ClearedItHasAllOfItsPlaces) {
  MeasurementPool::List list;
  fill(&list, 17);
  pool_.erase(&list, 3);
  pool_.clear();
  list = {};
  fill(&list, kCapacity);
  EXPECT_FALSE(pool_.push_back(&list, numbered(99)));
}

// Beside plain vectors, whatever happens.
TEST_F(MeasurementPoolTest, IsAsManyVectors) {
  test::Random random;
  constexpr int kLists = 7;
  MeasurementPool::List lists[kLists];
  std::vector<int> model[kLists];
  int used = 0, refused = 0, next = 0;
  for (int step = 0; step < test::trials(20000); ++step) {
    const int which = random.integer(0, kLists - 1);
    MeasurementPool::List& list = lists[which];
    std::vector<int>& expected = model[which];
    const int what = random.integer(0, 99);
    if (what < 60) {
      const bool added = pool_.push_back(&list, numbered(next));
      ASSERT_EQ(added, used < kCapacity);
      if (added) expected.push_back(next);
      used += added;
      refused += !added;
      ++next;
    } else if (what < 95 && list.size() > 0) {
      const int i = random.integer(0, list.size() - 1);
      pool_.erase(&list, i);
      expected.erase(expected.begin() + i);
      --used;
    } else if (what < 99) {
      pool_.erase_all(&list);
      used -= static_cast<int>(expected.size());
      expected.clear();
    } else {
      pool_.clear();
      for (int l = 0; l < kLists; ++l) {
        lists[l] = {};
        model[l].clear();
      }
      used = 0;
    }
    for (int l = 0; l < kLists; ++l) ASSERT_EQ(numbers(lists[l]), model[l]) << step;
  }
  EXPECT_GT(refused, 20) << "the pool must have been full";
}

}  // namespace
}  // namespace pptam
