#include "mapping/bundle_adjustment.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "geometry/robust.h"

namespace pptam {

namespace {

// Scale floor in units of the measurements' sigma: below the sub-pixel refinement's own noise nothing is an outlier.
constexpr float kSigmaFloor = 0.15f;
constexpr float kConverged = 1e-3f;  // relative fall of the cost by an accepted step
constexpr float kFirstLambda = 1e-3f;
constexpr float kMinLambda = 1e-6f, kMaxLambda = 1e4f;
constexpr int kLocalCameras = 5;  // the newest and its four nearest [ptam 6.3]

// Lower Cholesky factor of a 6x6 block in place; false if it is not positive definite.
bool factorise(Matrix6f& M) {
  for (int j = 0; j < 6; ++j) {
    float d = M(j, j);
    for (int k = 0; k < j; ++k) d -= M(j, k) * M(j, k);
    if (!(d > 1e-12f)) return false;
    const float root = std::sqrt(d);
    M(j, j) = root;
    for (int i = j + 1; i < 6; ++i) {
      float v = M(i, j);
      for (int k = 0; k < j; ++k) v -= M(i, k) * M(j, k);
      M(i, j) = v / root;
      M(j, i) = 0;
    }
  }
  return true;
}

// X <- X L^-T, L lower triangular.
void solve_right_transposed(const Matrix6f& L, Matrix6f& X) {
  for (int j = 0; j < 6; ++j) {
    for (int r = 0; r < 6; ++r) {
      float v = X(r, j);
      for (int k = 0; k < j; ++k) v -= X(r, k) * L(j, k);
      X(r, j) = v / L(j, j);
    }
  }
}

void solve_lower(const Matrix6f& L, Vector6f& x) {
  for (int i = 0; i < 6; ++i) {
    float v = x[i];
    for (int k = 0; k < i; ++k) v -= L(i, k) * x[k];
    x[i] = v / L(i, i);
  }
}

void solve_lower_transposed(const Matrix6f& L, Vector6f& x) {
  for (int i = 5; i >= 0; --i) {
    float v = x[i];
    for (int k = i + 1; k < 6; ++k) v -= L(k, i) * x[k];
    x[i] = v / L(i, i);
  }
}

}  // namespace

BundleAdjuster::BundleAdjuster(Arena& arena, const Config& config, Map& map, WorkMeter& meter, Background& background)
    : config_(config),
      map_(map),
      meter_(meter),
      background_(background),
      cameras_(arena, config.max_keyframes),
      points_(arena, config.max_map_points),
      observations_(arena, config.max_map_points * kMaxMeasurements),
      S_(arena, config.max_keyframes * (config.max_keyframes + 1) / 2),
      rhs_(arena, config.max_keyframes),
      squared_(arena, config.max_map_points * kMaxMeasurements) {}

Task BundleAdjuster::run(int newest, int max_iterations) {
  result_ = BundleResult();
  co_await gather(newest);
  if (free_cameras_ == 0 || points_.size() < 6) co_return;
  float lambda = kFirstLambda;
  float backoff = 4;
  while (result_.iterations < max_iterations) {
    co_await linearise();
    if (result_.iterations == 0) result_.initial_cost = cost_;
    result_.final_cost = cost_;
    result_.sigma = sigma_;
    bool accepted = false;
    while (lambda < kMaxLambda) {
      co_await build_reduced_system(lambda);
      co_await solve_reduced_system();
      if (solved_) {
        co_await evaluate_step();
        if (new_cost_ < cost_) {
          accepted = true;
          break;
        }
        // A step that neither gains nor loses means that the minimum is reached.
        if (new_cost_ < cost_ * (1 + 1e-6f)) break;
      }
      lambda *= backoff;
      backoff *= 2;
      if (map_.queued > 0) break;
    }
    if (!accepted) {
      result_.converged = map_.queued == 0;
      break;
    }
    lambda = std::max(lambda * 0.2f, kMinLambda);
    backoff = 4;
    ++result_.iterations;
    const float fall = cost_ - new_cost_;
    commit();
    result_.final_cost = new_cost_;
    if (fall < kConverged * cost_) {
      result_.converged = true;
      break;
    }
    if (map_.queued > 0) break;  // the new keyframe comes first
    co_await background_.slice();
  }
  if (result_.converged) co_await discard_outliers();
}

// The snapshot. The map's geometry is changed by the mapper alone, which is this very coroutine's caller: taking it in
// several slices is safe.
Task BundleAdjuster::gather(int newest) {
  cameras_.clear();
  points_.clear();
  observations_.clear();
  const int count = map_.keyframes.size();
  for (int k = 0; k < count; ++k) {
    Camera camera;
    camera.T = camera.T_new = map_.keyframes[k].T_kw;
    cameras_.push_back(camera);
  }
  free_cameras_ = 0;
  if (newest < 0) {
    for (int k = 1; k < count; ++k) cameras_[k].column = free_cameras_++;
  } else {
    // The newest, then the nearest of the rest, the first (the datum) never.
    const Vector3f centre = map_.keyframes[newest].T_kw.centre();
    if (newest > 0) cameras_[newest].column = free_cameras_++;
    while (free_cameras_ < kLocalCameras) {
      int best = -1;
      float best_distance = 0;
      for (int k = 1; k < count; ++k) {
        if (cameras_[k].column >= 0) continue;
        const float distance = (map_.keyframes[k].T_kw.centre() - centre).squaredNorm();
        if (best < 0 || distance < best_distance) {
          best = k;
          best_distance = distance;
        }
      }
      if (best < 0) break;
      cameras_[best].column = free_cameras_++;
    }
  }
  for (int i = 0; i < map_.points.size(); ++i) {
    const MapPoint& point = map_.points[i];
    if (point.id == 0) continue;
    bool seen_by_free = false;
    for (const Measurement& m : point.measurements) seen_by_free |= cameras_[m.keyframe].column >= 0;
    if (!seen_by_free) continue;
    Point entry;
    entry.index = i;
    entry.first = observations_.size();
    entry.p = entry.p_new = point.p_w;
    for (int j = 0; j < point.measurements.size(); ++j) {
      const Measurement& m = point.measurements[j];
      const Keyframe& keyframe = map_.keyframes[m.keyframe];
      Observation observation;
      observation.camera = m.keyframe;
      observation.measurement = static_cast<int16_t>(j);
      observation.px =
          global_shutter_px(config_.camera, config_.shutter, keyframe.velocity, keyframe.T_kw * point.p_w, m.px);
      observation.inv_sigma = 1.0f / m.sigma;
      if (!observations_.push_back(observation)) break;
    }
    entry.count = observations_.size() - entry.first;
    meter_.charge(Work::kBundleProjection, entry.count);
    points_.push_back(entry);
    co_await background_.slice();
  }
}

// Errors, Jacobians, scale, weights and the normal equations' diagonal blocks at the present estimate.
Task BundleAdjuster::linearise() {
  squared_.clear();
  for (Point& point : points_) {
    for (int k = point.first; k < point.first + point.count; ++k) {
      Observation& o = observations_[k];
      const SE3& T = cameras_[o.camera].T;
      const Vector3f p_c = T * point.p;
      Vector2f px;
      Matrix23f J;
      if (!config_.camera.project(p_c, &px, &J)) {
        o.error_sq = 1e12f;
        o.A.setZero();
        o.B.setZero();
        o.e.setZero();
        continue;
      }
      o.e = (o.px - px) * o.inv_sigma;
      o.error_sq = o.e.squaredNorm();
      o.A = J * se3_point_jacobian(p_c) * o.inv_sigma;
      o.B = J * T.R * o.inv_sigma;
      squared_.push_back(o.error_sq);
    }
    meter_.charge(Work::kBundleProjection, point.count);
    co_await background_.slice();
  }
  sigma_ = std::max(robust_sigma(squared_), kSigmaFloor);
  meter_.charge(Work::kOther, 30LL * squared_.size());
  cost_ = 0;
  for (Camera& camera : cameras_) {
    camera.U.setZero();
    camera.ea.setZero();
  }
  for (Point& point : points_) {
    point.V.setZero();
    point.eb.setZero();
    for (int k = point.first; k < point.first + point.count; ++k) {
      Observation& o = observations_[k];
      o.weight = tukey_weight(o.error_sq, sigma_);
      cost_ += tukey_cost(o.error_sq, sigma_);
      if (o.weight == 0) continue;
      Camera& camera = cameras_[o.camera];
      if (camera.column >= 0) {
        camera.U += o.weight * (o.A.transpose() * o.A);
        camera.ea += o.weight * (o.A.transpose() * o.e);
      }
      point.V += o.weight * (o.B.transpose() * o.B);
      point.eb += o.weight * (o.B.transpose() * o.e);
    }
    meter_.charge(Work::kBundleProjection, point.count / 2);
    co_await background_.slice();
  }
}

// S = U* - sum_i W_i V*_i^-1 W_i^T, rhs = ea - sum_i W_i V*_i^-1 eb_i.
Task BundleAdjuster::build_reduced_system(float lambda) {
  lambda_ = lambda;  // back substitution damps alike
  S_.resize(free_cameras_ * (free_cameras_ + 1) / 2);
  rhs_.resize(free_cameras_);
  for (Matrix6f& b : S_) b.setZero();
  for (const Camera& camera : cameras_) {
    if (camera.column < 0) continue;
    Matrix6f& diagonal = block(camera.column, camera.column);
    diagonal = camera.U;
    diagonal.diagonal() *= 1 + lambda;
    diagonal.diagonal().array() += 1e-6f;
    rhs_[camera.column] = camera.ea;
  }
  Eigen::Matrix<float, 6, 3> W[kMaxMeasurements + 1], Y[kMaxMeasurements + 1];
  for (Point& point : points_) {
    Matrix3f V = point.V;
    V.diagonal() *= 1 + lambda;
    V.diagonal().array() += 1e-9f;
    const Matrix3f V_inverse = V.inverse();
    if (!V_inverse.allFinite() || V.determinant() <= 0) continue;
    int blocks = 0;
    for (int a = 0; a < point.count; ++a) {
      const Observation& oa = observations_[point.first + a];
      const int ca = cameras_[oa.camera].column;
      if (ca < 0 || oa.weight == 0) continue;
      W[a] = oa.weight * (oa.A.transpose() * oa.B);
      Y[a] = W[a] * V_inverse;
      rhs_[ca] -= Y[a] * point.eb;
      for (int b = 0; b <= a; ++b) {
        const Observation& ob = observations_[point.first + b];
        const int cb = cameras_[ob.camera].column;
        if (cb < 0 || ob.weight == 0) continue;
        if (ca >= cb) {
          block(ca, cb) -= Y[a] * W[b].transpose();
        } else {
          block(cb, ca) -= Y[b] * W[a].transpose();
        }
        ++blocks;
      }
    }
    meter_.charge(Work::kBundleBlock, blocks + 1);
    co_await background_.slice();
  }
}

// S = L L^T block by block, then both triangular solves.
Task BundleAdjuster::solve_reduced_system() {
  solved_ = false;
  const int n = free_cameras_;
  for (int j = 0; j < n; ++j) {
    for (int i = j; i < n; ++i) {
      Matrix6f& target = block(i, j);
      for (int k = 0; k < j; ++k) target -= block(i, k) * block(j, k).transpose();
      meter_.charge(Work::kBundleSolve, 216LL * (j + 1));
      if (i == j) {
        if (!factorise(target)) co_return;
      } else {
        solve_right_transposed(block(j, j), target);
      }
      co_await background_.slice();
    }
  }
  for (int i = 0; i < n; ++i) {
    for (int k = 0; k < i; ++k) rhs_[i] -= block(i, k) * rhs_[k];
    solve_lower(block(i, i), rhs_[i]);
  }
  for (int i = n - 1; i >= 0; --i) {
    for (int k = i + 1; k < n; ++k) rhs_[i] -= block(k, i).transpose() * rhs_[k];
    solve_lower_transposed(block(i, i), rhs_[i]);
  }
  meter_.charge(Work::kBundleSolve, 36LL * n * n);
  solved_ = true;
  for (int i = 0; i < n; ++i) solved_ = solved_ && rhs_[i].allFinite();
}

// The step's poses and points, and what they cost at the same scale.
Task BundleAdjuster::evaluate_step() {
  for (Camera& camera : cameras_) {
    if (camera.column < 0) continue;
    camera.step = rhs_[camera.column];
    camera.T_new = SE3::exp(camera.step) * camera.T;
  }
  new_cost_ = 0;
  for (Point& point : points_) {
    Vector3f b = point.eb;
    for (int k = point.first; k < point.first + point.count; ++k) {
      const Observation& o = observations_[k];
      const Camera& camera = cameras_[o.camera];
      if (camera.column >= 0 && o.weight != 0) b -= o.weight * (o.B.transpose() * (o.A * camera.step));
    }
    Matrix3f V = point.V;
    V.diagonal() *= 1 + lambda_;
    V.diagonal().array() += 1e-9f;
    const Vector3f step = V.inverse() * b;
    point.p_new = step.allFinite() ? Vector3f(point.p + step) : point.p;
    for (int k = point.first; k < point.first + point.count; ++k) {
      const Observation& o = observations_[k];
      Vector2f px;
      const float error_sq = config_.camera.project(cameras_[o.camera].T_new * point.p_new, &px)
                                 ? ((o.px - px) * o.inv_sigma).squaredNorm()
                                 : 1e12f;
      new_cost_ += tukey_cost(error_sq, sigma_);
    }
    meter_.charge(Work::kBundleProjection, point.count);
    co_await background_.slice();
  }
}

// One accepted step, as a whole, into the map.
void BundleAdjuster::commit() {
  for (int k = 0; k < cameras_.size(); ++k) {
    Camera& camera = cameras_[k];
    if (camera.column < 0) continue;
    camera.T = {orthonormalised(camera.T_new.R), camera.T_new.t};
    map_.keyframes[k].T_kw = camera.T;
  }
  for (Point& point : points_) {
    point.p = point.p_new;
    map_.points[point.index].p_w = point.p;
  }
  meter_.charge(Work::kOther, 20LL * points_.size());
}

// Zero-weight measurements are forgotten; a point whose source view is one, or which is left with fewer than two, goes.
Task BundleAdjuster::discard_outliers() {
  for (const Point& entry : points_) {
    MapPoint& point = map_.points[entry.index];
    bool source_is_outlier = false;
    for (int k = entry.first + entry.count - 1; k >= entry.first; --k) {
      const Observation& o = observations_[k];
      if (o.weight != 0) continue;
      source_is_outlier |= o.camera == point.source.keyframe;
      point.measurements.erase_at(o.measurement);
    }
    if (source_is_outlier || point.measurements.size() < 2) map_.remove_point(entry.index);
    meter_.charge(Work::kOther, 50);
    co_await background_.slice();
  }
}

}  // namespace pptam
