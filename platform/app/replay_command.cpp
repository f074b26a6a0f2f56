// pocket-ptam replay: a recorded sequence.

#include <filesystem>
#include <memory>
#include <optional>

#include "platform/app/commands.h"
#include "platform/app/options.h"
#include "platform/app/single_run.h"
#include "platform/input_error.h"
#include "platform/run/console.h"
#include "platform/run/live_recording.h"
#include "platform/text.h"

namespace pptam::app {
namespace {

using namespace platform;

struct ReplayChoice {
  RecordingInput input;
  std::string readout;
  bool images_only = false;
  RunOptions run;
  std::optional<laboratory::Phone> phone;
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

// A live run's recording, repeated.
int repeat_live(const ReplayChoice& chosen, const std::string& command_line) {
  const RecordingInput& input = chosen.input;
  const RunOptions& run = chosen.run;
  if (!input.calibration.empty() || input.options.fov_degrees != 0 || !input.resize.empty() ||
      input.options.every != 1 || input.options.fps != 0 || input.options.rotate_degrees != 0 ||
      !chosen.readout.empty() || !run.taps_s.empty() || run.auto_start || run.plane_distance != 0 ||
      run.max_keyframes || run.max_erased_keyframes || !run.steady_damping || !run.load_map.empty() || run.lock_map ||
      chosen.phone || run.profile != SystemProfile::kPhone) {
    throw InputError("recording " + input.source + " repeats what was done live, bit for bit: camera, taps, maps and " +
                     "phone are in it; with other ones add --images-only");
  }
  const LiveScript script = read_live_recording(input.source);
  Knowledge knowledge;
  knowledge.inputs.add("the recording", script.folder / LiveRecording::kEventsName);
  for (const LiveScript::Event& event : script.events) {
    if (!event.file.empty()) knowledge.inputs.add("the recording's file", script.folder / event.file);
  }
  knowledge.image_folders = {script.folder, script.folder / "rgb"};
  if (!script.map_hash)
    knowledge.warnings.push_back(input.source + ": the recording was broken off; what is there is repeated");
  for (const std::string& warning : knowledge.warnings) print_warning(warning);
  const Watching watching(chosen.output, script.camera);
  bool whole = true;
  const Runner runner = [&](const StartObserver& on_start, const FrameObserver& on_frame) {
    RunLog log = repeat_live_recording(script, run, on_start, on_frame, watching.spectator());
    whole = !log.quit;
    return log;
  };
  const int code = run_and_write(script.camera.name, {}, runner, run, chosen.output, knowledge, command_line);
  if (code == kExitOk && !whole) {
    print_line("ended by key q: the same bits as in the live run up to there; the rest, and its map, was not compared");
  } else if (code == kExitOk && script.map_hash) {
    print_line("the same bits as in the live run");
  }
  return code;
}

int replay_recording(const ReplayChoice& chosen, const std::string& command_line) {
  if (!chosen.images_only && is_live_recording(chosen.input.source)) return repeat_live(chosen, command_line);
  RecordingOptions recording = chosen.input.recording();
  if (!chosen.readout.empty()) {
    const Readout parsed = parse_readout(chosen.readout);
    recording.readout_axis = parsed.axis;
    recording.readout_s = parsed.seconds;
  }
  Knowledge knowledge;
  knowledge.camera_told = true;
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
  replay->add_flag("--images-only", chosen->images_only,
                   "Of a recording made by live take the images alone; else all is repeated, bit for bit");
  add_run_options(replay, &chosen->run, &chosen->output);
  add_phone_option(replay, &chosen->run, &chosen->phone);
  add_show_options(replay, &chosen->output.show);
  replay->footer(
      "Examples:\n"
      "  pocket-ptam replay rgbd_dataset_freiburg1_xyz --calibration fr1.yaml --resize 320x240\n"
      "  pocket-ptam replay clip.mp4 --fov 50 --readout rows:+:0.030\n"
      "  pocket-ptam replay 'frames/img_%04d.png' --fov 60 --fps 15 --tap 2\n"
      "  pocket-ptam replay monday.mp4 --calibration phone.yaml --save-map room.map\n"
      "  pocket-ptam replay tuesday.mp4 --calibration phone.yaml --load-map room.map\n"
      "  pocket-ptam replay clip.mp4 --fov 50 --phone pi_zero --trace clip.json     that phone's times; for Perfetto\n"
      "  pocket-ptam replay clip.mp4 --fov 50 --show        in a window, or on the screen of a board\n"
      "  pocket-ptam replay desk                            what live --record desk did, bit for bit");
  return {replay, [chosen, command_line] { return replay_recording(*chosen, command_line); }};
}

}  // namespace pptam::app
