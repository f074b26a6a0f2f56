// The C interface gives what the C++ interface gives, bit for bit.
#include <gtest/gtest.h>

#include <algorithm>
#include <utility>
#include <vector>

#include <pocket_ptam/inspection.h>
#include <pocket_ptam/pocket_ptam_c.h>
#include "tests/support/c_phone.h"
#include "tests/support/recording.h"

namespace pptam {
namespace {

using test::c_config_for;
using test::c_frame;
using test::CPhone;
using test::desk_recording;
using test::Phone;
using test::Recording;

Vector3f vector_of(const float v[3]) {
  return {v[0], v[1], v[2]};
}

template <class T>
void append(std::vector<unsigned char>* bytes, const T& value) {
  const auto* p = reinterpret_cast<const unsigned char*>(&value);
  bytes->insert(bytes->end(), p, p + sizeof value);
}

// All that a frame's result says, without padding.
std::vector<unsigned char> bytes_of(const pptam_track_result& r) {
  std::vector<unsigned char> bytes;
  for (const int64_t number : {r.timestamp_ns,
                               int64_t{r.state},
                               int64_t{r.quality},
                               int64_t{r.hint},
                               int64_t{r.limits_hit},
                               int64_t{r.pose_valid},
                               int64_t{r.blurred},
                               int64_t{r.misfit},
                               int64_t{r.keyframe_added},
                               int64_t{r.repeated},
                               int64_t{r.points_attempted},
                               int64_t{r.points_found},
                               int64_t{r.points_inliers},
                               int64_t{r.partial_attempted},
                               int64_t{r.partial_found},
                               int64_t{r.map},
                               int64_t{r.maps},
                               int64_t{r.world_changes},
                               int64_t{r.keyframes},
                               int64_t{r.erased_keyframes},
                               int64_t{r.map_points},
                               int64_t{r.observed_points}})
    append(&bytes, number);
  append(&bytes, r.progress);
  append(&bytes, r.T_cw);
  append(&bytes, r.velocity);
  append(&bytes, r.covariance);
  append(&bytes, r.reprojection_px);
  append(&bytes, r.stage_ns);
  return bytes;
}

// The same of the C++ result, written down anew: a field that the C interface takes from another one shows.
std::vector<unsigned char> bytes_of(const TrackResult& r) {
  pptam_track_result c = {};
  c.timestamp_ns = r.timestamp_ns;
  c.state = static_cast<int>(r.state), c.quality = static_cast<int>(r.quality), c.hint = static_cast<int>(r.hint);
  c.limits_hit = r.limits_hit;
  c.pose_valid = r.pose_valid, c.blurred = r.blurred, c.misfit = r.misfit;
  c.keyframe_added = r.keyframe_added, c.repeated = r.repeated;
  c.points_attempted = r.points_attempted, c.points_found = r.points_found, c.points_inliers = r.points_inliers;
  c.partial_attempted = r.partial_attempted, c.partial_found = r.partial_found;
  c.map = r.map, c.maps = r.maps, c.world_changes = r.world_changes, c.keyframes = r.keyframes,
  c.erased_keyframes = r.erased_keyframes;
  c.map_points = r.map_points;
  c.observed_points = static_cast<int>(r.points.size());
  c.progress = r.progress;
  for (int i = 0; i < 9; ++i) c.T_cw.R[i] = r.T_cw.R(i / 3, i % 3);
  for (int i = 0; i < 3; ++i) c.T_cw.t[i] = r.T_cw.t(i);
  for (int i = 0; i < 6; ++i) c.velocity[i] = r.velocity(i);
  for (int i = 0; i < 36; ++i) c.covariance[i] = r.covariance(i / 6, i % 6);
  c.reprojection_px = r.reprojection_px;
  std::copy(std::begin(r.stage_ns), std::end(r.stage_ns), c.stage_ns);
  return bytes_of(c);
}

struct CountingClock final : Clock {
  int64_t now_ns() const override { return ++calls; }
  void idle_until(int64_t) override {}
  mutable int64_t calls = 0;
};
int64_t count_up(void* user) {
  return ++*static_cast<int64_t*>(user);
}

// What a tracer heard, in order.
struct Heard {
  std::vector<int64_t> events;
  void note(int64_t kind, int64_t what, int64_t value) { events.push_back((kind << 60) ^ (what << 48) ^ value); }
};
struct CppListener final : Tracer, Heard {
  void begin(Span span) override { note(1, static_cast<int64_t>(span), 0); }
  void end(Span span) override { note(2, static_cast<int64_t>(span), 0); }
  void count(Counter counter, int64_t value) override { note(3, static_cast<int64_t>(counter), value); }
};
void heard_begin(void* user, int32_t span) {
  static_cast<Heard*>(user)->note(1, span, 0);
}
void heard_end(void* user, int32_t span) {
  static_cast<Heard*>(user)->note(2, span, 0);
}
void heard_count(void* user, int32_t counter, int64_t value) {
  static_cast<Heard*>(user)->note(3, counter, value);
}

// Both have seen the same frames.
void expect_same_map(System& system, pptam_system* c) {
  EXPECT_EQ(pptam_map_hash(c), map_hash(system));
  const MapFit fit = map_fit(system);
  int32_t measurements = 0, parts = 0, count = 0;
  float cost = 0;
  EXPECT_EQ(pptam_map_fit(c, &measurements, &cost).code, PPTAM_OK);
  EXPECT_EQ(measurements, fit.measurements);
  EXPECT_EQ(cost, fit.cost);
  EXPECT_EQ(pptam_map_parts(c, 12, &parts).code, PPTAM_OK);
  EXPECT_EQ(parts, map_parts(system, 12));

  std::vector<KeyframeInfo> keyframes(100);
  std::vector<pptam_keyframe> c_keyframes(100);
  keyframes.resize(static_cast<size_t>(system.keyframes(keyframes)));
  ASSERT_EQ(pptam_keyframes(c, 0, c_keyframes.data(), c_keyframes.size(), &count).code, PPTAM_OK);
  ASSERT_EQ(count, static_cast<int>(keyframes.size()));
  ASSERT_GE(count, 3);
  for (size_t i = 0; i < keyframes.size(); ++i) {
    EXPECT_EQ(c_keyframes[i].id, keyframes[i].id);
    EXPECT_EQ(c_keyframes[i].timestamp_ns, keyframes[i].timestamp_ns);
    EXPECT_EQ(c_keyframes[i].T_cw.R[1], keyframes[i].T_cw.R(0, 1));
    EXPECT_EQ(c_keyframes[i].T_cw.t[2], keyframes[i].T_cw.t(2));
    pptam_image image = {};
    ASSERT_EQ(pptam_keyframe_image(c, c_keyframes[i].id, &image).code, PPTAM_OK);
    const GreyView view = system.keyframe_image(keyframes[i].id);
    ASSERT_EQ(image.width, view.width);
    ASSERT_EQ(image.height, view.height);
    EXPECT_EQ(image.data[image.stride_bytes + 5], view.at(5, 1));
  }

  std::vector<MapPointInfo> points(2000);
  std::vector<pptam_map_point> c_points(2000);
  points.resize(static_cast<size_t>(system.map_points(points, 1)));
  ASSERT_EQ(pptam_map_points(c, 1, c_points.data(), c_points.size(), &count).code, PPTAM_OK);
  ASSERT_EQ(count, static_cast<int>(points.size()));
  ASSERT_GE(count, 20);
  for (size_t i = 0; i < points.size(); ++i) {
    EXPECT_EQ(c_points[i].id, points[i].id);
    EXPECT_EQ(vector_of(c_points[i].p_w), points[i].p_w);
    EXPECT_EQ(vector_of(c_points[i].normal_w), points[i].normal_w);
    EXPECT_EQ(c_points[i].measurements, points[i].measurements);
    EXPECT_EQ(c_points[i].grey, points[i].grey);
  }
  // A smaller array takes the first ones, and what is behind it stays.
  std::vector<pptam_map_point> few(3);
  few[2].id = 77777;
  EXPECT_EQ(pptam_map_points(c, 0, few.data(), 2, &count).code, PPTAM_OK);
  EXPECT_EQ(count, static_cast<int>(points.size()));
  EXPECT_EQ(few[1].id, points[1].id);
  EXPECT_EQ(few[2].id, 77777u);

  std::vector<MeasurementInfo> seen(20000);
  std::vector<pptam_measurement> c_seen(20000);
  seen.resize(static_cast<size_t>(system.measurements(seen)));
  ASSERT_EQ(pptam_measurements(c, 0, c_seen.data(), c_seen.size(), &count).code, PPTAM_OK);
  ASSERT_EQ(count, static_cast<int>(seen.size()));
  for (size_t i = 0; i < seen.size(); ++i) {
    EXPECT_EQ(c_seen[i].point_id, seen[i].point_id);
    EXPECT_EQ(c_seen[i].keyframe_id, seen[i].keyframe_id);
    EXPECT_EQ(c_seen[i].px[1], seen[i].px.y());
    EXPECT_EQ(c_seen[i].global_px[0], seen[i].global_px.x());
    EXPECT_EQ(c_seen[i].sigma, seen[i].sigma);
  }
}

// The pixel of a map point through lens and shutter, and a pose as files have it.
void expect_same_drawing(System& system, pptam_system* c, const TrackResult& result) {
  pptam_map_point point;
  int32_t count = 0;
  ASSERT_EQ(pptam_map_points(c, 0, &point, 1, &count).code, PPTAM_OK);
  pptam_pose T_cw;
  for (int i = 0; i < 9; ++i) T_cw.R[i] = result.T_cw.R(i / 3, i % 3);
  for (int i = 0; i < 3; ++i) T_cw.t[i] = result.T_cw.t(i);
  PredictedPoint seen;
  const Camera& camera = system.config().camera;
  ASSERT_TRUE(camera.project_rolling(result.T_cw, result.velocity, vector_of(point.p_w), &seen));
  float px[2] = {}, ray[2] = {}, position[3] = {}, quaternion[4] = {};
  bool visible = false;
  ASSERT_EQ(pptam_project(c, &T_cw, result.velocity.data(), point.p_w, px, &visible).code, PPTAM_OK);
  EXPECT_TRUE(visible);
  EXPECT_EQ(Vector2f(px[0], px[1]), seen.px);
  ASSERT_EQ(pptam_unproject(c, px, ray).code, PPTAM_OK);
  EXPECT_EQ(Vector2f(ray[0], ray[1]), camera.unproject(seen.px));
  ASSERT_EQ(pptam_inverse_as_quaternion(&T_cw, position, quaternion).code, PPTAM_OK);
  EXPECT_EQ(vector_of(position), result.T_cw.centre());
  const Eigen::Quaternionf q(quaternion[3], quaternion[0], quaternion[1], quaternion[2]);
  // Some roundings of 6e-8 in each entry of a rotation.
  EXPECT_LT((q.toRotationMatrix() - result.T_cw.R.transpose()).norm(), 2e-6f);
}

// Saved maps are the same bytes, and each side loads the other's.
void expect_same_file(System& system, pptam_system* c) {
  std::vector<std::byte> file(system.map_bytes());
  std::vector<std::byte> c_file(pptam_map_bytes(c));
  size_t bytes = 0, c_bytes = 0;
  ASSERT_TRUE(system.save_map(file, &bytes).ok());
  ASSERT_EQ(pptam_save_map(c, c_file.data(), c_file.size(), &c_bytes).code, PPTAM_OK);
  EXPECT_EQ(c_bytes, bytes);
  EXPECT_EQ(c_file, file);
  pptam_map_info c_info;
  MapInfo info;
  ASSERT_TRUE(System::map_info(file, &info).ok());
  ASSERT_EQ(pptam_read_map_info(c_file.data(), c_file.size(), &c_info).code, PPTAM_OK);
  EXPECT_EQ(c_info.version, info.version);
  EXPECT_EQ(c_info.camera.fx, info.camera.model.fx);
  EXPECT_EQ(c_info.maps, info.maps);
  EXPECT_EQ(c_info.keyframes, info.keyframes);
  EXPECT_EQ(c_info.map_points, info.map_points);
  EXPECT_EQ(c_info.min_measurements_per_point, info.min_measurements_per_point);
  CPhone other(c_config_for(desk_recording()));
  ASSERT_EQ(pptam_load_map(other, file.data(), file.size()).code, PPTAM_OK);
  EXPECT_EQ(pptam_map_hash(other), pptam_map_hash(c));
}

// Changes the world of both.
void expect_same_ground(System& system, pptam_system* c) {
  std::vector<PlaneInfo> planes(kMostPlanes);
  planes.resize(static_cast<size_t>(system.planes(planes)));
  pptam_plane c_planes[kMostPlanes];
  int32_t count = 0;
  ASSERT_EQ(pptam_planes(c, 0, c_planes, kMostPlanes, &count).code, PPTAM_OK);
  ASSERT_EQ(count, static_cast<int>(planes.size()));
  ASSERT_GE(count, 1);
  EXPECT_EQ(vector_of(c_planes[0].normal_w), planes[0].normal_w);
  EXPECT_EQ(vector_of(c_planes[0].middle_w), planes[0].middle_w);
  EXPECT_EQ(c_planes[0].threshold, planes[0].threshold);
  EXPECT_EQ(c_planes[0].points, planes[0].points);
  const float px[2] = {120, 160};
  pptam_pose c_change = {};
  Similarity change;
  ASSERT_TRUE(system.set_ground(Vector2f(px[0], px[1]), &change).ok());
  ASSERT_EQ(pptam_set_ground(c, px, &c_change).code, PPTAM_OK);
  EXPECT_EQ(vector_of(c_change.t), change.T.t);
  EXPECT_EQ(c_change.R[1], change.T.R(0, 1));
  EXPECT_EQ(pptam_map_hash(c), map_hash(system));
}

TEST(CApi, GivesTheBitsOfTheCppInterface) {
  const Recording& frames = desk_recording();
  Phone phone(test::config_for(frames));
  CPhone c(c_config_for(frames));
  CountingClock clock;
  int64_t ticks = 0;
  phone->set_clock(&clock);
  ASSERT_EQ(pptam_set_clock(c, count_up, &ticks).code, PPTAM_OK);
  CppListener listener;
  Heard heard;
  const pptam_tracer tracer = {heard_begin, heard_end, heard_count, &heard};
  phone->set_tracer(&listener);
  ASSERT_EQ(pptam_set_tracer(c, &tracer).code, PPTAM_OK);
  phone->tap();
  ASSERT_EQ(pptam_tap(c).code, PPTAM_OK);
  TrackResult result;
  int poses = 0, hints = 0;
  for (int i = 0; i < frames.size(); ++i) {
    const pptam_frame frame = c_frame(frames.frame(i));
    pptam_track_result c_result;
    result = phone->track(frames.frame(i));
    ASSERT_EQ(pptam_track(c, &frame, &c_result).code, PPTAM_OK);
    ASSERT_EQ(bytes_of(c_result), bytes_of(result)) << "frame " << i;
    poses += result.pose_valid;
    hints += pptam_hint_text(c_result.hint)[0] != '\0';
    for (int slice = 0; slice < 60 && phone->has_work(); ++slice) {
      ASSERT_TRUE(pptam_has_work(c));
      phone->work_slice();
      ASSERT_EQ(pptam_work_slice(c).code, PPTAM_OK);
    }
  }
  EXPECT_GT(poses, 20) << "or nothing is compared";
  EXPECT_GT(hints, 0);
  EXPECT_GT(ticks, 0);
  EXPECT_EQ(ticks, clock.calls);
  EXPECT_GT(heard.events.size(), 1000u);
  EXPECT_EQ(heard.events, listener.events);
  std::vector<pptam_observed_point> observed(result.points.size());
  int32_t count = 0;
  ASSERT_EQ(pptam_observed_points(c, observed.data(), observed.size(), &count).code, PPTAM_OK);
  ASSERT_EQ(static_cast<size_t>(count), observed.size());
  ASSERT_GT(count, 20);
  for (size_t i = 0; i < observed.size(); ++i) {
    EXPECT_EQ(observed[i].px[0], result.points[i].px.x());
    EXPECT_EQ(observed[i].predicted_px[1], result.points[i].predicted_px.y());
    EXPECT_EQ(observed[i].point_id, result.points[i].point_id);
    EXPECT_EQ(observed[i].kind, static_cast<int>(result.points[i].kind));
    EXPECT_EQ(observed[i].level, result.points[i].level);
  }
  expect_same_map(*phone, c);
  const WorkMeter& meter = phone->work_meter();
  EXPECT_EQ(pptam_work_instructions(c), meter.instructions());
  EXPECT_EQ(pptam_work_ns(c), meter.modelled_ns());
  for (int i = 0; i < PPTAM_WORK_COUNT; ++i) EXPECT_EQ(pptam_work_units(c, i), meter.units(static_cast<Work>(i)));
  expect_same_drawing(*phone, c, result);
  expect_same_file(*phone, c);
  expect_same_ground(*phone, c);
}

TEST(CApi, ConfigurationsArriveWhole) {
  const Recording& frames = desk_recording();
  pptam_config config = c_config_for(frames);
  // Each number unlike its neighbours and the defaults, so that two that are mixed up show.
  config.camera.distortion = PPTAM_DISTORTION_RADTAN;
  for (int i = 0; i < 5; ++i) config.camera.coeffs[i] = 0.001f * static_cast<float>(i + 1);
  config.camera.shutter_axis = PPTAM_SHUTTER_COLUMNS;
  config.camera.line_time_s = -0.0001f;
  config.exposure_s = 0.0123f;
  int32_t* const ints[] = {&config.max_keyframes,      &config.max_erased_keyframes, &config.max_measurements,
                           &config.max_partial_points, &config.max_partial_searches, &config.max_new_partial_points};
  int next = 17;
  for (int32_t* number : ints) *number = next++;
  config.max_maps = 4, config.max_map_points = 321, config.max_measurements_per_point = 9;
  config.max_measured_points = 61, config.max_initial_points = 91;
  config.cells_x = 5, config.cells_y = 7, config.search_level = 2, config.coarse_search_level = 3;
  config.initial_baseline = 0.25f, config.initial_plane_distance = 1.5f;
  config.auto_start = true, config.steady_damping = false;
  config.min_keyframe_interval_s = 0.3f;
  config.profile.clock_mhz = 480, config.profile.cycles_per_instruction = 1.25f;
  for (int i = 0; i < PPTAM_WORK_COUNT; ++i) config.profile.instructions[i] = static_cast<float>(i + 1);
  CPhone phone(config);
  pptam_config read = {};
  ASSERT_EQ(pptam_get_config(phone, &read).code, PPTAM_OK);
  std::vector<unsigned char> given, got;
  for (auto [from, to] : {std::pair(&config, &given), std::pair(&read, &got)}) {
    append(to, from->camera);
    append(to, from->exposure_s);
    for (const int32_t number : {from->max_keyframes, from->max_erased_keyframes, from->max_maps, from->max_map_points,
                                 from->max_measurements, from->max_measurements_per_point, from->max_partial_points,
                                 from->max_measured_points, from->max_partial_searches, from->max_new_partial_points,
                                 from->max_initial_points, from->cells_x, from->cells_y, from->search_level,
                                 from->coarse_search_level, int32_t{from->auto_start}, int32_t{from->steady_damping}})
      append(to, number);
    for (const float number : {from->initial_baseline, from->initial_plane_distance, from->min_keyframe_interval_s})
      append(to, number);
    append(to, from->profile);
  }
  EXPECT_EQ(got, given);
  EXPECT_EQ(got.size(), sizeof(pptam_camera) + 4 * (1 + 17 + 3) + sizeof(pptam_phone_profile)) << "every field";

  // What the phone has by default is what the C++ interface has.
  const Config usual = Config::phone({});
  const pptam_config c_usual = c_config_for(frames);
  EXPECT_EQ(c_usual.max_keyframes, usual.max_keyframes);
  EXPECT_EQ(c_usual.max_maps, usual.max_maps);
  EXPECT_EQ(c_usual.min_keyframe_interval_s, usual.min_keyframe_interval_s);
  EXPECT_EQ(c_usual.steady_damping, usual.steady_damping);
  EXPECT_EQ(c_usual.profile.instructions[PPTAM_WORK_PATCH_WARP], usual.profile.instructions[6]);

  // And so has the tiny profile, for a camera that lies and one that stands.
  for (const bool lies : {false, true}) {
    pptam_camera camera = c_usual.camera;
    if (lies) std::swap(camera.width, camera.height);
    CameraModel model;
    model.width = camera.width;
    model.height = camera.height;
    const Config tiny = Config::tiny(model);
    pptam_config c_tiny;
    ASSERT_EQ(pptam_config_tiny(&camera, &c_tiny).code, PPTAM_OK);
    EXPECT_EQ(c_tiny.search_level, tiny.search_level);
    EXPECT_EQ(c_tiny.max_keyframes, tiny.max_keyframes);
    EXPECT_EQ(c_tiny.cells_x, tiny.cells_x);
    EXPECT_EQ(c_tiny.camera.width, camera.width);
  }
}

TEST(CApi, MemoryIsToldByItsParts) {
  const pptam_config config = c_config_for(desk_recording());
  pptam_memory_parts parts;
  ASSERT_EQ(pptam_required_parts(&config, &parts).code, PPTAM_OK);
  EXPECT_EQ(parts.map + parts.tracking + parts.mapping + parts.rest, pptam_required_bytes(&config));
  EXPECT_GT(parts.map, parts.tracking) << "most are keyframes' images";
  pptam_config fewer = config;
  --fewer.max_keyframes;
  pptam_memory_parts smaller;
  ASSERT_EQ(pptam_required_parts(&fewer, &smaller).code, PPTAM_OK);
  EXPECT_LT(smaller.map, parts.map);
  EXPECT_EQ(smaller.tracking, parts.tracking);

  fewer.max_keyframes = 0;
  EXPECT_EQ(pptam_required_parts(&fewer, &parts).code, PPTAM_INVALID_ARGUMENT);
  EXPECT_GT(parts.map, smaller.map) << "nothing has changed";
  EXPECT_EQ(pptam_required_parts(&config, nullptr).code, PPTAM_INVALID_ARGUMENT);
  EXPECT_EQ(pptam_required_parts(nullptr, &parts).code, PPTAM_INVALID_ARGUMENT);
}

}  // namespace
}  // namespace pptam
