// pocket-ptam replay: a recorded sequence.

#include <memory>

#include "platform/app/commands.h"
#include "platform/app/options.h"
#include "platform/app/single_run.h"
#include "platform/run/console.h"

namespace pptam::app {
namespace {

using namespace platform;

struct ReplayChoice {
  RecordingInput input;
  std::string readout;
  RunOptions run;
  OutputOptions output;
};

int replay_recording(const ReplayChoice& chosen, const std::string& command_line) {
  RecordingOptions recording = chosen.input.recording();
  if (!chosen.readout.empty()) {
    const Readout parsed = parse_readout(chosen.readout);
    recording.readout_axis = parsed.axis;
    recording.readout_s = parsed.seconds;
  }
  std::vector<std::string> warnings;
  const std::unique_ptr<platform::Camera> camera = open_recording(recording, &warnings);
  for (const std::string& warning : warnings) print_warning(warning);
  return run_and_write(*camera, chosen.run, chosen.output, {}, command_line);
}

}  // namespace

Command add_replay(CLI::App& program, const std::string& command_line) {
  CLI::App* replay = program.add_subcommand("replay", "Run on a recorded sequence");
  const auto chosen = std::make_shared<ReplayChoice>();
  add_recording_options(replay, &chosen->input);
  replay->add_option("--readout", chosen->readout, "Rolling shutter of the source, rows|columns:+|-:SECONDS");
  add_run_options(replay, &chosen->run, &chosen->output);
  replay->footer(
      "Examples:\n"
      "  pocket-ptam replay rgbd_dataset_freiburg1_xyz --calibration fr1.yaml --resize 320x240\n"
      "  pocket-ptam replay clip.mp4 --fov 50 --readout rows:+:0.030\n"
      "  pocket-ptam replay 'frames/img_%04d.png' --fov 60 --fps 15 --tap 2\n"
      "  pocket-ptam replay monday.mp4 --calibration phone.yaml --save-map room.map\n"
      "  pocket-ptam replay tuesday.mp4 --calibration phone.yaml --load-map room.map");
  return {replay, [chosen, command_line] { return replay_recording(*chosen, command_line); }};
}

}  // namespace pptam::app
