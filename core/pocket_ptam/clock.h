// Time comes from outside, in nanoseconds from any origin. A frame's timestamp may be any int64_t, so times are added
// and subtracted with saturated_sum() and saturated_difference().
#pragma once

#include <cstdint>
#include <limits>

#include <pocket_ptam/work_meter.h>

namespace pptam {

// a + b and a - b; where the result does not fit, the nearest end of int64_t's range.
constexpr int64_t saturated_sum(int64_t a, int64_t b) {
  if (b > 0 && a > std::numeric_limits<int64_t>::max() - b) return std::numeric_limits<int64_t>::max();
  if (b < 0 && a < std::numeric_limits<int64_t>::min() - b) return std::numeric_limits<int64_t>::min();
  return a + b;
}
constexpr int64_t saturated_difference(int64_t a, int64_t b) {
  if (b < 0 && a > std::numeric_limits<int64_t>::max() + b) return std::numeric_limits<int64_t>::max();
  if (b > 0 && a < std::numeric_limits<int64_t>::min() + b) return std::numeric_limits<int64_t>::min();
  return a - b;
}

class Clock {
 public:
  virtual ~Clock() = default;
  virtual int64_t now_ns() const = 0;  // never decreases, except by forget_since()
  // Sleeps until t_ns; a virtual clock jumps there. Returns at once when t_ns is in the past.
  virtual void idle_until(int64_t t_ns) = 0;
  // Says that what was done since t_ns (a value of now_ns()) is not the device's work, such as decoding a recording or
  // drawing an overlay. A clock that measures this computer's processing time goes back to t_ns. Other clocks do
  // nothing: real time cannot go back, and modelled time has not counted that work.
  virtual void forget_since(int64_t /*t_ns*/) {}
};

// Time is the modelled time of the work charged so far plus the idle time skipped: a pure function of the run's input.
class WorkClock final : public Clock {
 public:
  explicit WorkClock(const WorkMeter& meter) : meter_(meter) {}
  int64_t now_ns() const override { return saturated_sum(skipped_ns_, meter_.modelled_ns()); }
  void idle_until(int64_t t_ns) override {
    const int64_t now = now_ns();
    if (t_ns > now) skipped_ns_ = saturated_sum(skipped_ns_, saturated_difference(t_ns, now));
  }

 private:
  const WorkMeter& meter_;
  int64_t skipped_ns_ = 0;
};

}  // namespace pptam
