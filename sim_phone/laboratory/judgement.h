// Judges one run of the emulated phone by ground truth: what was tracked, what was wrong, what was found again, how
// still it stood and what it cost. The numbers of the suite's table.
#pragma once

#include <vector>

#include "platform/run/run_log.h"
#include "platform/run/summary.h"
#include "sim_phone/story.h"

namespace pptam::laboratory {

constexpr double kRecoveryLimit_s = 1;  // from the view's return to a right pose

// The numbers of a row of the suite, hence so many members. A value that does not exist in a run (its tracking never
// began, its story has no standstill) is NaN.
struct Judgement {
  bool initialised = false;
  double initialised_s;  // from the first sideways movement to the first pose

  // Frames from the first pose on, without those in which tracking cannot be expected.
  int expected = 0, tracked = 0;
  double tracked_percent() const;

  // Poses reported as valid; wrong ones as Evaluation defines them, scale jumps included: one similarity aligns all.
  int poses = 0, wrong = 0, wrong_good = 0;
  double wrong_percent() const;
  double wrong_good_percent() const;

  int false_relocalisations = 0;  // first poses after a loss that are wrong
  // Losses whose view returned: those that the story wants, at their end; others from when the true pose is near one
  // that was tracked rightly before and nothing is in the way. Recovered: with a right pose within kRecoveryLimit_s; a
  // pose found before the view is back counts as found at once.
  int losses = 0, recovered = 0;
  double recovery_s;  // the longest; NaN when there was none or one never ended

  Hint hint = Hint::kNone;  // the one given most often while there is no pose, from the first movement on

  // The largest error of the position during the story's pans, and in the 0.7 s after each, in percent of the scene's
  // depth; aligned by the poses before the first.
  double pan_percent, after_pan_percent;

  double ate_percent;  // of the path
  double plane_deg;    // error of the vertical

  // In the standstill: rms of the pose about its mean, scaled to the truth; ratio: to the reported covariance's rms.
  double jitter_mm, jitter_mm_ratio, jitter_deg, jitter_deg_ratio;
  // Frames from the first one after the story's step until one follows it to within a tenth; 0: the first one does.
  double lag_frames;

  std::vector<double> minstructions;  // modelled, of each frame tracked with a map

  Judgement();
};

// exposed_s: from the first line's first light to the last line's last light; frames that see a part of a deliberate
// loss belong to it. The story's times are the frames' timestamps.
Judgement judge(const platform::RunLog& log, const platform::Trajectory& truth, const sim::Story& story,
                double exposed_s);

std::vector<platform::SummaryRow> summarise(const Judgement& judgement);

}  // namespace pptam::laboratory
