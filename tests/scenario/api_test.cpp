// The API in careless hands: refused calls change nothing, absurd settings are refused, taps and resets may come at any
// time, and random use never breaks a promise of pocket_ptam.h.
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <functional>
#include <limits>
#include <vector>

#include <pocket_ptam/inspection.h>
#include "image/pyramid.h"
#include "tests/support/random.h"
#include "tests/support/recording.h"

namespace pptam {
namespace {

using test::desk_recording;
using test::Phone;
using test::Recording;
using test::Trace;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();

TEST(Api, RefusedFramesChangeNothing) {
  const Recording& frames = desk_recording();
  const auto run = [&](bool misuse) {
    Phone phone(test::config_for(frames));
    phone->tap();
    Trace trace;
    int poses = 0;
    for (int i = 0; i < frames.size(); ++i) {
      const Frame good = frames.frame(i);
      const TrackResult result = phone->track(good);
      EXPECT_TRUE(result.status.ok());
      poses += result.pose_valid;
      trace.add(result);
      if (misuse) {
        std::vector<Frame> bad(14, good);
        for (Frame& frame : bad) frame.timestamp_ns += 1;
        bad[0].data = nullptr;
        bad[1].width = 239;
        bad[2].height = 321;
        bad[3].width = -240;
        bad[4].height = 0;
        bad[5].stride_bytes = 239;
        bad[6].stride_bytes = 0;
        bad[7].stride_bytes = -240;
        bad[8].format = PixelFormat::kBgra;  // whose rows would need 960 bytes
        bad[9].format = PixelFormat::kYuyv;
        bad[10].format = static_cast<PixelFormat>(200);
        bad[11].timestamp_ns = good.timestamp_ns;  // the same time again
        bad[12].timestamp_ns = good.timestamp_ns - 1;
        bad[13].timestamp_ns = std::numeric_limits<int64_t>::min();
        for (size_t k = 0; k < bad.size(); ++k) {
          const TrackResult refused = phone->track(bad[k]);
          EXPECT_FALSE(refused.status.ok()) << k;
          EXPECT_EQ(refused.status.code(), k >= 11 ? StatusCode::kTimeWentBackwards : StatusCode::kInvalidArgument)
              << k;
          EXPECT_FALSE(refused.pose_valid) << k;
          EXPECT_NE(refused.status.message()[0], '\0') << k;
        }
      }
      for (int slice = 0; slice < 60; ++slice) phone->work_slice();
      trace.add_value(static_cast<int64_t>(map_hash(*phone)));
    }
    EXPECT_GT(poses, 20) << "the run must have a map, or nothing is compared";
    return trace;
  };
  EXPECT_TRUE(run(false) == run(true));
}

TEST(Api, AcceptedFormatsOfTheSameGreyGiveTheSameResult) {
  const Recording& frames = desk_recording();
  const auto run = [&](PixelFormat format, int padding) {
    const int bytes = format == PixelFormat::kBgra ? 4 : format == PixelFormat::kRgb24 ? 3 : 1;
    Phone phone(test::config_for(frames));
    phone->tap();
    Trace trace;
    for (int i = 0; i < 20; ++i) {
      Frame frame = frames.frame(i);
      const int stride = frame.width * bytes + padding;
      std::vector<uint8_t> pixels(static_cast<size_t>(stride) * static_cast<size_t>(frame.height), 77);
      for (int y = 0; y < frame.height; ++y)
        for (int x = 0; x < frame.width * bytes; ++x)
          pixels[static_cast<size_t>(y * stride + x)] = frame.data[y * frame.stride_bytes + x / bytes];
      frame.data = pixels.data();
      frame.stride_bytes = stride;
      frame.format = format;
      trace.add(phone->track(frame));
    }
    return trace;
  };
  const Trace grey = run(PixelFormat::kGrey, 0);
  EXPECT_TRUE(run(PixelFormat::kGrey, 13) == grey);
  EXPECT_TRUE(run(PixelFormat::kBgra, 4) == grey);
  EXPECT_TRUE(run(PixelFormat::kRgb24, 1) == grey);
  EXPECT_TRUE(run(PixelFormat::kNv12, 0) == grey);
}

TEST(Api, AbsurdConfigurationsAreRefused) {
  const Config good = test::config_for(desk_recording());
  ASSERT_TRUE(good.validate().ok());
  const std::vector<std::function<void(Config&)>> changes = {
      [](Config& c) { c.camera.model.width = 0; },
      [](Config& c) { c.camera.model.width = -240; },
      [](Config& c) { c.camera.model.width = 63; },
      [](Config& c) { c.camera.model.height = 4097; },
      [](Config& c) { c.camera.model.height = std::numeric_limits<int>::max(); },
      [](Config& c) { c.camera.model.fx = 0; },
      [](Config& c) { c.camera.model.fy = -300; },
      [](Config& c) { c.camera.model.fx = kNan; },
      [](Config& c) { c.camera.model.cx = kInfinity; },
      [](Config& c) { c.camera.model.cy = -5; },
      [](Config& c) { c.camera.model.distortion = static_cast<Distortion>(99); },
      [](Config& c) {
        c.camera.model.distortion = Distortion::kFov;
        c.camera.model.coeffs[0] = kNan;
      },
      [](Config& c) {
        c.camera.model.distortion = Distortion::kRadTan;
        c.camera.model.coeffs[0] = -30;
      },
      [](Config& c) { c.camera.shutter.line_time_s = kNan; },
      [](Config& c) { c.camera.shutter.line_time_s = kInfinity; },
      [](Config& c) { c.camera.shutter.line_time_s = 0.06f; },  // the readout, mistaken for a line
      [](Config& c) { c.exposure_s = -0.01f; },
      [](Config& c) { c.exposure_s = kNan; },
      [](Config& c) { c.exposure_s = 30; },  // milliseconds
      [](Config& c) { c.max_keyframes = 2; },
      [](Config& c) { c.max_keyframes = std::numeric_limits<int>::max(); },
      [](Config& c) { c.max_keyframes = -1; },
      [](Config& c) { c.max_map_points = 0; },
      [](Config& c) { c.max_map_points = std::numeric_limits<int>::max(); },
      [](Config& c) { c.max_measurements = -1; },
      [](Config& c) { c.max_measurements = std::numeric_limits<int>::max(); },
      [](Config& c) { c.max_measurements_per_point = 1; },
      [](Config& c) { c.max_measurements_per_point = -8; },
      [](Config& c) { c.max_measurements_per_point = 33; },
      [](Config& c) { c.max_measurements_per_point = std::numeric_limits<int>::max(); },
      [](Config& c) { c.cells_x = 0; },
      [](Config& c) { c.cells_x = 17; },
      [](Config& c) { c.cells_y = -1; },
      [](Config& c) { c.cells_y = std::numeric_limits<int>::max(); },
      [](Config& c) { c.search_level = -1; },
      [](Config& c) { c.search_level = c.coarse_search_level = kPyramidLevels; },
      [](Config& c) { c.search_level = c.coarse_search_level + 1; },  // the finer one
      [](Config& c) { c.coarse_search_level = -1; },
      [](Config& c) { c.coarse_search_level = kPyramidLevels; },
      [](Config& c) { c.max_partial_points = -1; },
      [](Config& c) { c.max_partial_points = std::numeric_limits<int>::max(); },
      [](Config& c) { c.max_measured_points = 0; },
      [](Config& c) { c.max_measured_points = 100000; },
      [](Config& c) { c.max_partial_searches = -1; },
      [](Config& c) { c.max_new_partial_points = -1; },
      [](Config& c) { c.max_initial_points = 3; },
      [](Config& c) { c.max_initial_points = 100000; },
      [](Config& c) { c.initial_baseline = 0; },
      [](Config& c) { c.initial_baseline = kNan; },
      [](Config& c) { c.initial_baseline = -0.1f; },
      [](Config& c) { c.initial_plane_distance = -1; },
      [](Config& c) { c.initial_plane_distance = kNan; },
      [](Config& c) { c.min_keyframe_interval_s = -1; },
      [](Config& c) { c.min_keyframe_interval_s = kNan; },
      [](Config& c) { c.profile.clock_mhz = 0; },
      [](Config& c) { c.profile.clock_mhz = kNan; },
      [](Config& c) { c.profile.cycles_per_instruction = -1; },
  };
  std::vector<std::max_align_t> memory(System::required_bytes(good) / sizeof(std::max_align_t) + 1);
  System* const untouched = reinterpret_cast<System*>(&memory);
  for (size_t i = 0; i < changes.size(); ++i) {
    Config config = good;
    changes[i](config);
    const Status status = config.validate();
    EXPECT_FALSE(status.ok()) << i;
    EXPECT_NE(status.message()[0], '\0') << i;
    EXPECT_EQ(System::required_bytes(config), 0u) << i;
    System* system = untouched;
    EXPECT_FALSE(System::create(config, std::as_writable_bytes(std::span(memory)), &system).ok()) << i;
    EXPECT_EQ(system, untouched) << i << ": set only on success";
  }
}

TEST(Api, MemoryMustBeEnoughAndAligned) {
  const Config config = test::config_for(desk_recording());
  const size_t bytes = System::required_bytes(config);
  std::vector<std::max_align_t> memory(bytes / sizeof(std::max_align_t) + 3);
  const std::span<std::byte> all = std::as_writable_bytes(std::span(memory));
  const auto create = [&](std::span<std::byte> block) {
    System* system = nullptr;
    const Status status = System::create(config, block, &system);
    EXPECT_EQ(status.ok(), system != nullptr);
    return status.code();
  };
  EXPECT_EQ(create(all.first(bytes)), StatusCode::kOk);
  EXPECT_EQ(create(all.first(bytes - 1)), StatusCode::kOutOfMemory);
  EXPECT_EQ(create(all.first(0)), StatusCode::kOutOfMemory);
  EXPECT_EQ(create({}), StatusCode::kOutOfMemory);
  for (size_t shift = 1; shift < 16; ++shift)
    EXPECT_EQ(create(all.subspan(shift, bytes)), StatusCode::kInvalidArgument) << shift;
  EXPECT_EQ(create(all.subspan(16, bytes)), StatusCode::kOk);
}

TEST(Api, OutputsNeverPassTheirSpan) {
  const Recording& frames = desk_recording();
  Phone phone(test::config_for(frames));
  phone->tap();
  for (int i = 0; i < frames.size(); ++i) {
    const TrackResult result = phone->track(frames.frame(i));
    ASSERT_TRUE(result.status.ok());
    phone.drain();
  }
  std::vector<KeyframeInfo> keyframes(100);
  std::vector<MapPointInfo> points(2000);
  const int keyframe_count = phone->keyframes(keyframes);
  const int point_count = phone->map_points(points);
  ASSERT_GE(keyframe_count, 3);
  ASSERT_GE(point_count, 20);
  for (const int room : {0, 1, 2}) {
    std::vector<KeyframeInfo> few_keyframes(static_cast<size_t>(room));
    std::vector<MapPointInfo> few_points(static_cast<size_t>(room));
    EXPECT_EQ(phone->keyframes(few_keyframes), keyframe_count);
    EXPECT_EQ(phone->map_points(few_points), point_count);
    for (size_t i = 0; i < few_points.size(); ++i) EXPECT_EQ(few_points[i].id, points[i].id);
  }
  for (int i = 1; i < keyframe_count; ++i)
    EXPECT_LT(keyframes[static_cast<size_t>(i) - 1].id, keyframes[static_cast<size_t>(i)].id) << "in the order of ids";
}

// What holds after every call, whatever came before.
void expect_promises(const TrackResult& result, const Config& config) {
  ASSERT_TRUE(result.status.ok());
  if (result.pose_valid) {
    EXPECT_EQ(result.state, TrackingState::kTracking);
    EXPECT_NE(result.quality, TrackingQuality::kBad);
    EXPECT_TRUE(result.T_cw.t.allFinite());
    EXPECT_TRUE(result.covariance.allFinite());
    // Re-orthonormalised in every frame: a few roundings of 6e-8 for each of nine entries.
    EXPECT_LT((result.T_cw.R * result.T_cw.R.transpose() - Matrix3f::Identity()).norm(), 1e-5f);
  }
  EXPECT_GE(result.progress, 0.0f);
  EXPECT_LE(result.progress, 1.0f);
  EXPECT_LE(result.keyframes, config.max_keyframes);
  EXPECT_LE(result.map_points, config.max_map_points);
  EXPECT_LE(result.points_found, result.points_attempted);
  EXPECT_LE(result.points_inliers, result.points_found);
  if (result.pose_valid) {  // a start may search more
    EXPECT_LE(result.points_attempted + result.partial_attempted,
              config.max_measured_points + config.max_partial_searches);
  }
  for (const ObservedPoint& point : result.points) {
    EXPECT_TRUE(point.px.allFinite());
    EXPECT_TRUE(point.predicted_px.allFinite());
  }
}

TEST(Api, RandomUseKeepsEveryPromise) {
  const Recording& frames = desk_recording();
  test::Random random;
  Config config = test::config_for(frames);
  config.max_keyframes = 6;  // small pools, so that they fill
  config.max_map_points = 120;
  config.max_partial_points = 20;
  Phone phone(config);
  Recording scratch = frames;
  int64_t now_ns = random.integer(-1000000, 1000000);
  int cursor = 0, tracked = 0, maps = 0, lost = 0;
  uint32_t limits = 0;
  bool had_map = false;
  phone->tap();
  for (int step = 0; step < 1500; ++step) {
    const int what = random.integer(0, 99);
    if (what < 1) {
      phone->tap();
    } else if (what < 2) {
      phone->reset();
    } else if (what < 30) {
      for (int i = random.integer(0, 60); i > 0; --i) phone->work_slice();  // stops in the middle of jobs
    } else {
      // Mostly the sequence as it goes on, so that maps come to be; sometimes a jump, a covered lens, noise.
      const int kind = random.integer(0, 199);
      if (kind < 2) cursor = random.integer(0, frames.size() - 1);
      cursor = (cursor + 1) % frames.size();
      Frame frame = frames.frame(cursor);
      std::vector<uint8_t>& pixels = scratch.images[0];
      if (kind >= 2 && kind < 8) {
        std::fill(pixels.begin(), pixels.end(), static_cast<uint8_t>(kind < 4 ? 0 : 255));
        frame.data = pixels.data();
      } else if (kind >= 8 && kind < 12) {
        for (uint8_t& pixel : pixels) pixel = static_cast<uint8_t>(random.integer(0, 255));
        frame.data = pixels.data();
      }
      const int64_t steps_ns[] = {1, 1000000, 4000000000, 66666667};
      now_ns += steps_ns[std::min(3, random.integer(0, 200))];
      frame.timestamp_ns = now_ns;
      const TrackResult result = phone->track(frame);
      expect_promises(result, config);
      if (::testing::Test::HasFailure()) return;
      tracked += result.pose_valid;
      lost += result.state == TrackingState::kLost;
      maps += result.keyframes > 0 && !had_map;
      had_map = result.keyframes > 0;
      limits |= result.limits_hit;
    }
    if (step % 50 == 0) {
      std::vector<MapPointInfo> points(static_cast<size_t>(config.max_map_points));
      const int count = phone->map_points(points);
      for (int i = 0; i < count; ++i) {
        EXPECT_TRUE(points[static_cast<size_t>(i)].p_w.allFinite());
        EXPECT_GE(points[static_cast<size_t>(i)].measurements, 1);
      }
    }
  }
  phone.drain();
  // It went through the states, or nothing was tested.
  EXPECT_GT(tracked, 20);
  EXPECT_GT(maps, 1);
  EXPECT_GT(lost, 0);
  EXPECT_NE(limits & (kLimitKeyframes | kLimitPartialPoints | kLimitMapPoints), 0u);

  // And it still works: from the beginning of the sequence a map is made as if nothing had been.
  phone->tap();
  bool pose = false;
  for (int i = 0; i < frames.size(); ++i) {
    now_ns += 66666667;
    pose |= phone->track(frames.frame(i, now_ns)).pose_valid;
    phone.drain();
  }
  EXPECT_TRUE(pose);
}

TEST(Api, ProfilesThatGiveNoTimeAreRefused) {
  for (const float bad :
       {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity(), -1.0f, 1e30f}) {
    Config config = test::config_for(desk_recording());
    config.profile.instructions[0] = bad;
    EXPECT_FALSE(config.validate().ok()) << "instructions " << bad;
    config = test::config_for(desk_recording());
    config.profile.clock_mhz = bad;
    EXPECT_FALSE(config.validate().ok()) << "clock " << bad;
  }
  // Such work would soon be more than the meter's sum holds.
  for (const Work work : {Work::kGreyPixel, Work::kPyramidPixel, Work::kKeyframePixel}) {
    Config absurd = test::config_for(desk_recording());
    absurd.profile.instructions[static_cast<size_t>(work)] = 1e4f;
    EXPECT_TRUE(absurd.validate().ok()) << absurd.validate().message();
    absurd.profile.instructions[static_cast<size_t>(work)] = 5e4f;
    EXPECT_FALSE(absurd.validate().ok());
  }
  Config dear = test::config_for(desk_recording());
  dear.profile.instructions[static_cast<size_t>(Work::kPatchWarp)] = 1.1e5f;
  EXPECT_FALSE(dear.validate().ok());
  Config config = test::config_for(desk_recording());
  config.max_new_partial_points = 1000000;
  EXPECT_FALSE(config.validate().ok()) << "the message says 0 to 1000";
}

}  // namespace
}  // namespace pptam
