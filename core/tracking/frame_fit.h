// Tells frames that do not fit the map as frames do: a stabiliser's jump, a zoom, pictures out of order. A pose is
// found in them, since its points are searched where the last pose says and the robust scale adapts, but their
// residuals are far above the usual ones of this map and camera. The map must take nothing from them.
//
// What is usual is learnt from the frames themselves: it differs by a factor of four between cameras. A misfit that
// lasts is another scene, focus or light, and is learnt as usual then.
#pragma once

namespace pptam {

class FrameFit {
 public:
  // Whether this frame fits. residual_px: rms of the inliers of a pose that was measured, level-0 pixels. dt_s: seconds
  // since the last frame.
  bool fits(float residual_px, float dt_s);
  void forget() { *this = FrameFit(); }  // with another map

 private:
  float usual_px_ = 0;  // running median of the residuals of frames that fit; 0: unknown
  float misfit_s_ = 0;  // time of frames that do not, less that of those which do
};

}  // namespace pptam
