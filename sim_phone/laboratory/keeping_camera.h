// Keeps what another camera delivers, so that it can be seen again, with other information or pictures if need be.
#pragma once

#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include "platform/camera.h"

namespace pptam::laboratory {

class KeepingCamera : public platform::Camera {
 public:
  explicit KeepingCamera(std::unique_ptr<platform::Camera> camera) : camera_(std::move(camera)) {
    info_ = camera_->info();
  }
  const platform::CameraInfo& info() const override { return info_; }
  platform::Trajectory ground_truth() const override { return camera_->ground_truth(); }
  platform::CameraEvent wait(Frame* frame, int64_t deadline_ns) override {
    if (next_ == end_) return platform::CameraEvent::kEnd;
    if (next_ == kept_.size()) {
      const platform::CameraEvent event = camera_->wait(frame, deadline_ns);
      if (event != platform::CameraEvent::kFrame) return event;
      const size_t bytes = static_cast<size_t>(frame->stride_bytes) * static_cast<size_t>(frame->height);
      kept_.push_back({*frame, {frame->data, frame->data + bytes}});
    }
    *frame = kept_[next_].frame;
    frame->data = kept_[next_].pixels.data();
    ++next_;
    return platform::CameraEvent::kFrame;
  }
  // From the first frame, to the end or only so many.
  void again(size_t frames = SIZE_MAX) {
    next_ = 0;
    end_ = frames;
  }
  // Keeps all that follow, unseen.
  void keep_all() {
    for (Frame frame; read(&frame);) continue;
    again();
  }
  size_t count() const { return kept_.size(); }
  const Frame& frame(size_t i) const { return kept_[i].frame; }       // its data is not valid
  std::vector<uint8_t>& pixels(size_t i) { return kept_[i].pixels; }  // of one kept: rows of frame(i).stride_bytes
  // Likewise; this is told of it from now on, whatever it was seen by.
  void again_as(const CameraModel& model, const RollingShutter& shutter) {
    again();
    info_.model = model;
    info_.shutter = shutter;
  }

 private:
  struct Kept {
    Frame frame;
    std::vector<uint8_t> pixels;
  };
  std::unique_ptr<platform::Camera> camera_;
  platform::CameraInfo info_;
  std::vector<Kept> kept_;
  size_t next_ = 0, end_ = SIZE_MAX;
};

}  // namespace pptam::laboratory
