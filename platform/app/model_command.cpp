// pocket-ptam model: a known object, tracked by its edges.

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <filesystem>
#include <memory>
#include <optional>

#include <pocket_ptam/model_tracker.h>
#include "platform/app/commands.h"
#include "platform/app/options.h"
#include "platform/app/single_run.h"
#include "platform/camera/camera_list.h"
#include "platform/camera/device_camera.h"
#include "platform/files.h"
#include "platform/input_error.h"
#include "platform/model/model_file.h"
#include "platform/outputs.h"
#include "platform/run/console.h"
#include "platform/run/html.h"
#include "platform/run/interruption.h"
#include "platform/run/model_overlay.h"
#include "platform/text.h"
#include "platform/trajectory.h"

namespace pptam::app {
namespace {

using namespace platform;

constexpr const char* kModelVideo = "overlay.mp4";
const std::vector<std::string> kModelOutputs = {"trajectory.txt", "frames.csv", "report.html", kModelVideo,
                                                "overlay.png"};
constexpr const char* kFeatureNames[kModelFeatures] = {"lines", "cylinders", "circles", "spheres"};

struct ModelChoice {
  std::string model, camera, readout, initial_pose, initial_points, out;
  RecordingInput input;
  double duration_s = 0;
  bool no_overlay = false;
};

// What came of the frames.
struct ModelLog {
  Trajectory trajectory;  // camera in the object's frame
  std::string csv = "timestamp,state,pose,quality,sites,inliers,error_px\n";
  int frames = 0, tracked = 0, lost = 0, restarts = 0;
  double squared_px[kModelFeatures] = {};
  int64_t inliers[kModelFeatures] = {};
  double quality = 0;
  std::string broken;
};

const char* model_state_name(ModelState state) {
  return state == ModelState::kTracking ? "tracking" : state == ModelState::kLost ? "lost" : "waiting";
}

void add_result(const ModelResult& result, ModelLog* log) {
  ++log->frames;
  log->csv += format("%.6f,%s,%d,%.3f,%d,%d,%.3f\n", 1e-9 * static_cast<double>(result.timestamp_ns),
                     model_state_name(result.state), result.pose_valid ? 1 : 0, static_cast<double>(result.quality),
                     result.sites_visible, result.sites_inliers, static_cast<double>(result.error_px));
  log->restarts += result.restarted ? 1 : 0;
  log->lost += result.state == ModelState::kLost ? 1 : 0;
  if (!result.pose_valid) return;
  ++log->tracked;
  log->quality += static_cast<double>(result.quality);
  for (int f = 0; f < kModelFeatures; ++f) {
    const double error = static_cast<double>(result.feature_error_px[f]);
    log->squared_px[f] += error * error * result.feature_inliers[f];
    log->inliers[f] += result.feature_inliers[f];
  }
  StampedPose pose;
  pose.timestamp_ns = result.timestamp_ns;
  const SE3 T_oc = result.T_co.inverse();
  pose.T_wc.linear() = T_oc.R.cast<double>();
  pose.T_wc.translation() = T_oc.t.cast<double>();
  log->trajectory.push_back(pose);
}

std::vector<SummaryRow> summarise(const ModelLog& log, const ModelFile& model) {
  std::vector<SummaryRow> rows;
  rows.push_back(
      {"model", format("%zu faces, %zu lines, %zu cylinders, %zu circles, %zu spheres", model.faces.size(),
                       model.lines.size(), model.cylinders.size(), model.circles.size(), model.spheres.size())});
  rows.push_back(
      {"frames", format("%d, tracked %d, lost %d, started %d times", log.frames, log.tracked, log.lost, log.restarts)});
  if (log.tracked > 0) rows.push_back({"quality", format("%.2f on average", log.quality / log.tracked)});
  for (int f = 0; f < kModelFeatures; ++f) {
    if (log.inliers[f] == 0) continue;
    rows.push_back({std::string("edges of ") + kFeatureNames[f],
                    format("%.2f px rms from the model, %.0f in a frame",
                           std::sqrt(log.squared_px[f] / static_cast<double>(log.inliers[f])),
                           static_cast<double>(log.inliers[f]) / log.tracked)});
  }
  return rows;
}

std::string report_page(const std::vector<SummaryRow>& rows, const std::string& command, const std::string& still) {
  std::string page =
      html_head("A known object, tracked by its edges") + "<h1>A known object, tracked by its edges</h1>\n";
  page += "<p><code>" + html_escaped(command) + "</code></p>\n<table>\n";
  for (const SummaryRow& row : rows)
    page += "<tr><th>" + html_escaped(row.label) + "</th><td>" + html_escaped(row.value) + "</td></tr>\n";
  page += "</table>\n";
  if (!still.empty()) {
    page += image_tag("image/png", still, "the model over a frame");
    page +=
        "<p>The model's contours are blue. Edges: red agree with the pose, green were rejected by the robust weights, "
        "white dots mark sites where nothing looks as it did.</p>\n";
  }
  return page + "</body></html>\n";
}

class ModelRun {
 public:
  ModelRun(const ModelChoice& chosen, std::string command_line)
      : chosen_(chosen), command_line_(std::move(command_line)) {}

  int run() {
    if (chosen_.input.source.empty() == chosen_.camera.empty())
      throw InputError("model: name either a recording or --camera");
    if (!chosen_.initial_pose.empty() && !chosen_.initial_points.empty())
      throw InputError("--initial-pose and --initial-points: give one of them");
    model_ = read_model(chosen_.model);
    view_ = model_.view();
    for (const std::filesystem::path& file : model_.files) knowledge_.inputs.add("the model's file", file);
    const Status status = view_.validate();
    if (!status.ok()) throw InputError(chosen_.model + ": " + status.message());
    camera_ = open_camera();
    stop_on_signals();
    camera_->start();
    begun_ns_ = clock_.now_ns();
    // A device may tell its readout with the first frame.
    Frame frame;
    if (!next_frame(&frame)) {
      if (interrupted()) throw InputError(camera_->info().name + ": " + interruption() + " before the first frame");
      throw InputError(camera_->info().name + ": no frame came" + (trouble_.empty() ? "" : ": " + trouble_));
    }
    create_tracker();
    start();
    const std::string name = std::filesystem::path(chosen_.model).stem().string() + " in " + camera_->info().name;
    const std::filesystem::path place =
        chosen_.out.empty() ? std::filesystem::path("out") / folder_name(name) : std::filesystem::path(chosen_.out);
    for (const std::filesystem::path& images : knowledge_.image_folders) {
      if (same_place(images, place))
        throw InputError("--out " + place.string() + ": the recording's images are there, name another folder");
    }
    OutputFolder folder(place, "--out", kModelOutputs, knowledge_.inputs);
    folder.prepare();
    track_all(folder, frame);
    return write(place, &folder);
  }

 private:
  std::unique_ptr<platform::Camera> open_camera() {
    std::optional<Readout> readout;
    if (!chosen_.readout.empty()) readout = parse_readout(chosen_.readout);
    if (chosen_.camera.empty()) {
      RecordingOptions recording = chosen_.input.recording();
      if (readout) {
        recording.readout_axis = readout->axis;
        recording.readout_s = readout->seconds;
      }
      auto camera = chosen_.input.open(recording, &knowledge_.warnings);
      add_inputs(recording, &knowledge_);
      return camera;
    }
    DeviceOptions options;
    options.calibration = chosen_.input.calibration;
    options.fov_degrees = chosen_.input.options.fov_degrees;
    options.rotate_degrees = chosen_.input.options.rotate_degrees;
    if (!chosen_.input.resize.empty()) parse_size("--resize", chosen_.input.resize, &options.width, &options.height);
    if (readout) {
      options.readout_axis = readout->axis;
      options.readout_s = readout->seconds;
    }
    auto camera = make_device_camera(open_camera_device(chosen_.camera), options, &knowledge_.warnings);
    for (const std::string& warning : knowledge_.warnings) print_warning(warning);
    return camera;
  }

  void create_tracker() {
    ModelTrackerConfig config;
    config.camera.model = camera_->info().model;
    config.camera.shutter = camera_->info().shutter;
    config.model = view_;
    const Status status = config.validate();
    if (!status.ok()) throw InputError(camera_->info().name + ": " + status.message());
    memory_.resize(ModelTracker::required_bytes(config) / sizeof(std::max_align_t) + 1);
    const Status created = ModelTracker::create(config, std::as_writable_bytes(std::span(memory_)), &tracker_);
    if (!created.ok()) throw InputError(chosen_.model + ": " + created.message());
  }

  // A model is often accompanied by the pose of a first view: box.cao by box.pos or box.0.pos. Empty: it is not.
  std::string pose_file() const {
    if (!chosen_.initial_pose.empty()) return chosen_.initial_pose;
    for (const char* extension : {".pos", ".0.pos"}) {
      std::filesystem::path beside = chosen_.model;
      beside.replace_extension(extension);
      std::error_code ignored;
      if (std::filesystem::is_regular_file(beside, ignored)) return beside.string();
    }
    return "";
  }

  void start() {
    if (!chosen_.initial_points.empty()) {
      const SeenPoints seen = read_seen_points(chosen_.initial_points);
      knowledge_.inputs.add("the first view's points", chosen_.initial_points);
      const Status status = tracker_->start(seen.points_o, seen.px);
      if (!status.ok()) throw InputError("--initial-points " + chosen_.initial_points + ": " + status.message());
      return;
    }
    const std::string file = pose_file();
    if (file.empty()) {
      warnings_.push_back(
          chosen_.model +
          ": the object was sought in the whole image. To say where it is at first, give --initial-pose "
          "or --initial-points, or lay a .pos file of the same name beside the model");
      tracker_->start_anywhere();
      return;
    }
    knowledge_.inputs.add("the first pose", file);
    const Status status = tracker_->start(read_object_pose(file));
    if (!status.ok()) throw InputError("--initial-pose " + file + ": " + status.message());
  }

  // False at the end, when the time is over, and at a signal. A device that was pulled out is waited for, but has no
  // times: its frames' no longer tell how long the run has been.
  bool next_frame(Frame* frame) {
    constexpr int64_t kLook_ns = 50'000'000;            // between two looks at signals and the clock
    constexpr int64_t kFirstFrame_ns = 10'000'000'000;  // for a device that takes its time
    const bool device = !chosen_.camera.empty();
    for (;;) {
      if (interrupted()) return false;
      const double waited_s = 1e-9 * static_cast<double>(clock_.now_ns() - begun_ns_);
      if (device && log_.frames == 0 && waited_s > 1e-9 * static_cast<double>(kFirstFrame_ns)) return false;
      if (gone_ && chosen_.duration_s > 0 && waited_s >= chosen_.duration_s) return false;
      switch (camera_->wait(frame, device ? clock_.now_ns() + kLook_ns : platform::Camera::kForEver)) {
        case CameraEvent::kFrame:
          return true;
        case CameraEvent::kEnd:
          return false;
        case CameraEvent::kUnplugged:
          gone_ = true;
          trouble_ = camera_->status().trouble;
          print_warning(trouble_ + "; waiting for it to come back");
          break;
        case CameraEvent::kReplugged:
          gone_ = false;
          print_warning(camera_->info().name + ": is back");
          break;
        case CameraEvent::kTimeout:
          break;
      }
    }
  }

  void track_all(const OutputFolder& folder, Frame frame) {
    if (!chosen_.no_overlay) {
      draft_ = std::make_unique<Draft>(folder.path(kModelVideo));
      overlay_ = std::make_unique<ModelOverlay>(camera_->info(), view_, draft_->path(), &warnings_);
    }
    Progress progress;
    try {
      const int64_t first_ns = frame.timestamp_ns;
      do {
        const ModelResult result = tracker_->track(frame);
        if (result.status.ok()) {
          add_result(result, &log_);
          if (overlay_) overlay_->add(frame, result);
        }
        camera_->give_back();
        const double seconds = 1e-9 * static_cast<double>(frame.timestamp_ns - first_ns);
        progress.show(log_.frames, camera_->info().frame_count.value_or(0),
                      format("%.1f s  %s, quality %.2f", seconds, model_state_name(result.state),
                             static_cast<double>(result.quality)));
        if (chosen_.duration_s > 0 && seconds >= chosen_.duration_s) break;
      } while (next_frame(&frame));
    } catch (const InputError& error) {
      log_.broken = error.what();
    }
    progress.finish();
    if (interrupted()) log_.broken = interruption();
    if (log_.frames == 0)
      throw InputError(log_.broken.empty() ? camera_->info().name + ": no frame came" : log_.broken);
  }

  int write(const std::filesystem::path& place, OutputFolder* folder) {
    bool failed = false;
    const auto attempt = [&](const auto& write_one) {
      try {
        write_one();
      } catch (const InputError& error) {
        print_error(error.what());
        failed = true;
      }
    };
    std::string still;
    attempt([&] {
      folder->write("trajectory.txt",
                    tum_text(log_.trajectory, "timestamp tx ty tz qx qy qz qw, camera-to-object, model units"));
    });
    attempt([&] { folder->write("frames.csv", log_.csv); });
    if (overlay_) {
      attempt([&] {
        if (overlay_->finish()) folder->keep(kModelVideo, draft_.get());
      });
      attempt([&] {
        still = overlay_->good_png();
        if (!still.empty()) folder->write("overlay.png", still);
      });
    }
    const std::vector<SummaryRow> rows = summarise(log_, model_);
    attempt([&] { folder->write("report.html", report_page(rows, command_line_, still)); });
    attempt([&] { folder->finish(); });
    print_rows(rows);
    std::string written;
    for (const std::string& name : folder->written()) written += " " + name;
    print_line("");
    print_line("written to " + place.string() + ":" + written);
    for (const std::string& warning : warnings_) print_warning(warning);
    for (const std::string& warning : camera_->remarks()) print_warning(warning);
    if (!log_.broken.empty()) print_error(log_.broken + "; what came before it was tracked and written");
    return failed || !log_.broken.empty() ? kExitBroken : kExitOk;
  }

  const ModelChoice& chosen_;
  std::string command_line_;
  ModelFile model_;
  ObjectModel view_;
  Knowledge knowledge_;
  std::unique_ptr<platform::Camera> camera_;
  std::vector<std::max_align_t> memory_;
  ModelTracker* tracker_ = nullptr;
  SteadyClock clock_;
  int64_t begun_ns_ = 0;  // by clock_
  bool gone_ = false;     // the device, for now
  std::string trouble_;   // why
  std::unique_ptr<Draft> draft_;
  std::unique_ptr<ModelOverlay> overlay_;
  std::vector<std::string> warnings_;
  ModelLog log_;
};

}  // namespace

Command add_model(CLI::App& program, const std::string& command_line) {
  CLI::App* model = program.add_subcommand("model", "Track a known object by its edges");
  const auto chosen = std::make_shared<ModelChoice>();
  model->add_option("model", chosen->model, "The object: .cao (V1) or Wavefront OBJ")->required()->type_name("MODEL");
  add_recording_options(model, &chosen->input);
  model->get_option("source")->required(false);
  model->add_option("--camera", chosen->camera, "A device instead of a recording: /dev/video0, libcamera:0")
      ->type_name("CAMERA");
  model->add_option("--readout", chosen->readout, "Rolling shutter of the source, rows|columns:+|-:SECONDS");
  model
      ->add_option("--initial-pose", chosen->initial_pose,
                   "Where the object is in the first frame, roughly: .pos or a 4x4 matrix, object to camera "
                   "[MODEL's name with .pos or .0.pos; else it is sought in the whole image]")
      ->type_name("FILE");
  model
      ->add_option("--initial-points", chosen->initial_points,
                   "Instead: a number n >= 4, then n lines X Y Z u v: points of the object and their pixels")
      ->type_name("FILE");
  model->add_option("--out", chosen->out, "Folder for the results [out/MODEL-in-SOURCE]")->type_name("DIR");
  model->add_flag("--no-overlay", chosen->no_overlay, "No overlay.mp4 and overlay.png");
  model->add_option("--duration", chosen->duration_s, "End after so long [never]")
      ->check(CLI::Range(0.01, 1e9))
      ->type_name("SECONDS");
  model->footer(
      "Written: trajectory.txt (camera in the object's frame, model units), frames.csv, report.html with the error of\n"
      "each kind of feature, overlay.mp4. Start: within about 15 degrees and a tenth of the distance.\n"
      "Examples:\n"
      "  pocket-ptam model box.cao clip.mp4 --calibration phone.yaml --initial-pose box.pos\n"
      "  pocket-ptam model box.obj 'frames/%04d.png' --fov 50 --initial-points box.points\n"
      "  pocket-ptam model box.cao --camera /dev/video0 --calibration cam.yaml --initial-pose box.pos --duration 30");
  return {model, [chosen, command_line] { return ModelRun(*chosen, command_line).run(); }};
}

}  // namespace pptam::app
