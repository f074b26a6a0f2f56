// pocket-ptam replay: a recorded sequence.

#include <filesystem>
#include <memory>

#include "platform/app/commands.h"
#include "platform/app/options.h"
#include "platform/app/single_run.h"
#include "platform/camera/image_list.h"

namespace pptam::app {
namespace {

using namespace platform;

struct ReplayChoice {
  RecordingInput input;
  std::string readout;
  RunOptions run;
  OutputOptions output;
};

// All files that the recording is read from.
void add_inputs(const RecordingOptions& recording, Knowledge* knowledge) {
  Inputs& inputs = knowledge->inputs;
  inputs.add("the recording", recording.source);
  inputs.add("the calibration", recording.calibration);
  std::error_code ignored;
  const bool is_folder = std::filesystem::is_directory(recording.source, ignored);
  if (std::filesystem::is_regular_file(recording.source, ignored) && !is_list(recording.source)) return;
  const ImageList list = list_images(recording.source, nullptr);
  for (const ImageEntry& image : list.images) inputs.add("the image", image.file);
  for (const std::filesystem::path& truth : {list.ground_truth.tum, list.ground_truth.euroc})
    inputs.add("the ground truth", truth);
  inputs.add("the calibration", list.calibration);
  if (is_folder) knowledge->image_folders.push_back(recording.source);
  if (!list.images.empty()) knowledge->image_folders.push_back(list.images.front().file.parent_path());
}

int replay_recording(const ReplayChoice& chosen, const std::string& command_line) {
  RecordingOptions recording = chosen.input.recording();
  if (!chosen.readout.empty()) {
    const Readout parsed = parse_readout(chosen.readout);
    recording.readout_axis = parsed.axis;
    recording.readout_s = parsed.seconds;
  }
  Knowledge knowledge;
  const std::unique_ptr<platform::Camera> camera = chosen.input.open(recording, &knowledge.warnings);
  add_inputs(recording, &knowledge);
  return run_and_write(*camera, chosen.run, chosen.output, knowledge, command_line);
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
