// pocket-ptam readout: finds a recording's rolling shutter by trying: the recording is tracked under many assumptions,
// and the one under which the tracked frames' points fit best is it. Frames tell more than the finished map's objective
// (System::map_fit, printed beside): there are many more frames than keyframes.

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <exception>
#include <memory>
#include <utility>
#include <vector>

#include "platform/app/commands.h"
#include "platform/app/options.h"
#include "platform/camera/recorded_camera.h"
#include "platform/run/console.h"
#include "platform/run/interruption.h"
#include "platform/run/jobs.h"
#include "platform/run/names.h"
#include "platform/run/run.h"
#include "platform/text.h"

namespace pptam::app {
namespace {

using namespace platform;

struct ReadoutOptions {
  RecordingInput input;
  RecordingOptions recording;
  RunOptions run;
  std::string axes = "both";  // rows, columns or both
  int jobs = 1;
};

constexpr int kSteps = 4;               // of the readout in either direction, up to the time between two frames
constexpr int kRounds = 2;              // of halving the step round the best
constexpr double kWorthSaying = 0.97;   // of a global shutter's reprojection error
constexpr double kSmoothedSteps = 4.5;  // of the last size, round the best, whose trials tell where the minimum lies
constexpr double kMinTracked = 0.8;     // of the best trial's tracked share, to count at all

struct Trial {
  RollingShutter::Axis axis = RollingShutter::Axis::kRows;
  double seconds = 0;
  double tracked = 0;
  MapFit fit;
  double reprojection_px = 0;  // of all tracked frames, rms
  std::string trouble;
};

std::string option_for(const Trial& trial) {
  return readout_text(trial.axis, trial.seconds);
}

Trial attempt(const ReadoutOptions& options, RollingShutter::Axis axis, double seconds) {
  Trial trial;
  trial.axis = axis;
  trial.seconds = seconds;
  platform::RecordingOptions recording = options.recording;
  recording.readout_axis = axis;
  recording.readout_s = seconds;
  try {
    const std::unique_ptr<platform::Camera> camera = platform::open_recording(recording, nullptr);
    const RunLog log = run_sequence(
        *camera, options.run, [](const platform::CameraInfo&) {}, nullptr);
    trial.trouble = log.broken;
    if (log.first_tracked() != nullptr)
      trial.tracked = static_cast<double>(log.trajectory().size()) / static_cast<double>(log.frames.size());
    trial.fit = log.map_fit;
    trial.reprojection_px = log.reprojection_px();
  } catch (const std::exception& error) {
    trial.trouble = error.what();
  }
  return trial;
}

void run_trials(const ReadoutOptions& options, std::vector<Trial>* trials) {
  const std::vector<bool> done = run_jobs(options.jobs, trials->size(), [&](size_t i) {
    Trial& trial = (*trials)[i];
    trial = attempt(options, trial.axis, trial.seconds);
    return "tried " + option_for(trial);
  });
  std::vector<Trial> whole;
  for (size_t i = 0; i < trials->size(); ++i) {
    if (done[i]) whole.push_back(std::move((*trials)[i]));
  }
  *trials = std::move(whole);
}

// Null: no trial counts. A map that lives for a moment may fit anything.
const Trial* best_of(const std::vector<Trial>& trials) {
  double tracked = 0;
  for (const Trial& trial : trials) tracked = std::max(tracked, trial.tracked);
  const Trial* best = nullptr;
  for (const Trial& trial : trials) {
    if (trial.fit.measurements == 0 || trial.tracked < kMinTracked * tracked) continue;
    if (best == nullptr || trial.reprojection_px < best->reprojection_px) best = &trial;
  }
  return best;
}

// Minimum of the parabola through the trials up to kSmoothedSteps steps from the best one, s, within a step of it: one
// trial's luck weighs less. The best one's where these are fewer than four, or the parabola opens downwards.
double smoothed_minimum(const std::vector<Trial>& trials, const Trial& best, double step_s) {
  Eigen::Matrix3d A = Eigen::Matrix3d::Zero();
  Eigen::Vector3d b = Eigen::Vector3d::Zero();
  int count = 0;
  for (const Trial& trial : trials) {
    const double x = (trial.seconds - best.seconds) / step_s;
    if ((trial.axis != best.axis && trial.seconds != 0) || std::abs(x) > kSmoothedSteps ||
        trial.fit.measurements == 0 || trial.tracked < kMinTracked * best.tracked)
      continue;
    const Eigen::Vector3d row(1, x, x * x);
    A += row * row.transpose();
    b += row * trial.reprojection_px;
    ++count;
  }
  if (count < 4) return best.seconds;
  const Eigen::Vector3d c = A.ldlt().solve(b);
  if (!(c[2] > 0)) return best.seconds;
  return best.seconds + step_s * std::clamp(-c[1] / (2 * c[2]), -1.0, 1.0);
}

// Whether the recording was whole; all trials read the same one.
bool report_trouble(const Trial& best) {
  if (best.trouble.empty()) return true;
  print_error(best.trouble + "; what came before it was tracked");
  return false;
}

// Prints each trial and what to write for --readout. False when too few trials gave a map, or the recording broke off.
bool find_readout(const ReadoutOptions& options) {
  std::vector<std::string> warnings;
  const double frames_per_s = options.input.open(options.recording, &warnings)->info().frames_per_s;
  stop_on_signals();
  double step_s = (frames_per_s > 0 ? 1 / frames_per_s : 1.0 / 30) / kSteps;
  std::vector<Trial> trials;
  for (const RollingShutter::Axis axis : {RollingShutter::Axis::kRows, RollingShutter::Axis::kColumns}) {
    if (options.axes != "both" && options.axes != name_of(axis)) continue;
    for (int i = -kSteps; i <= kSteps; ++i) {
      if (i == 0 && !trials.empty() && axis == RollingShutter::Axis::kColumns)
        continue;  // a global shutter has no axis
      Trial& trial = trials.emplace_back();
      trial.axis = axis;
      trial.seconds = i * step_s;
    }
  }
  run_trials(options, &trials);
  for (int round = 0; round < kRounds; ++round) {
    const Trial* best = best_of(trials);
    if (best == nullptr || interrupted()) break;
    step_s *= 0.5;
    std::vector<Trial> finer(2);
    finer[0].axis = finer[1].axis = best->axis;
    finer[0].seconds = best->seconds - step_s;
    finer[1].seconds = best->seconds + step_s;
    run_trials(options, &finer);
    trials.insert(trials.end(), finer.begin(), finer.end());
  }
  std::stable_sort(trials.begin(), trials.end(), [](const Trial& a, const Trial& b) {
    return a.axis != b.axis ? a.axis < b.axis : a.seconds < b.seconds;
  });
  std::vector<std::vector<std::string>> cells;
  for (const Trial& trial : trials) {
    cells.push_back({option_for(trial), format("%.1f", 100 * trial.tracked),
                     trial.fit.measurements > 0 ? format("%.5f", trial.fit.cost) : "-",
                     format("%d", trial.fit.measurements), format("%.3f", trial.reprojection_px)});
    if (!trial.trouble.empty()) cells.back().push_back(trial.trouble);
  }
  print_table({"readout", "tracked %", "objective", "measurements", "frames' px"}, cells);
  if (interrupted()) {
    print_error(interruption() + " before all trials were made; the best of those above may not be the best of all");
    return false;
  }
  const Trial* best = best_of(trials);
  if (best == nullptr) {
    std::printf("\nno trial gave a map: see that the recording starts with pocket-ptam replay (--tap, --fov)\n");
    return false;
  }
  for (const Trial& trial : trials) {
    if (trial.seconds == 0 && best->reprojection_px > kWorthSaying * trial.reprojection_px) {
      std::printf("\nno shutter fits clearly better than a global one: move faster, in all directions\n");
      return report_trouble(*best);
    }
  }
  std::printf("\nbest: --readout %s, to about %.1f ms\n",
              readout_text(best->axis, smoothed_minimum(trials, *best, step_s)).c_str(), 1000 * step_s);
  return report_trouble(*best);
}

struct ReadoutChoice {
  RecordingInput input;
  RunOptions run;
  std::string axes = "both";
  int jobs = 1;
};

}  // namespace

Command add_readout(CLI::App& program) {
  CLI::App* command =
      program.add_subcommand("readout", "Find a recording's rolling shutter: the one with which its map fits best");
  const auto chosen = std::make_shared<ReadoutChoice>();
  add_recording_options(command, &chosen->input);
  command->add_option("--axis", chosen->axes, "rows, columns, or both of them [both]")
      ->check(CLI::IsMember({"rows", "columns", "both"}))
      ->type_name("AXIS");
  command->add_option("--jobs", chosen->jobs, "Threads")->check(CLI::Range(1, 256))->type_name("N");
  add_tap_option(command, &chosen->run);
  command->footer(
      "The clip should start the map early and show the camera moving quickly now and then, in all directions.\n"
      "Examples:\n"
      "  pocket-ptam readout clip.mp4 --fov 60 --resize 320x240\n"
      "  pocket-ptam readout clip.mp4 --calibration phone.yaml --axis rows");
  return {command, [chosen] {
            const ReadoutOptions options = {chosen->input, chosen->input.recording(), chosen->run, chosen->axes,
                                            chosen->jobs};
            return find_readout(options) ? kExitOk : kExitBroken;
          }};
}

}  // namespace pptam::app
