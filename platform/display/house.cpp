#include "platform/display/house.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <numbers>
#include <utility>

namespace pptam::platform {
namespace {

struct Colour3 {
  float r, g, b;  // 0 to 1
};
constexpr Colour3 kWall = {0.96f, 0.88f, 0.72f};
constexpr Colour3 kRoof = {0.82f, 0.29f, 0.22f};
constexpr Colour3 kDoor = {0.45f, 0.27f, 0.16f};
constexpr Colour3 kWindow = {0.48f, 0.70f, 0.86f};
constexpr Rgba kGridColour = {115, 217, 255, 255};
constexpr Rgba kPointColour = {51, 217, 102, 255};
constexpr Rgba kKeyframeColour = {255, 209, 51, 255};
constexpr Rgba kCameraColour = {77, 166, 255, 255};

// The house's measures, in units of its longer side.
constexpr float kHalfLength = 0.50f, kHalfWidth = 0.36f, kEaves = 0.50f, kRidge = 0.90f;
constexpr float kRoofHalfLength = 0.57f, kRoofHalfWidth = 0.44f, kRoofLow = 0.43f, kRoofRidge = 0.94f;
constexpr float kDecal = 0.004f;  // doors and windows stand off the wall, so that the depth tells them apart

const Vector3f kLight = Vector3f(0.45f, -0.35f, 0.82f).normalized();  // towards it, in the house's frame

Vector3f at(float x, float y, float z) {
  return {x, y, z};
}

struct Face {
  std::array<Vector3f, 4> corners;  // counter-clockwise from outside; the last repeats in triangles
  Colour3 colour;
};

const std::vector<Face>& house_faces() {
  constexpr float a = kHalfLength, b = kHalfWidth, h = kEaves, e = kDecal;
  constexpr float c = kRoofHalfLength, d = kRoofHalfWidth, low = kRoofLow, top = kRoofRidge;
  static const Vector3f left = at(-a, 0, kRidge), right = at(a, 0, kRidge);
  static const std::vector<Face> faces = {
      {{at(-a, -b, 0), at(a, -b, 0), at(a, -b, h), at(-a, -b, h)}, kWall},
      {{at(a, b, 0), at(-a, b, 0), at(-a, b, h), at(a, b, h)}, kWall},
      {{at(a, -b, 0), at(a, b, 0), at(a, b, h), at(a, -b, h)}, kWall},
      {{at(-a, b, 0), at(-a, -b, 0), at(-a, -b, h), at(-a, b, h)}, kWall},
      {{at(a, -b, h), at(a, b, h), right, right}, kWall},
      {{at(-a, b, h), at(-a, -b, h), left, left}, kWall},
      {{at(-0.10f, -b - e, 0), at(0.10f, -b - e, 0), at(0.10f, -b - e, 0.36f), at(-0.10f, -b - e, 0.36f)}, kDoor},
      {{at(-0.40f, -b - e, 0.18f), at(-0.20f, -b - e, 0.18f), at(-0.20f, -b - e, 0.38f), at(-0.40f, -b - e, 0.38f)},
       kWindow},
      {{at(0.20f, -b - e, 0.18f), at(0.40f, -b - e, 0.18f), at(0.40f, -b - e, 0.38f), at(0.20f, -b - e, 0.38f)},
       kWindow},
      {{at(a + e, -0.12f, 0.18f), at(a + e, 0.12f, 0.18f), at(a + e, 0.12f, 0.40f), at(a + e, -0.12f, 0.40f)}, kWindow},
      {{at(-a - e, 0.12f, 0.18f), at(-a - e, -0.12f, 0.18f), at(-a - e, -0.12f, 0.40f), at(-a - e, 0.12f, 0.40f)},
       kWindow},
      {{at(0.20f, b + e, 0.18f), at(-0.20f, b + e, 0.18f), at(-0.20f, b + e, 0.40f), at(0.20f, b + e, 0.40f)}, kWindow},
      {{at(-c, -d, low), at(c, -d, low), at(c, 0, top), at(-c, 0, top)}, kRoof},
      {{at(c, d, low), at(-c, d, low), at(-c, 0, top), at(c, 0, top)}, kRoof},
  };
  return faces;
}

Rgba shaded(const Colour3& colour, float light) {
  const auto byte = [light](float part) {
    return static_cast<uint8_t>(std::lround(255 * std::min(part * light, 1.0f)));
  };
  return {byte(colour.r), byte(colour.g), byte(colour.b), 255};
}

uint64_t next_revision() {
  static std::atomic<uint64_t> last = 0;
  return ++last;
}

// A point of a quadrilateral, u and v from 0 to 1.
Vector3f inside(const std::array<Vector3f, 4>& c, float u, float v) {
  return (1 - v) * ((1 - u) * c[0] + u * c[1]) + v * ((1 - u) * c[3] + u * c[2]);
}

// A grid of so many cells a side, in small pieces as lens and shutter move only the corners of a triangle.
constexpr int kPieces = 2;

void add_cells(uint16_t first, WorldMesh* mesh) {
  constexpr int kRow = kPieces + 1;
  for (int i = 0; i < kPieces; ++i) {
    for (int j = 0; j < kPieces; ++j) {
      const int corner = first + i * kRow + j;
      for (const int of_cell : {0, kRow, kRow + 1, 0, kRow + 1, 1})
        mesh->triangles.push_back(static_cast<uint16_t>(corner + of_cell));
    }
  }
}

void add_face(const Face& face, const Site& site, WorldModel* model) {
  const auto& c = face.corners;
  const Vector3f normal = (c[1] - c[0]).cross(c[2] - c[0]).normalized();
  const float light = 0.55f + 0.45f * std::max(0.0f, normal.dot(kLight));
  const Rgba colour = shaded(face.colour, light);
  add_cells(static_cast<uint16_t>(model->faces.vertices.size()), &model->faces);
  for (int i = 0; i <= kPieces; ++i) {
    for (int j = 0; j <= kPieces; ++j) {
      const Vector3f p_h = inside(c, static_cast<float>(i) / kPieces, static_cast<float>(j) / kPieces);
      model->faces.vertices.push_back({site.to_world(p_h), colour});
    }
  }
  const Rgba dark = shaded(face.colour, 0.6f * light);
  for (size_t side = 0; side < 4; ++side) {
    const Vector3f& from = c[side];
    const Vector3f& to = c[(side + 1) % 4];
    if (from == to) continue;  // a triangle
    WorldLine edge;
    edge.width_px = 1.2f;
    for (int i = 0; i <= kPieces; ++i)
      edge.points.push_back({site.to_world(from + static_cast<float>(i) / kPieces * (to - from)), dark});
    model->edges.push_back(edge);
  }
}

// Corners of the smallest convex polygon around them, counter-clockwise; Andrew's monotone chain.
std::vector<Vector2f> convex_hull(std::vector<Vector2f> points) {
  std::sort(points.begin(), points.end(),
            [](const Vector2f& p, const Vector2f& q) { return p.x() != q.x() ? p.x() < q.x() : p.y() < q.y(); });
  std::vector<Vector2f> hull;
  for (int pass = 0; pass < 2; ++pass) {
    const size_t base = hull.size();
    for (const Vector2f& p : points) {
      while (hull.size() >= base + 2) {
        const Vector2f u = hull.back() - hull[hull.size() - 2];
        const Vector2f v = p - hull.back();
        if (u.x() * v.y() - u.y() * v.x() > 0) break;
        hull.pop_back();
      }
      hull.push_back(p);
    }
    hull.pop_back();
    std::reverse(points.begin(), points.end());
  }
  return hull;
}

// A polygon of the ground, house's frame, that fades out over a seam: one flat darkness, in small pieces.
void add_shadow(const std::vector<Vector2f>& outline, float seam, uint8_t alpha, const Site& site, WorldModel* model) {
  Vector2f middle = Vector2f::Zero();
  for (const Vector2f& p : outline) middle += p / static_cast<float>(outline.size());
  WorldMesh& mesh = model->shadow;
  const auto add = [&](const Vector2f& p, uint8_t a) {
    mesh.vertices.push_back({site.to_world(at(p.x(), p.y(), 0)), {0, 0, 0, a}});
  };
  const auto first = static_cast<int>(mesh.vertices.size());
  add(middle, alpha);
  const auto around = static_cast<int>(outline.size()) * kPieces;
  for (int i = 0; i < around; ++i) {
    const Vector2f& from = outline[static_cast<size_t>(i / kPieces)];
    const Vector2f& to = outline[static_cast<size_t>(i / kPieces + 1) % outline.size()];
    const Vector2f p = from + static_cast<float>(i % kPieces) / kPieces * (to - from);
    add(p, alpha);
    add(p + seam * (p - middle).normalized(), 0);
    const int here = first + 1 + 2 * i;
    const int next = first + 1 + 2 * ((i + 1) % around);
    for (const int index : {first, here, next, here, here + 1, next, next, here + 1, next + 1})
      mesh.triangles.push_back(static_cast<uint16_t>(index));
  }
}

void add_grid(const Site& site, WorldModel* model) {
  constexpr int kCells = 8;  // to each side
  constexpr float kWidth_px = 1.2f;
  constexpr float kOpacity = 0.55f;  // at the anchor
  const float step = site.grid_spacing;
  const float x0 = std::round(site.anchor_w.x() / step) * step;
  const float y0 = std::round(site.anchor_w.y() / step) * step;
  const auto colour = [&](int u, int v) {  // fades out with the distance
    const float far = std::hypot(static_cast<float>(u), static_cast<float>(v)) / kCells;
    Rgba c = kGridColour;
    c.a = static_cast<uint8_t>(std::lround(255 * kOpacity * std::max(0.0f, 1 - far)));
    return c;
  };
  for (int u = -kCells; u <= kCells; ++u) {
    for (const bool along_x : {false, true}) {
      WorldLine line;
      line.width_px = kWidth_px;
      for (int v = -kCells; v <= kCells; ++v) {
        if (std::hypot(u, v) > kCells) continue;
        const float x = x0 + static_cast<float>(along_x ? v : u) * step;
        const float y = y0 + static_cast<float>(along_x ? u : v) * step;
        line.points.push_back({at(x, y, 0), colour(u, v)});
      }
      model->ground.push_back(line);
    }
  }
}

// The image's corners at some depth, and lines from the camera's centre to them.
void add_camera(const pptam::Camera& camera, const SE3& T_cw, float depth, const Rgba& colour, float width_px,
                WorldModel* model) {
  const SE3 T_wc = T_cw.inverse();
  const auto right = static_cast<float>(camera.model.width - 1);
  const auto low = static_cast<float>(camera.model.height - 1);
  std::array<Vector3f, 4> corners;
  size_t i = 0;
  for (const Vector2f& px : {Vector2f(0, 0), Vector2f(right, 0), Vector2f(right, low), Vector2f(0, low)})
    corners[i++] = T_wc * Vector3f(depth * camera.unproject(px).homogeneous());
  for (i = 0; i < 4; ++i) {
    model->wires.push_back({{{corners[i], colour}, {corners[(i + 1) % 4], colour}}, width_px});
    model->wires.push_back({{{T_wc.t, colour}, {corners[i], colour}}, width_px});
  }
}

// Of the points' coordinate: without the outermost twentieths, which may be anywhere.
std::pair<float, float> range_of(std::vector<float> values) {
  std::sort(values.begin(), values.end());
  const size_t cut = values.size() / 20;
  return {values[cut], values[values.size() - 1 - cut]};
}

}  // namespace

Site place_house(const SE3& T_cw, float initial_baseline) {
  Site site;
  const Vector3f centre = T_cw.centre();
  const Vector3f axis = T_cw.R.row(2).transpose();
  const float height = std::max(std::abs(centre.z()), 0.5f * initial_baseline);
  float along = 2 * height;  // a view along the ground never meets it, or far away
  if (axis.z() < -0.2f) along = centre.z() / -axis.z();
  site.anchor_w = centre + along * axis;
  site.anchor_w.z() = 0;
  const float distance = (site.anchor_w - centre).norm();
  site.house_size = 0.2f * distance;
  // The door looks to the camera, turned by 35 degrees so that two walls show.
  Vector3f towards = T_cw.R.row(1).transpose();  // image down
  towards.z() = 0;
  if (towards.norm() < 0.1f) towards = Vector3f(0, -1, 0);
  const float angle =
      std::atan2(towards.y(), towards.x()) + 0.5f * std::numbers::pi_v<float> + 0.6f;  // 0.6: 35 degrees
  site.R_wh << std::cos(angle), -std::sin(angle), 0, std::sin(angle), std::cos(angle), 0, 0, 0, 1;
  site.grid_spacing = initial_baseline;
  while (site.grid_spacing > 0.2f * distance) site.grid_spacing *= 0.5f;
  while (site.grid_spacing < 0.1f * distance) site.grid_spacing *= 2;
  return site;
}

std::span<const Vector3f> house_corners() {
  static const std::vector<Vector3f> corners = [] {
    std::vector<Vector3f> all;
    for (const float x : {-1.0f, 1.0f}) {
      for (const float y : {-1.0f, 1.0f}) {
        all.push_back(at(x * kHalfLength, y * kHalfWidth, 0));
        all.push_back(at(x * kHalfLength, y * kHalfWidth, kEaves));
        all.push_back(at(x * kRoofHalfLength, y * kRoofHalfWidth, kRoofLow));
      }
      all.push_back(at(x * kRoofHalfLength, 0, kRoofRidge));
    }
    return all;
  }();
  return corners;
}

WorldModel make_site_model(const Site& site) {
  WorldModel model;
  model.revision = next_revision();
  add_grid(site, &model);
  std::vector<Vector2f> cast;
  for (const Vector3f& p_h : house_corners()) cast.push_back((p_h - kLight * (p_h.z() / kLight.z())).head<2>());
  add_shadow(convex_hull(cast), 0.04f, 97, site, &model);
  constexpr float a = kHalfLength, b = kHalfWidth;
  add_shadow({{-a, -b}, {a, -b}, {a, b}, {-a, b}}, 0.10f, 110, site, &model);  // where it touches the ground
  for (const Face& face : house_faces()) add_face(face, site, &model);
  return model;
}

WorldModel make_map_model(std::span<const MapPointInfo> points, std::span<const KeyframeInfo> keyframes,
                          const pptam::Camera& camera, const SE3* T_cw) {
  WorldModel model;
  model.revision = next_revision();
  std::vector<float> distances;
  for (const MapPointInfo& point : points) {
    model.points.push_back({point.p_w, kPointColour, 4});
    if (!keyframes.empty()) distances.push_back((point.p_w - keyframes.front().T_cw.centre()).norm());
  }
  if (distances.empty()) return model;
  const float size = 0.08f * range_of(distances).second;
  for (const KeyframeInfo& keyframe : keyframes) add_camera(camera, keyframe.T_cw, size, kKeyframeColour, 1, &model);
  if (T_cw != nullptr) add_camera(camera, *T_cw, 1.5f * size, kCameraColour, 2.5f, &model);
  return model;
}

Eye eye_above(std::span<const MapPointInfo> points, std::span<const KeyframeInfo> keyframes, int width, int height) {
  constexpr float kFieldOfView = 0.8f;  // radians, of the shorter side
  constexpr float kAslant = 0.35f;      // radians
  Eye eye;
  CameraModel& lens = eye.camera.model;
  lens.width = width;
  lens.height = height;
  lens.fx = lens.fy = 0.5f * static_cast<float>(std::min(width, height)) / std::tan(0.5f * kFieldOfView);
  lens.cx = 0.5f * static_cast<float>(width - 1);
  lens.cy = 0.5f * static_cast<float>(height - 1);
  lens.prepare();
  Vector3f middle = Vector3f::Zero();
  float reach = 1;
  Vector3f up(0, 1, 0);  // of the picture, on the ground
  if (!points.empty()) {
    std::array<std::vector<float>, 3> values;
    for (int axis = 0; axis < 3; ++axis) {
      auto& of_axis = values[static_cast<size_t>(axis)];
      for (const MapPointInfo& point : points) of_axis.push_back(point.p_w[axis]);
      auto [low, high] = range_of(of_axis);
      for (const KeyframeInfo& keyframe : keyframes) {
        low = std::min(low, keyframe.T_cw.centre()[axis]);
        high = std::max(high, keyframe.T_cw.centre()[axis]);
      }
      middle[axis] = 0.5f * (low + high);
      reach = axis == 0 ? 0.5f * (high - low) : std::max(reach, 0.5f * (high - low));
    }
  }
  if (!keyframes.empty()) {
    const Matrix3f& R = keyframes.front().T_cw.R;
    for (const Vector3f& way : {Vector3f(R.row(2).transpose()), Vector3f(-R.row(1).transpose())}) {
      if (std::hypot(way.x(), way.y()) < 0.3f) continue;  // looks down
      up = Vector3f(way.x(), way.y(), 0).normalized();
      break;
    }
  }
  const Vector3f forward = std::sin(kAslant) * up - std::cos(kAslant) * Vector3f(0, 0, 1);
  const Vector3f right = forward.cross(Vector3f(std::cos(kAslant) * up + std::sin(kAslant) * Vector3f(0, 0, 1)));
  eye.T_cw.R.row(0) = right.transpose();
  eye.T_cw.R.row(1) = forward.cross(right).transpose();
  eye.T_cw.R.row(2) = forward.transpose();
  const float away = 1.6f * reach / std::tan(0.5f * kFieldOfView);
  eye.T_cw.t = -(eye.T_cw.R * (middle - away * forward));
  eye.near_z = 0.02f * away;
  eye.near_faces_z = 0.4f * away;
  return eye;
}

}  // namespace pptam::platform
