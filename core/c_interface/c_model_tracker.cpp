// ModelTracker for C. A pptam_object_model is the head of a block with the caller's arrays as those of ObjectModel; a
// pptam_model_tracker that of the block with a ModelTracker.
#include <new>
#include <span>

#include <pocket_ptam/model_tracker.h>
#include <pocket_ptam/pocket_ptam_c.h>
#include "c_interface/conversions.h"

struct pptam_object_model {
  pptam::ObjectModel model;
};

struct pptam_model_tracker {
  pptam::ModelTracker* tracker = nullptr;
  const pptam_object_model* model = nullptr;
  std::span<const pptam::ModelSite> sites;  // of the last frame that was not refused
};

namespace pptam::c {

namespace {

constexpr const char* kNoTracker = "tracker is null: pptam_model_tracker_create() has not made one";
constexpr const char* kNullArgument = "a pointer is null";
constexpr const char* kNoArrays = "pptam_object_arrays: an array is null, or has more than 65536 entries";
// Of any array, more than ObjectModel::validate() takes of all but corners: no sum of their bytes overflows.
constexpr size_t kMostEntries = 65536;
constexpr size_t kMostStartPoints = 100;  // as ModelTracker::start()

bool is_array(const void* data, size_t count) {
  return count <= kMostEntries && (data || count == 0);
}

bool are_arrays(const pptam_object_arrays& a) {
  return is_array(a.points, a.point_count) && is_array(a.corners, a.corner_count) && is_array(a.lines, a.line_count) &&
         is_array(a.faces, a.face_count) && is_array(a.cylinders, a.cylinder_count) &&
         is_array(a.circles, a.circle_count) && is_array(a.spheres, a.sphere_count);
}

// The arrays one after the other; none needs more alignment than the head gives, and all have that of a float.
size_t model_bytes(const pptam_object_arrays& a) {
  return head_bytes<pptam_object_model>() + a.point_count * sizeof(Vector3f) + a.corner_count * sizeof(int) +
         a.line_count * sizeof(ModelLine) + a.face_count * sizeof(ModelFace) +
         a.cylinder_count * sizeof(ModelCylinder) + a.circle_count * sizeof(ModelCircle) +
         a.sphere_count * sizeof(ModelSphere);
}

ModelLine part_from(const pptam_model_line& line) {
  return {line.a, line.b, line.min_length_px};
}
ModelFace part_from(const pptam_model_face& face) {
  return {face.first, face.count, truth_from(face.open), face.min_area_px2, face.min_length_px};
}
ModelCylinder part_from(const pptam_model_cylinder& cylinder) {
  return {cylinder.a, cylinder.b, cylinder.radius, cylinder.min_length_px};
}
ModelCircle part_from(const pptam_model_circle& circle) {
  return {vector3_from(circle.centre), vector3_from(circle.normal), circle.radius, truth_from(circle.both_sides),
          circle.min_area_px2};
}
ModelSphere part_from(const pptam_model_sphere& sphere) {
  return {vector3_from(sphere.centre), sphere.radius, sphere.min_area_px2};
}
int part_from(int32_t corner) {
  return corner;
}

// Makes `count` parts at *place and moves it behind them.
template <class Part, class C>
std::span<const Part> copied(const C* from, size_t count, std::byte** place) {
  static_assert(alignof(Part) == alignof(float) && sizeof(Part) % alignof(float) == 0);
  Part* const parts = reinterpret_cast<Part*>(*place);
  for (size_t i = 0; i < count; ++i) new (parts + i) Part(part_from(from[i]));
  *place += count * sizeof(Part);
  return {parts, count};
}

ModelTrackerConfig config_from(const pptam_model_tracker_config& c) {
  ModelTrackerConfig config;
  config.camera = camera_from(c.camera);
  config.model = c.model->model;
  config.site_spacing_px = c.site_spacing_px;
  config.max_sites = c.max_sites;
  config.method.no_weights = truth_from(c.method.no_weights);
  config.method.likelihood_threshold = c.method.likelihood_threshold;
  config.method.scale_once = truth_from(c.method.scale_once);
  config.method.constant_jacobian = truth_from(c.method.constant_jacobian);
  return config;
}

pptam_model_tracker_config config_to_c(const ModelTrackerConfig& config, const pptam_object_model* model) {
  pptam_model_tracker_config c;
  c.camera = to_c(config.camera);
  c.model = model;
  c.site_spacing_px = config.site_spacing_px;
  c.max_sites = config.max_sites;
  c.method.no_weights = config.method.no_weights;
  c.method.likelihood_threshold = config.method.likelihood_threshold;
  c.method.scale_once = config.method.scale_once;
  c.method.constant_jacobian = config.method.constant_jacobian;
  return c;
}

pptam_status config_status(const pptam_model_tracker_config* config) {
  if (!config) return refused("config is null: begin with pptam_model_tracker_config_usual()");
  if (!config->model)
    return refused("pptam_model_tracker_config.model is null: make it by pptam_object_model_create()");
  const pptam_status status = camera_status(config->camera);
  return status.code == PPTAM_OK ? to_c(config_from(*config).validate()) : status;
}

pptam_model_result result_to_c(const ModelResult& r) {
  pptam_model_result c;
  c.timestamp_ns = r.timestamp_ns;
  c.state = static_cast<int32_t>(r.state);
  c.pose_valid = r.pose_valid;
  c.restarted = r.restarted;
  c.T_co = to_c(r.T_co);
  numbers_to(r.covariance, c.covariance);
  c.quality = r.quality;
  c.error_px = r.error_px;
  static_assert(kModelFeatures == PPTAM_MODEL_FEATURES);
  std::copy_n(r.feature_error_px, kModelFeatures, c.feature_error_px);
  std::copy_n(r.feature_inliers, kModelFeatures, c.feature_inliers);
  c.sites_visible = r.sites_visible;
  c.sites_inliers = r.sites_inliers;
  c.sites = static_cast<int32_t>(r.sites.size());
  return c;
}

pptam_model_site entry_to_c(const ModelSite& site) {
  pptam_model_site c;
  numbers_to(site.px, c.px);
  numbers_to(site.model_px, c.model_px);
  c.contour = site.contour;
  c.kind = static_cast<int32_t>(site.kind);
  return c;
}

}  // namespace
}  // namespace pptam::c

using pptam::c::kDone;
using pptam::c::kNoTracker;
using pptam::c::kNullArgument;
using pptam::c::refused;
using pptam::c::to_c;

size_t pptam_object_model_required_bytes(const pptam_object_arrays* arrays) {
  return arrays && pptam::c::are_arrays(*arrays) ? pptam::c::model_bytes(*arrays) : 0;
}

pptam_status pptam_object_model_create(const pptam_object_arrays* arrays, void* memory, size_t bytes,
                                       pptam_object_model** model) {
  if (!arrays || !model) return refused(kNullArgument);
  if (!pptam::c::are_arrays(*arrays)) return refused(pptam::c::kNoArrays);
  if (!memory || !pptam::c::block_aligned(memory)) return refused(pptam::c::kNoBlock);
  if (bytes < pptam::c::model_bytes(*arrays))
    return {PPTAM_OUT_OF_MEMORY,
            "pptam_object_model_create: the block is smaller than pptam_object_model_required_bytes(arrays)"};
  std::byte* place = static_cast<std::byte*>(memory) + pptam::c::head_bytes<pptam_object_model>();
  pptam::Vector3f* const points = reinterpret_cast<pptam::Vector3f*>(place);
  for (size_t i = 0; i < arrays->point_count; ++i)
    new (points + i) pptam::Vector3f(pptam::c::vector3_from(arrays->points + 3 * i));
  place += arrays->point_count * sizeof(pptam::Vector3f);
  using pptam::c::copied;
  pptam::ObjectModel made;
  made.points = {points, arrays->point_count};
  made.corners = copied<int>(arrays->corners, arrays->corner_count, &place);
  made.lines = copied<pptam::ModelLine>(arrays->lines, arrays->line_count, &place);
  made.faces = copied<pptam::ModelFace>(arrays->faces, arrays->face_count, &place);
  made.cylinders = copied<pptam::ModelCylinder>(arrays->cylinders, arrays->cylinder_count, &place);
  made.circles = copied<pptam::ModelCircle>(arrays->circles, arrays->circle_count, &place);
  made.spheres = copied<pptam::ModelSphere>(arrays->spheres, arrays->sphere_count, &place);
  made.outlines_of_smooth = pptam::c::truth_from(arrays->outlines_of_smooth);
  const pptam::Status status = made.validate();
  if (status.ok()) *model = new (memory) pptam_object_model{made};
  return to_c(status);
}

pptam_status pptam_model_tracker_config_usual(const pptam_camera* camera, const pptam_object_model* model,
                                              pptam_model_tracker_config* config) {
  if (!camera || !model || !config) return refused(kNullArgument);
  const pptam_camera as_given = *camera;  // what it says of axis and distortion may be no enumerator
  *config = pptam::c::config_to_c(pptam::ModelTrackerConfig(), model);
  config->camera = as_given;
  return kDone;
}

pptam_status pptam_model_tracker_config_validate(const pptam_model_tracker_config* config) {
  return pptam::c::config_status(config);
}

size_t pptam_model_tracker_required_bytes(const pptam_model_tracker_config* config) {
  if (pptam::c::config_status(config).code != PPTAM_OK) return 0;
  return pptam::c::head_bytes<pptam_model_tracker>() +
         pptam::ModelTracker::required_bytes(pptam::c::config_from(*config));
}

pptam_status pptam_model_tracker_create(const pptam_model_tracker_config* config, void* memory, size_t bytes,
                                        pptam_model_tracker** tracker) {
  const pptam_status status = pptam::c::config_status(config);
  if (status.code != PPTAM_OK) return status;
  if (!tracker) return refused(kNullArgument);
  if (!memory || !pptam::c::block_aligned(memory)) return refused(pptam::c::kNoBlock);
  if (bytes < pptam_model_tracker_required_bytes(config))
    return {PPTAM_OUT_OF_MEMORY,
            "pptam_model_tracker_create: the block is smaller than pptam_model_tracker_required_bytes(config)"};
  constexpr size_t kHead = pptam::c::head_bytes<pptam_model_tracker>();
  const std::span<std::byte> block(static_cast<std::byte*>(memory), bytes);
  pptam::ModelTracker* made = nullptr;
  const pptam::Status created =
      pptam::ModelTracker::create(pptam::c::config_from(*config), block.subspan(kHead), &made);
  if (!created.ok()) return to_c(created);
  *tracker = new (memory) pptam_model_tracker{made, config->model, {}};
  return kDone;
}

pptam_status pptam_model_tracker_get_config(const pptam_model_tracker* tracker, pptam_model_tracker_config* config) {
  if (!tracker) return refused(kNoTracker);
  if (!config) return refused(kNullArgument);
  *config = pptam::c::config_to_c(tracker->tracker->config(), tracker->model);
  return kDone;
}

pptam_status pptam_model_start(pptam_model_tracker* tracker, const pptam_pose* T_co) {
  if (!tracker) return refused(kNoTracker);
  if (!T_co) return refused(kNullArgument);
  return to_c(tracker->tracker->start(pptam::c::pose_from(*T_co)));
}

pptam_status pptam_model_start_from_points(pptam_model_tracker* tracker, const float* points_o, const float* px,
                                           size_t count) {
  if (!tracker) return refused(kNoTracker);
  if (!points_o || !px) return refused(kNullArgument);
  constexpr size_t kMost = pptam::c::kMostStartPoints;
  if (count > kMost) return refused("start: 4 to 100 points and as many pixels are needed");
  pptam::Vector3f points[kMost];
  pptam::Vector2f pixels[kMost];
  for (size_t i = 0; i < count; ++i) {
    points[i] = pptam::c::vector3_from(points_o + 3 * i);
    pixels[i] = pptam::c::vector2_from(px + 2 * i);
  }
  return to_c(tracker->tracker->start(std::span(points, count), std::span(pixels, count)));
}

pptam_status pptam_model_start_anywhere(pptam_model_tracker* tracker) {
  if (!tracker) return refused(kNoTracker);
  tracker->tracker->start_anywhere();
  return kDone;
}

pptam_status pptam_model_reset(pptam_model_tracker* tracker) {
  if (!tracker) return refused(kNoTracker);
  tracker->tracker->reset();
  return kDone;
}

pptam_status pptam_model_track(pptam_model_tracker* tracker, const pptam_frame* frame, pptam_model_result* result) {
  if (!result) return refused("result is null");
  pptam::ModelResult tracked;
  if (frame) tracked.timestamp_ns = frame->timestamp_ns;
  if (tracker && frame) {
    tracked = tracker->tracker->track(pptam::c::frame_from(*frame));
    if (tracked.status.ok()) tracker->sites = tracked.sites;
  }
  *result = pptam::c::result_to_c(tracked);
  if (!tracker) return refused(kNoTracker);
  return frame ? to_c(tracked.status) : refused("frame is null");
}

pptam_status pptam_model_sites(const pptam_model_tracker* tracker, pptam_model_site* out, size_t capacity,
                               int32_t* count) {
  if (!tracker) return refused(kNoTracker);
  if (!pptam::c::is_output(out, capacity, count)) return refused(pptam::c::kNoOutput);
  const size_t copied = std::min(capacity, tracker->sites.size());
  for (size_t i = 0; i < copied; ++i) out[i] = pptam::c::entry_to_c(tracker->sites[i]);
  *count = static_cast<int32_t>(tracker->sites.size());
  return kDone;
}
