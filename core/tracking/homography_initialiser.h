// Two-stage initialisation from one tap [phone 5.1].
//
//   HomographyTracker ─▶ decomposition: is the motion well constrained? ─▶ StartHypotheses ─▶ build()
//          └─▶ ViewRecorder: keyframes of the map to come
//
// Stage 1 tracks the first view's corners with a homography and decomposes it in every frame. Where H leaves more than
// noise, the relative pose from the epipolar constraint is sought on the same points, a few starts in each frame
// (beyond the paper). Once the motion is well constrained - sigma of the plane's normal, or of depth and direction,
// added up over frames - stage 2 tracks rival maps until one wins. The result is a small map: the points and up to
// eight keyframes spread over the way, in the first camera's frame, scaled so that the scene is about 1 away. The
// mapper locates the keyframes and adjusts it.
//
// A first view that has gone out of sight by turning, or of which nothing has come in ten seconds, is replaced. No
// frame costs more than about 6 million ARMv6 instructions: searches, starts and pose points of a frame are limited.
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
  // Keyframes between the first and the last get the last one's pose: the mapper finds theirs.
  bool build(Map& map, SE3* T_cw, Vector6f* velocity) override;
  void reset() override;
  bool active() const override { return stage_ != Stage::kIdle; }
  const Report& report() const override { return report_; }

 private:
  enum class Stage : uint8_t { kIdle, kHomography, kHypotheses };

  Progress give_up();
  void constrain(const FrameInput& frame, const Matrix3f& R_cp, float dt_s, bool sharp);
  Progress compare(const FrameInput& frame, float dt_s);
  void renew_first_view(const FrameInput& frame, const Vector3f& rotation_rate);
  float planar_margin(const Decomposition& decomposition);
  float general_margin(const Decomposition& decomposition);
  void seek_relative_pose(const Decomposition& decomposition, std::span<const Correspondence> correspondences);
  float median_depth_sigma(std::span<const Correspondence> correspondences);
  bool usable(const Hypothesis& hypothesis, int point) const;
  bool add_views(const Hypothesis& hypothesis, Map& map);
  bool add_points(const Hypothesis& hypothesis, Map& map);

  const Config& config_;
  WorkMeter& meter_;
  HomographyTracker tracker_;
  ViewRecorder recorder_;
  StartHypotheses hypotheses_;
  FixedVector<float> values_;  // of which a median is sought
  Report report_;

  Stage stage_ = Stage::kIdle;
  int64_t previous_ns_ = 0;
  int64_t start_ns_ = 0;
  int64_t branch_ns_ = 0;  // when stage 2 began
  int frames_ = 0;         // tracked well in this stage
  int bad_frames_ = 0;     // in a row
  float known_ = 0;        // information about the motion, summed over the frames; 1: known as well as it must be
  RelativePose relative_;  // general motion, refined from frame to frame; ok: may be used as a start
  int next_start_ = 0;     // which start is tried next, besides
};

}  // namespace pptam
