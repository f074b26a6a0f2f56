// The model-based tracker in the stories of a known object, judged by the truth: one run, or all stories with other
// ways of [vvs] side by side.
#pragma once

#include <string>
#include <vector>

#include <pocket_ptam/model_tracker.h>
#include "platform/camera.h"
#include "platform/run/summary.h"

namespace pptam::laboratory {

// Errors: mean distance of the model's projected points from the truth. Kept: within 10 px.
struct ModelJudgement {
  int frames = 0, tracked = 0, kept = 0;
  int wrong = 0;                     // poses off by over 20 px
  int first_bad = -1;                // frame that is not kept; -1: none
  bool to_the_end = false;           // the last frame is kept
  double mean_px = 0, worst_px = 0;  // of frames that are tracked
  double mean_degrees = 0;
};

// Tracks to the camera's end, from the first frame's true pose. model: .cao text in the world's frame.
ModelJudgement judge_model_run(platform::Camera& camera, const std::string& model, const ModelMethod& method = {});
std::vector<platform::SummaryRow> summarise(const ModelJudgement& judgement);

struct ModelStudyOptions {
  std::vector<std::string> stories;  // empty: all of a known object
  int seeds = 5;                     // 1 to seeds
  int jobs = 1;
};

// Prints a table for each question: eq. 24 against a fixed threshold, the scale once against in each iteration, a
// constant Jacobian against the full one. False when not all runs could be finished, or a story is not tracked to its
// end as it should be.
bool run_model_study(const ModelStudyOptions& options);

}  // namespace pptam::laboratory
