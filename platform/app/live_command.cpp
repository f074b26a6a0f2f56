// pocket-ptam live: a camera, as it is now.

#include <fcntl.h>
#include <unistd.h>

#include <cmath>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <memory>
#include <optional>
#include <utility>

#include "platform/app/commands.h"
#include "platform/app/options.h"
#include "platform/app/single_run.h"
#include "platform/camera/camera_list.h"
#include "platform/camera/device_camera.h"
#include "platform/camera/paced_camera.h"
#include "platform/input_error.h"
#include "platform/run/console.h"
#include "platform/run/interruption.h"
#include "platform/run/keys.h"
#include "platform/run/live.h"
#include "platform/run/names.h"
#include "platform/run/pose_lines.h"
#include "platform/text.h"
#include "sim_phone/phone_camera.h"
#include "sim_phone/scene.h"

namespace pptam::app {
namespace {

using namespace platform;
namespace fs = std::filesystem;

struct LiveChoice {
  std::string camera, readout, size, mode;
  DeviceOptions device;
  double fps = 0;
  std::string poses = "tum";
  std::string to;
  int udp = 0;
  bool no_auto_start = false;
  uint64_t seed = 1;
  LiveOptions live;
  OutputOptions output;
};

const std::string kSim = "sim:";

// The emulated phone in real time, "sim:desk": for trying things out without a camera.
std::unique_ptr<platform::Camera> open_sim(const LiveChoice& chosen) {
  sim::PhoneOptions phone;
  phone.scene = chosen.camera.substr(kSim.size());
  phone.seed = chosen.seed;
  phone.duration_s = 3600;
  if (chosen.fps > 0) phone.frames_per_s = chosen.fps;
  if (!chosen.device.calibration.empty() || chosen.device.fov_degrees > 0 || chosen.device.rotate_degrees != 0 ||
      !chosen.size.empty() || !chosen.mode.empty() || !chosen.readout.empty()) {
    throw InputError("camera " + chosen.camera + " knows its lens, size and readout: leave these options out");
  }
  if (chosen.output.show.predict)
    throw InputError("camera " + chosen.camera +
                     ": its frames have no real times, which --predict needs: leave it out");
  return make_paced_camera(sim::make_phone_camera(phone));
}

std::unique_ptr<platform::Camera> open_camera(const LiveChoice& chosen, std::vector<std::string>* warnings) {
  if (chosen.camera.rfind(kSim, 0) == 0) return open_sim(chosen);
  DeviceOptions options = chosen.device;
  if (!chosen.size.empty()) parse_size("--size", chosen.size, &options.width, &options.height);
  if (!chosen.mode.empty()) {  // 640x480, or YUYV:640x480
    const size_t colon = chosen.mode.find(':');
    if (colon != std::string::npos) options.request.format = chosen.mode.substr(0, colon);
    parse_size("--mode", colon == std::string::npos ? chosen.mode : chosen.mode.substr(colon + 1),
               &options.request.width, &options.request.height);
  }
  options.request.frames_per_s = chosen.fps;
  if (!chosen.readout.empty()) {
    const Readout parsed = parse_readout(chosen.readout);
    options.readout_axis = parsed.axis;
    options.readout_s = parsed.seconds;
  }
  return make_device_camera(open_camera_device(chosen.camera), options, warnings);
}

std::unique_ptr<PoseLines> open_poses(const LiveChoice& chosen, int standard_output) {
  if (chosen.poses == "none") return nullptr;
  const PoseFormat format = chosen.poses == "json" ? PoseFormat::kJson : PoseFormat::kTum;
  if (chosen.udp != 0) return PoseLines::to_udp(format, chosen.udp);
  if (!chosen.to.empty()) return PoseLines::to_file(format, chosen.to);
  return PoseLines::to_descriptor(format, ::fcntl(standard_output, F_DUPFD_CLOEXEC, 3));
}

// What a person sees on stderr: one line that changes on a terminal, elsewhere, and where poses run through the
// terminal, a line for each change of state.
class StatusLine {
 public:
  explicit StatusLine(bool poses_on_terminal) : terminal_(!poses_on_terminal && ::isatty(STDERR_FILENO) != 0) {}

  void say(const std::string& text) {
    progress_.finish();
    std::fprintf(stderr, "%s\n", printable(text).c_str());
  }
  void show(const LiveStatus& status) {
    if (!told_locks_ && !status.camera.locks.empty()) {
      told_locks_ = true;
      for (const std::string& line : status.camera.locks) say("  " + line);
    }
    if (!terminal_) {
      if (std::exchange(state_, status.state) != status.state || status.frames == 1)
        say(format("%.1f s: %s", status.seconds, name_of(status.state)) + advice(status));
      return;
    }
    if (status.seconds < next_s_ && status.state == state_ && !status.camera_gone) return;
    state_ = status.state;
    next_s_ = status.seconds + 0.25;  // the eye follows no more
    const double rate = status.seconds > 0 ? static_cast<double>(status.frames - 1) / status.seconds : 0;
    progress_.show(static_cast<int>(status.frames), 0,
                   format("%.1f/s  %s%s, %d keyframes, %d points, a pose is %.0f ms old", rate,
                          status.camera_gone ? "camera gone, " : "", name_of(status.state), status.keyframes,
                          status.map_points, status.ages.last_ms()) +
                       (status.locked ? ", locked" : "") + advice(status));
  }
  void finish() { progress_.finish(); }

 private:
  static std::string advice(const LiveStatus& status) {
    const std::string sentence = sentence_for(status.hint);
    return sentence.empty() ? "" : "  " + sentence;
  }

  bool terminal_;
  Progress progress_;
  bool told_locks_ = false;
  double next_s_ = 0;
  TrackingState state_ = TrackingState::kWaiting;
};

// Pose lines have standard output for themselves; all else goes to where errors go.
class StandardOutput {
 public:
  StandardOutput() : poses_(::fcntl(STDOUT_FILENO, F_DUPFD_CLOEXEC, 3)) {
    std::fflush(stdout);
    ::dup2(STDERR_FILENO, STDOUT_FILENO);
  }
  ~StandardOutput() {
    if (poses_ >= 0) ::close(poses_);
  }
  StandardOutput(const StandardOutput&) = delete;
  StandardOutput& operator=(const StandardOutput&) = delete;
  int poses() const { return poses_; }

 private:
  int poses_;
};

class LiveSession {
 public:
  LiveSession(const LiveChoice& chosen, std::string command_line)
      : chosen_(chosen),
        command_line_(std::move(command_line)),
        status_(chosen.poses != "none" && chosen.to.empty() && chosen.udp == 0 && ::isatty(output_.poses()) != 0) {}

  int run() {
    try {
      return run_camera();
    } catch (const InputError&) {
      if (started_ || (!interrupted() && !quit_)) throw;
      status_.say((quit_ ? "ended" : interruption()) + " before the first frame: nothing was done");
      return kExitOk;
    }
  }

 private:
  int run_camera() {
    check();
    Knowledge knowledge;
    knowledge.inputs.add("the calibration", chosen_.device.calibration);
    if (!chosen_.output.save_map.empty()) {
      Inputs inputs = knowledge.inputs;
      inputs.add("the map of --load-map", chosen_.live.run.load_map);
      check_map_file(chosen_.output.save_map, inputs);
    }
    if (!chosen_.output.trace.empty()) {
      Inputs inputs = knowledge.inputs;
      inputs.add("the map of --load-map", chosen_.live.run.load_map);
      check_trace_file(chosen_.output, inputs);
    }
    const std::unique_ptr<platform::Camera> camera = open_camera(chosen_, &knowledge.warnings);
    for (const std::string& warning : knowledge.warnings) print_warning(warning);
    if (chosen_.output.show.where != DisplayChoice::kNowhere)
      show_.emplace(
          chosen_.output.show, camera->info(), [this](const std::string& text) { status_.say(text); }, camera.get());
    stop_on_signals();
    knowledge.camera_told = chosen_.camera.rfind(kSim, 0) != 0;  // the emulated phone knows its own
    const Runner runner = [&](const StartObserver& on_start, const FrameObserver& on_frame) {
      return live(*camera, on_start, on_frame);
    };
    if (!chosen_.output.out.empty()) {
      OutputOptions output = chosen_.output;
      output.no_progress = true;
      const int code = run_and_write(camera->info().name, camera->ground_truth(), runner, chosen_.live.run, output,
                                     knowledge, command_line_);
      return finish(code == kExitOk);
    }
    const RunLog log = runner([](const CameraInfo&) {}, {});
    bool good = log.save_trouble.empty();
    for (const std::string& warning : log.warnings) print_warning(warning);
    if (!log.save_trouble.empty())
      print_error("--save-map " + chosen_.output.save_map + ": nothing was saved: " + log.save_trouble);
    if (!log.saved_map.empty()) good = save(log.saved_map) && good;
    if (!chosen_.output.trace.empty()) {
      try {
        write_trace_file(chosen_.output, log, command_line_);
      } catch (const std::exception& error) {  // the rest is still to be told
        print_error(error.what());
        good = false;
      }
    }
    return finish(good);
  }

  void check() const {
    if (chosen_.udp != 0 && !chosen_.to.empty()) throw InputError("--udp and --to: poses go one way, choose one");
    if ((chosen_.udp != 0 || !chosen_.to.empty()) && chosen_.poses == "none")
      throw InputError("--poses none: --udp and --to have nothing to send");
    if (!chosen_.to.empty()) PoseLines::check_file(chosen_.to);
    const std::string& map = chosen_.output.save_map;
    if (!map.empty() && !chosen_.to.empty() && same_place(map, chosen_.to))
      throw InputError("--save-map " + map + ": is where --to writes, name another file");
    if (!chosen_.output.trace.empty() && !chosen_.to.empty() && same_place(chosen_.output.trace, chosen_.to))
      throw InputError("--trace " + chosen_.output.trace + ": is where --to writes, name another file");
    const std::string& record = chosen_.live.record;
    if (record.empty()) return;
    LiveRecording::check(record);
    for (const auto& [option, file] :
         {std::pair("--save-map ", map), std::pair("--to ", chosen_.to), std::pair("--trace ", chosen_.output.trace)}) {
      if (file.empty()) continue;
      const fs::path folder = fs::absolute(file).lexically_normal().parent_path();
      if (same_place(file, record) || same_place(folder, record))
        throw InputError(option + file + ": the folder is taken by --record, name another one");
    }
  }

  RunLog live(platform::Camera& camera, const StartObserver& on_start, const FrameObserver& on_frame) {
    Keys keys;
    LiveObserver observer;
    if (show_) static_cast<Spectator&>(observer) = spectator_of(&*show_, &keys);
    observer.on_start = [&](const CameraInfo& info) {
      on_start(info);
      started_ = true;
      poses_ = open_poses(chosen_, output_.poses());
      status_.say(info.name + format(": tracking %dx%d", info.model.width, info.model.height) +
                  (keys.terminal() ? "; keys: t tap, r reset, l lock, m mark, g ground, s save map, q quit" : ""));
    };
    if (!show_) {
      observer.key = [&keys] { return run_key_of(keys.next()); };
      observer.say = [&](const std::string& text) { status_.say(text); };
    }
    observer.key = [this, key = observer.key] {
      const RunKey pressed = key();
      quit_ = quit_ || pressed == RunKey::kQuit;
      return pressed;
    };
    observer.on_result = [&](const TrackResult& result, int64_t arrived_ns) {
      return !poses_ || poses_->add(result, arrived_ns);
    };
    observer.on_frame = on_frame;
    observer.on_status = [&](const LiveStatus& status) { status_.show(status); };
    if (!chosen_.output.save_map.empty()) observer.on_save = [&](std::span<const std::byte> map) { save(map); };
    LiveOptions options = chosen_.live;
    options.keep_frames = !chosen_.output.out.empty();
    result_ = run_live(camera, options, observer);
    status_.finish();
    print_rows(summarise(result_));
    if (interrupted()) status_.say(interruption());
    return result_.log;
  }

  bool save(std::span<const std::byte> map) {
    try {
      write_map_file(chosen_.output.save_map, map);
      const std::string text = "map saved to " + chosen_.output.save_map;
      show_ ? show_->say(text) : status_.say(text);
      return true;
    } catch (const InputError& error) {
      status_.finish();
      print_error(error.what());
      return false;
    }
  }

  int finish(bool good) {
    if (poses_ && poses_->left_out() > 0)
      print_warning(format("%lld poses were left out: their reader was not there or too slow",
                           static_cast<long long>(poses_->left_out())));
    if (poses_ && !poses_->trouble().empty()) {
      print_error(poses_->trouble());
      good = false;
    }
    if (!result_.status.record_trouble.empty()) {
      print_error("--record " + result_.status.record_trouble +
                  format("; the %d frames before can be replayed", result_.status.recorded));
      good = false;
    }
    return good ? kExitOk : kExitBroken;
  }

  const LiveChoice& chosen_;
  std::string command_line_;
  StandardOutput output_;
  std::unique_ptr<PoseLines> poses_;
  StatusLine status_;
  std::optional<ScreenShow> show_;
  LiveResult result_;
  bool started_ = false;
  bool quit_ = false;  // by a key
};

void add_camera_options(CLI::App* live, LiveChoice* chosen) {
  DeviceOptions& device = chosen->device;
  live->add_option("--camera", chosen->camera,
                   "/dev/video0, libcamera:0, or sim:desk, the emulated phone [the first of pocket-ptam cameras]")
      ->type_name("CAMERA");
  live->add_option("--calibration", device.calibration, "Of the camera's images at this size, or of the same shape")
      ->type_name("FILE");
  live->add_option("--fov", device.fov_degrees, "Horizontal field of view, when there is no calibration")
      ->check(CLI::Range(1.0, 170.0))
      ->type_name("DEGREES");
  live->add_option("--mode", chosen->mode, "The device's size and perhaps format, 640x480 or YUYV:640x480 [nearest]")
      ->type_name("[FORMAT:]WxH");
  live->add_option("--size", chosen->size, "Tracked: cut out of the middle and shrunk [320x240, upright 240x320]")
      ->type_name("WxH");
  live->add_option("--fps", chosen->fps, "Frames per second [30]")->check(CLI::Range(1.0, 240.0))->type_name("N");
  live->add_option("--rotate", device.rotate_degrees, "Clockwise: 0, 90, 180 or 270")->type_name("DEGREES");
  live->add_option("--readout", chosen->readout, "Rolling shutter of the device, rows|columns:+|-:SECONDS");
  live->add_option("--exposure", device.sensor.exposure_s, "Exposure time [what the camera finds in 0.7 s]")
      ->check(CLI::Range(0.00001, 1.0))
      ->type_name("SECONDS");
  live->add_option("--mains", device.sensor.mains_hz, "Of lamps, 50 or 60 Hz: the camera's filter against flicker")
      ->check(CLI::IsMember({50, 60}))
      ->type_name("HZ");
  live->add_option("--seed", chosen->seed, "Of --camera sim:SCENE")->type_name("N");
}

void add_live_options(CLI::App* live, LiveChoice* chosen) {
  RunOptions& run = chosen->live.run;
  live->add_option("--poses", chosen->poses, "Lines: tum (timestamp tx ty tz qx qy qz qw), json, or none [tum]")
      ->check(CLI::IsMember({"tum", "json", "none"}))
      ->type_name("FORMAT");
  live->add_option("--to", chosen->to, "Write the lines to a new file or a named pipe [standard output]")
      ->type_name("FILE");
  live->add_option("--udp", chosen->udp, "Send the lines to this UDP port of 127.0.0.1, and nowhere else")
      ->check(CLI::Range(1, 65535))
      ->type_name("PORT");
  live->add_flag("--no-auto-start", chosen->no_auto_start,
                 "Start when t is pressed, not when the camera is held still");
  live->add_option("--plane-distance", run.plane_distance,
                   "Of the first view from the ground, z = 0, in any unit: sets the map's scale")
      ->check(CLI::Range(0.001, 1000.0))
      ->type_name("LENGTH");
  live->add_option(
          "--length", chosen->live.length,
          "Between two points of the scene, in any unit, to set the map's scale: aim the image's middle at each "
          "and press m")
      ->check(CLI::Range(0.001, 1000.0))
      ->type_name("LENGTH");
  add_ground_option(live, &run);
  live->add_option("--max-keyframes", run.max_keyframes, "Config::max_keyframes [35]")->type_name("N");
  live->add_option("--load-map", run.load_map, "Begin with a map saved earlier, made with this camera")
      ->type_name("FILE");
  live->add_option_function<std::string>(
          "--save-map",
          [chosen](const std::string& file) {
            chosen->output.save_map = file;
            chosen->live.run.save_map = true;
          },
          "Save the map at the end and when s is pressed; another file than a map is never replaced")
      ->type_name("FILE");
  live->add_flag("--lock-map", run.lock_map, "Track only: a finished or loaded map is not changed any more");
  live->add_option("--record", chosen->live.record,
                   "Store frames and all that was done in a new folder; replay repeats it bit for bit")
      ->type_name("DIR");
  live->add_option("--out", chosen->output.out,
                   "Folder for the results, as those of replay; keeps 400 bytes of memory a frame")
      ->type_name("DIR");
  live->add_option("--duration", chosen->live.duration_s, "End after so long [never]")
      ->check(CLI::Range(0.01, 1e9))
      ->type_name("SECONDS");
  add_trace_option(live, &run, &chosen->output);
  add_show_options(live, &chosen->output.show);
  live->add_flag(
          "--predict", chosen->output.show.predict,
          "With --show: house and grid where they will be when the picture is seen, not where the image has them")
      ->needs("--show");
}

}  // namespace

Command add_live(CLI::App& program, const std::string& command_line) {
  CLI::App* live = program.add_subcommand("live", "Run on a camera, as it is now");
  const auto chosen = std::make_shared<LiveChoice>();
  add_camera_options(live, chosen.get());
  add_live_options(live, chosen.get());
  live->footer(
      "Keys: t tap, r reset, l lock or unlock the map, m mark an end of --length, g the middle of the image shows\n"
      "the ground, s save the map, q quit; also as characters through a pipe.\n"
      "Times are those of CLOCK_MONOTONIC at mid-exposure. What is said meanwhile goes to standard error.\n"
      "Examples:\n"
      "  pocket-ptam live --fov 60                                   the first camera, poses on the terminal\n"
      "  pocket-ptam live --camera /dev/video2 --calibration cam.yaml --mains 50\n"
      "  pocket-ptam live --camera libcamera:0 --calibration cam.yaml --poses json --udp 5005\n"
      "  pocket-ptam live --fov 60 --record desk --duration 30       and then: pocket-ptam replay desk\n"
      "  pocket-ptam live --fov 60 --show --poses none               the house on a display\n"
      "  pocket-ptam live --fov 60 --duration 30 --trace t.json      what took how long, for ui.perfetto.dev\n"
      "  pocket-ptam live --camera sim:desk --duration 10            without any camera");
  return {live, [chosen, command_line] {
            chosen->live.run.auto_start = !chosen->no_auto_start && chosen->live.run.load_map.empty();
            chosen->output.no_overlay = true;
            return LiveSession(*chosen, command_line).run();
          }};
}

}  // namespace pptam::app
