// Camera pose from rows of residuals, rolling shutter included [ptam 5.4; phone 4].
//
// Minimises the Tukey-weighted residuals over the pose T_cw at the frame's timestamp and, with a rolling shutter, over
// the camera's velocity during the readout, which has a prior from the motion model. For a map point measured at m_i
// the residual is
//   e_i = (m_i - project(exp(dt(m_i) velocity) T_cw p_i)) / sigma_i.
// At most eleven reweighted Gauss-Newton iterations; the scale is re-estimated in each from the median. Rows are
// linearised in three of them and followed by their Jacobians in the others.
//
// Where rows come from is the caller's business (PoseRows): the tracker's attempts, a keyframe's measurements.
#pragma once

#include <span>

#include <pocket_ptam/camera.h>
#include <pocket_ptam/work_meter.h>
#include "base/containers.h"
#include "geometry/normal_equations.h"

namespace pptam {

// A residual at a pose, of two components or one (the second is zero then), divided by its expected sigma.
struct PoseRow {
  float J[2][6];       // d(prediction)/d(mu) for T_cw <- exp(mu) T_cw; by the velocity it is dt_s * J
  float e[2];          // measured minus predicted; followed between linearisations
  float e_0[2];        // the same, at the last linearisation
  float dt_s;          // of its line
  float depth;         // world units; 0: not to be counted in the scene's mean
  float weight = 0;    // result: final Tukey weight, 0 for outliers
  float error_sq = 0;  // result: |e|^2
  uint8_t components;  // 2 or 1; 0: it could not be predicted

  // Of map point p_w found at `found`; no components when it does not project.
  void set_point(const Camera& camera, const SE3& T_cw, const Vector6f& velocity, const Vector3f& p_w,
                 const ImagePoint& found);
};

// What holds a pose.
class PoseRows {
 public:
  virtual int count() const = 0;
  // Fills J, e_0, dt_s, depth and components of count() rows, always the same residuals in the same order.
  virtual void linearise(const SE3& T_cw, const Vector6f& velocity, std::span<PoseRow> rows) const = 0;

 protected:
  ~PoseRows() = default;
};

struct PosePoint {
  Vector3f p_w = Vector3f::Zero();
  ImagePoint found;
};

class PosePoints final : public PoseRows {
 public:
  PosePoints(const Camera& camera, std::span<const PosePoint> points) : camera_(camera), points_(points) {}
  int count() const override { return static_cast<int>(points_.size()); }
  void linearise(const SE3& T_cw, const Vector6f& velocity, std::span<PoseRow> rows) const override {
    for (size_t i = 0; i < rows.size(); ++i)
      rows[i].set_point(camera_, T_cw, velocity, points_[i].p_w, points_[i].found);
  }

 private:
  const Camera& camera_;
  std::span<const PosePoint> points_;
};

// How far the velocity during a readout may be from what the motion to the neighbouring frames says, 1-sigma of each
// component for a calm hand: tremor of 0.04 degrees and 0.1 mm at 10 Hz turns at about 0.015 radians/s rms. Emulated,
// 0.02 of both, five runs each: error of the path 0.095 % on desks, 0.118 boxes, 0.287 walls; half of the rotation's
// 0.095, 0.137, 0.313; four times as much 0.120, 0.140, 0.366.
constexpr float kVelocitySigmaRotation = 0.02f;      // radians/s
constexpr float kVelocitySigmaTranslation = 0.015f;  // mean scene depths/s

// The velocity expected at the pose exp(mu) T_start is mean + rate_per_s * mu: who has moved further was faster.
struct VelocityPrior {
  Vector6f mean = Vector6f::Zero();  // translation (world units/s), rotation (radians/s)
  float rate_per_s = 0;              // 0: independent of the pose
  float sigma_translation = 0;       // 1-sigma of each component; 0: velocity is fixed to the mean
  float sigma_rotation = 0;
};

struct PoseUpdate {
  SE3 T_cw;
  Vector6f velocity = Vector6f::Zero();
  Matrix6f covariance = Matrix6f::Zero();  // of mu in T_cw <- exp(mu) T_cw, velocity marginalised
  // Robust scale: 1-sigma of a component, in units of the rows' sigma; of rows of two components if there are any.
  float sigma = 0;
  float cost = 0;   // sum of Tukey costs at that scale
  int inliers = 0;  // rows of non-zero weight
  bool ok = false;  // at least 6 inliers and a well-conditioned system; otherwise T_cw is the start
};

// In one go:
//
//   const PoseUpdate& pose = updater.run(T_start, prior, rows);
//
// or in pieces, parts of an iteration, for background jobs that pause in between:
//
//   updater.start(T_start, prior, rows);
//   while (!updater.advance()) co_await slice();
//   use(updater.result());
//
// `rows` must stay where it is until then. The robust scale is at least kRobustSigmaFloor: a handful of perfect points
// does not reject all others. Rows of one and of two components have a scale each.
class PoseUpdater {
 public:
  // Rows beyond max_rows are left out. 84 bytes of the arena each.
  PoseUpdater(Arena& arena, int max_rows, bool rolling_shutter, WorkMeter& meter);

  void start(const SE3& T_start, const VelocityPrior& prior, const PoseRows& rows);
  bool advance();  // true at the end
  const PoseUpdate& result() const { return result_; }
  std::span<const PoseRow> rows() const { return rows_; }  // as they were last weighted

  const PoseUpdate& run(const SE3& T_start, const VelocityPrior& prior, const PoseRows& rows) {
    start(T_start, prior, rows);
    while (!advance()) {
    }
    return result_;
  }

 private:
  friend class RobustFit<PoseUpdater>;
  static constexpr int kUnknowns = 12;  // the velocity comes first, then the pose; or the pose alone
  // Sums over the rows of w J^T J and w J^T e, upper triangles row by row, with the factors 1, dt and dt^2.
  struct Sums {
    float A[21], A_dt[21], A_dt2[21];
    float b[6], b_dt[6];
    void add(const PoseRow& row, float weight);
  };
  // What RobustFit asks for.
  bool errors(int iteration);
  void scale();
  int residuals() const { return rows_.size(); }
  void sum(int from, int to);
  FitStep step(int iteration);

  bool linearise();
  void follow();
  void fill_equations(int unknowns);
  void finish(int unknowns);
  float sigma_of(int components);

  WorkMeter& meter_;
  const bool rolling_shutter_;
  const PoseRows* source_ = nullptr;
  FixedVector<PoseRow> rows_;
  FixedVector<float> squared_;  // of the errors, for their median
  SE3 T_start_;
  VelocityPrior prior_;
  bool velocity_free_ = false;

  RobustFit<PoseUpdater> fit_;
  NormalEquations<kUnknowns> equations_;
  bool full_ = false;       // this iteration's errors are exact
  bool confirm_ = false;    // the last step was small, but taken from errors that are not
  float scalar_sigma_ = 0;  // as PoseUpdate::sigma, of rows of one component
  float mean_depth_ = 1;
  SE3 T_;                   // at the last linearisation
  Vector6f velocity_;       // at the last linearisation
  Vector6f pose_step_;      // since the last linearisation
  Vector6f velocity_step_;  // since the last linearisation
  Vector6f moved_;          // all steps since T_start, to first order
  Sums sums_;
  PoseUpdate result_;
};

}  // namespace pptam
