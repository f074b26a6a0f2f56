// pocket-ptam readout: a camera's rolling shutter, and its field of view, from any recording. The recording is tracked
// once under what is assumed; what the points' tracks say of the camera (platform/calibrate/camera_fit.h) is assumed
// next, until it stays (camera_search.h).

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <memory>
#include <numbers>
#include <optional>
#include <utility>
#include <vector>

#include "platform/app/commands.h"
#include "platform/app/options.h"
#include "platform/app/single_run.h"
#include "platform/calibrate/camera_fit_report.h"
#include "platform/calibrate/camera_search.h"
#include "platform/camera/frame_transform.h"
#include "platform/camera/recorded_camera.h"
#include "platform/outputs.h"
#include "platform/run/console.h"
#include "platform/run/interruption.h"
#include "platform/run/names.h"
#include "platform/run/run.h"
#include "platform/text.h"

namespace pptam::app {
namespace {

using namespace platform;
using Axis = RollingShutter::Axis;

constexpr double kGuessedFov_degrees = 60;  // where nothing is known and it is to be found
const std::vector<std::string> kReadoutOutputs = {"report.html"};

struct ReadoutChoice {
  RecordingInput input;
  RunOptions run;
  std::string axes = "both";
  std::vector<std::string> estimates = {"readout"};
  std::string out;

  bool estimates_focal() const { return std::find(estimates.begin(), estimates.end(), "fov") != estimates.end(); }
  bool estimates_readout() const { return std::find(estimates.begin(), estimates.end(), "readout") != estimates.end(); }
};

// The recording tracked under what is assumed of its camera.
TrackedClip track(RecordingOptions recording, const RunOptions& run, const CameraAssumption& assumed) {
  recording.focal_factor = assumed.focal_factor;
  recording.shutter = assumed.shutter;
  const std::unique_ptr<platform::Camera> camera = open_recording(recording, nullptr);
  Progress progress;
  TrackedClip clip = track_clip(*camera, run, [&](const RunLog& so_far) {
    progress.show(so_far.source_frames, so_far.camera.frame_count.value_or(0), "tracking");
  });
  progress.finish();
  return clip;
}

// The words of the command line for what holds of the delivered images; it speaks of the images as they are stored.
class Stored {
 public:
  Stored(const CameraModel& delivered, int rotate_degrees)
      : model_(delivered), back_(delivered.width, delivered.height, (360 - rotate_degrees) % 360, 0, 0) {}

  std::string readout(Axis axis, double seconds) const {
    const RollingShutter stored = back_.shutter(shutter_of(axis, seconds, model_));
    return readout_text(stored.axis, readout_of(stored, back_.model(model_)));
  }
  double fov_degrees(double focal) const {
    const CameraModel stored = back_.model(model_);
    return 2 * std::atan(0.5 * stored.width / (focal * static_cast<double>(stored.fx))) * 180 / std::numbers::pi;
  }

 private:
  CameraModel model_;
  FrameTransform back_;
};

void print_rounds(const CameraSearch& search, const CameraFitOptions& options, int rotate_degrees) {
  std::vector<std::vector<std::string>> rows;
  for (const CameraSearch::Round& round : search.rounds) {
    const CameraModel& model = round.camera.model;
    const Stored stored(model, rotate_degrees);
    rows.push_back({stored.readout(round.camera.shutter.axis, readout_of(round.camera.shutter, model)),
                    format("%.1f", stored.fov_degrees(1)), format("%.1f", 100 * round.tracked),
                    format("%.3f", round.reprojection_px),
                    options.readout ? stored.readout(round.fit.axis, round.fit.readout_s.value) : "-",
                    options.focal ? format("%.1f", stored.fov_degrees(round.fit.focal.value)) : "-"});
  }
  print_table({"tracked under", "fov", "tracked %", "frames' px", "found readout", "fov"}, rows);
}

// What is known at the end, a line for each estimate. False when one of them is not.
bool report(const ReadoutChoice& chosen, const CameraSearch& search, int rotate_degrees) {
  const CameraFit& fit = search.fit;
  const CameraModel& model = search.rounds.back().camera.model;
  const Stored stored(model, rotate_degrees);
  bool known = true;
  const auto cannot = [&](const char* what, const std::string& why) {
    print_line(std::string("this recording cannot tell the ") + what + ": " + why);
    known = false;
  };
  if (chosen.estimates_readout()) {
    if (!fit.readout_s.trouble.empty()) {
      cannot("readout", fit.readout_s.trouble);
    } else if (fit.global) {
      print_line(format("a global shutter: no --readout, or one of less than %.1f ms", 2000 * fit.readout_s.sigma));
    } else {
      print_line("best: --readout " + stored.readout(fit.axis, fit.readout_s.value) +
                 format(", to about %.1f ms", 2000 * fit.readout_s.sigma));
    }
  }
  if (chosen.estimates_focal()) {
    if (!fit.focal.trouble.empty()) {
      cannot("field of view", fit.focal.trouble);
    } else if (chosen.input.calibration.empty() && model.distortion == Distortion::kNone) {
      print_line(format("best: --fov %.1f, to about %.1f %% of the focal length", stored.fov_degrees(fit.focal.value),
                        200 * fit.focal.sigma / fit.focal.value));
    } else {
      print_line(format("best: focal lengths of %.3f times the calibration's, to about %.1f %%", search.focal_factor,
                        200 * fit.focal.sigma / fit.focal.value));
    }
  }
  if (!search.settled)
    print_warning(
        format("the answer still changed in the last of %zu rounds: be careful with it", search.rounds.size()));
  return known && search.settled;
}

int find_camera(const ReadoutChoice& chosen, const std::string& command_line) {
  RecordingOptions recording = chosen.input.recording();
  const bool guessed = chosen.estimates_focal() && recording.calibration.empty() && recording.fov_degrees == 0;
  if (guessed) recording.fov_degrees = kGuessedFov_degrees;
  std::vector<std::string> warnings;
  const std::string name = chosen.input.open(recording, &warnings)->info().name;
  std::optional<OutputFolder> folder;
  if (!chosen.out.empty()) {
    Knowledge knowledge;
    add_inputs(recording, &knowledge);
    for (const std::filesystem::path& images : knowledge.image_folders) {
      if (same_place(images, chosen.out))
        throw InputError("--out " + chosen.out + ": the recording's images are there, name another folder");
    }
    folder.emplace(chosen.out, "--out", kReadoutOutputs, knowledge.inputs);
  }
  stop_on_signals();
  CameraFitOptions options;
  options.focal = chosen.estimates_focal();
  options.readout = chosen.estimates_readout();
  options.axes = chosen.axes;
  options.curves = !chosen.out.empty();
  const CameraSearch found = search_camera(
      [&](const CameraAssumption& assumed) { return track(recording, chosen.run, assumed); }, options, interrupted);
  print_rounds(found, options, recording.rotate_degrees);
  if (interrupted()) {
    print_error(interruption() + " before the search had ended; what it found so far may not be the best");
    return kExitBroken;
  }
  bool whole = true;
  if (!found.broken.empty()) {
    print_error(found.broken + "; what came before it was tracked");
    whole = false;
  }
  print_line("");
  if (!found.fit.trouble.empty()) {
    print_error(found.fit.trouble);
    print_line("see that the recording starts with pocket-ptam replay (--tap, --fov)");
    return kExitBroken;
  }
  whole = report(chosen, found, recording.rotate_degrees) && whole;
  if (!folder) return whole ? kExitOk : kExitBroken;
  folder->prepare();
  std::vector<std::string> new_warnings;
  folder->write("report.html", camera_fit_page({name, command_line, PPTAM_VERSION}, found.fit, &new_warnings));
  folder->finish();
  for (const std::string& warning : new_warnings) print_warning(warning);
  print_line("written to " + chosen.out + ": report.html");
  return whole ? kExitOk : kExitBroken;
}

}  // namespace

Command add_readout(CLI::App& program, const std::string& command_line) {
  CLI::App* command = program.add_subcommand(
      "readout", "Find a recording's rolling shutter, and its field of view: those with which its points fit best");
  const auto chosen = std::make_shared<ReadoutChoice>();
  add_recording_options(command, &chosen->input);
  command->add_option("--estimate", chosen->estimates, "What to find: readout, fov or readout,fov [readout]")
      ->delimiter(',')
      ->check(CLI::IsMember({"readout", "fov"}))
      ->type_name("WHAT");
  command->add_option("--axis", chosen->axes, "Of the readout, where it is known: rows, columns or both [both]")
      ->check(CLI::IsMember({"rows", "columns", "both"}))
      ->type_name("AXIS");
  command->add_option("--out", chosen->out, "Folder for report.html, which draws how well each readout fits")
      ->type_name("DIR");
  add_tap_option(command, &chosen->run);
  command->footer(
      "The clip should start the map early and show the camera moving quickly now and then, in all directions. For "
      "the\n"
      "field of view it should turn, too, and the scene have depth.\n"
      "Examples:\n"
      "  pocket-ptam readout clip.mp4 --fov 60 --resize 320x240\n"
      "  pocket-ptam readout clip.mp4 --calibration phone.yaml --axis rows --out found\n"
      "  pocket-ptam readout clip.mp4 --resize 320x240 --estimate fov,readout\n"
      "Exit code 1: the clip cannot tell; why, and what would, is said.");
  return {command, [chosen, command_line] { return find_camera(*chosen, command_line); }};
}

}  // namespace pptam::app
