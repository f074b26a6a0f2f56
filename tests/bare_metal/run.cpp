#include "tests/bare_metal/run.h"

namespace pptam::test {
namespace {

class Fnv {
 public:
  void add(const void* data, size_t bytes) {
    const auto* p = static_cast<const unsigned char*>(data);
    for (size_t i = 0; i < bytes; ++i) value_ = (value_ ^ p[i]) * 0x100000001b3u;
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
  Line& hex(uint64_t number) {
    for (int shift = 60; shift >= 0; shift -= 4) put("0123456789abcdef"[number >> shift & 15]);
    return *this;
  }
  const char* text() const { return text_; }

 private:
  void put(char c) {
    if (used_ + 1 < static_cast<int>(sizeof text_)) text_[used_++] = c;
  }
  char text_[160] = {};
  int used_ = 0;
};

constexpr int kSlicesAFrame = 40;  // enough for the start's map to be finished within a second

void add(Fnv* results, const pptam_track_result& r) {
  const int32_t numbers[] = {r.state,         r.quality, r.hint,      r.pose_valid, r.points_found,   r.points_inliers,
                             r.partial_found, r.map,     r.keyframes, r.map_points, r.observed_points};
  results->add(numbers, sizeof numbers);
  results->add(&r.T_cw, sizeof r.T_cw);
  results->add(r.velocity, sizeof r.velocity);
  results->add(r.covariance, sizeof r.covariance);
}

int failed(const Surroundings& around, const pptam_status& status) {
  Line line;
  line << "FAILED: " << status.message << "\n";
  around.say(line.text());
  return 1;
}

}  // namespace

int run_recording(const Surroundings& around, int changed_frame) {
  RecordingHead head;
  if (!around.read(&head, sizeof head)) return failed(around, {1, "the recording has no head"});
  pptam_config config;
  pptam_config_phone(&head.camera, &config);
  config.exposure_s = head.exposure_s;
  // A board with 8 MB of external memory: a map of a desk, and nothing is kept of what is erased.
  config.max_keyframes = 20;
  config.max_erased_keyframes = 5;
  config.max_maps = 1;
  pptam_status status = pptam_config_validate(&config);
  if (status.code != PPTAM_OK) return failed(around, status);
  const size_t pixels = static_cast<size_t>(head.camera.width) * static_cast<size_t>(head.camera.height);
  if (pixels > around.image_bytes) return failed(around, {1, "the images are larger than the room for one"});
  pptam_system* system = nullptr;
  status = pptam_create(&config, around.block, around.block_bytes, &system);
  if (status.code != PPTAM_OK) return failed(around, status);
  Line size;
  size << "block " << static_cast<int64_t>(pptam_required_bytes(&config)) << " bytes\n";
  around.say(size.text());
  pptam_tap(system);
  Fnv results;
  pptam_track_result result = {};
  int64_t poses = 0;
  for (int i = 0; i < head.frames; ++i) {
    int64_t timestamp_ns = 0;
    if (!around.read(&timestamp_ns, sizeof timestamp_ns) || !around.read(around.image, pixels))
      return failed(around, {1, "the recording breaks off"});
    if (i == changed_frame) around.image[pixels / 2] ^= 0xff;
    const pptam_frame frame = {around.image,      head.camera.width, head.camera.height,
                               head.camera.width, PPTAM_PIXEL_GREY,  timestamp_ns};
    status = pptam_track(system, &frame, &result);
    if (status.code != PPTAM_OK) return failed(around, status);
    add(&results, result);
    poses += result.pose_valid;
    for (int slice = 0; slice < kSlicesAFrame && pptam_has_work(system); ++slice) pptam_work_slice(system);
  }
  Line line;
  line << poses << " poses, " << result.keyframes << " keyframes, results ";
  line.hex(results.value()) << ", map ";
  line.hex(pptam_map_hash(system)) << "\n";
  around.say(line.text());
  return poses > 20 ? 0 : failed(around, {1, "there must be a map, or nothing is compared"});
}

}  // namespace pptam::test
