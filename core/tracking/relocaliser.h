// Proposes a pose for a lost camera: compares the frame's small blurred image with those of all keyframes, erased ones
// included [ptam 5.6, phone 3.3].
//
// The result is a starting pose only. The tracker reports a pose again after tracking has held for two frames in a row.
#pragma once

#include <pocket_ptam/work_meter.h>
#include "camera/full_frame_rotation.h"
#include "map/map.h"

namespace pptam {

struct RelocalisationCandidate {
  int keyframe = -1;
  SE3 T_cw;  // the keyframe's pose, turned by the rotation that aligns the small images
};

// Keyframes compared in one attempt: 0.5 million ARMv6 instructions (estimate). Bounds the time of a lost frame.
constexpr int kComparedKeyframes = 128;
constexpr int kRelocalisationRanks = 3;  // best keyframes among these that are tried, one an attempt; not swept

// One attempt, counted from 0 since the camera was lost. It compares up to kComparedKeyframes keyframes and aligns the
// rotation of one of the best by zero-mean sum of squared differences. Successive attempts take the next best, then the
// next keyframes, then the first ones again. keyframe = -1 when there are not that many or the rotation does not align.
RelocalisationCandidate propose_pose(const Map& map, FullFrameRotation& full_frame_rotation, bool lamp_bands,
                                     const GreyView& small, int attempt, WorkMeter& meter);

}  // namespace pptam
