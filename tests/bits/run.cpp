#include "tests/bits/run.h"

#include <algorithm>
#include <iterator>
#include <type_traits>
#include <utility>

#include "c_interface/conversions.h"
#include "camera/full_frame_rotation.h"
#include "image/pyramid.h"

namespace pptam::test {
namespace {

class Fnv {
 public:
  void add(const void* data, size_t bytes) {
    const auto* p = static_cast<const unsigned char*>(data);
    for (size_t i = 0; i < bytes; ++i) value_ = (value_ ^ p[i]) * 0x100000001b3u;
  }
  template <class T>
  void add(const T& value) {
    static_assert(!std::is_convertible_v<T, GreyView>, "an image's pixels are meant, not its address");
    add(&value, sizeof value);
  }
  void add(const GreyView& image) {
    for (int y = 0; y < image.height; ++y) add(image.row(y), static_cast<size_t>(image.width));
  }
  uint64_t value() const { return value_; }

 private:
  uint64_t value_ = 0xcbf29ce484222325u;
};

// A line of words and numbers, without printf.
class Line {
 public:
  Line& operator<<(const char* text) {
    for (; *text != '\0'; ++text) put(*text);
    return *this;
  }
  Line& operator<<(int64_t number) {
    char digits[20];
    int count = 0;
    do digits[count++] = static_cast<char>('0' + number % 10);
    while ((number /= 10) != 0);
    while (count > 0) put(digits[--count]);
    return *this;
  }
  Line& hex(uint64_t number, int count = 16) {
    for (int shift = 4 * (count - 1); shift >= 0; shift -= 4) put("0123456789abcdef"[number >> shift & 15]);
    return *this;
  }
  const char* text() const { return text_; }

 private:
  void put(char c) {
    if (used_ + 1 < static_cast<int>(sizeof text_)) text_[used_++] = c;
  }
  char text_[400] = {};
  int used_ = 0;
};

// Of a frame, in the order in which one needs the other.
enum StageOfBits {
  kPyramidBits,
  kRotationBits,
  kCornerBits,
  kPredictBits,
  kSearchBits,
  kPoseBits,
  kMapBits,
  kStagesOfBits
};
constexpr const char* kStageNames[kStagesOfBits] = {"pyramid", "rotation", "corners", "predict",
                                                    "search",  "pose",     "map"};
constexpr const char* kMappingNames[] = {"finish", "insert", "adjust_new", "adjust", "cull", "tidy"};

constexpr int kSlicesAFrame = 40;        // enough for the start's map to be finished within a second
constexpr int32_t kMostObserved = 1100;  // of a frame: a thousand is the desktop profile's

// Pyramid and full-frame rotation stay inside the library. The same functions on the same images tell whether they give
// the same bits.
class InnerStages {
 public:
  InnerStages(Arena& arena, const Camera& camera)
      : storage_(arena, camera.model.width, camera.model.height, 1),
        small_(small_image_storage(arena, camera.model.width, camera.model.height)),
        previous_(small_image_storage(arena, camera.model.width, camera.model.height)),
        rotation_(arena, camera) {}
  void see(const GreyView& image, Fnv (&stages)[kStagesOfBits]) {
    const Pyramid pyramid = build_pyramid(image, storage_);
    for (const GreyView& level : pyramid.level) stages[kPyramidBits].add(level);
    std::swap(small_, previous_);
    make_small_image(pyramid, small_);
    stages[kPyramidBits].add(GreyView(small_));
    if (seen_) {
      const RotationEstimate estimate = rotation_.estimate(previous_, small_, Matrix3f::Identity(), Vector3f::Zero());
      stages[kRotationBits].add(estimate.R_cp.data(), 9 * sizeof(float));
      stages[kRotationBits].add(estimate.covariance.data(), 9 * sizeof(float));
    }
    seen_ = true;
  }

 private:
  PyramidStorage storage_;
  GreyImage small_, previous_;
  FullFrameRotation rotation_;
  bool seen_ = false;
};

struct MappingSeen {  // bits of kMappingNames
  uint32_t kinds = 0;
};
void note_span(void* seen, int32_t span) {
  if (span >= PPTAM_SPAN_FINISH_MAP) static_cast<MappingSeen*>(seen)->kinds |= 1u << (span - PPTAM_SPAN_FINISH_MAP);
}
void note_nothing(void* /*seen*/, int32_t /*span*/) {}
void count_nothing(void* /*seen*/, int32_t /*counter*/, int64_t /*value*/) {}

int failed(const Surroundings& around, const pptam_status& status) {
  Line line;
  line << "FAILED: " << status.message << "\n";
  around.say(line.text());
  return 1;
}
int failed(const Surroundings& around, const char* why) {
  return failed(around, pptam_status{PPTAM_INVALID_ARGUMENT, why});
}

// What is the same of every recording: frames are read, and the hashes of their stages added up and said.
class Reading {
 public:
  // required: bytes of the block that are the library's.
  Reading(const Surroundings& around, const RecordingHead& head, size_t required, int changed_frame)
      : around_(around),
        head_(head),
        changed_frame_(changed_frame),
        camera_(prepared(c::camera_from(head.camera))),
        arena_({static_cast<std::byte*>(around.block) + aligned(required), around.block_bytes - aligned(required)}),
        inner_(arena_, camera_) {
    Line size;
    size << "block " << static_cast<int64_t>(required) << " bytes\n";
    around.say(size.text());
  }
  static bool fits(const Surroundings& around, const RecordingHead& head, size_t required) {
    const size_t pixels = static_cast<size_t>(head.camera.width) * static_cast<size_t>(head.camera.height);
    // 40 bytes for a pixel of the small images, of which there are at most 600.
    return pixels <= around.image_bytes && aligned(required) + pixels + 40000 <= around.block_bytes;
  }
  bool next() {
    int64_t timestamp_ns = 0;
    const size_t pixels = static_cast<size_t>(head_.camera.width) * static_cast<size_t>(head_.camera.height);
    if (!around_.read(&timestamp_ns, sizeof timestamp_ns) || !around_.read(around_.image, pixels)) return false;
    if (index_ == changed_frame_) around_.image[pixels / 2] ^= 0xff;
    frame_ = {around_.image,      head_.camera.width, head_.camera.height,
              head_.camera.width, PPTAM_PIXEL_GREY,   timestamp_ns};
    for (Fnv& stage : stages_) stage = Fnv();
    inner_.see({around_.image, head_.camera.width, head_.camera.height, head_.camera.width}, stages_);
    return true;
  }
  void finish(uint32_t mapping) {
    const Fnv nothing;
    Line line;
    line << "frame " << index_;
    for (int i = 0; i < kStagesOfBits; ++i) {
      const uint64_t hash = stages_[i].value() == nothing.value() ? 0 : stages_[i].value();
      results_.add(hash);
      line << " " << kStageNames[i] << " ";
      line.hex(hash ^ hash >> 32, 8);
    }
    if (mapping != 0) line << " by";
    for (int i = 0; i < static_cast<int>(std::size(kMappingNames)); ++i)
      if ((mapping >> i & 1) != 0) line << " " << kMappingNames[i];
    line << "\n";
    if (head_.tells_stages != 0) around_.say(line.text());
    ++index_;
  }
  const pptam_frame& frame() const { return frame_; }
  Fnv& stage(StageOfBits stage) { return stages_[stage]; }
  uint64_t results() const { return results_.value(); }

 private:
  static size_t aligned(size_t bytes) { return (bytes + 15) / 16 * 16; }
  static Camera prepared(Camera camera) {
    camera.model.prepare();
    return camera;
  }

  const Surroundings& around_;
  const RecordingHead& head_;
  const int changed_frame_;
  const Camera camera_;
  Arena arena_;
  InnerStages inner_;
  Fnv stages_[kStagesOfBits], results_;
  pptam_frame frame_ = {};
  int64_t index_ = 0;
};

// Points first found in an image are corners, the others are predicted; what was found where is the search's.
void add_points(const pptam_system* system, Reading& reading) {
  static pptam_observed_point points[kMostObserved];
  int32_t count = 0;
  pptam_observed_points(system, points, kMostObserved, &count);
  for (int32_t i = 0; i < std::min(count, kMostObserved); ++i) {
    const pptam_observed_point& point = points[i];
    const bool corner = point.kind == PPTAM_OBSERVED_INITIAL;
    reading.stage(corner ? kCornerBits : kPredictBits).add(point.predicted_px);
    reading.stage(kSearchBits).add(point.px);
    reading.stage(kSearchBits).add(point.point_id);
    reading.stage(kSearchBits).add(point.level);
    reading.stage(kPoseBits).add(point.kind);  // an inlier or not
  }
}

void add_result(const pptam_track_result& r, Fnv* pose) {
  const int32_t numbers[] = {r.state,         r.quality, r.hint,      r.pose_valid, r.points_found,   r.points_inliers,
                             r.partial_found, r.map,     r.keyframes, r.map_points, r.observed_points};
  pose->add(numbers);
  pose->add(r.T_cw);
  pose->add(r.velocity);
  pose->add(r.covariance);
}

int say_results(const Surroundings& around, int64_t poses, int64_t keyframes, uint64_t results, uint64_t map) {
  Line line;
  line << poses << " poses, " << keyframes << " keyframes, results ";
  line.hex(results) << ", map ";
  line.hex(map) << "\n";
  around.say(line.text());
  return poses > 20 ? 0 : failed(around, "there must be a map, or nothing is compared");
}

// The desktop's parts are none that C can name.
Config desktop(const RecordingHead& head) {
  const Camera camera = c::camera_from(head.camera);
  Config config = Config::desktop(camera.model);
  config.camera.shutter = camera.shutter;
  config.exposure_s = head.exposure_s;
  return config;
}

pptam_config configuration(const RecordingHead& head) {
  pptam_config config;
  if (head.tracked == Tracked::kTiny) {
    pptam_config_tiny(&head.camera, &config);
  } else {
    pptam_config_phone(&head.camera, &config);
  }
  config.exposure_s = head.exposure_s;
  if (head.tracked != Tracked::kBoard) return config;
  // A map of a desk, and nothing is kept of what is erased.
  config.max_keyframes = 20;
  config.max_erased_keyframes = 5;
  config.max_maps = 1;
  return config;
}

int run_map(const Surroundings& around, const RecordingHead& head, int changed_frame) {
  const bool on_desktop = head.tracked == Tracked::kDesktop;
  const pptam_config config = configuration(head);
  pptam_status status = pptam_config_validate(&config);
  if (status.code != PPTAM_OK) return failed(around, status);
  const size_t required = on_desktop ? c::required_bytes(desktop(head)) : pptam_required_bytes(&config);
  if (!Reading::fits(around, head, required)) return failed(around, "the block or the image is too small");
  pptam_system* system = nullptr;
  status = on_desktop ? c::create(desktop(head), around.block, required, &system)
                      : pptam_create(&config, around.block, required, &system);
  if (status.code != PPTAM_OK) return failed(around, status);
  Reading reading(around, head, required, changed_frame);
  MappingSeen mapping;
  const pptam_tracer tracer = {note_span, note_nothing, count_nothing, &mapping};
  pptam_set_tracer(system, &tracer);
  pptam_tap(system);
  pptam_track_result result = {};
  int64_t poses = 0;
  for (int i = 0; i < head.frames; ++i) {
    if (!reading.next()) return failed(around, "the recording breaks off");
    status = pptam_track(system, &reading.frame(), &result);
    if (status.code != PPTAM_OK) return failed(around, status);
    poses += result.pose_valid;
    add_points(system, reading);
    add_result(result, &reading.stage(kPoseBits));
    mapping.kinds = 0;
    for (int slice = 0; slice < kSlicesAFrame && pptam_has_work(system); ++slice) pptam_work_slice(system);
    if (result.keyframes > 0) reading.stage(kMapBits).add(pptam_map_hash(system));
    reading.finish(mapping.kinds);
  }
  return say_results(around, poses, result.keyframes, reading.results(), pptam_map_hash(system));
}

int run_model(const Surroundings& around, const RecordingHead& head, int changed_frame) {
  const pptam_object_arrays arrays = known_object();
  const size_t object_bytes = (pptam_object_model_required_bytes(&arrays) + 15) / 16 * 16;
  pptam_object_model* object = nullptr;
  pptam_status status = pptam_object_model_create(&arrays, around.block, object_bytes, &object);
  if (status.code != PPTAM_OK) return failed(around, status);
  pptam_model_tracker_config config;
  pptam_model_tracker_config_usual(&head.camera, object, &config);
  const size_t required = object_bytes + pptam_model_tracker_required_bytes(&config);
  if (!Reading::fits(around, head, required)) return failed(around, "the block or the image is too small");
  pptam_model_tracker* tracker = nullptr;
  status = pptam_model_tracker_create(&config, static_cast<std::byte*>(around.block) + object_bytes,
                                      required - object_bytes, &tracker);
  if (status.code != PPTAM_OK) return failed(around, status);
  status = pptam_model_start(tracker, &head.start);
  if (status.code != PPTAM_OK) return failed(around, status);
  Reading reading(around, head, required, changed_frame);
  int64_t poses = 0;
  for (int i = 0; i < head.frames; ++i) {
    if (!reading.next()) return failed(around, "the recording breaks off");
    pptam_model_result result;
    status = pptam_model_track(tracker, &reading.frame(), &result);
    if (status.code != PPTAM_OK) return failed(around, status);
    static pptam_model_site sites[kMostObserved];
    int32_t count = 0;
    pptam_model_sites(tracker, sites, kMostObserved, &count);
    for (int32_t s = 0; s < std::min(count, kMostObserved); ++s) {
      reading.stage(kPredictBits).add(sites[s].model_px);
      reading.stage(kSearchBits).add(sites[s].px);
    }
    poses += result.pose_valid;
    Fnv& pose = reading.stage(kPoseBits);
    pose.add(result.T_co);
    pose.add(result.covariance);
    pose.add(result.quality);
    pose.add(result.sites_inliers);
    reading.finish(0);
  }
  return say_results(around, poses, 0, reading.results(), 0);
}

}  // namespace

pptam_object_arrays known_object() {
  static constexpr float kPoints[] = {-0.1f,   -0.075f, -0.05f, 0.1f,   -0.075f, -0.05f,  -0.1f,  0.075f,
                                      -0.05f,  0.1f,    0.075f, -0.05f, -0.1f,   -0.075f, 0.05f,  0.1f,
                                      -0.075f, 0.05f,   -0.1f,  0.075f, 0.05f,   0.1f,    0.075f, 0.05f,
                                      -0.15f,  -0.09f,  0.0f,   -0.15f, 0.09f,   0.0f};
  static constexpr int32_t kCorners[] = {0, 2, 3, 1, 4, 5, 7, 6, 0, 1, 5, 4, 2, 6, 7, 3, 0, 4, 6, 2, 1, 3, 7, 5};
  static constexpr pptam_model_face kFaces[] = {{0, 4, false, 0, 0},  {4, 4, false, 0, 0},  {8, 4, false, 0, 0},
                                                {12, 4, false, 0, 0}, {16, 4, false, 0, 0}, {20, 4, false, 0, 0}};
  static constexpr pptam_model_cylinder kBar = {8, 9, 0.03f, 0};
  static constexpr pptam_model_sphere kBall = {{0.15f, 0, 0}, 0.03f, 0};
  pptam_object_arrays object = {};
  object.points = kPoints, object.point_count = std::size(kPoints) / 3;
  object.corners = kCorners, object.corner_count = std::size(kCorners);
  object.faces = kFaces, object.face_count = std::size(kFaces);
  object.cylinders = &kBar, object.cylinder_count = 1;
  object.spheres = &kBall, object.sphere_count = 1;
  return object;
}

int run_recording(const Surroundings& around, int changed_frame) {
  RecordingHead head;
  if (!around.read(&head, sizeof head)) return failed(around, "the recording has no head");
  return head.tracked == Tracked::kModel ? run_model(around, head, changed_frame)
                                         : run_map(around, head, changed_frame);
}

}  // namespace pptam::test
