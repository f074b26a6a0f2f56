// Decides which frames become keyframes, and hands them to the mapper. A frame is held until the next one has been
// tracked, which gives the camera's velocity in it, and then joins the queue [phone 6].
#pragma once

#include <span>

#include "camera/motion_model.h"
#include "map/map.h"
#include "tracking/frame_input.h"
#include "tracking/map_matching.h"

namespace pptam {

class KeyframePolicy {
 public:
  KeyframePolicy(const Config& config, Map& map, WorkMeter& meter) : config_(config), map_(map), meter_(meter) {}

  // True when this frame, whose pose is known, should become a keyframe. staying: inliers that will still be in view in
  // half a second.
  bool wants(int64_t timestamp_ns, const MotionModel& motion, int staying) const;
  // Copies the frame and its inliers into the queue's next slot.
  void hold(const FrameInput& frame, const MotionModel& motion, std::span<const Attempt> attempts);
  // The held frame joins the queue. release_unmeasured(): with the velocity expected from the frames before it.
  // release(): with the central difference, where the motion to the next frame is known.
  void release_unmeasured();
  void release(const MotionModel& motion);
  void made_at(int64_t timestamp_ns) { last_ns_ = timestamp_ns; }  // a keyframe that the initialiser made
  void forget_time() { last_ns_ = INT64_MIN; }                     // timestamps before are another recording's

 private:
  const Config& config_;
  Map& map_;
  WorkMeter& meter_;
  int64_t last_ns_ = 0;  // timestamp of the last keyframe
};

}  // namespace pptam
