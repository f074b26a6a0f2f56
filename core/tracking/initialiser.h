// Interface of map initialisation: tracks a first view until the camera's motion is known well enough to build a map.
// Config chooses the kind. The tracker calls it once a frame while there is no map.
#pragma once

#include <span>

#include "map/map.h"
#include "tracking/frame_input.h"

namespace pptam {

class Initialiser {
 public:
  enum class Progress : uint8_t {
    kIdle,      // start() has not been called
    kTracking,  // not finished yet
    kLost,      // given up: the first view was lost or no map was found; idle again
    kDone       // build() may be called
  };
  struct Report {        // of the last frame
    float progress = 0;  // 0 to 1
    Hint hint = Hint::kNone;
    int attempted = 0, found = 0;  // points of the first view
    // Valid, and unchanged by build() and reset(), until the next start() or track().
    std::span<const ObservedPoint> observed;
  };

  // Takes the first view. rotation_rate: from the full-frame rotation, radians/s. Hint::kNone on success, otherwise why
  // the view is not suitable (too little texture, not held still); the state is unchanged then.
  virtual Hint start(const FrameInput& frame, const Vector3f& rotation_rate) = 0;
  // Tracks the first view in the next frame. R_cp: previous camera to present camera, from the full-frame rotation.
  virtual Progress track(const FrameInput& frame, const Matrix3f& R_cp) = 0;
  // Writes keyframes and points into an empty map. The map is not ready() yet: the mapper finishes it in idle time.
  // Slot 0 is the first view, the last slot the current frame; at most kMaxInitialKeyframes, with one frame next to
  // each on either side (Map::add_neighbour). Poses of the views between are found anew; if one cannot be, the map is
  // given up. T_cw and velocity are the current frame's. False when the map is too small; it is empty again then.
  virtual bool build(Map& map, SE3* T_cw, Vector6f* velocity) = 0;
  virtual void reset() = 0;
  virtual bool active() const = 0;
  virtual const Report& report() const = 0;

 protected:
  ~Initialiser() = default;
};

}  // namespace pptam
