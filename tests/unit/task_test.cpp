// Background jobs: pauses by the work meter, nested jobs, frames that go back to the stack, abandoning and restarting.
#include "scheduler/task.h"

#include <gtest/gtest.h>

#include <string>
#include <vector>

namespace pptam {
namespace {

class Jobs : public Background {
 public:
  Jobs(Arena& arena, size_t frame_bytes, WorkMeter& meter) : Background(arena, frame_bytes, meter) {}

  // Each unit costs `cost` instructions.
  Task<> count(int units, int64_t cost) {
    for (int i = 0; i < units; ++i) {
      meter_.charge(Work::kOther, cost);
      ++counted;
      co_await slice();
    }
  }
  Task<> outer(int depth, std::string name) {
    log += "(" + name;
    if (depth > 0) {
      co_await outer(depth - 1, name + "1");
      co_await rest();
      co_await outer(depth - 1, name + "2");
    }
    log += ")";
  }
  Task<int> sum(int units, int64_t cost) {
    int total = 0;
    for (int i = 1; i <= units; ++i) {
      total += i;
      co_await spend(Work::kOther, cost);
    }
    co_return total;
  }
  Task<> add_sums(int* result) {
    const int first = co_await sum(1000, 1000);
    const int second = co_await sum(10, 1);
    *result = first + second;
  }
  Task<> forever() {
    for (;;) {
      co_await outer(2, "x");
      ++rounds;
      co_await rest();
    }
  }
  Task<> nothing() { co_return; }

  void run(Task<> task) {
    resume();  // nothing paused: marks the slice's start
    task_ = std::move(task);
    task_.start();
  }
  void drop() {
    abandon();
    task_ = Task<>();
  }

  int counted = 0;
  int rounds = 0;
  std::string log;

 private:
  Task<> task_;
};

class TaskTest : public ::testing::Test {
 protected:
  static constexpr size_t kFrameBytes = 16 * 1024;
  alignas(16) std::byte block_[2 * kFrameBytes];
  Arena arena_{block_};
  WorkMeter meter_;
  Jobs jobs_{arena_, kFrameBytes, meter_};
};

TEST_F(TaskTest, ReturnsValuesAcrossPauses) {
  int result = 0;
  jobs_.run(jobs_.add_sums(&result));
  EXPECT_EQ(result, 0) << "a thousand times a thousand instructions are more than a slice";
  int slices = 1;
  for (; result == 0 && slices < 100; ++slices) jobs_.resume();
  EXPECT_EQ(result, 500500 + 55);
  // spend() pauses as slice() does: eight times within the thousand, then goes on to the end.
  EXPECT_EQ(slices, 1'000'000 / (kSliceInstructions / 2) + 1);
}

TEST_F(TaskTest, PausesWhenTheSliceIsUsedUpAndNotBefore) {
  jobs_.run(jobs_.count(1000, 1000));
  // The pause comes at the first slice() at which half of a slice's instructions are used: the other half is for the
  // longest stretch between two.
  const int per_slice = kSliceInstructions / 2 / 1000;
  EXPECT_EQ(jobs_.counted, per_slice);
  jobs_.resume();
  EXPECT_EQ(jobs_.counted, 2 * per_slice);
  // Work done by others between the slices does not shorten the next one.
  meter_.charge(Work::kOther, 10 * kSliceInstructions);
  jobs_.resume();
  EXPECT_EQ(jobs_.counted, 3 * per_slice);
  for (int i = 0; i < 100; ++i) jobs_.resume();  // beyond the end: harmless
  EXPECT_EQ(jobs_.counted, 1000);
}

TEST_F(TaskTest, FreeWorkNeverPauses) {
  jobs_.run(jobs_.count(5000, 0));
  EXPECT_EQ(jobs_.counted, 5000);
}

TEST_F(TaskTest, NestedJobsRunInOrderAndRestAlwaysPauses) {
  jobs_.run(jobs_.outer(2, "x"));
  EXPECT_EQ(jobs_.log, "(x(x1(x11)");
  jobs_.resume();
  EXPECT_EQ(jobs_.log, "(x(x1(x11)(x12))");
  jobs_.resume();
  EXPECT_EQ(jobs_.log, "(x(x1(x11)(x12))(x2(x21)");
  jobs_.resume();
  EXPECT_EQ(jobs_.log, "(x(x1(x11)(x12))(x2(x21)(x22)))");
  jobs_.resume();
  EXPECT_EQ(jobs_.log, "(x(x1(x11)(x12))(x2(x21)(x22)))");
}

// Frames take a few hundred bytes each; the stack of 16 KB would overflow (and trap) within some tens of rounds if a
// frame stayed behind.
TEST_F(TaskTest, FramesGoBackToTheStack) {
  jobs_.run(jobs_.forever());
  for (int i = 0; i < 4 * 1000; ++i) jobs_.resume();
  EXPECT_EQ(jobs_.rounds, 1000);  // four pauses a round
  void* probe = jobs_.frames().push(16);
  jobs_.frames().pop(probe);
  jobs_.drop();
  for (int i = 0; i < 1000; ++i) {
    jobs_.run(jobs_.nothing());
    jobs_.drop();  // the old job's frame goes before the next one's comes: last in, first out
  }
  void* first = jobs_.frames().push(kFrameBytes);  // all of it is free again
  EXPECT_NE(first, nullptr);
  jobs_.frames().pop(first);
}

TEST_F(TaskTest, AJobMayBeAbandonedAtAnyPauseAndStartedAgain) {
  for (int round = 0; round < 1000; ++round) {
    jobs_.run(jobs_.forever());
    for (int i = 0; i < round % 7; ++i) jobs_.resume();
    jobs_.drop();
    const std::string log = jobs_.log;
    jobs_.resume();
    EXPECT_EQ(jobs_.log, log) << "an abandoned job does not go on";
    jobs_.log.clear();
    void* all = jobs_.frames().push(kFrameBytes);
    jobs_.frames().pop(all);
  }
}

TEST_F(TaskTest, MovingATaskMovesItsJob) {
  Task<> a = jobs_.count(3, kSliceInstructions);
  Task<> b = std::move(a);
  a = Task<>();  // empty: destroys nothing
  jobs_.resume();
  b.start();
  EXPECT_EQ(jobs_.counted, 1);
  jobs_.resume();
  jobs_.resume();
  EXPECT_EQ(jobs_.counted, 3);
}

int asserts = 0;

TEST(FrameStackDeathTest, OverflowStops) {
  alignas(16) std::byte block[64];
  EXPECT_DEATH(
      {
        set_assert_handler([](const char*, const char*, int) { ++asserts; });
        Arena arena(block);
        FrameStack stack(arena, 64);
        stack.push(48);
        stack.push(17);
      },
      "");
}

}  // namespace
}  // namespace pptam
