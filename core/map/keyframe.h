// Keyframes, and the queue through which the tracker hands new ones to the mapper.
//
//   tracker: hold() ─▶ fills it ─▶ next frame tells its velocity ─▶ release()      mapper: front() ─▶ take()
//
// Frames: T_kw takes world to keyframe. Pixels are level 0. Images change hands by swapping their storage: nothing is
// copied after hold().
#pragma once

#include <utility>

#include <pocket_ptam/camera.h>
#include "base/containers.h"
#include "camera/small_image.h"

namespace pptam {

// Erased keyframes [phone 3.3, footnote] have no measurements and no place in bundle adjustment. They keep their
// images, as patch sources and for relocalisation, and their positions, which follow the live keyframe nearest to them.
struct Keyframe {
  Keyframe() = default;
  Keyframe(Arena& arena, const CameraModel& camera);  // with storage for images of this size

  uint32_t id = 0;  // never reused; 0: empty slot
  bool erased = false;
  int16_t anchor = -1;  // of an erased one: the live keyframe that it follows,
  SE3 T_anchor;         // T_kw = T_anchor * T_kw of the anchor
  int64_t timestamp_ns = 0;
  SE3 T_kw;
  Vector6f velocity = Vector6f::Zero();        // T_kw(t + dt) = exp(dt * velocity) T_kw: world units/s and radians/s
  Vector6f velocity_prior = Vector6f::Zero();  // what the tracker thought of it
  float mean_depth = 1;                        // of the points that the tracker measured
  PyramidStorage storage;
  Pyramid pyramid;
  SmallImage small;

  bool live() const { return id != 0 && !erased; }
  // Copies both images.
  void set_images(const Pyramid& images, const GreyView& small_image);
};

// A map point found in a frame.
struct KeyframeMeasurement {
  int32_t point = -1;     // index into Map::points()
  uint32_t point_id = 0;  // checked on insertion: the point may have gone meanwhile
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

  // The tracker's side. Whoever is held is not in the queue yet.
  bool can_hold() const { return !held_ && waiting_ < slots_.size(); }
  KeyframeCandidate& hold();
  bool holding() const { return held_; }
  KeyframeCandidate& held();
  void release();  // joins the queue

  // The mapper's side, oldest first.
  int waiting() const { return waiting_; }
  const KeyframeCandidate& waiting(int i) const { return slots_[i]; }
  KeyframeCandidate& front();
  void pop();

  void clear();
  void apply(const Similarity& S);
  // Those waiting and the one held.
  std::span<const KeyframeCandidate> all() const { return {slots_.data(), static_cast<size_t>(waiting_ + held_)}; }

 private:
  FixedVector<KeyframeCandidate> slots_;  // the first `waiting_` wait; the next one is filled when held_
  int waiting_ = 0;
  bool held_ = false;
};

}  // namespace pptam
