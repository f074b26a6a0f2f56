#include "platform/app/options.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>

#include "platform/input_error.h"
#include "platform/run/console.h"
#include "platform/text.h"

namespace pptam::app {
namespace {

using namespace platform;

// The phone's images, pixels, and beyond how many times that --resize is advised. A clip of 30 frames/s on the modelled
// phone: at 3 times every frame is tracked, at 4.5 times frames are dropped, at 6 times no map begins.
constexpr int kProfileLonger = 320;
constexpr int kProfileShorter = 240;
constexpr int kLargeFactor = 3;

}  // namespace

void parse_size(const std::string& option, const std::string& text, int* width, int* height) {
  int used = 0;
  if (std::sscanf(text.c_str(), "%dx%d%n", width, height, &used) != 2 || static_cast<size_t>(used) != text.size() ||
      *width <= 0 || *height <= 0) {
    throw InputError(option + " " + text + ": write WIDTHxHEIGHT, for example 320x240");
  }
}

// "rows:+:0.03"
Readout parse_readout(const std::string& text) {
  const auto refuse = [&]() -> InputError {
    return InputError("--readout " + text + ": write AXIS:DIRECTION:SECONDS, for example columns:-:0.060");
  };
  const size_t first = text.find(':');
  if (first == std::string::npos || first + 2 >= text.size() || text[first + 2] != ':') throw refuse();
  const std::string axis = text.substr(0, first);
  const char direction = text[first + 1];
  const std::string number = text.substr(first + 3);
  Readout readout;
  if (axis == "columns") {
    readout.axis = RollingShutter::Axis::kColumns;
  } else if (axis != "rows") {
    throw refuse();
  }
  size_t used = 0;
  try {
    readout.seconds = std::stod(number, &used);
  } catch (const std::exception&) {
    throw refuse();
  }
  if (used != number.size() || !(readout.seconds >= 0 && readout.seconds <= 1) ||
      (direction != '+' && direction != '-')) {
    throw refuse();
  }
  if (direction == '-') readout.seconds = -readout.seconds;
  return readout;
}

void add_tap_option(CLI::App* command, RunOptions* run) {
  command->add_option("--tap", run->taps_s, "Tap at this time; may be repeated [at the start, and after failures]")
      ->type_name("SECONDS")
      ->expected(1)
      ->multi_option_policy(CLI::MultiOptionPolicy::TakeAll);
}

void add_ground_option(CLI::App* command, RunOptions* run) {
  command
      ->add_option_function<std::string>(
          "--ground",
          [run](const std::string& text) {
            float x = 0, y = 0;
            int used = 0;
            if (std::sscanf(text.c_str(), "%f,%f%n", &x, &y, &used) != 2 || static_cast<size_t>(used) != text.size() ||
                !(x >= 0 && y >= 0))
              throw InputError("--ground " + text + ": write X,Y in pixels, for example 120,250");
            run->ground = Vector2f(x, y);
          },
          "The ground, z = 0, is the plane at this pixel of the first image with a pose, as tracked; the report shows "
          "the choices [the largest plane, or what is below an upright one]")
      ->type_name("X,Y");
}

std::string phone_option_says() {
  return "A phone's profile, for the work clock: " + joined(laboratory::phone_names()) + ", or a file";
}

void add_phone_option(CLI::App* command, RunOptions* run, std::optional<laboratory::Phone>* phone) {
  command
      ->add_option_function<std::string>(
          "--phone",
          [run, phone](const std::string& name) {
            const laboratory::Phone loaded = laboratory::load_phone(name);
            laboratory::use_processor(loaded, run);
            *phone = loaded;
          },
          phone_option_says())
      ->type_name("NAME|FILE")
      ->excludes("--clock");
}

void add_trace_option(CLI::App* command, RunOptions* run, OutputOptions* output) {
  command
      ->add_option_function<std::string>(
          "--trace",
          [run, output](const std::string& file) {
            output->trace = file;
            run->keep_trace = true;
          },
          "Write what was done when, for ui.perfetto.dev or chrome://tracing; 32 bytes of memory a span until the "
          "end, for 8 million at most. Only an earlier trace is replaced")
      ->type_name("FILE");
}

void add_show_options(CLI::App* command, ShowOptions* show) {
  static const std::map<std::string, DisplayChoice> kPlaces = {
      {"auto", DisplayChoice::kAuto}, {"window", DisplayChoice::kWindow}, {"screen", DisplayChoice::kScreen}};
  // A flag, so that what follows is no value of it; "auto" is what it means alone.
  const auto place = std::make_shared<std::string>();
  command->add_flag(
      "--show{auto}", *place,
      "Show it as it goes, by real time: in a window, or, where there is no window system, on the whole "
      "screen; --show=window or --show=screen for one of them. Keys there: t tap, r reset, l lock or unlock "
      "the map, g the middle shows the ground, s save it, p picture, v view, q quit");
  command->parse_complete_callback([place, show] {
    if (place->empty()) return;
    const auto found = kPlaces.find(*place);
    if (found == kPlaces.end()) throw InputError("--show=" + *place + ": choose window, screen or auto");
    show->where = found->second;
  });
  command
      ->add_option("--turn", show->turn_degrees,
                   "With --show: the picture clockwise, for a screen mounted sideways [0]")
      ->check(CLI::IsMember({0, 90, 180, 270}))
      ->type_name("DEGREES");
}

void add_run_options(CLI::App* command, RunOptions* run, OutputOptions* output) {
  static const std::map<std::string, ClockKind> kClocks = {
      {"work", ClockKind::kWork}, {"steady", ClockKind::kSteady}, {"throttled", ClockKind::kThrottled}};
  command
      ->add_option("--out", output->out,
                   "Folder for the results [out/NAME]; files there that an earlier run did not make stay")
      ->type_name("DIR");
  command
      ->add_option_function<std::string>(
          "--clock",
          [run](const std::string& name) {
            const auto found = kClocks.find(name);
            if (found == kClocks.end()) throw InputError("--clock " + name + ": choose work, steady or throttled");
            run->clock = found->second;
          },
          "work (modelled phone time, repeatable), steady (real time) or throttled (this computer slowed down) [work]")
      ->type_name("NAME");
  command->add_option("--slowdown", run->slowdown, "Factor of the throttled clock")
      ->capture_default_str()
      ->check(CLI::Range(0.01, 10000.0))
      ->type_name("FACTOR");
  static const std::map<std::string, SystemProfile> kProfiles = {
      {"phone", SystemProfile::kPhone}, {"tiny", SystemProfile::kTiny}, {"desktop", SystemProfile::kDesktop}};
  command
      ->add_option_function<std::string>(
          "--profile",
          [run](const std::string& name) {
            const auto found = kProfiles.find(name);
            if (found == kProfiles.end()) throw InputError("--profile " + name + ": choose phone, tiny or desktop");
            run->profile = found->second;
          },
          "The system: phone (2009; 50 points a frame), tiny (the same for a microcontroller, images of 192x144 to "
          "160x120 "
          "in 1.5 MB) or desktop (2007; 1000 points a frame, in four levels) [phone]")
      ->type_name("NAME");
  command->add_flag_callback(
      "--no-drop", [run] { run->drop_late = false; }, "Track every frame, however late");
  add_tap_option(command, run);
  command->add_flag(
      "--auto-start", run->auto_start,
      "No tap: start when the camera is held still, again after failures, and anew, in another map, when it "
      "stays lost");
  command
      ->add_option("--plane-distance", run->plane_distance,
                   "Of the first view from the ground, z = 0, in any unit: sets the map's scale")
      ->check(CLI::Range(0.001, 1000.0))
      ->type_name("LENGTH");
  add_ground_option(command, run);
  command
      ->add_option("--max-keyframes", run->max_keyframes, "Config::max_keyframes [35; 12 of tiny, 100 of the desktop]")
      ->type_name("N");
  command
      ->add_option("--max-erased-keyframes", run->max_erased_keyframes,
                   "Config::max_erased_keyframes [35; 4 of tiny and of the desktop]")
      ->type_name("N");
  command->add_flag_callback(
      "--no-damping", [run] { run->steady_damping = false; }, "Show every pose as measured, also of a camera at rest");
  command
      ->add_option("--load-map", run->load_map,
                   "Begin with a map saved earlier, made with this camera; other image sizes are made equal")
      ->type_name("FILE");
  command
      ->add_option_function<std::string>(
          "--save-map",
          [run, output](const std::string& file) {
            output->save_map = file;
            run->save_map = true;
          },
          "Save the map at the end; an older map is replaced whole or not at all, another file never")
      ->type_name("FILE");
  command->add_flag("--lock-map", run->lock_map, "Track only: a finished or loaded map is not changed any more");
  add_trace_option(command, run, output);
  command->add_flag("--no-overlay", output->no_overlay, "No overlay.mp4 and stills");
  command->add_flag("--no-report", output->no_report, "No report.html");
}

RecordingOptions RecordingInput::recording() const {
  RecordingOptions recording = options;
  recording.source = source;
  recording.calibration = calibration;
  if (!resize.empty()) parse_size("--resize", resize, &recording.resize_width, &recording.resize_height);
  return recording;
}

std::unique_ptr<platform::Camera> RecordingInput::open(const RecordingOptions& recording,
                                                       std::vector<std::string>* warnings) const {
  std::unique_ptr<platform::Camera> camera = open_recording(recording, warnings);
  const CameraModel& model = camera->info().model;
  const int longer = std::max(model.width, model.height);
  const int shorter = std::min(model.width, model.height);
  if (longer > kLargeFactor * kProfileLonger || shorter > kLargeFactor * kProfileShorter) {
    const double scale = static_cast<double>(kProfileLonger) / longer;
    const auto scaled = [scale](int side) { return std::max(1L, std::lround(side * scale)); };
    warnings->push_back(
        format("%s: its images of %dx%d are much larger than the %dx%d that the tracker is made for: it "
               "takes long and may find no start; try --resize %ldx%ld, the same shape",
               camera->info().name.c_str(), model.width, model.height, kProfileLonger, kProfileShorter,
               scaled(model.width), scaled(model.height)));
  }
  for (const std::string& warning : *warnings) print_warning(warning);
  return camera;
}

void add_recording_options(CLI::App* command, RecordingInput* input) {
  command->add_option("source", input->source, "Folder (TUM, EuRoC, images), pattern such as img_%04d.png, or video")
      ->required()
      ->type_name("SOURCE");
  command
      ->add_option("--calibration", input->calibration,
                   "Camera calibration of Kalibr, OpenCV, ROS, EuRoC, ORB-SLAM, COLMAP and others")
      ->type_name("FILE");
  command->add_option("--fov", input->options.fov_degrees, "Horizontal field of view, when there is no calibration")
      ->type_name("DEGREES");
  command->add_option("--resize", input->resize, "Scale the images, after rotation")->type_name("WxH");
  command->add_option("--every", input->options.every, "Keep one frame of so many")
      ->capture_default_str()
      ->type_name("N");
  command
      ->add_option("--fps", input->options.fps,
                   "Frames per second of images and raw streams without times [30, 25]; overrides a video's")
      ->type_name("N");
  command->add_option("--rotate", input->options.rotate_degrees, "Clockwise: 0, 90, 180 or 270")
      ->capture_default_str()
      ->type_name("DEGREES");
}

}  // namespace pptam::app
