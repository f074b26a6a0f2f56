#include "map/patch_search.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

namespace pptam {

namespace {

// Zero-mean energy of a template below which it is noise: 64 pixels with a standard deviation of 4 grey levels.
constexpr int32_t kMinEnergy = 64 * 4 * 4;
// A match at this mean squared difference is accepted whatever the template's contrast: sensor noise of both images.
constexpr int32_t kNoiseZmssd = 64 * 3 * 3;
constexpr int kRefineSteps = 8;
// Slant between viewing ray and patch plane beyond which the affine warp is worthless: 75 degrees.
constexpr float kMinCosSlant = 0.25f;

}  // namespace

bool patch_affinity(const Camera& camera, const Vector3f& p_s, const Vector3f& n_s, const SE3& T_ts, Matrix2f* A_t_s) {
  const Vector3f p_t = T_ts * p_s;
  const Vector3f n_t = T_ts.R * n_s;
  if (-n_t.dot(p_t) < kMinCosSlant * p_t.norm()) return false;
  // Two tangents of the plane; a step along them moves the pixel by M_s in the source and M_t in the target.
  const Vector3f axis = std::abs(n_s.x()) < 0.7f ? Vector3f::UnitX() : Vector3f::UnitY();
  const Vector3f e1 = n_s.cross(axis).normalized();
  const Vector3f e2 = n_s.cross(e1);
  Vector2f px;
  Matrix23f J_s, J_t;
  if (!camera.project(p_s, &px, &J_s) || !camera.project(p_t, &px, &J_t)) return false;
  Matrix2f M_s, M_t;
  M_s << J_s * e1, J_s * e2;
  M_t << J_t * (T_ts.R * e1), J_t * (T_ts.R * e2);
  const float det = M_s.determinant();
  if (!(std::abs(det) > 1e-12f)) return false;
  *A_t_s = M_t * M_s.inverse();
  return A_t_s->allFinite();
}

bool warp_template(const Pyramid& source, const Vector2f& source_px, const Matrix2f& A_t_s, int level,
                   PatchTemplate* patch) {
  const float det = A_t_s.determinant();
  if (!(det > 1e-3f) || !(det < 1e3f)) return false;
  // One template pixel covers det(A^-1) 4^level source pixels at level 0: choose the source level nearest to that.
  const float area = static_cast<float>(1 << (2 * level)) / det;
  int source_level = 0;
  float scaled = area;
  while (scaled > 2.0f && source_level < kPyramidLevels - 1) {
    scaled *= 0.25f;
    ++source_level;
  }
  if (scaled < 0.25f || scaled > 4.0f) return false;
  const Matrix2f J_src_tpl = A_t_s.inverse() * (static_cast<float>(1 << level) / static_cast<float>(1 << source_level));
  const Vector2f centre(from_level0(source_px.x(), source_level), from_level0(source_px.y(), source_level));
  return warp_patch(source.level[source_level], centre, J_src_tpl, patch) && patch->energy() >= kMinEnergy;
}

SearchOutcome find_template(const Pyramid& target, const PatchTemplate& patch, const Vector2f& predicted_px,
                            const SearchOptions& options, WorkMeter& meter, ImagePoint* found) {
  const GreyView& image = target.level[options.level];
  const Vector2f predicted(from_level0(predicted_px.x(), options.level), from_level0(predicted_px.y(), options.level));
  const float energy = static_cast<float>(patch.energy());
  const int32_t max_zmssd = std::max(kNoiseZmssd, static_cast<int32_t>(options.max_relative_zmssd * energy));
  PatchHit hit;
  const bool matched = search_patch(image, patch, predicted, options.radius_px, max_zmssd, &hit);
  meter.charge(Work::kPatchCandidate, hit.candidates);
  if (hit.candidates == 0) return SearchOutcome::kNotVisible;
  if (!matched) return SearchOutcome::kNotFound;
  Vector2f at(static_cast<float>(hit.x) + kPatchCentre, static_cast<float>(hit.y) + kPatchCentre);
  if (options.refine) {
    RefinedPatch refined;
    const bool converged = refine_patch(image, patch, at, kRefineSteps, &refined);
    meter.charge(Work::kPatchRefineStep, refined.steps);
    if (!converged) return SearchOutcome::kNotFound;
    at = refined.position;
  }
  found->px = {to_level0(at.x(), options.level), to_level0(at.y(), options.level)};
  found->level = static_cast<uint8_t>(options.level);
  return SearchOutcome::kFound;
}

bool predict_in_keyframe(const Map& map, const Camera& camera, int keyframe, const Vector3f& p_w,
                         PredictedPoint* predicted) {
  const Keyframe& k = map.keyframes()[keyframe];
  return camera.project_rolling(k.T_kw, k.velocity, p_w, predicted) && camera.in_image(predicted->px, kSearchBorder_px);
}

SearchOutcome PatchFinder::find(const PatchSource& source, const Vector3f& p_w, const PredictedPoint& predicted,
                                const Pyramid& target, const SearchOptions& options, ImagePoint* found) const {
  const Keyframe& keyframe = map_.keyframes()[source.keyframe];
  const Vector3f p_s = keyframe.T_kw * p_w;
  Matrix2f A_t_s;
  if (!patch_affinity(camera_, p_s, source.normal, predicted.T_cw * keyframe.T_kw.inverse(), &A_t_s))
    return SearchOutcome::kNotVisible;
  PatchTemplate patch;
  meter_.charge(Work::kPatchWarp, 1);
  if (!warp_template(keyframe.pyramid, source.px, A_t_s, options.level, &patch)) return SearchOutcome::kNotVisible;
  return find_template(target, patch, predicted.px, options, meter_, found);
}

}  // namespace pptam
