// Does it fit a phone? Stories of the emulated phone are run by the work clock with a phone's profile, and it is told
// what a frame costs, stage by stage, and whether frames come to be dropped or mapping to starve.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "platform/run/run_log.h"
#include "sim_phone/laboratory/phone_profile.h"

namespace pptam::laboratory {

struct BudgetOptions {
  Phone phone;
  std::vector<std::string> stories;  // of sim::stories()
  uint64_t seed = 1;
  int jobs = 1;  // threads; the results do not depend on it
};

// Of times that frames took, ns.
struct Times {
  double mean = 0, median = 0, high = 0, worst = 0;  // high: the 99th percentile
  size_t count = 0;
};

struct WorstFrame {
  std::string story;
  double seconds = 0;  // since the story's first frame
  int64_t ns = 0;      // with capture and display
  // The stage that took most beyond its median, and by how much.
  Stage stage = Stage::kPyramid;
  int64_t stage_ns = 0, beyond_ns = 0;
};

struct StoryBudget {
  std::string story;
  int frames = 0, dropped = 0;
  Times tracking;        // of its frames
  int64_t worst_ns = 0;  // frame with capture and display
  platform::ProcessorTime time;
  double tracked_fraction = 0;  // RunLog's
};

struct BudgetReport {
  double period_ms = 0;  // between two frames
  int width = 0, height = 0;
  std::vector<StoryBudget> stories;
  int frames = 0, dropped = 0;
  Times stages[kStages];  // of the frames in which there was something to do
  Times tracking, whole;  // of all frames; with capture and display
  platform::ProcessorTime time;
  double job_ms[platform::kJobs] = {};  // of each second, on the average
  WorstFrame worst;
  int64_t memory_bytes = 0;
  MemoryParts memory_parts;
  int most_keyframes = 0, most_erased = 0, most_points = 0;
  std::vector<std::string> faults;  // why it does not fit; empty: it fits
  std::vector<std::string> broken;  // stories that did not run to their end and why, or that all was interrupted
};

// The sixteen of calm and quick hands.
std::vector<std::string> budget_stories();

// The emulated phone that sees a story.
sim::PhoneOptions phone_of(const BudgetOptions& options, const std::string& story);

// Throws InputError on options that make no sense, such as stories of different cameras.
void check_budget(const BudgetOptions& options);
// Finds the faults in all else that the report holds.
void give_verdict(BudgetReport* report);
// Checks likewise.
BudgetReport measure_budget(const BudgetOptions& options);

void print_budget(const BudgetOptions& options, const BudgetReport& report);

}  // namespace pptam::laboratory
