// Stage 1 of the homography start: the first view's corners, re-found in every frame, and the homography H in SL(3)
// that explains them [phone 5.1].
//
// Points are re-found from their prediction, patches warped by H: no continuous tracks. Normalised image coordinates
// throughout; measurements are corrected for the rolling shutter by the rate of H itself. No frame searches more than
// kSearchesPerFrame points.
#pragma once

#include "geometry/homography.h"
#include "image/corner_source.h"
#include "map/map.h"
#include "map/patch_search.h"

namespace pptam {

// All measurements of a start count as of this level, those of blurred frames too: hypotheses' costs need one unit.
constexpr uint8_t kStartLevel = 1;
constexpr float kStartSigma_px = 2.0f;  // their expected standard deviation, before sub-pixel refinement

struct TrackedPoint {
  Vector2f px_1 = Vector2f::Zero();      // first view, level-0 pixels
  Vector2f x_1 = Vector2f::Zero();       // normalised, corrected for the rolling shutter
  Matrix2f J_1 = Matrix2f::Identity();   // d(px)/d(x) of the camera there
  Vector2f px_2 = Vector2f::Zero();      // current frame
  Vector2f x_2 = Vector2f::Zero();       // normalised, corrected
  Vector2f residual = Vector2f::Zero();  // of x_2 against H, kept for the next prediction: off-plane points
  float weight = 0;                      // of the homography fit
  bool on_plane = false;                 // where it was last found
  bool found = false;
};

class HomographyTracker {
 public:
  HomographyTracker(Arena& arena, const Config& config, WorkMeter& meter, CornerSource* corner_source);

  // Corners of the first view. False, with nothing changed, when there are too few.
  bool start(const Pyramid& first_view, const Vector3f& rotation_rate);
  void reset();

  // The next frame, dt_s later, turned by R_cp. False when too few points were found or H does not fit: H is then the
  // last one, turned.
  bool track(const Pyramid& first_view, const Pyramid& pyramid, float dt_s, const Matrix3f& R_cp,
             const SearchOptions& options);

  std::span<const TrackedPoint> points() const { return points_; }
  const Matrix3f& H() const { return H_; }          // first view to current, at the frame's timestamp
  const Matrix3f& rate() const { return H_rate_; }  // H(t + dt) = exp(dt * rate) H(t), 1/s
  float sigma_px() const { return sigma_px_; }      // robust scale of H's residuals, level-0 pixels
  std::span<const Vector2f> inlier_rays();          // of the first view
  // The points found, as they are now; valid until the next call.
  std::span<const Correspondence> correspondences();
  std::span<const ObservedPoint> observed() const { return observed_; }
  int attempted() const { return attempted_; }
  int found() const { return found_; }
  // The most points that a frame searches: fewer are attempted when some are out of sight.
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
  FixedVector<float> squared_, weights_;  // of a fit
  FixedVector<Correspondence> correspondences_;
  FixedVector<Vector2f> inlier_rays_;
  FixedVector<ObservedPoint> observed_;
  Matrix3f H_ = Matrix3f::Identity();
  Matrix3f H_rate_ = Matrix3f::Zero();
  Matrix3f parallax_rate_ = Matrix3f::Zero();  // of that, what the full-frame rotation did not see
  float sigma_px_ = 1;
  int next_search_ = 0;  // the point with which the next frame's search begins
  int attempted_ = 0, found_ = 0;
};

}  // namespace pptam
