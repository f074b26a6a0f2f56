// Time, given from outside.
#pragma once

#include <cstdint>

#include "base/work_meter.h"

namespace pptam {

class Clock {
 public:
  virtual ~Clock() = default;
  virtual int64_t now_ns() const = 0;  // never decreases; any origin
  virtual void idle_until(
      int64_t t_ns) = 0;  // sleeps, or for a virtual clock jumps, to t_ns; past times return at once
};

// Time = modelled time of the work charged so far, plus the idle time skipped. A pure function of the run's input.
class WorkClock final : public Clock {
 public:
  explicit WorkClock(const WorkMeter& meter) : meter_(meter) {}
  int64_t now_ns() const override { return skipped_ns_ + meter_.modelled_ns(); }
  void idle_until(int64_t t_ns) override {
    const int64_t now = now_ns();
    if (t_ns > now) skipped_ns_ += t_ns - now;
  }

 private:
  const WorkMeter& meter_;
  int64_t skipped_ns_ = 0;
};

}  // namespace pptam
