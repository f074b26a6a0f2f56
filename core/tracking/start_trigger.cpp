#include "tracking/start_trigger.h"

namespace pptam {

namespace {

// Time for which the camera must be held still before initialisation starts by itself, s. Not swept. Shorter times take
// first views that are still moving; longer ones make the user wait.
constexpr float kSteadyTime_s = 0.3f;
constexpr float kSteadySpeed = 0.2f;  // apparent rotation that a hand at rest does not exceed, radians/s; not swept

}  // namespace

bool StartTrigger::wants_start(const FrameInput& frame, const MotionModel& motion, Hint* hint) {
  if (tapped_) return true;
  if (!config_.auto_start) return false;
  const bool steady =
      frame.dt_s() <= kMaxGap_s && motion.rotation_seen() && motion.prior().mean.tail<3>().norm() < kSteadySpeed;
  steady_s_ = steady ? steady_s_ + frame.dt_s() : 0;
  if (steady_s_ >= kSteadyTime_s) return true;
  if (frame.has_previous() && !motion.rotation_seen()) {
    *hint = Hint::kTooLittleTexture;       // the full-frame rotation found nothing to align
  } else if (*hint != Hint::kStartLost) {  // kStartLost is shown until the next start
    *hint = Hint::kHoldStill;
  }
  return false;
}

}  // namespace pptam
