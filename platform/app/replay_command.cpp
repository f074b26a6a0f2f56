// pocket-ptam replay: a recorded sequence.

#include <filesystem>
#include <memory>

#include "platform/app/commands.h"
#include "platform/app/options.h"
#include "platform/app/single_run.h"
#include "platform/input_error.h"
#include "platform/text.h"

namespace pptam::app {
namespace {

using namespace platform;

struct ReplayChoice {
  RecordingInput input;
  std::string readout;
  RunOptions run;
  OutputOptions output;
};

// A map that was made with images of another size: the larger ones of the two are made as small as the others, the
// recording's here, the map's by System::load_map. Whether it is the same lens is seen there.
void meet_map(const std::string& map_file, RecordingOptions* recording, std::vector<std::string>* warnings) {
  MapInfo map;
  if (!System::map_info(read_map_file(map_file), &map).ok()) return;  // refused when it is loaded
  const CameraModel made = map.camera.model;
  const CameraModel given = open_recording(*recording, nullptr)->info().model;
  if (made.width == given.width && made.height == given.height) return;
  const std::string sizes = format("the map %s has images of %dx%d, the recording of %dx%d", map_file.c_str(),
                                   made.width, made.height, given.width, given.height);
  if (made.width > given.width && made.height > given.height) {
    warnings->push_back(sizes + ": the map is scaled down, and finer measurements are lost");
  } else if (made.width <= given.width && made.height <= given.height) {
    if (recording->resize_width != 0)
      throw InputError(sizes + format(": give --resize %dx%d, or leave --resize out", made.width, made.height));
    recording->resize_width = made.width;
    recording->resize_height = made.height;
    warnings->push_back(sizes + ": the recording is made as small");
  }
}

int replay_recording(const ReplayChoice& chosen, const std::string& command_line) {
  RecordingOptions recording = chosen.input.recording();
  if (!chosen.readout.empty()) {
    const Readout parsed = parse_readout(chosen.readout);
    recording.readout_axis = parsed.axis;
    recording.readout_s = parsed.seconds;
  }
  Knowledge knowledge;
  if (!chosen.run.load_map.empty()) meet_map(chosen.run.load_map, &recording, &knowledge.warnings);
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
