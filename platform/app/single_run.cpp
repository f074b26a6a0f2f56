#include "platform/app/single_run.h"

#include <cstdio>
#include <filesystem>
#include <memory>

#include "platform/app/commands.h"
#include "platform/files.h"
#include "platform/input_error.h"
#include "platform/run/console.h"
#include "platform/run/evaluation.h"
#include "platform/run/names.h"
#include "platform/run/overlay.h"
#include "platform/run/report.h"
#include "platform/run/text_outputs.h"
#include "platform/text.h"

namespace pptam::app {
namespace {

using namespace platform;

// "desk, seed 3" -> "desk-seed-3".
std::string folder_name(const std::string& name) {
  std::string folder;
  for (const char c : name) {
    const bool plain =
        (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_' || c == '.';
    if (plain) {
      folder += c;
    } else if (!folder.empty() && folder.back() != '-') {
      folder += '-';
    }
  }
  while (!folder.empty() && (folder.back() == '-' || folder.back() == '.')) folder.pop_back();
  while (!folder.empty() && folder.front() == '.') folder.erase(0, 1);
  return folder.empty() ? "run" : folder;
}

constexpr const char* kOutputs[] = {"trajectory.txt", "keyframes.txt", "map.ply",     "frames.csv",
                                    "report.html",    "overlay.mp4",   "overlay.png", "start.png"};

void prepare_folder(const std::filesystem::path& folder) {
  platform::make_folder(folder, "--out");
  std::error_code ignored;
  for (const char* name : kOutputs) std::filesystem::remove(folder / name, ignored);  // of an earlier run
}

void check_map_options(const RunOptions& run, const OutputOptions& output) {
  if (!run.load_map.empty() && (!run.taps_s.empty() || run.auto_start))
    throw InputError("--load-map " + run.load_map + ": --tap and --auto-start would forget the map");
  if (output.save_map.empty()) return;
  const std::filesystem::path folder = std::filesystem::path(output.save_map).parent_path();
  if (!folder.empty() && !std::filesystem::is_directory(folder))
    throw InputError("--save-map " + output.save_map + ": there is no folder " + folder.string());
  if (std::filesystem::is_directory(output.save_map))
    throw InputError("--save-map " + output.save_map + ": is a folder");
}

// The run, with its overlay and its progress on the terminal. The folder is made once the input is known to be good.
RunLog run_and_show(platform::Camera& camera, const RunOptions& run_options, const OutputOptions& output,
                    const std::filesystem::path& folder, std::vector<std::string>* warnings) {
  std::unique_ptr<Overlay> overlay;
  Progress progress;
  RunLog log = run_sequence(
      camera, run_options,
      [&](const CameraInfo& info) {
        prepare_folder(folder);
        if (!output.no_overlay) overlay = std::make_unique<Overlay>(info, folder, warnings);
      },
      [&](const Frame& frame, const TrackResult& result, const RunLog& so_far) {
        const FrameLog& entry = so_far.frames.back();
        if (overlay) overlay->add(frame, result, entry);
        progress.show(so_far.source_frames, so_far.camera.frame_count.value_or(0),
                      format("%.1f s  %s, %d keyframes, %d points", so_far.seconds(entry.timestamp_ns),
                             name_of(entry.state), entry.keyframes, entry.map_points));
      });
  progress.finish();
  if (overlay) overlay->finish();
  return log;
}

RunSummary evaluated(const RunLog& log, const Trajectory& truth, const Knowledge& knowledge) {
  RunSummary summary;
  summary.version = PPTAM_VERSION;
  summary.plane_known = knowledge.plane_known;
  if (!truth.empty()) {
    try {
      summary.evaluation = evaluate(log.trajectory(), truth, "trajectory", "ground truth");
    } catch (const InputError& error) {
      summary.evaluation_trouble = error.what();
    }
  }
  if (knowledge.judge) summary.judgement = knowledge.judge(log, truth);
  return summary;
}

void print_written(const std::filesystem::path& folder) {
  std::string written;
  for (const char* name : kOutputs) {
    if (std::filesystem::exists(folder / name)) written += std::string(" ") + name;
  }
  std::printf("\nwritten to %s:%s\n", folder.string().c_str(), written.c_str());
  std::fflush(stdout);
}

}  // namespace

int run_and_write(platform::Camera& camera, const RunOptions& run_options, const OutputOptions& output,
                  const Knowledge& knowledge, const std::string& command_line) {
  const Trajectory truth = camera.ground_truth();
  const std::filesystem::path folder = output.out.empty()
                                           ? std::filesystem::path("out") / folder_name(camera.info().name)
                                           : std::filesystem::path(output.out);
  check_map_options(run_options, output);
  std::vector<std::string> warnings;
  const RunLog log = run_and_show(camera, run_options, output, folder, &warnings);
  RunSummary summary = evaluated(log, truth, knowledge);
  summary.command = command_line;
  write_text_outputs(log, folder);
  if (!output.no_report) write_report(folder, log, summary, truth, &warnings);
  if (!log.saved_map.empty()) platform::write_atomically(output.save_map, log.saved_map);

  print_rows(summarise(log, summary));
  print_written(folder);
  for (const std::string& warning : warnings) print_warning(warning);
  if (!log.saved_map.empty()) std::printf("map saved to %s\n", output.save_map.c_str());
  if (!log.save_trouble.empty())
    print_error("--save-map " + output.save_map + ": nothing was saved: " + log.save_trouble);
  if (!log.broken.empty()) print_error(log.broken + "; what came before it was tracked and written");
  return log.broken.empty() && log.save_trouble.empty() ? kExitOk : kExitBroken;
}

}  // namespace pptam::app
