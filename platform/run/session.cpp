#include "platform/run/session.h"

#include <algorithm>
#include <cmath>
#include <exception>
#include <new>
#include <span>

#include <pocket_ptam/inspection.h>
#include "platform/files.h"
#include "platform/input_error.h"
#include "platform/text.h"

namespace pptam::platform {
namespace {

Config config_for(const CameraInfo& info, SystemProfile profile) {
  CameraModel model = info.model;
  model.prepare();
  Config config = profile == SystemProfile::kTiny      ? Config::tiny(model)
                  : profile == SystemProfile::kDesktop ? Config::desktop(model)
                                                       : Config::phone(model);
  config.camera.shutter = info.shutter;
  config.exposure_s = info.exposure_s;
  return config;
}

constexpr size_t kMaxMapFile = size_t{1} << 30;

std::unique_ptr<Clock> clock_of(const RunOptions& options, const System& system) {
  if (options.make_clock) return options.make_clock();
  switch (options.clock) {
    case ClockKind::kSteady:
      return std::make_unique<SteadyClock>();
    case ClockKind::kThrottled:
      return std::make_unique<ThrottledClock>(options.slowdown);
    case ClockKind::kWork:
      break;
  }
  return std::make_unique<WorkClock>(system.work_meter());
}

}  // namespace

FrameLog log_of(const TrackResult& result) {
  FrameLog log;
  log.timestamp_ns = result.timestamp_ns;
  log.state = result.state;
  log.quality = result.quality;
  log.hint = result.hint;
  log.progress = result.progress;
  log.limits_hit = result.limits_hit;
  log.pose_valid = result.pose_valid;
  log.blurred = result.blurred;
  log.misfit = result.misfit;
  log.keyframe_added = result.keyframe_added;
  if (result.pose_valid) {
    log.T_wc = camera_to_world(result.T_cw);
    // With T_cw <- exp(mu) T_cw the centre moves by -R^T times mu's translation: the traces are those of mu's blocks.
    const auto variances = result.covariance.diagonal().cast<double>();
    log.position_sigma = std::sqrt(std::max(0.0, variances[0] + variances[1] + variances[2]));
    log.rotation_sigma = std::sqrt(std::max(0.0, variances[3] + variances[4] + variances[5]));
  }
  log.points_attempted = result.points_attempted;
  log.points_found = result.points_found;
  log.points_inliers = result.points_inliers;
  log.reprojection_px = result.reprojection_px;
  log.partial_attempted = result.partial_attempted;
  log.partial_found = result.partial_found;
  log.map = result.map;
  log.maps = result.maps;
  log.keyframes = result.keyframes;
  log.erased_keyframes = result.erased_keyframes;
  log.map_points = result.map_points;
  std::copy(std::begin(result.stage_ns), std::end(result.stage_ns), std::begin(log.stage_ns));
  return log;
}

Session make_session(const CameraInfo& camera, const RunOptions& options) {
  Config config = config_for(camera, options.profile);
  config.profile = options.processor.value_or(config.profile);
  config.auto_start = options.auto_start;
  config.initial_plane_distance = static_cast<float>(options.plane_distance);
  config.steady_damping = options.steady_damping;
  config.max_keyframes = options.max_keyframes.value_or(config.max_keyframes);
  config.max_erased_keyframes = options.max_erased_keyframes.value_or(config.max_erased_keyframes);
  const auto require = [&](const Status& status) {
    if (!status.ok()) throw InputError(camera.name + ": the camera cannot be used: " + status.message());
  };
  require(config.validate());
  Session session;
  const size_t bytes = System::required_bytes(config);
  session.bytes = static_cast<int64_t>(bytes);
  session.parts = System::required_parts(config);
  try {
    session.memory.resize((bytes + sizeof(std::max_align_t) - 1) / sizeof(std::max_align_t));
  } catch (const std::exception&) {
    throw InputError(camera.name + ": there is not enough memory for such images and --max-keyframes: " +
                     std::to_string(bytes >> 20) + " MB are needed");
  }
  require(System::create(config, std::as_writable_bytes(std::span(session.memory)), &session.system));
  session.clock = clock_of(options, *session.system);
  session.system->set_clock(session.clock.get());
  session.tracer = std::make_unique<RunTracer>(*session.clock, options.keep_trace);
  session.system->set_tracer(session.tracer.get());
  session.system->set_locked(options.lock_map);
  if (!options.load_map.empty()) {
    const Status status = session.system->load_map(read_map_file(options.load_map));
    if (!status.ok()) throw InputError(options.load_map + ": " + status.message());
  }
  return session;
}

void GroundChoice::choose(const SetGround& set_ground, TrackResult* result) {
  pptam::Similarity change;
  const Status status = set_ground(*px_, &change);
  if (status.ok()) {
    result->T_cw = change.moved(result->T_cw);
    ++result->world_changes;
  } else {
    trouble_ = format("--ground %g,%g: ", static_cast<double>(px_->x()), static_cast<double>(px_->y())) +
               status.message() + "; the ground is what was found";
  }
  px_.reset();
}

void take_map(System& system, const RunOptions& options, RunLog* log) {
  log->kept_maps.clear();
  for (const int map : log->maps()) {
    if (system.keyframes({}, map) > 0) log->kept_maps.push_back(map);
  }
  const int map = log->main_map();
  log->keyframes.resize(static_cast<size_t>(system.keyframes({}, map)));
  system.keyframes(log->keyframes, map);
  log->map_points.resize(static_cast<size_t>(system.map_points({}, map)));
  system.map_points(log->map_points, map);
  log->planes.resize(kMostPlanes);
  log->planes.resize(static_cast<size_t>(system.planes(log->planes, map)));
  log->map_fit = map_fit(system);
  // Of the map in use, whose number is the last frame's.
  const bool in_use = log->frames.empty() || log->frames.back().map == map;
  log->map_parts = in_use ? map_parts(system, kHoldingPoints) : 1;
  log->map_hash = map_hash(system);
  if (!options.save_map) return;
  try {
    log->saved_map.resize(system.map_bytes());
  } catch (const std::bad_alloc&) {  // the rest can still be written
    log->save_trouble = "not enough memory for a copy of the map";
    return;
  }
  size_t saved = 0;
  const Status status = system.save_map(log->saved_map, &saved);
  log->saved_map.resize(saved);
  if (!status.ok()) log->save_trouble = status.message();
}

std::vector<std::byte> read_map_file(const std::filesystem::path& file) {
  return read_file(file, kMaxMapFile);
}

}  // namespace pptam::platform
