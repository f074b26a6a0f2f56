#include "tracking/frame_input.h"

#include <cstring>
#include <utility>

#include <pocket_ptam/image.h>

namespace pptam {

namespace {

// Interval reported for the first frame, which has none before it: the phone's 15 Hz [phone 1].
constexpr float kFirstInterval_s = 1.0f / 15.0f;

constexpr int kHashedLevel = 2;       // noise of 2 grey levels is 0.5 in L2: no two of 4800 pixels' pictures are alike
constexpr int kHashInstructions = 2;  // ARMv6, a pixel: an estimate
constexpr int64_t kSmallImageInstructions = 43;  // of one pixel of the small image, as counted

// FNV-1a, 32 bits, by words of four pixels. Pictures are compared within a run only.
uint32_t hash_of(const GreyView& image) {
  uint32_t hash = 2166136261u;
  const auto add = [&](uint32_t word) { hash = (hash ^ word) * 16777619u; };
  for (int y = 0; y < image.height; ++y) {
    const uint8_t* row = image.row(y);
    int x = 0;
    for (; x + 4 <= image.width; x += 4) {
      uint32_t word;
      std::memcpy(&word, row + x, 4);
      add(word);
    }
    for (; x < image.width; ++x) add(row[x]);
  }
  return hash;
}

}  // namespace

FrameInput::FrameInput(Arena& arena, const CameraModel& camera, WorkMeter& meter)
    : meter_(meter), pyramid_storage_(arena, camera.width, camera.height, 1) {
  const int width = camera.width, height = camera.height;
  grey_storage_ = {arena.allocate_array<uint8_t>(static_cast<size_t>(width) * height), width, height, width};
  for (GreyImage* small : {&small_, &previous_small_}) *small = small_image_storage(arena, width, height);
}

bool FrameInput::take(const Frame& frame, bool pass_repeated) {
  const GreyView grey = to_grey(frame, grey_storage_);
  if (grey.data == grey_storage_.data)
    meter_.charge(Work::kGreyPixel, static_cast<int64_t>(frame.width) * frame.height);
  pyramid_ = build_pyramid(grey, pyramid_storage_);
  // Levels 1 to 4 together have a third of level 0's pixels.
  meter_.charge(Work::kPyramidPixel, static_cast<int64_t>(frame.width) * frame.height / 3);
  const GreyView& hashed = pyramid_.level[kHashedLevel];
  const uint32_t hash = hash_of(hashed);
  meter_.charge(Work::kOther, kHashInstructions * hashed.width * hashed.height);
  if (pass_repeated && has_frame_ && hash == hash_) return false;
  hash_ = hash;
  has_previous_ = has_frame_;
  has_frame_ = true;
  dt_s_ = has_previous_ ? elapsed_s(timestamp_ns_, frame.timestamp_ns) : kFirstInterval_s;
  timestamp_ns_ = frame.timestamp_ns;
  std::swap(small_, previous_small_);
  make_small_image(pyramid_, small_);
  meter_.charge(Work::kOther, kSmallImageInstructions * small_.width * small_.height);
  return true;
}

}  // namespace pptam
