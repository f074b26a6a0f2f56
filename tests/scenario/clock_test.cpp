// Clocks at the ends of time: frames may carry any timestamps, and none of them turns time back or round.
#include <gtest/gtest.h>

#include <limits>

#include <pocket_ptam/clock.h>
#include "platform/run/clocks.h"

namespace pptam {
namespace {

constexpr int64_t kFirst = std::numeric_limits<int64_t>::min();
constexpr int64_t kLast = std::numeric_limits<int64_t>::max();

TEST(Clock, SumsAndDifferencesStayWithinInt64) {
  static_assert(saturated_sum(2, 3) == 5 && saturated_difference(2, 3) == -1);
  static_assert(saturated_sum(kLast, kFirst) == -1 && saturated_difference(kLast, kLast) == 0);
  static_assert(saturated_sum(kLast - 1, 1) == kLast && saturated_sum(kLast, 1) == kLast);
  static_assert(saturated_sum(kFirst + 1, -1) == kFirst && saturated_sum(kFirst, -1) == kFirst);
  static_assert(saturated_difference(kFirst, 1) == kFirst && saturated_difference(kFirst, kLast) == kFirst);
  static_assert(saturated_difference(kLast, -1) == kLast && saturated_difference(0, kFirst) == kLast);
  static_assert(saturated_difference(-1, kFirst) == kLast && saturated_difference(kFirst, kFirst) == 0);
}

TEST(Clock, TheWorkClockStopsAtTheLastInstant) {
  WorkMeter meter;
  WorkClock clock(meter);
  meter.charge(Work::kGreyPixel, 100000);
  const int64_t begun = clock.now_ns();
  EXPECT_GT(begun, 0);
  clock.idle_until(kFirst);
  EXPECT_EQ(clock.now_ns(), begun);
  clock.idle_until(kLast);
  EXPECT_EQ(clock.now_ns(), kLast);
  meter.charge(Work::kGreyPixel, 100000);
  EXPECT_EQ(clock.now_ns(), kLast) << "wraps round to the past without saturation";
  clock.idle_until(kLast);
  EXPECT_EQ(clock.now_ns(), kLast);
}

TEST(Clock, WorkThatTakesTooLongForInt64EndsAtTheLastInstant) {
  PhoneProfile slow;
  slow.clock_mhz = 1;
  slow.cycles_per_instruction = 100;
  WorkMeter meter(slow);
  meter.charge(Work::kOther, 1'000'000);
  EXPECT_EQ(meter.modelled_ns(), 100'000'000'000) << "a million instructions of 100 us";
  meter.charge(Work::kOther, 100'000'000'000'000);  // 1e19 ns, where int64_t ends at 9.2e18
  EXPECT_EQ(meter.modelled_ns(), kLast);
}

TEST(Clock, TheThrottledClockForgetsWhatIsNotThePhonesWork) {
  platform::ThrottledClock clock(100);
  clock.idle_until(1'000'000'000'000);
  const int64_t before = clock.now_ns();
  double sum = 0;
  while (clock.now_ns() < before + 1'000'000'000) sum += 1;  // 10 ms of this thread
  EXPECT_GT(sum, 0);
  clock.forget_since(before);
  EXPECT_LT(clock.now_ns(), before + 500'000'000);
  clock.idle_until(kLast);
  EXPECT_GE(clock.now_ns(), kLast - 1'000'000'000);
  clock.forget_since(kFirst);  // nobody asks for this: it must only be harmless
  EXPECT_LT(clock.now_ns(), kLast);
}

}  // namespace
}  // namespace pptam
