#include "tracking/relocaliser.h"

namespace pptam {

namespace {

// Zero-mean sum of squared differences, scaled by the pixel count squared to stay in integers: at most 8192 pixels.
int64_t zmssd(const GreyView& a, const GreyView& b) {
  int64_t sum = 0, sum_sq = 0;
  for (int y = 0; y < a.height; ++y) {
    for (int x = 0; x < a.width; ++x) {
      const int d = static_cast<int>(a.at(x, y)) - static_cast<int>(b.at(x, y));
      sum += d;
      sum_sq += d * d;
    }
  }
  return sum_sq * (a.width * a.height) - sum * sum;
}

}  // namespace

RelocalisationCandidate propose_pose(const Map& map, FullFrameRotation& full_frame_rotation, const GreyView& small,
                                     int rank, WorkMeter& meter) {
  RelocalisationCandidate candidate;
  // Keyframes in the order of (score, index): walk to the rank-th.
  int64_t last_score = -1;
  int last_index = -1;
  for (int r = 0; r <= rank; ++r) {
    int best = -1;
    int64_t best_score = 0;
    for (int k = 0; k < map.keyframes.size(); ++k) {
      const int64_t score = zmssd(map.keyframes[k].small, small);
      if (score < last_score || (score == last_score && k <= last_index)) continue;
      if (best < 0 || score < best_score) {
        best = k;
        best_score = score;
      }
    }
    meter.charge(Work::kRotationPixel, static_cast<int64_t>(map.keyframes.size()) * small.width * small.height / 20);
    if (best < 0) return candidate;
    last_score = best_score;
    last_index = best;
  }
  const Keyframe& keyframe = map.keyframes[last_index];
  const RotationEstimate rotation =
      full_frame_rotation.estimate(keyframe.small, small, Matrix3f::Identity(), Vector3f::Zero());
  meter.charge(Work::kRotationPixel, static_cast<int64_t>(rotation.iterations) * small.width * small.height);
  if (!rotation.near) return candidate;  // what is left of it is less than the tracker's wide search
  candidate.keyframe = last_index;
  candidate.T_cw = SE3(rotation.R_cp, Vector3f::Zero()) * keyframe.T_kw;
  return candidate;
}

}  // namespace pptam
