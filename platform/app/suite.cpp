#include "platform/app/suite.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <limits>
#include <mutex>
#include <thread>

#include "platform/app/console.h"
#include "platform/app/evaluation.h"
#include "platform/app/report.h"

namespace pptam::app {
namespace {

using platform::InputError;

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();  // shown as "-"

struct Column {
  const char* name;
  const char* unit;
  const char* pattern;
  bool small_is_good;
};
enum ColumnId {
  kInitialised,
  kPlane,
  kTracked,
  kAte,
  kWrong,
  kKeyframes,
  kPoints,
  kMeanMs,
  kWorstMs,
  kMinstructions,
  kDropped,
  kColumns
};
constexpr Column kTable[kColumns] = {
    {"initialised", "s", "%.2f", true}, {"plane", "deg", "%.2f", true}, {"tracked", "%", "%.1f", false},
    {"ATE", "%", "%.2f", true},         {"wrong", "%", "%.1f", true},   {"keyframes", "", "%.0f", false},
    {"points", "", "%.0f", false},      {"frame", "ms", "%.1f", true},  {"worst", "ms", "%.1f", true},
    {"instr.", "M", "%.2f", true},      {"dropped", "", "%.0f", true}};

struct Row {
  std::string name;
  std::string scene;
  bool summary = false;
  double values[kColumns];
  std::string trouble;

  Row() { std::fill(std::begin(values), std::end(values), kNone); }
};

std::string cell(const Row& row, int column) {
  return std::isnan(row.values[column]) ? "-" : format(kTable[column].pattern, row.values[column]);
}

Row run_one(const SuiteOptions& options, const std::string& scene, uint64_t seed) {
  Row row;
  row.scene = scene;
  row.name = scene + " " + std::to_string(seed);
  try {
    sim::PhoneOptions phone = options.phone;
    phone.scene = scene;
    phone.seed = seed;
    const std::unique_ptr<platform::Camera> camera = sim::make_phone_camera(phone);
    const platform::Trajectory truth = camera->ground_truth();
    const RunLog log = run_sequence(
        *camera, options.run, [](const platform::CameraInfo&) {}, nullptr);
    row.trouble = log.broken;
    row.values[kTracked] = 100 * log.tracked_fraction();
    row.values[kDropped] = log.dropped;
    row.values[kKeyframes] = static_cast<double>(log.keyframes.size());
    row.values[kPoints] = static_cast<double>(log.map_points.size());
    const FrameLog* first = log.first_tracked();
    if (first == nullptr) return row;
    row.values[kInitialised] = log.seconds(first->timestamp_ns);
    const CostSummary cost = cost_of(log);
    row.values[kMeanMs] = cost.mean_ms;
    row.values[kWorstMs] = cost.worst_ms;
    row.values[kMinstructions] = cost.mean_minstructions;
    try {
      const Evaluation evaluation = evaluate(log.trajectory(), truth, row.name, "ground truth");
      row.values[kAte] = evaluation.ate_percent();
      row.values[kWrong] = 100 * evaluation.wrong_fraction;
      if (ground_plane_known(scene)) row.values[kPlane] = evaluation.vertical_error_deg;
    } catch (const InputError&) {
      // Tracked for too short a time to be judged: the cells stay empty.
    }
  } catch (const std::exception& error) {
    row.trouble = error.what();
  }
  return row;
}

// Median and worst of a scene's runs. A run without a value (it never initialised) counts as the worst of all in the
// median's order, and shows as "-" when it is the one.
void append_summaries(const std::string& scene, std::vector<Row>* rows) {
  Row median;
  Row worst;
  median.name = scene + " median";
  worst.name = scene + " worst";
  median.scene = worst.scene = scene;
  median.summary = worst.summary = true;
  for (int column = 0; column < kColumns; ++column) {
    std::vector<double> values;
    for (const Row& row : *rows) {
      if (row.scene == scene && !row.summary) values.push_back(row.values[column]);
    }
    if (values.empty()) continue;
    const bool small = kTable[column].small_is_good;
    std::sort(values.begin(), values.end(), [&](double a, double b) {
      if (std::isnan(a) || std::isnan(b)) return !std::isnan(a) && std::isnan(b);
      return small ? a < b : a > b;
    });
    median.values[column] = values[values.size() / 2];
    worst.values[column] = values.back();
  }
  rows->push_back(median);
  rows->push_back(worst);
}

void print_suite(const std::vector<Row>& rows) {
  std::vector<std::string> heads = {"run"};
  for (const Column& column : kTable)
    heads.push_back(std::string(column.name) + (*column.unit != '\0' ? std::string(" ") + column.unit : ""));
  std::vector<std::vector<std::string>> cells;
  bool after_summary = false;
  for (const Row& row : rows) {
    if (after_summary && !row.summary) cells.emplace_back();
    after_summary = row.summary;
    std::vector<std::string>& line = cells.emplace_back();
    line.push_back(row.name);
    for (int c = 0; c < kColumns; ++c) line.push_back(cell(row, c));
    if (!row.trouble.empty()) line.push_back(row.trouble);
  }
  print_table(heads, cells);
}

std::string csv_of(const std::vector<Row>& rows) {
  std::string csv =
      "run,scene,initialised_s,plane_deg,tracked_percent,ate_percent,wrong_percent,keyframes,points,"
      "frame_ms,worst_ms,frame_minstructions,dropped\n";
  for (const Row& row : rows) {
    csv += row.name + "," + row.scene;
    for (int c = 0; c < kColumns; ++c) csv += "," + (std::isnan(row.values[c]) ? "" : format("%.6g", row.values[c]));
    csv += "\n";
  }
  return csv;
}

std::string html_of(const std::vector<Row>& rows, const SuiteOptions& options) {
  std::string page = html_head("Pocket PTAM: suite") + "<h1>Emulated phone: " + std::to_string(options.seeds) +
                     " seeds of each scene</h1>\n<section><table class=\"wide\"><tr><th>run</th>";
  for (const Column& column : kTable) {
    page +=
        std::string("<th>") + column.name + (*column.unit != '\0' ? std::string("<br>") + column.unit : "") + "</th>";
  }
  page += "</tr>\n";
  for (const Row& row : rows) {
    page += std::string(row.summary ? "<tr class=\"total\">" : "<tr>") + "<td>" + html_escaped(row.name) + "</td>";
    for (int c = 0; c < kColumns; ++c) page += "<td>" + cell(row, c) + "</td>";
    page += (row.trouble.empty() ? "" : "<td>" + html_escaped(row.trouble) + "</td>") + "</tr>\n";
  }
  return page +
         "</table><p>initialised: time of the first pose. plane: error of the ground's normal. tracked: share of the "
         "frames from then on that have a pose. ATE: rms position error after alignment, in % of the path. wrong: "
         "share "
         "of the poses that are off by more than a tenth of the path's extent or 5 degrees. frame, worst: time to "
         "track "
         "a frame with a map, on the " +
         name_of(options.run.clock) + " clock.</p></section>\n<section><h2>To repeat these runs</h2><code>" +
         html_escaped(options.command) + "</code><p>pocket-ptam " + html_escaped(options.version) +
         "</p></section>\n</main></body></html>\n";
}

}  // namespace

bool ground_plane_known(const std::string& scene) {
  return scene == "desk" || scene == "boxes";
}

void run_jobs(int threads, size_t count, const std::function<std::string(size_t)>& job) {
  std::atomic<size_t> next = 0;
  std::mutex mutex;
  Progress progress;
  size_t done = 0;
  const auto worker = [&] {
    for (;;) {
      const size_t i = next++;
      if (i >= count) return;
      const std::string text = job(i);
      const std::lock_guard lock(mutex);
      progress.show(static_cast<int>(++done), static_cast<int>(count), text);
    }
  };
  std::vector<std::thread> workers;
  for (int i = 0; i < threads; ++i) workers.emplace_back(worker);
  for (std::thread& thread : workers) thread.join();
  progress.finish();
}

int run_suite(const SuiteOptions& options) {
  for (const std::string& scene : options.scenes) {  // refuses bad options before hours of work
    sim::PhoneOptions phone = options.phone;
    phone.scene = scene;
    sim::make_phone_camera(phone);
  }
  std::error_code error;
  std::filesystem::create_directories(options.out, error);
  if (error) throw InputError("--out " + options.out.string() + ": cannot be made: " + error.message());

  const size_t seeds = static_cast<size_t>(options.seeds);
  std::vector<Row> runs(options.scenes.size() * seeds);
  run_jobs(options.jobs, runs.size(), [&](size_t i) {
    runs[i] = run_one(options, options.scenes[i / seeds], i % seeds + 1);
    return "finished " + runs[i].name;
  });

  std::vector<Row> rows;
  int broken = 0;
  for (size_t s = 0; s < options.scenes.size(); ++s) {
    for (size_t i = 0; i < seeds; ++i) {
      rows.push_back(runs[s * seeds + i]);
      if (!rows.back().trouble.empty()) ++broken;
    }
    append_summaries(options.scenes[s], &rows);
  }
  print_suite(rows);
  write_file(options.out / "suite.csv", csv_of(rows));
  write_file(options.out / "suite.html", html_of(rows, options));
  std::printf("\nwritten to %s: suite.csv suite.html\n", options.out.string().c_str());
  return broken;
}

}  // namespace pptam::app
