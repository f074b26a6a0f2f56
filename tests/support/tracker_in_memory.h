// A ModelTracker with its block of memory, fed with grey images at 30 frames a second.
#pragma once

#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include <pocket_ptam/model_tracker.h>

namespace pptam::test {

class TrackerInMemory {
 public:
  explicit TrackerInMemory(const ModelTrackerConfig& config) : config_(config) {
    memory_.resize(ModelTracker::required_bytes(config) / sizeof(std::max_align_t) + 1);
    const Status status = ModelTracker::create(config, std::as_writable_bytes(std::span(memory_)), &tracker_);
    EXPECT_TRUE(status.ok()) << status.message();
  }
  ModelTracker* operator->() { return tracker_; }
  ModelResult track(const std::vector<uint8_t>& image) {
    Frame frame;
    frame.data = image.data();
    frame.width = frame.stride_bytes = config_.camera.model.width;
    frame.height = config_.camera.model.height;
    frame.timestamp_ns = time_ns_ += 33333333;
    return tracker_->track(frame);
  }

 private:
  ModelTrackerConfig config_;
  std::vector<std::max_align_t> memory_;
  ModelTracker* tracker_ = nullptr;
  int64_t time_ns_ = 0;
};

}  // namespace pptam::test
