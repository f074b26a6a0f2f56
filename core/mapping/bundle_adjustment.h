// Bundle adjustment of keyframes and points [ptam 6.3, phone 3], in slices.
//
// Levenberg-Marquardt on Tukey-weighted reprojection errors, Schur complement onto the cameras, dense blocked Cholesky
// of our own in fixed order. N points, M keyframes, T measurements a point: O(NT) projections, O(NT^2) outer products,
// O(M^3) solve. Works on its own snapshot and commits whole accepted steps, so that the tracker never sees a
// half-updated map; stops between steps when a new keyframe waits.
//
// Rolling shutter: a measurement is predicted at its own line's time, p_c = q + dt (v + w x q), q = T p, with the
// keyframe's velocity (v, w). Beyond [phone 6] the velocities may be unknowns too, with a prior from the tracker: the
// camera blocks then have 12 rows in place of 6.
#pragma once

#include "base/containers.h"
#include "map/map.h"
#include "scheduler/task.h"

namespace pptam {

// With more free keyframes than this, velocities are held: blocks of 12 rows cost four to eight times as much.
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

  // Adjusts all keyframes but the first's pose (newest = -1), or the newest and its four nearest with the others fixed
  // [ptam 6.3]; their velocities too if asked for. Afterwards removes measurements of zero weight and points left with
  // fewer than two. A coroutine of `background`. result may be read when it has ended.
  Task run(int newest, bool velocities, int max_iterations);
  const BundleResult& result() const { return result_; }

  FrameStack& frames() { return background_.frames(); }

 private:
  struct Camera {
    SE3 T, T_new;
    Vector6f velocity = Vector6f::Zero(), velocity_new = Vector6f::Zero(), velocity_prior = Vector6f::Zero();
    int column = -1;         // among the free cameras; -1: fixed
    bool pose_free = false;  // the first keyframe's pose is the datum; its velocity may be free all the same
    float depth = 1;
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
    int16_t camera = 0;       // keyframe index
    int16_t measurement = 0;  // index in the point's list
    Vector2f px = Vector2f::Zero();
    float dt_s = 0;  // of its line
    float inv_sigma = 1;
    float weight = 0;
    float error_sq = 0;
    Vector2f e = Vector2f::Zero();
    Matrix26f A = Matrix26f::Zero();    // d(px)/d(pose) / sigma
    Matrix26f A_v = Matrix26f::Zero();  // d(px)/d(velocity) / sigma
    Matrix23f B = Matrix23f::Zero();    // d(px)/d(point) / sigma
  };

  Task gather(int newest);
  template <int N>
  Task iterate(int max_iterations);
  Task linearise();
  template <int N>
  Task build_reduced_system(float lambda);
  template <int N>
  Task solve_reduced_system();
  template <int N>
  Task evaluate_step();
  Task discard_outliers();
  void commit();
  void hold_scale();
  float prior_cost(const Camera& camera, const Vector6f& velocity) const;
  Vector6f prior_information(const Camera& camera) const;
  // Lower triangle of NxN blocks, row by row; i >= j.
  template <int N>
  Eigen::Map<Eigen::Matrix<float, N, N>> block(int i, int j) {
    return Eigen::Map<Eigen::Matrix<float, N, N>>(S_.data() + (i * (i + 1) / 2 + j) * N * N);
  }
  template <int N>
  Eigen::Map<Eigen::Matrix<float, N, 1>> rhs(int i) {
    return Eigen::Map<Eigen::Matrix<float, N, 1>>(rhs_.data() + i * N);
  }

  const Config& config_;
  Map& map_;
  WorkMeter& meter_;
  Background& background_;
  FixedVector<Camera> cameras_;  // one per keyframe
  FixedVector<Point> points_;
  FixedVector<Observation> observations_;
  FixedVector<float> S_;
  FixedVector<float> rhs_;
  FixedVector<float> squared_;
  int free_cameras_ = 0;
  float sigma_ = 1;
  float lambda_ = 0;
  float cost_ = 0, new_cost_ = 0;
  bool solved_ = false;
  bool with_velocities_ = false;
  BundleResult result_;
};

}  // namespace pptam
