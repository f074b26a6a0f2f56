// Calls of the C interface one after the other, with bytes for numbers: no call breaks a promise of pocket_ptam_c.h.
// tests/fuzz/run.sh builds and runs it.
//
// The input is a script: a byte says what is called, the next ones are what it is called with. When they are used up
// zeros follow. Two systems stand side by side; half of the scripts begin with a map.
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <vector>

#include <pocket_ptam/pocket_ptam_c.h>
#include "tests/fuzz/script.h"
#include "tests/support/small_map.h"

namespace {

using namespace pptam;
using test::checked;
using test::require;
using test::Script;

using Memory = std::vector<std::max_align_t>;
constexpr size_t kMostBytes = size_t{8} << 20;  // of a system that is made

struct Target {
  Target() : original(1), good(original.file()), memory{Memory(kMostBytes / 16), Memory(kMostBytes / 16)} {
    pptam_camera camera = {};
    const Config& given = original.config;
    camera.width = given.camera.model.width, camera.height = given.camera.model.height;
    camera.fx = given.camera.model.fx, camera.fy = given.camera.model.fy;
    camera.cx = given.camera.model.cx, camera.cy = given.camera.model.cy;
    camera.shutter_axis = PPTAM_SHUTTER_COLUMNS, camera.line_time_s = given.camera.shutter.line_time_s;
    require(pptam_config_phone(&camera, &config).code == PPTAM_OK, "no configuration");
    config.max_keyframes = given.max_keyframes;
    config.max_map_points = given.max_map_points;
    config.max_partial_points = given.max_partial_points;
  }
  test::SmallMap original;
  std::vector<std::byte> good;
  std::array<Memory, 2> memory;
  pptam_config config;
};

int64_t no_time(void* user) {
  return *static_cast<const int64_t*>(user);
}

int open_spans = 0;
void note_span(void* user, int32_t span) {
  require(span >= 0 && span < PPTAM_SPAN_COUNT, "a span that is none");
  ++*static_cast<int*>(user);
}
void end_span(void* user, int32_t span) {
  require(span >= 0 && span < PPTAM_SPAN_COUNT && --*static_cast<int*>(user) >= 0, "an end without a beginning");
}
void note_count(void* /*user*/, int32_t counter, int64_t /*value*/) {
  require(counter >= 0 && counter < PPTAM_COUNTER_COUNT, "a counter that is none");
}

template <class T, class Copy>
void copy_out(size_t room, const Copy& copy) {
  std::vector<T> out(room);  // the sanitizer watches its end
  int32_t count = 0;
  if (checked(copy(out.data(), room, &count)).code == PPTAM_OK) require(count >= 0, "a negative count");
}

// One call of a system whose last frame was at *now_ns.
void call(Target& target, Script& script, pptam_system* system, int64_t* now_ns) {
  static int64_t time = 0;
  const size_t room = script.take<uint8_t>() % 64;
  switch (script.take<uint8_t>() % 16) {
    case 0:
      checked(pptam_tap(system));
      break;
    case 1:
      checked((room & 1) != 0 ? pptam_reset(system) : pptam_set_clock(system, no_time, &time));
      break;
    case 2:
      checked(pptam_set_locked(system, (room & 1) != 0));
      break;
    case 3: {
      const auto a = script.take<uint32_t>() % 2000;
      checked(pptam_set_length(system, a, script.take<uint32_t>() % 2000, script.take<float>()));
      break;
    }
    case 4: {
      std::vector<std::byte> file = target.good;
      if ((room & 1) != 0) file[script.take<uint32_t>() % file.size()] = script.take<std::byte>();
      checked(pptam_load_map(system, file.data(), file.size() - (room & 2)));
      break;
    }
    case 5: {
      std::vector<std::byte> file(std::min(pptam_map_bytes(system), size_t{1} << script.take<uint8_t>() % 25));
      size_t bytes = 0;
      if (checked(pptam_save_map(system, file.data(), file.size(), &bytes)).code != PPTAM_OK) break;
      pptam_map_info info;
      require(pptam_read_map_info(file.data(), bytes, &info).code == PPTAM_OK, "what was saved cannot be read");
      break;
    }
    case 6:
      copy_out<pptam_keyframe>(room, [&](auto... a) { return pptam_keyframes(system, script.take<int32_t>(), a...); });
      copy_out<pptam_keyframe>(room, [&](auto... a) { return pptam_keyframes(system, 0, a...); });
      break;
    case 7:
      copy_out<pptam_map_point>(room, [&](auto... a) { return pptam_map_points(system, 0, a...); });
      copy_out<pptam_measurement>(room, [&](auto... a) { return pptam_measurements(system, 0, a...); });
      copy_out<pptam_observed_point>(room, [&](auto... a) { return pptam_observed_points(system, a...); });
      break;
    case 8: {
      auto pose = script.take<pptam_pose>();
      if ((room & 1) != 0) pose = {{1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 0}};
      float numbers[9], px[2], position[3], quaternion[4];
      for (float& number : numbers) number = script.take<float>();
      bool visible = false;
      if (checked(pptam_project(system, &pose, numbers, numbers + 6, px, &visible)).code == PPTAM_OK && visible)
        require(std::isfinite(px[0]) && std::isfinite(px[1]), "a pixel that is no number");
      if (checked(pptam_unproject(system, numbers, px)).code == PPTAM_OK)
        require(std::isfinite(px[0]) && std::isfinite(px[1]), "a ray that is no number");
      if (checked(pptam_inverse_as_quaternion(&pose, position, quaternion)).code == PPTAM_OK)
        require(std::isfinite(quaternion[0]), "a quaternion that is no number");
      break;
    }
    case 9: {
      pptam_image image;
      checked(pptam_keyframe_image(system, script.take<uint32_t>() % 2000, &image));
      break;
    }
    case 10:
      for (size_t i = 0; i < room; ++i) checked(pptam_work_slice(system));
      break;
    case 11: {
      const float px[2] = {script.take<float>(), (room & 1) != 0 ? 40.0f : script.take<float>()};
      pptam_pose change;
      if (checked(pptam_set_ground(system, px, (room & 2) != 0 ? &change : nullptr)).code == PPTAM_OK &&
          (room & 2) != 0)
        for (const float number : change.R) require(std::isfinite(number), "a change that is no number");
      break;
    }
    case 12: {
      const pptam_tracer tracer = {note_span, end_span, note_count, &open_spans};
      require(open_spans == 0, "a span that was not ended");
      pptam_tracer incomplete = tracer;
      if ((room & 6) == 2) incomplete.end = nullptr;
      checked(pptam_set_tracer(system, (room & 6) == 6 ? nullptr : &incomplete));
      copy_out<pptam_plane>(room, [&](auto... a) { return pptam_planes(system, script.take<int32_t>() % 3, a...); });
      copy_out<pptam_plane>(room, [&](auto... a) { return pptam_planes(system, 0, a...); });
      break;
    }
    default: {  // a frame, mostly a good one
      const GreyView image = target.original.map.keyframes()[room & 1].pyramid.level[0];
      pptam_frame frame = {image.data, image.width, image.height, image.stride, PPTAM_PIXEL_GREY, *now_ns + 66666667};
      if (room > 50) script.change(&frame);
      if (frame.data != image.data) frame.data = nullptr;
      frame.stride_bytes = std::min(frame.stride_bytes, image.stride);
      pptam_track_result result;
      if (checked(pptam_track(system, &frame, &result)).code != PPTAM_OK) break;
      *now_ns = frame.timestamp_ns;
      for (const float number : result.T_cw.R) require(std::isfinite(number), "a pose that is no number");
    }
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  static Target target;
  Script script(data, size);
  const bool begins_with_map = (script.take<uint8_t>() & 1) != 0;
  std::array<pptam_system*, 2> systems = {};
  std::array<int64_t, 2> now_ns = {};
  for (size_t i = 0; i < systems.size(); ++i) {
    pptam_config config = target.config;
    if (i == 1) script.change(&config);  // may be none any more: then there is no second system
    const size_t bytes = pptam_required_bytes(&config);
    require((bytes == 0) == (checked(pptam_config_validate(&config)).code != PPTAM_OK), "bytes of no configuration");
    pptam_memory_parts parts = {};
    if (checked(pptam_required_parts(&config, &parts)).code == PPTAM_OK)
      require(parts.map + parts.tracking + parts.mapping + parts.rest == bytes, "parts of another whole");
    const size_t given = bytes <= kMostBytes ? bytes : kMostBytes;
    const pptam_status status = checked(pptam_create(&config, target.memory[i].data(), given, &systems[i]));
    require((status.code == PPTAM_OK) == (systems[i] != nullptr), "a handle of no system");
    require(status.code == PPTAM_OK || i == 1, "the first system is refused");
    if (begins_with_map && systems[i]) checked(pptam_load_map(systems[i], target.good.data(), target.good.size()));
  }
  while (script.more()) {
    const size_t i = script.take<uint8_t>() & 1;
    call(target, script, systems[i], &now_ns[i]);
  }
  return 0;
}
