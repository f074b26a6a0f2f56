#include "edges/model_view.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include "base/deterministic_math.h"

namespace pptam {

namespace {

// Degrees between two faces below which their common side is smooth, as a cosine: 30. Not swept.
constexpr float kSmoothCosine = 0.866f;
// A face turned away less than this from the line of sight shows its sides so close to each other that they are taken
// for one another, as a cosine of its normal with the line of sight: 3 degrees. Not swept.
constexpr float kGrazing = 0.05f;
// Share of the object's extent by which an occluder must be nearer than what it hides: models' parts meet inexactly.
constexpr float kOcclusionMargin = 0.02f;
// Level pixels: shorter contours are not sought, nor closed ones narrower than this. Masks are 5 pixels long.
constexpr float kShortest_px = 8, kNarrowest_px = 7;
// Level pixels that a site keeps from the image's border.
constexpr float kBorder_px = 3;
// Of the length that a side would have in the image at the object's middle, as many times count at most: one that
// crosses the camera's plane has no bound of its own.
constexpr float kMostNearer = 4;

// Any unit vector at a right angle to unit vector n.
Vector3f perpendicular(const Vector3f& n) {
  const Vector3f other = std::abs(n.x()) < 0.6f ? Vector3f(1, 0, 0) : Vector3f(0, 1, 0);
  const Vector3f u = other - n * n.dot(other);
  return u / std::sqrt(u.squaredNorm());
}

// Newell's normal of a polygon: twice its area long, right-handed to its corners' order.
Vector3f polygon_normal(const ObjectModel& model, const ModelFace& face) {
  Vector3f normal = Vector3f::Zero();
  for (int i = 1; i + 1 < face.count; ++i) {
    const Vector3f& first = model.points[model.corners[face.first]];
    const Vector3f& p = model.points[model.corners[face.first + i]];
    const Vector3f& q = model.points[model.corners[face.first + i + 1]];
    normal += (p - first).cross(q - first);
  }
  return normal;
}

}  // namespace

ModelParts::ModelParts(Arena& arena, const ObjectModel& model)
    : model_(model),
      normals_(arena, static_cast<int>(model.faces.size())),
      same_point_(arena, static_cast<int>(model.points.size())) {
  size_t sides = model.lines.size();
  for (const ModelFace& face : model.faces) sides += static_cast<size_t>(face.count);
  sides_ = FixedVector<ModelSide>(arena, static_cast<int>(sides));
  if (same_point_.capacity() != static_cast<int>(model.points.size())) return;  // only measured, or too small a block
  if (normals_.capacity() != static_cast<int>(model.faces.size())) return;
  if (sides_.capacity() != static_cast<int>(sides)) return;

  Vector3f low = Vector3f::Constant(INFINITY), high = -low;
  const auto include = [&](const Vector3f& centre, float radius) {
    low = low.cwiseMin(centre - Vector3f::Constant(radius));
    high = high.cwiseMax(centre + Vector3f::Constant(radius));
  };
  for (size_t i = 0; i < model.points.size(); ++i) {
    int same = 0;
    while (model.points[static_cast<size_t>(same)] != model.points[i]) ++same;
    same_point_.push_back(same);
  }
  for (size_t f = 0; f < model.faces.size(); ++f) {
    const ModelFace& face = model.faces[f];
    const Vector3f normal = polygon_normal(model, face);
    const float length = std::sqrt(normal.squaredNorm());
    normals_.push_back(length > 0 ? Vector3f(normal / length) : Vector3f(Vector3f::Zero()));
    for (int i = 0; i < face.count; ++i) {
      const int corner = model.corner(face, i);
      include(model.points[static_cast<size_t>(corner)], 0);
      if (i + 1 == face.count && (face.open || face.count == 2)) break;
      const int next = model.corner(face, i + 1);
      add_side(same_point_[corner], same_point_[next], static_cast<int>(f), face.min_length_px);
    }
  }
  for (const ModelLine& line : model.lines) {
    for (const int end : {line.a, line.b}) include(model.points[static_cast<size_t>(end)], 0);
    add_side(same_point_[line.a], same_point_[line.b], -1, line.min_length_px);
  }
  for (const ModelCylinder& cylinder : model.cylinders)
    for (const int end : {cylinder.a, cylinder.b}) include(model.points[static_cast<size_t>(end)], cylinder.radius);
  for (const ModelCircle& circle : model.circles) include(circle.centre, circle.radius);
  for (const ModelSphere& sphere : model.spheres) include(sphere.centre, sphere.radius);
  middle_ = 0.5f * (low + high);
  extent_ = 0.5f * std::sqrt((high - low).squaredNorm());
  for (ModelSide& side : sides_) {
    if (side.faces != 2) continue;
    const bool shallow = normals_[side.face[0]].dot(normals_[side.face[1]]) > kSmoothCosine;
    side.smooth = side.face[0] == side.face[1] || (model.outlines_of_smooth && shallow);
  }
}

// A side that several faces have is one contour, with the smallest of their thresholds.
void ModelParts::add_side(int a, int b, int face, float min_length_px) {
  if (a == b) return;
  for (ModelSide& side : sides_) {
    if (!((side.a == a && side.b == b) || (side.a == b && side.b == a))) continue;
    side.min_length_px = std::min(side.min_length_px, min_length_px);
    if (face < 0 || side.faces == 0) {  // a line of its own stays always visible
      side.faces = 0;
      side.face[0] = side.face[1] = -1;
      return;
    }
    if (side.faces < 2) side.face[side.faces] = face;
    ++side.faces;
    return;
  }
  ModelSide side;
  side.a = a;
  side.b = b;
  side.min_length_px = min_length_px;
  if (face >= 0) {
    side.face[0] = face;
    side.faces = 1;
  }
  sides_.push_back(side);
}

int ModelParts::contours() const {
  return sides_.size() + static_cast<int>(2 * model_.cylinders.size() + model_.circles.size() + model_.spheres.size());
}

int ModelParts::contours_at_most() const {
  size_t sides = model_.lines.size();
  for (const ModelFace& face : model_.faces) sides += static_cast<size_t>(face.count);
  return static_cast<int>(sides + 2 * model_.cylinders.size() + model_.circles.size() + model_.spheres.size());
}

int ModelParts::occluders() const {
  return static_cast<int>(model_.faces.size() + model_.cylinders.size() + model_.spheres.size());
}

ModelFeature ModelParts::feature(int contour) const {
  contour -= sides_.size();
  if (contour < 0) return ModelFeature::kLine;
  contour -= static_cast<int>(2 * model_.cylinders.size());
  if (contour < 0) return ModelFeature::kCylinder;
  return contour < static_cast<int>(model_.circles.size()) ? ModelFeature::kCircle : ModelFeature::kSphere;
}

ModelView::ModelView(Arena& arena, const ModelParts& parts, const Camera& camera)
    : parts_(parts),
      camera_(camera),
      focal_(0.5f * (camera.model.fx + camera.model.fy)),
      points_(arena, static_cast<int>(parts.model().points.size())),
      image_(arena, static_cast<int>(parts.model().points.size())),
      facing_(arena, static_cast<int>(parts.model().faces.size())),
      visible_(arena, parts.contours_at_most()),
      occluders_(arena, parts.occluders()) {
  x0_ = y0_ = INFINITY;
  x1_ = y1_ = -INFINITY;
  constexpr int kSteps = 16;  // round the image's border, where a lens' bend is largest
  for (int i = 0; i <= kSteps; ++i) {
    const float x = static_cast<float>(camera.model.width - 1) * static_cast<float>(i) / kSteps;
    const float y = static_cast<float>(camera.model.height - 1) * static_cast<float>(i) / kSteps;
    const float right = static_cast<float>(camera.model.width - 1),
                bottom = static_cast<float>(camera.model.height - 1);
    for (const Vector2f& px : {Vector2f(x, 0), Vector2f(x, bottom), Vector2f(0, y), Vector2f(right, y)}) {
      const Vector2f ray = camera.unproject(px);
      x0_ = std::min(x0_, ray.x());
      x1_ = std::max(x1_, ray.x());
      y0_ = std::min(y0_, ray.y());
      y1_ = std::max(y1_, ray.y());
    }
  }
}

void ModelView::set_pose(const SE3& T_co) {
  T_co_ = T_co;
  points_.clear();
  image_.clear();
  visible_.clear();
  occluders_.clear();
  facing_px_ = inside_px_ = 0;
  most_px_ = kMostNearer * focal_ / std::max((T_co * parts_.middle()).z(), 0.1f * parts_.extent());
  for (const Vector3f& p_o : parts_.model().points) {
    const Vector3f p = T_co * p_o;
    points_.push_back(p);
    const float z = std::max(p.z(), 1e-6f * parts_.extent());
    image_.push_back(Vector2f(p.x() / z, p.y() / z));
  }
  place_faces();
  add_solid_occluders();
  const ObjectModel& model = parts_.model();
  int contour = 0;
  for (const ModelSide& side : parts_.sides()) {
    const bool first = side.faces > 0 && facing_[side.face[0]], second = side.faces > 1 && facing_[side.face[1]];
    bool seen = side.faces == 0 || first || second || side.faces > 2;
    if (side.smooth && first == second) seen = false;
    if (seen) add_visible(contour, side.min_length_px);
    ++contour;
  }
  for (const ModelCylinder& cylinder : model.cylinders) {
    add_visible(contour++, cylinder.min_length_px);
    add_visible(contour++, cylinder.min_length_px);
  }
  for (const ModelCircle& circle : model.circles) {
    const Vector3f centre = T_co * circle.centre, normal = T_co.R * circle.normal;
    const float facing = -normal.dot(centre);
    const float least = kGrazing * std::sqrt(normal.squaredNorm() * centre.squaredNorm());
    if (facing > least || (circle.both_sides && -facing > least)) add_visible(contour, circle.min_area_px2);
    ++contour;
  }
  for (const ModelSphere& sphere : model.spheres) add_visible(contour++, sphere.min_area_px2);
}

void ModelView::place_faces() {
  const ObjectModel& model = parts_.model();
  facing_.clear();
  for (size_t f = 0; f < model.faces.size(); ++f) {
    const ModelFace& face = model.faces[f];
    const Vector3f& corner = points_[model.corners[static_cast<size_t>(face.first)]];
    const Vector3f normal = T_co_.R * parts_.normals()[f];
    const float towards = -normal.dot(corner) / std::sqrt(corner.squaredNorm());
    bool facing = face.count == 2 || towards > kGrazing;
    if (face.count > 2 && std::abs(towards) > kGrazing) add_face_occluder(static_cast<int>(f));
    if (facing && face.min_area_px2 > 0) {
      float area = 0;  // of the projected polygon, twice
      for (int i = 0; i < face.count; ++i) {
        const Vector2f& p = image_[model.corner(face, i)];
        const Vector2f& q = image_[model.corner(face, i + 1)];
        area += p.x() * q.y() - p.y() * q.x();
      }
      facing = 0.5f * std::abs(area) * focal_ * focal_ >= face.min_area_px2;
    }
    facing_.push_back(facing ? 1 : 0);
  }
}

void ModelView::add_face_occluder(int f) {
  const ObjectModel& model = parts_.model();
  const ModelFace& face = model.faces[static_cast<size_t>(f)];
  const Vector3f normal = T_co_.R * parts_.normals()[static_cast<size_t>(f)];
  Occluder occluder;
  occluder.face = f;
  occluder.x0 = occluder.y0 = INFINITY;
  occluder.x1 = occluder.y1 = -INFINITY;
  for (int i = 0; i < face.count; ++i) {
    const int corner = model.corner(face, i);
    if (!(points_[corner].z() > 0.01f * parts_.extent())) return;  // reaches behind the camera: hides nothing
    occluder.x0 = std::min(occluder.x0, image_[corner].x());
    occluder.x1 = std::max(occluder.x1, image_[corner].x());
    occluder.y0 = std::min(occluder.y0, image_[corner].y());
    occluder.y1 = std::max(occluder.y1, image_[corner].y());
  }
  occluder.inverse_depth = normal / normal.dot(points_[model.corners[static_cast<size_t>(face.first)]]);
  occluders_.push_back(occluder);
}

void ModelView::add_solid_occluders() {
  const auto bound = [](Occluder* occluder) {
    occluder->x0 = occluder->y0 = INFINITY;
    occluder->x1 = occluder->y1 = -INFINITY;
    for (const Vector2f& corner : occluder->corner) {
      occluder->x0 = std::min(occluder->x0, corner.x());
      occluder->x1 = std::max(occluder->x1, corner.x());
      occluder->y0 = std::min(occluder->y0, corner.y());
      occluder->y1 = std::max(occluder->y1, corner.y());
    }
  };
  for (const ModelCylinder& cylinder : parts_.model().cylinders) {
    const Vector3f &a = points_[cylinder.a], &b = points_[cylinder.b];
    Vector3f limb[4];
    if (!cylinder_limb(a, b, cylinder.radius, 0, &limb[0], &limb[1]) ||
        !cylinder_limb(a, b, cylinder.radius, 1, &limb[3], &limb[2]))
      continue;
    Occluder occluder;
    bool before = true;
    for (int i = 0; i < 4; ++i) {
      before = before && limb[i].z() > 0.01f * parts_.extent();
      occluder.corner[i] = limb[i].head<2>() / limb[i].z();
    }
    if (!before) continue;
    const Vector3f normal = (limb[1] - limb[0]).cross(limb[3] - limb[0]);
    occluder.inverse_depth = normal / normal.dot(limb[0]);
    bound(&occluder);
    occluders_.push_back(occluder);
  }
  for (const ModelSphere& sphere : parts_.model().spheres) {
    Vector3f Q, n;
    float r;
    Occluder occluder;
    occluder.disc = true;
    if (!sphere_outline(T_co_ * sphere.centre, sphere.radius, &Q, &n, &r) || !occluder.ellipse.set(Q, n, r)) continue;
    const EllipseContour& e = occluder.ellipse;
    occluder.x0 = e.xg - std::sqrt(e.mu20);
    occluder.x1 = e.xg + std::sqrt(e.mu20);
    occluder.y0 = e.yg - std::sqrt(e.mu02);
    occluder.y1 = e.yg + std::sqrt(e.mu02);
    occluder.inverse_depth = n / n.dot(Q);
    occluders_.push_back(occluder);
  }
}

bool ModelView::place(int contour, const SE3& T_co, PlacedContour* placed) const {
  const ObjectModel& model = parts_.model();
  const auto point = [&](int i) { return T_co * model.points[static_cast<size_t>(i)]; };
  placed->straight = true;
  if (contour < static_cast<int>(parts_.sides().size())) {
    const ModelSide& side = parts_.sides()[static_cast<size_t>(contour)];
    placed->a = point(side.a);
    placed->b = point(side.b);
    return true;
  }
  contour -= static_cast<int>(parts_.sides().size());
  if (contour < static_cast<int>(2 * model.cylinders.size())) {
    const ModelCylinder& cylinder = model.cylinders[static_cast<size_t>(contour / 2)];
    return cylinder_limb(point(cylinder.a), point(cylinder.b), cylinder.radius, contour % 2, &placed->a, &placed->b);
  }
  contour -= static_cast<int>(2 * model.cylinders.size());
  placed->straight = false;
  if (contour < static_cast<int>(model.circles.size())) {
    const ModelCircle& circle = model.circles[static_cast<size_t>(contour)];
    const Vector3f normal = circle.normal / std::sqrt(circle.normal.squaredNorm());
    const Vector3f u = perpendicular(normal);
    placed->a = T_co * circle.centre;
    placed->b = T_co.R * normal;
    placed->u = T_co.R * u;
    placed->v = placed->b.cross(placed->u);
    placed->radius = circle.radius;
    return true;
  }
  const ModelSphere& sphere = model.spheres[static_cast<size_t>(contour) - model.circles.size()];
  if (!sphere_outline(T_co * sphere.centre, sphere.radius, &placed->a, &placed->b, &placed->radius)) return false;
  placed->u = perpendicular(placed->b);
  placed->v = placed->b.cross(placed->u);
  return true;
}

// Liang and Barsky's way. False: no part of the segment from p to q lies within the image; else it is that between
// *from and *to, 0 to 1.
bool ModelView::clip(const Vector2f& p, const Vector2f& q, float* from, float* to) const {
  const Vector2f d = q - p;
  const float into[4] = {-d.x(), d.x(), -d.y(), d.y()};
  const float room[4] = {p.x() - x0_, x1_ - p.x(), p.y() - y0_, y1_ - p.y()};
  *from = 0;
  *to = 1;
  for (int i = 0; i < 4; ++i) {
    if (into[i] == 0) {
      if (room[i] < 0) return false;
      continue;
    }
    const float t = room[i] / into[i];
    if (into[i] < 0) *from = std::max(*from, t);
    if (into[i] > 0) *to = std::min(*to, t);
  }
  return *from < *to;
}

// least: pixels of a straight contour's length, squared ones of a closed one's area.
void ModelView::add_visible(int contour, float least) {
  Visible visible;
  visible.contour = contour;
  PlacedContour& placed = visible.placed;
  if (!place(contour, T_co_, &placed)) return;
  if (!placed.straight) {
    add_closed(&visible, least);
    return;
  }
  visible.width_px = INFINITY;
  const float near = 0.01f * parts_.extent();  // what is nearer to the camera's plane is cut off
  Vector3f &a = placed.a, &b = placed.b;
  const float most_px = most_px_ * std::sqrt((b - a).squaredNorm());
  if (a.z() < near && b.z() < near) return;
  if (a.z() < near) a = (a + (b - a) * ((near - a.z()) / (b.z() - a.z()))).eval();
  if (b.z() < near) b = (b + (a - b) * ((near - b.z()) / (a.z() - b.z()))).eval();
  const Vector2f p = a.head<2>() / a.z(), q = b.head<2>() / b.z();
  const float whole_px = focal_ * std::sqrt((q - p).squaredNorm());
  if (!(whole_px >= least)) return;
  facing_px_ += std::min(whole_px, most_px);
  if (!clip(p, q, &visible.from, &visible.to)) return;
  visible.length_px = whole_px * (visible.to - visible.from);
  inside_px_ += visible.length_px;
  visible_.push_back(visible);
}

void ModelView::add_closed(Visible* visible, float min_area_px2) {
  constexpr float kHalfTurn = 3.1415927f;
  const PlacedContour& placed = visible->placed;
  EllipseContour ellipse;
  if (!ellipse.set(placed.a, placed.b, placed.radius)) return;
  const float sum = ellipse.mu20 + ellipse.mu02;
  const float det = ellipse.mu20 * ellipse.mu02 - ellipse.mu11 * ellipse.mu11;
  if (!(kHalfTurn * focal_ * focal_ * std::sqrt(det) >= min_area_px2)) return;
  const float difference =
      std::sqrt((ellipse.mu20 - ellipse.mu02) * (ellipse.mu20 - ellipse.mu02) + 4 * ellipse.mu11 * ellipse.mu11);
  visible->width_px = 2 * focal_ * std::sqrt(std::max(0.5f * (sum - difference), 0.0f));
  const float whole_px = 2 * kHalfTurn * focal_ * std::sqrt(0.5f * sum);
  const float half_width = std::sqrt(ellipse.mu20), half_height = std::sqrt(ellipse.mu02);
  visible->buckets = ~uint64_t{0};
  if (ellipse.xg - half_width < x0_ || ellipse.xg + half_width > x1_ || ellipse.yg - half_height < y0_ ||
      ellipse.yg + half_height > y1_) {
    visible->buckets = 0;
    Vector2f before;
    for (int i = 0; i <= kSiteBuckets; ++i) {
      const float angle = 2 * kHalfTurn * static_cast<float>(i) / kSiteBuckets;
      const Vector3f at = placed.a + placed.radius * (placed.u * det_cos(angle) + placed.v * det_sin(angle));
      const Vector2f ray = at.head<2>() / at.z();
      float from, to;
      if (i > 0 && clip(before, ray, &from, &to)) visible->buckets |= uint64_t{1} << (i - 1);
      before = ray;
    }
  }
  visible->length_px = whole_px * static_cast<float>(std::popcount(visible->buckets)) / kSiteBuckets;
  facing_px_ += whole_px;
  inside_px_ += visible->length_px;
  if (visible->buckets != 0) visible_.push_back(*visible);
}

bool ModelView::inside(const Occluder& occluder, float x, float y) const {
  if (occluder.disc) return occluder.ellipse.algebraic(x, y) < 0;
  const ObjectModel& model = parts_.model();
  const ModelFace* face = occluder.face >= 0 ? &model.faces[static_cast<size_t>(occluder.face)] : nullptr;
  const int count = face ? face->count : 4;
  const auto corner = [&](int i) -> const Vector2f& {
    return face ? image_[model.corner(*face, i)] : occluder.corner[i];
  };
  bool odd = false;  // crossings of a ray to the right
  const Vector2f* p = &corner(count - 1);
  for (int i = 0; i < count; ++i) {
    const Vector2f* q = &corner(i);
    if ((p->y() > y) != (q->y() > y)) {
      const float dy = q->y() - p->y();
      const float cross = (x - p->x()) * dy - (y - p->y()) * (q->x() - p->x());
      if ((cross < 0) == (dy > 0)) odd = !odd;
    }
    p = q;
  }
  return odd;
}

bool ModelView::hidden(float x, float y, float inverse_depth) const {
  const float depth = 1 / inverse_depth;
  const float nearer = 1 / std::max(depth - kOcclusionMargin * parts_.extent(), 0.01f * depth);
  for (const Occluder& occluder : occluders_) {
    if (x < occluder.x0 || x > occluder.x1 || y < occluder.y0 || y > occluder.y1) continue;
    const float at = occluder.inverse_depth.x() * x + occluder.inverse_depth.y() * y + occluder.inverse_depth.z();
    if (at > nearer && inside(occluder, x, y)) return true;
  }
  return false;
}

void ModelView::add_site(const Visible& visible, const Vector3f& p_c, const Vector3f& tangent, float along,
                         const Vector6f& velocity, int level, FixedVector<ContourSite>* sites) const {
  Vector2f px;
  Matrix23f J;
  if (!camera_.project(p_c, &px, &J)) return;
  if (camera_.shutter.line_time_s != 0) {
    PredictedPoint seen;
    if (!camera_.project_rolling(SE3(), velocity, p_c, &seen)) return;
    px = seen.px;
  }
  if (!camera_.in_image(px, kBorder_px * static_cast<float>(1 << level))) return;
  if (hidden(p_c.x() / p_c.z(), p_c.y() / p_c.z(), 1 / p_c.z())) return;
  const Vector2f direction = J * tangent;
  const float length = std::sqrt(direction.squaredNorm());
  if (!(length > 0)) return;
  ContourSite site;
  site.contour = static_cast<uint16_t>(visible.contour);
  site.bucket = static_cast<uint8_t>(std::min(kSiteBuckets - 1, static_cast<int>(along * kSiteBuckets)));
  site.px = px;
  site.normal = Vector2f(-direction.y(), direction.x()) / length;
  site.p_c = p_c;
  sites->push_back(site);
}

void ModelView::add_straight_sites(const Visible& visible, int count, const Vector6f& velocity, int level,
                                   FixedVector<ContourSite>* sites) const {
  // Evenly in the image: x/z, y/z and 1/z are linear there.
  const PlacedContour& placed = visible.placed;
  const float iz_a = 1 / placed.a.z(), iz_b = 1 / placed.b.z(), step = 1 / static_cast<float>(count);
  const Vector2f p = placed.a.head<2>() * iz_a, q = placed.b.head<2>() * iz_b;
  const Vector3f tangent = placed.b - placed.a;
  for (int i = 0; i < count; ++i) {
    const float t = visible.from + (visible.to - visible.from) * (static_cast<float>(i) + 0.5f) * step;
    const float z = 1 / (iz_a + (iz_b - iz_a) * t);
    const Vector2f ray = p + (q - p) * t;
    add_site(visible, Vector3f(ray.x() * z, ray.y() * z, z), tangent, t * iz_b * z, velocity, level, sites);
  }
}

// On the parts first to end - 1 of a closed contour.
void ModelView::add_arc_sites(const Visible& visible, int first, int end, int count, const Vector6f& velocity,
                              int level, FixedVector<ContourSite>* sites) const {
  constexpr float kTurn = 6.2831853f;
  const PlacedContour& placed = visible.placed;
  const float step = static_cast<float>(end - first) / static_cast<float>(count);
  for (int i = 0; i < count; ++i) {
    const float along = (static_cast<float>(first) + (static_cast<float>(i) + 0.5f) * step) / kSiteBuckets;
    const float c = det_cos(kTurn * along), s = det_sin(kTurn * along);
    const Vector3f tangent = placed.v * c - placed.u * s;
    add_site(visible, placed.a + placed.radius * (placed.u * c + placed.v * s), tangent, along, velocity, level, sites);
  }
}

// Sites are counted along all contours as if they were one, at most capacity of them, so that where they are few no
// contour is left out for the sake of those before it.
float ModelView::make_sites(int level, float spacing, const Vector6f& velocity, FixedVector<ContourSite>* sites) const {
  sites->clear();
  const float unit = static_cast<float>(1 << level);
  const auto sought = [&](const Visible& visible) {
    return visible.length_px >= kShortest_px * unit && visible.width_px >= kNarrowest_px * unit;
  };
  float total = 0;
  for (const Visible& visible : visible_) total += sought(visible) ? visible.length_px / unit : 0;
  spacing = std::max(spacing, total / static_cast<float>(std::max(sites->capacity(), 1)));
  float passed = 0.5f;  // spacings
  const auto sites_on = [&](float length_px) {
    const int before = static_cast<int>(passed);
    passed += length_px / (unit * spacing);
    return static_cast<int>(passed) - before;
  };
  for (const Visible& visible : visible_) {
    if (!sought(visible)) continue;
    if (visible.placed.straight) {
      add_straight_sites(visible, sites_on(visible.length_px), velocity, level, sites);
      continue;
    }
    const float part_px = visible.length_px / static_cast<float>(std::popcount(visible.buckets));
    for (int end, first = 0; first < kSiteBuckets; first = end + 1) {
      for (end = first; end < kSiteBuckets && (visible.buckets >> end & 1) != 0;) ++end;
      if (end == first) continue;
      const int count = sites_on(part_px * static_cast<float>(end - first));
      add_arc_sites(visible, first, end, count, velocity, level, sites);
    }
  }
  return spacing;
}

}  // namespace pptam
