// Tells frames that do not fit the map as frames do: a stabiliser's jump, a zoom, pictures out of order. A pose is
// found in them, since its points are searched where the last pose says and the robust scale adapts, but their
// residuals are far above the usual ones of this map and camera. The map must take nothing from them.
//
// What is usual is learnt from the frames themselves: it differs by a factor of four between cameras. A misfit that
// lasts is another scene, focus or light, and is learnt as usual then.
//
// A misfit in which few points agree is one that the map still grows in, lest it starve. Where the camera is lost
// before frames fit again for as long, what was made in the meantime was made of what did not fit: doubted_since().
#pragma once

#include <cstdint>

namespace pptam {

class FrameFit {
 public:
  // Whether this frame fits. residual_px: rms of the inliers of a pose that was measured, level-0 pixels. dt_s: seconds
  // since the last frame. next_id: what the map makes next; 0: not to be doubted.
  bool fits(float residual_px, float dt_s, uint32_t next_id);
  // Whether a residual is no larger than that of frames that fit; true while nothing is known of those.
  bool is_usual(float residual_px) const;
  // Ids in the map from here on are of things made since a misfit began that is not over; 0: there is none.
  uint32_t doubted_since() const { return misfit_s_ > 0 ? first_id_ : 0; }
  void forget() { *this = FrameFit(); }  // with another map

 private:
  float usual_px_ = 0;  // running median of the residuals of frames that fit; 0: unknown
  float misfit_s_ = 0;  // time of frames that do not, less that of those which do; 0: no misfit, or it is over
  uint32_t first_id_ = 0;
};

}  // namespace pptam
