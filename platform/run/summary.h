// What a run amounts to, in rows of words: for the terminal and the report.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "platform/run/evaluation.h"
#include "platform/run/run_log.h"

namespace pptam::platform {

struct SummaryRow {
  std::string label;
  std::string value;
};

struct RunSummary {
  std::optional<Evaluation> evaluation;
  std::vector<SummaryRow> judgement;  // what the laboratory says of the emulated phone's run, by its story
  std::string evaluation_trouble;     // why there is no evaluation although there is ground truth
  bool plane_known = false;           // the truth's z = 0 is the scene's ground
  std::string command;                // how to repeat the run
  std::string version;
  std::vector<std::string> warnings;  // a row each
};

std::vector<SummaryRow> summarise(const RunLog& log, const RunSummary& summary);
std::vector<SummaryRow> summarise(const Evaluation& evaluation);

}  // namespace pptam::platform
