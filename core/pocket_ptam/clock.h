// Time, given from outside: nanoseconds from any origin. Frames carry whatever timestamps their source has, up to the
// ends of int64_t, so times are added and subtracted with the two saturating functions below.
#pragma once

#include <cstdint>
#include <limits>

#include <pocket_ptam/work_meter.h>

namespace pptam {

// a + b and a - b, the nearest end of int64_t where they leave it.
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
  virtual int64_t now_ns() const = 0;  // never decreases, but by forget_since()
  // Sleeps, or for a virtual clock jumps, to t_ns; past times return at once.
  virtual void idle_until(int64_t t_ns) = 0;
  // What was done since t_ns (a value of now_ns()) is not the device's work: reading and decoding a recording, drawing
  // for a spectator. A clock that is driven by this computer's effort goes back to t_ns; others have nothing to do:
  // real time cannot be given back, and modelled time never counted that work.
  virtual void forget_since(int64_t /*t_ns*/) {}
};

// Time = modelled time of the work charged so far, plus the idle time skipped. A pure function of the run's input.
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
