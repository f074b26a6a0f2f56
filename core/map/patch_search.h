// Finds one patch of the map in the current frame: predict, warp, search, refine [ptam 5.3, phone 4].
#pragma once

#include <pocket_ptam/camera.h>
#include <pocket_ptam/work_meter.h>
#include "image/patch.h"
#include "map/map.h"

namespace pptam {

// Points predicted nearer than this to the image's edge are not searched. Level-0 pixels: 8 for half a template of L1,
// and half of the search radius of 8. Not swept.
inline float search_border_px(const Config& config) {
  return 12.0f * config.px_scale();
}

// SearchOptions::level: the one of kPointLevels that shows the patch as large as its source's level does [ptam 5.3].
constexpr int kOwnLevel = -1;
// Level in which map points are searched in a sharp image.
inline int level_of_points(const Config& config) {
  return config.own_levels ? kOwnLevel : config.search_level;
}

// Where the search happens.
struct SearchOptions {
  int level = 1;        // pyramid level searched: 1, or 2 for blurred frames [phone 4]; or kOwnLevel
  float radius_px = 4;  // in that level's pixels [phone 4]
  // Largest zero-mean SSD, as a fraction of the template's own zero-mean energy: 1 - NCC^2 for equal contrast. Lower
  // loses points to blur and slant, higher takes accidental matches. Not swept.
  float max_relative_zmssd = 0.4f;
  bool refine = true;
};

enum class SearchOutcome : uint8_t {
  kFound,
  kNotFound,    // searched, no match
  kNotVisible,  // would fall outside the image, or is seen at an unsuitable scale or angle
};

// Affine map from level-0 pixels of the source to level-0 pixels of the target, for a patch at p_s (source camera's
// frame) on the plane with normal n_s; T_ts takes source to target. False when p_s does not project in both, or the
// target sees the plane at over 75 degrees from its normal.
bool patch_affinity(const Camera& camera, const Vector3f& p_s, const Vector3f& n_s, const SE3& T_ts, Matrix2f* A_t_s);

// The level, of kPointLevels, whose pixels have about this area, level-0 pixels.
int level_of_area(float area);
// The level of the target in which a pixel of the source's level covers about one pixel [ptam 5.3].
int own_level(const Matrix2f& A_t_s, int source_level);

// Warps the patch at source_px of the source pyramid by A (target level 0 from source level 0) for a search in
// `level`, from the source level whose scale fits best. False when |det| falls outside [1/4, 4] at every level, the
// template leaves the source image, or has too little contrast. streak_px: level-0 pixels of the target by which the
// point moves while it is exposed; the template is blurred alike.
bool warp_template(const Pyramid& source, const Vector2f& source_px, const Matrix2f& A_t_s, int level,
                   PatchTemplate* patch, const Vector2f& streak_px = Vector2f::Zero());
// Number of patches that warp_template() takes the mean of, at most 6; 1: the template is not blurred.
int streak_parts(const Vector2f& streak_px, int level);

// Searches and refines a warped template around predicted_px (level 0).
SearchOutcome find_template(const Pyramid& target, const PatchTemplate& patch, const Vector2f& predicted_px,
                            const SearchOptions& options, WorkMeter& meter, ImagePoint* found);

// Where p_w appears in a keyframe, rolling shutter included. False when it is not in the image, search_border_px()
// inside.
bool predict_in_keyframe(const Map& map, const Config& config, int keyframe, const Vector3f& p_w,
                         PredictedPoint* predicted);
constexpr int64_t kPredictionInstructions = 900;  // of one Camera::project_rolling(), as counted for the ARM1176

// Source camera to world, at the exposure time of the source pixel's line: the frame of PartialPoint::ray.
SE3 exposed_pose(const Map& map, const Camera& camera, const PatchSource& source);

// A map point's template as it was warped for an earlier frame, with what it was made from.
struct KeptTemplate {
  uint32_t point_id = 0;     // 0: none
  uint32_t keyframe_id = 0;  // of the patch's source; 0: no template
  Vector2f source_px = Vector2f::Zero();
  Matrix2f A_s_t = Matrix2f::Zero();  // inverse of its affine map
  Vector2f streak_px = Vector2f::Zero();
  uint32_t asked_for = 0;  // KeptTemplates
  int searched_level = 0;
  PatchTemplate patch;

  // Whether it shows the patch as A_t_s would, to an eighth of a pixel of `level` anywhere in the 8x8 (the streak,
  // too).
  bool shows(const Keyframe& source, const Vector2f& px, const Matrix2f& A_t_s, int level,
             const Vector2f& streak) const;
};

// Finds patches of the map's keyframes in other images.
class PatchFinder {
 public:
  PatchFinder(const Map& map, const Config& config, WorkMeter& meter)
      : map_(map), camera_(config.camera), exposure_s_(config.exposure_s), meter_(meter) {}

  // Searches for the patch `source` of a map point or partial point at p_w around `predicted`. Sets *found only on
  // kFound. kept: the point's template in earlier frames; it is used while it shows the
  // patch as it is seen now, and replaced otherwise.
  SearchOutcome find(const PatchSource& source, const Vector3f& p_w, const PredictedPoint& predicted,
                     const Pyramid& target, const SearchOptions& options, ImagePoint* found,
                     KeptTemplate* kept = nullptr) const;

 private:
  Vector2f streak(const Keyframe& source, const Vector3f& p_s, const Matrix2f& A_t_s, const Vector3f& p_w,
                  const PredictedPoint& predicted) const;

  const Map& map_;
  const Camera& camera_;
  const float exposure_s_;
  WorkMeter& meter_;
};

}  // namespace pptam
