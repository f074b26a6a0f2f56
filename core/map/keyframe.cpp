#include "map/keyframe.h"

#include <algorithm>

#include "base/assert.h"

namespace pptam {

namespace {

// Keyframes that wait for the mapper, with the one that is held. Each has a whole pyramid. The tracker makes at most
// one keyframe in Config::min_keyframe_interval_s, and none while the queue is full. Not swept.
constexpr int kQueueLength = 2;

}  // namespace

Keyframe::Keyframe(Arena& arena, const CameraModel& camera)
    : storage(arena, camera.width, camera.height, 0), small(small_image_storage(arena, camera.width, camera.height)) {}

void Keyframe::set_images(const Pyramid& images, const GreyView& small_image) {
  pyramid = copy_pyramid(images, storage);
  for (int y = 0; y < small_image.height; ++y) std::copy_n(small_image.row(y), small_image.width, small.row(y));
}

KeyframeQueue::KeyframeQueue(Arena& arena, const CameraModel& camera, int max_measurements)
    : slots_(arena, kQueueLength) {
  for (int i = 0; i < kQueueLength; ++i) {
    KeyframeCandidate candidate;
    candidate.frame = Keyframe(arena, camera);
    candidate.measurements = FixedVector<KeyframeMeasurement>(arena, max_measurements);
    if (i < slots_.capacity()) slots_.push_back(candidate);
  }
}

KeyframeCandidate& KeyframeQueue::hold() {
  PPTAM_ASSERT(can_hold());
  held_ = true;
  slots_[waiting_].measurements.clear();
  return slots_[waiting_];
}

KeyframeCandidate& KeyframeQueue::held() {
  PPTAM_ASSERT(held_);
  return slots_[waiting_];
}

void KeyframeQueue::release() {
  PPTAM_ASSERT(held_);
  held_ = false;
  ++waiting_;
}

KeyframeCandidate& KeyframeQueue::front() {
  PPTAM_ASSERT(waiting_ > 0);
  return slots_[0];
}

void KeyframeQueue::pop() {
  PPTAM_ASSERT(waiting_ > 0);
  for (int i = 0; i + 1 < slots_.size(); ++i) std::swap(slots_[i], slots_[i + 1]);
  --waiting_;
}

void KeyframeQueue::clear() {
  waiting_ = 0;
  held_ = false;
}

void KeyframeQueue::apply(const Similarity& S) {
  for (int i = 0; i < waiting_ + held_; ++i) {
    Keyframe& frame = slots_[i].frame;
    frame.T_kw = S.moved(frame.T_kw);
    frame.velocity.head<3>() *= S.scale;
    frame.velocity_prior.head<3>() *= S.scale;
    frame.mean_depth *= S.scale;
  }
}

}  // namespace pptam
