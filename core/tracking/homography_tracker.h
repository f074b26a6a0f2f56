// Stage 1 of the homography start: finds the first view's corners in every frame, and fits the homography H in SL(3)
// that maps them [phone 5.1].
//
// Points are searched around their prediction, with patches warped by H: no continuous tracks are needed. H maps
// normalised image coordinates. Measurements are corrected for the rolling shutter by the rate of H itself. A frame
// searches at most kSearchesPerFrame points.
#pragma once

#include <span>

#include "geometry/homography.h"
#include "image/corner_source.h"
#include "map/map.h"
#include "map/patch_search.h"

namespace pptam {

// Pyramid level that all measurements of a start count as, those of blurred frames too: costs of hypotheses need one
// unit.
inline uint8_t start_level(const Config& config) {
  return static_cast<uint8_t>(config.search_level);
}
// Expected standard deviation of a start's measurements, level-0 px: 2^start_level(), before sub-pixel refinement.
inline float start_sigma_px(const Config& config) {
  return 2.0f * config.px_scale();
}

struct TrackedPoint {
  Vector2f px_1 = Vector2f::Zero();      // first view, level-0 pixels
  Vector2f x_1 = Vector2f::Zero();       // normalised, corrected for the rolling shutter
  Matrix2f J_1 = Matrix2f::Identity();   // d(px)/d(x) of the camera at x_1
  Vector2f px_2 = Vector2f::Zero();      // current frame
  Vector2f x_2 = Vector2f::Zero();       // normalised, corrected
  Vector2f residual = Vector2f::Zero();  // x_2 - H x_1, normalised: predicts points off the plane in the next frame
  float weight = 0;                      // Tukey weight in the homography fit
  float farthest_sq = 0;                 // px_2 to px_1 at most since the first view, squared level-0 pixels
  bool on_plane = false;                 // inlier of H when it was last found
  bool had_turn = false;                 // in the last frame: searched, or expected outside of the image
  bool found = false;
};

class HomographyTracker {
 public:
  HomographyTracker(Arena& arena, const Config& config, WorkMeter& meter, CornerSource* corner_source);

  // Corners of the first view. False, with nothing changed, when there are too few.
  bool start(const Pyramid& first_view, const Vector3f& rotation_rate);
  void reset();

  // Tracks the next frame, dt_s later. R_cp: previous camera to present camera. False when too few points were found or
  // H does not fit: H is then the last H turned by R_cp.
  bool track(const Pyramid& first_view, const Pyramid& pyramid, float dt_s, const Matrix3f& R_cp,
             const SearchOptions& options);

  std::span<const TrackedPoint> points() const { return points_; }
  const Matrix3f& H() const { return H_; }          // first view to current, at the frame's timestamp
  const Matrix3f& rate() const { return H_rate_; }  // H(t + dt) = exp(dt * rate) H(t), 1/s
  float sigma_px() const { return sigma_px_; }      // robust scale of H's residuals, level-0 pixels
  // Inliers of H in the first view, normalised coordinates; valid until the next call.
  std::span<const Vector2f> inlier_rays();
  // The found points in the first and the present view; valid until the next call.
  std::span<const Correspondence> correspondences();
  std::span<const ObservedPoint> observed() const { return observed_; }
  int attempted() const { return attempted_; }
  int found() const { return found_; }
  // Whether many points have stayed in their places since the first view although others have moved: the camera stands,
  // and something moves in front of it. A hand that moves sideways turns too, by more than a pixel.
  bool camera_stands() const;
  // Whether much of what was not found in the last frame is found where the first view saw it: the scene at rest behind
  // a thing that moves. Searches at most kSearchesPerFrame points again.
  bool scene_rests(const Pyramid& first_view, const Pyramid& pyramid, const SearchOptions& options);
  // Largest number of points that a frame can search; fewer are attempted when some are out of sight.
  int searched_at_once() const;

 private:
  void search(const Pyramid& first_view, const Pyramid& pyramid, const Matrix3f& H_predicted, const Matrix3f& rate,
              const SearchOptions& options);
  bool predict(const TrackedPoint& point, const Matrix3f& H_predicted, const Matrix3f& rate, Vector2f* px,
               Matrix2f* A) const;
  bool fit(const Matrix3f& H_start);
  void correct(const Matrix3f& rate);
  Vector2f corrected(const Vector2f& px, const Matrix3f& rate) const;

  const Config& config_;
  WorkMeter& meter_;
  CornerSource* corner_source_;
  FixedVector<Corner> corners_;
  FixedVector<TrackedPoint> points_;
  FixedVector<float> squared_, weights_;  // scratch and Tukey weights of a fit
  FixedVector<Correspondence> correspondences_;
  FixedVector<Vector2f> inlier_rays_;
  FixedVector<ObservedPoint> observed_;
  Matrix3f H_ = Matrix3f::Identity();
  Matrix3f H_rate_ = Matrix3f::Zero();
  Matrix3f parallax_rate_ = Matrix3f::Zero();  // H_rate_ less the full-frame rotation's rate, 1/s
  float sigma_px_ = 1;
  int next_search_ = 0;  // the point with which the next frame's search begins
  int attempted_ = 0, found_ = 0;
};

}  // namespace pptam
