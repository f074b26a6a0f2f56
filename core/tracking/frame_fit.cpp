#include "tracking/frame_fit.h"

#include <algorithm>

namespace pptam {

namespace {

// Residual from which on a frame does not fit, relative to the usual one. In three recordings, two starts each, 2 % of
// the frames at most exceed 2. Emulated bad stretches have 2 to 20, but for views of one plane that are shifted: 1.3 to
// 2. With 1.7 quick turns are refused whose keyframes are needed: of four emulated explorations one has three times the
// error and one loses 8 % of its frames; with 2.5 and 3 none is worse than without.
constexpr float kMaxRelativeResidual = 2.5f;
// Rate at which the running median follows, relative change per second: slower than a stabiliser's drift. Not swept.
constexpr float kLearning_per_s = 0.15f;
constexpr float kMaxStep_s = 0.2f;  // that one frame counts for, however long the pause before it; not swept
// Time of misfit after which what is seen is taken as usual, s: longer than a disturbance, and short enough that a map
// which has to grow into a harder view does not starve. Not swept.
constexpr float kMaxMisfit_s = 3.0f;

}  // namespace

bool FrameFit::is_usual(float residual_px) const {
  return usual_px_ == 0 || residual_px <= kMaxRelativeResidual * usual_px_;
}

bool FrameFit::fits(float residual_px, float dt_s, uint32_t next_id) {
  dt_s = std::min(dt_s, kMaxStep_s);
  if (usual_px_ == 0) usual_px_ = residual_px;  // stays unknown while a residual is zero
  if (is_usual(residual_px)) {
    misfit_s_ = std::max(0.0f, misfit_s_ - dt_s);
    const float factor = 1.0f + kLearning_per_s * dt_s;
    usual_px_ = std::clamp(residual_px, usual_px_ / factor, usual_px_ * factor);
    return true;
  }
  if (misfit_s_ == 0) first_id_ = next_id;
  misfit_s_ += dt_s;
  if (misfit_s_ > kMaxMisfit_s) {
    usual_px_ = residual_px;
    misfit_s_ = 0;
  }
  return false;
}

}  // namespace pptam
