// Bundle adjustment of keyframes and points [ptam 6.3, phone 3], in slices: what the engine gets from the map, and what
// goes back.
//
// The engine (mapping/bundle_engine.h) works on a snapshot; whole accepted steps are committed, so that the tracker
// never sees a half-updated map. It stops between steps when a new keyframe waits. A step that fails leaves everything
// as it was.
//
// Rolling shutter: a measurement is predicted at its own line's time with the keyframe's velocity. Beyond [phone 6] the
// velocities may be unknowns too, with a prior from the tracker: each then takes a column beside that of its pose.
#pragma once

#include "map/map.h"
#include "map/patch_search.h"
#include "mapping/bundle_engine.h"
#include "scheduler/task.h"

namespace pptam {

// With more free keyframes than this, velocities are held: twice the columns cost four to eight times as much.
constexpr int kMaxVelocityCameras = 16;

struct BundleResult {
  bool converged = false;  // otherwise interrupted, or out of iterations
  int iterations = 0;      // accepted steps
  float initial_cost = 0;  // Tukey, at the scale of each end
  float final_cost = 0;
  float sigma = 0;  // robust scale at the end, units of the measurements' sigma
};

class BundleAdjuster {
 public:
  BundleAdjuster(Arena& arena, const Config& config, Map& map, WorkMeter& meter, Background& background);

  // Adjusts all live keyframes but the first's pose (newest = -1), or the newest and its four nearest with the others
  // fixed [ptam 6.3]; their velocities too if asked for. Afterwards measurements of zero weight are searched again, and
  // those not found removed, with points left with fewer than two. Erased keyframes follow every step. A coroutine of
  // `background`. result may be read when it has ended.
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
  Task<> free_cameras(int newest, bool velocities);
  Task<> discard_outliers();
  bool measure_again(const MapPoint& point, Measurement* measurement);
  void commit();
  void hold_scale(const SE3& T_last);

  const Config& config_;
  Map& map_;
  WorkMeter& meter_;
  Background& background_;
  PatchFinder finder_;
  Engine engine_;
  FixedVector<int32_t> point_indices_;  // of the engine's points, in Map::points
  BundleResult result_;
};

}  // namespace pptam
