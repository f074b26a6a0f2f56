// pocket-ptam: tracks and maps a recorded or an emulated sequence, and judges the result.

#include <CLI/CLI.hpp>
#include <cmath>
#include <cstdio>
#include <map>
#include <memory>
#include <optional>

#include "platform/app/map_command.h"
#include "platform/app/readout.h"
#include "platform/camera/dump_sequence.h"
#include "platform/camera/recorded_camera.h"
#include "platform/files.h"
#include "platform/run/console.h"
#include "platform/run/evaluation.h"
#include "platform/run/names.h"
#include "platform/run/overlay.h"
#include "platform/run/report.h"
#include "platform/run/run.h"
#include "platform/run/text_outputs.h"
#include "platform/text.h"
#include "sim_phone/laboratory/culling_study.h"
#include "sim_phone/laboratory/endurance.h"
#include "sim_phone/laboratory/judgement.h"
#include "sim_phone/laboratory/start_study.h"
#include "sim_phone/laboratory/suite.h"
#include "sim_phone/motion.h"
#include "sim_phone/phone_camera.h"
#include "sim_phone/story.h"

namespace {

using namespace pptam;
using namespace pptam::app;
using namespace pptam::platform;
using namespace pptam::laboratory;

constexpr int kExitOk = 0;
constexpr int kExitBroken = 1;    // the source or an output broke midway
constexpr int kExitBadInput = 2;  // nothing was done

struct OutputOptions {
  std::string out;
  std::string save_map;
  bool no_overlay = false;
  bool no_report = false;
};

struct Readout {
  RollingShutter::Axis axis = RollingShutter::Axis::kRows;
  double seconds = 0;  // signed
};

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

void parse_size(const std::string& text, int* width, int* height) {
  int used = 0;
  if (std::sscanf(text.c_str(), "%dx%d%n", width, height, &used) != 2 || static_cast<size_t>(used) != text.size() ||
      *width <= 0 || *height <= 0) {
    throw InputError("--resize " + text + ": write WIDTHxHEIGHT, for example 320x240");
  }
}

std::string quoted(const std::string& word) {
  constexpr const char* kPlain = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-+./:=,%";
  if (!word.empty() && word.find_first_not_of(kPlain) == std::string::npos) return word;
  std::string text = "'";
  for (const char c : word) text += c == '\'' ? std::string("'\\''") : std::string(1, c);
  return text + "'";
}

std::string command_of(int argc, char** argv) {
  std::string command = "pocket-ptam";
  for (int i = 1; i < argc; ++i) command += " " + quoted(argv[i]);
  return command;
}

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

int run_and_write(platform::Camera& camera, const RunOptions& run_options, const OutputOptions& output,
                  bool plane_known, const std::string& command, const sim::Story* story = nullptr) {
  const platform::Trajectory truth = camera.ground_truth();
  const std::filesystem::path folder = output.out.empty()
                                           ? std::filesystem::path("out") / folder_name(camera.info().name)
                                           : std::filesystem::path(output.out);
  check_map_options(run_options, output);
  std::vector<std::string> warnings;
  std::unique_ptr<Overlay> overlay;
  Progress progress;
  const RunLog log = run_sequence(
      camera, run_options,
      [&](const platform::CameraInfo& info) {
        prepare_folder(folder);
        if (!output.no_overlay) overlay = std::make_unique<Overlay>(info, folder, &warnings);
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

  RunSummary summary;
  summary.command = command;
  summary.version = PPTAM_VERSION;
  summary.plane_known = plane_known;
  if (!truth.empty()) {
    try {
      summary.evaluation = evaluate(log.trajectory(), truth, "trajectory", "ground truth");
    } catch (const InputError& error) {
      summary.evaluation_trouble = error.what();
    }
  }
  if (story != nullptr) {
    const RollingShutter& shutter = log.camera.shutter;
    const int lines = shutter.axis == RollingShutter::Axis::kColumns ? log.camera.model.width : log.camera.model.height;
    const float exposed_s = std::abs(shutter.line_time_s) * static_cast<float>(lines) + log.camera.exposure_s;
    summary.judgement = summarise(judge(log, truth, *story, static_cast<double>(exposed_s)));
  }
  write_text_outputs(log, folder);
  if (!output.no_report) write_report(folder, log, summary, truth, &warnings);
  if (!log.saved_map.empty()) platform::write_atomically(output.save_map, log.saved_map);

  print_rows(summarise(log, summary));
  std::string written;
  for (const char* name : kOutputs) {
    if (std::filesystem::exists(folder / name)) written += std::string(" ") + name;
  }
  std::printf("\nwritten to %s:%s\n", folder.string().c_str(), written.c_str());
  std::fflush(stdout);
  for (const std::string& warning : warnings) print_warning(warning);
  if (!log.saved_map.empty()) std::printf("map saved to %s\n", output.save_map.c_str());
  if (!log.save_trouble.empty())
    print_error("--save-map " + output.save_map + ": nothing was saved: " + log.save_trouble);
  if (!log.broken.empty()) print_error(log.broken + "; what came before it was tracked and written");
  return log.broken.empty() && log.save_trouble.empty() ? kExitOk : kExitBroken;
}

void add_run_options(CLI::App* command, RunOptions* run, OutputOptions* output) {
  static const std::map<std::string, ClockKind> kClocks = {
      {"work", ClockKind::kWork}, {"steady", ClockKind::kSteady}, {"throttled", ClockKind::kThrottled}};
  command->add_option("--out", output->out, "Folder for the results [out/NAME]")->type_name("DIR");
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
  command->add_flag_callback(
      "--no-drop", [run] { run->drop_late = false; }, "Track every frame, however late");
  command->add_option("--tap", run->taps_s, "Tap at this time; may be repeated [at the start, and after failures]")
      ->type_name("SECONDS")
      ->expected(1)
      ->multi_option_policy(CLI::MultiOptionPolicy::TakeAll);
  command->add_flag("--auto-start", run->auto_start,
                    "No tap: start when the camera is held still, again after failures");
  command
      ->add_option("--plane-distance", run->plane_distance,
                   "Of the first view from the dominant plane, in any unit: sets the map's scale")
      ->check(CLI::Range(0.001, 1000.0))
      ->type_name("LENGTH");
  command->add_option("--max-keyframes", run->max_keyframes, "Config::max_keyframes [35]")->type_name("N");
  command->add_option("--max-erased-keyframes", run->max_erased_keyframes, "Config::max_erased_keyframes [35]")
      ->type_name("N");
  command->add_flag_callback(
      "--no-damping", [run] { run->steady_damping = false; }, "Show every pose as measured, also of a camera at rest");
  command->add_option("--load-map", run->load_map, "Begin with a map saved earlier, made with this very camera")
      ->type_name("FILE");
  command
      ->add_option_function<std::string>(
          "--save-map",
          [run, output](const std::string& file) {
            output->save_map = file;
            run->save_map = true;
          },
          "Save the map at the end; an older file is replaced whole or not at all")
      ->type_name("FILE");
  command->add_flag("--lock-map", run->lock_map, "Track only: a finished or loaded map is not changed any more");
  command->add_flag("--no-overlay", output->no_overlay, "No overlay.mp4 and stills");
  command->add_flag("--no-report", output->no_report, "No report.html");
}

// A recording as named on the command line.
struct RecordingInput {
  platform::RecordingOptions options;
  std::string source, calibration, resize;

  platform::RecordingOptions recording() const {
    platform::RecordingOptions recording = options;
    recording.source = source;
    recording.calibration = calibration;
    if (!resize.empty()) parse_size(resize, &recording.resize_width, &recording.resize_height);
    return recording;
  }
};

void add_recording_options(CLI::App* command, RecordingInput* input) {
  command->add_option("source", input->source, "Folder (TUM, EuRoC, images), pattern such as img_%04d.png, or video")
      ->required()
      ->type_name("SOURCE");
  command->add_option("--calibration", input->calibration, "Camera calibration (YAML)")->type_name("FILE");
  command->add_option("--fov", input->options.fov_degrees, "Horizontal field of view, when there is no calibration")
      ->type_name("DEGREES");
  command->add_option("--resize", input->resize, "Scale the images, after rotation")->type_name("WxH");
  command->add_option("--every", input->options.every, "Keep one frame of so many")
      ->capture_default_str()
      ->type_name("N");
  command->add_option("--fps", input->options.fps, "Frames per second of images without timestamps [30]")
      ->type_name("N");
  command->add_option("--rotate", input->options.rotate_degrees, "Clockwise: 0, 90, 180 or 270")
      ->capture_default_str()
      ->type_name("DEGREES");
}

int run_program(int argc, char** argv) {
  CLI::App app("Pocket PTAM: camera tracking and mapping for one small core.", "pocket-ptam");
  app.require_subcommand(0, 1);
  app.set_version_flag("--version", std::string("pocket-ptam ") + PPTAM_VERSION);
  app.footer(
      "Examples:\n"
      "  pocket-ptam sim                                  a desk seen by the emulated phone\n"
      "  pocket-ptam replay clip.mp4 --fov 50             a video, with a guessed field of view\n"
      "  pocket-ptam eval trajectory.txt groundtruth.txt  compare two trajectories\n"
      "  pocket-ptam map info desk.map                    what is in a saved map\n"
      "Each command has its own --help. Exit codes: 0 done, 1 broke midway, 2 bad input.");
  const std::string command = command_of(argc, argv);
  RunOptions run;
  OutputOptions output;
  std::string readout;

  CLI::App* sim = app.add_subcommand("sim", "Run on the emulated phone");
  sim::PhoneOptions phone;
  bool no_noise = false;
  bool suite = false;
  std::string study;
  StudyOptions study_options;
  int seeds = 5;
  int jobs = 1;
  std::string dump;
  const auto listed = [](const std::vector<std::string>& names) {
    std::string list;
    for (const std::string& name : names) list += (list.empty() ? "One of " : ", ") + name;
    return list;
  };
  std::vector<std::string> story_names;
  std::string story_list = "Stories:\n";
  for (const sim::StoryKind& kind : sim::stories()) {
    story_names.push_back(kind.name);
    story_list += format("  %-16s %s\n", kind.name, kind.says);
  }
  std::vector<std::string> chosen_stories, chosen_scenes;
  CLI::Option* story_option =
      sim->add_option("--story", chosen_stories, "One of the stories below; may be repeated with --suite")
          ->type_name("NAME")
          ->expected(1)
          ->multi_option_policy(CLI::MultiOptionPolicy::TakeAll);
  sim->add_option("--scene", chosen_scenes,
                  listed(sim::scene_names()) + "; may be repeated with --suite and --study culling [desk]")
      ->type_name("NAME")
      ->expected(1)
      ->multi_option_policy(CLI::MultiOptionPolicy::TakeAll);
  std::vector<std::string> motions = sim::motion_names();
  for (const std::string& name : sim::start_names()) motions.push_back(name);
  sim->add_option("--motion", phone.motion, listed(motions))
      ->capture_default_str()
      ->type_name("NAME")
      ->excludes(story_option);
  sim->add_option("--seed", phone.seed, "Of the scene's details, the motion and the noise")
      ->capture_default_str()
      ->type_name("N");
  sim->add_option("--scene-seed", phone.scene_seed, "Of the scene's details alone [the seed]")
      ->type_name("N")
      ->excludes(story_option);
  std::optional<double> duration_s, exposure_s, drop_probability;  // without them a story's own hold
  sim->add_option("--duration", duration_s, "Length of the sequence [20, or the story's]")->type_name("SECONDS");
  sim->add_option("--readout", readout, "Rolling shutter, rows|columns:+|-:SECONDS [columns:-:0.060]");
  sim->add_option("--exposure", exposure_s, "Exposure time [0.03, or the story's]")->type_name("SECONDS");
  sim->add_option("--fps", phone.frames_per_s, "Frames per second")->capture_default_str()->type_name("N");
  sim->add_flag("--no-noise", no_noise, "An ideal sensor");
  sim->add_option("--drop", drop_probability, "Probability that the camera drops a frame [0, or the story's]")
      ->type_name("P");
  sim->add_option("--dump", dump, "Only write the sequence, in TUM layout")->type_name("DIR");
  CLI::Option* suite_flag =
      sim->add_flag("--suite", suite, "All stories, or those and the scenes named, with several seeds, as a table");
  CLI::Option* study_option =
      sim->add_option(
             "--study", study,
             "init: many short starts of several kinds, as a table and plots; culling: exploring runs with and without "
             "culling of keyframes, as a table")
          ->type_name("NAME")
          ->excludes(suite_flag);
  sim->add_option("--kind", study_options.kinds, listed(study_kinds()) + "; may be repeated, for --study [all]")
      ->type_name("NAME")
      ->expected(1)
      ->needs(study_option)
      ->multi_option_policy(CLI::MultiOptionPolicy::TakeAll);
  CLI::Option* seeds_option = sim->add_option("--seeds", seeds, "Seeds of each story or kind, for --suite and --study")
                                  ->capture_default_str()
                                  ->check(CLI::Range(1, 1000))
                                  ->type_name("N");
  CLI::Option* jobs_option = sim->add_option("--jobs", jobs, "Threads, for --suite and --study")
                                 ->capture_default_str()
                                 ->check(CLI::Range(1, 256))
                                 ->type_name("N");
  std::string shard;
  sim->add_option("--shard", shard, "Only the I-th of N parts of the suite's runs")
      ->type_name("I/N")
      ->needs(suite_flag);
  bool compare = false;
  sim->add_flag("--compare", compare,
                "In the suite, exploring stories also with a global shutter, and with a rolling one that the system is "
                "not told of")
      ->needs(suite_flag);
  EnduranceOptions endurance;
  CLI::Option* endurance_option =
      sim->add_option("--endurance", endurance.minutes,
                      "Long life: a lap of a minute through the scene, rendered once, is seen round and round for so "
                      "many minutes, with cuts and a covered lens; judged by the minute. Exit code 1 when accuracy or "
                      "cost do not hold")
          ->type_name("MINUTES")
          ->excludes(story_option)
          ->excludes(suite_flag)
          ->excludes(study_option);
  sim->add_flag("--twice", endurance.twice, "With --endurance: a second run must give the same maps")
      ->needs(endurance_option);
  add_run_options(sim, &run, &output);
  sim->footer(story_list +
              "Examples:\n"
              "  pocket-ptam sim --scene boxes --seed 3 --out out/boxes3\n"
              "  pocket-ptam sim --story shake --seed 2\n"
              "  pocket-ptam sim --readout rows:+:0.030 --fps 30   another phone's shutter\n"
              "  pocket-ptam sim --dump /tmp/desk                  a sequence for other programs\n"
              "  pocket-ptam sim --save-map desk.map\n"
              "  pocket-ptam sim --load-map desk.map --lock-map --seed 2 --scene-seed 1\n"
              "  pocket-ptam sim --suite --seeds 5 --jobs 2 --compare\n"
              "  pocket-ptam sim --suite --story orbit --story zoom --seeds 20\n"
              "  pocket-ptam sim --study init --seeds 20 --jobs 2\n"
              "  pocket-ptam sim --study culling --scene desk --scene walls --seeds 50 --jobs 2\n"
              "  pocket-ptam sim --endurance 60 --scene desk --twice");

  CLI::App* replay = app.add_subcommand("replay", "Run on a recorded sequence");
  RecordingInput input;
  add_recording_options(replay, &input);
  replay->add_option("--readout", readout, "Rolling shutter of the source, rows|columns:+|-:SECONDS");
  add_run_options(replay, &run, &output);
  replay->footer(
      "Examples:\n"
      "  pocket-ptam replay rgbd_dataset_freiburg1_xyz --calibration fr1.yaml --resize 320x240\n"
      "  pocket-ptam replay clip.mp4 --fov 50 --readout rows:+:0.030\n"
      "  pocket-ptam replay 'frames/img_%04d.png' --fov 60 --fps 15 --tap 2\n"
      "  pocket-ptam replay monday.mp4 --calibration phone.yaml --save-map room.map\n"
      "  pocket-ptam replay tuesday.mp4 --calibration phone.yaml --load-map room.map");

  CLI::App* readout_command =
      app.add_subcommand("readout", "Find a recording's rolling shutter: the one with which its map fits best");
  ReadoutOptions readout_options;
  add_recording_options(readout_command, &input);
  readout_command->add_option("--axis", readout_options.axes, "rows, columns, or both of them [both]")
      ->check(CLI::IsMember({"rows", "columns", "both"}))
      ->type_name("AXIS");
  readout_command->add_option("--jobs", jobs, "Threads")->check(CLI::Range(1, 256))->type_name("N");
  readout_command
      ->add_option("--tap", run.taps_s, "Tap at this time; may be repeated [at the start, and after failures]")
      ->type_name("SECONDS")
      ->expected(1)
      ->multi_option_policy(CLI::MultiOptionPolicy::TakeAll);
  readout_command->footer(
      "The clip should start the map early and show the camera moving quickly now and then, in all directions.\n"
      "Examples:\n"
      "  pocket-ptam readout clip.mp4 --fov 60 --resize 320x240\n"
      "  pocket-ptam readout clip.mp4 --calibration phone.yaml --axis rows");

  CLI::App* eval = app.add_subcommand("eval", "Compare an estimated trajectory with the truth");
  std::string estimate_file;
  std::string truth_file;
  std::string plot_file;
  eval->add_option("estimate", estimate_file, "TUM trajectory")->required()->type_name("ESTIMATE");
  eval->add_option("truth", truth_file, "TUM trajectory")->required()->type_name("TRUTH");
  eval->add_option("--plot", plot_file, "Draw both")->type_name("FILE.svg");
  eval->footer("Example:\n  pocket-ptam eval out/desk-seed-1/trajectory.txt groundtruth.txt --plot both.svg");

  CLI::App* map_command = app.add_subcommand("map", "Look into a saved map, or take it to other programs");
  map_command->require_subcommand(1);
  MapExportOptions export_options;
  CLI::App* map_info = map_command->add_subcommand("info", "What is in it; exit code 2 if it is damaged");
  CLI::App* map_export = map_command->add_subcommand("export", "Write it for other programs");
  for (CLI::App* part : {map_info, map_export})
    part->add_option("map", export_options.map, "Saved by --save-map")->required()->type_name("FILE");
  map_export->add_option("--ply", export_options.ply, "The points, for MeshLab or CloudCompare")->type_name("OUT.ply");
  map_export
      ->add_option("--colmap", export_options.colmap,
                   "COLMAP's text model (cameras.txt, images.txt, points3D.txt) and the keyframes' images")
      ->type_name("DIR");
  map_info->footer("Example:\n  pocket-ptam map info desk.map");
  map_export->footer(
      "In COLMAP's model the measurements are corrected for the rolling shutter; the images are as they were.\n"
      "Examples:\n"
      "  pocket-ptam map export desk.map --ply desk.ply\n"
      "  pocket-ptam map export desk.map --colmap desk-colmap");
  map_command->footer(
      "Examples:\n"
      "  pocket-ptam sim --save-map desk.map\n"
      "  pocket-ptam map info desk.map\n"
      "  pocket-ptam map export desk.map --ply desk.ply --colmap desk-colmap");

  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    if (error.get_exit_code() == 0) return app.exit(error);  // --help and --version
    std::string with_command = "pocket-ptam";
    for (const CLI::App* used = &app; !used->get_subcommands().empty();) {
      used = used->get_subcommands().front();
      with_command += " " + used->get_name();
    }
    throw InputError(std::string(error.what()) + "; see " + with_command + " --help");
  }

  if (app.get_subcommands().empty())
    throw InputError("no command given: sim, replay, readout, eval or map; see pocket-ptam --help");
  if (sim->parsed()) {
    if (!readout.empty()) {
      const Readout parsed = parse_readout(readout);
      phone.readout_axis = parsed.axis;
      phone.readout_s = parsed.seconds;
    }
    phone.noise = !no_noise;
    const auto adjust = [&](sim::PhoneOptions* options) {
      if (duration_s) options->duration_s = *duration_s;
      if (exposure_s) options->exposure_s = *exposure_s;
      if (drop_probability) options->drop_probability = *drop_probability;
    };
    const auto adjust_story = [&](sim::PhoneOptions* options) {
      adjust(options);
      options->readout_axis = phone.readout_axis;
      options->readout_s = phone.readout_s;
      options->noise = phone.noise;
      options->frames_per_s = phone.frames_per_s;
    };
    adjust(&phone);
    if ((suite || !study.empty() || !dump.empty()) && (run.save_map || run.lock_map || !run.load_map.empty()))
      throw InputError("--load-map, --save-map and --lock-map belong to a single run");
    if (suite) {
      SuiteOptions options;
      options.stories = chosen_stories;
      options.scenes = chosen_scenes;
      if (chosen_stories.empty() && chosen_scenes.empty()) options.stories = story_names;
      options.seeds = seeds;
      options.jobs = jobs;
      if (!shard.empty()) options.shard = parse_shard(shard);
      options.compare = compare;
      options.phone = phone;
      options.adjust_story = adjust_story;
      options.run = run;
      options.out = output.out.empty() ? "out/suite" : output.out;
      options.command = command;
      options.version = PPTAM_VERSION;
      if (duration_s) options.repeat_options += format(" --duration %g", *duration_s);
      if (exposure_s) options.repeat_options += format(" --exposure %g", *exposure_s);
      if (drop_probability) options.repeat_options += format(" --drop %g", *drop_probability);
      if (!readout.empty()) options.repeat_options += " --readout " + readout;
      if (no_noise) options.repeat_options += " --no-noise";
      return run_suite(options) == 0 ? kExitOk : kExitBroken;
    }
    if (chosen_stories.size() + chosen_scenes.size() > 1 && study != "culling")
      throw InputError("several --story or --scene belong to --suite");
    if (!chosen_scenes.empty()) phone.scene = chosen_scenes.front();
    if (!chosen_stories.empty()) {
      const uint64_t seed = phone.seed;
      sim::PhoneOptions told = sim::phone_for_story(chosen_stories.front(), seed);
      adjust_story(&told);
      phone = told;
    }
    if (!study.empty()) {
      if (study == "culling") {
        CullingStudyOptions culling;
        culling.scenes = chosen_scenes;
        culling.seeds = seeds;
        culling.jobs = jobs;
        culling.phone = phone;
        if (!duration_s) culling.phone.duration_s = 60;
        culling.run = run;
        return run_culling_study(culling) ? kExitOk : kExitBroken;
      }
      if (study != "init") throw InputError("--study " + study + ": there are init and culling");
      study_options.seeds = seeds;
      study_options.jobs = jobs;
      study_options.out = output.out.empty() ? "out/study" : output.out;
      study_options.command = command;
      study_options.version = PPTAM_VERSION;
      return run_study(study_options) == 0 ? kExitOk : kExitBroken;
    }
    if (!suite && (seeds_option->count() > 0 || jobs_option->count() > 0))
      throw InputError("--seeds and --jobs belong to --suite or --study");
    if (endurance_option->count() > 0) {
      endurance.phone = phone;
      endurance.run = run;
      return run_endurance(endurance) ? kExitOk : kExitBroken;
    }
    sim::check_phone_options(phone);
    const auto scene =
        std::make_shared<const sim::Scene>(sim::make_scene(phone.scene, phone.scene_seed.value_or(phone.seed)));
    const std::unique_ptr<platform::Camera> camera = sim::make_phone_camera(phone, scene);
    if (!dump.empty()) {
      static Progress* progress = nullptr;
      Progress shown;
      progress = &shown;
      platform::dump_sequence(*camera, dump, [](int done, int total) { progress->show(done, total, "written"); });
      shown.finish();
      std::printf("written to %s\n", dump.c_str());
      return kExitOk;
    }
    const sim::Story story = sim::story_of(phone, *scene);
    return run_and_write(*camera, run, output, sim::ground_plane_known(phone.scene), command, &story);
  }

  if (replay->parsed()) {
    platform::RecordingOptions recording = input.recording();
    if (!readout.empty()) {
      const Readout parsed = parse_readout(readout);
      recording.readout_axis = parsed.axis;
      recording.readout_s = parsed.seconds;
    }
    std::vector<std::string> warnings;
    const std::unique_ptr<platform::Camera> camera = platform::open_recording(recording, &warnings);
    for (const std::string& warning : warnings) print_warning(warning);
    return run_and_write(*camera, run, output, false, command);
  }

  if (readout_command->parsed()) {
    readout_options.recording = input.recording();
    readout_options.run = run;
    readout_options.jobs = jobs;
    return find_readout(readout_options) ? kExitOk : kExitBroken;
  }

  if (map_info->parsed()) {
    print_map_info(export_options.map);
    return kExitOk;
  }
  if (map_export->parsed()) {
    export_map(export_options);
    return kExitOk;
  }

  const platform::Trajectory estimate = platform::read_tum_trajectory(estimate_file);
  const platform::Trajectory truth = platform::read_tum_trajectory(truth_file);
  const Evaluation evaluation = evaluate(estimate, truth, estimate_file, truth_file);
  std::vector<SummaryRow> rows = {
      {"poses", format("%zu of %d have a time in the truth, which they cover by %.1f %%", evaluation.poses.size(),
                       evaluation.estimate_poses, 100 * evaluation.covered_fraction)}};
  for (SummaryRow& row : summarise(evaluation)) rows.push_back(std::move(row));
  print_rows(rows);
  if (!plot_file.empty()) platform::write_text(plot_file, plot_trajectories(evaluation, truth));
  return kExitOk;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    return run_program(argc, argv);
  } catch (const InputError& error) {
    print_error(error.what());
    return kExitBadInput;
  } catch (const std::exception& error) {
    print_error(error.what());
    return kExitBroken;
  }
}
