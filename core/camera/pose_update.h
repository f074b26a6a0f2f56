// Camera pose from rows of residuals, rolling shutter included [ptam 5.4; phone 4].
//
// Minimises the Tukey-weighted residuals over the pose T_cw at the frame's timestamp and, with a rolling shutter, over
// the camera's velocity during the readout, which has a prior from the motion model. For a map point measured at m_i
// the residual is
//   e_i = (m_i - project(exp(dt(m_i) velocity) T_cw p_i)) / sigma_i.
// At most eleven reweighted Gauss-Newton iterations. Each estimates the scale anew, from the median. Rows are
// linearised in three of them; in the others their residuals are extrapolated by their Jacobians.
//
// The caller provides the rows (PoseRows): the tracker its measurements of a frame, the mapper those of a keyframe.
#pragma once

#include <cmath>
#include <span>

#include <pocket_ptam/camera.h>
#include <pocket_ptam/work_meter.h>
#include "base/containers.h"
#include "geometry/normal_equations.h"

namespace pptam {

// A residual at a pose, divided by its expected sigma. It has two components, or one (the second is zero).
struct PoseRow {
  float J[2][6];       // d(prediction)/d(mu) for T_cw <- exp(mu) T_cw; d(prediction)/d(velocity) is dt_s * J
  float e[2];          // measured minus predicted, in sigmas, at the present estimate
  float e_0[2];        // measured minus predicted, in sigmas, at the last linearisation
  float dt_s;          // exposure time of its line relative to the frame's timestamp
  float depth;         // world units; 0: left out of the scene's mean depth
  float weight = 0;    // result: final Tukey weight, 0 for outliers
  float error_sq = 0;  // result: |e|^2
  uint8_t components;  // 2 or 1; 0: it could not be predicted

  // Fills the row of map point p_w (world units) measured at `found`. components is 0 when the point does not project.
  void set_point(const Camera& camera, const SE3& T_cw, const Vector6f& velocity, const Vector3f& p_w,
                 const ImagePoint& found);
};

// Source of the residuals that determine a pose.
class PoseRows {
 public:
  virtual int count() const = 0;  // number of rows
  // Fills J, e_0, dt_s, depth and components of the first rows.size() rows. The order of residuals never changes.
  virtual void linearise(const SE3& T_cw, const Vector6f& velocity, std::span<PoseRow> rows) const = 0;

 protected:
  ~PoseRows() = default;
};

// A map point and its measurement.
struct PosePoint {
  Vector3f p_w = Vector3f::Zero();
  ImagePoint found;
};

// Rows of map points.
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

// Prior 1-sigma of each component of the velocity during a readout, about the mean velocity to the neighbouring frames,
// for a calm hand: tremor of 0.04 degrees and 0.1 mm at 10 Hz turns at about 0.015 radians/s rms. Emulated, five runs
// each, error of the path on desks, boxes and walls: 0.095, 0.118, 0.287 % with a rotation sigma of 0.02; 0.095, 0.137,
// 0.313 with half of it; 0.120, 0.140, 0.366 with four times as much. The translation's was not swept on its own.
constexpr float kVelocitySigmaRotation = 0.02f;      // radians/s
constexpr float kVelocitySigmaTranslation = 0.015f;  // mean scene depths/s

// Gaussian prior of the velocity during the readout. Its mean at the pose exp(mu) T_start is mean + rate_per_s * mu: a
// pose that lies farther from the last frame's implies a faster motion.
struct VelocityPrior {
  Vector6f mean = Vector6f::Zero();  // translation (world units/s), rotation (radians/s)
  float rate_per_s = 0;              // 1 / frame interval; 0: independent of the pose
  float sigma_translation = 0;       // 1-sigma of each component, world units/s
  float sigma_rotation = 0;          // 1-sigma of each component, radians/s; 0: the velocity is fixed to the mean
};

struct PoseUpdate {
  SE3 T_cw;
  Vector6f velocity = Vector6f::Zero();
  Matrix6f covariance = Matrix6f::Zero();  // of mu in T_cw <- exp(mu) T_cw, velocity marginalised
  // Robust scale: 1-sigma of a component, in units of the rows' sigma. That of the rows of two components if there are
  // any, else that of the rows of one.
  float sigma = 0;
  float cost = 0;        // sum of Tukey costs at scale sigma
  int inliers = 0;       // rows of non-zero weight
  float mean_depth = 1;  // of the rows' points, world units
  // 1-sigma of the camera's centre by the covariance, its three components together, in mean depths.
  float position_sigma() const { return std::sqrt(covariance.topLeftCorner<3, 3>().trace()) / mean_depth; }
  bool ok = false;  // at least 6 inliers and a well-conditioned system; otherwise T_cw is T_start
};

// Computes a PoseUpdate. In one call:
//
//   const PoseUpdate& pose = updater.run(T_start, prior, rows);
//
// or in pieces (parts of an iteration), for background jobs that pause in between:
//
//   updater.start(T_start, prior, rows);
//   while (!updater.advance()) co_await slice();
//   use(updater.result());
//
// `rows` must stay alive until the end. Rows of one and of two components have a robust scale each, which is at least
// kRobustSigmaFloor.
class PoseUpdater {
 public:
  // Rows beyond max_rows are left out. Each takes 84 bytes of the arena.
  PoseUpdater(Arena& arena, int max_rows, bool rolling_shutter, WorkMeter& meter);

  void start(const SE3& T_start, const VelocityPrior& prior, const PoseRows& rows);
  bool advance();  // does the next piece; true at the end
  const PoseUpdate& result() const { return result_; }
  std::span<const PoseRow> rows() const { return rows_; }  // with the weights of the last iteration

  const PoseUpdate& run(const SE3& T_start, const VelocityPrior& prior, const PoseRows& rows) {
    start(T_start, prior, rows);
    while (!advance()) {
    }
    return result_;
  }

 private:
  friend class RobustFit<PoseUpdater>;
  static constexpr int kUnknowns = 12;  // at most: velocity, then pose. Without a rolling shutter the pose alone
  // Sums over the rows of w J^T J (upper triangle, row by row) and w J^T e, with factors 1, dt and dt^2.
  struct Sums {
    float A[21], A_dt[21], A_dt2[21];
    float b[6], b_dt[6];
    void add(const PoseRow& row, float weight);
  };
  // Interface for RobustFit.
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
  FixedVector<float> squared_;  // squared errors, for their median
  SE3 T_start_;
  VelocityPrior prior_;
  bool velocity_free_ = false;

  RobustFit<PoseUpdater> fit_;
  NormalEquations<kUnknowns> equations_;
  bool full_ = false;       // whether this iteration linearised the rows, so that its errors are exact
  bool confirm_ = false;    // linearise next: the last step was small, but came from extrapolated errors
  float scalar_sigma_ = 0;  // robust scale of the rows of one component, in units of their sigma
  float mean_depth_ = 1;    // of the rows' points, world units
  SE3 T_;                   // pose at the last linearisation
  Vector6f velocity_;       // at the last linearisation
  Vector6f pose_step_;      // since the last linearisation
  Vector6f velocity_step_;  // since the last linearisation
  Vector6f moved_;          // all steps since T_start, to first order
  Sums sums_;
  PoseUpdate result_;
};

}  // namespace pptam
