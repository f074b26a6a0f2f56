// Keyframes, and the queue through which the tracker hands new ones to the mapper.
//
//   tracker: hold() ─▶ fills it ─▶ next frame gives its velocity ─▶ release()      mapper: front() ─▶ pop()
//
// Frames: T_kw takes world to keyframe. Pixels are level 0. The tracker copies the images into the held keyframe. After
// that only storage is swapped.
#pragma once

#include <span>
#include <utility>

#include <pocket_ptam/camera.h>
#include "base/containers.h"
#include "camera/small_image.h"

namespace pptam {

// Erased keyframes [phone 3.3, footnote] have no measurements and no place in bundle adjustment. They keep their
// images, as patch sources and for relocalisation, and their poses, which follow the live keyframe nearest to them.
struct Keyframe {
  Keyframe() = default;
  Keyframe(Arena& arena, const CameraModel& camera);  // with storage for images of the camera's size

  uint32_t id = 0;  // never reused; 0: empty slot
  bool erased = false;
  int16_t anchor = -1;  // of an erased keyframe: index of the live keyframe that it follows
  SE3 T_anchor;         // of an erased keyframe: T_kw = T_anchor * T_kw of the anchor
  int64_t timestamp_ns = 0;
  SE3 T_kw;
  Vector6f velocity = Vector6f::Zero();        // T_kw(t + dt) = exp(dt * velocity) T_kw: world units/s and radians/s
  Vector6f velocity_prior = Vector6f::Zero();  // expected velocity, from the tracked poses
  float mean_depth = 1;                        // of the points that the tracker measured, world units
  PyramidStorage storage;
  Pyramid pyramid;
  SmallImage small;

  bool live() const { return id != 0 && !erased; }
  // Copies the pyramid and the small image into the keyframe's own storage.
  void set_images(const Pyramid& images, const GreyView& small_image);
};

// A map point found in a frame.
struct KeyframeMeasurement {
  int32_t point = -1;     // index into Map::points()
  uint32_t point_id = 0;  // checked on insertion: the point may have been removed meanwhile
  ImagePoint at;
};
// A tracked frame on its way to becoming a keyframe.
struct KeyframeCandidate {
  Keyframe frame;
  FixedVector<KeyframeMeasurement> measurements;
};

class KeyframeQueue {
 public:
  KeyframeQueue() = default;
  KeyframeQueue(Arena& arena, const CameraModel& camera, int max_measurements);

  // The tracker's side. A held keyframe is not in the queue yet.
  bool can_hold() const { return !held_ && waiting_ < slots_.size(); }
  KeyframeCandidate& hold();
  bool holding() const { return held_; }
  KeyframeCandidate& held();
  void release();  // the held keyframe joins the queue

  // The mapper's side, oldest first.
  int waiting() const { return waiting_; }
  const KeyframeCandidate& waiting(int i) const { return slots_[i]; }
  KeyframeCandidate& front();
  void pop();

  void clear();
  void apply(const Similarity& S);  // a change of the world's coordinates
  // The waiting keyframes and the held one.
  std::span<const KeyframeCandidate> all() const { return {slots_.data(), static_cast<size_t>(waiting_ + held_)}; }

 private:
  FixedVector<KeyframeCandidate> slots_;  // the first `waiting_` wait; the slot after them is being filled while held_
  int waiting_ = 0;
  bool held_ = false;
};

}  // namespace pptam
