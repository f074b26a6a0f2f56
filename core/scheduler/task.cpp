#include "scheduler/task.h"

#include "base/assert.h"

namespace pptam {

void* FrameStack::push(size_t bytes) {
  const size_t aligned = (bytes + Arena::kAlignment - 1) / Arena::kAlignment * Arena::kAlignment;
  if (used_ + aligned > size_) {
    PPTAM_ASSERT(!"FrameStack is too small for the nested jobs");
    __builtin_trap();  // to continue would write outside the arena
  }
  void* frame = memory_ + used_;
  used_ += aligned;
  return frame;
}

void FrameStack::pop(void* frame) {
  const size_t start = static_cast<size_t>(static_cast<std::byte*>(frame) - memory_);
  PPTAM_ASSERT(start <= used_);
  used_ = start;
}

}  // namespace pptam
