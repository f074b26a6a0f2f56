// Proposes a pose for a lost camera: compares the frame's small blurred image with those of all keyframes, erased ones
// included [ptam 5.6, phone 3.3].
//
// The paper compares whole images, which finds a camera that looks as a keyframe did. Every second attempt also shifts
// and scales the frame over the keyframes, in images half as large: that finds one that has turned away or come nearer.
// The result is a starting pose only. The tracker reports a pose again after tracking has held for two frames in a row.
#pragma once

#include <pocket_ptam/work_meter.h>
#include "camera/full_frame_rotation.h"
#include "map/map.h"

namespace pptam {

struct RelocalisationCandidate {
  int keyframe = -1;
  SE3 T_cw;  // the keyframe's pose, moved by what aligns the small images
};

// Keyframes compared in one attempt, whole images and shifted ones: 0.5 and at most 2 million ARMv6 instructions
// (estimates). Bounds the time of a lost frame.
constexpr int kComparedKeyframes = 128, kShiftedKeyframes = 8;
constexpr int kRelocalisationRanks = 3;  // best keyframes among these that are tried, one an attempt; not swept

// One attempt, counted from 0 since the camera was lost: of even number with whole images, of odd number with shifted
// ones. It compares so many keyframes and aligns the rotation of one of the best by zero-mean sum of squared
// differences. Successive attempts take the next best (of whole images), then the next keyframes, then the first again.
// keyframe = -1 when there are not that many or the rotation does not align.
RelocalisationCandidate propose_pose(const Map& map, const Camera& camera, FullFrameRotation& full_frame_rotation,
                                     bool lamp_bands, const GreyView& small, int attempt, WorkMeter& meter);

}  // namespace pptam
