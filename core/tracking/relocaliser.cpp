#include "tracking/relocaliser.h"

#include <algorithm>

#include "camera/small_image.h"

namespace pptam {

namespace {

// Comparing a pixel of two small images costs this fraction of a pixel of full-frame rotation: an estimate.
constexpr int kComparisonsPerRotationPixel = 20;

}  // namespace

RelocalisationCandidate propose_pose(const Map& map, FullFrameRotation& full_frame_rotation, bool lamp_bands,
                                     const GreyView& small, int attempt, WorkMeter& meter) {
  RelocalisationCandidate candidate;
  const int parts = (map.keyframes().size() + kComparedKeyframes - 1) / kComparedKeyframes;
  if (parts == 0) return candidate;
  const int first = attempt / kRelocalisationRanks % parts * kComparedKeyframes;
  const int end = std::min(first + kComparedKeyframes, map.keyframes().size());
  int64_t score[kComparedKeyframes];
  int compared = 0;
  for (int k = first; k < end; ++k) {
    score[k - first] = -1;
    if (map.keyframes()[k].id == 0) continue;
    score[k - first] = small_image_zmssd(map.keyframes()[k].small, small);
    ++compared;
  }
  meter.charge(Work::kRotationPixel,
               static_cast<int64_t>(compared) * small.width * small.height / kComparisonsPerRotationPixel);
  int best = -1;
  for (int rank = 0; rank <= attempt % kRelocalisationRanks; ++rank) {
    if (best >= 0) score[best - first] = -1;  // takes out the keyframe of the rank before
    best = -1;
    for (int k = first; k < end; ++k)
      if (score[k - first] >= 0 && (best < 0 || score[k - first] < score[best - first])) best = k;
    if (best < 0) return candidate;
  }
  const Keyframe& keyframe = map.keyframes()[best];
  const RotationEstimate rotation =
      full_frame_rotation.estimate(keyframe.small, small, Matrix3f::Identity(), Vector3f::Zero(), lamp_bands);
  meter.charge(Work::kRotationPixel, static_cast<int64_t>(rotation.iterations) * full_frame_rotation.pixels());
  if (!rotation.near) return candidate;  // `near`: the rotation left over is within the tracker's wide search
  candidate.keyframe = best;
  candidate.T_cw = SE3(rotation.R_cp, Vector3f::Zero()) * keyframe.T_kw;
  return candidate;
}

}  // namespace pptam
