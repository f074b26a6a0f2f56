// Where could the camera be? Compares the small blurred image with those of the keyframes, erased ones too [ptam 5.6,
// phone 3.3].
//
// Gives a starting pose only; the tracker believes it once real tracking has held for two frames in a row.
#pragma once

#include <pocket_ptam/work_meter.h>
#include "camera/full_frame_rotation.h"
#include "map/map.h"

namespace pptam {

struct RelocalisationCandidate {
  int keyframe = -1;
  SE3 T_cw;  // the keyframe's pose, turned by the rotation that aligns the small images
};

// One attempt, counted from 0 since the camera was lost: at most so many keyframes are compared, and one of the best by
// zero-mean sum of squared differences is aligned. Successive attempts take the next best, then the next keyframes,
// then the first again. keyframe = -1 when there are not that many or the rotation does not align.
constexpr int kComparedKeyframes = 128;  // 0.5 million ARMv6 instructions
constexpr int kRelocalisationRanks = 3;  // best ones tried of these
RelocalisationCandidate propose_pose(const Map& map, FullFrameRotation& full_frame_rotation, const GreyView& small,
                                     int attempt, WorkMeter& meter);

}  // namespace pptam
