#include "platform/calibrate/readout_fit.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <utility>

#include "platform/calibrate/jackknife.h"
#include "platform/calibrate/motion_curve.h"
#include "platform/calibrate/plane_pose.h"
#include "platform/text.h"

namespace pptam::platform {
namespace {

using Axis = RollingShutter::Axis;
using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr int kReach = 2;               // neighbours on either side that tell the motion: a polynomial of degree four
constexpr double kMaxGap = 2.5;         // frame intervals between neighbours
constexpr int kSteps = 6;               // of the readout in either direction, up to the time between two frames
constexpr double kFinest = 1.0 / 48;    // last step, in frame intervals
constexpr int kPoseRounds = 4;          // of poses from motion and motion from poses
constexpr int kMinFrames = 30;          // three for each block of the jackknife
constexpr double kBadFrameRatio = 3;    // of a frame's rms to the median: a misread board
constexpr double kMaxSigma = 0.05;      // of the frame interval: beyond, the clip does not tell
constexpr double kMinGain = 3;          // standard deviations by which the better axis must be better
constexpr double kSure = 3;             // standard deviations, by which a readout that is smaller may be none
constexpr double kMaxUnsure_s = 0.002;  // of these together, before that is called a global shutter

struct MotionFrame {
  double speed_px_s = 0;
  std::vector<Vector2d> rays;    // (x/z, y/z) of the corners, undistorted
  std::vector<double> lines[2];  // by axis: (line - middle) / lines, from -0.5 to 0.5
  std::vector<size_t> near;      // frames before and after; empty: this one takes no part
  // The board's coordinates to the camera's, as of a global shutter.
  Eigen::Isometry3d still = Eigen::Isometry3d::Identity();
  TimedPose pose;  // the same under the readout at hand, at the frame's time
};

// A board read from its other end is the same board: the reading that is nearer to the frame before.
void align_to(const std::vector<Vector2d>& before, std::vector<Vector2d>* corners) {
  double forward = 0, turned = 0;
  const size_t n = corners->size();
  for (size_t i = 0; i < n; ++i) {
    forward += (before[i] - (*corners)[i]).norm();
    turned += (before[i] - (*corners)[n - 1 - i]).norm();
  }
  if (turned < forward) std::reverse(corners->begin(), corners->end());
}

class Clip {
 public:
  Clip(const Board& board, const BoardViews& views, const CameraModel& model)
      : focal_px_(static_cast<double>(model.fx)) {
    const std::vector<Vector2d> plane = board.plane();
    for (const Vector2d& p : plane) board_.emplace_back(p.x(), p.y(), 0);
    std::vector<Vector2d> before;
    for (const BoardView& view : views.views) {
      std::vector<Vector2d> corners = view.corners;
      if (!before.empty()) align_to(before, &corners);
      MotionFrame frame;
      frame.pose.t_s = 1e-9 * static_cast<double>(view.timestamp_ns - views.views.front().timestamp_ns);
      frame.speed_px_s = view.speed_px_s;
      for (const Vector2d& px : corners) {
        frame.rays.push_back(model.unproject(px.cast<float>()).cast<double>());
        frame.lines[0].push_back((px.y() - 0.5 * (model.height - 1)) / model.height);
        frame.lines[1].push_back((px.x() - 0.5 * (model.width - 1)) / model.width);
      }
      frame.still = plane_pose(plane, frame.rays);
      frames_.push_back(std::move(frame));
      before = std::move(corners);
    }
    link();
  }

  double interval_s() const { return interval_s_; }
  size_t corners() const { return board_.size(); }

  // Of the frames that take part.
  std::vector<double> speeds() const {
    std::vector<double> speeds;
    for (const MotionFrame& frame : frames_)
      if (!frame.near.empty()) speeds.push_back(frame.speed_px_s);
    return speeds;
  }

  // Sums of squared distances, px^2, of each frame that takes part.
  std::vector<double> costs(Axis axis, double readout_s) {
    for (MotionFrame& frame : frames_) {
      frame.pose.R = frame.still.linear();
      frame.pose.t = frame.still.translation();
    }
    std::vector<double> costs;
    for (int round = 0; round < kPoseRounds; ++round) {
      costs.clear();
      std::vector<MotionFrame> improved = frames_;
      for (size_t i = 0; i < frames_.size(); ++i) {
        if (!frames_[i].near.empty()) costs.push_back(improve(axis, readout_s, frames_[i], &improved[i]));
      }
      frames_ = std::move(improved);
    }
    return costs;
  }

  // Frames whose costs, in the order of costs(), are larger take part no more.
  void drop(const std::vector<double>& costs, double most) {
    size_t i = 0;
    for (MotionFrame& frame : frames_) {
      if (!frame.near.empty() && costs[i++] > most) frame.near.clear();
    }
  }

 private:
  // Which frames follow each other without a gap.
  void link() {
    std::vector<double> steps;
    for (size_t i = 1; i < frames_.size(); ++i) steps.push_back(frames_[i].pose.t_s - frames_[i - 1].pose.t_s);
    if (steps.empty()) return;
    std::nth_element(steps.begin(), steps.begin() + static_cast<ptrdiff_t>(steps.size() / 2), steps.end());
    interval_s_ = steps[steps.size() / 2];
    const auto follows = [&](size_t i) {  // on the one before
      const double step = frames_[i].pose.t_s - frames_[i - 1].pose.t_s;
      return step > 0.2 * interval_s_ && step < kMaxGap * interval_s_;
    };
    for (size_t i = 0; i < frames_.size(); ++i) {
      std::vector<size_t> before, after;
      for (size_t k = i; k > 0 && before.size() < kReach && follows(k); --k) before.push_back(k - 1);
      for (size_t k = i + 1; k < frames_.size() && after.size() < kReach && follows(k); ++k) after.push_back(k);
      if (before.empty() || after.empty()) continue;
      frames_[i].near = before;
      frames_[i].near.insert(frames_[i].near.end(), after.begin(), after.end());
    }
  }

  // One step of Gauss-Newton on the pose, the motion about it as it is. The cost before it.
  double improve(Axis axis, double readout_s, const MotionFrame& frame, MotionFrame* improved) const {
    std::vector<const TimedPose*> near;
    for (const size_t other : frame.near) near.push_back(&frames_[other].pose);
    const MotionCurve motion(frame.pose, near, interval_s_);
    Eigen::Matrix<double, 6, 6> A = Eigen::Matrix<double, 6, 6>::Zero();
    Eigen::Matrix<double, 6, 1> b = Eigen::Matrix<double, 6, 1>::Zero();
    double cost = 0;
    for (size_t i = 0; i < board_.size(); ++i) {
      const Eigen::Matrix<double, 6, 1> moved = motion.at(readout_s * frame.lines[axis == Axis::kColumns ? 1 : 0][i]);
      const Matrix3d turn = turn_by(moved.head<3>());
      const Vector3d turned = frame.pose.R * board_[i];
      const Vector3d q = turn * turned + frame.pose.t + moved.tail<3>();
      const Vector2d error = focal_px_ * (frame.rays[i] - Vector2d(q.x() / q.z(), q.y() / q.z()));
      cost += error.squaredNorm();
      Eigen::Matrix<double, 2, 3> J_px_q;
      J_px_q << 1 / q.z(), 0, -q.x() / (q.z() * q.z()), 0, 1 / q.z(), -q.y() / (q.z() * q.z());
      Eigen::Matrix<double, 2, 6> J;  // by turn and shift
      J << focal_px_ * J_px_q * turn * -cross_matrix(turned), focal_px_ * J_px_q;
      A += J.transpose() * J;
      b += J.transpose() * error;
    }
    const Eigen::Matrix<double, 6, 1> step = A.ldlt().solve(b);
    improved->pose.R = turn_by(step.head<3>()) * frame.pose.R;
    improved->pose.t = frame.pose.t + step.tail<3>();
    return cost;
  }

  std::vector<Vector3d> board_;
  std::vector<MotionFrame> frames_;
  double focal_px_;
  double interval_s_ = 0;
};

std::vector<double> capped(std::vector<double> values, double most) {
  for (double& value : values) value = std::min(value, most);
  return values;
}

// The search along one axis.
struct AxisFit {
  Axis axis = Axis::kRows;
  double readout_s = 0, sigma_s = 0;
  std::vector<double> costs;  // at about the minimum, by frame
  std::vector<ReadoutTrial> trials;
};

AxisFit fit_axis(Clip* clip, Axis axis) {
  AxisFit fit;
  fit.axis = axis;
  double least = INFINITY, best_s = 0;
  const auto attempt = [&](double readout_s) {
    std::vector<double> costs = clip->costs(axis, readout_s);
    const double cost = sum_of(costs);
    fit.trials.push_back({axis, readout_s, std::sqrt(cost / static_cast<double>(costs.size() * clip->corners()))});
    if (cost < least) least = cost, best_s = readout_s;
    return costs;
  };
  double step_s = clip->interval_s() / kSteps;
  for (int i = -kSteps; i <= kSteps; ++i) attempt(i * step_s);
  while (step_s > kFinest * clip->interval_s()) {
    step_s *= 0.5;
    const double middle_s = best_s;
    attempt(middle_s - step_s);
    attempt(middle_s + step_s);
  }
  fit.costs = attempt(best_s);
  const std::vector<double> before = attempt(best_s - 2 * step_s), after = attempt(best_s + 2 * step_s);
  const Minimum minimum = jackknifed_minimum(before, fit.costs, after, best_s, 2 * step_s, clip->interval_s());
  fit.readout_s = minimum.at;
  fit.sigma_s = minimum.sigma;
  std::sort(fit.trials.begin(), fit.trials.end(),
            [](const ReadoutTrial& a, const ReadoutTrial& b) { return a.readout_s < b.readout_s; });
  return fit;
}

// Leaves out frames in which the board was misread: far worse than the others under the best of a few readouts.
void drop_misread(Clip* clip, const std::vector<Axis>& axes) {
  std::vector<double> best;
  for (const Axis axis : axes) {
    for (int i = -2; i <= 2; ++i) {
      std::vector<double> costs = clip->costs(axis, 0.4 * i * clip->interval_s());
      if (best.empty() || sum_of(costs) < sum_of(best)) best = std::move(costs);
    }
  }
  clip->drop(best, kBadFrameRatio * kBadFrameRatio * median_of(best));
}

constexpr const char* kHowToMove =
    "move the camera before the board quickly to and fro, sideways and up and down and turning, for ten seconds or "
    "more, in bright light, with the whole board in view";

}  // namespace

ReadoutFit fit_readout(const Board& board, const BoardViews& views, const CameraModel& model, const std::string& axes) {
  ReadoutFit fit;
  if (views.views.size() < 3) {
    fit.trouble = format("the moving clip shows the board in %zu of %d frames: ", views.views.size(), views.looked_at) +
                  kHowToMove;
    return fit;
  }
  Clip clip(board, views, model);
  if (clip.speeds().size() < kMinFrames) {
    fit.trouble = format("the moving clip shows the board in too few frames that follow each other, %zu: ",
                         clip.speeds().size()) +
                  kHowToMove;
    return fit;
  }
  std::vector<Axis> tried;
  if (axes != "columns") tried.push_back(Axis::kRows);
  if (axes != "rows") tried.push_back(Axis::kColumns);
  drop_misread(&clip, tried);
  std::vector<AxisFit> fits;
  fits.reserve(tried.size());
  for (const Axis axis : tried) fits.push_back(fit_axis(&clip, axis));
  std::stable_sort(fits.begin(), fits.end(),
                   [](const AxisFit& a, const AxisFit& b) { return sum_of(a.costs) < sum_of(b.costs); });
  const AxisFit& best = fits.front();
  const std::vector<double> global = clip.costs(best.axis, 0);
  const double corners = static_cast<double>(best.costs.size() * clip.corners());
  fit.axis = best.axis;
  fit.readout_s = best.readout_s;
  fit.sigma_s = best.sigma_s;
  fit.rms_px = std::sqrt(sum_of(best.costs) / corners);
  fit.global_px = std::sqrt(sum_of(global) / corners);
  fit.frames = static_cast<int>(best.costs.size());
  fit.speed_px_s = median_of(clip.speeds());
  for (const AxisFit& one : fits) fit.trials.insert(fit.trials.end(), one.trials.begin(), one.trials.end());
  std::stable_sort(fit.trials.begin(), fit.trials.end(),
                   [](const ReadoutTrial& a, const ReadoutTrial& b) { return a.axis < b.axis; });

  const bool perhaps_global = std::abs(fit.readout_s) < kSure * fit.sigma_s;
  fit.global = perhaps_global && kSure * fit.sigma_s <= kMaxUnsure_s;
  const auto cannot = [&](const std::string& why) {
    fit.trouble = "this clip cannot tell the readout: " + why + ". To tell, " + kHowToMove;
  };
  if (fit.sigma_s > kMaxSigma * clip.interval_s()) {
    cannot(format("its corners move by %.0f px/s, which leaves it uncertain by %.1f ms", fit.speed_px_s,
                  1000 * fit.sigma_s));
  } else if (std::abs(fit.readout_s) > clip.interval_s()) {
    cannot(format("%.1f ms fit best, more than the %.1f ms between two frames: are the frames' times right (--fps)?",
                  1000 * fit.readout_s, 1000 * clip.interval_s()));
  } else if (perhaps_global && !fit.global) {
    cannot(format("%.1f ms fit best, but uncertain by %.1f ms they may be a global shutter's as well",
                  1000 * fit.readout_s, 1000 * fit.sigma_s));
  } else if (fits.size() == 2 && std::abs(fit.readout_s) > kMinGain * fit.sigma_s) {
    // Under the wrong axis a frame's pose may run away: its cost, a million times the others', would hide their gain.
    const double most = kBadFrameRatio * kBadFrameRatio * median_of(best.costs);
    const std::vector<double> costs = capped(best.costs, most), others = capped(fits[1].costs, most);
    const auto gain_without = [&](int block) { return mean_without(others, block) - mean_without(costs, block); };
    if (gain_without(-1) < kMinGain * jackknife_sigma(gain_without))
      cannot("rows and columns explain it alike; --axis rows or --axis columns decides, if it is known");
  }
  return fit;
}

}  // namespace pptam::platform
