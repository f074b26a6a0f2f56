#include "sim_phone/laboratory/judgement.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>

#include "platform/input_error.h"
#include "platform/run/evaluation.h"
#include "platform/run/statistics.h"
#include "platform/text.h"
#include "sim_phone/hand.h"

namespace pptam::laboratory {
namespace {

using namespace platform;

using Eigen::Isometry3d;
using Eigen::Matrix3d;
using Eigen::Vector3d;

// A true pose this near to one that was tracked rightly shows a known view: at half a metre 10 cm shift it by 11
// degrees, of the 37 x 48 that the phone sees.
constexpr double kKnownView_m = 0.1;
constexpr double kKnownView_deg = 12;

double seconds(int64_t timestamp_ns) {
  return 1e-9 * static_cast<double>(timestamp_ns);
}

double percent(int part, int whole) {
  return whole > 0 ? 100.0 * part / whole : kNone;
}

Vector3d rotation_vector(const Matrix3d& R) {
  const Eigen::AngleAxisd turn(R);
  return turn.angle() * turn.axis();
}

double angle_deg(const Matrix3d& R) {
  return Eigen::AngleAxisd(R).angle() / sim::kDegree;
}

// What the log and the truth say of each frame.
struct Moment {
  double t_s = 0;
  const FrameLog* frame = nullptr;
  const Isometry3d* truth = nullptr;  // null: not known
  bool valid = false;
  bool wrong = false;
  bool deliberate = false;  // sees a part of a deliberate loss
};

void judge_losses(const std::vector<Moment>& moments, const sim::Story& story, double exposed_s, Judgement* j) {
  double longest = 0;
  bool any_open = false;
  const double end_s = moments.back().t_s;
  const auto first_right = [&](double from_s) -> std::optional<double> {
    for (const Moment& m : moments) {
      if (m.t_s >= from_s && m.valid && !m.wrong) return m.t_s;
    }
    return std::nullopt;
  };
  // Counts a loss whose view is back at back_s, unless the run ends before it can be told.
  const auto count = [&](double back_s) {
    const std::optional<double> right_s = first_right(back_s);
    if (!right_s && end_s < back_s + kRecoveryLimit_s) return;
    ++j->losses;
    if (!right_s) {
      any_open = true;
      return;
    }
    longest = std::max(longest, *right_s - back_s);
    if (*right_s - back_s <= kRecoveryLimit_s) ++j->recovered;
  };

  const auto first_pose = std::find_if(moments.begin(), moments.end(), [](const Moment& m) { return m.valid; });
  for (const sim::Interval& lost : story.lost) {
    if (lost.from_s > first_pose->t_s && lost.to_s < end_s) count(lost.to_s + 0.5 * exposed_s);
  }
  const auto belongs_to_the_story = [&](double t_s) {
    return std::any_of(story.lost.begin(), story.lost.end(), [&](const sim::Interval& lost) {
      return t_s >= lost.from_s - 0.5 * exposed_s && t_s <= lost.to_s + 0.5 * exposed_s + kRecoveryLimit_s;
    });
  };
  for (auto m = first_pose; m != moments.end(); ++m) {
    if (!m->valid || std::next(m) == moments.end() || std::next(m)->valid) continue;
    const auto begin = std::next(m);
    if (belongs_to_the_story(begin->t_s)) continue;
    const auto back = std::find_if(begin, moments.end(), [&](const Moment& now) {
      const bool obstructed =
          std::any_of(story.obstructed.begin(), story.obstructed.end(), [&](const sim::Interval& hidden) {
            return now.t_s > hidden.from_s - 0.5 * exposed_s && now.t_s < hidden.to_s + 0.5 * exposed_s;
          });
      if (now.deliberate || obstructed || now.truth == nullptr) return false;
      return std::any_of(first_pose, begin, [&](const Moment& known) {
        return known.valid && !known.wrong && known.truth != nullptr &&
               (known.truth->translation() - now.truth->translation()).norm() < kKnownView_m &&
               angle_deg(known.truth->linear().transpose() * now.truth->linear()) < kKnownView_deg;
      });
    });
    if (back != moments.end()) count(back->t_s);
  }
  if (j->losses > 0 && !any_open) j->recovery_s = longest;
}

void judge_standstill(const std::vector<Moment>& moments, const sim::Standstill& still, double exposed_s, double scale,
                      Judgement* j) {
  constexpr double kSettle_s = 1;
  std::vector<const Moment*> resting;
  for (const Moment& m : moments) {
    if (m.valid && m.truth != nullptr && m.t_s > still.from_s + kSettle_s && m.t_s < still.step_from_s - exposed_s) {
      resting.push_back(&m);
    }
  }
  constexpr size_t kEnough = 30;  // 2 s: the rms is known within 13 % (1 / sqrt(2 * 30))
  if (resting.size() < kEnough) return;
  const double count = static_cast<double>(resting.size());
  Vector3d mean = Vector3d::Zero();
  for (const Moment* m : resting) mean += m->frame->T_wc.translation() / count;
  const Matrix3d reference = resting.front()->frame->T_wc.linear();
  Vector3d mean_turn = Vector3d::Zero();
  for (const Moment* m : resting) {
    mean_turn += rotation_vector(reference.transpose() * m->frame->T_wc.linear()) / count;
  }
  double position_sq = 0, turn_sq = 0, position_expected_sq = 0, turn_expected_sq = 0;
  for (const Moment* m : resting) {
    position_sq += (m->frame->T_wc.translation() - mean).squaredNorm() / count;
    turn_sq += (rotation_vector(reference.transpose() * m->frame->T_wc.linear()) - mean_turn).squaredNorm() / count;
    position_expected_sq += m->frame->position_sigma * m->frame->position_sigma / count;
    turn_expected_sq += m->frame->rotation_sigma * m->frame->rotation_sigma / count;
  }
  j->jitter_mm = 1000 * scale * std::sqrt(position_sq);
  j->jitter_deg = std::sqrt(turn_sq) / sim::kDegree;
  if (position_expected_sq > 0) j->jitter_mm_ratio = std::sqrt(position_sq / position_expected_sq);
  if (turn_expected_sq > 0) j->jitter_deg_ratio = std::sqrt(turn_sq / turn_expected_sq);

  // The step, in the resting camera's frame.
  const double angle = mean_turn.norm();
  Isometry3d rest = Isometry3d::Identity();
  rest.linear() =
      angle > 0 ? Matrix3d(reference * Eigen::AngleAxisd(angle, mean_turn / angle).toRotationMatrix()) : reference;
  rest.translation() = mean;
  const Isometry3d& truth_rest = *resting.front()->truth;
  int after = 0;
  for (const Moment& m : moments) {
    if (m.t_s < still.step_to_s || m.truth == nullptr) continue;
    const Isometry3d truth_step = truth_rest.inverse() * *m.truth;
    Isometry3d step = rest.inverse() * m.frame->T_wc;
    step.translation() *= scale;
    constexpr double kFollowed = 0.1;
    if (m.valid &&
        (step.translation() - truth_step.translation()).norm() <= kFollowed * truth_step.translation().norm() &&
        angle_deg(step.linear().transpose() * truth_step.linear()) <= kFollowed * angle_deg(truth_step.linear())) {
      j->lag_frames = after;
      return;
    }
    ++after;
  }
}

void judge_pans(const RunLog& log, const platform::Trajectory& truth, const std::vector<Moment>& moments,
                const sim::Story& story, Judgement* j) {
  constexpr double kAfter_s = 0.7;  // the story rests
  platform::Trajectory before;
  for (const auto& pose : log.trajectory()) {
    if (seconds(pose.timestamp_ns) < story.pans.front().from_s) before.push_back(pose);
  }
  std::optional<Evaluation> evaluation;
  try {
    evaluation = evaluate(before, truth, "run", "ground truth");
  } catch (const platform::InputError&) {
    return;  // there was no map before
  }
  for (const Moment& m : moments) {
    if (!m.valid || m.truth == nullptr) continue;
    const double error =
        100 * (evaluation->alignment * m.frame->T_wc.translation() - m.truth->translation()).norm() / story.pan_depth_m;
    for (const sim::Interval& pan : story.pans) {
      if (m.t_s > pan.from_s && m.t_s <= pan.to_s) j->pan_percent = std::fmax(j->pan_percent, error);
      if (m.t_s > pan.to_s && m.t_s <= pan.to_s + kAfter_s)
        j->after_pan_percent = std::fmax(j->after_pan_percent, error);
    }
  }
}

Hint usual_hint(const RunLog& log, double from_s) {
  std::map<Hint, int> counts;
  for (const FrameLog& frame : log.frames) {
    if (frame.pose_valid) break;
    if (seconds(frame.timestamp_ns) >= from_s) ++counts[frame.hint];
  }
  Hint usual = Hint::kNone;
  for (const auto& [hint, count] : counts) {
    if (count > counts[usual]) usual = hint;
  }
  return usual;
}

}  // namespace

Judgement::Judgement()
    : initialised_s(kNone),
      recovery_s(kNone),
      pan_percent(kNone),
      after_pan_percent(kNone),
      ate_percent(kNone),
      plane_deg(kNone),
      jitter_mm(kNone),
      jitter_mm_ratio(kNone),
      jitter_deg(kNone),
      jitter_deg_ratio(kNone),
      lag_frames(kNone) {}

double Judgement::tracked_percent() const {
  return percent(tracked, expected);
}
double Judgement::wrong_percent() const {
  return percent(wrong, poses);
}
double Judgement::wrong_good_percent() const {
  return percent(wrong_good, poses);
}

Judgement judge(const RunLog& log, const platform::Trajectory& truth, const sim::Story& story, double exposed_s) {
  Judgement j;
  for (const FrameLog& frame : log.frames) {
    if (frame.state == TrackingState::kTracking)
      j.minstructions.push_back(1e-6 * static_cast<double>(frame.instructions));
  }
  j.hint = usual_hint(log, story.move_s);
  const FrameLog* first = log.first_tracked();
  if (first == nullptr) return j;
  j.initialised = true;
  j.initialised_s = seconds(first->timestamp_ns) - story.move_s;

  std::optional<Evaluation> evaluation;
  try {
    evaluation = evaluate(log.trajectory(), truth, "run", "ground truth");
    j.ate_percent = evaluation->ate_percent();
    j.plane_deg = evaluation->vertical_error_deg;
  } catch (const platform::InputError&) {
    // Tracked for too short a time to be judged.
  }

  std::vector<Moment> moments;
  size_t associated = 0, true_pose = 0;
  for (const FrameLog& frame : log.frames) {
    Moment m;
    m.t_s = seconds(frame.timestamp_ns);
    m.frame = &frame;
    m.valid = frame.pose_valid;
    while (true_pose < truth.size() && truth[true_pose].timestamp_ns < frame.timestamp_ns) ++true_pose;
    if (true_pose < truth.size() && truth[true_pose].timestamp_ns == frame.timestamp_ns)
      m.truth = &truth[true_pose].T_wc;
    if (m.valid && evaluation) {
      while (associated < evaluation->poses.size() && evaluation->poses[associated].timestamp_ns < frame.timestamp_ns) {
        ++associated;
      }
      m.wrong = associated < evaluation->poses.size() &&
                evaluation->poses[associated].timestamp_ns == frame.timestamp_ns && evaluation->poses[associated].wrong;
    }
    m.deliberate = std::any_of(story.lost.begin(), story.lost.end(), [&](const sim::Interval& lost) {
      return m.t_s > lost.from_s - 0.5 * exposed_s && m.t_s < lost.to_s + 0.5 * exposed_s;
    });
    moments.push_back(m);
  }
  bool begun = false;
  for (size_t i = 0; i < moments.size(); ++i) {
    const Moment& m = moments[i];
    if (m.valid) {
      ++j.poses;
      if (m.wrong) ++j.wrong;
      if (m.wrong && m.frame->quality == TrackingQuality::kGood) ++j.wrong_good;
      if (m.wrong && begun && !moments[i - 1].valid) ++j.false_relocalisations;
      begun = true;
    }
    if (begun && !m.deliberate) {
      ++j.expected;
      if (m.valid) ++j.tracked;
    }
  }
  judge_losses(moments, story, exposed_s, &j);
  if (!story.pans.empty()) judge_pans(log, truth, moments, story, &j);
  if (story.standstill && evaluation) {
    judge_standstill(moments, *story.standstill, exposed_s, evaluation->robust_alignment.scale, &j);
  }
  return j;
}

std::vector<SummaryRow> summarise(const Judgement& j) {
  std::vector<SummaryRow> rows;
  if (!j.initialised) return rows;
  rows.push_back(
      {"after the movement", format("first pose %.2f s after the first sideways movement", j.initialised_s)});
  rows.push_back(
      {"tracked if expected", format("%d of %d frames (%.1f %%)", j.tracked, j.expected, j.tracked_percent())});
  rows.push_back({"wrong as good", format("%d of %d (%.2f %%)", j.wrong_good, j.poses, j.wrong_good_percent())});
  if (j.losses > 0 || j.false_relocalisations > 0) {
    const std::string longest =
        std::isnan(j.recovery_s) ? "not all were recovered" : format("longest %.2f s", j.recovery_s);
    rows.push_back({"recovered", format("%d of %d losses in time, %s; %d false relocalisations", j.recovered, j.losses,
                                        longest.c_str(), j.false_relocalisations)});
  }
  if (!std::isnan(j.jitter_mm)) {
    rows.push_back(
        {"standstill", format("%.3f mm rms, %.2f times the covariance's; %.4f degrees, %.2f times; followed "
                              "%.0f frames after the step",
                              j.jitter_mm, j.jitter_mm_ratio, j.jitter_deg, j.jitter_deg_ratio, j.lag_frames)});
  }
  return rows;
}

}  // namespace pptam::laboratory
