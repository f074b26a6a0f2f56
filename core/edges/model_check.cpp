// What a model and a tracker's configuration must be.
#include <cmath>

#include <pocket_ptam/model_tracker.h>
#include "edges/model_view.h"

namespace pptam {

namespace {

constexpr float kLargestNumber = 1e6f;  // of any number, model units or pixels
constexpr float kLeast = 1e-6f;         // of a length, model units

Status bad(const char* message) {
  return {StatusCode::kInvalidArgument, message};
}

bool within_range(const Vector3f& v) {
  return std::abs(v.x()) <= kLargestNumber && std::abs(v.y()) <= kLargestNumber && std::abs(v.z()) <= kLargestNumber;
}

}  // namespace

Status ObjectModel::validate() const {
  if (points.size() > kMaxPoints) return bad("ObjectModel::points: at most 4096");
  if (lines.size() > kMaxSides) return bad("ObjectModel: at most 4096 lines and sides of faces");
  if (faces.size() > kMaxFaces) return bad("ObjectModel::faces: at most 2048");
  if (cylinders.size() > kMaxCurved || circles.size() > kMaxCurved || spheres.size() > kMaxCurved)
    return bad("ObjectModel: at most 1024 cylinders, circles and spheres each");
  if (lines.empty() && faces.empty() && cylinders.empty() && circles.empty() && spheres.empty())
    return bad("ObjectModel: nothing to track: no lines, faces, cylinders, circles or spheres");
  for (const Vector3f& p : points)
    if (!within_range(p)) return bad("ObjectModel::points: coordinates must be within 1e6");
  const int count = static_cast<int>(points.size());
  const auto apart = [&](int a, int b) {
    return a >= 0 && b >= 0 && a < count && b < count &&
           (points[static_cast<size_t>(a)] - points[static_cast<size_t>(b)]).squaredNorm() > kLeast * kLeast;
  };
  const auto positive = [](float v) { return v >= kLeast && v <= kLargestNumber; };
  const auto threshold = [](float v) { return v >= 0 && v <= kLargestNumber; };
  size_t sides = lines.size();
  for (const ModelLine& line : lines)
    if (!apart(line.a, line.b) || !threshold(line.min_length_px))
      return bad("ObjectModel::lines: two points at different places are needed");
  for (const ModelFace& face : faces) {
    if (face.count < 2 || face.first < 0 || face.count > static_cast<int>(corners.size()) ||
        face.first > static_cast<int>(corners.size()) - face.count)
      return bad("ObjectModel::faces: a face needs two or more corners that are in ObjectModel::corners");
    sides += static_cast<size_t>(face.count);
    if (sides > kMaxSides) return bad("ObjectModel: at most 4096 lines and sides of faces");
    for (int i = 0; i < face.count; ++i) {
      const int here = corner(face, i);
      const int next = corner(face, i + 1);
      if (!apart(here, next)) return bad("ObjectModel::faces: neighbouring corners must be points at different places");
    }
    if (!threshold(face.min_area_px2) || !threshold(face.min_length_px))
      return bad("ObjectModel::faces: thresholds must be 0 to 1e6");
  }
  for (const ModelCylinder& cylinder : cylinders)
    if (!apart(cylinder.a, cylinder.b) || !positive(cylinder.radius) || !threshold(cylinder.min_length_px))
      return bad("ObjectModel::cylinders: two points at different places and a radius are needed");
  for (const ModelCircle& circle : circles)
    if (!within_range(circle.centre) || !within_range(circle.normal) || !positive(circle.radius) ||
        !(circle.normal.squaredNorm() > 1e-20f) || !threshold(circle.min_area_px2))
      return bad("ObjectModel::circles: a centre, a normal with a length and a radius are needed");
  for (const ModelSphere& sphere : spheres)
    if (!within_range(sphere.centre) || !positive(sphere.radius) || !threshold(sphere.min_area_px2))
      return bad("ObjectModel::spheres: a centre and a radius are needed");
  return {};
}

Status ModelTrackerConfig::validate() const {
  const Status status = camera.model.validate();
  if (!status.ok()) return status;
  if (camera.model.width < 64 || camera.model.height < 64 || camera.model.width > 4096 || camera.model.height > 4096)
    return bad("ModelTrackerConfig::camera: width and height must be within 64 to 4096 pixels");
  if (!(camera.readout_s() <= 1))
    return bad("ModelTrackerConfig::camera.shutter: the readout must be under 1 s; line_time_s is per line");
  if (!(site_spacing_px >= 1 && site_spacing_px <= 100))
    return bad("ModelTrackerConfig::site_spacing_px must be within 1 to 100");
  if (max_sites < 50 || max_sites > 5000) return bad("ModelTrackerConfig::max_sites must be within 50 to 5000");
  if (!(method.likelihood_threshold >= 0 && method.likelihood_threshold <= 1))
    return bad("ModelTrackerConfig::method.likelihood_threshold must be within 0 to 1");
  return model.validate();
}

}  // namespace pptam
