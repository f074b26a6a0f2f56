// The model-based tracker's C interface: the bits of the C++ interface, and what it refuses.
#include <gtest/gtest.h>

#include <cstring>
#include <functional>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include <pocket_ptam/model_tracker.h>
#include <pocket_ptam/pocket_ptam_c.h>
#include "tests/support/rendered_object.h"
#include "tests/support/tracker_in_memory.h"

namespace pptam {
namespace {

using test::box;
using test::config_of;
using test::RenderedObject;
using test::small_camera;
using test::swaying;
using test::TrackerInMemory;

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

// An object in arrays of C.
struct CObject {
  explicit CObject(const RenderedObject& object) {
    points.reserve(3 * object.points.size());
    for (const Vector3f& p : object.points) points.insert(points.end(), p.data(), p.data() + 3);
    corners.assign(object.corners.begin(), object.corners.end());
    faces.reserve(object.faces.size());
    for (const ModelFace& f : object.faces)
      faces.push_back({f.first, f.count, f.open, f.min_area_px2, f.min_length_px});
    cylinders.reserve(object.cylinders.size());
    for (const ModelCylinder& c : object.cylinders) cylinders.push_back({c.a, c.b, c.radius, c.min_length_px});
    circles.reserve(object.circles.size());
    for (const ModelCircle& c : object.circles)
      circles.push_back({{c.centre.x(), c.centre.y(), c.centre.z()},
                         {c.normal.x(), c.normal.y(), c.normal.z()},
                         c.radius,
                         c.both_sides,
                         c.min_area_px2});
    spheres.reserve(object.spheres.size());
    for (const ModelSphere& s : object.spheres)
      spheres.push_back({{s.centre.x(), s.centre.y(), s.centre.z()}, s.radius, s.min_area_px2});
  }
  pptam_object_arrays arrays() const {
    pptam_object_arrays a = {};
    a.points = points.data(), a.point_count = points.size() / 3;
    a.corners = corners.data(), a.corner_count = corners.size();
    a.faces = faces.data(), a.face_count = faces.size();
    a.cylinders = cylinders.data(), a.cylinder_count = cylinders.size();
    a.circles = circles.data(), a.circle_count = circles.size();
    a.spheres = spheres.data(), a.sphere_count = spheres.size();
    return a;
  }
  std::vector<float> points;
  std::vector<int32_t> corners;
  std::vector<pptam_model_face> faces;
  std::vector<pptam_model_cylinder> cylinders;
  std::vector<pptam_model_circle> circles;
  std::vector<pptam_model_sphere> spheres;
};

using Memory = std::vector<std::max_align_t>;
Memory memory_of(size_t bytes) {
  return Memory(bytes / sizeof(std::max_align_t) + 2);
}

pptam_camera c_camera(const Camera& camera) {
  pptam_camera c = {};
  c.width = camera.model.width, c.height = camera.model.height;
  c.fx = camera.model.fx, c.fy = camera.model.fy, c.cx = camera.model.cx, c.cy = camera.model.cy;
  c.shutter_axis = static_cast<int32_t>(camera.shutter.axis), c.line_time_s = camera.shutter.line_time_s;
  return c;
}

pptam_pose c_pose(const SE3& T) {
  pptam_pose pose;
  for (int i = 0; i < 9; ++i) pose.R[i] = T.R(i / 3, i % 3);
  for (int i = 0; i < 3; ++i) pose.t[i] = T.t(i);
  return pose;
}

// A tracker of an object, 400 sites; it and the object in memory of their own.
struct CTracker {
  CTracker(const pptam_object_arrays& arrays, const Camera& camera) {
    object_memory = memory_of(pptam_object_model_required_bytes(&arrays));
    EXPECT_EQ(
        pptam_object_model_create(&arrays, object_memory.data(), pptam_object_model_required_bytes(&arrays), &object)
            .code,
        PPTAM_OK);
    const pptam_camera lens = c_camera(camera);
    EXPECT_EQ(pptam_model_tracker_config_usual(&lens, object, &config).code, PPTAM_OK);
    config.max_sites = 400;
    const size_t bytes = pptam_model_tracker_required_bytes(&config);
    memory = memory_of(bytes);
    const pptam_status status = pptam_model_tracker_create(&config, memory.data(), bytes, &tracker);
    EXPECT_EQ(status.code, PPTAM_OK) << status.message;
  }
  Memory object_memory, memory;
  pptam_object_model* object = nullptr;
  pptam_model_tracker_config config = {};
  pptam_model_tracker* tracker = nullptr;
};

TEST(ModelCApi, GivesTheBitsOfTheCppInterface) {
  RenderedObject object = box();
  object.spheres.push_back({Vector3f(0.05f, 0.02f, 0.09f), 0.03f, 0});
  object.circles.push_back({Vector3f(-0.05f, 0, -0.051f), Vector3f(0, 0, -1), 0.03f, true, 0});
  object.cylinders.push_back({0, 1, 0.004f, 0});
  const Camera camera = small_camera();
  TrackerInMemory tracker(config_of(object, camera));
  CTracker c(CObject(object).arrays(), camera);  // the arrays are gone afterwards
  const pptam_pose start = c_pose(swaying(0));
  ASSERT_TRUE(tracker->start(swaying(0)).ok());
  ASSERT_EQ(pptam_model_start(c.tracker, &start).code, PPTAM_OK);
  int poses = 0;
  for (int i = 0; i < 4; ++i) {  // few: emulated processors render them, too
    const std::vector<uint8_t> image = object.render(camera, [&](float t_s) { return swaying(30 * t_s + float(i)); });
    const ModelResult r = tracker.track(image);
    const pptam_frame frame = {image.data(),       camera.model.width, camera.model.height,
                               camera.model.width, PPTAM_PIXEL_GREY,   r.timestamp_ns};
    pptam_model_result result;
    ASSERT_EQ(pptam_model_track(c.tracker, &frame, &result).code, PPTAM_OK);
    poses += r.pose_valid;
    EXPECT_EQ(result.timestamp_ns, r.timestamp_ns);
    EXPECT_EQ(result.state, static_cast<int>(r.state));
    EXPECT_EQ(result.pose_valid, r.pose_valid);
    EXPECT_EQ(result.restarted, r.restarted);
    const pptam_pose T_co = c_pose(r.T_co);
    EXPECT_EQ(std::memcmp(&result.T_co, &T_co, sizeof T_co), 0) << i;
    EXPECT_EQ(result.covariance[7], r.covariance(1, 1));
    EXPECT_EQ(result.quality, r.quality);
    EXPECT_EQ(result.error_px, r.error_px);
    for (int k = 0; k < kModelFeatures; ++k) {
      EXPECT_EQ(result.feature_error_px[k], r.feature_error_px[k]);
      EXPECT_EQ(result.feature_inliers[k], r.feature_inliers[k]);
    }
    EXPECT_EQ(result.sites_visible, r.sites_visible);
    EXPECT_EQ(result.sites_inliers, r.sites_inliers);
    std::vector<pptam_model_site> sites(r.sites.size());
    int32_t count = 0;
    ASSERT_EQ(pptam_model_sites(c.tracker, sites.data(), sites.size(), &count).code, PPTAM_OK);
    ASSERT_EQ(count, static_cast<int>(r.sites.size()));
    ASSERT_EQ(count, result.sites);
    for (size_t k = 0; k < sites.size(); ++k) {
      EXPECT_EQ(sites[k].px[0], r.sites[k].px.x());
      EXPECT_EQ(sites[k].model_px[1], r.sites[k].model_px.y());
      EXPECT_EQ(sites[k].contour, r.sites[k].contour);
      EXPECT_EQ(sites[k].kind, static_cast<int>(r.sites[k].kind));
    }
  }
  EXPECT_GT(poses, 2) << "or nothing is compared";
  pptam_model_tracker_config config = {};
  ASSERT_EQ(pptam_model_tracker_get_config(c.tracker, &config).code, PPTAM_OK);
  EXPECT_EQ(config.model, c.object);
  EXPECT_EQ(config.max_sites, 400);
  EXPECT_EQ(config.site_spacing_px, ModelTrackerConfig().site_spacing_px);
  ASSERT_EQ(pptam_model_reset(c.tracker).code, PPTAM_OK);
  ASSERT_EQ(pptam_model_start_anywhere(c.tracker).code, PPTAM_OK);
}

TEST(ModelCApi, RefusesWhatIsNoInput) {
  const CObject good(box());
  const std::vector<std::pair<const char*, std::function<void(CObject&, pptam_object_arrays&)>>> objects = {
      {"nothing to track", [](CObject&, pptam_object_arrays& a) { a.face_count = 0; }},
      {"points nowhere", [](CObject&, pptam_object_arrays& a) { a.points = nullptr; }},
      {"spheres nowhere", [](CObject&, pptam_object_arrays& a) { a.sphere_count = 1, a.spheres = nullptr; }},
      {"endless faces", [](CObject&, pptam_object_arrays& a) { a.face_count = SIZE_MAX; }},
      {"more corners than can be", [](CObject&, pptam_object_arrays& a) { a.corner_count = 65537; }},
      {"a corner of no point", [](CObject& o, pptam_object_arrays&) { o.corners[3] = 99; }},
      {"a face of no corners", [](CObject& o, pptam_object_arrays&) { o.faces[1].first = 1 << 30; }},
      {"a point of no numbers", [](CObject& o, pptam_object_arrays&) { o.points[4] = kNaN; }},
  };
  Memory memory = memory_of(1 << 20);
  for (const auto& [name, change] : objects) {
    CObject object = good;
    pptam_object_arrays arrays = object.arrays();
    change(object, arrays);
    pptam_object_model* model = nullptr;
    const pptam_status status = pptam_object_model_create(&arrays, memory.data(), 1 << 20, &model);
    EXPECT_EQ(status.code, PPTAM_INVALID_ARGUMENT) << name;
    EXPECT_NE(status.message[0], '\0') << name;
    EXPECT_EQ(model, nullptr) << name;
  }
  const pptam_object_arrays arrays = good.arrays();
  const size_t bytes = pptam_object_model_required_bytes(&arrays);
  pptam_object_model* none = nullptr;
  EXPECT_EQ(pptam_object_model_create(&arrays, memory.data(), bytes - 1, &none).code, PPTAM_OUT_OF_MEMORY);
  EXPECT_EQ(pptam_object_model_create(&arrays, reinterpret_cast<char*>(memory.data()) + 4, bytes, &none).code,
            PPTAM_INVALID_ARGUMENT);
  EXPECT_EQ(pptam_object_model_create(&arrays, nullptr, bytes, &none).code, PPTAM_INVALID_ARGUMENT);
  EXPECT_EQ(pptam_object_model_required_bytes(nullptr), 0u);

  CTracker c(arrays, small_camera());
  pptam_model_tracker_config config = c.config;
  pptam_model_tracker* tracker = nullptr;
  config.model = nullptr;
  EXPECT_EQ(pptam_model_tracker_required_bytes(&config), 0u);
  EXPECT_EQ(pptam_model_tracker_create(&config, memory.data(), 1 << 20, &tracker).code, PPTAM_INVALID_ARGUMENT);
  config = c.config;
  config.camera.fx = kNaN;
  EXPECT_EQ(pptam_model_tracker_config_validate(&config).code, PPTAM_INVALID_ARGUMENT);
  config = c.config;
  config.camera.shutter_axis = 256;
  EXPECT_EQ(pptam_model_tracker_config_validate(&config).code, PPTAM_INVALID_ARGUMENT);
  config = c.config;
  config.max_sites = 1;
  EXPECT_EQ(pptam_model_tracker_config_validate(&config).code, PPTAM_INVALID_ARGUMENT);
  EXPECT_EQ(pptam_model_tracker_create(&c.config, memory.data(), 1000, &tracker).code, PPTAM_OUT_OF_MEMORY);
  EXPECT_EQ(pptam_model_tracker_create(&c.config, reinterpret_cast<char*>(memory.data()) + 1, 1 << 20, &tracker).code,
            PPTAM_INVALID_ARGUMENT);
  EXPECT_EQ(tracker, nullptr);

  pptam_pose pose = c_pose(swaying(0));
  pose.t[2] = -1;
  EXPECT_EQ(pptam_model_start(c.tracker, &pose).code, PPTAM_INVALID_ARGUMENT) << "behind the camera";
  EXPECT_EQ(pptam_model_start(c.tracker, nullptr).code, PPTAM_INVALID_ARGUMENT);
  const float numbers[9] = {};
  for (const size_t count : {size_t{0}, size_t{3}, size_t{101}, SIZE_MAX})
    EXPECT_EQ(pptam_model_start_from_points(c.tracker, numbers, numbers, count).code, PPTAM_INVALID_ARGUMENT) << count;
  const std::vector<uint8_t> image(320 * 240, 0);
  pptam_frame frame = {image.data(), 320, 240, 320, PPTAM_PIXEL_GREY, 1000};
  pptam_model_result result;
  EXPECT_EQ(pptam_model_track(c.tracker, nullptr, &result).code, PPTAM_INVALID_ARGUMENT);
  EXPECT_EQ(pptam_model_track(c.tracker, &frame, nullptr).code, PPTAM_INVALID_ARGUMENT);
  EXPECT_EQ(pptam_model_track(nullptr, &frame, &result).code, PPTAM_INVALID_ARGUMENT);
  EXPECT_EQ(pptam_model_track(c.tracker, &frame, &result).code, PPTAM_OK);
  EXPECT_EQ(pptam_model_track(c.tracker, &frame, &result).code, PPTAM_TIME_WENT_BACKWARDS);
  frame.timestamp_ns = 2000, frame.stride_bytes = 319;
  EXPECT_EQ(pptam_model_track(c.tracker, &frame, &result).code, PPTAM_INVALID_ARGUMENT);
  EXPECT_EQ(pptam_model_sites(c.tracker, nullptr, 3, nullptr).code, PPTAM_INVALID_ARGUMENT);
}

}  // namespace
}  // namespace pptam
