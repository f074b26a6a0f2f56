#include "platform/camera/paced_camera.h"

#include <algorithm>
#include <cerrno>
#include <ctime>
#include <utility>

#include <pocket_ptam/clock.h>

namespace pptam::platform {
namespace {

int64_t monotonic_ns() {
  timespec time = {};
  ::clock_gettime(CLOCK_MONOTONIC, &time);
  return int64_t{time.tv_sec} * 1'000'000'000 + time.tv_nsec;
}

bool sleep_until(int64_t until_ns) {  // false: a signal came
  timespec until = {};
  until.tv_sec = static_cast<time_t>(until_ns / 1'000'000'000);
  until.tv_nsec = static_cast<long>(until_ns % 1'000'000'000);
  return ::clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr) != EINTR;
}

constexpr int kMostLate = 5;  // in a row; a source that is slower than its own time would never deliver any

class PacedCamera : public Camera {
 public:
  explicit PacedCamera(std::unique_ptr<Camera> source) : source_(std::move(source)) {}

  const CameraInfo& info() const override { return source_->info(); }
  CameraDescription describe() const override { return source_->describe(); }
  Configuration configure(const CameraRequest& wanted) override { return source_->configure(wanted); }
  Trajectory ground_truth() const override { return source_->ground_truth(); }
  std::vector<std::string> remarks() const override { return source_->remarks(); }
  CameraStatus status() const override { return status_; }

  CameraEvent wait(Frame* frame, int64_t deadline_ns) override {
    const double rate = info().frames_per_s;
    const auto period_ns = static_cast<int64_t>(rate > 0 ? 1e9 / rate : 0);
    for (;;) {
      if (!waiting_) {
        const CameraEvent event = source_->wait(&next_, Camera::kForEver);
        if (event != CameraEvent::kFrame) return event;
        waiting_ = true;
        if (!started_) origin_ns_ = saturated_difference(monotonic_ns(), next_.timestamp_ns);
        started_ = true;
      }
      int64_t due_ns = saturated_sum(origin_ns_, next_.timestamp_ns);
      const int64_t now_ns = monotonic_ns();
      if (period_ns > 0 && now_ns - due_ns >= period_ns && late_ < kMostLate) {  // the next one is there by now
        ++late_;
        ++status_.dropped;
        waiting_ = false;
        continue;
      }
      if (late_ == kMostLate) {
        origin_ns_ = saturated_difference(now_ns, next_.timestamp_ns);
        due_ns = now_ns;
      }
      late_ = 0;
      if (now_ns >= due_ns) {
        waiting_ = false;
        ++status_.frames;
        status_.arrived_ns = due_ns;
        status_.clock = "the recording's";
        *frame = next_;
        return CameraEvent::kFrame;
      }
      if (now_ns >= deadline_ns || !sleep_until(std::min(due_ns, deadline_ns))) return CameraEvent::kTimeout;
    }
  }

 private:
  std::unique_ptr<Camera> source_;
  Frame next_;  // valid until the source is asked again
  bool waiting_ = false;
  bool started_ = false;
  int late_ = 0;  // dropped in a row
  int64_t origin_ns_ = 0;
  CameraStatus status_;
};

}  // namespace

std::unique_ptr<Camera> make_paced_camera(std::unique_ptr<Camera> source) {
  return std::make_unique<PacedCamera>(std::move(source));
}

}  // namespace pptam::platform
