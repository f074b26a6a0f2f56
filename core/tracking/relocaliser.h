// Where could the camera be? Compares the small blurred image with those of all keyframes [ptam 5.6, phone 3.3].
//
// Gives a starting pose only; the tracker believes it once real tracking has held for two frames in a row.
#pragma once

#include "base/work_meter.h"
#include "map/map.h"
#include "tracking/full_frame_rotation.h"

namespace pptam {

struct RelocalisationCandidate {
  int keyframe = -1;
  SE3 T_cw;  // the keyframe's pose, turned by the rotation that aligns the small images
};

// The rank-th best keyframe (0 = best) by zero-mean sum of squared differences; keyframe = -1 when there are not that
// many or the rotation does not align.
RelocalisationCandidate propose_pose(const Map& map, FullFrameRotation& full_frame_rotation, const GreyView& small,
                                     int rank, WorkMeter& meter);

}  // namespace pptam
