#include "platform/run/evaluation.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <numbers>
#include <optional>
#include <random>

#include <pocket_ptam/clock.h>
#include "platform/input_error.h"
#include "platform/run/statistics.h"
#include "platform/text.h"

namespace pptam::platform {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr double kDegrees = 180 / std::numbers::pi;
constexpr size_t kMinPoses = 3;  // a similarity has 7 unknowns, three positions give 9 equations
// A hand that accelerates by 2 m/s2 leaves the chord by a h^2 / 8 = 6 mm within 0.15 s: no more than what it moves, at
// 0.3 m/s, within the 0.02 s that are allowed between two poses taken for one.
constexpr int64_t kMaxInterpolatedNs = 150'000'000;
constexpr int64_t kMaxTimeDifferenceNs = 20'000'000;
constexpr double kMaxCoordinate = 1e15;  // a light day in millimetres; squares and products stay far from overflow

// From one pose to a later one; a trajectory's timestamps may lie anywhere.
int64_t elapsed_ns(const auto& from, const auto& to) {
  return saturated_difference(to.timestamp_ns, from.timestamp_ns);
}

int64_t distance_ns(int64_t a, int64_t b) {
  return saturated_difference(std::max(a, b), std::min(a, b));
}

double median(std::vector<double> values) {
  return values.empty() ? 0 : percentile(std::move(values), 0.5);
}

double median_interval_s(const Trajectory& trajectory) {
  std::vector<double> intervals;
  for (size_t i = 1; i < trajectory.size(); ++i) {
    intervals.push_back(1e-9 * static_cast<double>(elapsed_ns(trajectory[i - 1], trajectory[i])));
  }
  return median(intervals);
}

const StampedPose* first_not_before(const Trajectory& trajectory, int64_t timestamp_ns) {
  const auto found = std::lower_bound(trajectory.begin(), trajectory.end(), timestamp_ns,
                                      [](const StampedPose& a, int64_t t) { return a.timestamp_ns < t; });
  return trajectory.data() + (found - trajectory.begin());
}

// Between the two neighbours in time when they are close enough, else the nearest within kMaxTimeDifferenceNs.
std::optional<Eigen::Isometry3d> pose_at(const Trajectory& trajectory, int64_t timestamp_ns) {
  const StampedPose* after = first_not_before(trajectory, timestamp_ns);
  const StampedPose* end = trajectory.data() + trajectory.size();
  if (after != end && after->timestamp_ns == timestamp_ns) return after->T_wc;
  const StampedPose* before = after == trajectory.data() ? nullptr : after - 1;
  if (after != end && before != nullptr && elapsed_ns(*before, *after) <= kMaxInterpolatedNs) {
    const double share = static_cast<double>(timestamp_ns - before->timestamp_ns) /
                         static_cast<double>(after->timestamp_ns - before->timestamp_ns);
    const Eigen::Quaterniond q(before->T_wc.linear());
    Eigen::Isometry3d T_wc = Eigen::Isometry3d::Identity();
    T_wc.linear() = q.slerp(share, Eigen::Quaterniond(after->T_wc.linear())).normalized().toRotationMatrix();
    T_wc.translation() = (1 - share) * before->T_wc.translation() + share * after->T_wc.translation();
    return T_wc;
  }
  const StampedPose* nearest = after != end ? after : before;
  if (after != end && before != nullptr &&
      distance_ns(before->timestamp_ns, timestamp_ns) < distance_ns(after->timestamp_ns, timestamp_ns)) {
    nearest = before;
  }
  if (nearest == nullptr || distance_ns(nearest->timestamp_ns, timestamp_ns) > kMaxTimeDifferenceNs) return {};
  return nearest->T_wc;
}

// The sparser of the two keeps its times; the other one is interpolated.
std::vector<AssociatedPose> associate(const Trajectory& estimate, const Trajectory& truth, bool at_truth_times) {
  std::vector<AssociatedPose> poses;
  for (const StampedPose& pose : at_truth_times ? truth : estimate) {
    const std::optional<Eigen::Isometry3d> other = pose_at(at_truth_times ? estimate : truth, pose.timestamp_ns);
    if (!other) continue;
    AssociatedPose associated;
    associated.timestamp_ns = pose.timestamp_ns;
    associated.T_wc = at_truth_times ? *other : pose.T_wc;
    associated.truth_T_wc = at_truth_times ? pose.T_wc : *other;
    poses.push_back(associated);
  }
  return poses;
}

Similarity fit(const std::vector<AssociatedPose>& poses, const std::vector<size_t>& used) {
  Eigen::Matrix3Xd from(3, static_cast<Eigen::Index>(used.size()));
  Eigen::Matrix3Xd to(3, from.cols());
  for (Eigen::Index i = 0; i < from.cols(); ++i) {
    from.col(i) = poses[used[static_cast<size_t>(i)]].T_wc.translation();
    to.col(i) = poses[used[static_cast<size_t>(i)]].truth_T_wc.translation();
  }
  const Eigen::Matrix4d m = Eigen::umeyama(from, to, true);
  Similarity similarity;
  similarity.scale = std::cbrt(m.topLeftCorner<3, 3>().determinant());
  if (similarity.scale > 0) similarity.R = m.topLeftCorner<3, 3>() / similarity.scale;
  similarity.t = m.topRightCorner<3, 1>();
  return similarity;
}

std::vector<double> position_errors(const std::vector<AssociatedPose>& poses, const Similarity& similarity) {
  std::vector<double> errors;
  errors.reserve(poses.size());
  for (const AssociatedPose& pose : poses) {
    errors.push_back((similarity * pose.T_wc.translation() - pose.truth_T_wc.translation()).norm());
  }
  return errors;
}

// Poses that lie at least a hundredth of the extent apart along the truth: where the camera stood still counts once, so
// that a majority of them is a majority of the path.
std::vector<AssociatedPose> spread_poses(const std::vector<AssociatedPose>& poses, double extent) {
  std::vector<AssociatedPose> spread;
  for (const AssociatedPose& pose : poses) {
    if (spread.empty() ||
        (pose.truth_T_wc.translation() - spread.back().truth_T_wc.translation()).norm() >= 0.01 * extent) {
      spread.push_back(pose);
    }
  }
  return spread.size() >= kMinPoses ? spread : poses;
}

// Every so-manieth, so that what is tried hundreds of times takes seconds for hours of poses.
std::vector<AssociatedPose> thinned(const std::vector<AssociatedPose>& poses) {
  constexpr size_t kEnough = 20'000;  // 11 minutes at 30 per second, of which none is left out
  std::vector<AssociatedPose> some;
  const size_t step = 1 + (poses.size() - 1) / kEnough;
  for (size_t i = 0; i < poses.size(); i += step) some.push_back(poses[i]);
  return some;
}

// Least median of squares over triples, then least squares over what lies within 3 sigma of it, until that settles.
// Holds as long as more than half of the poses are right.
Similarity fit_robustly(const std::vector<AssociatedPose>& poses, const Similarity& start) {
  constexpr int kTriples = 300;  // with 40 % of wrong poses one triple in five is clean
  constexpr int kRefits = 10;
  if (poses.size() < kFewPoses) return start;  // some three of them agree by chance with half of the others
  Similarity best = start;
  double best_median = median(position_errors(poses, start));
  std::mt19937 random(1);  // a fixed seed: equal input, equal answer
  const auto draw = [&] { return static_cast<size_t>(random() % poses.size()); };
  for (int i = 0; i < kTriples; ++i) {
    const size_t a = draw();
    const size_t b = draw();
    const size_t c = draw();
    if (a == b || b == c || a == c) continue;
    const Similarity candidate = fit(poses, {a, b, c});
    if (!std::isfinite(candidate.scale) || !candidate.R.allFinite() || !(candidate.scale > 0)) continue;
    const double error = median(position_errors(poses, candidate));
    if (error < best_median) {
      best_median = error;
      best = candidate;
    }
  }
  for (int i = 0; i < kRefits; ++i) {
    const std::vector<double> errors = position_errors(poses, best);
    const double limit = 3 * median(errors) / 1.5382;  // median of the norm of a 3-D Gaussian of sigma 1
    std::vector<size_t> near;
    for (size_t k = 0; k < poses.size(); ++k) {
      if (errors[k] <= limit) near.push_back(k);
    }
    if (near.size() < kMinPoses) break;
    best = fit(poses, near);
  }
  return best;
}

Matrix3d nearest_rotation(const Matrix3d& m) {
  const Eigen::JacobiSVD<Matrix3d> svd(m, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Vector3d signs(1, 1, (svd.matrixU() * svd.matrixV().transpose()).determinant() < 0 ? -1 : 1);
  return svd.matrixU() * signs.asDiagonal() * svd.matrixV().transpose();
}

double angle_deg(const Matrix3d& R) {
  return kDegrees * Eigen::AngleAxisd(R).angle();
}

// The rotation between the worlds, from orientations alone: the one nearest to most, then the mean of those near it.
Matrix3d robust_world_rotation(const std::vector<AssociatedPose>& poses) {
  std::vector<Matrix3d> rotations;
  rotations.reserve(poses.size());
  for (const AssociatedPose& pose : poses) {
    rotations.push_back(pose.truth_T_wc.linear() * pose.T_wc.linear().transpose());
  }
  constexpr size_t kCandidates = 50;  // spread over the trajectory
  Matrix3d best = rotations.front();
  double best_median = std::numeric_limits<double>::infinity();
  const auto errors_of = [&](const Matrix3d& R) {
    std::vector<double> errors;
    errors.reserve(rotations.size());
    for (const Matrix3d& other : rotations) errors.push_back(angle_deg(R.transpose() * other));
    return errors;
  };
  for (size_t i = 0; i < kCandidates; ++i) {
    const Matrix3d& candidate = rotations[i * (rotations.size() - 1) / (kCandidates - 1)];
    const double error = median(errors_of(candidate));
    if (error < best_median) {
      best_median = error;
      best = candidate;
    }
  }
  const std::vector<double> errors = errors_of(best);
  Matrix3d sum = Matrix3d::Zero();
  for (size_t i = 0; i < rotations.size(); ++i) {
    if (errors[i] <= 3 * best_median) sum += rotations[i];
  }
  return sum.isZero() ? best : nearest_rotation(sum);
}

void measure_relative_motion(double scale, Evaluation* e) {
  constexpr int64_t kStepNs = 1'000'000'000;
  std::vector<double> intervals;
  for (size_t i = 1; i < e->poses.size(); ++i) {
    intervals.push_back(static_cast<double>(elapsed_ns(e->poses[i - 1], e->poses[i])));
  }
  // Beyond half an interval the pose itself is missing; beyond a tenth of the step it is not a second any more.
  const auto tolerance_ns = static_cast<int64_t>(std::min(0.5 * median(intervals), 0.1 * kStepNs));
  double translation_sq = 0;
  double rotation_sq = 0;
  size_t j = 0;
  for (const AssociatedPose& from : e->poses) {
    const int64_t target = saturated_sum(from.timestamp_ns, kStepNs);
    while (j + 1 < e->poses.size() &&
           distance_ns(e->poses[j + 1].timestamp_ns, target) <= distance_ns(e->poses[j].timestamp_ns, target)) {
      ++j;
    }
    const AssociatedPose& to = e->poses[j];
    if (distance_ns(to.timestamp_ns, target) > tolerance_ns) continue;
    const Eigen::Isometry3d truth = from.truth_T_wc.inverse() * to.truth_T_wc;
    Eigen::Isometry3d estimate = from.T_wc.inverse() * to.T_wc;
    estimate.translation() *= scale;
    const Eigen::Isometry3d error = truth.inverse() * estimate;
    translation_sq += error.translation().squaredNorm();
    const double angle = angle_deg(error.linear());
    rotation_sq += angle * angle;
    ++e->relative_pairs;
  }
  if (e->relative_pairs == 0) return;
  e->relative_translation = std::sqrt(translation_sq / e->relative_pairs);
  e->relative_rotation_deg = std::sqrt(rotation_sq / e->relative_pairs);
}

double covered_fraction(const Trajectory& estimate, const Trajectory& truth) {
  const double span = static_cast<double>(elapsed_ns(truth.front(), truth.back()));
  if (!(span > 0)) return 0;
  const double longest = 3e9 * median_interval_s(estimate);
  double covered = 0;
  for (size_t i = 1; i < estimate.size(); ++i) {
    const int64_t from = std::max(estimate[i - 1].timestamp_ns, truth.front().timestamp_ns);
    const int64_t to = std::min(estimate[i].timestamp_ns, truth.back().timestamp_ns);
    const double step = static_cast<double>(elapsed_ns(estimate[i - 1], estimate[i]));
    if (to > from && step <= longest) covered += static_cast<double>(saturated_difference(to, from));
  }
  return covered / span;
}

// How far the estimate goes between two times, in its own unit, by steps of at least 0.1 s: those of single frames
// would add up noise. Nothing where it has gaps. Longer steps than longest_step are jumps, not motion.
constexpr int64_t kPathStepNs = 100'000'000;
std::optional<double> path_between(const Trajectory& estimate, int64_t from_ns, int64_t to_ns, double longest_step) {
  const std::optional<Eigen::Isometry3d> begin = pose_at(estimate, from_ns);
  const std::optional<Eigen::Isometry3d> end = pose_at(estimate, to_ns);
  if (!begin || !end) return {};
  double length = 0;
  StampedPose last = {from_ns, *begin};
  int64_t seen_ns = from_ns;
  const auto go_to = [&](const StampedPose& pose) {
    const double step = (pose.T_wc.translation() - last.T_wc.translation()).norm();
    if (step <= longest_step) length += step;
    last = pose;
  };
  for (const StampedPose* pose = first_not_before(estimate, from_ns);
       pose != estimate.data() + estimate.size() && pose->timestamp_ns < to_ns; ++pose) {
    if (saturated_difference(pose->timestamp_ns, seen_ns) > kMaxInterpolatedNs) return {};
    seen_ns = pose->timestamp_ns;
    if (elapsed_ns(last, *pose) >= kPathStepNs) go_to(*pose);
  }
  if (saturated_difference(to_ns, seen_ns) > kMaxInterpolatedNs) return {};
  go_to({to_ns, *end});
  return length;
}

// Three times what nine tenths of the estimate's steps stay below.
double longest_step_of(const Trajectory& estimate) {
  std::vector<double> steps;
  const StampedPose* last = estimate.data();
  for (const StampedPose& pose : estimate) {
    const int64_t elapsed = elapsed_ns(*last, pose);
    if (elapsed < kPathStepNs) continue;
    if (elapsed <= kPathStepNs + kMaxInterpolatedNs) {
      steps.push_back((pose.T_wc.translation() - last->T_wc.translation()).norm());
    }
    last = &pose;
  }
  return steps.empty() ? 0 : 3 * percentile(std::move(steps), 0.9);
}

// Of the truth from the first to the last associated pose. Chords cut a sparse truth's path short: there the estimate
// says how far it went, where it is right.
double path_length(const Evaluation& e, const Trajectory& estimate, const Trajectory& truth) {
  double length = 0;
  double longest_step = -1;
  const auto right_at = [&](int64_t timestamp_ns) {
    const auto found = std::lower_bound(e.poses.begin(), e.poses.end(), timestamp_ns,
                                        [](const AssociatedPose& a, int64_t t) { return a.timestamp_ns < t; });
    return found != e.poses.end() && found->timestamp_ns == timestamp_ns && !found->wrong;
  };
  for (size_t i = 1; i < truth.size(); ++i) {
    const StampedPose& from = truth[i - 1];
    const StampedPose& to = truth[i];
    // Half a millisecond of slack keeps the ends that were associated with slightly different times.
    constexpr int64_t kSlackNs = 500'000;
    if (saturated_sum(from.timestamp_ns, kSlackNs) < e.poses.front().timestamp_ns) continue;
    if (saturated_difference(to.timestamp_ns, kSlackNs) > e.poses.back().timestamp_ns) break;
    double step = (to.T_wc.translation() - from.T_wc.translation()).norm();
    if (e.at_truth_times && elapsed_ns(from, to) > kMaxInterpolatedNs && right_at(from.timestamp_ns) &&
        right_at(to.timestamp_ns)) {
      if (longest_step < 0) longest_step = longest_step_of(estimate);
      const std::optional<double> estimated = path_between(estimate, from.timestamp_ns, to.timestamp_ns, longest_step);
      step = std::max(step, e.robust_alignment.scale * estimated.value_or(0));
    }
    length += step;
  }
  return std::max(length, e.extent);
}

void check_numbers(const Trajectory& trajectory, const std::string& name) {
  for (const StampedPose& pose : trajectory) {
    if (!pose.T_wc.matrix().allFinite() || pose.T_wc.translation().cwiseAbs().maxCoeff() > kMaxCoordinate) {
      throw InputError(name + format(": the pose at %.6f s is not finite or farther than 1e15 from the origin",
                                     1e-9 * static_cast<double>(pose.timestamp_ns)));
    }
  }
}

std::string span_text(const Trajectory& trajectory) {
  return format("from %.3f to %.3f s", 1e-9 * static_cast<double>(trajectory.front().timestamp_ns),
                1e-9 * static_cast<double>(trajectory.back().timestamp_ns));
}

[[noreturn]] void refuse_times(const Trajectory& estimate, const Trajectory& truth, const std::string& estimate_name,
                               const std::string& truth_name) {
  const bool apart = estimate.back().timestamp_ns < truth.front().timestamp_ns ||
                     truth.back().timestamp_ns < estimate.front().timestamp_ns;
  throw InputError(estimate_name + " runs " + span_text(estimate) + ", " + truth_name + " " + span_text(truth) +
                   ": no pose lies within 0.02 s of one of the other, " +
                   (apart ? "the two must count time from the same origin, in seconds"
                          : "and neither has them close enough, 0.15 s, to interpolate"));
}

}  // namespace

Evaluation evaluate(const Trajectory& estimate, const Trajectory& truth, const std::string& estimate_name,
                    const std::string& truth_name) {
  if (truth.empty()) throw InputError(truth_name + ": holds no poses, nothing to compare with");
  if (estimate.empty()) throw InputError(estimate_name + ": holds no poses, nothing to evaluate");
  Evaluation e;
  check_numbers(estimate, estimate_name);
  check_numbers(truth, truth_name);
  e.estimate_poses = static_cast<int>(estimate.size());
  e.truth_poses = static_cast<int>(truth.size());
  constexpr double kSparser =
      1.5;  // times the interval: frames that were dropped do not make the truth the sparser one
  e.at_truth_times = median_interval_s(truth) > kSparser * median_interval_s(estimate);
  e.poses = associate(estimate, truth, e.at_truth_times);
  if (e.poses.empty()) refuse_times(estimate, truth, estimate_name, truth_name);
  if (e.poses.size() < kMinPoses) {
    throw InputError(estimate_name + ": only " + std::to_string(e.poses.size()) + " poses match " + truth_name +
                     " in time, an alignment needs at least " + std::to_string(kMinPoses));
  }

  Vector3d low = e.poses.front().truth_T_wc.translation();
  Vector3d high = low;
  Vector3d estimate_low = e.poses.front().T_wc.translation();
  Vector3d estimate_high = estimate_low;
  for (const AssociatedPose& pose : e.poses) {
    low = low.cwiseMin(pose.truth_T_wc.translation());
    high = high.cwiseMax(pose.truth_T_wc.translation());
    estimate_low = estimate_low.cwiseMin(pose.T_wc.translation());
    estimate_high = estimate_high.cwiseMax(pose.T_wc.translation());
  }
  e.extent = (high - low).norm();
  constexpr double kNoMotion = 1e-9;
  if (e.extent < kNoMotion) throw InputError(truth_name + ": the camera does not move while it is tracked, no scale");
  if ((estimate_high - estimate_low).norm() < kNoMotion) {
    throw InputError(estimate_name + ": the camera does not move, no scale");
  }

  std::vector<size_t> all(e.poses.size());
  for (size_t i = 0; i < all.size(); ++i) all[i] = i;
  e.alignment = fit(e.poses, all);
  const std::vector<double> errors = position_errors(e.poses, e.alignment);
  double sum_sq = 0;
  for (size_t i = 0; i < errors.size(); ++i) {
    e.poses[i].aligned = e.alignment * e.poses[i].T_wc.translation();
    e.poses[i].position_error = errors[i];
    sum_sq += errors[i] * errors[i];
    e.ate_max = std::max(e.ate_max, errors[i]);
  }
  e.ate_rmse = std::sqrt(sum_sq / static_cast<double>(errors.size()));
  e.ate_median = median(errors);
  e.covered_fraction = covered_fraction(estimate, truth);

  e.robust_alignment = fit_robustly(thinned(spread_poses(e.poses, e.extent)), e.alignment);
  const std::vector<double> robust_errors = position_errors(e.poses, e.robust_alignment);
  const Matrix3d world_rotation = robust_world_rotation(thinned(e.poses));
  for (size_t i = 0; i < e.poses.size(); ++i) {
    AssociatedPose& pose = e.poses[i];
    const double rotation_deg = angle_deg(pose.truth_T_wc.linear().transpose() * world_rotation * pose.T_wc.linear());
    pose.wrong = robust_errors[i] > kWrongExtentFraction * e.extent || rotation_deg > kWrongRotationDeg;
    if (pose.wrong) ++e.wrong_poses;
  }
  e.wrong_fraction = static_cast<double>(e.wrong_poses) / static_cast<double>(e.poses.size());
  e.vertical_error_deg = kDegrees * std::atan2(world_rotation.col(2).head<2>().norm(), world_rotation(2, 2));
  e.path_length = path_length(e, estimate, truth);
  measure_relative_motion(e.robust_alignment.scale, &e);
  if (!std::isfinite(e.ate_percent()) || !std::isfinite(e.relative_translation) ||
      !std::isfinite(e.vertical_error_deg)) {
    throw InputError(estimate_name + " and " + truth_name + ": no alignment of the two gives finite numbers");
  }
  return e;
}

}  // namespace pptam::platform
