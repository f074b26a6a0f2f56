#include "geometry/pose_update.h"

#include <algorithm>
#include <cmath>

#include "geometry/robust.h"

namespace pptam {

namespace {

constexpr int kIterations = 10;
// Iterations with full projections; between them the errors follow their Jacobians [phone 4].
constexpr int kRelinearised[] = {0, 4, 9};
constexpr int kMaxPoints = 256;  // more are left out
constexpr int kMinInliers = 6;
// Squared steps, radians and scene depths.
constexpr float kConverged = 1e-10f;  // 0.004 px on the phone
constexpr float kMaxStep = 0.5f;      // more comes from garbage
// Smallest pivot of the system scaled to a unit diagonal: a hundred times float32's rounding.
constexpr float kMinPivot = 1e-5f;

constexpr int kPose = 6, kUnknowns = 12;  // the velocity comes first, the pose at kPose, or alone

// A point's error e = e_0 - J (mu + dt velocity step), both rows divided by sigma.
struct Row {
  float J[2][6];
  float e_0[2];
  float e[2];
  float dt_s;
  bool valid;
};

// Sums over the points of w J^T J and w J^T e, upper triangles row by row, with the factors 1, dt and dt^2.
struct Sums {
  float A[21] = {}, A_dt[21] = {}, A_dt2[21] = {};
  float b[6] = {}, b_dt[6] = {};

  void add(const Row& row, float weight) {
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
};

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

bool project_rolling(const CameraModel& camera, const RollingShutter& shutter, const SE3& T_cw,
                     const Vector6f& velocity, const Vector3f& p_w, Vector2f* px, SE3* T_line) {
  *T_line = T_cw;
  const Vector3f q = T_cw * p_w;
  if (!camera.project(q, px)) return false;
  if (shutter.line_time_s == 0) return true;
  float dt_s = 0;
  for (int pass = 0; pass < 2; ++pass) {
    dt_s = shutter.dt_s(*px, camera.width, camera.height);
    if (!camera.project(moved_point(q, velocity, dt_s), px)) return false;
  }
  *T_line = pose_at(T_cw, velocity, dt_s);
  return true;
}

PoseUpdate update_pose(const CameraModel& camera, const RollingShutter& shutter, const SE3& T_start,
                       const VelocityPrior& prior, std::span<PosePoint> points, float sigma_floor, WorkMeter& meter) {
  PoseUpdate result;
  result.T_cw = T_start;
  result.velocity = prior.mean;
  const int count = std::min<int>(static_cast<int>(points.size()), kMaxPoints);
  if (count < kMinInliers) return result;
  const bool estimate_velocity = shutter.line_time_s != 0 && prior.sigma_rotation > 0;
  const int unknowns = estimate_velocity ? kUnknowns : kUnknowns - kPose;
  const int pose = unknowns - kPose;  // the pose's place

  float squared[kMaxPoints];
  Row rows[kMaxPoints];
  for (int i = 0; i < count; ++i) rows[i].dt_s = shutter.dt_s(points[i].px, camera.width, camera.height);

  SE3 T = T_start;                     // of the last full projection
  Vector6f velocity = prior.mean;      // the same
  Vector6f mu = Vector6f::Zero();      // since then
  Vector6f faster = Vector6f::Zero();  // the same, of the velocity
  Vector6f moved = Vector6f::Zero();   // all steps since T_start, to first order
  float mean_depth = 1;
  bool confirm = false;  // the last step was small, but taken from errors that are not exact
  for (int iteration = 0;; ++iteration) {
    const bool full =
        confirm || std::find(std::begin(kRelinearised), std::end(kRelinearised), iteration) != std::end(kRelinearised);
    int valid = 0;
    if (full) {
      meter.charge(Work::kPoseProjection, count);
      T = SE3::exp(mu) * T;
      velocity += faster;
      mu.setZero();
      faster.setZero();
      float depth_sum = 0;
      for (int i = 0; i < count; ++i) {
        PosePoint& point = points[i];
        Row& row = rows[i];
        const Vector3f p = moved_point(T * point.p_w, velocity, row.dt_s);
        Vector2f px;
        Matrix23f J_px_p;
        row.valid = camera.project(p, &px, &J_px_p);
        if (!row.valid) {
          point.error_sq = 1e12f;
          point.weight = 0;
          continue;
        }
        const float scale = 1 / point.sigma;
        for (int k = 0; k < 2; ++k) {
          const float x = scale * J_px_p(k, 0), y = scale * J_px_p(k, 1), z = scale * J_px_p(k, 2);
          row.J[k][0] = x;
          row.J[k][1] = y;
          row.J[k][2] = z;
          row.J[k][3] = p.y() * z - p.z() * y;  // the rotation's: p x (x, y, z)
          row.J[k][4] = p.z() * x - p.x() * z;
          row.J[k][5] = p.x() * y - p.y() * x;
          row.e_0[k] = row.e[k] = scale * (point.px[k] - px[k]);
        }
        depth_sum += p.z();
        ++valid;
      }
      if (valid < kMinInliers) return result;
      mean_depth = depth_sum / static_cast<float>(valid);
    } else {
      for (int i = 0; i < count; ++i) {
        Row& row = rows[i];
        if (!row.valid) continue;
        for (int k = 0; k < 2; ++k) {
          float e = row.e_0[k];
          for (int c = 0; c < 6; ++c) e -= row.J[k][c] * (mu[c] + row.dt_s * faster[c]);
          row.e[k] = e;
        }
      }
    }
    meter.charge(Work::kPosePoint, count);
    valid = 0;
    for (int i = 0; i < count; ++i) {
      if (!rows[i].valid) continue;
      points[i].error_sq = rows[i].e[0] * rows[i].e[0] + rows[i].e[1] * rows[i].e[1];
      squared[valid++] = points[i].error_sq;
    }
    result.sigma = std::max(robust_sigma({squared, static_cast<size_t>(valid)}), sigma_floor);

    Sums sums;
    int inliers = 0;
    float cost = tukey_cost(1e12f, result.sigma) * static_cast<float>(count - valid);
    for (int i = 0; i < count; ++i) {
      PosePoint& point = points[i];
      if (!rows[i].valid) continue;
      point.weight = tukey_weight(point.error_sq, result.sigma);
      cost += tukey_cost(point.error_sq, result.sigma);
      if (point.weight == 0) continue;
      ++inliers;
      sums.add(rows[i], point.weight);
    }
    result.cost = cost;
    result.inliers = inliers;
    if (inliers < kMinInliers) return result;

    // The prior's r = velocity - (mean + rate * moved) adds to both.
    const float information = 1 / (result.sigma * result.sigma);
    float H[kUnknowns][kUnknowns];
    float g[kUnknowns];
    for (int i = 0, k = 0; i < 6; ++i) {
      for (int j = i; j < 6; ++j, ++k) {
        H[pose + j][pose + i] = information * sums.A[k];
        if (!estimate_velocity) continue;
        H[j][i] = information * sums.A_dt2[k];
        H[pose + j][i] = H[pose + i][j] = information * sums.A_dt[k];
      }
      g[pose + i] = information * sums.b[i];
      if (!estimate_velocity) continue;
      const float sigma = i < 3 ? prior.sigma_translation : prior.sigma_rotation;
      const float W = 1 / (sigma * sigma);
      const float r = velocity[i] + faster[i] - (prior.mean[i] + prior.rate_per_s * moved[i]);
      H[i][i] += W;
      H[pose + i][i] -= W * prior.rate_per_s;
      H[pose + i][pose + i] += W * prior.rate_per_s * prior.rate_per_s;
      g[i] = information * sums.b_dt[i] - W * r;
      g[pose + i] += W * prior.rate_per_s * r;
    }
    // Scaled to a unit diagonal, which keeps the system within float32 and makes the pivots tell its conditioning.
    float unit[kUnknowns];
    for (int i = 0; i < unknowns; ++i) {
      if (!(H[i][i] > 0)) return result;
      unit[i] = 1 / std::sqrt(H[i][i]);
    }
    for (int i = 0; i < unknowns; ++i) {
      for (int j = 0; j < i; ++j) H[i][j] *= unit[i] * unit[j];
      H[i][i] = 1;
      g[i] *= unit[i];
    }
    Factorised factorised;
    if (!factorised.factorise(H, unknowns)) return result;
    factorised.solve(g, 0, unknowns);

    Vector6f step;
    for (int i = 0; i < 6; ++i) {
      step[i] = unit[pose + i] * g[pose + i];
      if (estimate_velocity) faster[i] += unit[i] * g[i];
    }
    mu += step;
    moved += step;
    if (!step.allFinite() || !faster.allFinite()) return result;
    const float size = step.head<3>().squaredNorm() / (mean_depth * mean_depth) + step.tail<3>().squaredNorm();
    if (size > kMaxStep) return result;
    const bool small = size < kConverged;
    if (iteration < kIterations && !(small && full)) {
      confirm = small;
      continue;
    }
    T = SE3::exp(mu) * T;
    result.T_cw = {orthonormalised(T.R), T.t};
    result.velocity = velocity + faster;
    for (int i = 0; i < 6; ++i) {
      float column[kUnknowns] = {};
      column[pose + i] = 1;
      factorised.solve(column, pose, unknowns);
      for (int j = 0; j < 6; ++j) result.covariance(j, i) = unit[pose + i] * unit[pose + j] * column[pose + j];
    }
    result.ok = result.T_cw.t.allFinite() && result.T_cw.R.allFinite() && result.covariance.allFinite();
    if (!result.ok) result.T_cw = T_start;
    return result;
  }
}

}  // namespace pptam
