#include "camera/pose_update.h"

#include <algorithm>
#include <cmath>

#include "base/sse2.h"
#include "geometry/robust.h"

namespace pptam {

namespace {

// Number of the last iteration, counted from 0 [ptam 5.4: ten iterations].
constexpr int kIterations = 10;
// Iterations with full projections, after [ptam 6.5: every fourth]. Between them the errors follow their Jacobians.
constexpr int kRelinearised[] = {0, 4, 9};
constexpr int kMinInliers = 6;  // rows: 12 equations of map points for the pose's 6 unknowns; not swept
// Squared steps, in radians and mean scene depths.
constexpr float kConvergedSq = 1e-9f;  // 0.011 px on the phone
// All steps since the last linearisation together up to which its errors are exact: the square that they leave out is
// 0.004 px on the phone.
constexpr float kLinearSq = 1e-5f;
constexpr float kMaxStepSq = 0.5f;      // 40 degrees or 0.7 depths: longer steps come from wrong matches. Not swept
constexpr float kMinPosePivot = 1e-5f;  // ratio (NormalEquations), a hundred times float32's rounding; not swept

constexpr float kUnseen = 1e12f;  // squared error (sigma^2) of a row that cannot be predicted: beyond every cut-off

constexpr int kPose = 6;  // unknowns
// ARMv6 of a step besides its rows: equations and their solution, with the velocity among the unknowns as counted and
// without it estimated; and of the covariance at the end.
constexpr int64_t kStepInstructions = 6400, kPoseStepInstructions = 2000, kFinishInstructions = 3700;
constexpr int kSummedAtOnce = 64;  // rows in one piece: 45,000 instructions (Work::kPosePoint), well under a slice

}  // namespace

void PoseRow::set_point(const Camera& camera, const SE3& T_cw, const Vector6f& velocity, const Vector3f& p_w,
                        const ImagePoint& found) {
  dt_s = camera.dt_s(found.px);
  const Vector3f p = moved_point(T_cw * p_w, velocity, dt_s);
  Vector2f px;
  Matrix23f J_px_p;
  components = camera.project(p, &px, &J_px_p) ? 2 : 0;
  if (components == 0) return;
  const float scale = 1 / found.sigma();
  for (int k = 0; k < 2; ++k) {
    const float x = scale * J_px_p(k, 0), y = scale * J_px_p(k, 1), z = scale * J_px_p(k, 2);
    J[k][0] = x;
    J[k][1] = y;
    J[k][2] = z;
    J[k][3] = p.y() * z - p.z() * y;  // of the rotation: p x (x, y, z)
    J[k][4] = p.z() * x - p.x() * z;
    J[k][5] = p.x() * y - p.y() * x;
    e_0[k] = scale * (found.px[k] - px[k]);
  }
  depth = p.z();
}

#if defined(PPTAM_SSE2)
// Four elements of the upper triangle at a time, across its rows. The bits are those of the plain form below.
void PoseUpdater::Sums::add(const PoseRow& row, float weight) {
  const __m128 w = _mm_set1_ps(weight), dt = _mm_set1_ps(row.dt_s);
  const __m128 J0123[2] = {_mm_loadu_ps(row.J[0]), _mm_loadu_ps(row.J[1])};
  const __m128 J2345[2] = {_mm_loadu_ps(row.J[0] + 2), _mm_loadu_ps(row.J[1] + 2)};
  const __m128 x0123[2] = {_mm_mul_ps(w, J0123[0]), _mm_mul_ps(w, J0123[1])};
  const __m128 x2345[2] = {_mm_mul_ps(w, J2345[0]), _mm_mul_ps(w, J2345[1])};
  const auto add_to = [](float* sum, __m128 v) { _mm_storeu_ps(sum, _mm_add_ps(_mm_loadu_ps(sum), v)); };
  const auto add_four = [&](int k, __m128 x, __m128 y, __m128 J_x, __m128 J_y) {
    const __m128 p = _mm_add_ps(_mm_mul_ps(x, J_x), _mm_mul_ps(y, J_y)), p_dt = _mm_mul_ps(dt, p);
    add_to(A + k, p);
    add_to(A_dt + k, p_dt);
    add_to(A_dt2 + k, _mm_mul_ps(dt, p_dt));
  };
#define PPTAM_ADD_FOUR(k, x_from, x_to, x_order, J_from, J_to, J_order)                                         \
  add_four(k, _mm_shuffle_ps((x_from)[0], (x_to)[0], x_order), _mm_shuffle_ps((x_from)[1], (x_to)[1], x_order), \
           _mm_shuffle_ps((J_from)[0], (J_to)[0], J_order), _mm_shuffle_ps((J_from)[1], (J_to)[1], J_order))
  PPTAM_ADD_FOUR(0, x0123, x0123, _MM_SHUFFLE(0, 0, 0, 0), J0123, J0123, _MM_SHUFFLE(3, 2, 1, 0));   // 00 01 02 03
  PPTAM_ADD_FOUR(4, x0123, x0123, _MM_SHUFFLE(1, 1, 0, 0), J2345, J0123, _MM_SHUFFLE(2, 1, 3, 2));   // 04 05 11 12
  PPTAM_ADD_FOUR(8, x0123, x0123, _MM_SHUFFLE(2, 1, 1, 1), J2345, J2345, _MM_SHUFFLE(0, 3, 2, 1));   // 13 14 15 22
  PPTAM_ADD_FOUR(12, x0123, x0123, _MM_SHUFFLE(3, 2, 2, 2), J2345, J2345, _MM_SHUFFLE(1, 3, 2, 1));  // 23 24 25 33
  PPTAM_ADD_FOUR(16, x0123, x2345, _MM_SHUFFLE(2, 2, 3, 3), J2345, J2345, _MM_SHUFFLE(3, 2, 3, 2));  // 34 35 44 45
#undef PPTAM_ADD_FOUR
  const float p = weight * row.J[0][5] * row.J[0][5] + weight * row.J[1][5] * row.J[1][5], p_dt = row.dt_s * p;
  A[20] += p;
  A_dt[20] += p_dt;
  A_dt2[20] += row.dt_s * p_dt;
  const __m128 q = _mm_add_ps(_mm_mul_ps(x0123[0], _mm_set1_ps(row.e[0])), _mm_mul_ps(x0123[1], _mm_set1_ps(row.e[1])));
  add_to(b, q);
  add_to(b_dt, _mm_mul_ps(dt, q));
  for (int i = 4; i < 6; ++i) {
    const float q_i = weight * row.J[0][i] * row.e[0] + weight * row.J[1][i] * row.e[1];
    b[i] += q_i;
    b_dt[i] += row.dt_s * q_i;
  }
}
#else
void PoseUpdater::Sums::add(const PoseRow& row, float weight) {
  const float dt = row.dt_s;
  float* a = A;
  float* a_dt = A_dt;
  float* a_dt2 = A_dt2;
  for (int i = 0; i < 6; ++i) {
    const float x = weight * row.J[0][i], y = weight * row.J[1][i];
    for (int j = i; j < 6; ++j) {
      const float p = x * row.J[0][j] + y * row.J[1][j];
      const float p_dt = dt * p;
      *a++ += p;
      *a_dt++ += p_dt;
      *a_dt2++ += dt * p_dt;
    }
    const float q = x * row.e[0] + y * row.e[1];
    b[i] += q;
    b_dt[i] += dt * q;
  }
}
#endif

PoseUpdater::PoseUpdater(Arena& arena, int max_rows, bool rolling_shutter, WorkMeter& meter)
    : meter_(meter), rolling_shutter_(rolling_shutter), rows_(arena, max_rows), squared_(arena, max_rows) {}

void PoseUpdater::start(const SE3& T_start, const VelocityPrior& prior, const PoseRows& rows) {
  source_ = &rows;
  rows_.resize(std::min(rows.count(), rows_.capacity()));
  T_start_ = T_ = T_start;
  prior_ = prior;
  velocity_ = prior.mean;
  velocity_free_ = rolling_shutter_ && prior.sigma_rotation > 0;
  pose_step_.setZero();
  velocity_step_.setZero();
  moved_.setZero();
  mean_depth_ = 1;
  confirm_ = false;
  result_ = PoseUpdate();
  result_.T_cw = T_start;
  result_.velocity = prior.mean;
  for (PoseRow& row : rows_) row.weight = row.error_sq = 0;
  fit_.start(kSummedAtOnce);
  if (rows_.size() < kMinInliers) fit_.give_up();
}

bool PoseUpdater::advance() {
  return fit_.advance(*this);
}

bool PoseUpdater::errors(int iteration) {
  full_ =
      confirm_ || std::find(std::begin(kRelinearised), std::end(kRelinearised), iteration) != std::end(kRelinearised);
  if (full_) return linearise();
  follow();
  return true;
}

bool PoseUpdater::linearise() {
  meter_.charge(Work::kPoseProjection, rows_.size());
  T_ = SE3::exp(pose_step_) * T_;
  velocity_ += velocity_step_;
  pose_step_.setZero();
  velocity_step_.setZero();
  source_->linearise(T_, velocity_, rows_);
  float depth_sum = 0;
  int valid = 0, deep = 0;
  for (PoseRow& row : rows_) {
    if (row.components == 0) {
      row.error_sq = kUnseen;
      row.weight = 0;
      continue;
    }
    row.e[0] = row.e_0[0];
    row.e[1] = row.e_0[1];
    ++valid;
    depth_sum += row.depth;
    deep += row.depth > 0;
  }
  if (deep > 0) mean_depth_ = depth_sum / static_cast<float>(deep);
  return valid >= kMinInliers;
}

void PoseUpdater::follow() {
  const Vector6f pose_step = pose_step_, velocity_step = velocity_step_;
  for (PoseRow& row : rows_) {
    if (row.components == 0) continue;
    for (int k = 0; k < 2; ++k) {
      float e = row.e_0[k];
      for (int c = 0; c < 6; ++c) e -= row.J[k][c] * (pose_step[c] + row.dt_s * velocity_step[c]);
      row.e[k] = e;
    }
  }
}

// Robust sigma of the rows that have this number of components; 0 when there are none.
float PoseUpdater::sigma_of(int components) {
  squared_.clear();
  for (PoseRow& row : rows_) {
    if (row.components != components) continue;
    row.error_sq = row.e[0] * row.e[0] + row.e[1] * row.e[1];
    squared_.push_back(row.error_sq);
  }
  if (squared_.empty()) return 0;
  return std::max(components == 2 ? robust_sigma(squared_) : robust_sigma_1d(squared_), kRobustSigmaFloor);
}

void PoseUpdater::scale() {
  const float sigma = sigma_of(2);
  const int points = squared_.size();
  scalar_sigma_ = sigma_of(1);
  const int unseen = rows_.size() - points - squared_.size();
  result_.sigma = points > 0 ? sigma : scalar_sigma_;
  sums_ = Sums();
  result_.inliers = 0;
  result_.cost = Tukey(result_.sigma).saturated() * static_cast<float>(unseen);
}

void PoseUpdater::sum(int from, int to) {
  meter_.charge(Work::kPosePoint, to - from);
  const Tukey tukey(result_.sigma), scalar(scalar_sigma_, kTukeyCutoff1d);
  // Cost and sums are in units of result_.sigma^2: rows of one component are scaled by ratio^2.
  const float ratio = scalar_sigma_ > 0 ? result_.sigma / scalar_sigma_ : 0;
  for (int i = from; i < to; ++i) {
    PoseRow& row = rows_[i];
    if (row.components == 0) continue;
    const bool one = row.components == 1;
    row.weight = one ? scalar.weight(row.error_sq) : tukey.weight(row.error_sq);
    result_.cost += one ? ratio * ratio * scalar.cost(row.error_sq) : tukey.cost(row.error_sq);
    if (row.weight == 0) continue;
    ++result_.inliers;
    sums_.add(row, one ? ratio * ratio * row.weight : row.weight);
  }
}

// Unknowns: the velocity (when free), then the pose. The residual of the velocity's prior, r = velocity - (mean +
// rate_per_s * moved), depends on both.
void PoseUpdater::fill_equations(int unknowns) {
  const int pose = unknowns - kPose;  // index of the pose's first unknown
  const float information = 1 / (result_.sigma * result_.sigma);
  equations_.clear(unknowns);
  for (int i = 0, k = 0; i < 6; ++i) {
    for (int j = i; j < 6; ++j, ++k) {
      equations_.A(pose + j, pose + i) = information * sums_.A[k];
      if (!velocity_free_) continue;
      equations_.A(j, i) = information * sums_.A_dt2[k];
      equations_.A(pose + j, i) = equations_.A(pose + i, j) = information * sums_.A_dt[k];
    }
    equations_.b(pose + i) = information * sums_.b[i];
    if (!velocity_free_) continue;
    const float sigma = i < 3 ? prior_.sigma_translation : prior_.sigma_rotation;
    const float W = 1 / (sigma * sigma);
    const float r = velocity_[i] + velocity_step_[i] - (prior_.mean[i] + prior_.rate_per_s * moved_[i]);
    equations_.A(i, i) += W;
    equations_.A(pose + i, i) -= W * prior_.rate_per_s;
    equations_.A(pose + i, pose + i) += W * prior_.rate_per_s * prior_.rate_per_s;
    equations_.b(i) = information * sums_.b_dt[i] - W * r;
    equations_.b(pose + i) += W * prior_.rate_per_s * r;
  }
}

FitStep PoseUpdater::step(int iteration) {
  if (result_.inliers < kMinInliers) return FitStep::kFailed;
  const int unknowns = velocity_free_ ? kUnknowns : kPose;
  meter_.charge(Work::kOther, velocity_free_ ? kStepInstructions : kPoseStepInstructions);
  fill_equations(unknowns);
  float x[kUnknowns];
  if (!equations_.solve(kMinPosePivot, x)) return FitStep::kFailed;
  Vector6f step;
  for (int i = 0; i < 6; ++i) {
    step[i] = x[unknowns - kPose + i];
    if (velocity_free_) velocity_step_[i] += x[i];
  }
  pose_step_ += step;
  moved_ += step;
  const auto size_sq = [depth_sq = mean_depth_ * mean_depth_](const Vector6f& mu) {
    return mu.head<3>().squaredNorm() / depth_sq + mu.tail<3>().squaredNorm();
  };
  const float size = size_sq(step);
  if (size > kMaxStepSq) return FitStep::kFailed;
  const bool small = size < kConvergedSq;
  if (iteration < kIterations && !(small && (full_ || size_sq(pose_step_) < kLinearSq))) {
    confirm_ = small;
    return FitStep::kAgain;
  }
  finish(unknowns);
  return FitStep::kConverged;
}

void PoseUpdater::finish(int unknowns) {
  meter_.charge(Work::kOther, kFinishInstructions);
  const int pose = unknowns - kPose;
  const SE3 T = SE3::exp(pose_step_) * T_;
  result_.T_cw = {orthonormalised(T.R), T.t};
  result_.velocity = velocity_ + velocity_step_;
  result_.mean_depth = mean_depth_;
  for (int i = 0; i < 6; ++i) {
    float column[kUnknowns];
    equations_.covariance_column(pose + i, pose, column);
    for (int j = 0; j < 6; ++j) result_.covariance(j, i) = column[pose + j];
  }
  result_.ok = result_.T_cw.t.allFinite() && result_.T_cw.R.allFinite() && result_.covariance.allFinite();
  if (!result_.ok) result_.T_cw = T_start_;
}

}  // namespace pptam
