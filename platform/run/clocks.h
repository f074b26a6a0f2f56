// The real clocks that a run can be timed by, next to the core's deterministic WorkClock.
#pragma once

#include <cstdint>

#include <pocket_ptam/clock.h>

namespace pptam::platform {

enum class ClockKind {
  kWork,      // modelled time of the work charged: repeatable bit for bit
  kSteady,    // real time
  kThrottled  // CPU time times RunOptions::slowdown
};

// The operating system's monotonic clock: frames come at their own pace, in real time.
class SteadyClock final : public Clock {
 public:
  int64_t now_ns() const override;
  void idle_until(int64_t t_ns) override;  // sleeps, but not on after a signal that ends the run
};

// This thread's CPU time times a factor, plus the idle time skipped: a desktop that is slowed down to a phone. Time
// spent waiting for the disk or for other programs does not count. One thread only.
class ThrottledClock final : public Clock {
 public:
  explicit ThrottledClock(double slowdown) : slowdown_(slowdown) {}
  int64_t now_ns() const override;
  void idle_until(int64_t t_ns) override;  // jumps
  void forget_since(int64_t t_ns) override;

 private:
  double slowdown_;
  int64_t skipped_ns_ = 0;
};

}  // namespace pptam::platform
