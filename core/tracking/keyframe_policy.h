// Which frames become keyframes, and handing them over: a frame is held until the next one tells how fast the camera
// was in it, and joins the queue then.
#pragma once

#include "camera/motion_model.h"
#include "map/map.h"
#include "tracking/frame_input.h"
#include "tracking/map_matching.h"

namespace pptam {

class KeyframePolicy {
 public:
  KeyframePolicy(const Config& config, Map& map, WorkMeter& meter) : config_(config), map_(map), meter_(meter) {}

  // Is this frame, with a good pose, worth it? visible: map points in view.
  bool wants(int64_t timestamp_ns, const MotionModel& motion, int visible) const;
  void hold(const FrameInput& frame, const MotionModel& motion, std::span<const Attempt> attempts);
  // What is held joins the queue. Its velocity was expected from the past; the central difference replaces that where
  // the motion to the next frame is known.
  void release_unmeasured();
  void release(const MotionModel& motion);
  void made_at(int64_t timestamp_ns) { last_ns_ = timestamp_ns; }  // keyframes made otherwise
  void forget_time() { last_ns_ = INT64_MIN; }

 private:
  const Config& config_;
  Map& map_;
  WorkMeter& meter_;
  int64_t last_ns_ = 0;
};

}  // namespace pptam
