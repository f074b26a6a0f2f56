#include "tracking/relocaliser.h"

#include <algorithm>
#include <cmath>

#include "camera/small_image.h"
#include "image/shrink.h"

namespace pptam {

namespace {

// Comparing a pixel of two small images, whole or shifted, costs this fraction of a pixel of full-frame rotation: an
// estimate.
constexpr int kComparisonsPerRotationPixel = 20;

// Longer side of the images for the comparison of shifted ones, pixels: a shift by one of them is 5 degrees on the
// phone, from half of which the full-frame rotation finds the rest. Not swept.
constexpr int kThumbSide = 10;
// Scales at which the frame is laid over a keyframe, as if the camera had come nearer by 29 % or gone away by 33 %.
// Between them, up to some 15 %, the tracker's wide search finds the points. Not swept.
constexpr size_t kScaleCount = 3;
constexpr float kScales[kScaleCount] = {1.0f, 1.4f, 0.75f};
constexpr int kMaxThumbSide = 16;  // kThumbSide / 0.75, and a margin
// Least share of a keyframe's image that the frame must cover. With the phone's 37 degrees a turn by 20 leaves 0.46.
constexpr float kMinCovered = 0.35f;

// A small image made smaller still.
struct Thumb {
  uint8_t px[kMaxThumbSide * kMaxThumbSide];
  GreyImage image;

  Thumb(const GreyView& small, float scale) {
    const float factor = kThumbSide / (scale * static_cast<float>(std::max(small.width, small.height)));
    const auto side = [factor](int of) {
      return std::clamp(static_cast<int>(factor * static_cast<float>(of) + 0.5f), 1, std::min(of, kMaxThumbSide));
    };
    image = {px, side(small.width), side(small.height), side(small.width)};
    shrink(small, image);
  }
  Thumb(const Thumb&) = delete;
  Thumb& operator=(const Thumb&) = delete;
};

// How well the frame, laid over a keyframe at a shift in its thumb's pixels, agrees with what is below it.
struct Overlay {
  float score = -1;  // of the correlation and the covered share: chance agrees better in small parts
  int shift_x = 0, shift_y = 0;
};

// Of zero-mean normalised correlation, n (sum ab) - (sum a)(sum b) over the root of the variances. Sums of at most 256
// products of 8 bits: 24 bits, and 32 bits once multiplied by n.
float correlation_at(const GreyView& a, const GreyView& b, int shift_x, int shift_y, int* covered) {
  const int x0 = std::max(0, shift_x), x1 = std::min(a.width, b.width + shift_x);
  const int y0 = std::max(0, shift_y), y1 = std::min(a.height, b.height + shift_y);
  int32_t sum_a = 0, sum_b = 0, sum_aa = 0, sum_bb = 0, sum_ab = 0;
  for (int y = y0; y < y1; ++y) {
    const uint8_t* row_a = a.row(y);
    const uint8_t* row_b = b.row(y - shift_y);
    for (int x = x0; x < x1; ++x) {
      const int32_t p = row_a[x], q = row_b[x - shift_x];
      sum_a += p;
      sum_b += q;
      sum_aa += p * p;
      sum_bb += q * q;
      sum_ab += p * q;
    }
  }
  const int64_t n = int64_t{x1 - x0} * (y1 - y0);
  *covered += static_cast<int>(n);
  const int64_t variance_a = n * sum_aa - int64_t{sum_a} * sum_a, variance_b = n * sum_bb - int64_t{sum_b} * sum_b;
  if (variance_a <= 0 || variance_b <= 0) return -1;
  const int64_t covariance = n * sum_ab - int64_t{sum_a} * sum_b;
  return static_cast<float>(covariance) / std::sqrt(static_cast<float>(variance_a) * static_cast<float>(variance_b));
}

// The best of all shifts at which enough is covered. *compared: pixels, added to.
Overlay lay_over(const GreyView& keyframe, const GreyView& frame, int* compared) {
  Overlay best;
  const float whole = static_cast<float>(keyframe.width * keyframe.height);
  for (int y = 1 - frame.height; y < keyframe.height; ++y) {
    const int rows = std::min(keyframe.height, frame.height + y) - std::max(0, y);
    for (int x = 1 - frame.width; x < keyframe.width; ++x) {
      const int columns = std::min(keyframe.width, frame.width + x) - std::max(0, x);
      const float covered = static_cast<float>(rows * columns) / whole;
      if (covered < kMinCovered) continue;
      // Of a correlation r: nearly proportional to Fisher's z, whose sigma falls as the root of the pixels, by square
      // roots alone, which are the same everywhere.
      const float r = std::clamp(correlation_at(keyframe, frame, x, y, compared), 0.0f, 0.999f);
      const float score = r / std::sqrt(std::sqrt(1 - r * r)) * std::sqrt(std::min(covered, 1.0f));
      if (score > best.score) best = {score, x, y};
    }
  }
  return best;
}

// The rotation by the smallest angle that takes unit vector a to b; not for opposite ones.
Matrix3f rotation_between(const Vector3f& a, const Vector3f& b) {
  const Vector3f v = a.cross(b);
  Matrix3f V;
  V << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return Matrix3f::Identity() + V + V * V / (1 + a.dot(b));
}

// Where the keyframe's camera would have to be moved: its axis turns to what the frame's middle lies over, and it moves
// along that by what the scale tells. t_over_depth: in mean depths.
struct Moved {
  Matrix3f R_cp = Matrix3f::Identity();
  Vector3f t_over_depth = Vector3f::Zero();
};
Moved moved_by(const Overlay& overlay, float scale, const Camera& camera, const GreyView& small,
               const GreyView& keyframe, const GreyView& frame) {
  const int small_level = small_image_level(camera.model.width, camera.model.height);
  const auto under = [&](float middle, int small_side, int frame_side, int keyframe_side, int shift) {
    const float in_small = from_level0(middle, small_level) + 0.5f;
    const float in_keyframe =
        in_small * static_cast<float>(frame_side) / static_cast<float>(small_side) + static_cast<float>(shift);
    return to_level0(in_keyframe * static_cast<float>(small_side) / static_cast<float>(keyframe_side) - 0.5f,
                     small_level);
  };
  const Vector2f middle(0.5f * static_cast<float>(camera.model.width - 1),
                        0.5f * static_cast<float>(camera.model.height - 1));
  const Vector2f seen(under(middle.x(), small.width, frame.width, keyframe.width, overlay.shift_x),
                      under(middle.y(), small.height, frame.height, keyframe.height, overlay.shift_y));
  Moved moved;
  moved.R_cp = rotation_between(camera.unproject(seen).homogeneous().normalized(),
                                camera.unproject(middle).homogeneous().normalized());
  moved.t_over_depth.z() = 1 / scale - 1;
  return moved;
}

// Where the scores of keyframes first to first + count - 1 are best, but for `rank` better ones; -1: none is left. A
// negative score is none.
int ranked(std::span<float> scores, int rank) {
  int best = -1;
  for (int r = 0; r <= rank; ++r) {
    if (best >= 0) scores[static_cast<size_t>(best)] = -1;
    best = -1;
    for (int i = 0; i < static_cast<int>(scores.size()); ++i) {
      const float score = scores[static_cast<size_t>(i)];
      if (score >= 0 && (best < 0 || score > scores[static_cast<size_t>(best)])) best = i;
    }
    if (best < 0) return -1;
  }
  return best;
}

// The keyframes that an attempt compares: parts of `most` in turn.
struct Part {
  int first = 0, end = 0, rank = 0;
  Part(int keyframes, int most, int ranks, int attempt) {
    const int parts = std::max(1, (keyframes + most - 1) / most);
    first = attempt / ranks % parts * most;
    end = std::min(first + most, keyframes);
    rank = attempt % ranks;
  }
  size_t size() const { return static_cast<size_t>(std::max(0, end - first)); }
};

}  // namespace

RelocalisationCandidate propose_pose(const Map& map, const Camera& camera, FullFrameRotation& full_frame_rotation,
                                     bool lamp_bands, const GreyView& small, int attempt, WorkMeter& meter) {
  RelocalisationCandidate candidate;
  float least_residual = 0;
  const auto align = [&](int k, const Moved& start) {
    const Keyframe& keyframe = map.keyframes()[k];
    const RotationEstimate rotation =
        full_frame_rotation.estimate(keyframe.small, small, start.R_cp, start.t_over_depth, lamp_bands);
    meter.charge(Work::kRotationPixel, static_cast<int64_t>(rotation.iterations) * full_frame_rotation.pixels());
    meter.charge(Work::kOther, kRotationStepInstructions * rotation.iterations);
    // `near`: the rotation left over is within the tracker's wide search.
    if (!rotation.near || (candidate.keyframe >= 0 && rotation.residual >= least_residual)) return;
    least_residual = rotation.residual;
    candidate = {k, SE3(rotation.R_cp, start.t_over_depth * keyframe.mean_depth) * keyframe.T_kw};
  };
  const int slots = map.keyframes().size();
  int compared = 0;
  if (attempt % 2 == 0) {
    const Part part(slots, kComparedKeyframes, kRelocalisationRanks, attempt / 2);
    float scores[kComparedKeyframes];
    for (int k = part.first; k < part.end; ++k) {
      const Keyframe& keyframe = map.keyframes()[k];
      scores[k - part.first] = -1;
      if (keyframe.id == 0) continue;
      scores[k - part.first] = 1 / (1 + static_cast<float>(small_image_zmssd(keyframe.small, small)));
      compared += small.width * small.height;
    }
    meter.charge(Work::kRotationPixel, compared / kComparisonsPerRotationPixel);
    const int best = ranked({scores, part.size()}, part.rank);
    if (best >= 0) align(part.first + best, Moved());
    return candidate;
  }
  // Of each scale the best, from which the aligned images choose.
  const Part part(slots, kShiftedKeyframes, 1, attempt / 2);
  const Thumb frame[kScaleCount] = {{small, kScales[0]}, {small, kScales[1]}, {small, kScales[2]}};
  float scores[kScaleCount][kShiftedKeyframes];
  Overlay overlays[kScaleCount][kShiftedKeyframes];
  GreyView size;  // of a keyframe's thumb
  for (int k = part.first; k < part.end; ++k) {
    const Keyframe& keyframe = map.keyframes()[k];
    const size_t i = static_cast<size_t>(k - part.first);
    for (auto& of_scale : scores) of_scale[i] = -1;
    if (keyframe.id == 0) continue;
    const Thumb thumb(keyframe.small, 1);
    compared += small.width * small.height;
    for (size_t scale = 0; scale < kScaleCount; ++scale) {
      overlays[scale][i] = lay_over(thumb.image, frame[scale].image, &compared);
      scores[scale][i] = overlays[scale][i].score;
    }
    size = {nullptr, thumb.image.width, thumb.image.height, thumb.image.stride};
  }
  meter.charge(Work::kRotationPixel, compared / kComparisonsPerRotationPixel);
  for (size_t scale = 0; scale < kScaleCount; ++scale) {
    const int best = ranked({scores[scale], part.size()}, part.rank);
    if (best < 0) continue;
    align(part.first + best, moved_by(overlays[scale][best], kScales[scale], camera, small, size, frame[scale].image));
  }
  return candidate;
}

}  // namespace pptam
