// Bundle adjustment of keyframes and points [ptam 6.3, phone 3], in slices.
//
// Levenberg-Marquardt on Tukey-weighted reprojection errors, Schur complement onto the cameras, dense blocked Cholesky
// of our own in fixed order. N points, M keyframes, T measurements a point: O(NT) projections, O(NT^2) outer products,
// O(M^3) solve. Works on its own snapshot and commits whole accepted steps, so that the tracker never sees a
// half-updated map; stops between steps when a new keyframe waits. Measurements are corrected for the rolling shutter
// with the keyframes' velocities when the snapshot is taken [phone 6].
#pragma once

#include "base/containers.h"
#include "map/map.h"
#include "scheduler/task.h"

namespace pptam {

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

  // Adjusts all keyframes but the first (newest = -1), or the newest and its four nearest with the others fixed
  // [ptam 6.3]. Afterwards removes measurements of zero weight and points left with fewer than two. A coroutine of
  // `background`. result may be read when it has ended.
  Task run(int newest, int max_iterations);
  const BundleResult& result() const { return result_; }

  FrameStack& frames() { return background_.frames(); }

 private:
  struct Camera {
    SE3 T, T_new;
    int column = -1;  // among the free cameras; -1: fixed
    Matrix6f U = Matrix6f::Zero();
    Vector6f ea = Vector6f::Zero();
    Vector6f step = Vector6f::Zero();
  };
  struct Point {
    int32_t index = 0;  // in Map::points
    int32_t first = 0;  // observations [first, first + count)
    int32_t count = 0;
    Vector3f p = Vector3f::Zero(), p_new = Vector3f::Zero();
    Matrix3f V = Matrix3f::Zero();
    Vector3f eb = Vector3f::Zero();
  };
  struct Observation {
    int16_t camera = 0;              // keyframe index
    int16_t measurement = 0;         // index in the point's list
    Vector2f px = Vector2f::Zero();  // corrected
    float inv_sigma = 1;
    float weight = 0;
    float error_sq = 0;
    Vector2f e = Vector2f::Zero();
    Matrix26f A = Matrix26f::Zero();
    Matrix23f B = Matrix23f::Zero();
  };

  Task gather(int newest);
  Task linearise();
  Task build_reduced_system(float lambda);
  Task solve_reduced_system();
  Task evaluate_step();
  Task discard_outliers();
  void commit();
  Matrix6f& block(int i, int j) { return S_[i * (i + 1) / 2 + j]; }  // i >= j

  const Config& config_;
  Map& map_;
  WorkMeter& meter_;
  Background& background_;
  FixedVector<Camera> cameras_;  // one per keyframe
  FixedVector<Point> points_;
  FixedVector<Observation> observations_;
  FixedVector<Matrix6f> S_;  // lower triangle of blocks, row by row
  FixedVector<Vector6f> rhs_;
  FixedVector<float> squared_;
  int free_cameras_ = 0;
  float sigma_ = 1;
  float lambda_ = 0;
  float cost_ = 0, new_cost_ = 0;
  bool solved_ = false;
  BundleResult result_;
};

}  // namespace pptam
