// System for C: pocket_ptam_c.h but for the model tracker. A pptam_system is the head of the caller's block, the System
// with all that is its own follows it.
#include <memory>
#include <new>
#include <span>

#include <pocket_ptam/inspection.h>
#include <pocket_ptam/pocket_ptam.h>
#include <pocket_ptam/pocket_ptam_c.h>
#include "c_interface/conversions.h"

namespace pptam::c {

namespace {

constexpr const char* kNoSystem = "system is null: pptam_create() has not made one";
constexpr const char* kNullPointer = "a pointer is null";
constexpr const char* kNoMotion = "the pose is not a rotation and a translation within 1e9";
// Of coordinates, world units: no product of two overflows. Of turning rates, rad/s: in half a readout, at most 0.5 s,
// no angle leaves the sine's domain.
constexpr float kMostCoordinate = 1e9f, kMostRate = 1e3f;

class CallbackClock final : public Clock {
 public:
  CallbackClock() = default;
  CallbackClock(pptam_clock callback, void* user) : callback_(callback), user_(user) {}
  static void operator delete(void*) {}  // it stands in the caller's block: there is no heap to give it back to
  int64_t now_ns() const override { return callback_(user_); }
  void idle_until(int64_t /*t_ns*/) override {}  // the core never idles

 private:
  pptam_clock callback_ = nullptr;
  void* user_ = nullptr;
};

class CallbackTracer final : public Tracer {
 public:
  CallbackTracer() = default;
  explicit CallbackTracer(const pptam_tracer& callbacks) : callbacks_(callbacks) {}
  void begin(Span span) override { callbacks_.begin(callbacks_.user, static_cast<int32_t>(span)); }
  void end(Span span) override { callbacks_.end(callbacks_.user, static_cast<int32_t>(span)); }
  void count(Counter counter, int64_t value) override {
    callbacks_.count(callbacks_.user, static_cast<int32_t>(counter), value);
  }

 private:
  pptam_tracer callbacks_ = {};
};

Config config_from(const pptam_config& c) {
  Config config = Config::phone({});
  config.camera = camera_from(c.camera);
  config.exposure_s = c.exposure_s;
  config.max_keyframes = c.max_keyframes;
  config.max_erased_keyframes = c.max_erased_keyframes;
  config.max_maps = c.max_maps;
  config.max_map_points = c.max_map_points;
  config.max_measurements = c.max_measurements;
  config.max_measurements_per_point = c.max_measurements_per_point;
  config.max_partial_points = c.max_partial_points;
  config.max_measured_points = c.max_measured_points;
  config.max_partial_searches = c.max_partial_searches;
  config.max_new_partial_points = c.max_new_partial_points;
  config.max_initial_points = c.max_initial_points;
  config.cells_x = c.cells_x;
  config.cells_y = c.cells_y;
  config.search_level = c.search_level;
  config.coarse_search_level = c.coarse_search_level;
  config.initial_baseline = c.initial_baseline;
  config.initial_plane_distance = c.initial_plane_distance;
  config.auto_start = truth_from(c.auto_start);
  config.min_keyframe_interval_s = c.min_keyframe_interval_s;
  config.steady_damping = truth_from(c.steady_damping);
  config.profile.clock_mhz = c.profile.clock_mhz;
  config.profile.cycles_per_instruction = c.profile.cycles_per_instruction;
  std::copy_n(c.profile.instructions, kWorkKinds, config.profile.instructions.begin());
  return config;
}

pptam_config config_to_c(const Config& config) {
  pptam_config c;
  c.camera = to_c(config.camera);
  c.exposure_s = config.exposure_s;
  c.max_keyframes = config.max_keyframes;
  c.max_erased_keyframes = config.max_erased_keyframes;
  c.max_maps = config.max_maps;
  c.max_map_points = config.max_map_points;
  c.max_measurements = config.max_measurements;
  c.max_measurements_per_point = config.max_measurements_per_point;
  c.max_partial_points = config.max_partial_points;
  c.max_measured_points = config.max_measured_points;
  c.max_partial_searches = config.max_partial_searches;
  c.max_new_partial_points = config.max_new_partial_points;
  c.max_initial_points = config.max_initial_points;
  c.cells_x = config.cells_x;
  c.cells_y = config.cells_y;
  c.search_level = config.search_level;
  c.coarse_search_level = config.coarse_search_level;
  c.initial_baseline = config.initial_baseline;
  c.initial_plane_distance = config.initial_plane_distance;
  c.auto_start = config.auto_start;
  c.min_keyframe_interval_s = config.min_keyframe_interval_s;
  c.steady_damping = config.steady_damping;
  c.profile.clock_mhz = config.profile.clock_mhz;
  c.profile.cycles_per_instruction = config.profile.cycles_per_instruction;
  std::copy_n(config.profile.instructions.begin(), kWorkKinds, c.profile.instructions);
  return c;
}

pptam_status config_status(const pptam_config* config) {
  if (!config) return refused("config is null: begin with pptam_config_phone()");
  const pptam_status status = camera_status(config->camera);
  return status.code == PPTAM_OK ? to_c(config_from(*config).validate()) : status;
}

pptam_track_result result_to_c(const TrackResult& r) {
  pptam_track_result c;
  c.timestamp_ns = r.timestamp_ns;
  c.state = static_cast<int32_t>(r.state);
  c.quality = static_cast<int32_t>(r.quality);
  c.hint = static_cast<int32_t>(r.hint);
  c.progress = r.progress;
  c.limits_hit = r.limits_hit;
  c.pose_valid = r.pose_valid;
  c.blurred = r.blurred;
  c.misfit = r.misfit;
  c.keyframe_added = r.keyframe_added;
  c.repeated = r.repeated;
  c.T_cw = to_c(r.T_cw);
  numbers_to(r.velocity, c.velocity);
  numbers_to(r.covariance, c.covariance);
  c.points_attempted = r.points_attempted;
  c.points_found = r.points_found;
  c.points_inliers = r.points_inliers;
  c.reprojection_px = r.reprojection_px;
  c.partial_attempted = r.partial_attempted;
  c.partial_found = r.partial_found;
  c.map = r.map;
  c.maps = r.maps;
  c.world_changes = r.world_changes;
  c.keyframes = r.keyframes;
  c.erased_keyframes = r.erased_keyframes;
  c.map_points = r.map_points;
  c.observed_points = static_cast<int32_t>(r.points.size());
  std::copy_n(r.stage_ns, kStages, c.stage_ns);
  return c;
}

// Whether R is a rotation but for rounding, and all is finite.
bool is_motion(const pptam_pose& pose) {
  if (!all_within(pose.R, 9, 2) || !all_within(pose.t, 3, kMostCoordinate)) return false;
  const Matrix3f R = pose_from(pose).R;
  return (R * R.transpose() - Matrix3f::Identity()).squaredNorm() < 1e-4f && R.determinant() > 0;
}

pptam_keyframe entry_to_c(const KeyframeInfo& keyframe) {
  return {keyframe.id, keyframe.timestamp_ns, to_c(keyframe.T_cw)};
}

pptam_map_point entry_to_c(const MapPointInfo& point) {
  pptam_map_point c;
  c.id = point.id;
  numbers_to(point.p_w, c.p_w);
  numbers_to(point.normal_w, c.normal_w);
  c.measurements = point.measurements;
  c.grey = point.grey;
  return c;
}

pptam_measurement entry_to_c(const MeasurementInfo& measurement) {
  pptam_measurement c;
  c.point_id = measurement.point_id;
  c.keyframe_id = measurement.keyframe_id;
  numbers_to(measurement.px, c.px);
  numbers_to(measurement.global_px, c.global_px);
  c.sigma = measurement.sigma;
  return c;
}

pptam_plane entry_to_c(const PlaneInfo& plane) {
  pptam_plane c;
  numbers_to(plane.normal_w, c.normal_w);
  numbers_to(plane.middle_w, c.middle_w);
  c.threshold = plane.threshold;
  c.points = plane.points;
  return c;
}

pptam_observed_point entry_to_c(const ObservedPoint& point) {
  pptam_observed_point c;
  numbers_to(point.px, c.px);
  numbers_to(point.predicted_px, c.predicted_px);
  c.point_id = point.point_id;
  c.kind = static_cast<int32_t>(point.kind);
  c.level = point.level;
  return c;
}

// Lets a function of System fill the caller's array. There is no other room for thousands of entries: System's own
// structures, Info, are made in the array's memory, and each is replaced by the C structure of the same size.
template <class Info, class C, class Fill>
pptam_status copy_out(C* out, size_t capacity, int32_t* count, const Fill& fill) {
  static_assert(sizeof(C) == sizeof(Info) && alignof(C) == alignof(Info));
  if (!is_output(out, capacity, count)) return refused(kNoOutput);
  const int all = fill(std::span<Info>());
  const size_t copied = std::min(capacity, static_cast<size_t>(all));
  Info* const infos = reinterpret_cast<Info*>(out);
  std::uninitialized_value_construct_n(infos, copied);
  fill(std::span(infos, copied));
  for (size_t i = 0; i < copied; ++i) {
    const Info info = infos[i];
    new (out + i) C(entry_to_c(info));
  }
  *count = all;
  return kDone;
}

}  // namespace
}  // namespace pptam::c

struct pptam_system {
  pptam::System* system = nullptr;
  pptam::c::CallbackClock clock;
  pptam::c::CallbackTracer tracer;
  std::span<const pptam::ObservedPoint> points;  // of the last frame that was not refused
};

using pptam::c::kDone;
using pptam::c::kNoSystem;
using pptam::c::kNullPointer;
using pptam::c::refused;
using pptam::c::to_c;

const char* pptam_version(void) {
  return PPTAM_VERSION;
}

void pptam_set_assert_handler(pptam_assert_handler handler) {
  pptam::set_assert_handler(handler ? handler : pptam::detail::default_assert_handler);
}

pptam_status pptam_inverse_as_quaternion(const pptam_pose* pose, float position[3], float quaternion_xyzw[4]) {
  if (!pose || !position || !quaternion_xyzw) return refused(kNullPointer);
  if (!pptam::c::is_motion(*pose)) return refused(pptam::c::kNoMotion);
  const pptam::SE3 inverse = pptam::c::pose_from(*pose).inverse();
  Eigen::Quaternionf q(inverse.R);
  q.normalize();
  if (q.w() < 0) q.coeffs() = -q.coeffs();
  pptam::c::numbers_to(inverse.t, position);
  pptam::c::numbers_to(q.coeffs(), quaternion_xyzw);
  return kDone;
}

pptam_status pptam_camera_validate(const pptam_camera* camera) {
  if (!camera) return refused("camera is null");
  const pptam_status status = pptam::c::camera_status(*camera);
  return status.code == PPTAM_OK ? to_c(pptam::c::camera_from(*camera).model.validate()) : status;
}

pptam_status pptam_config_phone(const pptam_camera* camera, pptam_config* config) {
  if (!camera || !config) return refused(kNullPointer);
  const pptam_camera as_given = *camera;  // what it says of axis and distortion may be no enumerator
  *config = pptam::c::config_to_c(pptam::Config::phone({}));
  config->camera = as_given;
  return kDone;
}

pptam_status pptam_config_tiny(const pptam_camera* camera, pptam_config* config) {
  if (!camera || !config) return refused(kNullPointer);
  const pptam_camera as_given = *camera;
  *config = pptam::c::config_to_c(pptam::Config::tiny(pptam::c::camera_from(as_given).model));
  config->camera = as_given;
  return kDone;
}

pptam_status pptam_config_validate(const pptam_config* config) {
  return pptam::c::config_status(config);
}

pptam_status pptam_required_parts(const pptam_config* config, pptam_memory_parts* parts) {
  if (!parts) return refused(kNullPointer);
  const pptam_status status = pptam::c::config_status(config);
  if (status.code != PPTAM_OK) return status;
  const pptam::MemoryParts all = pptam::System::required_parts(pptam::c::config_from(*config));
  *parts = {all.map, all.tracking, all.mapping, all.rest + pptam::c::head_bytes<pptam_system>()};
  return kDone;
}

size_t pptam::c::required_bytes(const Config& config) {
  return head_bytes<pptam_system>() + System::required_bytes(config);
}

pptam_status pptam::c::create(const Config& config, void* memory, size_t bytes, pptam_system** system) {
  if (!system) return refused(kNullPointer);
  if (!memory || !block_aligned(memory)) return refused(kNoBlock);
  if (bytes < required_bytes(config))
    return {PPTAM_OUT_OF_MEMORY, "pptam_create: the block is smaller than pptam_required_bytes(config)"};
  const std::span<std::byte> block(static_cast<std::byte*>(memory), bytes);
  System* made = nullptr;
  const Status created = System::create(config, block.subspan(head_bytes<pptam_system>()), &made);
  if (!created.ok()) return to_c(created);
  *system = new (memory) pptam_system{made, {}, {}, {}};
  return kDone;
}

size_t pptam_required_bytes(const pptam_config* config) {
  if (pptam::c::config_status(config).code != PPTAM_OK) return 0;
  return pptam::c::required_bytes(pptam::c::config_from(*config));
}

pptam_status pptam_create(const pptam_config* config, void* memory, size_t bytes, pptam_system** system) {
  const pptam_status status = pptam::c::config_status(config);
  return status.code == PPTAM_OK ? pptam::c::create(pptam::c::config_from(*config), memory, bytes, system) : status;
}

pptam_status pptam_get_config(const pptam_system* system, pptam_config* config) {
  if (!system) return refused(kNoSystem);
  if (!config) return refused(kNullPointer);
  *config = pptam::c::config_to_c(system->system->config());
  return kDone;
}

pptam_status pptam_set_clock(pptam_system* system, pptam_clock now_ns, void* user) {
  if (!system) return refused(kNoSystem);
  system->clock = {now_ns, user};
  system->system->set_clock(now_ns ? &system->clock : nullptr);
  return kDone;
}

pptam_status pptam_set_tracer(pptam_system* system, const pptam_tracer* tracer) {
  if (!system) return refused(kNoSystem);
  if (tracer && (!tracer->begin || !tracer->end || !tracer->count))
    return refused("pptam_set_tracer: a function is missing");
  if (tracer) system->tracer = pptam::c::CallbackTracer(*tracer);
  system->system->set_tracer(tracer ? &system->tracer : nullptr);
  return kDone;
}

const char* pptam_hint_text(int32_t hint) {
  switch (pptam::c::enum_from<pptam::Hint>(hint)) {
    case pptam::Hint::kNone:
      return "";
    case pptam::Hint::kTap:
      return "tap to start";
    case pptam::Hint::kHoldStill:
      return "hold still";
    case pptam::Hint::kMoveSideways:
      return "move sideways";
    case pptam::Hint::kOnlyRotating:
      return "only turning: move sideways";
    case pptam::Hint::kTooLittleTexture:
      return "too little texture";
    case pptam::Hint::kTooFast:
      return "too fast";
    case pptam::Hint::kStartLost:
      return "first view lost: start again";
    case pptam::Hint::kReturnToKnownView:
      return "go back to a known view";
  }
  return "";
}

pptam_status pptam_track(pptam_system* system, const pptam_frame* frame, pptam_track_result* result) {
  if (!result) return refused("result is null");
  pptam::TrackResult tracked;
  if (frame) tracked.timestamp_ns = frame->timestamp_ns;
  if (system && frame) {
    tracked = system->system->track(pptam::c::frame_from(*frame));
    if (tracked.status.ok()) system->points = tracked.points;
  }
  *result = pptam::c::result_to_c(tracked);
  if (!system) return refused(kNoSystem);
  return frame ? to_c(tracked.status) : refused("frame is null");
}

pptam_status pptam_observed_points(const pptam_system* system, pptam_observed_point* out, size_t capacity,
                                   int32_t* count) {
  if (!system) return refused(kNoSystem);
  if (!pptam::c::is_output(out, capacity, count)) return refused(pptam::c::kNoOutput);
  const size_t copied = std::min(capacity, system->points.size());
  for (size_t i = 0; i < copied; ++i) out[i] = pptam::c::entry_to_c(system->points[i]);
  *count = static_cast<int32_t>(system->points.size());
  return kDone;
}

bool pptam_has_work(const pptam_system* system) {
  return system && system->system->has_work();
}

pptam_status pptam_work_slice(pptam_system* system) {
  if (!system) return refused(kNoSystem);
  system->system->work_slice();
  return kDone;
}

pptam_status pptam_tap(pptam_system* system) {
  if (!system) return refused(kNoSystem);
  system->system->tap();
  return kDone;
}

pptam_status pptam_reset(pptam_system* system) {
  if (!system) return refused(kNoSystem);
  system->system->reset();
  return kDone;
}

pptam_status pptam_set_locked(pptam_system* system, bool locked) {
  if (!system) return refused(kNoSystem);
  system->system->set_locked(pptam::c::truth_from(locked));
  return kDone;
}

bool pptam_locked(const pptam_system* system) {
  return system && system->system->locked();
}

pptam_status pptam_set_length(pptam_system* system, uint32_t point_a, uint32_t point_b, float length) {
  if (!system) return refused(kNoSystem);
  return to_c(system->system->set_length(point_a, point_b, length));
}

pptam_status pptam_set_ground(pptam_system* system, const float px[2], pptam_pose* change) {
  if (!system) return refused(kNoSystem);
  if (!px) return refused(kNullPointer);
  pptam::Similarity S;
  const pptam_status status = to_c(system->system->set_ground(pptam::Vector2f(px[0], px[1]), &S));
  if (change && status.code == PPTAM_OK) *change = to_c(S.T);
  return status;
}

pptam_status pptam_project(const pptam_system* system, const pptam_pose* T_cw, const float velocity[6],
                           const float p_w[3], float px[2], bool* visible) {
  if (!system) return refused(kNoSystem);
  if (!T_cw || !velocity || !p_w || !px || !visible) return refused(kNullPointer);
  if (!pptam::c::is_motion(*T_cw)) return refused(pptam::c::kNoMotion);
  using pptam::c::all_within;
  if (!all_within(velocity, 3, pptam::c::kMostCoordinate) || !all_within(velocity + 3, 3, pptam::c::kMostRate) ||
      !all_within(p_w, 3, pptam::c::kMostCoordinate))
    return refused("pptam_project: a coordinate beyond 1e9, or a turning rate beyond 1e3 rad/s");
  pptam::PredictedPoint seen;
  *visible = system->system->config().camera.project_rolling(
      pptam::c::pose_from(*T_cw), Eigen::Map<const pptam::Vector6f>(velocity), pptam::c::vector3_from(p_w), &seen);
  if (*visible) pptam::c::numbers_to(seen.px, px);
  return kDone;
}

pptam_status pptam_unproject(const pptam_system* system, const float px[2], float ray[2]) {
  if (!system) return refused(kNoSystem);
  if (!px || !ray) return refused(kNullPointer);
  if (!pptam::c::all_within(px, 2, 1e6f)) return refused("pptam_unproject: the pixel is beyond 1e6");
  pptam::c::numbers_to(system->system->config().camera.unproject(pptam::c::vector2_from(px)), ray);
  return kDone;
}

pptam_status pptam_keyframes(const pptam_system* system, int32_t map, pptam_keyframe* out, size_t capacity,
                             int32_t* count) {
  if (!system) return refused(kNoSystem);
  return pptam::c::copy_out<pptam::KeyframeInfo>(out, capacity, count, [&](std::span<pptam::KeyframeInfo> infos) {
    return system->system->keyframes(infos, map);
  });
}

pptam_status pptam_map_points(const pptam_system* system, int32_t map, pptam_map_point* out, size_t capacity,
                              int32_t* count) {
  if (!system) return refused(kNoSystem);
  return pptam::c::copy_out<pptam::MapPointInfo>(out, capacity, count, [&](std::span<pptam::MapPointInfo> infos) {
    return system->system->map_points(infos, map);
  });
}

pptam_status pptam_measurements(const pptam_system* system, int32_t map, pptam_measurement* out, size_t capacity,
                                int32_t* count) {
  if (!system) return refused(kNoSystem);
  return pptam::c::copy_out<pptam::MeasurementInfo>(out, capacity, count, [&](std::span<pptam::MeasurementInfo> infos) {
    return system->system->measurements(infos, map);
  });
}

pptam_status pptam_planes(const pptam_system* system, int32_t map, pptam_plane* out, size_t capacity, int32_t* count) {
  if (!system) return refused(kNoSystem);
  return pptam::c::copy_out<pptam::PlaneInfo>(
      out, capacity, count, [&](std::span<pptam::PlaneInfo> infos) { return system->system->planes(infos, map); });
}

pptam_status pptam_keyframe_image(const pptam_system* system, uint32_t keyframe_id, pptam_image* image) {
  if (!system) return refused(kNoSystem);
  if (!image) return refused(kNullPointer);
  const pptam::GreyView view = system->system->keyframe_image(keyframe_id);
  if (view.empty()) return refused("pptam_keyframe_image: no keyframe has this id");
  *image = {view.data, view.width, view.height, view.stride};
  return kDone;
}

uint64_t pptam_map_hash(const pptam_system* system) {
  return system ? pptam::map_hash(*system->system) : 0;
}

pptam_status pptam_map_fit(const pptam_system* system, int32_t* measurements, float* cost) {
  if (!system) return refused(kNoSystem);
  if (!measurements || !cost) return refused(kNullPointer);
  const pptam::MapFit fit = pptam::map_fit(*system->system);
  *measurements = fit.measurements;
  *cost = fit.cost;
  return kDone;
}

pptam_status pptam_map_parts(const pptam_system* system, int32_t common_points, int32_t* parts) {
  if (!system) return refused(kNoSystem);
  if (!parts) return refused(kNullPointer);
  *parts = pptam::map_parts(*system->system, common_points);
  return kDone;
}

size_t pptam_map_bytes(const pptam_system* system) {
  return system ? system->system->map_bytes() : 0;
}

pptam_status pptam_save_map(const pptam_system* system, void* out, size_t capacity, size_t* bytes) {
  if (!system) return refused(kNoSystem);
  if (!bytes || (!out && capacity > 0)) return refused("bytes is null, or out is null and capacity is not 0");
  return to_c(system->system->save_map({static_cast<std::byte*>(out), capacity}, bytes));
}

pptam_status pptam_load_map(pptam_system* system, const void* file, size_t bytes) {
  if (!system) return refused(kNoSystem);
  if (!file && bytes > 0) return refused("file is null");
  return to_c(system->system->load_map({static_cast<const std::byte*>(file), bytes}));
}

pptam_status pptam_read_map_info(const void* file, size_t bytes, pptam_map_info* info) {
  if (!info || (!file && bytes > 0)) return refused(kNullPointer);
  pptam::MapInfo read;
  const pptam::Status status = pptam::System::map_info({static_cast<const std::byte*>(file), bytes}, &read);
  if (!status.ok()) return to_c(status);
  info->version = read.version;
  info->camera = to_c(read.camera);
  info->maps = read.maps;
  info->keyframes = read.keyframes;
  info->erased_keyframes = read.erased_keyframes;
  info->map_points = read.map_points;
  info->partial_points = read.partial_points;
  info->min_keyframes = read.min_keyframes;
  info->min_erased_keyframes = read.min_erased_keyframes;
  info->min_map_points = read.min_map_points;
  info->min_partial_points = read.min_partial_points;
  info->min_measurements = read.min_measurements;
  info->min_measurements_per_point = read.min_measurements_per_point;
  return kDone;
}

int64_t pptam_work_units(const pptam_system* system, int32_t work) {
  if (!system || work < 0 || work >= PPTAM_WORK_COUNT) return -1;
  return system->system->work_meter().units(static_cast<pptam::Work>(work));
}

int64_t pptam_work_instructions(const pptam_system* system) {
  return system ? system->system->work_meter().instructions() : -1;
}

int64_t pptam_work_ns(const pptam_system* system) {
  return system ? system->system->work_meter().modelled_ns() : -1;
}
