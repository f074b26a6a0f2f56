#include "mapping/bundle_adjustment.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "geometry/pose_update.h"
#include "geometry/robust.h"

namespace pptam {

namespace {

constexpr float kConverged = 1e-3f;  // relative fall of the cost by an accepted step
constexpr float kFirstLambda = 1e-3f;
constexpr float kMinLambda = 1e-6f, kMaxLambda = 1e4f;
constexpr int kLocalCameras = 5;  // the newest and its four nearest [ptam 6.3]

// Lower Cholesky factor of a block in place; false if it is not positive definite.
template <class Block>
bool factorise(Block& M) {
  const int n = static_cast<int>(M.rows());
  for (int j = 0; j < n; ++j) {
    float d = M(j, j);
    for (int k = 0; k < j; ++k) d -= M(j, k) * M(j, k);
    if (!(d > 1e-12f)) return false;
    const float root = std::sqrt(d);
    M(j, j) = root;
    for (int i = j + 1; i < n; ++i) {
      float v = M(i, j);
      for (int k = 0; k < j; ++k) v -= M(i, k) * M(j, k);
      M(i, j) = v / root;
      M(j, i) = 0;
    }
  }
  return true;
}

// X <- X L^-T, L lower triangular.
template <class Block>
void solve_right_transposed(const Block& L, Block& X) {
  const int n = static_cast<int>(L.rows());
  for (int j = 0; j < n; ++j) {
    for (int r = 0; r < n; ++r) {
      float v = X(r, j);
      for (int k = 0; k < j; ++k) v -= X(r, k) * L(j, k);
      X(r, j) = v / L(j, j);
    }
  }
}

template <class Block, class Vector>
void solve_lower(const Block& L, Vector& x) {
  const int n = static_cast<int>(L.rows());
  for (int i = 0; i < n; ++i) {
    float v = x[i];
    for (int k = 0; k < i; ++k) v -= L(i, k) * x[k];
    x[i] = v / L(i, i);
  }
}

template <class Block, class Vector>
void solve_lower_transposed(const Block& L, Vector& x) {
  const int n = static_cast<int>(L.rows());
  for (int i = n - 1; i >= 0; --i) {
    float v = x[i];
    for (int k = i + 1; k < n; ++k) v -= L(k, i) * x[k];
    x[i] = v / L(i, i);
  }
}

// Point in the camera at dt after the timestamp, q = T p being its place at the timestamp.
Vector3f moved(const Vector3f& q, const Vector6f& velocity, float dt_s) {
  return q + dt_s * (velocity.head<3>() + velocity.tail<3>().cross(q));
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
      S_(arena, std::max(config.max_keyframes * (config.max_keyframes + 1) / 2 * 36,
                         kMaxVelocityCameras * (kMaxVelocityCameras + 1) / 2 * 144)),
      rhs_(arena, std::max(config.max_keyframes * 6, kMaxVelocityCameras * 12)),
      squared_(arena, config.max_map_points * kMaxMeasurements) {}

Vector6f BundleAdjuster::prior_information(const Camera& camera) const {
  const float translation = kVelocitySigmaTranslation * camera.depth;
  Vector6f information;
  information << Vector3f::Constant(1.0f / (translation * translation)),
      Vector3f::Constant(1.0f / (kVelocitySigmaRotation * kVelocitySigmaRotation));
  return information * (sigma_ * sigma_);  // in units of the Tukey costs, which are not divided by sigma^2
}

float BundleAdjuster::prior_cost(const Camera& camera, const Vector6f& velocity) const {
  return 0.5f * (velocity - camera.velocity_prior).cwiseAbs2().dot(prior_information(camera));
}

Task BundleAdjuster::run(int newest, bool velocities, int max_iterations) {
  result_ = BundleResult();
  with_velocities_ =
      velocities && config_.shutter.line_time_s != 0 && (newest >= 0 || map_.keyframes.size() <= kMaxVelocityCameras);
  co_await gather(newest);
  if (free_cameras_ == 0 || points_.size() < 6) co_return;
  if (with_velocities_) {
    co_await iterate<12>(max_iterations);
  } else {
    co_await iterate<6>(max_iterations);
  }
  if (result_.converged) co_await discard_outliers();
}

template <int N>
Task BundleAdjuster::iterate(int max_iterations) {
  float lambda = kFirstLambda;
  float backoff = 4;
  while (result_.iterations < max_iterations) {
    co_await linearise();
    if (result_.iterations == 0) result_.initial_cost = cost_;
    result_.final_cost = cost_;
    result_.sigma = sigma_;
    bool accepted = false;
    while (lambda < kMaxLambda) {
      co_await build_reduced_system<N>(lambda);
      co_await solve_reduced_system<N>();
      if (solved_) {
        co_await evaluate_step<N>();
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
}

// The snapshot. The map's geometry is changed by the mapper alone, which is this very coroutine's caller: taking it in
// several slices is safe.
Task BundleAdjuster::gather(int newest) {
  cameras_.clear();
  points_.clear();
  observations_.clear();
  const int count = map_.keyframes.size();
  for (int k = 0; k < count; ++k) {
    const Keyframe& keyframe = map_.keyframes[k];
    Camera camera;
    camera.T = camera.T_new = keyframe.T_kw;
    camera.velocity = camera.velocity_new = keyframe.velocity;
    camera.velocity_prior = keyframe.velocity_prior;
    camera.depth = keyframe.mean_depth;
    cameras_.push_back(camera);
  }
  free_cameras_ = 0;
  const auto release = [this](int k) {
    cameras_[k].column = free_cameras_++;
    cameras_[k].pose_free = k > 0;
  };
  if (newest < 0) {
    for (int k = with_velocities_ ? 0 : 1; k < count; ++k) release(k);
  } else {
    // The newest, then the nearest of the rest, the first (the datum) never.
    const Vector3f centre = map_.keyframes[newest].T_kw.centre();
    if (newest > 0) release(newest);
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
      release(best);
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
      Observation observation;
      observation.camera = m.keyframe;
      observation.measurement = static_cast<int16_t>(j);
      observation.px = m.px;
      observation.dt_s = config_.shutter.dt_s(m.px, config_.camera.width, config_.camera.height);
      observation.inv_sigma = 1.0f / m.sigma;
      if (!observations_.push_back(observation)) break;
    }
    entry.count = observations_.size() - entry.first;
    meter_.charge(Work::kOther, 40LL * entry.count);
    points_.push_back(entry);
    co_await background_.slice();
  }
}

// Errors, Jacobians, scale, weights and the points' normal equations at the present estimate.
Task BundleAdjuster::linearise() {
  squared_.clear();
  for (Point& point : points_) {
    for (int k = point.first; k < point.first + point.count; ++k) {
      Observation& o = observations_[k];
      const Camera& camera = cameras_[o.camera];
      const Vector3f q = camera.T * point.p;
      Vector2f px;
      Matrix23f J;
      if (!config_.camera.project(moved(q, camera.velocity, o.dt_s), &px, &J)) {
        o.error_sq = 1e12f;
        o.A.setZero();
        o.A_v.setZero();
        o.B.setZero();
        o.e.setZero();
        continue;
      }
      o.e = (o.px - px) * o.inv_sigma;
      o.error_sq = o.e.squaredNorm();
      const Eigen::Matrix<float, 3, 6> G = se3_point_jacobian(q);
      const Matrix23f J_sigma = J * o.inv_sigma;
      const Matrix23f J_q = J_sigma + o.dt_s * (J_sigma * hat(camera.velocity.tail<3>()));
      o.A = J_q * G;
      if (with_velocities_) o.A_v = o.dt_s * (J_sigma * G);
      o.B = J_q * camera.T.R;
      squared_.push_back(o.error_sq);
    }
    meter_.charge(Work::kBundleProjection, point.count);
    co_await background_.slice();
  }
  sigma_ = std::max(robust_sigma(squared_), kRobustSigmaFloor);
  meter_.charge(Work::kOther, 30LL * squared_.size());
  cost_ = 0;
  for (Point& point : points_) {
    point.V.setZero();
    point.eb.setZero();
    for (int k = point.first; k < point.first + point.count; ++k) {
      Observation& o = observations_[k];
      o.weight = tukey_weight(o.error_sq, sigma_);
      cost_ += tukey_cost(o.error_sq, sigma_);
      if (o.weight == 0) continue;
      point.V += o.weight * (o.B.transpose() * o.B);
      point.eb += o.weight * (o.B.transpose() * o.e);
    }
    meter_.charge(Work::kBundleProjection, point.count / 4);
    co_await background_.slice();
  }
  if (with_velocities_)
    for (const Camera& camera : cameras_)
      if (camera.column >= 0) cost_ += prior_cost(camera, camera.velocity);
}

// S = U* - sum_i W_i V*_i^-1 W_i^T, rhs = ea - sum_i W_i V*_i^-1 eb_i.
template <int N>
Task BundleAdjuster::build_reduced_system(float lambda) {
  using Jacobian = Eigen::Matrix<float, 2, N>;
  using Coupling = Eigen::Matrix<float, N, 3>;
  lambda_ = lambda;  // back substitution damps alike
  S_.resize(free_cameras_ * (free_cameras_ + 1) / 2 * N * N);
  rhs_.resize(free_cameras_ * N);
  std::fill(S_.begin(), S_.end(), 0.0f);
  std::fill(rhs_.begin(), rhs_.end(), 0.0f);
  // The datum's pose has no columns of its own.
  const auto jacobian = [&cameras = cameras_](const Observation& o) {
    Jacobian J = Jacobian::Zero();
    if (cameras[o.camera].pose_free) J.template leftCols<6>() = o.A;
    if constexpr (N == 12) J.template rightCols<6>() = o.A_v;
    return J;
  };
  // First the cameras' own blocks, damped; then what the points take away.
  for (const Point& point : points_) {
    for (int k = point.first; k < point.first + point.count; ++k) {
      const Observation& o = observations_[k];
      const int c = cameras_[o.camera].column;
      if (c < 0 || o.weight == 0) continue;
      const Jacobian J = jacobian(o);
      block<N>(c, c) += o.weight * (J.transpose() * J);
      rhs<N>(c) += o.weight * (J.transpose() * o.e);
    }
    meter_.charge(Work::kBundleBlock, point.count * N / 12);
    co_await background_.slice();
  }
  for (const Camera& camera : cameras_) {
    if (camera.column < 0) continue;
    auto diagonal = block<N>(camera.column, camera.column);
    if constexpr (N == 12) {
      const Vector6f information = prior_information(camera);
      diagonal.diagonal().template tail<6>() += information;
      rhs<N>(camera.column).template tail<6>() += information.cwiseProduct(camera.velocity_prior - camera.velocity);
      if (!camera.pose_free) diagonal.diagonal().template head<6>().setOnes();
    }
    diagonal.diagonal() *= 1 + lambda;
    diagonal.diagonal().array() += 1e-6f;
  }
  Coupling W[kMaxMeasurements + 1], Y[kMaxMeasurements + 1];
  for (const Point& point : points_) {
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
      W[a] = oa.weight * (jacobian(oa).transpose() * oa.B);
      Y[a] = W[a] * V_inverse;
      rhs<N>(ca) -= Y[a] * point.eb;
      for (int b = 0; b <= a; ++b) {
        const Observation& ob = observations_[point.first + b];
        const int cb = cameras_[ob.camera].column;
        if (cb < 0 || ob.weight == 0) continue;
        if (ca >= cb) {
          block<N>(ca, cb) -= Y[a] * W[b].transpose();
        } else {
          block<N>(cb, ca) -= Y[b] * W[a].transpose();
        }
        ++blocks;
      }
    }
    meter_.charge(Work::kBundleBlock, (blocks + 1) * (N * N / 36));
    co_await background_.slice();
  }
}

// S = L L^T block by block, then both triangular solves.
template <int N>
Task BundleAdjuster::solve_reduced_system() {
  solved_ = false;
  const int n = free_cameras_;
  for (int j = 0; j < n; ++j) {
    for (int i = j; i < n; ++i) {
      auto target = block<N>(i, j);
      for (int k = 0; k < j; ++k) target -= block<N>(i, k) * block<N>(j, k).transpose();
      meter_.charge(Work::kBundleSolve, static_cast<int64_t>(N) * N * N * (j + 1));
      if (i == j) {
        if (!factorise(target)) co_return;
      } else {
        auto L = block<N>(j, j);
        solve_right_transposed(L, target);
      }
      co_await background_.slice();
    }
  }
  for (int i = 0; i < n; ++i) {
    auto x = rhs<N>(i);
    for (int k = 0; k < i; ++k) x -= block<N>(i, k) * rhs<N>(k);
    solve_lower(block<N>(i, i), x);
  }
  for (int i = n - 1; i >= 0; --i) {
    auto x = rhs<N>(i);
    for (int k = i + 1; k < n; ++k) x -= block<N>(k, i).transpose() * rhs<N>(k);
    solve_lower_transposed(block<N>(i, i), x);
  }
  meter_.charge(Work::kBundleSolve, static_cast<int64_t>(N) * N * n * n);
  solved_ = true;
  for (int i = 0; i < n; ++i) solved_ = solved_ && rhs<N>(i).allFinite();
}

// The step's poses, velocities and points, and what they cost at the same scale.
template <int N>
Task BundleAdjuster::evaluate_step() {
  new_cost_ = 0;
  for (Camera& camera : cameras_) {
    if (camera.column < 0) continue;
    const auto step = rhs<N>(camera.column);
    if (camera.pose_free) camera.T_new = SE3::exp(step.template head<6>()) * camera.T;
    if constexpr (N == 12) {
      camera.velocity_new = camera.velocity + step.template tail<6>();
      new_cost_ += prior_cost(camera, camera.velocity_new);
    }
  }
  for (Point& point : points_) {
    Vector3f b = point.eb;
    for (int k = point.first; k < point.first + point.count; ++k) {
      const Observation& o = observations_[k];
      const Camera& camera = cameras_[o.camera];
      if (camera.column < 0 || o.weight == 0) continue;
      const auto step = rhs<N>(camera.column);
      Vector2f shift = Vector2f::Zero();
      if (camera.pose_free) shift += o.A * step.template head<6>();
      if constexpr (N == 12) shift += o.A_v * step.template tail<6>();
      b -= o.weight * (o.B.transpose() * shift);
    }
    Matrix3f V = point.V;
    V.diagonal() *= 1 + lambda_;
    V.diagonal().array() += 1e-9f;
    const Vector3f step = V.inverse() * b;
    point.p_new = step.allFinite() ? Vector3f(point.p + step) : point.p;
    for (int k = point.first; k < point.first + point.count; ++k) {
      const Observation& o = observations_[k];
      const Camera& camera = cameras_[o.camera];
      Vector2f px;
      const Vector3f p_c = moved(camera.T_new * point.p_new, camera.velocity_new, o.dt_s);
      const float error_sq = config_.camera.project(p_c, &px) ? ((o.px - px) * o.inv_sigma).squaredNorm() : 1e12f;
      new_cost_ += tukey_cost(error_sq, sigma_);
    }
    meter_.charge(Work::kBundleProjection, point.count);
    co_await background_.slice();
  }
}

// Scales the new state about the first camera so that the last one stays as far from it as it was.
void BundleAdjuster::hold_scale() {
  const Vector3f origin = cameras_[0].T.centre();
  const Camera& last = cameras_.back();
  const float before = (last.T.centre() - origin).norm(), after = (last.T_new.centre() - origin).norm();
  if (!(before > 0) || !(after > 1e-3f * before)) return;
  const float scale = before / after;
  for (Camera& camera : cameras_) {
    const Vector3f centre = origin + scale * (camera.T_new.centre() - origin);
    camera.T_new.t = -(camera.T_new.R * centre);
    camera.velocity_new.head<3>() *= scale;
  }
  for (Point& point : points_) point.p_new = origin + scale * (point.p_new - origin);
}

// One accepted step, as a whole, into the map.
void BundleAdjuster::commit() {
  // A map that is not shown yet drifts in scale, which nothing else holds; the tracker follows it with a pose of the
  // scale that it was built with.
  if (!map_.ready) hold_scale();
  for (int k = 0; k < cameras_.size(); ++k) {
    Camera& camera = cameras_[k];
    if (camera.column < 0) continue;
    camera.T = camera.T_new = {orthonormalised(camera.T_new.R), camera.T_new.t};
    camera.velocity = camera.velocity_new;
    map_.keyframes[k].T_kw = camera.T;
    map_.keyframes[k].velocity = camera.velocity;
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
