// Calls of the C interface's model tracker, with bytes for objects, settings, starts and images: no call breaks a
// promise of pocket_ptam_c.h. The input is a script, as that of c_api_fuzz.
#include <array>
#include <cmath>
#include <cstddef>
#include <vector>

#include "tests/bits/run.h"
#include "tests/fuzz/script.h"

namespace {

using namespace pptam;
using test::checked;
using test::require;
using test::Script;

using Memory = std::vector<std::max_align_t>;
constexpr size_t kMostBytes = size_t{16} << 20;  // of an object or a tracker that is made
constexpr int kWidth = 96, kHeight = 80;

// The caller's copy of an object, of which numbers may be changed.
struct Object {
  Object() {
    const pptam_object_arrays known = test::known_object();
    points.assign(known.points, known.points + 3 * known.point_count);
    corners.assign(known.corners, known.corners + known.corner_count);
    faces.assign(known.faces, known.faces + known.face_count);
    cylinders.assign(known.cylinders, known.cylinders + known.cylinder_count);
    spheres.assign(known.spheres, known.spheres + known.sphere_count);
    lines.push_back({0, 7, 0});
    circles.push_back({{0.1f, 0, 0}, {1, 0, 0}, 0.02f, true, 0});
  }
  void change(Script& script) {
    switch (script.take<uint8_t>() % 8) {
      case 0:
        points[script.take<uint8_t>() % points.size()] = script.take<float>();
        break;
      case 1:
        corners[script.take<uint8_t>() % corners.size()] = script.take<int32_t>();
        break;
      case 2:
        script.change(&faces[script.take<uint8_t>() % faces.size()]);
        break;
      case 3:
        script.change(&cylinders[0]);
        break;
      case 4:
        script.change(&spheres[0]);
        break;
      case 5:
        script.change(&lines[0]);
        break;
      case 6:
        script.change(&circles[0]);
        break;
      default:
        outlines_of_smooth = !outlines_of_smooth;
    }
  }
  pptam_object_arrays arrays() const {
    pptam_object_arrays all = {};
    all.points = points.data(), all.point_count = points.size() / 3;
    all.corners = corners.data(), all.corner_count = corners.size();
    all.lines = lines.data(), all.line_count = lines.size();
    all.faces = faces.data(), all.face_count = faces.size();
    all.cylinders = cylinders.data(), all.cylinder_count = cylinders.size();
    all.circles = circles.data(), all.circle_count = circles.size();
    all.spheres = spheres.data(), all.sphere_count = spheres.size();
    all.outlines_of_smooth = outlines_of_smooth;
    return all;
  }
  std::vector<float> points;
  std::vector<int32_t> corners;
  std::vector<pptam_model_line> lines;
  std::vector<pptam_model_face> faces;
  std::vector<pptam_model_cylinder> cylinders;
  std::vector<pptam_model_circle> circles;
  std::vector<pptam_model_sphere> spheres;
  bool outlines_of_smooth = false;
};

pptam_camera small_camera() {
  pptam_camera camera = {};
  camera.width = kWidth, camera.height = kHeight;
  camera.fx = camera.fy = 96, camera.cx = 47.5f, camera.cy = 39.5f;
  return camera;
}

void start(Script& script, pptam_model_tracker* tracker) {
  const auto kind = script.take<uint8_t>();
  if (kind % 4 == 0) {
    checked(pptam_model_start_anywhere(tracker));
  } else if (kind % 4 == 1) {
    float points[3 * 6] = {-0.1f, -0.075f, -0.05f, 0.1f, -0.075f, -0.05f, -0.1f, 0.075f, -0.05f, 0.1f, 0.075f, 0.05f};
    float px[2 * 6] = {30, 25, 65, 25, 30, 55, 65, 55};
    for (int i = kind / 4 % 4; i > 0; --i) {
      points[script.take<uint8_t>() % 18] = script.take<float>();
      px[script.take<uint8_t>() % 12] = script.take<float>();
    }
    checked(pptam_model_start_from_points(tracker, points, px, kind / 16 % 8));
  } else {
    pptam_pose pose = {{1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 0.5f}};
    if (kind % 4 == 3) script.change(&pose);
    checked(pptam_model_start(tracker, kind == 2 ? nullptr : &pose));
  }
}

// A picture of a few rectangles, mostly with edges where the object could have them.
void track(Script& script, pptam_model_tracker* tracker, int64_t* now_ns) {
  static std::vector<uint8_t> image(kWidth * kHeight);
  const auto kind = script.take<uint8_t>();
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      const bool inside = x > 28 + kind % 8 && x < 66 && y > 24 + kind / 8 % 8 && y < 56;
      image[static_cast<size_t>(y * kWidth + x)] = static_cast<uint8_t>(inside ? 150 : 60 + x / 4);
    }
  for (int i = kind / 64; i > 0; --i) image[script.take<uint16_t>() % image.size()] = script.take<uint8_t>();
  pptam_frame frame = {image.data(), kWidth, kHeight, kWidth, PPTAM_PIXEL_GREY, *now_ns + 33333333};
  if (kind % 16 == 15) script.change(&frame);
  if (frame.data != image.data()) frame.data = nullptr;
  frame.stride_bytes = std::min(frame.stride_bytes, kWidth);
  pptam_model_result result;
  if (checked(pptam_model_track(tracker, &frame, &result)).code != PPTAM_OK) return;
  *now_ns = frame.timestamp_ns;
  require(result.state >= PPTAM_MODEL_WAITING && result.state <= PPTAM_MODEL_LOST, "a state that is none");
  if (!result.pose_valid) return;
  for (const float number : result.T_co.R) require(std::isfinite(number), "a rotation that is no number");
  for (const float number : result.T_co.t) require(std::isfinite(number), "a translation that is no number");
  for (const float number : result.covariance) require(std::isfinite(number), "a covariance that is no number");
  require(result.quality >= 0 && result.quality <= 1, "a quality that is none");
}

void call(Script& script, pptam_model_tracker* tracker, int64_t* now_ns) {
  switch (script.take<uint8_t>() % 8) {
    case 0:
      start(script, tracker);
      break;
    case 1:
      checked(pptam_model_reset(tracker));
      break;
    case 2: {
      const size_t room = script.take<uint8_t>();
      std::vector<pptam_model_site> sites(room);
      int32_t count = 0;
      if (checked(pptam_model_sites(tracker, sites.data(), room, &count)).code == PPTAM_OK)
        require(count >= 0, "a negative count");
      break;
    }
    default:
      track(script, tracker, now_ns);
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  static Memory object_memory(kMostBytes / 16), tracker_memory(kMostBytes / 16);
  Script script(data, size);
  Object object;
  for (int changes = script.take<uint8_t>() % 4; changes > 0; --changes) object.change(script);
  pptam_object_arrays arrays = object.arrays();
  const size_t object_bytes = pptam_object_model_required_bytes(&arrays);
  pptam_object_model* model = nullptr;
  const pptam_status made =
      checked(pptam_object_model_create(&arrays, object_memory.data(), std::min(object_bytes, kMostBytes), &model));
  require((made.code == PPTAM_OK) == (model != nullptr), "a handle of no object");

  const pptam_camera camera = small_camera();
  pptam_model_tracker_config config;
  if (checked(pptam_model_tracker_config_usual(&camera, model, &config)).code != PPTAM_OK) return 0;
  config.max_sites = 200;
  const pptam_model_tracker_config usual = config;
  if (script.take<uint8_t>() % 4 == 0) script.change(&config);
  config.model = usual.model;  // a pointer to anything cannot be looked at
  const size_t bytes = pptam_model_tracker_required_bytes(&config);
  require((bytes == 0) == (checked(pptam_model_tracker_config_validate(&config)).code != PPTAM_OK),
          "bytes of no configuration");
  pptam_model_tracker* tracker = nullptr;
  const pptam_status status =
      checked(pptam_model_tracker_create(&config, tracker_memory.data(), std::min(bytes, kMostBytes), &tracker));
  require((status.code == PPTAM_OK) == (tracker != nullptr), "a handle of no tracker");
  int64_t now_ns = 0;
  for (int calls = 0; script.more() && calls < 40; ++calls) call(script, tracker, &now_ns);
  return 0;
}
