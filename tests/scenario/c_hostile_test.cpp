// The C interface in hostile hands: each call is refused with a reason, its outputs stay as they were, and the system
// goes on as if there had been no such call.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <functional>
#include <limits>
#include <string>
#include <vector>

#include <pocket_ptam/pocket_ptam_c.h>
#include "tests/support/c_phone.h"
#include "tests/support/random.h"
#include "tests/support/recording.h"

namespace pptam {
namespace {

using test::Block;
using test::c_config_for;
using test::c_frame;
using test::CPhone;
using test::desk_recording;

constexpr float kNotANumber = std::numeric_limits<float>::quiet_NaN();
constexpr float kEndless = std::numeric_limits<float>::infinity();
constexpr int32_t kMostInt = std::numeric_limits<int32_t>::max();

void expect_refused(const pptam_status& status, int32_t code, const std::string& name) {
  EXPECT_EQ(status.code, code) << name << ": " << status.message;
  EXPECT_NE(status.message[0], '\0') << name;
}

TEST(CHostile, ConfigurationsAreRefused) {
  const pptam_config good = c_config_for(desk_recording());
  const std::vector<std::pair<const char*, std::function<void(pptam_config&)>>> changes = {
      {"focal length NaN", [](pptam_config& c) { c.camera.fx = kNotANumber; }},
      {"focal length 0", [](pptam_config& c) { c.camera.fy = 0; }},
      {"principal point infinite", [](pptam_config& c) { c.camera.cx = kEndless; }},
      {"width negative", [](pptam_config& c) { c.camera.width = -240; }},
      {"height huge", [](pptam_config& c) { c.camera.height = kMostInt; }},
      {"distortion -1", [](pptam_config& c) { c.camera.distortion = -1; }},
      {"distortion 4", [](pptam_config& c) { c.camera.distortion = 4; }},
      {"distortion 256, which is 0 in a byte", [](pptam_config& c) { c.camera.distortion = 256; }},
      {"coefficient NaN",
       [](pptam_config& c) {
         c.camera.distortion = PPTAM_DISTORTION_RADTAN;
         c.camera.coeffs[1] = kNotANumber;
       }},
      {"axis 2", [](pptam_config& c) { c.camera.shutter_axis = 2; }},
      {"axis 257, which is 1 in a byte", [](pptam_config& c) { c.camera.shutter_axis = 257; }},
      {"line time NaN", [](pptam_config& c) { c.camera.line_time_s = kNotANumber; }},
      {"exposure in milliseconds", [](pptam_config& c) { c.exposure_s = 30; }},
      {"keyframes beyond memory", [](pptam_config& c) { c.max_keyframes = kMostInt; }},
      {"points negative", [](pptam_config& c) { c.max_map_points = -1; }},
      {"maps none", [](pptam_config& c) { c.max_maps = 0; }},
      {"interval NaN", [](pptam_config& c) { c.min_keyframe_interval_s = kNotANumber; }},
      {"plane behind the camera", [](pptam_config& c) { c.initial_plane_distance = -1; }},
      {"clock 0", [](pptam_config& c) { c.profile.clock_mhz = 0; }},
      {"price infinite", [](pptam_config& c) { c.profile.instructions[PPTAM_WORK_OTHER] = kEndless; }},
      {"all bytes 0", [](pptam_config& c) { std::memset(&c, 0, sizeof c); }},
      {"all bytes 0xff", [](pptam_config& c) { std::memset(&c, 0xff, sizeof c); }},
      {"all bytes 0x55", [](pptam_config& c) { std::memset(&c, 0x55, sizeof c); }},
  };
  Block block(pptam_required_bytes(&good));
  for (const auto& [name, change] : changes) {
    pptam_config config = good;
    change(config);
    pptam_system* system = nullptr;
    expect_refused(pptam_config_validate(&config), PPTAM_INVALID_ARGUMENT, name);
    EXPECT_EQ(pptam_required_bytes(&config), 0u) << name;
    expect_refused(pptam_create(&config, block.data(), block.bytes(), &system), PPTAM_INVALID_ARGUMENT, name);
    EXPECT_EQ(system, nullptr) << name;
  }
  pptam_camera camera = good.camera;
  EXPECT_EQ(pptam_camera_validate(&camera).code, PPTAM_OK);
  camera.shutter_axis = -1;
  expect_refused(pptam_camera_validate(&camera), PPTAM_INVALID_ARGUMENT, "axis");
  camera = good.camera;
  camera.fx = kNotANumber;
  expect_refused(pptam_camera_validate(&camera), PPTAM_INVALID_ARGUMENT, "focal length");
  expect_refused(pptam_camera_validate(nullptr), PPTAM_INVALID_ARGUMENT, "no camera");
}

TEST(CHostile, BlocksAreRefusedAndTheNextOneWorks) {
  const pptam_config config = c_config_for(desk_recording());
  const size_t bytes = pptam_required_bytes(&config);
  Block block(bytes);
  pptam_system* system = nullptr;
  expect_refused(pptam_create(nullptr, block.data(), bytes, &system), PPTAM_INVALID_ARGUMENT, "no configuration");
  expect_refused(pptam_create(&config, nullptr, bytes, &system), PPTAM_INVALID_ARGUMENT, "no block");
  expect_refused(pptam_create(&config, block.data(), bytes, nullptr), PPTAM_INVALID_ARGUMENT, "no handle");
  for (size_t shift = 1; shift < alignof(std::max_align_t); ++shift)
    expect_refused(pptam_create(&config, block.data() + shift, bytes, &system), PPTAM_INVALID_ARGUMENT,
                   "shifted by " + std::to_string(shift));
  for (const size_t too_few : {size_t{0}, size_t{1}, size_t{64}, bytes / 2, bytes - 1})
    expect_refused(pptam_create(&config, block.data(), too_few, &system), PPTAM_OUT_OF_MEMORY,
                   std::to_string(too_few) + " bytes");
  EXPECT_EQ(system, nullptr);

  // Frames after a failure: the handle is still null.
  const pptam_frame frame = c_frame(desk_recording().frame(0));
  pptam_track_result result;
  expect_refused(pptam_track(system, &frame, &result), PPTAM_INVALID_ARGUMENT, "frame after a failure");
  EXPECT_EQ(result.timestamp_ns, frame.timestamp_ns);
  EXPECT_FALSE(result.pose_valid);
  ASSERT_EQ(pptam_create(&config, block.data(), bytes, &system).code, PPTAM_OK);
  EXPECT_EQ(pptam_track(system, &frame, &result).code, PPTAM_OK);
}

TEST(CHostile, NullHandlesAreRefusedByAll) {
  const pptam_frame frame = c_frame(desk_recording().frame(0));
  pptam_config config;
  pptam_track_result result;
  pptam_pose pose = {};
  pptam_image image;
  float numbers[6] = {};
  bool visible = false;
  int32_t count = 0;
  size_t bytes = 0;
  const std::vector<std::pair<const char*, pptam_status>> statuses = {
      {"get_config", pptam_get_config(nullptr, &config)},
      {"set_clock", pptam_set_clock(nullptr, nullptr, nullptr)},
      {"set_tracer", pptam_set_tracer(nullptr, nullptr)},
      {"track", pptam_track(nullptr, &frame, &result)},
      {"observed_points", pptam_observed_points(nullptr, nullptr, 0, &count)},
      {"work_slice", pptam_work_slice(nullptr)},
      {"tap", pptam_tap(nullptr)},
      {"reset", pptam_reset(nullptr)},
      {"set_locked", pptam_set_locked(nullptr, true)},
      {"set_length", pptam_set_length(nullptr, 1, 2, 1)},
      {"set_ground", pptam_set_ground(nullptr, numbers, nullptr)},
      {"planes", pptam_planes(nullptr, 0, nullptr, 0, &count)},
      {"project", pptam_project(nullptr, &pose, numbers, numbers, numbers, &visible)},
      {"unproject", pptam_unproject(nullptr, numbers, numbers)},
      {"keyframes", pptam_keyframes(nullptr, 0, nullptr, 0, &count)},
      {"map_points", pptam_map_points(nullptr, 0, nullptr, 0, &count)},
      {"measurements", pptam_measurements(nullptr, 0, nullptr, 0, &count)},
      {"keyframe_image", pptam_keyframe_image(nullptr, 1, &image)},
      {"map_fit", pptam_map_fit(nullptr, &count, numbers)},
      {"map_parts", pptam_map_parts(nullptr, 12, &count)},
      {"save_map", pptam_save_map(nullptr, nullptr, 0, &bytes)},
      {"load_map", pptam_load_map(nullptr, &frame, sizeof frame)},
      {"model start", pptam_model_start(nullptr, &pose)},
      {"model start_from_points", pptam_model_start_from_points(nullptr, numbers, numbers, 1)},
      {"model start_anywhere", pptam_model_start_anywhere(nullptr)},
      {"model reset", pptam_model_reset(nullptr)},
      {"model sites", pptam_model_sites(nullptr, nullptr, 0, &count)},
      {"model get_config", pptam_model_tracker_get_config(nullptr, nullptr)},
  };
  for (const auto& [name, status] : statuses) expect_refused(status, PPTAM_INVALID_ARGUMENT, name);
  EXPECT_FALSE(pptam_has_work(nullptr));
  EXPECT_FALSE(pptam_locked(nullptr));
  EXPECT_EQ(pptam_map_bytes(nullptr), 0u);
  EXPECT_EQ(pptam_map_hash(nullptr), 0u);
  EXPECT_EQ(pptam_required_bytes(nullptr), 0u);
  EXPECT_EQ(pptam_work_units(nullptr, 0), -1);
  EXPECT_EQ(pptam_work_instructions(nullptr), -1);
  EXPECT_EQ(pptam_work_ns(nullptr), -1);
  for (const int32_t hint : {-1, 9, 256, 257, kMostInt}) EXPECT_STREQ(pptam_hint_text(hint), "") << hint;
  EXPECT_STREQ(pptam_hint_text(PPTAM_HINT_MOVE_SIDEWAYS), "move sideways");
  EXPECT_NE(pptam_version()[0], '\0');
}

// A call that must be refused, between two frames. It may look at the last frame and at a saved map.
struct Hostile {
  const char* name;
  int32_t code;
  std::function<pptam_status(pptam_system*, const pptam_frame&)> call;
};

// A frame that is changed before it is given.
Hostile bad_frame(const char* name, int32_t code, std::function<void(pptam_frame&)> change) {
  return {name, code, [change](pptam_system* system, const pptam_frame& good) {
            pptam_frame frame = good;
            ++frame.timestamp_ns;
            change(frame);
            pptam_track_result result;
            const pptam_status status = pptam_track(system, &frame, &result);
            EXPECT_FALSE(result.pose_valid);
            EXPECT_EQ(result.timestamp_ns, frame.timestamp_ns);
            return status;
          }};
}

std::vector<Hostile> hostile_frames() {
  return {
      bad_frame("no pixels", PPTAM_INVALID_ARGUMENT, [](pptam_frame& f) { f.data = nullptr; }),
      bad_frame("stride of less than a row", PPTAM_INVALID_ARGUMENT, [](pptam_frame& f) { --f.stride_bytes; }),
      bad_frame("stride 0", PPTAM_INVALID_ARGUMENT, [](pptam_frame& f) { f.stride_bytes = 0; }),
      bad_frame("stride negative", PPTAM_INVALID_ARGUMENT, [](pptam_frame& f) { f.stride_bytes = -f.stride_bytes; }),
      bad_frame("stride of grey for BGRA", PPTAM_INVALID_ARGUMENT, [](pptam_frame& f) { f.format = PPTAM_PIXEL_BGRA; }),
      bad_frame("width of another camera", PPTAM_INVALID_ARGUMENT, [](pptam_frame& f) { --f.width; }),
      bad_frame("height negative", PPTAM_INVALID_ARGUMENT, [](pptam_frame& f) { f.height = -f.height; }),
      bad_frame("format -1", PPTAM_INVALID_ARGUMENT, [](pptam_frame& f) { f.format = -1; }),
      bad_frame("format 256, which is grey in a byte", PPTAM_INVALID_ARGUMENT, [](pptam_frame& f) { f.format = 256; }),
      bad_frame("the same time", PPTAM_TIME_WENT_BACKWARDS, [](pptam_frame& f) { --f.timestamp_ns; }),
      bad_frame("time backwards", PPTAM_TIME_WENT_BACKWARDS, [](pptam_frame& f) { f.timestamp_ns -= 2; }),
      bad_frame("the first time there is", PPTAM_TIME_WENT_BACKWARDS,
                [](pptam_frame& f) { f.timestamp_ns = std::numeric_limits<int64_t>::min(); }),
      {"no frame", PPTAM_INVALID_ARGUMENT,
       [](pptam_system* system, const pptam_frame&) {
         pptam_track_result result;
         return pptam_track(system, nullptr, &result);
       }},
      {"no result", PPTAM_INVALID_ARGUMENT,
       [](pptam_system* system, const pptam_frame& good) {
         pptam_frame frame = good;
         ++frame.timestamp_ns;
         return pptam_track(system, &frame, nullptr);
       }},
  };
}

std::vector<Hostile> hostile_calls() {
  static int32_t count;
  static size_t bytes;
  static float numbers[6];
  using Frame = const pptam_frame&;
  const int32_t refused = PPTAM_INVALID_ARGUMENT;
  return {
      {"tracer without functions", refused,
       [](pptam_system* s, Frame) {
         const pptam_tracer tracer = {};
         return pptam_set_tracer(s, &tracer);
       }},
      {"ground null", refused, [](pptam_system* s, Frame) { return pptam_set_ground(s, nullptr, nullptr); }},
      {"ground NaN", refused,
       [](pptam_system* s, Frame) {
         const float px[2] = {kNotANumber, 1};
         return pptam_set_ground(s, px, nullptr);
       }},
      {"ground outside", refused,
       [](pptam_system* s, Frame) {
         const float px[2] = {-1, 1e30f};
         return pptam_set_ground(s, px, nullptr);
       }},
      {"length NaN", refused, [](pptam_system* s, Frame) { return pptam_set_length(s, 1, 2, kNotANumber); }},
      {"length between a point and itself", refused,
       [](pptam_system* s, Frame) { return pptam_set_length(s, 1, 1, 1); }},
      {"length between no points", refused,
       [](pptam_system* s, Frame) { return pptam_set_length(s, 4000000000u, 4000000001u, 1); }},
      {"keyframes without a count", refused,
       [](pptam_system* s, Frame) { return pptam_keyframes(s, 0, nullptr, 0, nullptr); }},
      {"keyframes to nowhere", refused,
       [](pptam_system* s, Frame) { return pptam_keyframes(s, 0, nullptr, 5, &count); }},
      {"map points to nowhere", refused,
       [](pptam_system* s, Frame) { return pptam_map_points(s, 0, nullptr, SIZE_MAX, &count); }},
      {"measurements without a count", refused,
       [](pptam_system* s, Frame) { return pptam_measurements(s, 0, nullptr, 0, nullptr); }},
      {"observed points to nowhere", refused,
       [](pptam_system* s, Frame) { return pptam_observed_points(s, nullptr, 1, &count); }},
      {"image of no keyframe", refused,
       [](pptam_system* s, Frame) {
         pptam_image image = {nullptr, 7, 7, 7};
         const pptam_status status = pptam_keyframe_image(s, 4000000000u, &image);
         EXPECT_EQ(image.width, 7);
         return status;
       }},
      {"image to nowhere", refused, [](pptam_system* s, Frame) { return pptam_keyframe_image(s, 1, nullptr); }},
      {"fit to nowhere", refused, [](pptam_system* s, Frame) { return pptam_map_fit(s, nullptr, numbers); }},
      {"parts to nowhere", refused, [](pptam_system* s, Frame) { return pptam_map_parts(s, 12, nullptr); }},
      {"saving to nowhere", refused, [](pptam_system* s, Frame) { return pptam_save_map(s, nullptr, 100, &bytes); }},
      {"saving without a size", refused, [](pptam_system* s, Frame) { return pptam_save_map(s, numbers, 0, nullptr); }},
      {"saving into too little", PPTAM_OUT_OF_MEMORY,
       [](pptam_system* s, Frame) {
         bytes = 77;
         const pptam_status status = pptam_save_map(s, numbers, sizeof numbers, &bytes);
         EXPECT_EQ(bytes, 77u);
         return status;
       }},
      {"loading nothing", PPTAM_BAD_FILE, [](pptam_system* s, Frame) { return pptam_load_map(s, nullptr, 0); }},
      {"loading from nowhere", refused, [](pptam_system* s, Frame) { return pptam_load_map(s, nullptr, 100); }},
      {"loading an image", PPTAM_BAD_FILE,
       [](pptam_system* s, Frame f) { return pptam_load_map(s, f.data, static_cast<size_t>(f.width * f.height)); }},
  };
}

std::vector<Hostile> hostile_numbers() {
  static float numbers[6];
  static bool visible;
  static const pptam_pose rest = {{1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 0}};
  using Frame = const pptam_frame&;
  const int32_t refused = PPTAM_INVALID_ARGUMENT;
  return {
      {"a pose of no numbers", refused,
       [](pptam_system* s, Frame) {
         pptam_pose bad = rest;
         bad.t[1] = kNotANumber;
         return pptam_project(s, &bad, numbers, numbers, numbers, &visible);
       }},
      {"a pose that is no rotation", refused,
       [](pptam_system* s, Frame) {
         pptam_pose bad = rest;
         bad.R[4] = -1;
         return pptam_project(s, &bad, numbers, numbers, numbers, &visible);
       }},
      {"a turn that is endless", refused,
       [](pptam_system* s, Frame) {
         const float fast[6] = {0, 0, 0, 0, kEndless, 0};
         return pptam_project(s, &rest, fast, numbers, numbers, &visible);
       }},
      {"a quaternion of no rotation", refused,
       [](pptam_system*, Frame) {
         const pptam_pose none = {};
         return pptam_inverse_as_quaternion(&none, numbers, numbers);
       }},
      {"a ray of no pixel", refused,
       [](pptam_system* s, Frame) {
         const float px[2] = {kNotANumber, 0};
         return pptam_unproject(s, px, numbers);
       }},
      {"a configuration to nowhere", refused, [](pptam_system* s, Frame) { return pptam_get_config(s, nullptr); }},
      {"header of an image", PPTAM_BAD_FILE,
       [](pptam_system*, Frame f) {
         pptam_map_info info;
         info.version = 77;
         const pptam_status status = pptam_read_map_info(f.data, 5000, &info);
         EXPECT_EQ(info.version, 77);
         return status;
       }},
  };
}

// A map of the same desk, cut short, and with a byte altered.
std::vector<Hostile> hostile_maps(std::vector<unsigned char>* file) {
  return {
      {"a map cut short", PPTAM_BAD_FILE,
       [file](pptam_system* s, const pptam_frame&) { return pptam_load_map(s, file->data(), file->size() - 1); }},
      {"a map with a changed byte", PPTAM_BAD_FILE,
       [file](pptam_system* s, const pptam_frame&) {
         unsigned char& byte = (*file)[file->size() / 2];
         byte ^= 1;
         const pptam_status status = pptam_load_map(s, file->data(), file->size());
         byte ^= 1;
         return status;
       }},
  };
}

// What a run is made of: each frame's result and the map after it. Between frames what `hostile` does.
std::vector<uint64_t> run(const std::vector<Hostile>& hostile, int frames_to_misuse) {
  const test::Recording& frames = desk_recording();
  CPhone system(c_config_for(frames));
  std::vector<uint64_t> trace;
  EXPECT_EQ(pptam_tap(system).code, PPTAM_OK);
  int poses = 0;
  for (int i = 0; i < frames.size(); ++i) {
    const pptam_frame frame = c_frame(frames.frame(i));
    pptam_track_result result;
    EXPECT_EQ(pptam_track(system, &frame, &result).code, PPTAM_OK);
    poses += result.pose_valid;
    for (int slice = 0; slice < 60; ++slice) EXPECT_EQ(pptam_work_slice(system).code, PPTAM_OK);
    // Of a finished map: without one some calls say that instead.
    if (result.map > 0 && frames.size() - i <= frames_to_misuse)
      for (const Hostile& h : hostile) expect_refused(h.call(system, frame), h.code, h.name);
    int32_t observed = 0;
    EXPECT_EQ(pptam_observed_points(system, nullptr, 0, &observed).code, PPTAM_OK);
    EXPECT_EQ(observed, result.observed_points) << "refused frames leave the last frame's points";
    uint64_t numbers[4] = {pptam_map_hash(system), static_cast<uint64_t>(result.points_found), 0, 0};
    std::memcpy(&numbers[2], result.T_cw.t, sizeof result.T_cw.t);
    trace.insert(trace.end(), numbers, numbers + 4);
  }
  EXPECT_GT(poses, 20) << "the run must have a map, or nothing is compared";
  return trace;
}

TEST(CHostile, RefusedCallsChangeNothing) {
  const test::Recording& frames = desk_recording();
  std::vector<unsigned char> file;
  {
    CPhone system(c_config_for(frames));
    ASSERT_EQ(pptam_tap(system).code, PPTAM_OK);
    for (int i = 0; i < frames.size(); ++i) {
      const pptam_frame frame = c_frame(frames.frame(i));
      pptam_track_result result;
      ASSERT_EQ(pptam_track(system, &frame, &result).code, PPTAM_OK);
      while (pptam_has_work(system)) ASSERT_EQ(pptam_work_slice(system).code, PPTAM_OK);
    }
    file.resize(pptam_map_bytes(system));
    size_t bytes = 0;
    ASSERT_EQ(pptam_save_map(system, file.data(), file.size(), &bytes).code, PPTAM_OK);

    pptam_config other = c_config_for(frames);
    other.camera.fx *= 1.01f;
    CPhone stranger(other);
    expect_refused(pptam_load_map(stranger, file.data(), file.size()), PPTAM_CONFIG_MISMATCH, "another camera's map");
    EXPECT_EQ(pptam_map_bytes(stranger), 0u);
    size_t none = 77;
    expect_refused(pptam_save_map(stranger, file.data(), file.size(), &none), PPTAM_NOT_READY, "no map");
    expect_refused(pptam_set_length(stranger, 1, 2, 1), PPTAM_NOT_READY, "no map");
    EXPECT_EQ(none, 77u);
    int32_t count = 77;
    EXPECT_EQ(pptam_keyframes(stranger, -1, nullptr, 0, &count).code, PPTAM_OK) << "a map that is not kept has none";
    EXPECT_EQ(count, 0);
  }
  std::vector<Hostile> all = hostile_frames();
  for (const auto& more : {hostile_calls(), hostile_numbers(), hostile_maps(&file)})
    all.insert(all.end(), more.begin(), more.end());
  ASSERT_GE(all.size(), 24u);
  EXPECT_TRUE(run({}, 0) == run(all, frames.size()));
  // The comparison can fail: a tap is no refused call.
  const Hostile tap = {"tap", PPTAM_INVALID_ARGUMENT, [](pptam_system* s, const pptam_frame&) {
                         EXPECT_EQ(pptam_tap(s).code, PPTAM_OK);
                         return pptam_status{PPTAM_INVALID_ARGUMENT, "as if refused"};
                       }};
  EXPECT_FALSE(run({}, 0) == run({tap}, 5));
}

TEST(CHostile, SystemsSideBySideDoNotMeet) {
  const test::Recording& frames = desk_recording();
  pptam_config other_config = c_config_for(frames);
  other_config.max_keyframes = 6;
  other_config.initial_baseline = 0.2f;
  const auto alone = [&](const pptam_config& config) {
    CPhone system(config);
    EXPECT_EQ(pptam_tap(system).code, PPTAM_OK);
    for (int i = 0; i < frames.size(); ++i) {
      const pptam_frame frame = c_frame(frames.frame(i));
      pptam_track_result result;
      EXPECT_EQ(pptam_track(system, &frame, &result).code, PPTAM_OK);
      for (int slice = 0; slice < 30; ++slice) EXPECT_EQ(pptam_work_slice(system).code, PPTAM_OK);
    }
    return pptam_map_hash(system);
  };
  CPhone first(c_config_for(frames)), second(other_config);
  EXPECT_EQ(pptam_tap(first).code, PPTAM_OK);
  EXPECT_EQ(pptam_tap(second).code, PPTAM_OK);
  for (int i = 0; i < frames.size(); ++i) {
    const pptam_frame frame = c_frame(frames.frame(i));
    pptam_track_result result;
    EXPECT_EQ(pptam_track(first, &frame, &result).code, PPTAM_OK);
    EXPECT_EQ(pptam_track(second, &frame, &result).code, PPTAM_OK);
    for (int slice = 0; slice < 30; ++slice) {
      EXPECT_EQ(pptam_work_slice(second).code, PPTAM_OK);
      EXPECT_EQ(pptam_work_slice(first).code, PPTAM_OK);
    }
  }
  EXPECT_EQ(pptam_map_hash(first), alone(c_config_for(frames)));
  EXPECT_EQ(pptam_map_hash(second), alone(other_config));
  EXPECT_NE(pptam_map_hash(first), pptam_map_hash(second));
}

int64_t count_up(void* user) {
  return ++*static_cast<int64_t*>(user);
}

// Copies into an array of `room` entries, which are followed by rubbish that must stay.
template <class T, class Copy>
void expect_within(size_t room, const Copy& copy) {
  std::vector<T> out(room + 1);
  std::memset(static_cast<void*>(&out[room]), 0x5a, sizeof(T));
  const T behind = out[room];
  int32_t count = -1;
  const pptam_status status = copy(out.data(), room, &count);
  EXPECT_EQ(status.code, PPTAM_OK) << status.message;
  EXPECT_GE(count, 0);
  EXPECT_EQ(std::memcmp(&behind, &out[room], sizeof(T)), 0);
}

// Calls of any kind, mostly frames of the sequence as it goes on, so that maps come to be.
class RandomCaller {
 public:
  explicit RandomCaller(const pptam_config& config) : system_(config) {}

  pptam_status call() {
    switch (std::max(0, random_.integer(-40, 14))) {
      case 1:
      case 2:
      case 3:
        return change();
      case 4:
        return save();
      case 5:
        return load();
      case 6:
      case 7:
      case 8:
      case 9:
        return copy_out();
      case 10:
      case 11:
        return project();
      case 12:
      case 13:
        return bad_frame();
      case 14:
        for (int i = random_.integer(0, 60); i > 0; --i) pptam_work_slice(system_);
        return {PPTAM_OK, ""};
      default:
        return good_frame();
    }
  }

  int poses = 0, loaded = 0;  // counts
  int64_t ticks = 0;          // of the clock

 private:
  pptam_status change() {
    const auto id = static_cast<uint32_t>(random_.integer(0, 300));
    const float lengths[] = {0.1f, 0, -1, kNotANumber, 1e30f, 1e-30f};
    switch (random_.integer(0, 12)) {
      case 0:
        return pptam_tap(system_);
      case 1:
        return pptam_reset(system_);
      case 2:
      case 3:
        return pptam_set_clock(system_, random_.integer(0, 1) == 0 ? nullptr : count_up, &ticks);
      case 4:
      case 5:
        return pptam_set_locked(system_, random_.integer(0, 4) == 0);
      default:
        return pptam_set_length(system_, id, id + 1, lengths[random_.integer(0, 5)]);
    }
  }
  pptam_status save() {
    std::vector<unsigned char> saved(pptam_map_bytes(system_));
    size_t bytes = 0;
    const pptam_status status = pptam_save_map(system_, saved.data(), saved.size(), &bytes);
    if (status.code == PPTAM_OK) file_ = saved;
    return status;
  }
  pptam_status load() {  // mostly with a changed byte
    std::vector<unsigned char> changed = file_;
    if (!changed.empty() && random_.integer(0, 2) > 0)
      changed[static_cast<size_t>(random_.integer(0, static_cast<int>(changed.size()) - 1))] ^= 4;
    const pptam_status status = pptam_load_map(system_, changed.data(), changed.size());
    loaded += status.code == PPTAM_OK;
    return status;
  }
  pptam_status copy_out() {
    const auto room = static_cast<size_t>(random_.integer(0, 40));
    const int32_t map = random_.integer(-1, 3);
    expect_within<pptam_keyframe>(room, [&](auto... a) { return pptam_keyframes(system_, map, a...); });
    expect_within<pptam_map_point>(room, [&](auto... a) { return pptam_map_points(system_, map, a...); });
    expect_within<pptam_measurement>(room, [&](auto... a) { return pptam_measurements(system_, map, a...); });
    expect_within<pptam_observed_point>(room, [&](auto... a) { return pptam_observed_points(system_, a...); });
    pptam_image image;
    return pptam_keyframe_image(system_, static_cast<uint32_t>(random_.integer(0, 40)), &image);
  }
  pptam_status project() {
    float numbers[12], px[2];  // position, velocity, point
    const float sizes[] = {1, 1e9f, 1e20f, kEndless};
    for (float& number : numbers)
      number = static_cast<float>(random_.uniform(-1, 1)) * sizes[std::max(0, random_.integer(-60, 3))];
    pptam_pose pose = {{1, 0, 0, 0, 1, 0, 0, 0, 1}, {numbers[0], numbers[1], numbers[2]}};
    if (random_.integer(0, 4) == 0) pose.R[random_.integer(0, 8)] = kNotANumber;
    bool visible = false;
    const pptam_status status = pptam_project(system_, &pose, numbers + 3, numbers + 9, px, &visible);
    if (status.code == PPTAM_OK && visible) {
      EXPECT_TRUE(std::isfinite(px[0]) && std::isfinite(px[1]));
    }
    return status;
  }
  pptam_status bad_frame() {
    pptam_frame frame = c_frame(desk_recording().frame(cursor_, now_ns_ + 1));
    int32_t* const fields[] = {&frame.width, &frame.height, &frame.stride_bytes, &frame.format};
    *fields[random_.integer(0, 3)] = random_.integer(-300, 200);  // no stride that reaches beyond the pixels
    pptam_track_result result;
    const pptam_status status = pptam_track(system_, &frame, &result);
    if (status.code == PPTAM_OK) now_ns_ = frame.timestamp_ns;  // grey by another name
    return status;
  }
  pptam_status good_frame() {
    cursor_ = (cursor_ + 1) % desk_recording().size();
    now_ns_ += 66666667;
    const pptam_frame frame = c_frame(desk_recording().frame(cursor_, now_ns_));
    pptam_track_result result;
    const pptam_status status = pptam_track(system_, &frame, &result);
    EXPECT_EQ(status.code, PPTAM_OK) << status.message;
    poses += result.pose_valid;
    for (const float number : result.T_cw.R) EXPECT_TRUE(std::isfinite(number));
    for (int i = 0; i < 20; ++i) pptam_work_slice(system_);
    return status;
  }

  test::Random random_;
  CPhone system_;
  std::vector<unsigned char> file_;
  int64_t now_ns_ = 0;
  int cursor_ = 0;
};

TEST(CHostile, AnySequenceOfCallsIsHarmless) {
  pptam_config config = c_config_for(desk_recording());
  config.max_keyframes = 6;  // small pools, so that they fill
  config.max_map_points = 120;
  config.auto_start = true;
  RandomCaller caller(config);
  int codes[PPTAM_CONFIG_MISMATCH + 1] = {};
  for (int step = 0; step < 1500 && !HasFailure(); ++step) {
    const pptam_status status = caller.call();
    ASSERT_GE(status.code, PPTAM_OK);
    ASSERT_LE(status.code, PPTAM_CONFIG_MISMATCH);
    ASSERT_EQ(status.code == PPTAM_OK, status.message[0] == '\0') << status.message;
    ++codes[status.code];
  }
  // It went through all that, or nothing was tested.
  EXPECT_GT(caller.poses, 50);
  EXPECT_GT(caller.loaded, 0);
  EXPECT_GT(caller.ticks, 0);
  EXPECT_GT(codes[PPTAM_INVALID_ARGUMENT], 20);
  EXPECT_GT(codes[PPTAM_TIME_WENT_BACKWARDS] + codes[PPTAM_BAD_FILE], 0);
}

}  // namespace
}  // namespace pptam
