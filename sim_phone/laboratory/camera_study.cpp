#include "sim_phone/laboratory/camera_study.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "platform/calibrate/camera_search.h"
#include "platform/run/console.h"
#include "platform/run/interruption.h"
#include "platform/run/jobs.h"
#include "platform/run/names.h"
#include "platform/text.h"
#include "sim_phone/laboratory/keeping_camera.h"
#include "sim_phone/random.h"

namespace pptam::laboratory {
namespace {

using namespace platform;

constexpr double kMaxReadoutError_s = 0.003, kMaxFocalError = 0.03;  // wanted
constexpr uint64_t kGlobalEvery = 4;                                 // of so many clips one has a global shutter
constexpr double kMinReadout_s = 0.008;                              // of the others
constexpr double kMaxReadout = 0.95;                                 // likewise, of the time between two frames
constexpr double kNarrow_degrees = 35, kWide_degrees = 60;           // horizontal fields of view
constexpr double kMaxLogFocal = 0.3;                                 // by which what is told is wrong
constexpr uint64_t kPhoneStream = 96;                                // of chance

struct FoundCamera {
  std::string name;
  RollingShutter::Axis axis = RollingShutter::Axis::kRows;
  double readout_s = 0, told_focal = 1;  // the truth, and what was told relative to it
  CameraSearch search;

  const CameraFit& fit() const { return search.fit; }
  bool fitted() const { return fit().trouble.empty() && search.settled; }
  bool told_readout() const { return fitted() && fit().readout_s.trouble.empty(); }
  bool told_focal_length() const { return fitted() && fit().focal.trouble.empty(); }
  // A readout along the other axis is wrong by all of it.
  double readout_error_s() const {
    const double found_s = fit().global ? 0 : fit().readout_s.value;
    return fit().axis == axis || found_s == 0 ? found_s - readout_s : std::abs(found_s) + std::abs(readout_s);
  }
  double focal_error() const { return told_focal * search.focal_factor - 1; }
};

FoundCamera find_one(sim::PhoneOptions phone, size_t index, const RunOptions& run) {
  FoundCamera found;
  sim::Random random(index, kPhoneStream);
  phone.readout_axis = random.chance(0.5) ? RollingShutter::Axis::kRows : RollingShutter::Axis::kColumns;
  const double share = random.uniform(kMinReadout_s * phone.frames_per_s, kMaxReadout);
  const double sign = random.sign();
  phone.readout_s = index % kGlobalEvery == 0 ? 0 : sign * share / phone.frames_per_s;
  phone.horizontal_fov_degrees = random.uniform(kNarrow_degrees, kWide_degrees);
  phone.exposure_s = random.uniform(0.004, 0.020);
  found.name = phone.scene + ", seed " + std::to_string(phone.seed);
  found.axis = phone.readout_axis;
  found.readout_s = phone.readout_s;
  found.told_focal = std::exp(random.uniform(-kMaxLogFocal, kMaxLogFocal));
  KeepingCamera camera(sim::make_phone_camera(phone));
  CameraModel told = camera.info().model;
  told.fx *= static_cast<float>(found.told_focal);
  told.fy *= static_cast<float>(found.told_focal);
  CameraFitOptions options;
  options.focal = true;
  options.curves = false;
  found.search = search_camera(
      [&](const CameraAssumption& assumed) {
        CameraModel model = told;
        model.fx *= static_cast<float>(assumed.focal_factor);
        model.fy *= static_cast<float>(assumed.focal_factor);
        camera.again_as(model, assumed.shutter.value_or(RollingShutter()));
        return track_clip(camera, run, nullptr);
      },
      options, interrupted);
  return found;
}

}  // namespace

bool run_camera_study(const CameraStudyOptions& options) {
  std::vector<std::string> scenes = options.scenes;
  if (scenes.empty()) scenes = {"desk", "boxes", "walls"};
  const auto seeds = static_cast<size_t>(options.seeds);
  for (const std::string& scene : scenes) {
    sim::PhoneOptions phone = options.phone;
    phone.scene = scene;
    sim::check_phone_options(phone);
  }
  stop_on_signals();
  std::vector<FoundCamera> all(scenes.size() * seeds);
  const std::vector<bool> done = run_jobs(options.jobs, all.size(), [&](size_t i) {
    sim::PhoneOptions phone = options.phone;
    phone.scene = scenes[i / seeds];
    phone.seed = 1 + i % seeds;
    all[i] = find_one(phone, i, options.run);
    return all[i].name;
  });
  std::vector<std::vector<std::string>> rows;
  size_t missing = 0;
  int wrong_readouts = 0, wrong_focals = 0, readouts = 0, focals = 0;
  for (size_t i = 0; i < all.size(); ++i) {
    missing += !done[i];
    if (!done[i]) continue;
    const FoundCamera& one = all[i];
    const CameraFit& fit = one.fit();
    readouts += one.told_readout();
    focals += one.told_focal_length();
    wrong_readouts += one.told_readout() && !(std::abs(one.readout_error_s()) <= kMaxReadoutError_s);
    wrong_focals += one.told_focal_length() && !(std::abs(one.focal_error()) <= kMaxFocalError);
    const double tracked = one.search.rounds.empty() ? 0 : one.search.rounds.back().tracked;
    rows.push_back({one.name, one.readout_s == 0 ? "global" : readout_text(one.axis, one.readout_s),
                    format("%.2f", one.told_focal), format("%zu", one.search.rounds.size()),
                    format("%.0f", 100 * tracked), format("%+.2f", 1000 * one.readout_error_s()),
                    format("%.2f", 1000 * fit.readout_s.sigma), one.told_readout() ? "" : "not told",
                    format("%+.2f", 100 * one.focal_error()), format("%.2f", 100 * fit.focal.sigma),
                    one.told_focal_length() ? "" : "not told"});
  }
  print_table(
      {"clip", "shutter", "told focal", "rounds", "tracked %", "readout ms", "sigma", "", "focal %", "sigma", ""},
      rows);
  print_line(
      format("\nreadout told of %d clips, wrong by more than %g ms in %d; focal length of %d, wrong by more than "
             "%g %% in %d",
             readouts, 1000 * kMaxReadoutError_s, wrong_readouts, focals, 100 * kMaxFocalError, wrong_focals));
  if (missing > 0) print_error(interruption() + format(": %zu of %zu clips are missing", missing, all.size()));
  return wrong_readouts == 0 && wrong_focals == 0 && missing == 0;
}

}  // namespace pptam::laboratory
