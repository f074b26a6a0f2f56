// A frame as the tracker uses it: a grey pyramid and a small blurred image, with the small image of the frame before.
#pragma once

#include <pocket_ptam/camera_model.h>
#include <pocket_ptam/work_meter.h>
#include "image/pyramid.h"

namespace pptam {

// Computed in double: the difference of two timestamps may overflow int64.
inline float elapsed_s(int64_t from_ns, int64_t to_ns) {
  return static_cast<float>((static_cast<double>(to_ns) - static_cast<double>(from_ns)) * 1e-9);
}

// Gap between two frames, s, after which the motion model's velocity is not used, nor rest taken for granted. Not
// swept.
constexpr float kMaxGap_s = 1.0f;

class FrameInput {
 public:
  FrameInput(Arena& arena, const CameraModel& camera, WorkMeter& meter);

  // The frame must be validated. Level 0 may point into the frame's memory. False when repeated pictures are to be
  // passed over and this is the last one again, bit for bit in L2, as from a recorder that stalls: nothing changes
  // then, and the time of the frame is not counted.
  bool take(const Frame& frame, bool pass_repeated);

  // Lamps draw bands along these lines of the frame.
  void set_lamp_lines(LampLines lines) { pyramid_.lamp_lines = lines; }

  int64_t timestamp_ns() const { return timestamp_ns_; }
  float dt_s() const { return dt_s_; }  // since the frame before
  const Pyramid& pyramid() const { return pyramid_; }
  const GreyImage& small() const { return small_; }
  bool has_previous() const { return has_previous_; }
  const GreyImage& previous_small() const { return previous_small_; }

 private:
  WorkMeter& meter_;
  GreyImage grey_storage_;
  PyramidStorage pyramid_storage_;
  Pyramid pyramid_;
  GreyImage small_, previous_small_;
  bool has_frame_ = false, has_previous_ = false;
  uint32_t hash_ = 0;  // of L2
  int64_t timestamp_ns_ = 0;
  float dt_s_ = 0;
};

}  // namespace pptam
