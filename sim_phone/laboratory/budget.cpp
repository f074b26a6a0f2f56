#include "sim_phone/laboratory/budget.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <numeric>

#include "platform/input_error.h"
#include "platform/run/console.h"
#include "platform/run/interruption.h"
#include "platform/run/jobs.h"
#include "platform/run/names.h"
#include "platform/run/run.h"
#include "platform/run/statistics.h"
#include "platform/text.h"
#include "sim_phone/phone_camera.h"
#include "sim_phone/story.h"

namespace pptam::laboratory {
namespace {

using namespace platform;

int64_t whole_ns(const FrameLog& frame) {
  return frame.capture_ns + frame.track_ns + frame.display_ns;
}

Times times_of(const std::vector<double>& ns) {
  Times times;
  times.count = ns.size();
  if (ns.empty()) return times;
  times.mean = std::accumulate(ns.begin(), ns.end(), 0.0) / static_cast<double>(ns.size());
  times.median = percentile(ns, 0.5);
  times.high = percentile(ns, 0.99);
  times.worst = *std::max_element(ns.begin(), ns.end());
  return times;
}

RunLog run_story(const BudgetOptions& options, const std::string& story) {
  RunOptions run;
  use_processor(options.phone, &run);
  const std::unique_ptr<platform::Camera> camera = sim::make_phone_camera(phone_of(options, story));
  return run_sequence(*camera, run, [](const CameraInfo&) {}, {});
}

StoryBudget budget_of(const RunLog& log, const std::string& story) {
  StoryBudget budget;
  budget.story = story;
  budget.frames = log.source_frames;
  budget.dropped = log.dropped;
  std::vector<double> tracking;
  tracking.reserve(log.frames.size());
  for (const FrameLog& frame : log.frames) {
    tracking.push_back(static_cast<double>(frame.track_ns));
    budget.worst_ns = std::max(budget.worst_ns, whole_ns(frame));
  }
  budget.tracking = times_of(tracking);
  budget.time.add(log);
  budget.tracked_fraction = log.tracked_fraction();
  return budget;
}

// Needs the stages' medians.
void find_worst(const std::vector<RunLog>& logs, const BudgetOptions& options, BudgetReport* report) {
  const RunLog* of = nullptr;
  const FrameLog* worst = nullptr;
  size_t story = 0;
  for (size_t i = 0; i < logs.size(); ++i) {
    for (const FrameLog& frame : logs[i].frames) {
      if (worst != nullptr && whole_ns(frame) <= whole_ns(*worst)) continue;
      worst = &frame;
      of = &logs[i];
      story = i;
    }
  }
  if (worst == nullptr) return;
  WorstFrame& found = report->worst;
  found.story = options.stories[story];
  found.seconds = of->seconds(worst->timestamp_ns);
  found.ns = whole_ns(*worst);
  found.beyond_ns = INT64_MIN;
  for (int s = 0; s < kStages; ++s) {
    // A stage that few frames have, such as a start, is beyond what is usual with all of its time.
    const bool usual = 2 * report->stages[s].count > report->tracking.count;
    const int64_t beyond_ns =
        saturated_difference(worst->stage_ns[s], usual ? std::llround(report->stages[s].median) : 0);
    if (beyond_ns <= found.beyond_ns) continue;
    found.stage = static_cast<Stage>(s);
    found.stage_ns = worst->stage_ns[s];
    found.beyond_ns = beyond_ns;
  }
}

void sum_up(const std::vector<RunLog>& logs, BudgetReport* report) {
  std::vector<double> stages[kStages], tracking, whole;
  for (const RunLog& log : logs) {
    report->dropped += log.dropped;
    report->frames += log.source_frames;
    report->memory_bytes = log.memory_bytes;
    report->memory_parts = log.memory_parts;
    report->time.add(log);
    for (const FrameLog& frame : log.frames) {
      for (int s = 0; s < kStages; ++s)
        if (frame.stage_ns[s] > 0) stages[s].push_back(static_cast<double>(frame.stage_ns[s]));
      tracking.push_back(static_cast<double>(frame.track_ns));
      whole.push_back(static_cast<double>(whole_ns(frame)));
      for (int job = 0; job < kJobs; ++job) report->job_ms[job] += 1e-6 * static_cast<double>(frame.job_ns[job]);
      report->most_keyframes = std::max(report->most_keyframes, frame.keyframes);
      report->most_erased = std::max(report->most_erased, frame.erased_keyframes);
      report->most_points = std::max(report->most_points, frame.map_points);
    }
  }
  for (int s = 0; s < kStages; ++s) report->stages[s] = times_of(stages[s]);
  report->tracking = times_of(tracking);
  report->whole = times_of(whole);
  for (double& ms : report->job_ms) ms /= std::max(1e-9 * static_cast<double>(report->time.all_ns()), 1e-9);
}

std::string ms_text(double ns) {
  return format("%.2f", 1e-6 * ns);
}

std::string percent_text(double share) {
  return format("%.0f", 100 * share);
}

std::vector<std::string> times_row(const std::string& name, const Times& times) {
  return {name,
          format("%zu", times.count),
          ms_text(times.mean),
          ms_text(times.median),
          ms_text(times.high),
          ms_text(times.worst)};
}

std::vector<std::string> same_for_all(const std::string& name, size_t count, int64_t each_ns) {
  const double ns = static_cast<double>(each_ns);
  return times_row(name, {ns, ns, ns, ns, count});
}

void print_stories(const BudgetReport& report) {
  std::vector<std::vector<std::string>> rows;
  rows.reserve(report.stories.size() + 1);
  const auto add = [&](const StoryBudget& s) {
    rows.push_back({s.story, std::to_string(s.frames), std::to_string(s.dropped), std::to_string(s.time.late),
                    ms_text(s.tracking.median), ms_text(s.tracking.high), ms_text(s.tracking.worst),
                    ms_text(static_cast<double>(s.worst_ns)), percent_text(s.time.share(s.time.mapping_ns)),
                    percent_text(s.time.share(s.time.idle_ns)), percent_text(s.time.work_left_share()),
                    percent_text(s.tracked_fraction)});
  };
  for (const StoryBudget& story : report.stories) add(story);
  print_line(
      "Times in ms. tracking: of a frame; whole: its worst with capture and display. Shares in %: mapping and idle,");
  print_line("of the time; left: frames that came before mapping was done; poses: of the frames since the first pose.");
  print_table(
      {"story", "frames", "dropped", "late", "tracking", "99 %", "worst", "whole", "mapping", "idle", "left", "poses"},
      rows);
}

void print_stages(const BudgetOptions& options, const BudgetReport& report) {
  std::vector<std::vector<std::string>> rows;
  rows.reserve(kStages + 4);
  for (int s = 0; s < kStages; ++s) rows.push_back(times_row(name_of(static_cast<Stage>(s)), report.stages[s]));
  rows.push_back(times_row("tracking", report.tracking));
  rows.push_back(same_for_all("capture", report.whole.count, options.phone.capture_ns));
  rows.push_back(same_for_all("display", report.whole.count, options.phone.display_ns));
  rows.push_back(times_row("whole", report.whole));
  print_table({"stage, ms", "frames", "mean", "median", "99 %", "worst"}, rows);
}

std::string mapping_text(const BudgetReport& report) {
  const ProcessorTime& time = report.time;
  return format("%.0f %% of the time, idle %.0f %%; work was left at %.0f %% of the frames; longest slice %.2f ms",
                100 * time.share(time.mapping_ns), 100 * time.share(time.idle_ns), 100 * time.work_left_share(),
                1e-6 * static_cast<double>(time.longest_slice_ns));
}

std::string jobs_text(const BudgetReport& report) {
  std::string text;
  for (int job = 0; job < kJobs; ++job)
    text += format("%s%s %.1f", text.empty() ? "" : ", ", name_of(span_of_job(job)), report.job_ms[job]);
  return text + " ms of each second";
}

}  // namespace

std::vector<std::string> budget_stories() {
  std::vector<std::string> names;
  for (const sim::StoryKind& kind : sim::stories())
    if (!kind.harsh) names.emplace_back(kind.name);
  return names;
}

sim::PhoneOptions phone_of(const BudgetOptions& options, const std::string& story) {
  sim::PhoneOptions phone = sim::phone_for_story(story, options.seed);
  use_camera(options.phone, &phone);
  return phone;
}

void check_budget(const BudgetOptions& options) {
  if (options.stories.empty()) throw InputError("no story was named");
  for (const std::string& story : options.stories) {
    if (sim::find_story(story) == nullptr)
      throw InputError("story '" + story + "' is unknown; choose one of " + joined(budget_stories()) +
                       ", or of the harder ones that pocket-ptam sim --help lists");
    const sim::PhoneOptions phone = phone_of(options, story), first = phone_of(options, options.stories[0]);
    sim::check_phone_options(phone);
    if (phone.width != first.width || phone.height != first.height || phone.frames_per_s != first.frames_per_s)
      throw InputError("stories " + options.stories[0] + " and " + story +
                       ": have different cameras; ask for one at a time, or give the phone's profile a camera");
  }
}

void give_verdict(BudgetReport* report) {
  const double worst_ms = 1e-6 * static_cast<double>(report->worst.ns);
  if (report->dropped > 0)
    report->faults.push_back(format("%d frames were dropped because the one before was not done", report->dropped));
  if (worst_ms > report->period_ms)
    report->faults.push_back(
        format("the worst frame takes %.1f ms, and one comes every %.1f ms", worst_ms, report->period_ms));
  const double left = report->time.share(saturated_sum(report->time.mapping_ns, report->time.idle_ns));
  if (left < kLeastForMapping)
    report->faults.push_back(format("frames leave %.0f %% of the time to mapping, which starves below %.0f %%",
                                    100 * left, 100 * kLeastForMapping));
}

BudgetReport measure_budget(const BudgetOptions& options) {
  check_budget(options);
  std::vector<RunLog> logs(options.stories.size());
  const std::vector<bool> done = run_jobs(options.jobs, logs.size(), [&](size_t i) {
    logs[i] = run_story(options, options.stories[i]);
    return options.stories[i];
  });
  BudgetReport report;
  report.period_ms = 1000 / logs[0].camera.frames_per_s;
  report.width = logs[0].camera.model.width;
  report.height = logs[0].camera.model.height;
  for (size_t i = 0; i < logs.size(); ++i) {
    if (done[i] && !logs[i].broken.empty()) report.broken.push_back(logs[i].broken);
    report.stories.push_back(budget_of(logs[i], options.stories[i]));
  }
  if (std::find(done.begin(), done.end(), false) != done.end())
    report.broken.push_back("budget: " + interruption() + ", nothing of it holds");
  sum_up(logs, &report);
  find_worst(logs, options, &report);
  give_verdict(&report);
  return report;
}

void print_budget(const BudgetOptions& options, const BudgetReport& report) {
  const PhoneProfile& processor = options.phone.processor;
  print_line(options.phone.name + (options.phone.says.empty() ? "" : ": " + options.phone.says));
  print_line("");
  print_stories(report);
  print_line("");
  print_stages(options, report);
  print_line("");
  const double worst_ms = 1e-6 * static_cast<double>(report.worst.ns);
  const MemoryParts& parts = report.memory_parts;
  const auto mb = [](size_t bytes) { return 1e-6 * static_cast<double>(bytes); };
  std::vector<SummaryRow> rows = {
      {"phone", format("%.4g MHz, %.3g cycles an instruction; %dx%d, a frame every %.1f ms",
                       static_cast<double>(processor.clock_mhz), static_cast<double>(processor.cycles_per_instruction),
                       report.width, report.height, report.period_ms)},
      {"frames", format("%d, %d dropped, %d late", report.frames, report.dropped, report.time.late)},
      {"worst frame",
       format("%.2f ms with capture and display, %.1f s into %s: %s takes %.2f ms, %.2f beyond what is usual", worst_ms,
              report.worst.seconds, report.worst.story.c_str(), name_of(report.worst.stage),
              1e-6 * static_cast<double>(report.worst.stage_ns), 1e-6 * static_cast<double>(report.worst.beyond_ns))},
      {"mapping", mapping_text(report)},
      {"  of it", jobs_text(report)},
      {"memory",
       format("%.2f MB: map %.2f, tracking %.2f, mapping %.2f, else %.2f", mb(static_cast<size_t>(report.memory_bytes)),
              mb(parts.map), mb(parts.tracking), mb(parts.mapping), mb(parts.rest))},
      {"  used at most", format("%d keyframes, %d erased ones, %d points", report.most_keyframes, report.most_erased,
                                report.most_points)},
  };
  if (report.faults.empty()) {
    rows.push_back({"verdict", format("fits: the worst frame leaves %.0f %% of a frame's time",
                                      100 * (1 - worst_ms / report.period_ms))});
  } else {
    for (size_t i = 0; i < report.faults.size(); ++i)
      rows.push_back({i == 0 ? "verdict" : "", (i == 0 ? "does not fit: " : "and ") + report.faults[i]});
  }
  print_rows(rows);
}

}  // namespace pptam::laboratory
