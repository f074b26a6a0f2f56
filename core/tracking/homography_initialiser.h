// Two-stage initialisation from one tap [phone 5.1].
//
//   HomographyTracker ─▶ decomposition: is the motion well constrained? ─▶ StartHypotheses ─▶ build()
//          └─▶ ViewRecorder: keyframes of the map to come
//
// Stage 1 tracks the first view's corners with a homography H and decomposes it in every frame. Where H leaves more
// than noise, the relative pose is sought from the epipolar constraint on the same points, a few starts in each frame
// (beyond the paper). The motion is well constrained when the sigma of the plane's normal, or of depth and direction,
// is small; information is summed over frames. Then stage 2 tracks rival maps until one wins. The result is a small
// map: the points and up to eight keyframes spread over the path, in the first camera's frame, scaled so that the scene
// is at a distance of about 1. The mapper finds the keyframes' poses and adjusts the map.
//
// The first view is replaced when turning has moved it out of sight, and after ten seconds without stage 2. No frame
// costs more than about 6 million ARMv6 instructions: searches, starts and pose points of a frame are limited.
#pragma once

#include "tracking/initialiser.h"
#include "tracking/start_hypotheses.h"
#include "tracking/view_recorder.h"

namespace pptam {

class HomographyInitialiser final : public Initialiser {
 public:
  HomographyInitialiser(Arena& arena, const Config& config, WorkMeter& meter, CornerSource* corner_source);

  Hint start(const FrameInput& frame, const Vector3f& rotation_rate) override;
  Progress track(const FrameInput& frame, const Matrix3f& R_cp) override;
  // Keyframes between the first and the last get the last one's pose: the mapper finds their own (InitialMap).
  bool build(Map& map, SE3* T_cw, Vector6f* velocity) override;
  void reset() override;
  bool active() const override { return stage_ != Stage::kIdle; }
  const Report& report() const override { return report_; }

 private:
  enum class Stage : uint8_t { kIdle, kHomography, kHypotheses };

  Progress give_up();
  void constrain(const FrameInput& frame, const Matrix3f& R_cp, float dt_s, bool sharp, const SearchOptions& options);
  Progress compare(const FrameInput& frame, float dt_s);
  void renew_first_view(const FrameInput& frame, const Vector3f& rotation_rate);
  float planar_margin(const Decomposition& decomposition);
  float general_margin(const Decomposition& decomposition);
  void seek_relative_pose(const Decomposition& decomposition, std::span<const Correspondence> correspondences);
  float median_depth_sigma(std::span<const Correspondence> correspondences);
  bool usable(const Hypothesis& hypothesis, int point) const;
  bool add_views(const Hypothesis& hypothesis, Map& map);
  bool add_points(const Hypothesis& hypothesis, Map& map);

  float px(float length) const { return length * config_.px_scale(); }

  const Config& config_;
  WorkMeter& meter_;
  HomographyTracker tracker_;
  ViewRecorder recorder_;
  StartHypotheses hypotheses_;
  FixedVector<float> values_;  // scratch for medians
  Report report_;

  Stage stage_ = Stage::kIdle;
  int64_t previous_ns_ = 0;
  int64_t start_ns_ = 0;
  int64_t branch_ns_ = 0;  // when stage 2 began
  int frames_ = 0;         // frames tracked well in the present stage
  int bad_frames_ = 0;     // bad frames in a row
  float information_ = 0;  // about the motion, summed over the frames; 1: that of one frame that reaches margin 1
  RelativePose relative_;  // general motion, refined from frame to frame; ok: usable as a start
  int next_start_ = 0;     // starts tried so far besides relative_; modulo their number, the next one
};

}  // namespace pptam
