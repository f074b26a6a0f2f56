#include "platform/app/single_run.h"

#include <algorithm>
#include <cerrno>
#include <cstddef>
#include <cstdio>
#include <cstring>
#include <exception>
#include <filesystem>
#include <functional>
#include <memory>
#include <new>
#include <span>

#include "platform/app/commands.h"
#include "platform/calibrate/camera_fit.h"
#include "platform/camera/image_list.h"
#include "platform/files.h"
#include "platform/input_error.h"
#include "platform/run/console.h"
#include "platform/run/evaluation.h"
#include "platform/run/ground_view.h"
#include "platform/run/interruption.h"
#include "platform/run/names.h"
#include "platform/run/overlay.h"
#include "platform/run/report.h"
#include "platform/run/text_outputs.h"
#include "platform/run/trace.h"
#include "platform/text.h"

namespace pptam::app {
namespace {

using namespace platform;

constexpr const char* kVideo = "overlay.mp4";
const std::vector<std::string> kOutputs = {"trajectory.txt", "keyframes.txt", "map.ply",
                                           "frames.csv",     "report.html",   kVideo,
                                           "overlay.png",    "start.png",     "other_maps.txt"};

bool is_sound_map(std::span<const std::byte> content) {
  MapInfo info;
  return System::map_info(content, &info).ok();
}

// A single file's place is not taken by what goes into the folder.
void check_apart(const std::string& option, const std::string& file, const std::filesystem::path& folder) {
  const auto refuse = [&](const char* why) { return InputError(option + " " + file + why + folder.string()); };
  for (const char* name : {"", OutputFolder::kListName}) {
    if (same_place(folder / name, file) || same_place(folder, file)) throw refuse(": is taken by --out ");
  }
  // Neither the folder nor one above it, which prepare() may be about to make.
  const std::filesystem::path whole = std::filesystem::absolute(folder).lexically_normal();
  for (std::filesystem::path above = whole; above.has_relative_path(); above = above.parent_path()) {
    if (same_place(above, file)) throw refuse(": is a folder on the way to --out ");
  }
  for (const std::string& name : kOutputs) {
    if (same_place(folder / name, file)) throw refuse(": is another output's name, of --out ");
  }
}

// All that is checked before the first frame. Nothing is changed by it.
void check_map(const RunOptions& run, const OutputOptions& output, const std::filesystem::path& folder,
               const Knowledge& knowledge) {
  if (!run.load_map.empty() && (!run.taps_s.empty() || run.auto_start))
    throw InputError("--load-map " + run.load_map + ": --tap would forget the map, and --auto-start waits for none");
  if (!run.save_map) return;
  Inputs inputs = knowledge.inputs;
  inputs.add("the map of --load-map", run.load_map);
  check_map_file(output.save_map, inputs, folder);
  check_apart("--save-map", output.save_map, folder);
}

void check_trace(const RunOptions& run, const OutputOptions& output, const std::filesystem::path& folder,
                 const Knowledge& knowledge) {
  if (output.trace.empty()) return;
  Inputs inputs = knowledge.inputs;
  inputs.add("the map of --load-map", run.load_map);
  check_trace_file(output, inputs, folder);
  check_apart("--trace", output.trace, folder);
}

OutputFolder check_folder(const RunOptions& run, const std::filesystem::path& folder, const Knowledge& knowledge) {
  Inputs inputs = knowledge.inputs;
  inputs.add("the map of --load-map", run.load_map);
  for (const std::filesystem::path& images : knowledge.image_folders) {
    if (same_place(images, folder))
      throw InputError("--out " + folder.string() + ": the recording's images are there, name another folder");
  }
  return OutputFolder(folder, "--out", kOutputs, inputs);
}

// The overlay with the draft of its video. Its troubles cost only itself.
class Show {
 public:
  Show(const CameraInfo& camera, const OutputFolder& folder, std::vector<std::string>* warnings)
      : draft_(folder.path(kVideo)), overlay_(camera, draft_.path(), warnings) {}

  void add(const Frame& frame, const TrackResult& result, const FrameLog& entry) {
    if (!trouble_.empty()) return;
    try {
      overlay_.add(frame, result, entry);
    } catch (const std::exception& error) {
      trouble_ = error.what();
    }
  }
  // Once: null without an encoder. Throws InputError when it failed.
  Draft* video() {
    if (!trouble_.empty()) throw InputError(trouble_);
    return overlay_.finish() ? &draft_ : nullptr;
  }
  const Overlay& overlay() const { return overlay_; }

 private:
  Draft draft_;
  Overlay overlay_;
  std::string trouble_;
};

// Null, with a warning, where nothing can be drawn.
std::unique_ptr<Show> make_show(const CameraInfo& camera, const OutputFolder& folder,
                                std::vector<std::string>* warnings) {
  try {
    return std::make_unique<Show>(camera, folder, warnings);
  } catch (const InputError& error) {
    warnings->push_back(std::string("there is no overlay: ") + error.what());
    return nullptr;
  }
}

// The run, with its overlay and its progress on the terminal. The folder is made once the input is known to be good.
// tracks: of what was tracked, or null.
RunLog run_and_show(const Runner& runner, const OutputOptions& output, const OutputFolder& folder,
                    std::unique_ptr<Show>* show, PointTracks* tracks, GroundView* ground,
                    std::vector<std::string>* warnings) {
  Progress progress;
  RunLog log = runner(
      [&](const CameraInfo& info) {
        folder.prepare();
        stop_on_signals();  // first: the overlay's encoder is to be ended like the rest
        if (!output.no_overlay) *show = make_show(info, folder, warnings);
      },
      [&](const Frame& frame, const TrackResult& result, const RunLog& so_far) {
        const FrameLog& entry = so_far.frames.back();
        if (tracks != nullptr) tracks->add(result);
        ground->add(frame, result);
        if (*show) (*show)->add(frame, result, entry);
        if (!output.no_progress && output.show.where == DisplayChoice::kNowhere)
          progress.show(so_far.source_frames, so_far.camera.frame_count.value_or(0),
                        format("%.1f s  %s, %d keyframes, %d points", so_far.seconds(entry.timestamp_ns),
                               name_of(entry.state), entry.keyframes, entry.map_points));
      });
  progress.finish();
  return log;
}

// What the points' tracks say against the camera that the program was told of.
void add_camera_doubts(const RunLog& log, PointTracks* tracks, std::vector<std::string>* warnings) {
  tracks->finish(log.map_points);
  const CameraDoubts doubts = doubt_camera(*tracks, log.camera.model, log.camera.shutter);
  std::vector<std::string> found;
  if (doubts.focal) found.push_back(format("a focal length of %.2f times the one assumed", doubts.fit.focal.value));
  if (doubts.readout) {
    found.push_back(doubts.fit.global ? "a global shutter"
                                      : "a readout, of the images as tracked, of " +
                                            readout_text(doubts.fit.axis, doubts.fit.readout_s.value));
  }
  if (found.empty()) return;
  warnings->push_back("the points fit " + found[0] + (found.size() > 1 ? " and " + found[1] : "") +
                      " better: poses and map may be wrong. pocket-ptam readout SOURCE --estimate fov,readout finds "
                      "what to give");
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

// Outputs one by one: what fails is told at once and costs nothing else.
class Writing {
 public:
  void attempt(const std::function<void()>& write) {
    try {
      write();
    } catch (const std::exception& error) {
      failed(error.what());
    }
  }
  void failed(const std::string& why) {
    print_error(why);
    failed_ = true;
  }
  bool any_failed() const { return failed_; }

 private:
  bool failed_ = false;
};

// The poses in other maps than the trajectory's; empty when there are none.
std::string other_maps_text(const RunLog& log) {
  std::string text;
  for (const int map : log.maps()) {
    if (map == log.main_map()) continue;
    text +=
        tum_text(log.trajectory_in(map), format("map %d, in a world of its own: timestamp tx ty tz qx qy qz qw", map));
  }
  return text;
}

// The map, the paths and the tables. What matters most comes first, and the video's draft makes room for it on a disk
// that is full. Returns whether the map was saved.
bool write_essentials(const RunLog& log, const OutputOptions& output, OutputFolder* folder, std::unique_ptr<Show>* show,
                      Writing* writing) {
  const auto attempt = [&](const std::function<void()>& write) {
    if (*show) {
      try {
        return write();
      } catch (const std::exception& error) {
        const std::string why = error.what();
        if (why.find(std::strerror(ENOSPC)) != std::string::npos ||
            why.find(std::strerror(EDQUOT)) != std::string::npos) {
          for (const char* name : {kVideo, "overlay.png", "start.png"}) folder->give_up(name);
          writing->failed(why + ": overlay.mp4 and the stills are given up for it");
          show->reset();
        }
      }
    }
    writing->attempt(write);
  };
  bool map_saved = false;
  if (!log.saved_map.empty()) {
    attempt([&] {
      write_map_file(output.save_map, log.saved_map);
      map_saved = true;
    });
  }
  const std::string head = "timestamp tx ty tz qx qy qz qw, camera-to-world, world units";
  attempt([&] { folder->write("trajectory.txt", tum_text(log.trajectory(), head)); });
  const std::string others = other_maps_text(log);
  if (!others.empty()) attempt([&] { folder->write("other_maps.txt", others); });
  attempt([&] { folder->write("keyframes.txt", tum_text(log.keyframe_trajectory(), head)); });
  attempt([&] { folder->write("map.ply", ply_text(log.map_points)); });
  attempt([&] { folder->write("frames.csv", frames_text(log)); });
  return map_saved;
}

Pictures write_pictures(Show* show, OutputFolder* folder, Writing* writing) {
  Pictures pictures;
  writing->attempt([&] {
    try {
      if (Draft* draft = show->video()) {
        folder->keep(kVideo, draft);
        pictures.video = true;
      }
    } catch (const std::exception&) {
      folder->give_up(kVideo);
      throw;
    }
  });
  writing->attempt([&] {
    const std::string png = show->overlay().start_png();
    if (!png.empty()) folder->write("start.png", png);
  });
  writing->attempt([&] {
    pictures.good_png = show->overlay().good_png();
    if (!pictures.good_png.empty()) folder->write("overlay.png", pictures.good_png);
  });
  return pictures;
}

void print_written(const std::filesystem::path& place, const OutputFolder& folder) {
  std::string written;
  for (const std::string& name : kOutputs) {
    const auto& names = folder.written();
    if (std::find(names.begin(), names.end(), name) != names.end()) written += " " + name;
  }
  print_line("");
  print_line("written to " + place.string() + ":" + written);
  std::fflush(stdout);
}

}  // namespace

void check_map_file(const std::string& file, const Inputs& inputs, const std::filesystem::path& to_be_made) {
  check_output_file("--save-map", file, inputs, "a sound map", is_sound_map, to_be_made);
}

void check_trace_file(const OutputOptions& output, const Inputs& inputs, const std::filesystem::path& to_be_made) {
  check_output_file("--trace", output.trace, inputs, "a trace of an earlier run", is_trace, to_be_made);
  if (!output.save_map.empty() && same_place(output.trace, output.save_map))
    throw InputError("--trace " + output.trace + ": is where --save-map writes, name another file");
}

void write_trace_file(const OutputOptions& output, const RunLog& log, const std::string& command_line) {
  judge_output_file("--trace", output.trace, {}, "a trace of an earlier run", is_trace);  // may have come meanwhile
  try {
    write_text_atomically(output.trace, trace_text(log, command_line));
  } catch (const std::bad_alloc&) {
    throw InputError("--trace " + output.trace + ": not written, there is not enough memory for its text");
  }
}

void write_map_file(const std::string& file, std::span<const std::byte> map) {
  judge_output_file("--save-map", file, {}, "a sound map", is_sound_map);  // may have come meanwhile
  write_atomically(file, map);
}

Watching::Watching(const OutputOptions& output, const CameraInfo& camera) {
  if (output.show.where == DisplayChoice::kNowhere) return;
  ShowOptions show = output.show;
  show.paced = true;
  show_.emplace(show, camera, [](const std::string& text) { std::fprintf(stderr, "%s\n", printable(text).c_str()); });
  keys_.emplace();
  spectator_ = spectator_of(&*show_, &*keys_);
  if (output.save_map.empty()) return;
  spectator_.on_save = [this, file = output.save_map](std::span<const std::byte> map) {
    try {
      write_map_file(file, map);
      show_->say("map saved to " + file);
    } catch (const InputError& error) {
      show_->say(error.what());
    }
  };
}

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

int run_and_write(platform::Camera& camera, const RunOptions& run_options, const OutputOptions& output,
                  const Knowledge& knowledge, const std::string& command_line) {
  const Watching watching(output, camera.info());
  const Runner runner = [&](const StartObserver& on_start, const FrameObserver& on_frame) {
    return run_sequence(camera, run_options, on_start, on_frame, watching.spectator());
  };
  return run_and_write(camera.info().name, camera.ground_truth(), runner, run_options, output, knowledge, command_line);
}

int run_and_write(const std::string& name, const Trajectory& truth, const Runner& runner, const RunOptions& run_options,
                  const OutputOptions& output, const Knowledge& knowledge, const std::string& command_line) {
  const std::filesystem::path place =
      output.out.empty() ? std::filesystem::path("out") / folder_name(name) : std::filesystem::path(output.out);
  OutputFolder folder = check_folder(run_options, place, knowledge);
  check_map(run_options, output, place, knowledge);
  check_trace(run_options, output, place, knowledge);
  std::vector<std::string> warnings;  // to be printed
  std::unique_ptr<Show> show;
  PointTracks tracks;
  GroundView ground;
  const RunLog log =
      run_and_show(runner, output, folder, &show, knowledge.camera_told ? &tracks : nullptr, &ground, &warnings);

  Writing writing;
  const bool map_saved = write_essentials(log, output, &folder, &show, &writing);
  Pictures pictures;
  if (show) pictures = write_pictures(show.get(), &folder, &writing);
  warnings.insert(warnings.begin(), log.warnings.begin(), log.warnings.end());
  if (knowledge.camera_told && log.broken.empty()) {
    writing.attempt([&] { add_camera_doubts(log, &tracks, &warnings); });
  }
  const auto all_warnings = [&] {
    std::vector<std::string> all = knowledge.warnings;
    all.insert(all.end(), warnings.begin(), warnings.end());
    return all;
  };
  RunSummary summary = evaluated(log, truth, knowledge);
  summary.command = command_line;
  summary.warnings = all_warnings();
  if (!output.no_report) {
    writing.attempt([&] {
      pictures.ground_png = ground.picture(log);
      pictures.ground_note = ground.note(log);
      folder.write("report.html", report_page(log, summary, truth, pictures, &warnings));
    });
    summary.warnings = all_warnings();
  }
  writing.attempt([&] { folder.finish(); });
  bool traced = false;
  if (!output.trace.empty()) {
    writing.attempt([&] {
      write_trace_file(output, log, command_line);
      traced = true;
    });
  }

  print_rows(summarise(log, summary));
  print_written(place, folder);
  for (const std::string& warning : warnings) print_warning(warning);
  if (map_saved) print_line("map saved to " + output.save_map);
  if (traced) print_line("trace saved to " + output.trace + "; look at it in ui.perfetto.dev");
  if (!log.save_trouble.empty())
    print_error("--save-map " + output.save_map + ": nothing was saved: " + log.save_trouble);
  if (!log.broken.empty())
    print_error(log.broken + "; what came before it was tracked" + (writing.any_failed() ? "" : " and written"));
  if (!log.differs.empty()) print_error(log.differs);
  return log.broken.empty() && log.differs.empty() && log.save_trouble.empty() && !writing.any_failed() ? kExitOk
                                                                                                        : kExitBroken;
}

}  // namespace pptam::app
