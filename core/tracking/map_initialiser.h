// Two-stage initialisation from one tap [phone 5.1].
//
// Stage 1 tracks the first view's corners with a homography H in SL(3) and decomposes it in every frame. Where H leaves
// more than noise, the relative pose from the epipolar constraint is sought on the same points, a few starts in each
// frame (beyond the paper). Once the motion is well constrained - sigma of the plane's normal, or of depth and
// direction, added up over frames - stage 2 keeps up to two planar hypotheses (R, t, n) and one without a plane, each
// with its own triangulated points, and tracks an SE(3) pose in each until the others cost twice as much; a plane that
// costs hardly more than no plane wins. The result is a small map: the points and up to eight keyframes spread over the
// way (beyond the paper: two views cannot tell structure from the shutter's distortion, several can), in the first
// camera's frame, scaled so that the scene is about 1 away. The mapper locates the keyframes and adjusts it.
//
// A first view that has gone out of sight by turning, or of which nothing has come in ten seconds, is replaced.
//
// Points are re-found in each frame from their prediction: no continuous tracks. Normalised image coordinates
// throughout; measurements are corrected for the rolling shutter by the rate of H itself. No frame costs more than
// about 6 million ARMv6 instructions: searches, starts and pose points of a frame are limited.
#pragma once

#include "camera/pose_update.h"
#include "geometry/homography.h"
#include "geometry/two_view.h"
#include "image/corners.h"
#include "map/map.h"
#include "map/patch_search.h"

namespace pptam {

class MapInitialiser {
 public:
  MapInitialiser(Arena& arena, const Config& config, WorkMeter& meter);

  enum class Progress : uint8_t {
    kIdle,      // start() has not been called
    kTracking,  // stage 1 or 2 goes on
    kLost,      // the first view was lost, or nothing came of it: back to idle
    kDone       // build() may be called
  };

  // Takes the first view. rotation_rate: of the full-frame rotation, radians/s. Hint::kNone on success, otherwise why
  // the view is not suitable (too little texture, not held still); nothing has changed then.
  Hint start(const Pyramid& pyramid, const GreyView& small, int64_t timestamp_ns, const Vector3f& rotation_rate);

  // Tracks the first view in the next frame. R_cp: rotation from the frame before (full-frame rotation).
  Progress track(const Pyramid& pyramid, const GreyView& small, int64_t timestamp_ns, const Matrix3f& R_cp);

  // Writes keyframes and points into an empty map (and leaves it not `ready`); T_cw and velocity are the current
  // frame's. Keyframes between the first and the last get the last one's pose: the mapper finds theirs in idle time.
  // False when the map came out too small; the map is then empty again.
  bool build(Map& map, SE3* T_cw, Vector6f* velocity);

  void reset();
  bool active() const { return stage_ != Stage::kIdle; }
  float progress() const { return progress_; }  // 0 to 1
  Hint hint() const { return hint_; }
  std::span<const ObservedPoint> observed() const { return observed_; }
  int attempted() const { return attempted_; }
  int found() const { return found_; }

 private:
  enum class Stage : uint8_t { kIdle, kHomography, kHypotheses };
  struct Point {
    Vector2f px_1 = Vector2f::Zero();      // first view, level-0 pixels
    Vector2f x_1 = Vector2f::Zero();       // normalised, corrected for the rolling shutter
    Matrix2f J_1 = Matrix2f::Identity();   // d(px)/d(x) of the camera there
    Vector2f px_2 = Vector2f::Zero();      // current frame
    Vector2f x_2 = Vector2f::Zero();       // normalised, corrected
    Vector2f residual = Vector2f::Zero();  // of x_2 against H, kept for the next prediction: off-plane points
    float weight = 0;                      // of the homography fit
    bool on_plane = false;                 // where it was last found
    bool found = false;
    bool found_b = false;
  };
  struct Hypothesis {
    bool planar = true;
    Vector3f n_1 = Vector3f::UnitZ();  // the plane n_1 . p_1 = 1, when planar
    SE3 T_c1;                          // pose of the current frame
    Vector6f velocity = Vector6f::Zero();
    FixedVector<Vector3f> p_1;  // one per point; z = 0 where not triangulated
    float cost = 0;             // running robust cost, summed over the frames of stage 2
    float sigma = 0;            // robust scale of its residuals in the current frame, units of 2 px
    bool alive = false;
  };
  struct ViewPoint {
    Vector2f px = Vector2f::Zero();
    bool found = false;
  };
  struct Neighbour {  // the frame before or after a view
    bool known = false;
    int64_t timestamp_ns = 0;
    FixedVector<ViewPoint> points;
  };
  struct View {  // on the way: a keyframe if the map comes about
    Keyframe frame;
    FixedVector<ViewPoint> points;  // one per point
    Neighbour before, after;
  };

  void search_points(const Pyramid& pyramid, const Matrix3f& H_predicted, const Matrix3f& rate,
                     const SearchOptions& options);
  bool fit_to_found(const Matrix3f& H_predicted);
  void renew_first_view(const Pyramid& pyramid, const GreyView& small, int64_t timestamp_ns,
                        const Vector3f& rotation_rate);
  float planar_margin(const Decomposition& decomposition);
  float general_margin(const Decomposition& decomposition);
  void branch(const Decomposition& decomposition, bool general);
  void gather_pose_points(const Hypothesis& hypothesis);
  bool track_hypotheses(float dt_s);
  Vector2f corrected(const Vector2f& px, const Matrix3f& rate) const;
  Vector6f velocity_from_rate(const Matrix3f& rate, const Hypothesis& hypothesis, const SE3& T_k1) const;
  void record_view(const Pyramid& pyramid, const GreyView& small, int64_t timestamp_ns, bool last);
  bool usable(const Hypothesis& hypothesis, int point) const;
  bool add_views(const Hypothesis& hypothesis, Map& map);
  bool add_points(const Hypothesis& hypothesis, Map& map);
  void note_points(FixedVector<ViewPoint>& points) const;
  void note_neighbour(int64_t timestamp_ns, Neighbour& neighbour) const;
  void store_view(const Pyramid& pyramid, const GreyView& small, int64_t timestamp_ns, View& view);

  const Config& config_;
  WorkMeter& meter_;
  Stage stage_ = Stage::kIdle;
  View views_[kMaxInitialKeyframes];  // views_[0] is the first view
  Neighbour last_;                    // the frame before the present one
  int view_count_ = 0;
  int view_stride_ = 1;  // frames from one recorded view to the next; doubles whenever the places run out
  int frames_since_view_ = 0;
  CornerDetector corner_detector_;
  FixedVector<Corner> corners_;
  FixedVector<Point> points_;
  FixedVector<PosePoint> pose_points_;
  PoseUpdater pose_;
  FixedVector<float> squared_;
  FixedVector<float> weights_;
  FixedVector<Correspondence> correspondences_;
  FixedVector<Vector2f> inlier_rays_;
  FixedVector<ObservedPoint> observed_;
  RelativePose relative_;  // general motion, refined from frame to frame; ok: may be used as a start
  int next_start_ = 0;     // which start is tried next, besides
  static constexpr int kHypotheses = 3;
  Hypothesis hypotheses_[kHypotheses];  // two of the plane, one general
  Matrix3f H_ = Matrix3f::Identity();   // first view to current, at the frame's timestamp
  Matrix3f H_previous_ = Matrix3f::Identity();
  Matrix3f H_rate_ = Matrix3f::Zero();         // H(t + dt) = exp(dt * H_rate) H(t), 1/s
  Matrix3f parallax_rate_ = Matrix3f::Zero();  // of that, what the full-frame rotation did not see
  int64_t previous_ns_ = 0;
  int64_t start_ns_ = 0;
  int64_t branch_ns_ = 0;  // when stage 2 began
  int winner_ = -1;
  bool all_failed_ = false;  // no hypothesis of stage 2 is left
  int frames_ = 0;
  int bad_frames_ = 0;
  float sigma_px_ = 1;  // robust scale of the homography's residuals, level-0 pixels
  float known_ = 0;     // information about the motion, summed over the frames; 1: known as well as it must be
  float progress_ = 0;
  Hint hint_ = Hint::kNone;
  int next_search_ = 0;  // the point with which the next frame's search begins
  int attempted_ = 0;
  int found_ = 0;
};

}  // namespace pptam
