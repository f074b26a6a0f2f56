#include "sim_phone/laboratory/suite.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <limits>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <thread>
#include <utility>

#include "platform/input_error.h"
#include "platform/outputs.h"
#include "platform/run/console.h"
#include "platform/run/html.h"
#include "platform/run/interruption.h"
#include "platform/run/jobs.h"
#include "platform/run/names.h"
#include "platform/run/statistics.h"
#include "platform/text.h"
#include "sim_phone/laboratory/judgement.h"
#include "sim_phone/laboratory/keeping_camera.h"
#include "sim_phone/laboratory/results.h"
#include "sim_phone/story.h"

namespace pptam::laboratory {
namespace {

using namespace platform;

// The goals for all stories, with the phone profile.
constexpr double kGoalTracked = 98;     // % of the frames, stories that do not lose on purpose
constexpr double kGoalRecovered = 95;   // % of the losses
constexpr double kGoalWrongGood = 0.2;  // % of the poses
constexpr double kGoalAteMedian = 0.2;  // % of the path, stories that explore
constexpr double kGoalAte90 = 0.5;
constexpr double kGoalOverGlobal = 1.5;  // at most so many times the global shutter's error
constexpr double kGoalUnmodelled = 2;    // without the shutter's model at least so many times worse
constexpr double kGoalJitter_mm = 0.15;
constexpr double kGoalJitter_deg = 0.01;
constexpr double kGoalJitterRatio = 1.3;    // to what the covariance predicts
constexpr double kGoalLag = 2;              // frames
constexpr double kGoalMinstructions = 3.5;  // of a tracked frame, median
constexpr double kGoalMinstructions99 = 5;

// Those for the stories of a harsher life; how much of each is to be tracked stands in the table stories().
constexpr double kHarshWrongGood = 0.1;
constexpr double kHarshAteMedian = 0.15;
constexpr double kHarshAte90 = 0.6;
constexpr double kHarshStarts = 98;     // % of the runs: a right map, or refused with the right hint
constexpr double kHarshStartWrong = 5;  // % of the poses that may be wrong with a right map
constexpr double kHarshPan = 1;         // % of the scene's depth
constexpr double kHarshBands = 1.5;     // times the error without them

struct Column {
  const char* name;  // in the table; the CSV's is longer
  const char* unit;
  const char* pattern;
  bool small_is_good;
  const char* csv;
  const char* says;
};
enum ColumnId {
  kInitialised,
  kTracked,
  kAte,
  kWrong,
  kWrongGood,
  kFalse,
  kRecovered,
  kRecovery,
  kJitter,
  kJitterRatio,
  kTurn,
  kTurnRatio,
  kLag,
  kMedian,
  kHigh,
  kPlane,
  kGlobal,
  kOverGlobal,
  kUnmodelled,
  kOverModelled,
  kPan,
  kAfterPan,
  kSteady,
  kOverSteady,
  kColumns
};
constexpr Column kTable[kColumns] = {
    {"init", "s", "%.2f", true, "initialised_s", "first pose, after the first sideways movement"},
    {"tracked", "%", "%.1f", false, "tracked_percent",
     "share of the frames from then on that have a pose, where tracking can be expected"},
    {"ATE", "%", "%.2f", true, "ate_percent", "rms position error after alignment, of the path"},
    {"wrong", "%", "%.1f", true, "wrong_percent",
     "share of the poses that are off by more than a tenth of the path's extent or 5 degrees"},
    {"as good", "%", "%.2f", true, "wrong_good_percent", "share of the poses that are wrong and reported as good"},
    {"false", "", "%.0f", true, "false_relocalisations", "first poses after a loss that are wrong"},
    {"recov.", "%", "%.0f", false, "recovered_percent",
     "losses whose view returned, with a right pose within a second"},
    {"after", "s", "%.2f", true, "recovery_s", "the longest of them"},
    {"jitter", "mm", "%.3f", true, "jitter_mm", "rms of the position about its mean in the standstill"},
    {"/cov", "", "%.2f", true, "jitter_mm_ratio", "to what the reported covariance predicts"},
    {"jitter", "deg", "%.4f", true, "jitter_deg", "rms of the orientation"},
    {"/cov", "", "%.2f", true, "jitter_deg_ratio", "likewise"},
    {"lag", "fr.", "%.0f", true, "lag_frames",
     "frames after the story's quick step until it is followed to within a tenth"},
    {"median", "M", "%.2f", true, "frame_minstructions_median", "modelled instructions of a tracked frame"},
    {"99 %", "M", "%.2f", true, "frame_minstructions_p99", "its 99th percentile"},
    {"plane", "deg", "%.2f", true, "plane_deg", "error of the ground's normal"},
    {"global", "%", "%.2f", true, "global_ate_percent", "ATE of the same story with a global shutter"},
    {"/global", "", "%.2f", true, "ate_to_global", "ATE to that"},
    {"untold", "%", "%.2f", true, "unmodelled_ate_percent", "ATE when the system is not told of the rolling shutter"},
    {"untold/", "", "%.2f", false, "unmodelled_to_ate", "that to ATE"},
    {"pan", "%", "%.2f", true, "pan_percent", "largest position error in a pan on the spot, of the scene's depth"},
    {"back", "%", "%.2f", true, "after_pan_percent", "likewise once it is back"},
    {"steady", "%", "%.2f", true, "steady_ate_percent", "ATE of the same story in a lamp's light without flicker"},
    {"/steady", "", "%.2f", true, "ate_to_steady", "ATE to that"}};

struct Row {
  std::string name;
  std::string group;  // story or scene
  uint64_t seed = 0;
  bool summary = false;
  double values[kColumns];
  Judgement judgement;
  int keyframes = 0, points = 0, dropped = 0;
  bool explores = false, loses = false;
  const sim::StoryKind* kind = nullptr;  // null: a scene
  std::string repeat;                    // options of `pocket-ptam sim`
  std::string trouble;                   // why it broke

  Row() { std::fill(std::begin(values), std::end(values), kNone); }
  bool harsh() const { return kind != nullptr && kind->harsh; }
  bool wants_no_map() const { return kind != nullptr && kind->map == sim::WantedMap::kNone; }
  double tracked_goal() const { return kind != nullptr ? kind->tracked_percent : kGoalTracked; }
  bool refused_rightly() const {
    return kind != nullptr && kind->map == sim::WantedMap::kRightOrRefused && !judgement.initialised &&
           judgement.hint == kind->refusal;
  }
  bool started_rightly() const {
    return judgement.initialised && judgement.initialised_s >= 0 && judgement.wrong_percent() <= kHarshStartWrong;
  }
};

std::string cell(const Row& row, int column) {
  return std::isnan(row.values[column]) ? "-" : format(kTable[column].pattern, row.values[column]);
}

RunLog run(platform::Camera& camera, const SuiteOptions& options) {
  return run_sequence(
      camera, options.run, [](const platform::CameraInfo&) {}, nullptr);
}

sim::PhoneOptions phone_for(const SuiteOptions& options, size_t group, uint64_t seed) {
  if (group < options.stories.size()) {
    sim::PhoneOptions phone = sim::phone_for_story(options.stories[group], seed);
    options.adjust_story(&phone);
    return phone;
  }
  sim::PhoneOptions phone = options.phone;
  phone.scene = options.scenes[group - options.stories.size()];
  phone.seed = seed;
  return phone;
}

Row run_one(const SuiteOptions& options, size_t group, uint64_t seed) {
  sim::PhoneOptions phone = phone_for(options, group, seed);
  Row row;
  row.group = phone.story.empty() ? phone.scene : phone.story;
  row.seed = seed;
  row.name = row.group + " " + std::to_string(seed);
  row.repeat =
      (phone.story.empty() ? "--scene " + phone.scene + " --motion " + phone.motion : "--story " + phone.story) +
      " --seed " + std::to_string(seed) + options.repeat_options;
  const sim::StoryKind* kind = sim::find_story(phone.story);
  row.explores = kind != nullptr && kind->explores;
  row.loses = kind != nullptr && kind->loses;
  row.kind = kind;
  try {
    const auto scene = std::make_shared<const sim::Scene>(sim::make_scene(phone));
    const sim::Story story = sim::story_of(phone, *scene);
    KeepingCamera camera(sim::make_phone_camera(phone, scene));
    const platform::Trajectory truth = camera.ground_truth();
    const double exposed_s = std::abs(phone.readout_s) + phone.exposure_s;
    const RunLog log = run(camera, options);
    row.trouble = log.broken;
    row.judgement = judge(log, truth, story, exposed_s);
    const Judgement& j = row.judgement;
    row.keyframes = static_cast<int>(log.keyframes.size());
    row.points = static_cast<int>(log.map_points.size());
    row.dropped = log.dropped;
    double* v = row.values;
    v[kInitialised] = j.initialised_s;
    v[kTracked] = j.tracked_percent();
    v[kAte] = j.ate_percent;
    v[kWrong] = j.wrong_percent();
    v[kWrongGood] = j.wrong_good_percent();
    if (j.initialised) v[kFalse] = j.false_relocalisations;
    if (j.losses > 0) v[kRecovered] = 100.0 * j.recovered / j.losses;
    v[kRecovery] = j.recovery_s;
    v[kJitter] = j.jitter_mm;
    v[kJitterRatio] = j.jitter_mm_ratio;
    v[kTurn] = j.jitter_deg;
    v[kTurnRatio] = j.jitter_deg_ratio;
    v[kLag] = j.lag_frames;
    v[kMedian] = percentile(j.minstructions, 0.5);
    v[kHigh] = percentile(j.minstructions, 0.99);
    if (sim::ground_plane_known(phone.scene)) v[kPlane] = j.plane_deg;
    v[kPan] = j.pan_percent;
    v[kAfterPan] = j.after_pan_percent;
    if (options.compare && row.explores && row.harsh() && phone.harsh.flicker > 0) {
      phone.harsh.flicker = 0;
      const std::unique_ptr<platform::Camera> steady = sim::make_phone_camera(phone, scene);
      v[kSteady] = judge(run(*steady, options), truth, story, exposed_s).ate_percent;
      v[kOverSteady] = v[kAte] / v[kSteady];
    }
    if (options.compare && row.explores && !row.harsh()) {
      camera.again_as(camera.info().model, RollingShutter());
      v[kUnmodelled] = judge(run(camera, options), truth, story, exposed_s).ate_percent;
      phone.readout_s = 0;
      const std::unique_ptr<platform::Camera> global = sim::make_phone_camera(phone, scene);
      v[kGlobal] = judge(run(*global, options), truth, story, phone.exposure_s).ate_percent;
      v[kOverGlobal] = v[kAte] / v[kGlobal];
      v[kOverModelled] = v[kUnmodelled] / v[kAte];
    }
  } catch (const std::exception& error) {
    row.trouble = error.what();
  }
  return row;
}

// The median (or the share-th) of values, those that do not exist counting as the worst of all; NaN when it is one.
double ranked(std::vector<double> values, double share, bool small_is_good) {
  if (values.empty()) return kNone;
  std::sort(values.begin(), values.end(), [&](double a, double b) {
    if (std::isnan(a) || std::isnan(b)) return !std::isnan(a) && std::isnan(b);
    return small_is_good ? a < b : a > b;
  });
  return values[static_cast<size_t>(share * static_cast<double>(values.size() - 1) + 0.5)];
}

// Runs without a loss do not count in these columns' summaries. Elsewhere a missing value is a fault.
bool of_losses(int column) {
  return column == kRecovered || column == kRecovery;
}

// Median and worst of a group's runs.
std::vector<Row> summaries(const std::string& group, const std::vector<Row>& runs) {
  Row median;
  Row worst;
  median.name = group + " median";
  worst.name = "  worst";
  median.group = worst.group = group;
  median.summary = worst.summary = true;
  for (int column = 0; column < kColumns; ++column) {
    std::vector<double> values;
    for (const Row& row : runs) {
      if (row.group != group) continue;
      if (of_losses(column) && row.judgement.losses == 0) continue;
      values.push_back(row.values[column]);
    }
    median.values[column] = ranked(values, 0.5, kTable[column].small_is_good);
    worst.values[column] = ranked(values, 1, kTable[column].small_is_good);
  }
  return {median, worst};
}

// ---- goals ----

struct Goal {
  std::string what, wanted, found;
  bool met = false;
};

// What the goals are about, of all runs together.
struct Sums {
  int initialised = 0, expected = 0, tracked = 0, poses = 0, wrong_good = 0, losses = 0, recovered = 0, false_ones = 0;
  std::vector<double> ate, global, untold, instructions;
  std::vector<double> standing[kColumns];
};

Sums sums_of(const std::vector<Row>& runs) {
  Sums sums;
  for (const Row& row : runs) {
    const Judgement& j = row.judgement;
    sums.initialised += j.initialised ? 1 : 0;
    if (!row.loses) {
      sums.expected += j.expected;
      sums.tracked += j.tracked;
    }
    sums.poses += j.poses;
    sums.wrong_good += j.wrong_good;
    sums.losses += j.losses;
    sums.recovered += j.recovered;
    sums.false_ones += j.false_relocalisations;
    sums.instructions.insert(sums.instructions.end(), j.minstructions.begin(), j.minstructions.end());
    if (row.explores) {
      sums.ate.push_back(row.values[kAte]);
      sums.global.push_back(row.values[kGlobal]);
      sums.untold.push_back(row.values[kUnmodelled]);
    }
    if (row.group == "static") {
      for (const int column : {kJitter, kJitterRatio, kTurn, kTurnRatio, kLag}) {
        sums.standing[column].push_back(row.values[column]);
      }
    }
  }
  return sums;
}

std::vector<Goal> goals_of(const std::vector<Row>& runs, bool compared) {
  const Sums sums = sums_of(runs);
  std::vector<Goal> goals;
  const auto add = [&](const char* what, const std::string& wanted, const std::string& found, bool met) {
    goals.push_back({what, wanted, found, met});
  };
  const auto at_most = [&](const char* what, const char* pattern, double limit, double found) {
    add(what, "at most " + format(pattern, limit), std::isnan(found) ? "-" : format(pattern, found), found <= limit);
  };
  if (runs.empty()) return goals;
  add("runs that initialised", "all", format("%d of %d", sums.initialised, static_cast<int>(runs.size())),
      sums.initialised == static_cast<int>(runs.size()));
  if (sums.expected > 0) {
    const double share = 100.0 * sums.tracked / sums.expected;
    add("tracked, stories that do not lose on purpose", format("at least %.0f %%", kGoalTracked),
        format("%.2f %%", share), share >= kGoalTracked);
  }
  if (sums.losses > 0) {
    const double share = 100.0 * sums.recovered / sums.losses;
    add("recovered within 1 s of the view's return", format("at least %.0f %%", kGoalRecovered),
        format("%.1f %%, %d of %d", share, sums.recovered, sums.losses), share >= kGoalRecovered);
  }
  add("false relocalisations", "none", format("%d", sums.false_ones), sums.false_ones == 0);
  if (sums.poses > 0) {
    const double share = 100.0 * sums.wrong_good / sums.poses;
    add("wrong poses reported as good", format("under %.1f %%", kGoalWrongGood), format("%.3f %%", share),
        share < kGoalWrongGood);
  }
  if (!sums.ate.empty()) {
    const double median = ranked(sums.ate, 0.5, true);
    at_most("ATE of the path, exploring stories, median", "%.3f %%", kGoalAteMedian, median);
    at_most("  90th percentile", "%.3f %%", kGoalAte90, ranked(sums.ate, 0.9, true));
    if (compared) {
      const double of_global = ranked(sums.global, 0.5, true);
      const double of_untold = ranked(sums.untold, 0.5, true);
      at_most("  times that with a global shutter, medians", "%.2f", kGoalOverGlobal, median / of_global);
      add("  without the shutter's model, times worse, medians", format("at least %.1f", kGoalUnmodelled),
          format("%.2f", of_untold / median), of_untold / median >= kGoalUnmodelled);
      add("    (medians: as is, global shutter, untold)", "",
          format("%.3f %%, %.3f %%, %.3f %%", median, of_global, of_untold), true);
    }
  }
  if (!sums.standing[kLag].empty()) {
    const auto worst = [&](int column) { return ranked(sums.standing[column], 1, true); };
    at_most("standing still, rms position, worst run", "%.3f mm", kGoalJitter_mm, worst(kJitter));
    at_most("  to the covariance's", "%.2f", kGoalJitterRatio, worst(kJitterRatio));
    at_most("  rms orientation, worst run", "%.4f degrees", kGoalJitter_deg, worst(kTurn));
    at_most("  to the covariance's", "%.2f", kGoalJitterRatio, worst(kTurnRatio));
    at_most("  frames after a step, worst run", "%.0f", kGoalLag, worst(kLag));
  }
  if (!sums.instructions.empty()) {
    at_most("a tracked frame, median", "%.2f M instructions", kGoalMinstructions, percentile(sums.instructions, 0.5));
    at_most("  99th percentile", "%.2f M instructions", kGoalMinstructions99, percentile(sums.instructions, 0.99));
  }
  return goals;
}

std::vector<Goal> harsh_goals_of(const std::vector<Row>& runs, bool compared) {
  std::vector<Goal> goals;
  const auto add = [&](const std::string& what, const std::string& wanted, const std::string& found, bool met) {
    goals.push_back({what, wanted, found, met});
  };
  const auto at_most = [&](const char* what, double limit, double found) {
    add(what, format("at most %.2f %%", limit), std::isnan(found) ? "-" : format("%.3f %%", found), found <= limit);
  };
  int wanted = 0, right = 0, refused = 0, moving = 0, mapped = 0, poses = 0, wrong_good = 0, false_ones = 0;
  struct Tracked {
    double expected = 0, tracked = 0;
  };
  std::map<double, Tracked, std::greater<>> tracked;  // by what is wanted
  std::vector<double> ate, pans, backs, over_steady;
  for (const Row& row : runs) {
    const Judgement& j = row.judgement;
    if (row.wants_no_map()) {
      ++moving;
      mapped += j.initialised ? 1 : 0;
      continue;
    }
    ++wanted;
    right += row.started_rightly() ? 1 : 0;
    refused += row.refused_rightly() ? 1 : 0;
    tracked[row.tracked_goal()].expected += j.expected;
    tracked[row.tracked_goal()].tracked += j.tracked;
    poses += j.poses;
    wrong_good += j.wrong_good;
    false_ones += j.false_relocalisations;
    if (row.explores) ate.push_back(row.values[kAte]);
    if (row.group.starts_with("pan")) {
      pans.push_back(row.values[kPan]);
      backs.push_back(row.values[kAfterPan]);
    }
    if (row.group.starts_with("bands")) over_steady.push_back(row.values[kOverSteady]);
  }
  if (wanted > 0) {
    const double share = 100.0 * (right + refused) / wanted;
    add("harsher: a right map, or refused with the right hint", format("at least %.0f %%", kHarshStarts),
        format("%.1f %%: %d and %d of %d", share, right, refused, wanted), share >= kHarshStarts);
  }
  for (const auto& [goal, sum] : tracked) {
    if (sum.expected == 0) continue;
    const double share = 100 * sum.tracked / sum.expected;
    add(goal == kGoalTracked ? "  tracked" : "  tracked in dim rooms", format("at least %.0f %%", goal),
        format("%.2f %%", share), share >= goal);
  }
  if (poses > 0) {
    const double share = 100.0 * wrong_good / poses;
    add("  wrong poses reported as good", format("under %.1f %%", kHarshWrongGood), format("%.3f %%", share),
        share < kHarshWrongGood);
    add("  false relocalisations", "none", format("%d", false_ones), false_ones == 0);
  }
  if (!ate.empty()) {
    at_most("  ATE of the path, exploring stories, median", kHarshAteMedian, ranked(ate, 0.5, true));
    at_most("    90th percentile", kHarshAte90, ranked(ate, 0.9, true));
  }
  if (!pans.empty()) {
    at_most("  position in a pan on the spot, of the depth, worst run", kHarshPan, ranked(pans, 1, true));
    at_most("    back again", kHarshPan, ranked(backs, 1, true));
  }
  if (compared && !over_steady.empty()) {
    const double over = ranked(over_steady, 0.5, true);
    add("  with a lamp's bands, times the error without, median", format("at most %.1f", kHarshBands),
        format("%.2f", over), over <= kHarshBands);
  }
  if (moving > 0) {
    add("  maps of a moving thing before a camera at rest", "none", format("%d of %d", mapped, moving), mapped == 0);
  }
  return goals;
}

// What is not as it should be in one run; empty: nothing.
std::string faults_of(const Row& row) {
  const Judgement& j = row.judgement;
  std::string faults;
  const auto add = [&](const std::string& fault) { faults += (faults.empty() ? "" : ", ") + fault; };
  if (!row.trouble.empty()) add(row.trouble);
  if (row.wants_no_map()) {
    if (j.initialised) add(format("a map of a moving thing, %d poses", j.poses));
    return faults;
  }
  if (!j.initialised) {
    if (!row.refused_rightly()) add(std::string("no map, the hint is ") + name_of(j.hint));
    return faults;
  }
  if (j.initialised_s < 0) add("a map before the first sideways movement");
  if (!row.loses && j.tracked_percent() < row.tracked_goal()) add(format("tracked %.1f %%", j.tracked_percent()));
  if (j.wrong > 0) add(format("%d of %d poses wrong, %d of them reported as good", j.wrong, j.poses, j.wrong_good));
  if (j.false_relocalisations > 0) add(format("%d false relocalisations", j.false_relocalisations));
  if (j.recovered < j.losses) add(format("%d of %d losses recovered in time", j.recovered, j.losses));
  if (row.explores && !(j.ate_percent <= (row.harsh() ? kHarshAte90 : kGoalAte90)))
    add(format("ATE %.2f %%", j.ate_percent));
  if (j.pan_percent > kHarshPan || j.after_pan_percent > kHarshPan)
    add(format("position off by %.2f %% of the depth in a pan, %.2f %% back", j.pan_percent, j.after_pan_percent));
  return faults;
}

// ---- output ----

std::string head_of(const Column& column) {
  return std::string(column.name) + (*column.unit != '\0' ? std::string(" ") + column.unit : "");
}

// The columns that some row has a value for.
std::vector<int> columns_of(const std::vector<Row>& rows) {
  std::vector<int> columns;
  for (int c = 0; c < kColumns; ++c) {
    if (std::any_of(rows.begin(), rows.end(), [&](const Row& row) { return !std::isnan(row.values[c]); })) {
      columns.push_back(c);
    }
  }
  return columns;
}

void print_suite(const std::vector<Row>& rows) {
  const std::vector<int> columns = columns_of(rows);
  std::vector<std::string> heads = {"story"};
  for (const int c : columns) heads.push_back(head_of(kTable[c]));
  std::vector<std::vector<std::string>> cells;
  for (const Row& row : rows) {
    std::vector<std::string>& line = cells.emplace_back();
    line.push_back(row.name);
    for (const int c : columns) line.push_back(cell(row, c));
  }
  print_table(heads, cells);
}

void print_goals(const std::vector<Goal>& goals) {
  std::vector<std::vector<std::string>> cells;
  cells.reserve(goals.size());
  for (const Goal& goal : goals) {
    cells.push_back({goal.what, goal.wanted, goal.found, goal.wanted.empty() ? "" : goal.met ? "met" : "NOT MET"});
  }
  std::printf("\n");
  print_table({"goal", "wanted", "found", ""}, cells);
}

std::string csv_of(const std::vector<Row>& runs) {
  std::string csv = "run,story,seed";
  for (const Column& column : kTable) csv += std::string(",") + column.csv;
  csv +=
      ",frames_expected,frames_tracked,poses,wrong_poses,wrong_good_poses,losses,recovered,keyframes,points,dropped,"
      "repeat,trouble\n";
  for (const Row& row : runs) {
    const Judgement& j = row.judgement;
    csv += row.name + "," + row.group + "," + std::to_string(row.seed);
    for (int c = 0; c < kColumns; ++c) csv += "," + (std::isnan(row.values[c]) ? "" : format("%.6g", row.values[c]));
    csv += format(",%d,%d,%d,%d,%d,%d,%d,%d,%d,%d,", j.expected, j.tracked, j.poses, j.wrong, j.wrong_good, j.losses,
                  j.recovered, row.keyframes, row.points, row.dropped);
    std::string trouble = row.trouble;
    std::replace(trouble.begin(), trouble.end(), ',', ';');
    std::replace(trouble.begin(), trouble.end(), '\n', ' ');
    csv += row.repeat + "," + trouble + "\n";
  }
  return csv;
}

// One column of all runs, a story a place on the axis; empty when there is nothing to show.
std::string scatter(const std::vector<Row>& runs, const std::vector<std::string>& groups, int column,
                    const std::string& label, const std::string& settings) {
  std::string data, tics;
  for (size_t g = 0; g < groups.size(); ++g) {
    tics += format("%s'%s' %d", g > 0 ? ", " : "", groups[g].c_str(), static_cast<int>(g));
    for (const Row& row : runs) {
      if (row.group == groups[g] && !std::isnan(row.values[column])) {
        data += format("%.3f %.6g\n", static_cast<double>(g) + 0.04 * (static_cast<double>(row.seed % 9) - 4),
                       row.values[column]);
      }
    }
  }
  if (data.empty()) return "";
  return plot_svg(1120, 360,
                  "$runs << EOD\n" + data + "EOD\nset xtics (" + tics + ") rotate by -35 noenhanced\n" +
                      format("set xrange [-0.6:%.1f]\n", static_cast<double>(groups.size()) - 0.4) + "set ylabel '" +
                      label + "'\n" + settings +
                      "\nplot $runs using 1:2 with points pt 7 ps 0.6 lc rgb '#4f81bd' notitle\n");
}

std::string table_of(const std::vector<Row>& rows) {
  const std::vector<int> columns = columns_of(rows);
  std::string table = "<table class=\"wide\"><tr><th>run</th>";
  for (const int c : columns) {
    table += std::string("<th>") + kTable[c].name +
             (*kTable[c].unit != '\0' ? std::string("<br>") + kTable[c].unit : "") + "</th>";
  }
  table += "</tr>\n";
  for (const Row& row : rows) {
    table += "<tr><td>" + html_escaped(row.name) + "</td>";
    for (const int c : columns) table += "<td>" + cell(row, c) + "</td>";
    table += (row.trouble.empty() ? "" : "<td>" + html_escaped(row.trouble) + "</td>") + "</tr>\n";
  }
  return table + "</table>";
}

std::string html_of(const std::vector<Row>& runs, const std::vector<Row>& summary, const std::vector<Goal>& goals,
                    const std::vector<std::string>& groups, const SuiteOptions& options) {
  std::string page = html_head("Pocket PTAM: suite") + "<h1>Emulated phone: " + std::to_string(options.seeds) +
                     " seeds of each story</h1>\n<section>" + table_of(summary) + "<p>";
  for (const int c : columns_of(runs)) {
    page += "<b>" + html_escaped(head_of(kTable[c])) + "</b>: " + kTable[c].says + ". ";
  }
  page += "</p></section>\n<section><h2>Goals</h2><table class=\"wide\">";
  for (const Goal& goal : goals) {
    page += "<tr><td>" + html_escaped(goal.what) + "</td><td>" + goal.wanted + "</td><td>" + goal.found + "</td><td>" +
            (goal.wanted.empty() ? ""
             : goal.met          ? "met"
                                 : "<b>not met</b>") +
            "</td></tr>\n";
  }
  page += "</table></section>\n";
  const auto add = [&](const char* title, int column, const std::string& settings) {
    const std::string svg = scatter(runs, groups, column, title, settings);
    if (!svg.empty()) page += std::string("<section><h2>") + title + "</h2>" + svg_tag(svg, title) + "</section>\n";
  };
  add("Position error, % of the path", kAte, "set logscale y");
  add("Tracked, %", kTracked, "set yrange [*:100.5]");
  add("Wrong poses, %", kWrong, "set yrange [-0.5:*]");
  add("A tracked frame, 99th percentile, M instructions", kHigh, "set yrange [0:*]");
  page += "<section><h2>All runs</h2>" + table_of(runs) + "</section>\n<section><h2>The stories</h2><p>";
  for (const std::string& group : groups) {
    if (const sim::StoryKind* kind = sim::find_story(group)) {
      page += "<b>" + group + "</b>: " + html_escaped(kind->says) + ". ";
    }
  }
  return page + "</p></section>\n<section><h2>To repeat these runs</h2><code>" + html_escaped(options.command) +
         "</code><p>pocket-ptam " + html_escaped(options.version) + "</p></section>\n</main></body></html>\n";
}

}  // namespace

Shard parse_shard(const std::string& text) {
  Shard shard;
  int used = 0;
  if (std::sscanf(text.c_str(), "%d/%d%n", &shard.number, &shard.count, &used) != 2 ||
      static_cast<size_t>(used) != text.size() || shard.count < 1 || shard.number < 1 || shard.number > shard.count) {
    throw InputError("--shard " + text + ": write I/N with I from 1 to N, for example 1/4");
  }
  return shard;
}

std::vector<size_t> runs_of(const Shard& shard, size_t runs) {
  std::vector<size_t> chosen;
  for (size_t i = static_cast<size_t>(shard.number) - 1; i < runs; i += static_cast<size_t>(shard.count)) {
    chosen.push_back(i);
  }
  return chosen;
}

int run_suite(const SuiteOptions& options) {
  std::vector<std::string> groups = options.stories;
  groups.insert(groups.end(), options.scenes.begin(), options.scenes.end());
  for (size_t group = 0; group < groups.size(); ++group) {  // refuses bad options before hours of work
    sim::check_phone_options(phone_for(options, group, 1));
  }
  Inputs inputs;
  inputs.add("the map of --load-map", options.run.load_map);
  OutputFolder folder(options.out, "--out", {"suite.csv", "suite.html"}, inputs);
  folder.prepare();
  stop_on_signals();

  const size_t seeds = static_cast<size_t>(options.seeds);
  const std::vector<size_t> chosen = runs_of(options.shard, groups.size() * seeds);
  std::vector<Row> all(chosen.size());
  const std::vector<bool> done = run_jobs(options.jobs, all.size(), [&](size_t i) {
    all[i] = run_one(options, chosen[i] / seeds, chosen[i] % seeds + 1);
    return "finished " + all[i].name;
  });
  std::vector<Row> runs;  // those that a signal has not cut short
  for (size_t i = 0; i < all.size(); ++i) {
    if (done[i]) runs.push_back(std::move(all[i]));
  }

  std::vector<Row> summary;
  for (const std::string& group : groups) {
    if (std::none_of(runs.begin(), runs.end(), [&](const Row& row) { return row.group == group; })) continue;
    for (Row& row : summaries(group, runs)) summary.push_back(std::move(row));
  }
  print_suite(summary);
  std::vector<Row> usual, harsh;
  for (const Row& row : runs) (row.harsh() ? harsh : usual).push_back(row);
  std::vector<Goal> goals = goals_of(usual, options.compare);
  for (const Goal& goal : harsh_goals_of(harsh, options.compare)) goals.push_back(goal);
  print_goals(goals);
  int broken = 0;
  std::printf("\n");
  for (const Row& row : runs) {
    if (!row.trouble.empty()) ++broken;
    const std::string faults = faults_of(row);
    if (!faults.empty()) print_line("pocket-ptam sim " + row.repeat + ": " + faults);
  }
  const size_t missing = all.size() - runs.size();
  if (missing > 0) {
    print_error(interruption() + format(": %zu of %zu runs are missing; the others are written", missing, all.size()));
    ++broken;
  }
  if (!write_results(&folder, "suite.csv", csv_of(runs), "suite.html",
                     [&] { return html_of(runs, summary, goals, groups, options); })) {
    ++broken;
  }
  return broken;
}

}  // namespace pptam::laboratory
