#include "camera/pose_update.h"

#include <algorithm>
#include <cmath>

#include "geometry/robust.h"

namespace pptam {

namespace {

constexpr int kIterations = 10;
// Iterations with full projections; between them the errors follow their Jacobians [phone 4].
constexpr int kRelinearised[] = {0, 4, 9};
constexpr int kMinInliers = 6;
// Squared steps, radians and scene depths.
constexpr float kConverged = 1e-10f;  // 0.004 px on the phone
constexpr float kMaxStep = 0.5f;      // more comes from garbage
// Smallest pivot of the system scaled to a unit diagonal: a hundred times float32's rounding.
constexpr float kMinPivot = 1e-5f;

constexpr float kUnseen = 1e12f;  // squared error of a row that cannot be predicted

constexpr int kPose = 6, kUnknowns = 12;  // the velocity comes first, the pose at kPose, or alone

// H x = g with H = L D L^T, symmetric positive definite and scaled to a unit diagonal; only H's lower triangle is read.
// False when a pivot falls under kMinPivot.
struct Factorised {
  float L[kUnknowns][kUnknowns];
  float D[kUnknowns];

  bool factorise(const float (&H)[kUnknowns][kUnknowns], int n) {
    for (int j = 0; j < n; ++j) {
      float scaled[kUnknowns];  // L(j, k) D(k)
      float d = H[j][j];
      for (int k = 0; k < j; ++k) {
        scaled[k] = L[j][k] * D[k];
        d -= scaled[k] * L[j][k];
      }
      if (!(d > kMinPivot)) return false;
      D[j] = d;
      for (int i = j + 1; i < n; ++i) {
        float v = H[i][j];
        for (int k = 0; k < j; ++k) v -= L[i][k] * scaled[k];
        L[i][j] = v / d;
      }
    }
    return true;
  }
  // Of the last n - first unknowns alone: with first > 0 the others are marginalised.
  void solve(float* x, int first, int n) const {
    for (int i = first; i < n; ++i)
      for (int k = first; k < i; ++k) x[i] -= L[i][k] * x[k];
    for (int i = first; i < n; ++i) x[i] /= D[i];
    for (int i = n - 1; i >= first; --i)
      for (int k = i + 1; k < n; ++k) x[i] -= L[k][i] * x[k];
  }
};

}  // namespace

void PoseRow::set_point(const Camera& camera, const SE3& T_cw, const Vector6f& velocity, const Vector3f& p_w,
                        const ImagePoint& found) {
  dt_s = camera.dt_s(found.px);
  const Vector3f p = moved_point(T_cw * p_w, velocity, dt_s);
  Vector2f px;
  Matrix23f J_px_p;
  valid = camera.project(p, &px, &J_px_p);
  if (!valid) return;
  const float scale = 1 / found.sigma();
  for (int k = 0; k < 2; ++k) {
    const float x = scale * J_px_p(k, 0), y = scale * J_px_p(k, 1), z = scale * J_px_p(k, 2);
    J[k][0] = x;
    J[k][1] = y;
    J[k][2] = z;
    J[k][3] = p.y() * z - p.z() * y;  // the rotation's: p x (x, y, z)
    J[k][4] = p.z() * x - p.x() * z;
    J[k][5] = p.x() * y - p.y() * x;
    e_0[k] = scale * (found.px[k] - px[k]);
  }
  depth = p.z();
}

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
  iteration_ = 0;
  confirm_ = false;
  result_ = PoseUpdate();
  result_.T_cw = T_start;
  result_.velocity = prior.mean;
  for (PoseRow& row : rows_) row.weight = row.error_sq = 0;
  next_ = rows_.size() < kMinInliers ? Piece::kEnd : Piece::kErrors;
}

bool PoseUpdater::advance() {
  switch (next_) {
    case Piece::kErrors:
      full_ = confirm_ ||
              std::find(std::begin(kRelinearised), std::end(kRelinearised), iteration_) != std::end(kRelinearised);
      next_ = full_ ? linearise() : follow();
      break;
    case Piece::kScale:
      next_ = estimate_scale();
      break;
    case Piece::kSums:
      next_ = sum_up();
      break;
    case Piece::kEnd:
      break;
  }
  return next_ == Piece::kEnd;
}

PoseUpdater::Piece PoseUpdater::linearise() {
  meter_.charge(Work::kPoseProjection, rows_.size());
  T_ = SE3::exp(pose_step_) * T_;
  velocity_ += velocity_step_;
  pose_step_.setZero();
  velocity_step_.setZero();
  source_->linearise(T_, velocity_, rows_);
  float depth_sum = 0;
  int valid = 0, deep = 0;
  for (PoseRow& row : rows_) {
    if (!row.valid) {
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
  if (valid < kMinInliers) return Piece::kEnd;
  if (deep > 0) mean_depth_ = depth_sum / static_cast<float>(deep);
  return Piece::kScale;
}

PoseUpdater::Piece PoseUpdater::follow() {
  const Vector6f pose_step = pose_step_, velocity_step = velocity_step_;
  for (PoseRow& row : rows_) {
    if (!row.valid) continue;
    for (int k = 0; k < 2; ++k) {
      float e = row.e_0[k];
      for (int c = 0; c < 6; ++c) e -= row.J[k][c] * (pose_step[c] + row.dt_s * velocity_step[c]);
      row.e[k] = e;
    }
  }
  return Piece::kScale;
}

PoseUpdater::Piece PoseUpdater::estimate_scale() {
  squared_.clear();
  for (PoseRow& row : rows_) {
    if (!row.valid) continue;
    row.error_sq = row.e[0] * row.e[0] + row.e[1] * row.e[1];
    squared_.push_back(row.error_sq);
  }
  const int unseen = rows_.size() - squared_.size();
  result_.sigma = std::max(robust_sigma(squared_), kRobustSigmaFloor);
  sums_ = Sums();
  summed_ = 0;
  result_.inliers = 0;
  result_.cost = tukey_cost(kUnseen, result_.sigma) * static_cast<float>(unseen);
  return Piece::kSums;
}

PoseUpdater::Piece PoseUpdater::sum_up() {
  const int count = rows_.size();
  const int end = std::min(count, summed_ + kSummedAtOnce);
  const float sigma = result_.sigma;
  meter_.charge(Work::kPosePoint, end - summed_);
  for (; summed_ < end; ++summed_) {
    PoseRow& row = rows_[summed_];
    if (!row.valid) continue;
    row.weight = tukey_weight(row.error_sq, sigma);
    result_.cost += tukey_cost(row.error_sq, sigma);
    if (row.weight == 0) continue;
    ++result_.inliers;
    sums_.add(row, row.weight);
  }
  if (end < count) return Piece::kSums;
  return result_.inliers < kMinInliers ? Piece::kEnd : solve();
}

PoseUpdater::Piece PoseUpdater::solve() {
  const int unknowns = velocity_free_ ? kUnknowns : kUnknowns - kPose;
  const int pose = unknowns - kPose;  // the pose's place
  // The prior's r = velocity - (mean + rate * moved) adds to both.
  const float information = 1 / (result_.sigma * result_.sigma);
  float H[kUnknowns][kUnknowns];
  float g[kUnknowns];
  for (int i = 0, k = 0; i < 6; ++i) {
    for (int j = i; j < 6; ++j, ++k) {
      H[pose + j][pose + i] = information * sums_.A[k];
      if (!velocity_free_) continue;
      H[j][i] = information * sums_.A_dt2[k];
      H[pose + j][i] = H[pose + i][j] = information * sums_.A_dt[k];
    }
    g[pose + i] = information * sums_.b[i];
    if (!velocity_free_) continue;
    const float sigma = i < 3 ? prior_.sigma_translation : prior_.sigma_rotation;
    const float W = 1 / (sigma * sigma);
    const float r = velocity_[i] + velocity_step_[i] - (prior_.mean[i] + prior_.rate_per_s * moved_[i]);
    H[i][i] += W;
    H[pose + i][i] -= W * prior_.rate_per_s;
    H[pose + i][pose + i] += W * prior_.rate_per_s * prior_.rate_per_s;
    g[i] = information * sums_.b_dt[i] - W * r;
    g[pose + i] += W * prior_.rate_per_s * r;
  }
  // Scaled to a unit diagonal, which keeps the system within float32 and makes the pivots tell its conditioning.
  float unit[kUnknowns];
  for (int i = 0; i < unknowns; ++i) {
    if (!(H[i][i] > 0)) return Piece::kEnd;
    unit[i] = 1 / std::sqrt(H[i][i]);
  }
  for (int i = 0; i < unknowns; ++i) {
    for (int j = 0; j < i; ++j) H[i][j] *= unit[i] * unit[j];
    H[i][i] = 1;
    g[i] *= unit[i];
  }
  Factorised factorised;
  if (!factorised.factorise(H, unknowns)) return Piece::kEnd;
  factorised.solve(g, 0, unknowns);

  Vector6f step;
  for (int i = 0; i < 6; ++i) {
    step[i] = unit[pose + i] * g[pose + i];
    if (velocity_free_) velocity_step_[i] += unit[i] * g[i];
  }
  pose_step_ += step;
  moved_ += step;
  if (!step.allFinite() || !velocity_step_.allFinite()) return Piece::kEnd;
  const float size = step.head<3>().squaredNorm() / (mean_depth_ * mean_depth_) + step.tail<3>().squaredNorm();
  if (size > kMaxStep) return Piece::kEnd;
  const bool small = size < kConverged;
  if (iteration_ < kIterations && !(small && full_)) {
    confirm_ = small;
    ++iteration_;
    return Piece::kErrors;
  }
  const SE3 T = SE3::exp(pose_step_) * T_;
  result_.T_cw = {orthonormalised(T.R), T.t};
  result_.velocity = velocity_ + velocity_step_;
  for (int i = 0; i < 6; ++i) {
    float column[kUnknowns] = {};
    column[pose + i] = 1;
    factorised.solve(column, pose, unknowns);
    for (int j = 0; j < 6; ++j) result_.covariance(j, i) = unit[pose + i] * unit[pose + j] * column[pose + j];
  }
  result_.ok = result_.T_cw.t.allFinite() && result_.T_cw.R.allFinite() && result_.covariance.allFinite();
  if (!result_.ok) result_.T_cw = T_start_;
  return Piece::kEnd;
}

}  // namespace pptam
