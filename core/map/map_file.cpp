#include "map/map_file.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>

#include "base/assert.h"
#include "image/shrink.h"
#include "map/map_access.h"

namespace pptam {

namespace {

// The format of map_file.h: changing one of these makes files of another version. Sizes are in bytes.
constexpr char kMagic[] = "PPTAMMAP";
constexpr size_t kMagicBytes = 8;
constexpr uint32_t kVersion = 3;
constexpr uint32_t kUsualLevel = 1;  // of a patch: 0 in the file, as before patches had levels
constexpr size_t kHeaderBytes = 92;
constexpr uint32_t kMaxNumber = 1u << 30;  // of a map: many more can follow in an int32_t
constexpr size_t kCountsBytes = 40;        // of each map, behind the header
constexpr size_t kKeyframeBytes = 120;     // without its image and, if it was erased, its anchor
constexpr size_t kPointBytes = 52;         // without its measurements
constexpr size_t kMeasurementBytes = 20;
constexpr size_t kPartialBytes = 44;
constexpr size_t kCrcBytes = 4;

constexpr uint32_t kErasedFlag = 1;  // bit of a keyframe's flags
// Error of the products of a rotation's rows, and of a normal's squared length: a thousand times float32's rounding, a
// hundred times what a map ever shows.
constexpr float kUnitTolerance = 1e-4f;
// Between the camera of a map and the same one at another image size. Calibrations are printed with four digits or
// more; half a pixel lies between those who scale the principal point with the pixels' edges and those who do not.
constexpr float kMaxFocalDifference = 2e-4f;  // relative
constexpr float kMaxCentreDifference_px = 0.5f;
constexpr float kMaxReadoutDifference = 1e-3f;  // relative
constexpr float kMaxLineTime_s = 1;             // the exact bound is Config::validate()'s, on the whole readout
constexpr uint32_t kCrcPolynomial = 0xEDB88320u;

Status refused(const char* message) {
  return {StatusCode::kBadFile, message};
}
Status mismatch(const char* message) {
  return {StatusCode::kConfigMismatch, message};
}

constexpr std::array<uint32_t, 256> make_crc_table() {
  std::array<uint32_t, 256> table = {};
  for (uint32_t i = 0; i < 256; ++i) {
    uint32_t value = i;
    for (int bit = 0; bit < 8; ++bit) value = (value >> 1) ^ ((value & 1) != 0 ? kCrcPolynomial : 0u);
    table[i] = value;
  }
  return table;
}
constexpr std::array<uint32_t, 256> kCrcTable = make_crc_table();

// Writes into a span, or only counts when there is none.
class Writer {
 public:
  explicit Writer(std::span<std::byte> out) : out_(out) {}
  void bytes(const void* data, size_t count) {
    if (!out_.empty()) std::memcpy(out_.data() + used_, data, count);
    used_ += count;
  }
  template <class T>
  void integer(T value) {
    uint8_t little[sizeof(T)];
    for (size_t i = 0; i < sizeof(T); ++i) little[i] = static_cast<uint8_t>(static_cast<uint64_t>(value) >> (8 * i));
    bytes(little, sizeof(T));
  }
  void u16(uint16_t value) { integer(value); }
  void u32(uint32_t value) { integer(value); }
  void u64(uint64_t value) { integer(value); }
  void f32(float value) { u32(std::bit_cast<uint32_t>(value)); }
  template <class Vector>
  void vector(const Vector& values) {
    for (int i = 0; i < values.size(); ++i) f32(values[i]);
  }
  size_t used() const { return used_; }

 private:
  std::span<std::byte> out_;
  size_t used_ = 0;
};

// Reads out of a span. Past its end every value read is zero, and failed() is true.
class Reader {
 public:
  explicit Reader(std::span<const std::byte> in) : in_(in) {}
  std::span<const std::byte> bytes(size_t count) {
    if (count > left()) {
      failed_ = true;
      return {};
    }
    const std::span<const std::byte> part = in_.subspan(used_, count);
    used_ += count;
    return part;
  }
  template <class T>
  T integer() {
    const std::span<const std::byte> little = bytes(sizeof(T));
    uint64_t value = 0;
    for (size_t i = 0; i < little.size(); ++i) value |= static_cast<uint64_t>(little[i]) << (8 * i);
    return static_cast<T>(value);
  }
  uint16_t u16() { return integer<uint16_t>(); }
  uint32_t u32() { return integer<uint32_t>(); }
  uint64_t u64() { return integer<uint64_t>(); }
  float f32() { return std::bit_cast<float>(u32()); }
  template <class Vector>
  void vector(Vector* values) {
    for (int i = 0; i < values->size(); ++i) (*values)[i] = f32();
  }
  size_t left() const { return in_.size() - used_; }
  bool failed() const { return failed_; }

 private:
  std::span<const std::byte> in_;
  size_t used_ = 0;
  bool failed_ = false;
};

bool within(float value, float least, float most) {  // false for NaN
  return value >= least && value <= most;
}

template <class Vector>
bool small_enough(const Vector& values) {
  for (int i = 0; i < values.size(); ++i)
    if (!within(values[i], -kMaxInMap, kMaxInMap)) return false;
  return true;
}

bool is_rotation(const Matrix3f& R) {
  if (!small_enough(R.reshaped())) return false;
  const Matrix3f error = R * R.transpose() - Matrix3f::Identity();
  return error.cwiseAbs().maxCoeff() < kUnitTolerance && R.row(0).cross(R.row(1)).dot(R.row(2)) > 0;
}

struct Count {  // slots up to the last used one, and entries, of one kind
  uint32_t slots = 0, entries = 0;
};
template <class Slots>
Count count(const Slots& slots) {
  Count result;
  for (int i = 0; i < slots.size(); ++i) {
    if (slots[i].id == 0) continue;
    result.slots = static_cast<uint32_t>(i + 1);
    ++result.entries;
  }
  return result;
}

// Of one map.
struct Counts {
  uint32_t number = 0;
  Count keyframes, points, partial_points;
  uint32_t erased = 0;                             // of the keyframes
  uint32_t measurements = 0, most_of_a_point = 0;  // of all points; of the point that has the most

  uint32_t live() const { return keyframes.entries - erased; }
  // Measurements beyond two of each point: they take shared places.
  int64_t shared_measurements() const { return int64_t{measurements} - 2 * int64_t{points.entries}; }
};

struct Header {
  uint32_t version = 0;
  uint32_t flags = 0;
  uint64_t bytes = 0;
  Camera camera;
  uint32_t next_id = 0, last_number = 0;
  uint32_t maps = 0;
  std::array<Counts, kMaxMaps> counts = {};  // the first `maps` of them

  std::span<const Counts> all() const { return {counts.data(), maps}; }
};

void write_header(const Header& header, Writer* out) {
  out->bytes(kMagic, kMagicBytes);
  out->u32(header.version);
  out->u32(header.flags);
  out->u64(header.bytes);
  const CameraModel& camera = header.camera.model;
  out->u32(static_cast<uint32_t>(camera.width));
  out->u32(static_cast<uint32_t>(camera.height));
  for (const float value : {camera.fx, camera.fy, camera.cx, camera.cy}) out->f32(value);
  out->u32(static_cast<uint32_t>(camera.distortion));
  for (const float value : camera.coeffs) out->f32(value);
  out->u32(static_cast<uint32_t>(header.camera.shutter.axis));
  out->f32(header.camera.shutter.line_time_s);
  out->u32(header.next_id);
  out->u32(header.last_number);
  out->u32(header.maps);
  for (const Counts& counts : header.all()) {
    out->u32(counts.number);
    for (const Count& counted : {counts.keyframes, counts.points, counts.partial_points}) {
      out->u32(counted.slots);
      out->u32(counted.entries);
    }
    out->u32(counts.erased);
    out->u32(counts.measurements);
    out->u32(counts.most_of_a_point);
  }
}

// Entries must fit into the file's size, so that no reader trusts a count that is impossible.
Status check_counts(const Header& header, uint32_t width, uint32_t height) {
  uint64_t least = kHeaderBytes + header.maps * kCountsBytes + kCrcBytes;
  bool possible = true;
  for (const Counts& counts : header.all()) {
    least += counts.keyframes.entries * (kKeyframeBytes + uint64_t{width} * height);
    least += uint64_t{counts.points.entries} * kPointBytes;
    least += uint64_t{counts.measurements} * kMeasurementBytes;
    least += uint64_t{counts.partial_points.entries} * kPartialBytes;
    if (counts.most_of_a_point > kMaxMeasurementsPerPoint + 1)
      return refused("a map point has more measurements than any configuration allows");
    if (counts.shared_measurements() < 0) return refused("the map's counts do not fit its measurements");
    possible = possible && counts.erased < counts.keyframes.entries;
    for (const Count& counted : {counts.keyframes, counts.points, counts.partial_points})
      possible = possible && counted.entries <= counted.slots && counted.slots <= INT16_MAX;
    bool distinct = counts.number >= 1 && counts.number <= header.last_number;
    for (const Counts& other : header.all())
      distinct = distinct && (&other == &counts || other.number != counts.number);
    if (!distinct) return refused("the maps of the file have impossible numbers");
  }
  if (header.last_number > kMaxNumber) return refused("the maps of the file have impossible numbers");
  if (!possible || least > header.bytes) return refused("the map's counts do not fit its size");
  return {};
}

enum class Checksum { kCheck, kChecked };

// The header and the checksum of the whole.
Status read_header(std::span<const std::byte> file, Checksum checksum, Header* header) {
  if (file.size() < kMagicBytes || std::memcmp(file.data(), kMagic, kMagicBytes) != 0)
    return refused("this is not a map saved by Pocket PTAM");
  Reader in(file.subspan(kMagicBytes));
  header->version = in.u32();
  header->flags = in.u32();
  if (in.failed() || file.size() < kHeaderBytes + kCrcBytes)
    return refused("the map is cut off within its header: take another copy of the file");
  if (header->version != kVersion)
    return refused("the map has a version that this program does not know: use the program that saved it");
  const uint32_t maps = Reader(file.subspan(kHeaderBytes - sizeof(uint32_t))).u32();
  if (maps < 1 || maps > kMaxMaps) return refused("the file holds no map, or more than any configuration allows");
  if (file.size() < kHeaderBytes + maps * kCountsBytes + kCrcBytes)
    return refused("the map is cut off within its header: take another copy of the file");
  header->bytes = in.u64();
  if (file.size() < header->bytes) return refused("the map is cut off: take another copy of the file");
  if (file.size() > header->bytes)
    return refused("the file is longer than the map that it begins with: take another copy of it");
  const std::span<const std::byte> checked = file.first(file.size() - kCrcBytes);
  if (checksum == Checksum::kCheck && Reader(file.last(kCrcBytes)).u32() != crc32(checked))
    return refused("the map's checksum is wrong, the file is damaged: take another copy of it");
  if (header->flags != 0) return refused("the map's header has flags that this program does not know");
  CameraModel& camera = header->camera.model;
  const uint32_t width = in.u32(), height = in.u32();
  for (float* value : {&camera.fx, &camera.fy, &camera.cx, &camera.cy}) *value = in.f32();
  const uint32_t distortion = in.u32();
  for (float& value : camera.coeffs) value = in.f32();
  const uint32_t axis = in.u32();
  header->camera.shutter.line_time_s = in.f32();
  header->next_id = in.u32();
  header->last_number = in.u32();
  header->maps = in.u32();
  for (uint32_t i = 0; i < header->maps; ++i) {
    Counts& counts = header->counts[i];
    counts.number = in.u32();
    for (Count* counted : {&counts.keyframes, &counts.points, &counts.partial_points}) {
      counted->slots = in.u32();
      counted->entries = in.u32();
    }
    counts.erased = in.u32();
    counts.measurements = in.u32();
    counts.most_of_a_point = in.u32();
  }
  if (width > INT16_MAX || height > INT16_MAX || distortion > static_cast<uint32_t>(Distortion::kEquidistant) ||
      axis > static_cast<uint32_t>(RollingShutter::Axis::kColumns) ||
      !within(header->camera.shutter.line_time_s, -kMaxLineTime_s, kMaxLineTime_s))
    return refused("the map's camera is nonsense");
  camera.width = static_cast<int>(width);
  camera.height = static_cast<int>(height);
  camera.distortion = static_cast<Distortion>(distortion);
  header->camera.shutter.axis = static_cast<RollingShutter::Axis>(axis);
  const Status status = camera.validate();
  if (!status.ok()) return refused(status.message());
  return check_counts(*header, width, height);
}

// Equal bits: -0 differs from 0.
bool same(float a, float b) {
  return std::bit_cast<uint32_t>(a) == std::bit_cast<uint32_t>(b);
}
bool same(const CameraModel& a, const CameraModel& b) {
  bool equal = same(a.fx, b.fx) && same(a.fy, b.fy) && same(a.cx, b.cx) && same(a.cy, b.cy);
  for (size_t i = 0; i < std::size(a.coeffs); ++i) equal = equal && same(a.coeffs[i], b.coeffs[i]);
  return equal && a.distortion == b.distortion;
}

bool close(float a, float b, float relative) {
  return std::abs(a - b) <= relative * std::abs(b);  // false for NaN
}

// From pixels of the map's images to those of the camera that loads it.
struct ImageScale {
  float x = 1, y = 1;  // at most 1
  int levels = 0;      // a measurement's pyramid level is so much lower
  bool is_one() const { return x == 1 && y == 1; }
  Vector2f operator()(const Vector2f& px) const { return {(px.x() + 0.5f) * x - 0.5f, (px.y() + 0.5f) * y - 0.5f}; }
};

ImageScale image_scale(const CameraModel& made, const CameraModel& given) {
  ImageScale scale;
  scale.x = static_cast<float>(given.width) / static_cast<float>(made.width);
  scale.y = static_cast<float>(given.height) / static_cast<float>(made.height);
  float larger = std::max(scale.x, scale.y);
  for (; larger < 0.7071f; larger *= 2) ++scale.levels;  // to the nearest level
  return scale;
}

// Is `given` the camera `made` with its images made smaller, and nothing else?
bool differs_in_size_only(const CameraModel& made, const CameraModel& given) {
  const ImageScale scale = image_scale(made, given);
  bool equal = made.distortion == given.distortion && close(made.fx * scale.x, given.fx, kMaxFocalDifference) &&
               close(made.fy * scale.y, given.fy, kMaxFocalDifference);
  for (size_t i = 0; i < std::size(made.coeffs); ++i) equal = equal && same(made.coeffs[i], given.coeffs[i]);
  const Vector2f centre = scale({made.cx, made.cy});
  return equal && std::abs(centre.x() - given.cx) <= kMaxCentreDifference_px &&
         std::abs(centre.y() - given.cy) <= kMaxCentreDifference_px;
}

Status check_camera(const Camera& made_by, const Camera& given_by) {
  const CameraModel &made = made_by.model, &given = given_by.model;
  if (made.width < given.width || made.height < given.height)
    return mismatch(
        "the map was made with smaller images than Config::camera's: make the camera's images as small as the map's");
  const bool same_size = made.width == given.width && made.height == given.height;
  if (!(same_size ? same(made, given) : differs_in_size_only(made, given)))
    return mismatch(
        "the map was made with another camera: focal length, principal point or distortion differ from "
        "Config::camera by more than the image's size");
  const bool same_shutter =
      same_size ? same(made_by.shutter.line_time_s, given_by.shutter.line_time_s)
                : close(made_by.readout_s(), given_by.readout_s(), kMaxReadoutDifference) &&
                      std::signbit(made_by.shutter.line_time_s) == std::signbit(given_by.shutter.line_time_s);
  if (!same_shutter || made_by.shutter.axis != given_by.shutter.axis)
    return mismatch("the map was made with another rolling shutter than Config::camera's");
  return {};
}

Status check_fit(const Header& header, const Config& config) {
  const Status status = check_camera(header.camera, config.camera);
  if (!status.ok()) return status;
  if (header.maps > static_cast<uint32_t>(config.max_maps))
    return mismatch("the file has more maps than Config::max_maps: raise it");
  const auto slots = static_cast<uint32_t>(keyframe_slots(config.max_keyframes, config.max_erased_keyframes));
  uint32_t images = 0;
  int64_t shared = 0;
  for (const Counts& counts : header.all()) {
    images += counts.keyframes.entries;
    shared += counts.shared_measurements();
    // One more live or erased keyframe than Config allows: a map may be saved while culling decides.
    if (counts.live() > static_cast<uint32_t>(config.max_keyframes + 1))
      return mismatch("the map has more keyframes than Config::max_keyframes: raise it");
    if (counts.erased > static_cast<uint32_t>(config.max_erased_keyframes + 1) || counts.keyframes.slots > slots)
      return mismatch("the map has more erased keyframes than Config::max_erased_keyframes: raise it");
    if (counts.points.slots > static_cast<uint32_t>(config.max_map_points))
      return mismatch("the map has more map points than Config::max_map_points: raise it");
    // One more measurement than Config allows: a map may be saved before culling has judged it.
    if (counts.most_of_a_point > static_cast<uint32_t>(config.max_measurements_per_point + 1))
      return mismatch("a map point has more measurements than Config::max_measurements_per_point: raise it");
    if (counts.partial_points.slots > static_cast<uint32_t>(config.max_partial_points))
      return mismatch("the map has more partial points than Config::max_partial_points: raise it");
  }
  if (images > slots)
    return mismatch(
        "the maps have more keyframes in all than Config::max_keyframes and max_erased_keyframes: raise one");
  if (shared > config.max_measurements)
    return mismatch("the map has more measurements than Config::max_measurements: raise it");
  return {};
}

void write_source(const PatchSource& source, Writer* out) {
  out->u16(static_cast<uint16_t>(source.keyframe));
  out->u16(static_cast<uint16_t>(source.level ^ kUsualLevel));
  out->vector(source.px);
  out->vector(source.normal);
}

void write_pose(const SE3& T, Writer* out) {
  for (int i = 0; i < 9; ++i) out->f32(T.R(i / 3, i % 3));
  out->vector(T.t);
}

void write_keyframe(int slot, const Keyframe& keyframe, Writer* out) {
  out->u32(static_cast<uint32_t>(slot));
  out->u32(keyframe.id);
  out->u32(keyframe.erased ? kErasedFlag : 0);
  out->u64(static_cast<uint64_t>(keyframe.timestamp_ns));
  write_pose(keyframe.T_kw, out);
  out->vector(keyframe.velocity);
  out->vector(keyframe.velocity_prior);
  out->f32(keyframe.mean_depth);
  if (keyframe.erased) {
    out->u32(static_cast<uint32_t>(keyframe.anchor));
    write_pose(keyframe.T_anchor, out);
  }
  const GreyView& image = keyframe.pyramid.level[0];
  for (int y = 0; y < image.height; ++y) out->bytes(image.row(y), static_cast<size_t>(image.width));
}

void write_point(const Map& map, int slot, const MapPoint& point, Writer* out) {
  out->u32(static_cast<uint32_t>(slot));
  out->u32(point.id);
  out->vector(point.p_w);
  write_source(point.source, out);
  out->u16(point.attempts);
  out->u16(point.found);
  out->u32(static_cast<uint32_t>(point.measurements.size()));
  for (const Measurement& m : map.measurements(point)) {
    out->u32(static_cast<uint32_t>(m.keyframe));
    out->vector(m.at.px);
    out->u32(m.at.level);
    out->f32(m.weight);
  }
}

void write_partial_point(int slot, const PartialPoint& partial, Writer* out) {
  out->u32(static_cast<uint32_t>(slot));
  out->u32(partial.id);
  write_source(partial.source, out);
  out->f32(partial.inverse_depth);
  out->f32(partial.information);
  out->u16(partial.attempts);
  out->u16(partial.found);
}

template <class Slots, class Write>
void write_entries(const Slots& slots, Write&& write, Writer* out) {
  for (int i = 0; i < slots.size(); ++i)
    if (slots[i].id != 0) write(i, slots[i], out);
}

// The finished maps, that in use first.
struct Maps {
  std::array<MapAccess::Part, kMaxMaps> parts = {};
  size_t count = 0;
  std::span<const MapAccess::Part> all() const { return {parts.data(), count}; }
};
Maps finished_maps(const Map& map) {
  Maps maps;
  if (map.ready()) maps.parts[maps.count++] = MapAccess::in_use(map);
  for (int i = 0; i < map.places(); ++i)
    if (map.is_aside(i)) maps.parts[maps.count++] = MapAccess::aside(map, i);
  return maps;
}

Counts counts_of(const MapAccess::Part& part) {
  Counts counts;
  counts.number = part.number;
  counts.keyframes = count(*part.keyframes);
  counts.points = count(*part.points);
  counts.partial_points = count(*part.partial_points);
  for (const Keyframe& keyframe : *part.keyframes) counts.erased += keyframe.id != 0 && keyframe.erased;
  for (const MapPoint& point : *part.points) {
    if (point.id == 0) continue;
    const auto measurements = static_cast<uint32_t>(point.measurements.size());
    counts.measurements += measurements;
    counts.most_of_a_point = std::max(counts.most_of_a_point, measurements);
  }
  return counts;
}

size_t write(const Map& map, const Config& config, uint64_t bytes, std::span<std::byte> out) {
  const Maps maps = finished_maps(map);
  Header header;
  header.version = kVersion;
  header.bytes = bytes;
  header.camera = config.camera;
  header.next_id = MapAccess::next_id(map);
  header.last_number = MapAccess::last_number(map);
  header.maps = static_cast<uint32_t>(maps.count);
  for (size_t i = 0; i < maps.count; ++i) header.counts[i] = counts_of(maps.parts[i]);
  Writer writer(out);
  write_header(header, &writer);
  for (const MapAccess::Part& part : maps.all()) {
    write_entries(*part.keyframes, write_keyframe, &writer);
    write_entries(
        *part.points, [&map](int slot, const MapPoint& point, Writer* to) { write_point(map, slot, point, to); },
        &writer);
    write_entries(*part.partial_points, write_partial_point, &writer);
  }
  writer.u32(out.empty() ? 0 : crc32(out.first(writer.used())));
  return writer.used();
}

// Reads and checks all that follows the header. Puts it into a map when there is one, which holds nothing.
class Body {
 public:
  Body(std::span<const std::byte> file, const Header& header, const Config& config)
      : in_(file.subspan(size_before(header), file.size() - size_before(header) - kCrcBytes)),
        header_(header),
        config_(config),
        scale_(image_scale(header.camera.model, config.camera.model)) {}

  Status read(Map* map_or_null) {
    map_ = map_or_null;
    for (uint32_t i = 0; i < header_.maps; ++i) {
      if (map_ && i > 0) map_->exchange(static_cast<int>(i) - 1);
      const Status status = read_one(header_.counts[i]);
      if (!status.ok()) return status;
      if (map_ && i > 0) map_->exchange(static_cast<int>(i) - 1);
    }
    if (in_.failed() || in_.left() != 0) return refused("the map's entries do not fill the file");
    return {};
  }

 private:
  static size_t size_before(const Header& header) { return kHeaderBytes + header.maps * kCountsBytes; }

  // One map, into the one in use.
  Status read_one(const Counts& counts) {
    counts_ = counts;
    measurements_ = most_of_a_point_ = 0;
    slots_ = {};
    if (map_) {
      MapAccess::resize_keyframes(*map_, static_cast<int>(counts_.keyframes.slots));
      for (int i = 0; i < map_->keyframes().size(); ++i) MapAccess::keyframe(*map_, i).id = 0;
    }
    Status status = read_entries(counts_.keyframes, &Body::read_keyframe);
    if (status.ok()) status = check_anchors();
    if (status.ok()) status = read_entries(counts_.points, &Body::read_point);
    if (status.ok()) status = read_entries(counts_.partial_points, &Body::read_partial_point);
    if (!status.ok()) return status;
    if (measurements_ != counts_.measurements || most_of_a_point_ != counts_.most_of_a_point)
      return refused("the map's counts do not fit its measurements");
    if (!map_) return {};
    map_->finish();
    MapAccess::set_numbers(*map_, counts_.number, header_.last_number);
    return {};
  }

  Status read_entries(const Count& counted, Status (Body::*read_entry)(int slot, uint32_t id)) {
    int64_t last_slot = -1;
    for (uint32_t i = 0; i < counted.entries; ++i) {
      const uint32_t slot = in_.u32(), id = in_.u32();
      if (in_.failed() || slot <= last_slot || slot >= counted.slots)
        return refused("the map's entries are not in the order of their slots");
      if (id == 0 || id >= header_.next_id) return refused("the map has an entry with an impossible id");
      last_slot = slot;
      const Status status = (this->*read_entry)(static_cast<int>(slot), id);
      if (!status.ok()) return status;
    }
    if (last_slot + 1 != counted.slots) return refused("the map has more slots than its last entry needs");
    return {};
  }

  enum class Slot : uint8_t { kEmpty, kLive, kErased };
  bool has_keyframe(uint32_t slot) const { return slot < counts_.keyframes.slots && slots_[slot] != Slot::kEmpty; }
  bool has_live_keyframe(uint32_t slot) const { return slot < counts_.keyframes.slots && slots_[slot] == Slot::kLive; }

  Status check_anchors() const {
    uint32_t erased = 0;
    for (uint32_t slot = 0; slot < counts_.keyframes.slots; ++slot) {
      if (slots_[slot] != Slot::kErased) continue;
      ++erased;
      if (!has_live_keyframe(anchors_[slot]))
        return refused("an erased keyframe of the map follows one that is not there");
    }
    if (erased != counts_.erased) return refused("the map's counts do not fit its keyframes");
    if (!has_live_keyframe(0)) return refused("the map's first keyframe, its datum, is missing");
    return {};
  }

  bool read_pose(SE3* T) {
    for (int i = 0; i < 9; ++i) T->R(i / 3, i % 3) = in_.f32();
    in_.vector(&T->t);
    return is_rotation(T->R);
  }

  // A pixel of the map's images, as one of the camera's.
  bool read_px(Vector2f* px) {
    in_.vector(px);
    if (!header_.camera.in_image(*px, 0)) return false;  // NaN too
    if (!scale_.is_one()) {
      const CameraModel& camera = config_.camera.model;
      const Vector2f last(static_cast<float>(camera.width - 1), static_cast<float>(camera.height - 1));
      *px =
          scale_(*px).cwiseMax(Vector2f::Zero()).cwiseMin(last);  // an outermost pixel's centre moves half a pixel out
    }
    return true;
  }

  Status read_source(PatchSource* source) {
    const uint32_t keyframe = in_.u16(), level = in_.u16() ^ kUsualLevel;
    if (!has_keyframe(keyframe)) return refused("a point of the map comes from a keyframe that is not there");
    if (level >= kPointLevels) return refused("a point of the map comes from a pyramid level that there is not");
    source->keyframe = static_cast<int16_t>(keyframe);
    source->level = static_cast<uint8_t>(std::max(0, static_cast<int>(level) - scale_.levels));
    const bool inside = read_px(&source->px);
    in_.vector(&source->normal);
    if (!inside) return refused("a point of the map comes from outside its keyframe's image");
    if (!small_enough(source->normal) || !(std::abs(source->normal.squaredNorm() - 1) < kUnitTolerance))
      return refused("a point of the map has a normal that is not of unit length");
    return {};
  }

  Status read_keyframe(int slot, uint32_t id) {
    const uint32_t flags = in_.u32();
    const int64_t timestamp_ns = static_cast<int64_t>(in_.u64());
    SE3 T_kw, T_anchor;
    bool rotations = read_pose(&T_kw);
    Vector6f velocity, velocity_prior;
    in_.vector(&velocity);
    in_.vector(&velocity_prior);
    const float mean_depth = in_.f32();
    const bool erased = flags == kErasedFlag;
    uint32_t anchor = 0;
    if (erased) {
      anchor = in_.u32();
      rotations = read_pose(&T_anchor) && rotations;
    }
    const CameraModel& camera = header_.camera.model;
    const auto pixels = in_.bytes(static_cast<size_t>(camera.width) * static_cast<size_t>(camera.height));
    if (in_.failed()) return refused("the map's entries do not fill the file");
    if (flags != 0 && !erased) return refused("a keyframe of the map has flags that this program does not know");
    if (!rotations) return refused("a keyframe of the map has a rotation that is none");
    if (!small_enough(T_kw.t) || !small_enough(T_anchor.t) || !small_enough(velocity) || !small_enough(velocity_prior))
      return refused("a keyframe of the map has a position or velocity that is not a usable number");
    if (!within(mean_depth, kMinDepthInMap, kMaxInMap))
      return refused("a keyframe of the map has a mean depth that is not a usable number");
    slots_[static_cast<size_t>(slot)] = erased ? Slot::kErased : Slot::kLive;
    anchors_[static_cast<size_t>(slot)] = anchor;
    if (!map_) return {};
    MapAccess::bring_images(*map_, slot);
    Keyframe& keyframe = MapAccess::keyframe(*map_, slot);
    keyframe.id = id;
    keyframe.erased = erased;
    keyframe.anchor = erased ? static_cast<int16_t>(anchor) : int16_t{-1};
    keyframe.T_anchor = T_anchor;
    keyframe.timestamp_ns = timestamp_ns;
    keyframe.T_kw = T_kw;
    keyframe.velocity = velocity;
    keyframe.velocity_prior = velocity_prior;
    keyframe.mean_depth = mean_depth;
    const GreyImage& image = keyframe.storage.level[0];
    shrink({reinterpret_cast<const uint8_t*>(pixels.data()), camera.width, camera.height, camera.width}, image);
    keyframe.pyramid = build_pyramid(image, keyframe.storage);
    make_small_image(keyframe.pyramid, keyframe.small);
    return {};
  }

  Status read_point(int slot, uint32_t id) {
    MapPoint point;
    point.id = id;
    in_.vector(&point.p_w);
    const Status status = read_source(&point.source);
    if (!status.ok()) return status;
    point.attempts = in_.u16();
    point.found = in_.u16();
    const uint32_t measurements = in_.u32();
    if (!small_enough(point.p_w)) return refused("a map point's position is not a usable number");
    if (point.found > point.attempts) return refused("a map point was found more often than searched");
    if (measurements < 2 || measurements > counts_.most_of_a_point)
      return refused("a map point has less than two measurements, or more than the header says");
    measurements_ += measurements;
    most_of_a_point_ = std::max(most_of_a_point_, measurements);
    if (measurements_ > counts_.measurements) return refused("the map's counts do not fit its measurements");
    if (map_) MapAccess::point(*map_, slot) = point;
    int16_t measured[kMaxMeasurementsPerPoint + 1];
    for (uint32_t i = 0; i < measurements; ++i) {
      Measurement m;
      const uint32_t keyframe = in_.u32();
      const bool inside = read_px(&m.at.px);
      const uint32_t level = in_.u32();
      m.weight = in_.f32();
      if (!has_live_keyframe(keyframe)) return refused("a map point was measured in a keyframe that is not there");
      m.keyframe = static_cast<int16_t>(keyframe);
      if (!inside) return refused("a map point was measured outside of the image");
      if (level >= kPyramidLevels) return refused("a measurement's pyramid level is not within 0 to 4");
      m.at.level = static_cast<uint8_t>(std::max(0, static_cast<int>(level) - scale_.levels));
      if (!within(m.weight, 0, 1)) return refused("a measurement's weight is not within 0 to 1");
      if (std::find(measured, measured + i, m.keyframe) != measured + i)
        return refused("a map point was measured twice in one keyframe");
      measured[i] = m.keyframe;
      if (map_) map_->add_measurement(slot, m);
    }
    return {};
  }

  Status read_partial_point(int slot, uint32_t id) {
    PartialPoint partial;
    partial.id = id;
    const Status status = read_source(&partial.source);
    if (!status.ok()) return status;
    partial.inverse_depth = in_.f32();
    partial.information = in_.f32();
    partial.attempts = in_.u16();
    partial.found = in_.u16();
    if (!within(partial.inverse_depth, kMinDepthInMap, kMaxInMap) ||
        !within(partial.information, 0, kMaxInformationInMap))
      return refused("a partial point's depth is not a usable number");
    if (partial.found > partial.attempts) return refused("a partial point was found more often than searched");
    const Vector2f ray = config_.camera.unproject(partial.source.px);
    partial.ray = {ray.x(), ray.y(), 1.0f};
    if (map_) MapAccess::partial_point(*map_, slot) = partial;
    return {};
  }

  Reader in_;
  const Header& header_;
  const Config& config_;
  const ImageScale scale_;
  Map* map_ = nullptr;
  Counts counts_;                                    // of the map that is read
  uint32_t measurements_ = 0, most_of_a_point_ = 0;  // of the points read so far
  std::array<Slot, kMaxKeyframeSlots> slots_ = {};
  std::array<uint32_t, kMaxKeyframeSlots> anchors_ = {};
};

}  // namespace

uint32_t crc32(std::span<const std::byte> bytes) {
  uint32_t crc = 0xFFFFFFFFu;
  for (const std::byte byte : bytes) crc = (crc >> 8) ^ kCrcTable[(crc ^ static_cast<uint32_t>(byte)) & 0xFF];
  return ~crc;
}

size_t map_file_bytes(const Map& map, const Config& config) {
  return write(map, config, 0, {});
}

void write_map_file(const Map& map, const Config& config, std::span<std::byte> out) {
  const size_t bytes = write(map, config, out.size(), out);
  PPTAM_ASSERT(bytes == out.size());
  (void)bytes;
}

Status read_map_info(std::span<const std::byte> file, MapInfo* info) {
  Header header;
  const Status status = read_header(file, Checksum::kCheck, &header);
  if (!status.ok()) return status;
  info->version = static_cast<int>(header.version);
  info->camera = header.camera;
  info->maps = static_cast<int>(header.maps);
  info->keyframes = info->erased_keyframes = info->map_points = info->partial_points = 0;
  info->min_keyframes = info->min_map_points = info->min_partial_points = 0;
  info->min_measurements = info->min_measurements_per_point = 0;
  int slots = 0;
  for (const Counts& counts : header.all()) {
    const int live = static_cast<int>(counts.live());
    info->keyframes += live;
    info->erased_keyframes += static_cast<int>(counts.erased);
    info->map_points += static_cast<int>(counts.points.entries);
    info->partial_points += static_cast<int>(counts.partial_points.entries);
    slots = std::max(slots, static_cast<int>(counts.keyframes.slots));
    info->min_keyframes = std::max(info->min_keyframes, live);
    info->min_map_points = std::max(info->min_map_points, static_cast<int>(counts.points.slots));
    info->min_measurements += static_cast<int>(counts.shared_measurements());
    info->min_measurements_per_point =
        std::max(info->min_measurements_per_point, static_cast<int>(counts.most_of_a_point));
    info->min_partial_points = std::max(info->min_partial_points, static_cast<int>(counts.partial_points.slots));
  }
  // Slots for the largest map, and images for all of them.
  info->min_erased_keyframes = std::max(slots, info->keyframes + info->erased_keyframes) - info->min_keyframes;
  return {};
}

Status check_map_file(std::span<const std::byte> file, const Config& config) {
  Header header;
  Status status = read_header(file, Checksum::kCheck, &header);
  if (status.ok()) status = check_fit(header, config);
  if (status.ok()) status = Body(file, header, config).read(nullptr);
  return status;
}

void read_map_file(std::span<const std::byte> file, const Config& config, Map& map) {
  Header header;
  Status status = read_header(file, Checksum::kChecked, &header);
  if (status.ok()) status = Body(file, header, config).read(&map);
  PPTAM_ASSERT(status.ok());
  MapAccess::set_next_id(map, header.next_id);
}

}  // namespace pptam
