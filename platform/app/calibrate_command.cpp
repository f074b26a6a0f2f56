// pocket-ptam calibrate: a camera's lens from views of a checkerboard, and its readout from a clip that moves before
// it.

#include <algorithm>
#include <cmath>
#include <exception>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "platform/app/commands.h"
#include "platform/app/options.h"
#include "platform/app/single_run.h"
#include "platform/calibrate/board.h"
#include "platform/calibrate/board_views.h"
#include "platform/calibrate/board_vision.h"
#include "platform/calibrate/calibration_report.h"
#include "platform/calibrate/lens_fit.h"
#include "platform/calibrate/readout_fit.h"
#include "platform/camera/calibration.h"
#include "platform/files.h"
#include "platform/input_error.h"
#include "platform/outputs.h"
#include "platform/run/console.h"
#include "platform/run/interruption.h"
#include "platform/run/names.h"
#include "platform/text.h"

namespace pptam::app {
namespace {

using namespace platform;

constexpr size_t kMostViews = 40;  // more cost time and add little

const std::vector<std::string> kCalibrationOutputs = {"calibration.yaml", "report.html", "coverage.png",
                                                      "residuals.png"};

struct CalibrateChoice {
  std::string source, moving, calibration, board = "10x7", lens = "auto", axes = "both", out;
  double fps = 0;
  std::string print_board, paper = "A4";
  double square_mm = 0;
};

int print_board(const CalibrateChoice& chosen) {
  const std::string pdf = board_pdf(parse_board(chosen.board), chosen.paper, chosen.square_mm);
  check_output_file("--print-board", chosen.print_board, {}, "a checkerboard", is_sealed);
  write_text_atomically(chosen.print_board, pdf);
  print_line("a checkerboard of " + chosen.board + " squares for " + chosen.paper + " paper is in " +
             chosen.print_board + ": print it at 100 %");
  return kExitOk;
}

// Opens a source of images for which only the images count. Warnings, which may be null, are printed.
std::unique_ptr<platform::Camera> open_images_of(const CalibrateChoice& chosen, const std::string& source,
                                                 const std::string& calibration, bool timed, Knowledge* knowledge) {
  RecordingOptions recording;
  recording.source = source;
  recording.calibration = calibration;
  recording.uncalibrated = calibration.empty();
  recording.fps = chosen.fps;
  std::vector<std::string> warnings;
  std::unique_ptr<platform::Camera> camera = open_recording(recording, timed ? &warnings : nullptr);
  for (const std::string& warning : warnings) print_warning(warning);
  add_inputs(recording, knowledge);
  return camera;
}

BoardViews look(platform::Camera& camera, const Board& board, bool every_frame) {
  LookOptions options;
  options.every_frame = every_frame;
  Progress progress;
  BoardViews views = look_for_board(camera, board, board_vision(), options, [&](const BoardViews& so_far) {
    progress.show(so_far.frames + 1, camera.info().frame_count.value_or(0),
                  format("%zu views of the board", so_far.views.size()));
    return !interrupted();
  });
  progress.finish();
  for (const std::string& remark : camera.remarks()) print_warning(remark);
  return views;
}

// Throws InputError when the board was never seen.
void require_board(const BoardViews& found, const CalibrateChoice& chosen, const std::string& name) {
  if (!found.views.empty()) return;
  if (!found.broken.empty()) throw InputError(found.broken);
  std::string why = ": is it in view as a whole, with a white rim, sharp and evenly lit?";
  if (!found.other_board.empty()) why = ", but one of " + found.other_board + " was: give --board " + found.other_board;
  throw InputError(name + format(": in none of %d images was a checkerboard of ", found.looked_at) + chosen.board +
                   " squares found" + why);
}

// What the command makes, and its parts for the report.
struct Calibrated {
  std::optional<LensFit> lens;
  std::optional<ReadoutFit> readout;
  Calibration calibration;
  bool known = false;  // there is a calibration to write
  std::vector<SummaryRow> rows;
  std::vector<std::string> advice, troubles;
  std::string coverage_png;
};

std::string views_text(const BoardViews& found, size_t used, int blurred, const LensFit* lens) {
  std::string text = format("%zu of %d images looked at; %d without the whole board, %d too blurred", used,
                            found.looked_at, found.without_board, blurred);
  if (lens != nullptr && !lens->left_out.empty()) {
    std::vector<std::string> frames;
    for (const int frame : lens->left_out) frames.push_back(format("%d", frame));
    text += format("; %zu that do not fit the others: frame ", frames.size()) + joined(frames);
  }
  return text;
}

void add_lens_rows(const LensFit& fit, std::vector<SummaryRow>* rows) {
  const LensSolution& s = fit.solution;
  const CameraModel& m = fit.model;
  const Vector2f left = m.unproject(Vector2f(-0.5f, m.cy)), right = m.unproject(Vector2f(m.width - 0.5f, m.cy));
  const double fov = 180 / M_PI * static_cast<double>(std::atan(right.x()) - std::atan(left.x()));
  const auto sigma = [](double px) { return px > 0 ? format(" (+- %.2f)", px) : std::string(); };
  rows->push_back({"lens", format("%s, %.1f degrees across", name_of(s.kind), fov)});
  rows->push_back({"focal length", format("fx %.2f", s.fx) + sigma(s.sigma_fx) + format(", fy %.2f px", s.fy)});
  rows->push_back({"principal point",
                   format("%.2f", s.cx) + sigma(s.sigma_cx) + format(", %.2f", s.cy) + sigma(s.sigma_cy) + " px"});
  std::vector<std::string> coeffs;
  for (const double c : s.coeffs) coeffs.push_back(format("%.5g", c));
  if (s.kind != LensKind::kWide) coeffs.pop_back();
  rows->push_back({"distortion", joined(coeffs)});
  rows->push_back({"residuals", format("%.3f px rms of %zu corners", fit.rms_px,
                                       fit.views.size() * fit.views.front().corners.size())});
  if (fit.uncertain_px)
    rows->push_back(
        {"uncertainty", format("+- %.2f px (one standard deviation), where it is worst", *fit.uncertain_px)});
}

void calibrate_lens(platform::Camera& camera, const CalibrateChoice& chosen, Calibrated* result) {
  const Board board = parse_board(chosen.board);
  const BoardViews found = look(camera, board, false);
  require_board(found, chosen, camera.info().name);
  if (!found.broken.empty()) result->troubles.push_back(found.broken + "; what came before it was used");
  int blurred = 0;
  const std::vector<BoardView> views = choose_views(found, kMostViews, &blurred);
  Coverage coverage(found.width, found.height);
  for (const BoardView& view : views) coverage.add(view);
  result->advice = coverage.missing();
  result->coverage_png = coverage_png(board, found.width, found.height, views);
  std::optional<LensKind> kind;
  for (const LensKind known : {LensKind::kNormal, LensKind::kWide, LensKind::kFisheye}) {
    if (chosen.lens == name_of(known)) kind = known;
  }
  try {
    result->lens = fit_lens(board, found.width, found.height, views, coverage, board_vision(), kind);
  } catch (const InputError& error) {
    result->rows.push_back({"views", views_text(found, views.size(), blurred, nullptr)});
    result->troubles.push_back(error.what());
    return;
  }
  const LensFit& fit = *result->lens;
  add_lens_rows(fit, &result->rows);
  result->rows.push_back({"views", views_text(found, fit.views.size(), blurred, &fit)});
  result->rows.push_back({"coverage", format("%.0f %% of the image", 100 * coverage.share())});
  result->advice.insert(result->advice.begin(), fit.warnings.begin(), fit.warnings.end());
  result->calibration.model = fit.model;
  result->known = true;
}

void find_shutter(platform::Camera& camera, const CalibrateChoice& chosen, Calibrated* result) {
  const Board board = parse_board(chosen.board);
  const CameraModel& model = result->calibration.model;
  const CameraModel& seen = camera.info().model;
  if (seen.width != model.width || seen.height != model.height) {
    result->troubles.push_back(
        format("the moving clip has images of %dx%d, the views of %dx%d: take both in the same "
               "mode of the camera",
               seen.width, seen.height, model.width, model.height));
    return;
  }
  const BoardViews clip = look(camera, board, true);
  if (!clip.broken.empty()) result->troubles.push_back(clip.broken + "; what came before it was used");
  const ReadoutFit fit = fit_readout(board, clip, model, chosen.axes);
  result->readout = fit;
  if (!fit.trouble.empty()) {
    result->troubles.push_back(fit.trouble);
    return;
  }
  result->rows.push_back(
      {"readout", readout_text(fit.axis, fit.readout_s) +
                      format(", +- %.2f ms%s", 1000 * fit.sigma_s, fit.global ? ": as of a global shutter" : "")});
  result->rows.push_back({"moving clip", format("%d frames at %.0f px/s; corners %.3f px rms, %.3f under a global "
                                                "shutter",
                                                fit.frames, fit.speed_px_s, fit.rms_px, fit.global_px)});
  RollingShutter& shutter = result->calibration.shutter;
  shutter.axis = fit.axis;
  const int lines = fit.axis == RollingShutter::Axis::kColumns ? model.width : model.height;
  shutter.line_time_s = fit.global ? 0.0f : static_cast<float>(fit.readout_s / lines);
}

// Results one by one; what fails is told. Returns whether all was written.
bool write_calibration(const Calibrated& result, const std::string& name, const std::string& command_line,
                       OutputFolder* folder) {
  bool whole = true;
  const auto attempt = [&](const std::function<void()>& write) {
    try {
      write();
    } catch (const std::exception& error) {
      print_error(error.what());
      whole = false;
    }
  };
  if (result.known) {
    attempt([&] {
      std::string head = "# Made by pocket-ptam calibrate.";
      if (result.lens) {
        head += format(" %zu views, residuals of %.3f px rms.", result.lens->views.size(), result.lens->rms_px);
      }
      if (!result.readout || !result.readout->trouble.empty()) head += " The readout was not measured.";
      folder->write("calibration.yaml", head + "\n" + calibration_yaml(result.calibration));
    });
  } else {
    folder->give_up("calibration.yaml");
  }
  CalibrationReport report;
  report.name = name;
  report.command = command_line;
  report.version = PPTAM_VERSION;
  report.rows = result.rows;
  report.advice = result.troubles;
  report.advice.insert(report.advice.end(), result.advice.begin(), result.advice.end());
  report.coverage_png = result.coverage_png;
  report.lens = result.lens ? &*result.lens : nullptr;
  report.readout = result.readout ? &*result.readout : nullptr;
  if (!report.coverage_png.empty()) attempt([&] { folder->write("coverage.png", report.coverage_png); });
  if (result.lens) {
    attempt([&] {
      report.residuals_png = residuals_png(*result.lens);
      folder->write("residuals.png", report.residuals_png);
    });
  }
  std::vector<std::string> warnings;
  attempt([&] { folder->write("report.html", calibration_page(report, &warnings)); });
  attempt([&] { folder->finish(); });
  for (const std::string& warning : warnings) print_warning(warning);
  return whole;
}

void check_choice(const CalibrateChoice& chosen) {
  if (chosen.source.empty() && (chosen.calibration.empty() || chosen.moving.empty())) {
    throw InputError(
        "calibrate: name the views of the board (a folder, pattern or video), or --calibration and --moving for the "
        "readout alone; --print-board makes a board; see pocket-ptam calibrate --help");
  }
  if (!chosen.source.empty() && !chosen.calibration.empty())
    throw InputError("--calibration " + chosen.calibration + ": is for the readout alone, without views of the board");
}

int calibrate(const CalibrateChoice& chosen, const std::string& command_line) {
  check_choice(chosen);
  parse_board(chosen.board);
  board_vision();
  Knowledge knowledge;
  std::unique_ptr<platform::Camera> views, moving;
  if (!chosen.source.empty()) views = open_images_of(chosen, chosen.source, "", false, &knowledge);
  if (!chosen.moving.empty()) moving = open_images_of(chosen, chosen.moving, chosen.calibration, true, &knowledge);
  const std::string name = (views ? views : moving)->info().name;
  const std::filesystem::path place(chosen.out.empty() ? "out/calibration-" + folder_name(name) : chosen.out);
  for (const std::filesystem::path& images : knowledge.image_folders) {
    if (same_place(images, place))
      throw InputError("--out " + place.string() + ": the images are there, name another folder");
  }
  OutputFolder folder(place, "--out", kCalibrationOutputs, knowledge.inputs);
  stop_on_signals();

  Calibrated result;
  if (views) {
    calibrate_lens(*views, chosen, &result);
  } else {
    const CameraInfo& info = moving->info();
    result.calibration = {info.model, info.shutter, info.exposure_s};
    result.known = true;
  }
  if (moving && result.known && !interrupted()) find_shutter(*moving, chosen, &result);
  if (interrupted()) result.troubles.push_back(interruption() + "; what came before it was used");
  if (!views && (!result.readout || !result.readout->trouble.empty())) result.known = false;  // nothing new

  folder.prepare();
  const bool written = write_calibration(result, name, command_line, &folder);
  print_rows(result.rows);
  for (const std::string& line : result.advice) print_warning(line);
  for (const std::string& line : result.troubles) print_error(line);
  print_line("");
  print_line("written to " + place.string() + ": " + joined(folder.written()));
  if (result.known) print_line("use it with --calibration " + folder.path("calibration.yaml").string());
  return written && result.troubles.empty() ? kExitOk : kExitBroken;
}

}  // namespace

Command add_calibrate(CLI::App& program, const std::string& command_line) {
  CLI::App* command = program.add_subcommand(
      "calibrate", "Calibrate a camera by views of a checkerboard, and its rolling shutter by a moving clip of it");
  const auto chosen = std::make_shared<CalibrateChoice>();
  command->add_option("source", chosen->source, "Views: folder of images, pattern such as img_%04d.png, or video")
      ->type_name("SOURCE");
  command->add_option("--board", chosen->board, "The board's squares, across and down")
      ->capture_default_str()
      ->type_name("CxR");
  command->add_option("--lens", chosen->lens, "normal (4 coefficients), wide (5), fisheye, or auto: what fits")
      ->capture_default_str()
      ->check(CLI::IsMember({"auto", "normal", "wide", "fisheye"}))
      ->type_name("KIND");
  command->add_option("--moving", chosen->moving, "A clip that moves quickly before the board: finds the readout")
      ->type_name("SOURCE");
  command->add_option("--axis", chosen->axes, "Of the readout, where it is known: rows, columns or both")
      ->capture_default_str()
      ->check(CLI::IsMember({"rows", "columns", "both"}))
      ->type_name("AXIS");
  command->add_option("--calibration", chosen->calibration, "Instead of views: find the readout alone, for this lens")
      ->type_name("FILE");
  command->add_option("--fps", chosen->fps, "Frames per second of images and raw streams without times")
      ->type_name("N");
  command->add_option("--out", chosen->out, "Folder for the results [out/calibration-NAME]")->type_name("DIR");
  command->add_option("--print-board", chosen->print_board, "Only write the board as a PDF to print")
      ->type_name("OUT.pdf");
  command->add_option("--paper", chosen->paper, "Of that PDF: A4 or Letter")
      ->capture_default_str()
      ->check(CLI::IsMember({"A4", "Letter"}))
      ->type_name("SIZE");
  command->add_option("--square", chosen->square_mm, "Side of a square of that PDF [as large as fits]")
      ->type_name("MM");
  command->footer(
      "Print the board and glue it to something flat, or show it on a screen. Take 20 to 40 sharp photographs of it,\n"
      "or a slow video: near, so that it fills half of the view; in every part and corner of the image; tilted by 20\n"
      "to 40 degrees to the left, the right, up and down. Same size, zoom and focus as later.\n"
      "For the readout besides a clip in which the camera moves quickly, with the whole board in view.\n"
      "Examples:\n"
      "  pocket-ptam calibrate --print-board board.pdf\n"
      "  pocket-ptam calibrate photos/\n"
      "  pocket-ptam calibrate slow.mp4 --moving quick.mp4 --out mycamera\n"
      "  pocket-ptam calibrate --calibration mycamera/calibration.yaml --moving quick.mp4\n"
      "Exit code 1: the views do not tell the lens, or the clip the readout; what is missing is said and drawn.");
  return {command, [chosen, command_line] {
            return chosen->print_board.empty() ? calibrate(*chosen, command_line) : print_board(*chosen);
          }};
}

}  // namespace pptam::app
