#include "platform/run/clocks.h"

#include <cerrno>
#include <ctime>

#include "platform/run/interruption.h"

namespace pptam::platform {
namespace {

constexpr int64_t kNsPerSecond = 1'000'000'000;

int64_t read_clock_ns(clockid_t id) {
  timespec time = {};
  clock_gettime(id, &time);
  return static_cast<int64_t>(time.tv_sec) * kNsPerSecond + time.tv_nsec;
}

}  // namespace

int64_t SteadyClock::now_ns() const {
  return read_clock_ns(CLOCK_MONOTONIC);
}

void SteadyClock::idle_until(int64_t t_ns) {
  timespec until = {};
  until.tv_sec = static_cast<time_t>(t_ns / kNsPerSecond);
  until.tv_nsec = static_cast<long>(t_ns % kNsPerSecond);
  while (!interrupted() && clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr) == EINTR) {
  }
}

int64_t ThrottledClock::now_ns() const {
  const double cpu_ns = static_cast<double>(read_clock_ns(CLOCK_THREAD_CPUTIME_ID));
  return saturated_sum(skipped_ns_, static_cast<int64_t>(cpu_ns * slowdown_));
}

void ThrottledClock::idle_until(int64_t t_ns) {
  const int64_t now = now_ns();
  if (t_ns > now) skipped_ns_ = saturated_sum(skipped_ns_, saturated_difference(t_ns, now));
}

void ThrottledClock::forget_since(int64_t t_ns) {
  skipped_ns_ = saturated_difference(skipped_ns_, saturated_difference(now_ns(), t_ns));
}

}  // namespace pptam::platform
