// Connects tracking, mapping and the map inside the caller's block of memory, and checks the caller's input.
#include <new>

#include <pocket_ptam/image.h>
#include <pocket_ptam/pocket_ptam.h>
#include "base/assert.h"
#include "map/map_access.h"
#include "map/map_file.h"
#include "mapping/mapper.h"
#include "tracking/tracker.h"

namespace pptam {

namespace {

// Bytes of all keyframes' images at level 0: 1 GB. Not swept.
constexpr int64_t kMaxImageBytes = int64_t{1} << 30;
// Keyframes counted for that bound besides live and erased ones: those of the queue and of a start, and a reserve.
constexpr int kOtherKeyframes = 16;

// Bounds of Config: the smallest pyramid level keeps 4x4 pixels, slots of points fit into int16_t, the others bound
// memory and time. Not swept.
constexpr int kMinImageSize = 64, kMaxImageSize = 4096;  // pixels
constexpr int kMinKeyframes = 3;
constexpr int kMinMapPoints = 100, kMaxMapPoints = 30000;
constexpr int kMaxPartialPoints = 30000;
constexpr int kMaxMeasurements = 1000000;
constexpr int kMaxCellsAcross = 16;  // also of the choice of points (tracking/point_selection.cpp)
constexpr int kMinMeasuredPoints = 16, kMaxMeasuredPoints = 2000;
constexpr int kMaxPartialsPerStep = 1000;  // searched in a frame, or new in a keyframe
constexpr int kMinPointsOfStart = 30, kMaxPointsOfStart = 250;
constexpr float kMaxReadout_s = 1.0f, kMaxExposure_s = 1.0f;
constexpr float kMinLength = 1e-3f, kMaxLength = 1e3f;  // world units, of a start's baseline or plane distance
constexpr float kMaxKeyframeInterval_s = 3600;
constexpr float kMaxClock_mhz = 1e5f, kMinCycles = 0.01f, kMaxCycles = 1e3f;
// Instructions of a unit, and of a frame's pixels at once: the work meter's sum holds four weeks of such frames.
constexpr float kMaxInstructions = 1e5f;
constexpr double kMaxFrameInstructions = 1e9;
// Change of scale that one set_length() may make, a ratio. Not swept.
constexpr float kMinScale = 1e-6f, kMaxScale = 1e6f;

// ARMv6 instructions a byte, for the checksum and a copy: an estimate.
constexpr int kMapFileInstructions = 8;

// One of the maps by its number, 0 for that in use. Without contents when there is none of that number.
MapAccess::Part part_of(const Map& map, int number) {
  if (number == 0 || static_cast<uint32_t>(number) == map.number()) return MapAccess::in_use(map);
  for (int place = 0; place < map.places(); ++place)
    if (map.is_aside(place) && map.number_aside(place) == static_cast<uint32_t>(number))
      return MapAccess::aside(map, place);
  return {};
}

}  // namespace

struct System::Impl {
  Impl(Arena& arena, const Config& configuration)
      : config(configuration),
        meter(config.profile),
        map(arena, config),
        map_end(arena.used()),
        corner_source(config.corner_source(arena, config, meter)),
        tracker(arena, config, map, meter, config.initialiser(arena, config, meter, corner_source)),
        tracking_end(arena.used()),
        mapper(arena, config, map, meter, corner_source) {}

  Config config;
  WorkMeter meter;
  Map map;
  size_t map_end;  // in the arena
  CornerSource* corner_source;
  Tracker tracker;
  size_t tracking_end;
  Mapper mapper;
  const Clock* clock = nullptr;
  Tracer* tracer = nullptr;
  int64_t last_timestamp_ns = INT64_MIN;
  int world_changes = 0;  // TrackResult's
};

Status Config::validate() const {
  if (!corner_source)
    return {StatusCode::kInvalidArgument, "Config::corner_source names no part: begin with Config::phone"};
  if (!initialiser)
    return {StatusCode::kInvalidArgument, "Config::initialiser names no part: begin with Config::phone"};
  if (!point_source)
    return {StatusCode::kInvalidArgument, "Config::point_source names no part: begin with Config::phone"};
  if (!culling) return {StatusCode::kInvalidArgument, "Config::culling names no part: begin with Config::phone"};
  const CameraModel& model = camera.model;
  const Status status = model.validate();
  if (!status.ok()) return status;
  if (model.width < kMinImageSize || model.height < kMinImageSize || model.width > kMaxImageSize ||
      model.height > kMaxImageSize)
    return {StatusCode::kInvalidArgument, "Config::camera: width and height must be within 64 to 4096 pixels"};
  if (!(camera.readout_s() <= kMaxReadout_s))
    return {StatusCode::kInvalidArgument,
            "Config::camera.shutter: the readout must be under 1 s; line_time_s is per line"};
  if (!(exposure_s >= 0 && exposure_s <= kMaxExposure_s))
    return {StatusCode::kInvalidArgument, "Config::exposure_s must be within 0 to 1 s"};
  if (max_keyframes < kMinKeyframes || max_keyframes > kMaxKeyframes)
    return {StatusCode::kInvalidArgument, "Config::max_keyframes must be within 3 to 1000"};
  if (max_erased_keyframes < 0 || max_erased_keyframes > kMaxKeyframes)
    return {StatusCode::kInvalidArgument, "Config::max_erased_keyframes must be within 0 to 1000"};
  if (max_maps < 1 || max_maps > kMaxMaps)
    return {StatusCode::kInvalidArgument, "Config::max_maps must be within 1 to 8"};
  if (max_map_points < kMinMapPoints || max_map_points > kMaxMapPoints)
    return {StatusCode::kInvalidArgument, "Config::max_map_points must be within 100 to 30000"};
  if (max_partial_points < 0 || max_partial_points > kMaxPartialPoints)
    return {StatusCode::kInvalidArgument, "Config::max_partial_points must be within 0 to 30000"};
  if (max_measurements_per_point < 2 || max_measurements_per_point > kMaxMeasurementsPerPoint)
    return {StatusCode::kInvalidArgument, "Config::max_measurements_per_point must be within 2 to 32"};
  if (max_measurements < 0 || max_measurements > kMaxMeasurements)
    return {StatusCode::kInvalidArgument, "Config::max_measurements must be within 0 to 1000000"};
  if (cells_x < 1 || cells_y < 1 || cells_x > kMaxCellsAcross || cells_y > kMaxCellsAcross)
    return {StatusCode::kInvalidArgument, "Config::cells_x and cells_y must be within 1 to 16"};
  if (search_level < 0 || search_level >= kPyramidLevels || coarse_search_level < search_level ||
      coarse_search_level >= kPyramidLevels)
    return {StatusCode::kInvalidArgument,
            "Config::search_level and coarse_search_level must be within 0 to 4, the latter not the finer one"};
  if (max_measured_points < kMinMeasuredPoints || max_measured_points > kMaxMeasuredPoints)
    return {StatusCode::kInvalidArgument, "Config::max_measured_points must be within 16 to 2000"};
  if (max_coarse_points < 0 || max_coarse_points > max_measured_points)
    return {StatusCode::kInvalidArgument, "Config::max_coarse_points must be within 0 to max_measured_points"};
  if (max_partial_searches < 0 || max_partial_searches > kMaxPartialsPerStep || max_new_partial_points < 0 ||
      max_new_partial_points > kMaxPartialsPerStep)
    return {StatusCode::kInvalidArgument, "Config: the partial points' limits must be within 0 to 1000"};
  if (max_initial_points < kMinPointsOfStart || max_initial_points > kMaxPointsOfStart)
    return {StatusCode::kInvalidArgument, "Config::max_initial_points must be within 30 to 250"};
  if (!(initial_baseline > kMinLength && initial_baseline < kMaxLength))
    return {StatusCode::kInvalidArgument, "Config::initial_baseline must be within 0.001 to 1000"};
  if (!(initial_plane_distance == 0 || (initial_plane_distance > kMinLength && initial_plane_distance < kMaxLength)))
    return {StatusCode::kInvalidArgument, "Config::initial_plane_distance must be 0 or within 0.001 to 1000"};
  if (!(min_keyframe_interval_s >= 0 && min_keyframe_interval_s < kMaxKeyframeInterval_s))
    return {StatusCode::kInvalidArgument, "Config::min_keyframe_interval_s must be within 0 to 3600 s"};
  if (static_cast<int64_t>(model.width) * model.height * (max_keyframes + max_erased_keyframes + kOtherKeyframes) >
      kMaxImageBytes)
    return {StatusCode::kInvalidArgument,
            "Config: max_keyframes and max_erased_keyframes of this size need over 1 GB: lower one of them"};
  if (!(profile.clock_mhz >= 1 && profile.clock_mhz <= kMaxClock_mhz) ||
      !(profile.cycles_per_instruction >= kMinCycles && profile.cycles_per_instruction <= kMaxCycles))
    return {StatusCode::kInvalidArgument, "Config::profile: clock or cycles per instruction is absurd"};
  for (const float instructions : profile.instructions)
    if (!(instructions >= 0 && instructions <= kMaxInstructions))
      return {StatusCode::kInvalidArgument, "Config::profile: instructions per unit must be within 0 to 1e5"};
  for (const Work of_pixel : {Work::kGreyPixel, Work::kPyramidPixel, Work::kKeyframePixel})
    if (static_cast<double>(profile.instructions[static_cast<size_t>(of_pixel)]) * model.width * model.height >
        kMaxFrameInstructions)
      return {StatusCode::kInvalidArgument, "Config::profile: a frame's pixels take over 1e9 instructions"};
  return {};
}

size_t System::required_bytes(const Config& config) {
  const MemoryParts parts = required_parts(config);
  return parts.map + parts.tracking + parts.mapping + parts.rest;
}

MemoryParts System::required_parts(const Config& config) {
  MemoryParts parts;
  if (!config.validate().ok()) return parts;
  Arena arena;  // measures only
  arena.allocate(sizeof(System));
  arena.allocate(sizeof(Impl));
  parts.rest = arena.used();
  const Impl impl(arena, config);
  parts.map = impl.map_end - parts.rest;
  parts.tracking = impl.tracking_end - impl.map_end;
  parts.mapping = arena.used() - impl.tracking_end;
  return parts;
}

Status System::create(const Config& config, std::span<std::byte> memory, System** system) {
  const Status status = config.validate();
  if (!status.ok()) return status;
  if (reinterpret_cast<uintptr_t>(memory.data()) % Arena::kAlignment != 0)
    return {StatusCode::kInvalidArgument,
            "System::create: memory must be aligned as by malloc (alignof(std::max_align_t))"};
  if (memory.size() < required_bytes(config))
    return {StatusCode::kOutOfMemory, "System::create: memory is smaller than System::required_bytes(config)"};
  Config prepared = config;
  prepared.camera.model.prepare();
  Arena arena(memory);
  void* place = arena.allocate(sizeof(System));
  void* impl_place = arena.allocate(sizeof(Impl));
  Impl* const impl = new (impl_place) Impl(arena, prepared);
  if (arena.overflowed())
    return {StatusCode::kOutOfMemory, "System::create: a part of Config takes more memory than when it was measured"};
  *system = new (place) System(impl);
  return {};
}

void System::set_clock(const Clock* clock) {
  impl_->clock = clock;
}

void System::set_tracer(Tracer* tracer) {
  impl_->tracer = tracer;
}

TrackResult System::track(const Frame& frame) {
  TrackResult refused;
  refused.timestamp_ns = frame.timestamp_ns;
  refused.status = validate_frame(frame);
  const CameraModel& model = impl_->config.camera.model;
  if (refused.status.ok() && (frame.width != model.width || frame.height != model.height))
    refused.status = {StatusCode::kInvalidArgument, "track: the frame's size differs from Config::camera's"};
  if (refused.status.ok() && frame.timestamp_ns <= impl_->last_timestamp_ns)
    refused.status = {StatusCode::kTimeWentBackwards, "track: the timestamp is not later than the last frame's"};
  if (!refused.status.ok()) return refused;
  impl_->last_timestamp_ns = frame.timestamp_ns;
  Tracer* const tracer = impl_->tracer;
  if (tracer) tracer->begin(Span::kFrame);
  TrackResult result = impl_->tracker.track(frame, impl_->clock, tracer);
  result.world_changes = impl_->world_changes;
  if (!tracer) return result;
  tracer->end(Span::kFrame);
  tracer->count(Counter::kKeyframes, result.keyframes);
  tracer->count(Counter::kMapPoints, result.map_points);
  tracer->count(Counter::kInliers, result.points_inliers);
  tracer->count(Counter::kQuality, static_cast<int64_t>(result.quality));
  return result;
}

bool System::has_work() const {
  return impl_->mapper.has_work();
}
void System::work_slice() {
  impl_->mapper.work_slice(impl_->tracer);
}
void System::tap() {
  impl_->tracker.tap();
}
void System::reset() {
  impl_->tracker.reset();
}

Status System::set_length(uint32_t point_a, uint32_t point_b, float length) {
  Map& map = impl_->map;
  if (!map.ready()) return {StatusCode::kNotReady, "set_length: there is no map yet"};
  const MapPoint* a = nullptr;
  const MapPoint* b = nullptr;
  for (const MapPoint& point : map.points()) {
    if (point.id == 0) continue;
    if (point.id == point_a) a = &point;
    if (point.id == point_b) b = &point;
  }
  if (!a || !b) return {StatusCode::kInvalidArgument, "set_length: a map point with this id does not exist"};
  const float scale = length / (a->p_w - b->p_w).norm();
  if (!(scale > kMinScale && scale < kMaxScale))  // refuses NaN, and the same point twice
    return {StatusCode::kInvalidArgument, "set_length: the length must be within 1e-6 to 1e6 times the present one"};
  if (!map.can_change_scale(scale))
    return {StatusCode::kInvalidArgument,
            "set_length: the whole map would become too large or too small to be usable: choose another unit"};
  Similarity S;
  S.scale = scale;
  map.change_coordinates(S);
  impl_->tracker.follow_map();
  ++impl_->world_changes;
  return {};
}

Status System::set_ground(const Vector2f& px, Similarity* change) {
  SE3 T_cw;
  if (!impl_->map.ready() || !impl_->tracker.last_pose(px, &T_cw))
    return {StatusCode::kNotReady, "set_ground: the last frame has no pose in a finished map"};
  const Status status = impl_->mapper.ground().choose(T_cw, px, change);
  if (!status.ok()) return status;
  impl_->tracker.follow_map();
  ++impl_->world_changes;
  return status;
}

int System::planes(std::span<PlaneInfo> out, int map) const {
  const MapAccess::Part part = part_of(impl_->map, map);
  // While a new map is being finished its ground is sought, also while another one is looked at.
  const bool seeking = impl_->map.looking() || (impl_->map.exists() && !impl_->map.ready());
  if (!part.keyframes || part.keyframes->empty() || seeking) return 0;
  return impl_->mapper.ground().planes(part, out);
}

size_t System::map_bytes() const {
  const Map& map = impl_->map;
  return map.ready() || map.aside_count() > 0 ? map_file_bytes(map, impl_->config) : 0;
}

Status System::save_map(std::span<std::byte> out, size_t* bytes) const {
  const size_t needed = map_bytes();
  if (needed == 0) return {StatusCode::kNotReady, "save_map: there is no finished map yet"};
  if (out.size() < needed) return {StatusCode::kOutOfMemory, "save_map: out is smaller than map_bytes()"};
  write_map_file(impl_->map, impl_->config, out.first(needed));
  impl_->meter.charge(Work::kOther, static_cast<int64_t>(2 * needed) * kMapFileInstructions);
  // Checked by the reader's rules, so that a map that was saved can be loaded.
  const Status status = check_map_file(out.first(needed), impl_->config);
  if (status.ok()) *bytes = needed;
  return status;
}

Status System::map_info(std::span<const std::byte> file, MapInfo* info) {
  return read_map_info(file, info);
}

Status System::load_map(std::span<const std::byte> file) {
  impl_->meter.charge(Work::kOther, static_cast<int64_t>(file.size()) * kMapFileInstructions);
  const Status status = check_map_file(file, impl_->config);
  if (!status.ok()) return status;
  impl_->tracker.reset();
  read_map_file(file, impl_->config, impl_->map);
  impl_->tracker.begin_lost();
  const CameraModel& model = impl_->config.camera.model;
  // Levels 1 to 4 of a keyframe have a third of level 0's pixels.
  impl_->meter.charge(Work::kPyramidPixel,
                      static_cast<int64_t>(model.width) * model.height / 3 * impl_->map.keyframes().size());
  return {};
}

void System::set_locked(bool locked) {
  impl_->map.set_locked(locked);
}
bool System::locked() const {
  return impl_->map.locked();
}

int System::keyframes(std::span<KeyframeInfo> out, int map) const {
  const MapAccess::Part part = part_of(impl_->map, map);
  if (!part.keyframes) return 0;
  int count = 0;
  for (uint32_t last_id = 0;; ++count) {
    const Keyframe* next = nullptr;  // by ascending id: slots are used again and are not in that order
    for (const Keyframe& keyframe : *part.keyframes)
      if (keyframe.live() && keyframe.id > last_id && (!next || keyframe.id < next->id)) next = &keyframe;
    if (!next) return count;
    if (count < static_cast<int>(out.size())) out[count] = {next->id, next->timestamp_ns, next->T_kw};
    last_id = next->id;
  }
}

int System::map_points(std::span<MapPointInfo> out, int map) const {
  const MapAccess::Part part = part_of(impl_->map, map);
  if (!part.points) return 0;
  int count = 0;
  for (const MapPoint& point : *part.points) {
    if (point.id == 0) continue;
    if (count < static_cast<int>(out.size())) {
      const Keyframe& source = (*part.keyframes)[point.source.keyframe];
      MapPointInfo& info = out[count];
      info.id = point.id;
      info.p_w = point.p_w;
      info.normal_w = source.T_kw.R.transpose() * point.source.normal;
      info.measurements = point.measurements.size();
      info.grey = source.pyramid.level[0].at(static_cast<int>(point.source.px.x() + 0.5f),
                                             static_cast<int>(point.source.px.y() + 0.5f));
    }
    ++count;
  }
  return count;
}

int System::measurements(std::span<MeasurementInfo> out, int map) const {
  const MapAccess::Part part = part_of(impl_->map, map);
  if (!part.points) return 0;
  const Camera& camera = impl_->config.camera;
  int count = 0;
  for (const MapPoint& point : *part.points) {
    if (point.id == 0) continue;
    for (const Measurement& m : impl_->map.measurements(point)) {
      if (count < static_cast<int>(out.size())) {
        const Keyframe& keyframe = (*part.keyframes)[m.keyframe];
        const Vector2f global_px = camera.global_shutter_px(keyframe.velocity, keyframe.T_kw * point.p_w, m.at.px);
        out[count] = {point.id, keyframe.id, m.at.px, global_px, m.at.sigma()};
      }
      ++count;
    }
  }
  return count;
}

GreyView System::keyframe_image(uint32_t id) const {
  const Map& map = impl_->map;
  for (const Keyframe& keyframe : map.keyframes())
    if (id != 0 && keyframe.id == id) return keyframe.pyramid.level[0];
  for (int place = 0; place < map.places(); ++place)
    for (const Keyframe& keyframe : map.keyframes_aside(place))
      if (id != 0 && keyframe.id == id) return keyframe.pyramid.level[0];
  return {};
}

const Config& System::config() const {
  return impl_->config;
}
const WorkMeter& System::work_meter() const {
  return impl_->meter;
}
const Map& System::map() const {
  return impl_->map;
}

}  // namespace pptam
