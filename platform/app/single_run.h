// One run with all its outputs: what sim, replay and live do once they have a camera.
#pragma once

#include <cstddef>
#include <filesystem>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "platform/app/options.h"
#include "platform/camera.h"
#include "platform/outputs.h"
#include "platform/run/keys.h"
#include "platform/run/run.h"
#include "platform/run/screen_show.h"
#include "platform/run/summary.h"

namespace pptam::app {

// What is known of the sequence beyond its true trajectory.
struct Knowledge {
  bool plane_known = false;  // the truth's z = 0 is the scene's ground
  // Further rows for the summary; null: none.
  std::function<std::vector<platform::SummaryRow>(const platform::RunLog&, const platform::Trajectory& truth)> judge;
  platform::Inputs inputs;                           // what it is read from: never an output
  std::vector<std::filesystem::path> image_folders;  // likewise: no place for outputs
  std::vector<std::string> warnings;                 // printed already
  bool camera_told = false;  // by the user: whether what was tracked contradicts it is looked at after the run
};

// Runs, writes the results into the folder of the options, prints the summary. What cannot be written is told and does
// not stop the rest. Returns the exit code. Throws InputError before the first frame is tracked, with nothing done.
int run_and_write(platform::Camera& camera, const platform::RunOptions& run_options, const OutputOptions& output,
                  const Knowledge& knowledge, const std::string& command_line);

// The same of another kind of run, which calls the two observers as run_sequence() does.
using Runner = std::function<platform::RunLog(const platform::StartObserver&, const platform::FrameObserver&)>;
int run_and_write(const std::string& name, const platform::Trajectory& truth, const Runner& runner,
                  const platform::RunOptions& run_options, const OutputOptions& output, const Knowledge& knowledge,
                  const std::string& command_line);

// --save-map alone: judged before anything is done, and written; both throw InputError. to_be_made: a folder that will
// be made before; empty: none.
void check_map_file(const std::string& file, const platform::Inputs& inputs,
                    const std::filesystem::path& to_be_made = {});
void write_map_file(const std::string& file, std::span<const std::byte> map);

// --trace likewise.
void check_trace_file(const OutputOptions& output, const platform::Inputs& inputs,
                      const std::filesystem::path& to_be_made = {});
void write_trace_file(const OutputOptions& output, const platform::RunLog& log, const std::string& command_line);

// Somebody who watches what the options say: a display, if they name one, and the terminal's keys with it.
class Watching {
 public:
  // Opens the display. Throws InputError.
  Watching(const OutputOptions& output, const platform::CameraInfo& camera);
  const platform::Spectator& spectator() const { return spectator_; }

 private:
  std::optional<platform::Keys> keys_;
  std::optional<platform::ScreenShow> show_;
  platform::Spectator spectator_;
};

// Adds all files that the recording is read from.
void add_inputs(const platform::RecordingOptions& recording, Knowledge* knowledge);

// The usual folder of results in out/: "desk, seed 3" -> "desk-seed-3".
std::string folder_name(const std::string& name);

}  // namespace pptam::app
