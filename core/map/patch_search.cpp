#include "map/patch_search.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

namespace pptam {

namespace {

// Zero-mean energy (grey levels^2) below which a template is noise: 64 pixels with a standard deviation of 4 grey
// levels. Not swept.
constexpr int32_t kMinEnergy = 64 * 4 * 4;
// Zero-mean SSD (grey levels^2) at which a match is accepted whatever the template's contrast: 64 pixels that differ by
// 3 grey levels rms, the sensor noise of both images. Not swept.
constexpr int32_t kNoiseZmssd = 64 * 3 * 3;
// SearchOptions::max_relative_zmssd is this many times larger under lamp bands, until the light is matched. Not swept.
constexpr float kBandTolerance = 2.0f;
constexpr int kRefineSteps = 8;  // ESM iterations at most: bounds the time of one point; not swept
// Cosine of the angle between viewing ray and patch normal: beyond 75 degrees an affine warp does not describe the
// view. Not swept.
constexpr float kMinCosSlant = 0.25f;
// Component of a unit normal along x above which y serves as the auxiliary axis: about 1 / sqrt(2), so that the cross
// product never vanishes.
constexpr float kAxisSwitch = 0.7f;
constexpr float kMinDeterminant = 1e-12f;  // px^2 per world unit^2: only guards the division
// Determinants of a level-0 warp outside of this are out of reach for every pyramid level.
constexpr float kMinWarpArea = 1e-3f, kMaxWarpArea = 1e3f;
// Length of a streak, pixels of the level searched, from which on the template is blurred, and the part of it for which
// one patch stands of those of which the mean is taken. Blurred from 1 or 1.5 px on nothing is gained. With parts of
// 1 px, and up to 6 of them, a quick pan's frames cost half a million instructions more, and 23 emulated runs had 1.08
// times the error.
constexpr float kMinStreak_px = 2, kStreakPart_px = 2;
constexpr int64_t kAffinityInstructions = 950;  // ARMv6, of one patch's affine map, as counted
constexpr int64_t kStreakInstructions = 500;    // of one streak(): an estimate
// Pixels of the level searched by which a kept template may be wrong anywhere. Six stories, three seeds each, error of
// the path beside that with templates of each frame: 0.97 times as large, with twice that 1.17, with four times 1.28.
constexpr float kKeptWarp_px = 0.125f;
// Area of a template pixel in pixels of the source level, a ratio: within 1/4 to 4 [ptam 5.3]. A level is a factor of
// 4; above 2 the next coarser level is nearer.
constexpr float kMinSourceArea = 0.25f, kMaxSourceArea = 4.0f, kCoarserArea = 2.0f, kAreaPerLevel = 0.25f;

// Whether the 8x8 at `at` (image pixels) and its next pixels are inside the image.
bool inside(const GreyView& image, const Vector2f& at) {
  const float x = at.x() - kPatchCentre, y = at.y() - kPatchCentre;
  return x >= 0 && y >= 0 && x < static_cast<float>(image.width - kPatchSize) &&
         y < static_cast<float>(image.height - kPatchSize);
}

}  // namespace

bool patch_affinity(const Camera& camera, const Vector3f& p_s, const Vector3f& n_s, const SE3& T_ts, Matrix2f* A_t_s) {
  const Vector3f p_t = T_ts * p_s;
  const Vector3f n_t = T_ts.R * n_s;
  if (-n_t.dot(p_t) < kMinCosSlant * p_t.norm()) return false;
  // Two tangents of the plane; a step along them moves the pixel by M_s in the source and M_t in the target.
  const Vector3f axis = std::abs(n_s.x()) < kAxisSwitch ? Vector3f::UnitX() : Vector3f::UnitY();
  const Vector3f e1 = n_s.cross(axis).normalized();
  const Vector3f e2 = n_s.cross(e1);
  Vector2f px;
  Matrix23f J_s, J_t;
  if (!camera.project(p_s, &px, &J_s) || !camera.project(p_t, &px, &J_t)) return false;
  Matrix2f M_s, M_t;
  M_s << J_s * e1, J_s * e2;
  M_t << J_t * (T_ts.R * e1), J_t * (T_ts.R * e2);
  const float det = M_s.determinant();
  if (!(std::abs(det) > kMinDeterminant)) return false;
  *A_t_s = M_t * M_s.inverse();
  return A_t_s->allFinite();
}

int level_of_area(float area) {
  int level = 0;
  for (; area > kCoarserArea && level < kPointLevels - 1; ++level) area *= kAreaPerLevel;
  return level;
}

int own_level(const Matrix2f& A_t_s, int source_level) {
  return level_of_area(A_t_s.determinant() * static_cast<float>(1 << (2 * source_level)));
}

int streak_parts(const Vector2f& streak_px, int level) {
  const float length = streak_px.norm() / static_cast<float>(1 << level);
  if (!(length >= kMinStreak_px)) return 1;  // NaN too
  const float parts = std::min(length / kStreakPart_px, static_cast<float>(TemplateMean::kMost));
  return std::max(2, static_cast<int>(parts + 0.5f));
}

bool warp_template(const Pyramid& source, const Vector2f& source_px, const Matrix2f& A_t_s, int level,
                   PatchTemplate* patch, const Vector2f& streak_px) {
  const float det = A_t_s.determinant();
  if (!(det > kMinWarpArea) || !(det < kMaxWarpArea)) return false;
  // One template pixel covers 4^level / det(A) source pixels at level 0: choose the source level nearest to that.
  const float area = static_cast<float>(1 << (2 * level)) / det;
  int source_level = 0;
  float scaled = area;
  while (scaled > kCoarserArea && source_level < kPyramidLevels - 1) {
    scaled *= kAreaPerLevel;
    ++source_level;
  }
  if (scaled < kMinSourceArea || scaled > kMaxSourceArea) return false;
  const Matrix2f J_src_tpl = A_t_s.inverse() * (static_cast<float>(1 << level) / static_cast<float>(1 << source_level));
  const Vector2f centre(from_level0(source_px.x(), source_level), from_level0(source_px.y(), source_level));
  const GreyView& image = source.level[source_level];
  const int parts = streak_parts(streak_px, level);
  if (parts == 1) return warp_patch(image, centre, J_src_tpl, patch) && patch->energy() >= kMinEnergy;
  // The mean over the exposure: of patches at its equal parts.
  const Vector2f streak = streak_px / static_cast<float>(1 << level);  // template pixels
  TemplateMean mean;
  for (int i = 0; i < parts; ++i) {
    const float share = (static_cast<float>(i) + 0.5f) / static_cast<float>(parts) - 0.5f;
    if (!warp_pixels(image, centre + J_src_tpl * (share * streak), J_src_tpl, patch)) return false;
    mean.add(*patch);
  }
  mean.write(parts, patch);
  return patch->energy() >= kMinEnergy;
}

SearchOutcome find_template(const Pyramid& target, const PatchTemplate& patch, const Vector2f& predicted_px,
                            const SearchOptions& options, WorkMeter& meter, ImagePoint* found) {
  const GreyView& image = target.level[options.level];
  const Vector2f predicted(from_level0(predicted_px.x(), options.level), from_level0(predicted_px.y(), options.level));
  const auto limit = [&](const PatchTemplate& of, float share) {
    return std::max(kNoiseZmssd, static_cast<int32_t>(share * static_cast<float>(of.energy())));
  };
  const bool bands = target.lamp_lines != LampLines::kNone;
  PatchHit hit;
  const bool matched = search_patch(image, patch, predicted, options.radius_px,
                                    limit(patch, (bands ? kBandTolerance : 1) * options.max_relative_zmssd), &hit);
  meter.charge(Work::kPatchCandidate, hit.candidates);
  if (hit.candidates == 0) return SearchOutcome::kNotVisible;
  if (!matched) return SearchOutcome::kNotFound;
  Vector2f at(static_cast<float>(hit.x) + kPatchCentre, static_cast<float>(hit.y) + kPatchCentre);
  RefinedPatch refined;
  const auto refine = [&](const PatchTemplate& with) {
    const bool converged = refine_patch(image, with, at, kRefineSteps, &refined);
    meter.charge(Work::kPatchRefineStep, refined.steps);
    if (converged) at = refined.position;
    return converged;
  };
  if (!bands) {
    if (options.refine && !refine(patch)) return SearchOutcome::kNotFound;
  } else {
    // The light is matched where the patch was found, and once more where that leads.
    for (int round = 0; round < (options.refine ? 2 : 1); ++round) {
      if (!inside(image, at)) return SearchOutcome::kNotFound;
      PatchTemplate lit = patch;
      match_light(image, at, target.lamp_lines, &lit);
      if (round == 0 && !search_patch(image, lit, at, 0, limit(lit, options.max_relative_zmssd), &hit))
        return SearchOutcome::kNotFound;
      if (options.refine && !refine(lit)) return SearchOutcome::kNotFound;
    }
  }
  found->px = {to_level0(at.x(), options.level), to_level0(at.y(), options.level)};
  found->level = static_cast<uint8_t>(options.level);
  return SearchOutcome::kFound;
}

bool predict_in_keyframe(const Map& map, const Config& config, int keyframe, const Vector3f& p_w,
                         PredictedPoint* predicted) {
  const Keyframe& k = map.keyframes()[keyframe];
  return config.camera.project_rolling(k.T_kw, k.velocity, p_w, predicted) &&
         config.camera.in_image(predicted->px, search_border_px(config));
}

SE3 exposed_pose(const Map& map, const Camera& camera, const PatchSource& source) {
  const Keyframe& keyframe = map.keyframes()[source.keyframe];
  return pose_at(keyframe.T_kw, keyframe.velocity, camera.dt_s(source.px)).inverse();
}

// Level-0 pixels of the target by which the point moves while it is exposed, less what the source's own exposure has
// blurred.
Vector2f PatchFinder::streak(const Keyframe& source, const Vector3f& p_s, const Matrix2f& A_t_s, const Vector3f& p_w,
                             const PredictedPoint& predicted) const {
  const auto in = [&](const Vector3f& p, const Vector6f& velocity) -> Vector2f {
    Vector2f px;
    Matrix23f J_px_p;
    if (!camera_.project(p, &px, &J_px_p)) return Vector2f::Zero();
    return exposure_s_ * (J_px_p * Vector3f(velocity.head<3>() + velocity.tail<3>().cross(p)));
  };
  const Vector2f target = in(predicted.T_cw * p_w, predicted.velocity);
  const float length_sq = target.squaredNorm();
  if (length_sq == 0) return Vector2f::Zero();
  const float more_sq = length_sq - (A_t_s * in(p_s, source.velocity)).squaredNorm();
  return target * std::sqrt(std::max(0.0f, more_sq / length_sq));
}

bool KeptTemplate::shows(const Keyframe& source, const Vector2f& px, const Matrix2f& A_t_s, int level,
                         const Vector2f& streak) const {
  if (keyframe_id != source.id || source_px != px || searched_level != level) return false;
  // A pixel of the template at u (from its reference point) shows what is seen at A_t_s A_s_t u now. The distance is
  // largest in a corner.
  const Matrix2f E = A_t_s * A_s_t - Matrix2f::Identity();
  const float away_sq = std::max((E.col(0) + E.col(1)).squaredNorm(), (E.col(0) - E.col(1)).squaredNorm());
  const float longest_px = kKeptWarp_px * static_cast<float>(1 << level);
  return away_sq * kPatchCentre * kPatchCentre <= kKeptWarp_px * kKeptWarp_px &&
         (streak - streak_px).squaredNorm() <= longest_px * longest_px;
}

SearchOutcome PatchFinder::find(const PatchSource& source, const Vector3f& p_w, const PredictedPoint& predicted,
                                const Pyramid& target, const SearchOptions& options, ImagePoint* found,
                                KeptTemplate* kept) const {
  const Keyframe& keyframe = map_.keyframes()[source.keyframe];
  const Vector3f p_s = keyframe.T_kw * p_w;
  Matrix2f A_t_s;
  meter_.charge(Work::kOther, kAffinityInstructions);
  if (!patch_affinity(camera_, p_s, source.normal, predicted.T_cw * keyframe.T_kw.inverse(), &A_t_s))
    return SearchOutcome::kNotVisible;
  SearchOptions used = options;
  if (options.level == kOwnLevel) used.level = own_level(A_t_s, source.level);
  Vector2f streak_px = Vector2f::Zero();
  if (exposure_s_ > 0) {
    streak_px = streak(keyframe, p_s, A_t_s, p_w, predicted);
    meter_.charge(Work::kOther, kStreakInstructions);
  }
  const int parts = streak_parts(streak_px, used.level);
  if (parts == 1) streak_px.setZero();  // the template is not blurred
  if (kept && kept->shows(keyframe, source.px, A_t_s, used.level, streak_px))
    return find_template(target, kept->patch, predicted.px, used, meter_, found);
  PatchTemplate patch;
  meter_.charge(Work::kPatchWarp, parts);
  if (!warp_template(keyframe.pyramid, source.px, A_t_s, used.level, &patch, streak_px))
    return SearchOutcome::kNotVisible;
  if (kept) {
    kept->keyframe_id = keyframe.id;
    kept->source_px = source.px;
    kept->A_s_t = A_t_s.inverse();
    kept->streak_px = streak_px;
    kept->searched_level = used.level;
    kept->patch = patch;
  }
  return find_template(target, patch, predicted.px, used, meter_, found);
}

}  // namespace pptam
