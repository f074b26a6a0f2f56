#include "platform/calibrate/camera_fit.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <utility>

#include "platform/calibrate/jackknife.h"
#include "platform/text.h"

namespace pptam::platform {
namespace {

using Axis = RollingShutter::Axis;
using Eigen::Index;
using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::VectorXd;
using Matrix6d = Eigen::Matrix<double, 6, 6>;
using Vector6d = Eigen::Matrix<double, 6, 1>;

constexpr size_t kTrackReach = 2;        // neighbours on either side that tell the motion: a polynomial of degree four
constexpr double kMaxTrackGap = 2.5;     // frame intervals between neighbours
constexpr size_t kMinSeen = 10;          // points of a frame that takes part
constexpr size_t kMinTrackedViews = 30;  // that take part: three for each block of the jackknife
constexpr size_t kMinPoints = 15;
constexpr double kTukeyCutoff = 4.685;  // in robust sigmas
constexpr double kMinSigma_px = 0.05;   // of a residual, relative to its level's
constexpr int kReadoutTries = 4;        // of the readouts tried in either direction, up to the time between two frames
constexpr double kReadoutStep = 1.0 / 16;  // frame intervals between the three trials that tell the minimum
constexpr double kCorrelated = 3;  // times the standard deviation of independent residuals: a patch errs alike for long
constexpr double kFocalStep = 0.03;              // between the trials of a curve, of the logarithm of the focal length
constexpr double kMaxFocal = 4;                  // times the model's, or one over that
constexpr double kMaxReadoutSigma_s = 0.0015;    // beyond, the clip does not tell
constexpr double kMaxRelativeFocalSigma = 0.04;  // likewise, relative
// Standard deviations that neither sees, jackknife nor covariance: motion between frames is not quite a polynomial,
// patches are found with a bias, and a real lens distorts. In emulated clips errors are up to 3.2 ms and 0.6 %; in
// three real ones the focal length is 2 to 10 % off the published calibration.
constexpr double kUnseenReadoutSigma_s = 0.0005, kUnseenFocalSigma = 0.02;
constexpr double kSureOfReadout = 3;    // standard deviations, by which a readout that is smaller may be none
constexpr int kFewPoints = 60;          // for what is looked at after every run
constexpr double kDoubtedFocal = 0.12;  // relative change of the focal length that is worth saying
constexpr double kDoubted_s = 0.005;    // likewise, of the readout
constexpr double kDoubtSure = 4;        // standard deviations from what was assumed, to say so
constexpr double kMaxOtherGain = 0.7;   // of the better axis' gain over a global shutter, explained by the other one

constexpr const char* kHowToFilm =
    "look at a scene with depth, move the camera to and fro quickly and turn it to all sides, for ten seconds or more";

struct Seen {
  int point = 0;
  Vector2d px = Vector2d::Zero();
  double inverse_sigma = 1;
  double lines[2] = {0, 0};  // by axis: (line - middle) / lines, from -0.5 to 0.5
};

struct TrackedView {
  std::vector<Seen> seen;
  std::vector<size_t> near;  // views before and after
};

// All that is adjusted.
struct State {
  std::vector<TimedPose> poses;
  std::vector<Vector3d> points;
  double log_focal = 0;  // relative to the model's
  double readout_s = 0;
  Axis axis = Axis::kRows;
};

struct Unknown {
  bool focal = false, readout = false;
  Index count() const { return (focal ? 1 : 0) + (readout ? 1 : 0); }
};

// A residual with its derivatives.
struct Residual {
  Vector2d e = Vector2d::Zero();  // in sigmas
  double weight = 0;
  Eigen::Matrix<double, 2, 6> A;  // by the pose: turn, shift
  Eigen::Matrix<double, 2, 3> B;  // by the point
  Vector2d focal, readout;        // by the logarithm of the focal length, and by the readout
};

class Adjustment {
 public:
  Adjustment(const PointTracks& tracks, const CameraModel& model, int max_points) : model_(model) {
    choose_points(tracks, max_points);
    for (const PointTracks::View& view : tracks.views) {
      TrackedView entry;
      for (const PointTracks::Sighting& sighting : view.seen) {
        const auto found = index_.find(sighting.point);
        if (found == index_.end()) continue;
        Seen& seen = entry.seen.emplace_back();
        seen.point = found->second;
        seen.px = sighting.px.cast<double>();
        seen.inverse_sigma = 1 / static_cast<double>(sighting.sigma);
        seen.lines[0] = (seen.px.y() - 0.5 * (model.height - 1)) / model.height;
        seen.lines[1] = (seen.px.x() - 0.5 * (model.width - 1)) / model.width;
      }
      if (entry.seen.size() < kMinSeen) continue;
      views_.push_back(std::move(entry));
      start_.poses.push_back(view.pose);
    }
    link();
  }

  const State& start() const { return start_; }
  size_t views() const { return views_.size(); }
  size_t points() const { return start_.points.size(); }
  double interval_s() const { return interval_s_; }
  double sightings() const {
    double count = 0;
    for (const TrackedView& view : views_) count += static_cast<double>(view.seen.size());
    return count;
  }
  double mean_sigma_px() const {
    double sum = 0;
    for (const TrackedView& view : views_)
      for (const Seen& seen : view.seen) sum += 1 / seen.inverse_sigma;
    return sum / sightings();
  }

  // The robust scale of the residuals of a state; from then on all costs are by it.
  void set_sigma(const State& state) {
    std::vector<double> squares;
    for (size_t i = 0; i < views_.size(); ++i) {
      const MotionCurve motion = motion_about(state, i);
      for (const Seen& seen : views_[i].seen) squares.push_back(error_of(state, i, motion, seen).squaredNorm());
    }
    sigma_ = std::max(std::sqrt(median_of(std::move(squares))) / 1.1774, kMinSigma_px);
  }
  void use_sigma(double sigma) { sigma_ = sigma; }
  double sigma() const { return sigma_; }

  // Tukey costs of each view.
  std::vector<double> costs(const State& state) const {
    std::vector<double> costs(views_.size());
    for (size_t i = 0; i < views_.size(); ++i) {
      const MotionCurve motion = motion_about(state, i);
      for (const Seen& seen : views_[i].seen) {
        double weight = 0;
        costs[i] += tukey(error_of(state, i, motion, seen).squaredNorm(), &weight);
      }
    }
    return costs;
  }

  // Levenberg-Marquardt. Returns the cost. rescale: the robust scale is estimated anew after each step.
  double adjust(State* state, const Unknown& unknown, int max_iterations, bool rescale = false) {
    double lambda = 1e-4;
    double cost = sum_of(costs(*state));
    for (int i = 0; i < max_iterations && lambda < 1e4; ++i) {
      linearise(*state, unknown, lambda);
      const State tried = stepped(*state, unknown, lambda);
      const double tried_cost = sum_of(costs(tried));
      if (!(tried_cost < cost)) {
        lambda *= 10;
        continue;
      }
      const bool converged = tried_cost > cost * (1 - 1e-5);
      *state = tried;
      cost = tried_cost;
      lambda = std::max(0.1 * lambda, 1e-7);
      if (rescale) {
        set_sigma(*state);
        cost = sum_of(costs(*state));
      } else if (converged) {
        break;
      }
    }
    return cost;
  }

  // Standard deviation of the logarithm of the focal length, the only or first of the unknowns, were the residuals
  // independent.
  double log_focal_sigma(const State& state, const Unknown& unknown) {
    constexpr double kHardly = 1e-7;  // damping: position, attitude and size of the whole are free
    linearise(state, unknown, kHardly);
    S_.diagonal() *= 1 + kHardly;
    S_.diagonal().array() += 1e-9;
    const Index focal = S_.rows() - unknown.count();
    VectorXd unit = VectorXd::Zero(S_.rows());
    unit[focal] = 1;
    const VectorXd column = S_.selfadjointView<Eigen::Lower>().llt().solve(unit);
    return sigma_ * std::sqrt(column[focal]);
  }

 private:
  void choose_points(const PointTracks& tracks, int max_points) {
    std::map<uint32_t, int> sightings;
    for (const PointTracks::View& view : tracks.views) {
      for (const PointTracks::Sighting& seen : view.seen) {
        if (tracks.points.count(seen.point) > 0) ++sightings[seen.point];
      }
    }
    std::vector<std::pair<int, uint32_t>> order;  // most often seen first
    order.reserve(sightings.size());
    for (const auto& [id, count] : sightings) order.emplace_back(-count, id);
    std::sort(order.begin(), order.end());
    if (order.size() > static_cast<size_t>(max_points)) order.resize(static_cast<size_t>(max_points));
    for (const auto& [count, id] : order) {
      index_[id] = static_cast<int>(start_.points.size());
      start_.points.push_back(tracks.points.at(id));
    }
  }

  void link() {
    std::vector<double> steps;
    for (size_t i = 1; i < views_.size(); ++i) steps.push_back(start_.poses[i].t_s - start_.poses[i - 1].t_s);
    if (steps.empty()) return;
    interval_s_ = median_of(steps);
    const auto follows = [&](size_t i) {
      return steps[i - 1] > 0.2 * interval_s_ && steps[i - 1] < kMaxTrackGap * interval_s_;
    };
    for (size_t i = 0; i < views_.size(); ++i) {
      std::vector<size_t> before, after;
      for (size_t k = i; k > 0 && before.size() < kTrackReach && follows(k); --k) before.push_back(k - 1);
      for (size_t k = i + 1; k < views_.size() && after.size() < kTrackReach && follows(k); ++k) after.push_back(k);
      // At the end of a row of frames the motion would be extrapolated: its lines are all at its own time.
      if (before.empty() || after.empty()) continue;
      views_[i].near = std::move(before);
      views_[i].near.insert(views_[i].near.end(), after.begin(), after.end());
    }
  }

  MotionCurve motion_about(const State& state, size_t i) const {
    std::vector<const TimedPose*> near;
    if (state.readout_s != 0) {
      for (const size_t other : views_[i].near) near.push_back(&state.poses[other]);
    }
    return MotionCurve(state.poses[i], near, interval_s_);
  }

  // In the camera's frame at its line's time.
  Vector3d seen_at(const State& state, size_t i, const Vector6d& moved, const Seen& seen) const {
    const TimedPose& pose = state.poses[i];
    return turn_by(moved.head<3>()) * (pose.R * state.points[static_cast<size_t>(seen.point)]) + pose.t +
           moved.tail<3>();
  }

  static double line_of(const State& state, const Seen& seen) {
    return seen.lines[state.axis == Axis::kColumns ? 1 : 0];
  }

  bool project(const State& state, const Vector3d& q, Vector2d* px, Eigen::Matrix<double, 2, 3>* J) const {
    Vector2f at;
    Matrix23f J_at;
    if (!model_.project(q.cast<float>(), &at, &J_at)) return false;
    const double focal = std::exp(state.log_focal);
    const Vector2d centre(static_cast<double>(model_.cx), static_cast<double>(model_.cy));
    *px = centre + focal * (at.cast<double>() - centre);
    *J = focal * J_at.cast<double>();
    return true;
  }

  Vector2d error_of(const State& state, size_t i, const MotionCurve& motion, const Seen& seen) const {
    Vector2d px;
    Eigen::Matrix<double, 2, 3> J;
    const Vector6d moved = motion.at(state.readout_s * line_of(state, seen));
    if (!project(state, seen_at(state, i, moved, seen), &px, &J)) return Vector2d::Constant(1e3);
    return (seen.px - px) * seen.inverse_sigma;
  }

  double tukey(double squared, double* weight) const {
    const double cutoff = kTukeyCutoff * kTukeyCutoff * sigma_ * sigma_;
    const double left = 1 - std::min(squared / cutoff, 1.0);
    *weight = left * left;
    return cutoff / 3 * (1 - left * left * left);
  }

  Residual residual(const State& state, size_t i, const MotionCurve& motion, const Seen& seen) const {
    Residual r;
    const double line = line_of(state, seen);
    const Vector6d moved = motion.at(state.readout_s * line), rate = motion.rate(state.readout_s * line);
    const Matrix3d turn = turn_by(moved.head<3>());
    const Vector3d turned = state.poses[i].R * state.points[static_cast<size_t>(seen.point)];
    const Vector3d q = seen_at(state, i, moved, seen);
    Vector2d px;
    Eigen::Matrix<double, 2, 3> J;
    if (!project(state, q, &px, &J)) return r;
    J *= seen.inverse_sigma;
    r.e = (seen.px - px) * seen.inverse_sigma;
    tukey(r.e.squaredNorm(), &r.weight);
    r.A << J * turn * -cross_matrix(turned), J;
    r.B = J * turn * state.poses[i].R;
    r.focal = (px - Vector2d(static_cast<double>(model_.cx), static_cast<double>(model_.cy))) * seen.inverse_sigma;
    r.readout = J * (line * (rate.head<3>().cross(turn * turned) + rate.tail<3>()));
    return r;
  }

  // One view's part of the normal equations, for the way back.
  struct Eliminated {
    Matrix6d inverse;  // of its own block, damped
    Vector6d rhs;
    MatrixXd couplings;  // rows: three for each of its sightings, then the camera's unknowns
  };

  void linearise(const State& state, const Unknown& unknown, double lambda) {
    const Index size = 3 * static_cast<Index>(state.points.size()), all = size + unknown.count();
    S_.setZero(all, all);
    rhs_.setZero(all);
    eliminated_.resize(views_.size());
    for (size_t i = 0; i < views_.size(); ++i) add_view(state, unknown, lambda, i, size);
  }

  // Eigen's lower triangle of S_ is filled.
  void add_view(const State& state, const Unknown& unknown, double lambda, size_t i, Index size) {
    const TrackedView& view = views_[i];
    const MotionCurve motion = motion_about(state, i);
    const Index cameras = unknown.count(), count = static_cast<Index>(view.seen.size());
    Matrix6d own = Matrix6d::Zero();
    Eliminated& out = eliminated_[i];
    out.rhs.setZero();
    out.couplings.setZero(3 * count + cameras, 6);
    for (Index k = 0; k < count; ++k) {
      const Seen& seen = view.seen[static_cast<size_t>(k)];
      const Residual r = residual(state, i, motion, seen);
      if (r.weight == 0) continue;
      Eigen::Matrix<double, 2, Eigen::Dynamic, 0, 2, 2> C(2, cameras);
      Index column = 0;
      if (unknown.focal) C.col(column++) = r.focal;
      if (unknown.readout) C.col(column++) = r.readout;
      const Eigen::Matrix<double, 6, 2> wA = r.weight * r.A.transpose();
      own += wA * r.A;
      out.rhs += wA * r.e;
      out.couplings.middleRows<3>(3 * k) = r.B.transpose() * wA.transpose();
      const Index at = 3 * seen.point;
      S_.block<3, 3>(at, at) += r.weight * r.B.transpose() * r.B;
      rhs_.segment<3>(at) += r.weight * r.B.transpose() * r.e;
      if (cameras == 0) continue;
      out.couplings.bottomRows(cameras) += C.transpose() * wA.transpose();
      S_.block(size, at, cameras, 3) += r.weight * C.transpose() * r.B;
      S_.bottomRightCorner(cameras, cameras) += r.weight * C.transpose() * C;
      rhs_.tail(cameras) += r.weight * C.transpose() * r.e;
    }
    own.diagonal() *= 1 + lambda;
    own.diagonal().array() += 1e-9;
    out.inverse = own.inverse();
    eliminate(view, out, size, cameras);
  }

  void eliminate(const TrackedView& view, const Eliminated& out, Index size, Index cameras) {
    const Index count = static_cast<Index>(view.seen.size());
    const MatrixXd Y = out.couplings * out.inverse;
    const VectorXd known = Y * out.rhs;
    for (Index a = 0; a < count; ++a) {
      const Index row = 3 * view.seen[static_cast<size_t>(a)].point;
      rhs_.segment<3>(row) -= known.segment<3>(3 * a);
      const Eigen::Matrix<double, 3, 6> Y_a = Y.middleRows<3>(3 * a);
      for (Index b = 0; b < count; ++b) {
        const Index column = 3 * view.seen[static_cast<size_t>(b)].point;
        if (column > row) continue;
        S_.block<3, 3>(row, column) -= Y_a * out.couplings.middleRows<3>(3 * b).transpose();
      }
      if (cameras > 0)
        S_.block(size, row, cameras, 3) -= Y.bottomRows(cameras) * out.couplings.middleRows<3>(3 * a).transpose();
    }
    if (cameras == 0) return;
    S_.bottomRightCorner(cameras, cameras) -= Y.bottomRows(cameras) * out.couplings.bottomRows(cameras).transpose();
    rhs_.tail(cameras) -= known.tail(cameras);
  }

  // The state after the step that solves the system of linearise().
  State stepped(const State& state, const Unknown& unknown, double lambda) {
    // Position, attitude and size of the whole are free: damping holds them.
    S_.diagonal() *= 1 + lambda;
    S_.diagonal().array() += 1e-9;
    const VectorXd step = S_.selfadjointView<Eigen::Lower>().llt().solve(rhs_);
    State next = state;
    const Index cameras = unknown.count();
    for (size_t p = 0; p < next.points.size(); ++p) next.points[p] += step.segment<3>(3 * static_cast<Index>(p));
    Index at = 3 * static_cast<Index>(next.points.size());
    if (unknown.focal)
      next.log_focal = std::clamp(next.log_focal + step[at++], -std::log(kMaxFocal), std::log(kMaxFocal));
    if (unknown.readout)
      next.readout_s = std::clamp(next.readout_s + step[at++], -1.5 * interval_s_, 1.5 * interval_s_);
    for (size_t i = 0; i < views_.size(); ++i) {
      const Eliminated& view = eliminated_[i];
      Vector6d rhs = view.rhs;
      for (size_t k = 0; k < views_[i].seen.size(); ++k) {
        rhs -= view.couplings.middleRows<3>(3 * static_cast<Index>(k)).transpose() *
               step.segment<3>(3 * views_[i].seen[k].point);
      }
      if (cameras > 0) rhs -= view.couplings.bottomRows(cameras).transpose() * step.tail(cameras);
      const Vector6d moved = view.inverse * rhs;
      next.poses[i].R = turn_by(moved.head<3>()) * next.poses[i].R;
      next.poses[i].t += moved.tail<3>();
    }
    return next;
  }

  const CameraModel& model_;
  std::map<uint32_t, int> index_;  // of points, by id
  std::vector<TrackedView> views_;
  State start_;
  double interval_s_ = 0;
  double sigma_ = 1;
  MatrixXd S_;
  VectorXd rhs_;
  std::vector<Eliminated> eliminated_;
};

// One of the trials, all else adjusted.
struct Attempt {
  State state;
  std::vector<double> costs;  // by view
  double cost = INFINITY;
};

class Fit {
 public:
  Fit(Adjustment* adjustment, const RollingShutter& shutter, const CameraModel& model, const CameraFitOptions& options)
      : adjustment_(*adjustment), options_(options), start_(adjustment->start()) {
    start_.axis = shutter.axis;
    start_.readout_s = readout_of(shutter, model);
    adjustment_.set_sigma(start_);
    adjustment_.adjust(&start_, {options.focal, false}, kFirstSteps, true);
  }

  // Whether a few steps from what was assumed lead nowhere.
  bool stays(double readout_s, double log_focal) {
    const double assumed_s = start_.readout_s;
    for (const Axis axis : {Axis::kRows, Axis::kColumns}) {
      if (axis != start_.axis && assumed_s != 0) continue;  // a readout along another axis is far away
      State state = start_;
      state.axis = axis;
      adjustment_.adjust(&state, {true, true}, kFirstSteps, true);
      if (std::abs(state.readout_s - assumed_s) > readout_s || std::abs(state.log_focal) > log_focal) return false;
    }
    return true;
  }

  void run(CameraFit* fit) {
    std::vector<Attempt> bests;
    if (options_.readout) {
      for (const Axis axis : {Axis::kRows, Axis::kColumns}) {
        if (options_.axes == (axis == Axis::kRows ? "columns" : "rows")) continue;
        bests.push_back(best_readout(axis));
      }
    } else {
      bests.push_back(attempt(start_, {options_.focal, false}, kLastSteps));
    }
    // All are compared by the scale of the best.
    std::vector<double> sigmas;
    for (const Attempt& best : bests) {
      adjustment_.set_sigma(best.state);
      sigmas.push_back(adjustment_.sigma());
    }
    const size_t first = static_cast<size_t>(std::min_element(sigmas.begin(), sigmas.end()) - sigmas.begin());
    std::swap(bests[0], bests[first]);
    adjustment_.set_sigma(bests[0].state);
    const Unknown unknown = {options_.focal, options_.readout};
    for (Attempt& best : bests) best = attempt(best.state, unknown, kLastSteps);
    if (bests.size() == 2 && bests[1].cost < bests[0].cost) std::swap(bests[0], bests[1]);
    describe(bests, fit);
  }

 private:
  static constexpr int kFirstSteps = 10, kTrialSteps = 6, kLastSteps = 20;  // of adjustment

  Attempt attempt(const State& from, const Unknown& unknown, int max_steps) {
    Attempt attempt;
    attempt.state = from;
    attempt.cost = adjustment_.adjust(&attempt.state, unknown, max_steps);
    attempt.costs = adjustment_.costs(attempt.state);
    return attempt;
  }

  Attempt at_readout(State from, double readout_s) {
    from.readout_s = readout_s;
    return attempt_far(from, {options_.focal, false});
  }

  // From a state that is moved away from where it fits: its residuals would have no weight. They get a scale of their
  // own, which shrinks, before the common one.
  Attempt attempt_far(State from, const Unknown& unknown) {
    const double sigma = adjustment_.sigma();
    adjustment_.set_sigma(from);
    adjustment_.adjust(&from, unknown, kTrialSteps, true);
    adjustment_.use_sigma(sigma);
    return attempt(from, unknown, kTrialSteps);
  }

  Attempt best_readout(Axis axis) {
    State from = start_;
    from.axis = axis;
    from.readout_s = 0;
    adjustment_.set_sigma(from);
    Attempt best = attempt(from, {options_.focal, false}, kTrialSteps);
    for (const int direction : {-1, 1}) {
      State last = from;
      for (int i = 1; i <= kReadoutTries; ++i) {
        Attempt tried = at_readout(last, direction * i * adjustment_.interval_s() / kReadoutTries);
        last = tried.state;
        if (tried.cost < best.cost) best = std::move(tried);
      }
    }
    State state = best.state;
    adjustment_.set_sigma(state);
    adjustment_.adjust(&state, {options_.focal, true}, kLastSteps, true);
    best.state = std::move(state);
    return best;
  }

  double rms_px(double cost) const {
    return std::sqrt(0.5 * cost / adjustment_.sightings()) * adjustment_.mean_sigma_px();
  }

  void describe(const std::vector<Attempt>& bests, CameraFit* fit) {
    const Attempt& best = bests[0];
    fit->axis = best.state.axis;
    fit->rms_px = rms_px(best.cost);
    fit->focal.value = std::exp(best.state.log_focal);
    if (options_.readout) {
      const double step_s = kReadoutStep * adjustment_.interval_s();
      const Attempt low = at_readout(best.state, best.state.readout_s - step_s),
                    high = at_readout(best.state, best.state.readout_s + step_s), none = at_readout(best.state, 0);
      const Minimum minimum =
          jackknifed_minimum(low.costs, best.costs, high.costs, best.state.readout_s, step_s, adjustment_.interval_s());
      fit->readout_s.value = minimum.at;
      fit->readout_s.sigma = std::hypot(minimum.sigma, kUnseenReadoutSigma_s);
      fit->global_px = rms_px(none.cost);
      judge_readout(bests, none.cost, fit);
      if (options_.curves) {
        for (const Attempt& one : bests) draw_readouts(one, fit);
      }
    }
    if (options_.focal) {
      const double sigma = adjustment_.log_focal_sigma(best.state, {true, options_.readout});
      fit->focal.sigma = fit->focal.value * std::hypot(kCorrelated * sigma, kUnseenFocalSigma);
      judge_focal(fit);
      if (options_.curves) draw_focals(best, fit);
    }
  }

  Attempt at_focal(State from, double step) {
    from.log_focal += step;
    return attempt_far(from, {false, options_.readout});
  }

  void judge_readout(const std::vector<Attempt>& bests, double global_cost, CameraFit* fit) const {
    CameraFit::Estimate& readout = fit->readout_s;
    const bool perhaps_global = std::abs(readout.value) < kSureOfReadout * readout.sigma;
    fit->global = perhaps_global && readout.sigma <= kMaxReadoutSigma_s;
    const double interval_s = adjustment_.interval_s();
    if (!(readout.sigma <= kMaxReadoutSigma_s)) {
      readout.trouble = format("it leaves it uncertain by %.1f ms. To tell, ", 1000 * readout.sigma) + kHowToFilm;
    } else if (std::abs(readout.value) > interval_s + kSureOfReadout * readout.sigma) {
      readout.trouble = format(
          "%.1f ms fit best, more than the %.1f ms between two frames: are the frames' times "
          "right (--fps)?",
          1000 * readout.value, 1000 * interval_s);
    } else if (bests.size() == 2 && !fit->global &&
               global_cost - bests[1].cost > kMaxOtherGain * (global_cost - bests[0].cost)) {
      readout.trouble = "rows and columns explain it alike; --axis rows or --axis columns decides, if it is known";
    }
  }

  void judge_focal(CameraFit* fit) const {
    CameraFit::Estimate& focal = fit->focal;
    const double relative = focal.sigma / focal.value;
    if (!(relative <= kMaxRelativeFocalSigma))
      focal.trouble = format("it leaves it uncertain by %.1f %%. To tell, ", 100 * relative) + kHowToFilm;
  }

  void draw_readouts(const Attempt& best, CameraFit* fit) {
    const double interval_s = adjustment_.interval_s();
    std::vector<CameraFit::Trial> trials;
    const auto keep = [&](const Attempt& tried) {
      trials.push_back({tried.state.axis, tried.state.readout_s, std::exp(tried.state.log_focal), rms_px(tried.cost)});
    };
    keep(best);
    for (const int direction : {-1, 1}) {
      State last = best.state;
      const double first = std::ceil(direction * best.state.readout_s / interval_s * 2 * kReadoutTries + 0.01);
      for (int i = static_cast<int>(first); i <= 2 * kReadoutTries; ++i) {
        const Attempt tried = at_readout(last, direction * i * interval_s / (2 * kReadoutTries));
        keep(tried);
        last = tried.state;
      }
    }
    std::sort(trials.begin(), trials.end(),
              [](const CameraFit::Trial& a, const CameraFit::Trial& b) { return a.readout_s < b.readout_s; });
    fit->readouts.insert(fit->readouts.end(), trials.begin(), trials.end());
  }

  void draw_focals(const Attempt& best, CameraFit* fit) {
    const auto trial = [&](const Attempt& tried) {
      return CameraFit::Trial{tried.state.axis, tried.state.readout_s, std::exp(tried.state.log_focal),
                              rms_px(tried.cost)};
    };
    fit->focals.push_back(trial(best));
    for (const int direction : {-1, 1}) {
      State last = best.state;
      for (int i = 1; i <= 2 * kReadoutTries; ++i) {
        const Attempt tried = at_focal(last, direction * kFocalStep);
        fit->focals.push_back(trial(tried));
        last = tried.state;
      }
    }
    std::sort(fit->focals.begin(), fit->focals.end(),
              [](const CameraFit::Trial& a, const CameraFit::Trial& b) { return a.focal < b.focal; });
  }

  Adjustment& adjustment_;
  const CameraFitOptions& options_;
  State start_;
};

}  // namespace

void PointTracks::add(const TrackResult& result) {
  if (!result.status.ok() || !result.pose_valid || result.repeated) return;
  if (views.size() == 2 * kMaxViews) views.erase(views.begin(), views.begin() + static_cast<ptrdiff_t>(kMaxViews));
  View view;
  view.pose.t_s = 1e-9 * static_cast<double>(result.timestamp_ns);
  view.pose.R = result.T_cw.R.cast<double>();
  view.pose.t = result.T_cw.t.cast<double>();
  for (const ObservedPoint& point : result.points) {
    if (point.kind != ObservedKind::kInlier && point.kind != ObservedKind::kOutlier) continue;
    view.seen.push_back({point.point_id, point.px, ImagePoint{point.px, point.level}.sigma()});
  }
  views.push_back(std::move(view));
}

void PointTracks::finish(std::span<const MapPointInfo> map_points) {
  for (const MapPointInfo& point : map_points) points[point.id] = point.p_w.cast<double>();
}

double readout_of(const RollingShutter& shutter, const CameraModel& model) {
  return static_cast<double>(shutter.line_time_s) * (shutter.axis == Axis::kColumns ? model.width : model.height);
}

double readout_change_s(const CameraFit& fit, double assumed_s, Axis assumed_axis) {
  const double found_s = fit.global ? 0 : fit.readout_s.value;
  return fit.axis == assumed_axis ? std::abs(found_s - assumed_s) : std::max(std::abs(found_s), std::abs(assumed_s));
}

CameraFit fit_camera(const PointTracks& tracks, const CameraModel& model, const RollingShutter& shutter,
                     const CameraFitOptions& options) {
  CameraFit fit;
  CameraModel prepared = model;
  prepared.prepare();
  Adjustment adjustment(tracks, prepared, options.max_points);
  fit.frames = static_cast<int>(adjustment.views());
  fit.points = static_cast<int>(adjustment.points());
  fit.interval_s = adjustment.interval_s();
  if (adjustment.views() < kMinTrackedViews || adjustment.points() < kMinPoints) {
    fit.trouble = format("%d frames with %d points were tracked, too few to tell anything of the camera: ", fit.frames,
                         fit.points) +
                  kHowToFilm;
    return fit;
  }
  Fit(&adjustment, shutter, model, options).run(&fit);
  return fit;
}

CameraDoubts doubt_camera(const PointTracks& tracks, const CameraModel& model, const RollingShutter& shutter) {
  CameraDoubts doubts;
  CameraFitOptions options;
  options.focal = true;
  options.curves = false;
  options.max_points = kFewPoints;
  CameraModel prepared = model;
  prepared.prepare();
  Adjustment adjustment(tracks, prepared, options.max_points);
  if (adjustment.views() < kMinTrackedViews || adjustment.points() < kMinPoints) return doubts;
  if (Fit(&adjustment, shutter, prepared, options).stays(0.5 * kDoubted_s, 0.2 * kDoubtedFocal)) return doubts;
  options.max_points = CameraFitOptions().max_points;
  doubts.fit = fit_camera(tracks, model, shutter, options);
  const CameraFit& fit = doubts.fit;
  if (!fit.trouble.empty()) return doubts;
  const double log_focal = std::log(fit.focal.value);
  doubts.focal = fit.focal.trouble.empty() && std::abs(log_focal) > kDoubtedFocal &&
                 std::abs(log_focal) > kDoubtSure * fit.focal.sigma / fit.focal.value;
  const double change_s = readout_change_s(fit, readout_of(shutter, model), shutter.axis);
  doubts.readout =
      fit.readout_s.trouble.empty() && change_s > kDoubted_s && change_s > kDoubtSure * fit.readout_s.sigma;
  return doubts;
}

}  // namespace pptam::platform
