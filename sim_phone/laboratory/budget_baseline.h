// A budget kept in a file, and a later one compared with it, stage by stage.
#pragma once

#include <cstddef>
#include <functional>
#include <map>
#include <span>
#include <string>
#include <vector>

#include "sim_phone/laboratory/budget.h"

namespace pptam::laboratory {

// A stage has become dearer when its mean has grown by more than the first share of itself, or by more than the second
// one of a whole frame's mean. By the work clock equal programs have equal figures; these leave room for the chance by
// which other timing changes a map.
constexpr double kStageTolerance = 0.1;
constexpr double kFrameTolerance = 0.025;
constexpr size_t kMaxBaselineBytes = 64 * 1024;  // one has under 1 kB

// As CSV, sealed (platform/outputs.h).
std::string baseline_text(const BudgetOptions& options, const BudgetReport& report);
// Such a text, as it was written.
bool is_baseline(std::span<const std::byte> content);

struct Baseline {
  std::string phone;                                   // its name
  std::map<std::string, double, std::less<>> mean_ms;  // by stage, and of tracking
};
// text: of an earlier baseline; name stands for it in messages. Throws InputError when it is none or not a whole one,
// was changed since, or was made with other stories or another seed or camera than the options.
Baseline read_baseline(const std::string& text, const std::string& name, const BudgetOptions& options);

struct BudgetChange {
  std::string what;  // a stage, or tracking
  double before_ms = 0, now_ms = 0;
  bool dearer = false;
};
struct BudgetComparison {
  std::string phone;                  // the baseline's
  std::vector<BudgetChange> changes;  // of everything
  std::vector<std::string> dearer;    // a line for each that is
};

BudgetComparison compare(const Baseline& before, const BudgetReport& report);

void print_comparison(const BudgetComparison& comparison);

}  // namespace pptam::laboratory
