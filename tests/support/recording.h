// A sequence of the emulated phone, rendered once and replayed as often as a test likes, frame by frame or as a Camera.
#pragma once

#include <gtest/gtest.h>

#include <cstddef>
#include <memory>
#include <utility>
#include <vector>

#include <pocket_ptam/pocket_ptam.h>
#include "platform/camera.h"
#include "sim_phone/phone_camera.h"

namespace pptam::test {

struct Recording {
  platform::CameraInfo info;
  std::vector<std::vector<uint8_t>> images;
  std::vector<int64_t> timestamps_ns;
  platform::Trajectory truth;

  int size() const { return static_cast<int>(images.size()); }
  // Image i, at its own time or at another.
  Frame frame(int i) const { return frame(i, timestamps_ns[static_cast<size_t>(i)]); }
  Frame frame(int i, int64_t timestamp_ns) const {
    return {images[static_cast<size_t>(i)].data(),
            info.model.width,
            info.model.height,
            info.model.width,
            PixelFormat::kGrey,
            timestamp_ns};
  }
};

// The images from..to - 1, at their own times.
inline Recording part_of(const Recording& whole, int from, int to) {
  Recording part;
  part.info = whole.info;
  part.truth = whole.truth;
  part.images.assign(whole.images.begin() + from, whole.images.begin() + to);
  part.timestamps_ns.assign(whole.timestamps_ns.begin() + from, whole.timestamps_ns.begin() + to);
  return part;
}

// scene: the one that the options ask for, when it has been painted before.
inline Recording record(const sim::PhoneOptions& options, std::shared_ptr<const sim::Scene> scene = nullptr) {
  Recording recording;
  const auto camera = sim::make_phone_camera(options, std::move(scene));
  recording.info = camera->info();
  recording.truth = camera->ground_truth();
  Frame frame;
  while (camera->read(&frame)) {
    recording.images.emplace_back(frame.data, frame.data + static_cast<ptrdiff_t>(frame.stride_bytes) * frame.height);
    recording.timestamps_ns.push_back(frame.timestamp_ns);
  }
  return recording;
}

// Seven seconds before a desk, for all tests of a program.
inline const Recording& desk_recording() {
  static const Recording made = [] {
    sim::PhoneOptions options;
    options.scene = "desk";
    options.seed = 1;
    options.duration_s = 7;
    return record(options);
  }();
  return made;
}

class Replay final : public platform::Camera {
 public:
  explicit Replay(const Recording& recording) : recording_(recording) {}
  const platform::CameraInfo& info() const override { return recording_.info; }
  platform::Trajectory ground_truth() const override { return recording_.truth; }
  platform::CameraEvent wait(Frame* frame, int64_t /*deadline_ns*/) override {
    if (next_ == recording_.size()) return platform::CameraEvent::kEnd;
    *frame = recording_.frame(next_++);
    return platform::CameraEvent::kFrame;
  }

 private:
  const Recording& recording_;
  int next_ = 0;
};

inline Config config_for(const Recording& recording) {
  Config config = Config::phone(recording.info.model);
  config.camera.shutter = recording.info.shutter;
  config.exposure_s = recording.info.exposure_s;
  return config;
}

// A System with its memory, exactly as much as it asks for.
class Phone {
 public:
  explicit Phone(const Config& config)
      : bytes_(System::required_bytes(config)), memory_(new std::max_align_t[(bytes_ + 15) / 16]) {
    const Status status = System::create(config, {reinterpret_cast<std::byte*>(memory_.get()), bytes_}, &system_);
    if (!status.ok()) ADD_FAILURE() << status.message();
  }
  System* operator->() { return system_; }
  System& operator*() { return *system_; }

  // Maps until there is nothing left to do; the number of slices.
  int drain() {
    int slices = 0;
    for (; system_->has_work(); ++slices) {
      system_->work_slice();
      if (slices > 1000000) {
        ADD_FAILURE() << "mapping does not come to an end";
        break;
      }
    }
    return slices;
  }

 private:
  static_assert(sizeof(std::max_align_t) >= 16);
  size_t bytes_;
  std::unique_ptr<std::max_align_t[]> memory_;
  System* system_ = nullptr;
};

// All that a result says, for comparing bit by bit: what a run is made of.
struct Trace {
  std::vector<uint8_t> bytes;
  void add(const TrackResult& r) {
    add_bytes(&r.timestamp_ns, sizeof r.timestamp_ns);
    add_value(static_cast<int>(r.status.code()));
    add_value(static_cast<int>(r.state));
    add_value(static_cast<int>(r.quality));
    add_value(static_cast<int>(r.hint));
    add_value(r.pose_valid);
    add_value(r.points_attempted);
    add_value(r.points_found);
    add_value(r.points_inliers);
    add_value(r.partial_found);
    add_value(r.keyframes);
    add_value(r.map_points);
    add_bytes(r.T_cw.R.data(), 9 * sizeof(float));
    add_bytes(r.T_cw.t.data(), 3 * sizeof(float));
    add_bytes(r.covariance.data(), 36 * sizeof(float));
    for (const ObservedPoint& point : r.points) add_bytes(point.px.data(), 2 * sizeof(float));
  }
  void add_value(int64_t value) { add_bytes(&value, sizeof value); }
  bool operator==(const Trace&) const = default;

 private:
  void add_bytes(const void* data, size_t count) {
    const auto* p = static_cast<const uint8_t*>(data);
    bytes.insert(bytes.end(), p, p + count);
  }
};

}  // namespace pptam::test
