// Bundle adjustment on plain cameras, points and observations, without a map [ptam 6.3].
//
// Minimises  sum_i rho(|e_i|^2) + 1/2 sum_k |(v_k - v0_k) / sigma_k|^2 sigma^2  over poses, velocities and points,
// where
//   e_i = (m_i - project(p_c)) / sigma_i,  p_c = q + dt_i (v + w x q),  q = R p + t,
// rho is the Tukey biweight at the robust scale sigma. The priors of the velocities (v, w) have the factor sigma^2, so
// that they keep their weight against the observations. Minimised by Levenberg-Marquardt:
//
//   measure ──▶ scale ──▶ linearise ──▶ reduce(lambda) ──▶ solve ──▶ step ──▶ measure ──▶ better? ──▶ accept
//                 ▲                        └──────────── no: lambda grows ─────────────┘ │ yes
//                 └──────────────────────────────────────────────────────────────────────┘
//
// The points are eliminated. For point i with normal equations V = L L^T (damped) and couplings W_a to the columns of
// its cameras,
//   Y_a = W_a L^-T,  S_ab -= Y_a Y_b^T,  b_a -= Y_a L^-1 e_p,  and back:  dp = L^-T (L^-1 e_p - sum_a Y_a^T d_a).
// A free pose is one column of 6x6 blocks and a free velocity another. N points, T observations each, M columns: O(NT)
// projections, O(NT^2) block products, O(M^3) solve.
//
// Every part is a coroutine that may pause after each point or block. Sums are taken in the order of points and
// observations, so that pauses change no bit. Scalar is float in the library; tests build it with double.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>

#include "base/containers.h"
#include "geometry/robust.h"
#include "mapping/block_system.h"
#include "scheduler/task.h"

namespace pptam {

struct BundleCapacity {
  int cameras = 0, points = 0, observations = 0;
  int observations_per_point = 0;
  int columns = 0;  // free poses and free velocities
};

struct BundleOptions {
  float sigma = 0;  // robust scale, units of the observations' sigma; 0: estimated; infinite: least squares
  // Relative fall of the cost by an accepted step under which adjustment has converged, a ratio. Nine of ten synthetic
  // maps then take at most eight iterations (tests/unit). Not swept.
  float converged_at = 1e-3f;
};

enum class BundleOutcome : uint8_t {
  kAccepted,   // the cost has fallen
  kRejected,   // the state is unchanged; the next attempt takes a shorter step
  kConverged,  // the cost has fallen by less than BundleOptions::converged_at
  kExhausted,  // the state is unchanged; no step lowers the cost
};

// Projection has two functions: bool project(int camera, const Vector3& p_c, Vector2* px) const, and one with a further
// argument Matrix23* J for d(px)/d(p_c). Both return false when p_c cannot be seen.
//
// One class with some thirty members: the arrays of one problem and of its normal equations, and the scalars of one
// iteration. Each part of an iteration reads most of them.
template <class Scalar, class Projection>
class BundleEngine {
 public:
  using Vector2 = Eigen::Matrix<Scalar, 2, 1>;
  using Vector3 = Eigen::Matrix<Scalar, 3, 1>;
  using Vector6 = Eigen::Matrix<Scalar, 6, 1>;
  using Matrix3 = Eigen::Matrix<Scalar, 3, 3>;
  using Matrix23 = Eigen::Matrix<Scalar, 2, 3>;

  struct State {
    Matrix3 R = Matrix3::Identity();  // world to camera
    Vector3 t = Vector3::Zero();
    Vector6 velocity = Vector6::Zero();  // translation, rotation
  };
  struct Camera {
    State now, tried;
    Vector6 velocity_prior = Vector6::Zero(), prior_information = Vector6::Zero();  // sigma^-2 of each component
    bool pose_free = false, velocity_free = false;
    int16_t pose_column = -1, velocity_column = -1;  // set by assign_columns(); -1: not free
  };
  struct Point {
    int32_t first = 0, count = 0;  // observations, by ascending camera, at most one of each
    Vector3 p = Vector3::Zero(), tried = Vector3::Zero();
    Scalar V[6] = {};       // lower triangle by columns
    Scalar e[3] = {};       // B^T w e
    Scalar factor[6] = {};  // L of the damped V, with the inverse of its diagonal, by columns
  };
  struct Observation {
    Vector2 px = Vector2::Zero();
    Scalar inverse_sigma = 1;
    Scalar dt_s = 0;      // time of its line relative to the frame's timestamp
    Scalar weight = 0;    // at the last linearisation; 0: an outlier
    Scalar error_sq = 0;  // of the last state measured; kUnseen when it does not project
    int16_t camera = 0;
    int16_t tag = 0;  // for the caller's use
  };

  BundleEngine(Arena& arena, const BundleCapacity& capacity, const Projection& projection, WorkMeter& meter,
               Background& background)
      : projection_(projection),
        meter_(meter),
        background_(background),
        cameras_(arena, capacity.cameras),
        points_(arena, capacity.points),
        observations_(arena, capacity.observations),
        couplings_(arena, capacity.observations * 2 * kCoupling),
        blocks_(arena, capacity.columns),
        camera_blocks_(arena, capacity.columns * 2 * kBlockNumbers),
        camera_rhs_(arena, capacity.columns * kBlock),
        eliminated_(arena, capacity.observations_per_point * 2 * kCoupling),
        eliminated_columns_(arena, capacity.observations_per_point * 2) {}

  FrameStack& frames() { return background_.frames(); }

  // The problem: fill, assign_columns(), start(); then linearise() and attempt() in turn.
  FixedVector<Camera>& cameras() { return cameras_; }
  FixedVector<Point>& points() { return points_; }
  FixedVector<Observation>& observations() { return observations_; }
  void clear() {
    cameras_.clear();
    points_.clear();
    observations_.clear();
  }
  // Gives every free pose and velocity a column. False when there are more than the capacity.
  bool assign_columns();
  int columns() const { return columns_; }
  // Resets the solver and measures the errors of the start.
  Task<> start(const BundleOptions& options);
  // Estimates the scale and linearises at the present state. Does nothing if the state has not changed.
  Task<> linearise();
  // One step from the last linearisation; its result is outcome().
  Task<> attempt();
  BundleOutcome outcome() const { return outcome_; }
  Scalar cost() const { return cost_; }  // of the present state, at scale sigma()
  Scalar sigma() const { return sigma_; }

 private:
  // Squared error of an observation that does not project, units of sigma^2: far above any real one, so that its cost
  // is saturated.
  static constexpr Scalar kUnseen = Scalar(1e12);
  static constexpr uint32_t kUnseenBits = std::bit_cast<uint32_t>(1e12f);
  static constexpr int kCoupling = 3 * kBlock;  // W or Y: element (r, c) at c * kBlock + r
  // Levenberg-Marquardt's damping, relative to the diagonal: first value, bounds, factor after an accepted step. A
  // rejected step multiplies it by 4, the next rejected one by 8, and so on. Not swept.
  static constexpr Scalar kFirstLambda = Scalar(1e-3), kMinLambda = Scalar(1e-6), kMaxLambda = Scalar(1e4);
  static constexpr Scalar kLambdaShrink = Scalar(0.2), kFirstGrowth = 4;
  static constexpr int kGrowthFactor = 2;
  // Added to the diagonal of the cameras' blocks, in their units: keeps columns without observations solvable.
  static constexpr Scalar kMinDiagonal = Scalar(1e-6);
  // Pivot of a point's V relative to its diagonal: smaller ones are directions that no observation constrains. Some ten
  // times float32's rounding.
  static constexpr Scalar kMinPivot = Scalar(1e-6);
  // Ratio of two costs up to which they are the same but for rounding.
  static constexpr Scalar kSameCost = 1 + 8 * std::numeric_limits<Scalar>::epsilon();
  static constexpr Scalar kMedianToSigma = Scalar(1.1774);  // sqrt(2 ln 2): median(|e|^2) = 2 ln 2 sigma^2

  // ARMv6 instructions, estimates. An iteration is counted as a whole (tests/budget).
  static constexpr int64_t kAcceptPointInstructions = 20;
  static constexpr int kCountDigitInstructions = 12;       // of one observation
  static constexpr int64_t kFindDigitInstructions = 3000;  // in the histogram
  static constexpr int64_t kClearBlockInstructions = 30;
  static constexpr int64_t kPrepareColumnInstructions = 500;
  static constexpr int64_t kStepCameraInstructions = 600;
  static constexpr int64_t kSubstituteRowInstructions = 200, kSubstituteBlockInstructions = 90;
  static constexpr int kDivisionProducts = 2;  // the division by a diagonal block, in units of block products
  // As counted: a point eliminated, and each of its columns, besides the products; an observation linearised in a
  // camera whose pose is not free, as most are in a local adjustment.
  static constexpr int64_t kReducePointInstructions = 380, kReduceColumnInstructions = 80;
  static constexpr int64_t kFixedProjectionInstructions = 335;

  Task<> measure();
  Task<> estimate_scale();
  Task<> reduce();
  Task<> solve();
  Task<> step();
  void count_digits(int from, int to);
  void measure_point(Point& point);
  int linearise_point(Point& point);
  Scalar linearise_observation(Point& point, int index);
  static void add_column(const Scalar* A, const Scalar* wB, const Scalar* we, Scalar weight, Scalar* __restrict U,
                         Scalar* __restrict rhs, Scalar* __restrict W);
  static void add_cross(const Scalar* A_v, const Scalar* A, Scalar weight, Scalar* __restrict U);
  void factorise_point(Point& point);
  int reduce_point(Point& point);
  void step_point(Point& point);
  void step_camera(Camera& camera);
  void prepare_system(const Camera& camera);
  Scalar prior_cost(const Camera& camera, const Vector6& velocity) const {
    if (!camera.velocity_free) return 0;
    return Scalar(0.5) * sigma_ * sigma_ * (velocity - camera.velocity_prior).cwiseAbs2().dot(camera.prior_information);
  }
  void accept();

  Scalar* coupling(int observation, int which) { return couplings_.data() + (2 * observation + which) * kCoupling; }
  // Blocks of a column: its diagonal block, and for a velocity the block with its camera's pose, the column before.
  Scalar* own_block(int column) { return camera_blocks_.data() + 2 * column * kBlockNumbers; }
  Scalar* cross_block(int column) { return own_block(column) + kBlockNumbers; }
  Scalar* camera_rhs(int column) { return camera_rhs_.data() + column * kBlock; }

  // Written out by element: small processors run Eigen's expressions through memory and calls.
  static Vector3 transformed(const State& T, const Vector3& p) {
    const auto row = [&](int i) { return T.R(i, 0) * p[0] + T.R(i, 1) * p[1] + T.R(i, 2) * p[2] + T.t[i]; };
    return {row(0), row(1), row(2)};
  }
  static Vector3 cross(const Vector3& a, const Vector3& b) {
    return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
  }
  // q + dt (v + w x q)
  static Vector3 moved(const Vector3& q, const Vector6& velocity, Scalar dt_s) {
    const Vector3 turn = cross({velocity[3], velocity[4], velocity[5]}, q);
    return {q[0] + dt_s * (velocity[0] + turn[0]), q[1] + dt_s * (velocity[1] + turn[1]),
            q[2] + dt_s * (velocity[2] + turn[2])};
  }
  // j (I, -hat(q)): j = d(e)/d(q) turned into the derivative by a left-multiplied motion, for a point at q.
  static void rigid_row(const Vector3& q, const Vector3& j, Scalar* row) {
    const Vector3 turn = cross(q, j);
    row[0] = j[0], row[1] = j[1], row[2] = j[2];
    row[3] = turn[0], row[4] = turn[1], row[5] = turn[2];
  }
  // rho(s) = c^2/6 (1 - (1 - s/c^2)^3) at s = error_sq; weight = 2 d(rho)/ds. Written so that small s do not cancel,
  // and that c may be infinite.
  Scalar tukey(Scalar error_sq, Scalar* weight) const {
    if (!(error_sq < cutoff_sq_)) {
      *weight = 0;
      return cutoff_sq_ * Scalar(1.0 / 6);
    }
    const Scalar a = 1 - error_sq * inverse_cutoff_sq_;
    *weight = a * a;
    return error_sq * (1 + a + a * a) * Scalar(1.0 / 6);
  }
  void set_sigma(Scalar sigma) {
    sigma_ = sigma;
    cutoff_sq_ = Scalar(kTukeyCutoff) * Scalar(kTukeyCutoff) * sigma * sigma;
    inverse_cutoff_sq_ = 1 / cutoff_sq_;
  }

  Projection projection_;
  WorkMeter& meter_;
  Background& background_;
  FixedVector<Camera> cameras_;
  FixedVector<Point> points_;
  FixedVector<Observation> observations_;
  FixedVector<Scalar> couplings_;
  BlockSystem<Scalar> blocks_;
  FixedVector<Scalar> camera_blocks_, camera_rhs_;
  FixedVector<Scalar> eliminated_;  // Y of one point
  FixedVector<int16_t> eliminated_columns_;

  struct Digits {
    uint32_t known = 0, mask = 0;  // digits found so far, and the bits that they occupy
    int shift = 0;                 // position of the digit being counted, bits
    int32_t histogram[256] = {};   // by the value of that digit
  };
  Digits median_;  // search for the median of the squared errors, by digits of 8 bits

  BundleOptions options_;
  int columns_ = 0;
  bool velocities_free_ = false;
  bool linearised_ = false;
  bool solved_ = false;
  BundleOutcome outcome_ = BundleOutcome::kRejected;
  Scalar sigma_ = 1, cutoff_sq_ = 1, inverse_cutoff_sq_ = 1;
  Scalar lambda_ = kFirstLambda, growth_ = kFirstGrowth;
  Scalar cost_ = 0, tried_cost_ = 0;
};

template <class Scalar, class Projection>
bool BundleEngine<Scalar, Projection>::assign_columns() {
  columns_ = 0;
  velocities_free_ = false;
  for (Camera& camera : cameras_) {
    camera.pose_column = camera.velocity_column = -1;
    if (camera.pose_free) camera.pose_column = static_cast<int16_t>(columns_++);
    if (camera.velocity_free) camera.velocity_column = static_cast<int16_t>(columns_++);
    velocities_free_ = velocities_free_ || camera.velocity_free;
  }
  return columns_ <= blocks_.max_rows();
}

template <class Scalar, class Projection>
Task<> BundleEngine<Scalar, Projection>::start(const BundleOptions& options) {
  options_ = options;
  couplings_.resize(couplings_.capacity());
  camera_blocks_.resize(columns_ * 2 * kBlockNumbers);
  camera_rhs_.resize(columns_ * kBlock);
  eliminated_.resize(eliminated_.capacity());
  eliminated_columns_.resize(eliminated_columns_.capacity());
  lambda_ = kFirstLambda;
  growth_ = kFirstGrowth;
  linearised_ = false;
  outcome_ = BundleOutcome::kRejected;
  for (Camera& camera : cameras_) camera.tried = camera.now;
  for (Point& point : points_) point.tried = point.p;
  set_sigma(1);
  co_await measure();
}

template <class Scalar, class Projection>
Task<> BundleEngine<Scalar, Projection>::attempt() {
  co_await reduce();
  co_await solve();
  bool better = false;
  if (solved_) {
    co_await step();
    co_await measure();
    better = tried_cost_ < cost_;
    // A step that leaves the cost the same means that the minimum is reached.
    if (!better && tried_cost_ < cost_ * kSameCost) {
      outcome_ = BundleOutcome::kExhausted;
      co_return;
    }
  }
  if (better) {
    outcome_ = cost_ - tried_cost_ < Scalar(options_.converged_at) * cost_ ? BundleOutcome::kConverged
                                                                           : BundleOutcome::kAccepted;
    accept();
  } else {
    lambda_ *= growth_;
    growth_ *= kGrowthFactor;
    outcome_ = lambda_ < kMaxLambda ? BundleOutcome::kRejected : BundleOutcome::kExhausted;
  }
}

template <class Scalar, class Projection>
void BundleEngine<Scalar, Projection>::accept() {
  for (Camera& camera : cameras_) camera.now = camera.tried;
  for (Point& point : points_) point.p = point.tried;
  cost_ = tried_cost_;
  lambda_ = std::max(lambda_ * kLambdaShrink, kMinLambda);
  growth_ = kFirstGrowth;
  linearised_ = false;
  meter_.charge(Work::kOther, kAcceptPointInstructions * points_.size());
}

// Errors and cost of the tried state, at the present scale.
template <class Scalar, class Projection>
Task<> BundleEngine<Scalar, Projection>::measure() {
  tried_cost_ = 0;
  for (const Camera& camera : cameras_) tried_cost_ += prior_cost(camera, camera.tried.velocity);
  for (Point& point : points_) {
    measure_point(point);
    co_await background_.spend(Work::kBundleError, point.count);
  }
}

template <class Scalar, class Projection>
void BundleEngine<Scalar, Projection>::measure_point(Point& point) {
  Scalar sum = 0;
  for (int k = point.first; k < point.first + point.count; ++k) {
    Observation& o = observations_[k];
    const State& camera = cameras_[o.camera].tried;
    const Vector3 p_c = moved(transformed(camera, point.tried), camera.velocity, o.dt_s);
    Vector2 px;
    o.error_sq = kUnseen;
    if (projection_.project(o.camera, p_c, &px)) {
      const Scalar e0 = (o.px[0] - px[0]) * o.inverse_sigma, e1 = (o.px[1] - px[1]) * o.inverse_sigma;
      o.error_sq = e0 * e0 + e1 * e1;
    }
    Scalar weight;
    sum += tukey(o.error_sq, &weight);
  }
  tried_cost_ += sum;
}

// sigma from the median of the squared errors, as robust_sigma() defines it. The median is found digit by digit in the
// errors' float representation, whose order is that of the numbers: counting digits can pause, nth_element cannot.
template <class Scalar, class Projection>
Task<> BundleEngine<Scalar, Projection>::estimate_scale() {
  if (options_.sigma > 0) {
    set_sigma(Scalar(options_.sigma));
    co_return;
  }
  median_ = Digits();
  int rank = 0;  // of the median among the errors that share the digits found so far
  for (median_.shift = 24; median_.shift >= 0; median_.shift -= 8) {
    std::fill_n(median_.histogram, 256, 0);
    constexpr int kChunk = 64;  // observations counted between two pauses
    for (int i = 0; i < observations_.size(); i += kChunk) {
      count_digits(i, std::min(i + kChunk, observations_.size()));
      co_await background_.spend(Work::kOther, kChunk * kCountDigitInstructions);
    }
    int count = 0;
    for (const int32_t n : median_.histogram) count += n;
    if (count == 0) break;
    if (median_.shift == 24) rank = count / 2;
    uint32_t digit = 0;
    while (rank >= median_.histogram[digit]) rank -= median_.histogram[digit++];
    median_.known |= digit << median_.shift;
    median_.mask |= 255u << median_.shift;
    meter_.charge(Work::kOther, kFindDigitInstructions);
  }
  const Scalar median(std::bit_cast<float>(median_.known));
  set_sigma(std::max(std::sqrt(median) / kMedianToSigma, Scalar(kRobustSigmaFloor)));
}

template <class Scalar, class Projection>
void BundleEngine<Scalar, Projection>::count_digits(int from, int to) {
  const uint32_t known = median_.known, mask = median_.mask;
  const int shift = median_.shift;
  const Observation* const end = observations_.data() + to;
  for (const Observation* o = observations_.data() + from; o != end; ++o) {
    const uint32_t bits = std::bit_cast<uint32_t>(static_cast<float>(o->error_sq));
    if (bits < kUnseenBits && (bits & mask) == known) ++median_.histogram[(bits >> shift) & 255];
  }
}

// Computes weights, normal equations of points and cameras, and their couplings, at the present state and its scale.
template <class Scalar, class Projection>
Task<> BundleEngine<Scalar, Projection>::linearise() {
  if (linearised_) co_return;
  co_await estimate_scale();
  std::fill(camera_blocks_.begin(), camera_blocks_.end(), Scalar(0));
  std::fill(camera_rhs_.begin(), camera_rhs_.end(), Scalar(0));
  cost_ = 0;
  for (const Camera& camera : cameras_) cost_ += prior_cost(camera, camera.now.velocity);
  for (Point& point : points_) {
    const int fixed = linearise_point(point);
    if (velocities_free_) meter_.charge(Work::kBundleMotion, point.count);
    meter_.charge(Work::kOther, kFixedProjectionInstructions * fixed);
    co_await background_.spend(Work::kBundleProjection, point.count - fixed);
  }
  linearised_ = true;
}

// Returns the number of its observations in cameras whose pose is not free.
template <class Scalar, class Projection>
int BundleEngine<Scalar, Projection>::linearise_point(Point& point) {
  std::fill_n(point.V, 6, Scalar(0));
  std::fill_n(point.e, 3, Scalar(0));
  Scalar sum = 0;
  int fixed = 0;
  for (int k = point.first; k < point.first + point.count; ++k) {
    sum += linearise_observation(point, k);
    fixed += cameras_[observations_[k].camera].pose_column < 0;
  }
  cost_ += sum;
  return fixed;
}

// Returns the observation's cost.
template <class Scalar, class Projection>
Scalar BundleEngine<Scalar, Projection>::linearise_observation(Point& point, int index) {
  Observation& o = observations_[index];
  const Camera& camera = cameras_[o.camera];
  const State& state = camera.now;
  const Vector3 q = transformed(state, point.p);
  Vector2 px;
  Matrix23 J;  // d(px)/d(p_c)
  if (!projection_.project(o.camera, moved(q, state.velocity, o.dt_s), &px, &J)) {
    const Scalar cost = tukey(kUnseen, &o.weight);
    o.weight = 0;  // also at an infinite scale, where tukey() gives no zero
    return cost;
  }
  const Scalar e[2] = {(o.px[0] - px[0]) * o.inverse_sigma, (o.px[1] - px[1]) * o.inverse_sigma};
  const Scalar cost = tukey(e[0] * e[0] + e[1] * e[1], &o.weight);
  if (o.weight == 0) return cost;

  // Rows of the derivatives of e: A by the pose, A_v by the velocity, B by the point; with j a row of d(px)/d(p_c),
  //   j_q = j (I + dt hat(w)),  A = j_q (I, -hat(q)),  A_v = dt j (I, -hat(q)),  B = j_q R.
  Scalar B[2 * 3], A[2 * kBlock], A_v[2 * kBlock];
#pragma GCC unroll 2
  for (int i = 0; i < 2; ++i) {
    const Vector3 j(J(i, 0) * o.inverse_sigma, J(i, 1) * o.inverse_sigma, J(i, 2) * o.inverse_sigma);
    const Vector3 turn = cross(j, {state.velocity[3], state.velocity[4], state.velocity[5]});
    const Vector3 j_q(j[0] + o.dt_s * turn[0], j[1] + o.dt_s * turn[1], j[2] + o.dt_s * turn[2]);
    rigid_row(q, j_q, A + i * kBlock);
    if (velocities_free_) rigid_row(q, {o.dt_s * j[0], o.dt_s * j[1], o.dt_s * j[2]}, A_v + i * kBlock);
#pragma GCC unroll 3
    for (int c = 0; c < 3; ++c) B[i * 3 + c] = state.R(0, c) * j_q[0] + state.R(1, c) * j_q[1] + state.R(2, c) * j_q[2];
  }

  Scalar wB[2 * 3];
  const Scalar we[2] = {o.weight * e[0], o.weight * e[1]};
#pragma GCC unroll 3
  for (int c = 0; c < 3; ++c) {
    wB[c] = o.weight * B[c];
    wB[3 + c] = o.weight * B[3 + c];
    point.e[c] = point.e[c] + B[c] * we[0] + B[3 + c] * we[1];
  }
  Scalar* V = point.V;
#pragma GCC unroll 3
  for (int c = 0; c < 3; ++c)
#pragma GCC unroll 3
    for (int r = c; r < 3; ++r, ++V) *V = *V + B[r] * wB[c] + B[3 + r] * wB[3 + c];
  const int pose = camera.pose_column, velocity = camera.velocity_column;
  if (pose >= 0) add_column(A, wB, we, o.weight, own_block(pose), camera_rhs(pose), coupling(index, 0));
  if (velocity >= 0) {
    add_column(A_v, wB, we, o.weight, own_block(velocity), camera_rhs(velocity), coupling(index, 1));
    if (pose >= 0) add_cross(A_v, A, o.weight, cross_block(velocity));
  }
  return cost;
}

// U += A^T w A (lower triangle), e_c += A^T w e, W = A^T w B.
template <class Scalar, class Projection>
void BundleEngine<Scalar, Projection>::add_column(const Scalar* A, const Scalar* wB, const Scalar* we, Scalar weight,
                                                  Scalar* __restrict U, Scalar* __restrict rhs, Scalar* __restrict W) {
#pragma GCC unroll 6
  for (int c = 0; c < kBlock; ++c) {
    const Scalar a0 = A[c], a1 = A[kBlock + c];
    rhs[c] = rhs[c] + a0 * we[0] + a1 * we[1];
#pragma GCC unroll 3
    for (int k = 0; k < 3; ++k) W[k * kBlock + c] = a0 * wB[k] + a1 * wB[3 + k];
    const Scalar w0 = weight * a0, w1 = weight * a1;
#pragma GCC unroll 6
    for (int r = c; r < kBlock; ++r) U[c * kBlock + r] = U[c * kBlock + r] + A[r] * w0 + A[kBlock + r] * w1;
  }
}

// U += A_v^T w A.
template <class Scalar, class Projection>
void BundleEngine<Scalar, Projection>::add_cross(const Scalar* A_v, const Scalar* A, Scalar weight,
                                                 Scalar* __restrict U) {
#pragma GCC unroll 6
  for (int c = 0; c < kBlock; ++c) {
    const Scalar w0 = weight * A[c], w1 = weight * A[kBlock + c];
#pragma GCC unroll 6
    for (int r = 0; r < kBlock; ++r) U[c * kBlock + r] = U[c * kBlock + r] + A_v[r] * w0 + A_v[kBlock + r] * w1;
  }
}

// Builds S and its right-hand side: the cameras' own blocks, damped, minus the Schur complement's part of every point.
template <class Scalar, class Projection>
Task<> BundleEngine<Scalar, Projection>::reduce() {
  blocks_.resize(columns_);
  for (int row = 0; row < columns_; ++row) {
    blocks_.clear_row(row);
    co_await background_.spend(Work::kOther, kClearBlockInstructions * (row + 1));
  }
  for (const Camera& camera : cameras_) prepare_system(camera);
  meter_.charge(Work::kOther, kPrepareColumnInstructions * columns_);
  for (Point& point : points_) {
    const int products = reduce_point(point);
    co_await background_.spend(Work::kBundleBlock, products);
  }
}

template <class Scalar, class Projection>
void BundleEngine<Scalar, Projection>::prepare_system(const Camera& camera) {
  for (const int column : {camera.pose_column, camera.velocity_column}) {
    if (column < 0) continue;
    Scalar* block = blocks_.block(column, column);
    Scalar* rhs = blocks_.rhs(column);
    std::copy_n(own_block(column), kBlockNumbers, block);
    std::copy_n(camera_rhs(column), kBlock, rhs);
    for (int i = 0; i < kBlock; ++i) {
      Scalar* diagonal = block + i * (kBlock + 1);
      if (column == camera.velocity_column) {
        const Scalar information = camera.prior_information[i] * sigma_ * sigma_;
        *diagonal += information;
        rhs[i] += information * (camera.velocity_prior[i] - camera.now.velocity[i]);
      }
      *diagonal = *diagonal * (1 + lambda_) + kMinDiagonal;
    }
  }
  if (camera.pose_column >= 0 && camera.velocity_column >= 0) {
    std::copy_n(cross_block(camera.velocity_column), kBlockNumbers,
                blocks_.block(camera.velocity_column, camera.pose_column));
    blocks_.connect(camera.velocity_column, camera.pose_column);
  }
}

// Subtracts one point's part from S and its right-hand side. Returns the number of block products.
template <class Scalar, class Projection>
int BundleEngine<Scalar, Projection>::reduce_point(Point& point) {
  factorise_point(point);
  const Scalar* L = point.factor;
  const Scalar f0 = point.e[0] * L[0], f1 = (point.e[1] - L[1] * f0) * L[3],
               f2 = (point.e[2] - L[2] * f0 - L[4] * f1) * L[5];
  int count = 0, products = 0;
  for (int k = point.first; k < point.first + point.count; ++k) {
    const Observation& o = observations_[k];
    if (o.weight == 0) continue;
    const Camera& camera = cameras_[o.camera];
    for (int which = 0; which < 2; ++which) {
      const int column = which == 0 ? camera.pose_column : camera.velocity_column;
      if (column < 0) continue;
      const Scalar* W = coupling(k, which);
      Scalar* Y = eliminated_.data() + count * kCoupling;
      Scalar* rhs = blocks_.rhs(column);
#pragma GCC unroll 6
      for (int r = 0; r < kBlock; ++r) {
        const Scalar y0 = W[r] * L[0], y1 = (W[kBlock + r] - L[1] * y0) * L[3],
                     y2 = (W[2 * kBlock + r] - L[2] * y0 - L[4] * y1) * L[5];
        Y[r] = y0;
        Y[kBlock + r] = y1;
        Y[2 * kBlock + r] = y2;
        rhs[r] -= y0 * f0 + y1 * f1 + y2 * f2;
      }
      eliminated_columns_[count] = static_cast<int16_t>(column);
      ++count;
      blocks_.connect(column, eliminated_columns_[0]);
      Scalar* row = blocks_.block(column, 0);
      for (int b = 0; b < count; ++b)
        subtract_product(row + eliminated_columns_[b] * kBlockNumbers, Y, eliminated_.data() + b * kCoupling, 3);
      products += count;
    }
  }
  meter_.charge(Work::kOther, kReducePointInstructions + kReduceColumnInstructions * count);
  return products;
}

// L of V with its diagonal multiplied by 1 + lambda. An unconstrained direction gets a zero, and so no step.
template <class Scalar, class Projection>
void BundleEngine<Scalar, Projection>::factorise_point(Point& point) {
  const Scalar damping = 1 + lambda_;
  const Scalar* V = point.V;
  Scalar* L = point.factor;
  const auto inverse_root = [](Scalar pivot, Scalar of) {
    return pivot > kMinPivot * of ? Scalar(1) / std::sqrt(pivot) : Scalar(0);
  };
  const Scalar v0 = V[0] * damping, v3 = V[3] * damping, v5 = V[5] * damping;
  L[0] = inverse_root(v0, v0);
  L[1] = V[1] * L[0];
  L[2] = V[2] * L[0];
  L[3] = inverse_root(v3 - L[1] * L[1], v3);
  L[4] = (V[4] - L[1] * L[2]) * L[3];
  L[5] = inverse_root(v5 - L[2] * L[2] - L[4] * L[4], v5);
}

template <class Scalar, class Projection>
Task<> BundleEngine<Scalar, Projection>::solve() {
  solved_ = false;
  for (int row = 0; row < columns_; ++row) {
    for (int column = blocks_.first(row); column <= row; ++column) {
      if (!blocks_.factorise(row, column)) co_return;
      co_await background_.spend(Work::kBundleSolve, blocks_.products(row, column) + kDivisionProducts);
    }
  }
  for (int row = 0; row < columns_; ++row) {
    blocks_.solve_forward(row);
    co_await background_.spend(Work::kOther,
                               kSubstituteRowInstructions + kSubstituteBlockInstructions * (row - blocks_.first(row)));
  }
  for (int row = columns_ - 1; row >= 0; --row) {
    blocks_.solve_backward(row);
    co_await background_.spend(Work::kOther,
                               kSubstituteRowInstructions + kSubstituteBlockInstructions * (row - blocks_.first(row)));
  }
  solved_ = true;
  for (int row = 0; row < columns_; ++row)
    for (int i = 0; i < kBlock; ++i) solved_ = solved_ && std::isfinite(blocks_.rhs(row)[i]);
}

// Computes the tried state from the solution.
template <class Scalar, class Projection>
Task<> BundleEngine<Scalar, Projection>::step() {
  for (Camera& camera : cameras_) step_camera(camera);
  meter_.charge(Work::kOther, kStepCameraInstructions * cameras_.size());
  for (Point& point : points_) {
    step_point(point);
    // A free velocity adds half as much again.
    co_await background_.spend(Work::kBundleStep, velocities_free_ ? 3 * point.count / 2 : point.count);
  }
}

// T <- exp(mu) T to first order, with Cayley's rotation (I - hat(a))^-1 (I + hat(a)), a = w / 2, which needs no sine:
// I + 2 / (1 + a.a) (hat(a) + hat(a)^2).
template <class Scalar, class Projection>
void BundleEngine<Scalar, Projection>::step_camera(Camera& camera) {
  if (camera.pose_column >= 0) {
    const Scalar* mu = blocks_.rhs(camera.pose_column);
    const Vector3 a(mu[3] * Scalar(0.5), mu[4] * Scalar(0.5), mu[5] * Scalar(0.5));
    Matrix3 H;
    H << 0, -a.z(), a.y(), a.z(), 0, -a.x(), -a.y(), a.x(), 0;
    const Matrix3 turn = Matrix3::Identity() + (2 / (1 + a.dot(a))) * (H + H * H);
    const Matrix3 R = turn * camera.now.R;
    // One Newton step to the nearest rotation, so that the rounding of many steps does not add up.
    camera.tried.R = R * (Scalar(1.5) * Matrix3::Identity() - Scalar(0.5) * (R.transpose() * R));
    camera.tried.t = turn * camera.now.t + Vector3(mu[0], mu[1], mu[2]);
  }
  if (camera.velocity_column >= 0) {
    const Scalar* step = blocks_.rhs(camera.velocity_column);
    for (int i = 0; i < kBlock; ++i) camera.tried.velocity[i] = camera.now.velocity[i] + step[i];
  }
}

template <class Scalar, class Projection>
void BundleEngine<Scalar, Projection>::step_point(Point& point) {
  Scalar b[3] = {point.e[0], point.e[1], point.e[2]};
  for (int k = point.first; k < point.first + point.count; ++k) {
    const Observation& o = observations_[k];
    if (o.weight == 0) continue;
    const Camera& camera = cameras_[o.camera];
    for (int which = 0; which < 2; ++which) {
      const int column = which == 0 ? camera.pose_column : camera.velocity_column;
      if (column < 0) continue;
      const Scalar* W = coupling(k, which);
      const Scalar* d = blocks_.rhs(column);
#pragma GCC unroll 6
      for (int r = 0; r < kBlock; ++r)
#pragma GCC unroll 3
        for (int c = 0; c < 3; ++c) b[c] -= W[c * kBlock + r] * d[r];
    }
  }
  const Scalar* L = point.factor;
  const Scalar f0 = b[0] * L[0], f1 = (b[1] - L[1] * f0) * L[3], f2 = (b[2] - L[2] * f0 - L[4] * f1) * L[5];
  const Scalar z = f2 * L[5], y = (f1 - L[4] * z) * L[3], x = (f0 - L[1] * y - L[2] * z) * L[0];
  point.tried = point.p + Vector3(x, y, z);
}

}  // namespace pptam
