#include "tracking/frame_input.h"

#include <utility>

#include <pocket_ptam/image.h>

namespace pptam {

namespace {

// Interval reported for the first frame, which has none before it: the phone's 15 Hz [phone 1].
constexpr float kFirstInterval_s = 1.0f / 15.0f;

}  // namespace

FrameInput::FrameInput(Arena& arena, const CameraModel& camera, WorkMeter& meter)
    : meter_(meter), pyramid_storage_(arena, camera.width, camera.height, 1) {
  const int width = camera.width, height = camera.height;
  grey_storage_ = {arena.allocate_array<uint8_t>(static_cast<size_t>(width) * height), width, height, width};
  const int small_width = width >> (kPyramidLevels - 1), small_height = height >> (kPyramidLevels - 1);
  for (GreyImage* small : {&small_, &previous_small_})
    *small = {arena.allocate_array<uint8_t>(static_cast<size_t>(small_width) * small_height), small_width, small_height,
              small_width};
}

void FrameInput::take(const Frame& frame) {
  has_previous_ = has_frame_;
  has_frame_ = true;
  dt_s_ = has_previous_ ? elapsed_s(timestamp_ns_, frame.timestamp_ns) : kFirstInterval_s;
  timestamp_ns_ = frame.timestamp_ns;
  const GreyView grey = to_grey(frame, grey_storage_);
  if (grey.data == grey_storage_.data)
    meter_.charge(Work::kGreyPixel, static_cast<int64_t>(frame.width) * frame.height);
  pyramid_ = build_pyramid(grey, pyramid_storage_);
  // Levels 1 to 4 together have a third of level 0's pixels.
  meter_.charge(Work::kPyramidPixel, static_cast<int64_t>(frame.width) * frame.height / 3);
  std::swap(small_, previous_small_);
  make_small_image(pyramid_, small_);
}

}  // namespace pptam
