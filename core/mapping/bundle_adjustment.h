// Bundle adjustment of keyframes and points [ptam 6.3, phone 3], in slices: copies the map into the engine and accepted
// steps back into the map.
//
// The engine (mapping/bundle_engine.h) works on a snapshot. Accepted steps are committed as a whole, so that the
// tracker never sees a half-updated map. Adjustment stops between steps when a new keyframe waits. A step that fails
// changes nothing.
//
// Rolling shutter: a measurement is predicted at its own line's time with the keyframe's velocity. Beyond [phone 6] the
// velocities may be unknowns too, with a prior from the tracker: a free velocity takes a column of its own. They are
// while a map begins; later they are estimated between adjustments.
#pragma once

#include "map/map.h"
#include "map/patch_search.h"
#include "mapping/bundle_engine.h"
#include "scheduler/task.h"

namespace pptam {

// Free keyframes up to which velocities may be unknowns too: twice the columns cost four to eight times as much.
// Counted, in million instructions an iteration: 7.7 against 35.4 with 35 keyframes and 300 points; 8.8 with 16
// keyframes, 150 points and velocities. In a finished map they gain nothing over ones estimated between adjustments
// (tests/MEASURED.md).
constexpr int kMaxVelocityCameras = 16;

struct BundleResult {
  bool converged = false;  // otherwise interrupted, or out of iterations
  int iterations = 0;      // accepted steps
  float initial_cost = 0;  // Tukey cost before the first step, at the scale estimated there
  float final_cost = 0;    // Tukey cost after the last step, at the scale of that step
  float sigma = 0;         // robust scale at the end, units of the measurements' sigma
};

class BundleAdjuster {
 public:
  BundleAdjuster(Arena& arena, const Config& config, Map& map, WorkMeter& meter, Background& background);

  // newest = -1: adjusts all live keyframes with enough measurements but the first, whose pose is the datum. Otherwise:
  // adjusts `newest` and the four keyframes nearest to it, with the others fixed [ptam 6.3]. With `velocities`, the
  // velocities of up to kMaxVelocityCameras free keyframes too. After convergence measurements of zero weight are
  // searched again or removed, and points with fewer than two measurements are removed. Erased keyframes follow every
  // step. A coroutine of `background`. result() may be read when it has ended.
  Task<> run(int newest, bool velocities, int max_iterations);
  const BundleResult& result() const { return result_; }

  FrameStack& frames() { return background_.frames(); }

 private:
  struct Projection {
    const CameraModel* camera;
    bool project(int, const Vector3f& p_c, Vector2f* px) const { return camera->project(p_c, px); }
    bool project(int, const Vector3f& p_c, Vector2f* px, Matrix23f* J) const { return camera->project(p_c, px, J); }
  };
  using Engine = BundleEngine<float, Projection>;

  Task<> gather(int newest, bool velocities);
  Task<> count_measurements();
  Task<> free_cameras(int newest, bool velocities);
  Task<> discard_outliers();
  bool measure_again(const MapPoint& point, Measurement* measurement);
  void commit();
  void hold_initial_scale();
  void note_scale();
  void restore_scale();

  const Config& config_;
  Map& map_;
  WorkMeter& meter_;
  Background& background_;
  PatchFinder finder_;
  Engine engine_;
  FixedVector<int32_t> measured_;       // number of each keyframe's measurements
  FixedVector<int32_t> point_indices_;  // of each of the engine's points: its index in Map::points()
  FixedVector<float> ratios_;           // scratch: of each settled point, its distance after and before
  float scale_ = 1;                     // of a finished map, relative to when the adjustment began
  BundleResult result_;
};

}  // namespace pptam
