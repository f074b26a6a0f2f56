#include "platform/run/overlay.h"

#include <cairo.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <optional>

#include <pocket_ptam/image.h>
#include "platform/input_error.h"
#include "platform/run/names.h"
#include "platform/run/picture.h"
#include "platform/run/video_writer.h"

namespace pptam::platform {
namespace {

constexpr Colour kGreen = {0.20, 0.85, 0.40};
constexpr Colour kRed = {0.95, 0.25, 0.25};
constexpr Colour kYellow = {1.00, 0.82, 0.20};
constexpr Colour kBlue = {0.30, 0.65, 1.00};
constexpr Colour kGrey = {0.72, 0.72, 0.72};
constexpr Colour kGrid = {0.45, 0.85, 1.00};
constexpr Colour kPanel = {0.10, 0.11, 0.13};
constexpr Colour kText = {0.93, 0.94, 0.95};
constexpr Colour kWall = {0.96, 0.88, 0.72};
constexpr Colour kRoof = {0.82, 0.29, 0.22};
constexpr Colour kDoor = {0.45, 0.27, 0.16};
constexpr Colour kWindow = {0.48, 0.70, 0.86};

// Draws world geometry: clips it to what the camera model can project, and bends it as the lens does.
class Projector {
 public:
  Projector(const CameraModel& model, double scale) : model_(model), scale_(scale) {
    // A square inside the circle that project() accepts: no clipped point can fail to project.
    slope_ = 0.999f * std::sqrt(0.5f * model.max_radius_sq);
  }
  void set_pose(const SE3& T_cw) { T_cw_ = T_cw; }
  Vector3f camera_centre() const { return T_cw_.centre(); }

  // Appends the visible part of a world segment to cr's path.
  void line(cairo_t* cr, const Vector3f& from_w, const Vector3f& to_w) const {
    Vector3f a = T_cw_ * from_w;
    Vector3f b = T_cw_ * to_w;
    for (int plane = 0; plane < kPlanes; ++plane) {
      const float da = inside(plane, a);
      const float db = inside(plane, b);
      if (da < 0 && db < 0) return;
      if (da < 0) a = (a + (b - a) * (da / (da - db))).eval();
      if (db < 0) b = (b + (a - b) * (db / (db - da))).eval();
    }
    bool started = false;
    bend(a, b, [&](const Vector2f& px) {
      started ? cairo_line_to(cr, x(px), y(px)) : cairo_move_to(cr, x(px), y(px));
      started = true;
    });
  }

  // Appends the visible part of a convex world polygon to cr's path; false when nothing of it is visible.
  bool polygon(cairo_t* cr, std::span<const Vector3f> corners_w) const {
    std::vector<Vector3f> corners;
    for (const Vector3f& p_w : corners_w) corners.push_back(T_cw_ * p_w);
    for (int plane = 0; plane < kPlanes; ++plane) corners = clipped(corners, plane);
    if (corners.size() < 3) return false;
    bool started = false;
    for (size_t i = 0; i < corners.size(); ++i) {
      bend(corners[i], corners[(i + 1) % corners.size()], [&](const Vector2f& px) {
        started ? cairo_line_to(cr, x(px), y(px)) : cairo_move_to(cr, x(px), y(px));
        started = true;
      });
    }
    cairo_close_path(cr);
    return started;
  }

  double x(const Vector2f& px) const { return (static_cast<double>(px.x()) + 0.5) * scale_; }
  double y(const Vector2f& px) const { return (static_cast<double>(px.y()) + 0.5) * scale_; }

 private:
  static constexpr int kPlanes = 5;
  static constexpr float kNear = 1e-4f;  // world units, a thousandth of the first baseline

  float inside(int plane, const Vector3f& p_c) const {  // positive inside
    switch (plane) {
      case 0:
        return p_c.z() - kNear;
      case 1:
        return slope_ * p_c.z() - p_c.x();
      case 2:
        return slope_ * p_c.z() + p_c.x();
      case 3:
        return slope_ * p_c.z() - p_c.y();
      default:
        return slope_ * p_c.z() + p_c.y();
    }
  }

  std::vector<Vector3f> clipped(const std::vector<Vector3f>& corners, int plane) const {
    std::vector<Vector3f> kept;
    for (size_t i = 0; i < corners.size(); ++i) {
      const Vector3f& a = corners[i];
      const Vector3f& b = corners[(i + 1) % corners.size()];
      const float da = inside(plane, a);
      const float db = inside(plane, b);
      if (da >= 0) kept.push_back(a);
      if ((da >= 0) != (db >= 0)) kept.push_back(a + (b - a) * (da / (da - db)));
    }
    return kept;
  }

  template <class Emit>
  void bend(const Vector3f& a, const Vector3f& b, Emit&& emit) const {
    constexpr int kPieces = 8;
    for (int i = 0; i <= kPieces; ++i) {
      const float s = static_cast<float>(i) / kPieces;
      Vector2f px;
      if (model_.project(a + (b - a) * s, &px)) emit(px);
    }
  }

  CameraModel model_;
  double scale_;
  float slope_;
  SE3 T_cw_;
};

// The house: local unit 1 is its longer side; z up, its floor's centre at the origin.
struct Face {
  std::array<Vector3f, 4> corners;  // counter-clockwise from outside; the last repeats in triangles
  Colour colour;
};

std::vector<Face> make_walls() {
  constexpr float a = 0.50f;  // half length
  constexpr float b = 0.36f;  // half width
  constexpr float h = 0.52f;  // eaves
  constexpr float r = 0.92f;  // ridge, along x
  const Vector3f ridge_left(-a, 0, r);
  const Vector3f ridge_right(a, 0, r);
  const auto at = [](float x, float y, float z) { return Vector3f(x, y, z); };
  constexpr float e = 0.002f;  // decals stand off the wall
  return {
      {{at(-a, -b, 0), at(a, -b, 0), at(a, -b, h), at(-a, -b, h)}, kWall},
      {{at(a, b, 0), at(-a, b, 0), at(-a, b, h), at(a, b, h)}, kWall},
      {{at(a, -b, 0), at(a, b, 0), at(a, b, h), at(a, -b, h)}, kWall},
      {{at(-a, b, 0), at(-a, -b, 0), at(-a, -b, h), at(-a, b, h)}, kWall},
      {{at(a, -b, h), at(a, b, h), ridge_right, ridge_right}, kWall},
      {{at(-a, b, h), at(-a, -b, h), ridge_left, ridge_left}, kWall},
      {{at(-0.10f, -b - e, 0), at(0.10f, -b - e, 0), at(0.10f, -b - e, 0.36f), at(-0.10f, -b - e, 0.36f)}, kDoor},
      {{at(-0.40f, -b - e, 0.18f), at(-0.20f, -b - e, 0.18f), at(-0.20f, -b - e, 0.38f), at(-0.40f, -b - e, 0.38f)},
       kWindow},
      {{at(0.20f, -b - e, 0.18f), at(0.40f, -b - e, 0.18f), at(0.40f, -b - e, 0.38f), at(0.20f, -b - e, 0.38f)},
       kWindow},
      {{at(a + e, -0.12f, 0.18f), at(a + e, 0.12f, 0.18f), at(a + e, 0.12f, 0.40f), at(a + e, -0.12f, 0.40f)}, kWindow},
      {{at(-a - e, 0.12f, 0.18f), at(-a - e, -0.12f, 0.18f), at(-a - e, -0.12f, 0.40f), at(-a - e, 0.12f, 0.40f)},
       kWindow},
      {{at(0.20f, b + e, 0.18f), at(-0.20f, b + e, 0.18f), at(-0.20f, b + e, 0.40f), at(0.20f, b + e, 0.40f)}, kWindow},
  };
}

std::vector<Face> make_roof() {
  constexpr float a = 0.57f;
  constexpr float b = 0.44f;
  constexpr float low = 0.43f;
  constexpr float ridge = 0.94f;
  const auto at = [](float x, float y, float z) { return Vector3f(x, y, z); };
  return {{{at(-a, -b, low), at(a, -b, low), at(a, 0, ridge), at(-a, 0, ridge)}, kRoof},
          {{at(a, b, low), at(-a, b, low), at(-a, 0, ridge), at(a, 0, ridge)}, kRoof}};
}

// Where the virtual things stand; fixed by the first tracked frame.
struct Stage3d {
  Vector3f anchor = Vector3f::Zero();  // on z = 0
  Matrix3f R_wh = Matrix3f::Identity();
  float house_size = 0;
  float grid_spacing = 0;

  Vector3f to_world(const Vector3f& local) const { return anchor + house_size * (R_wh * local); }
};

Stage3d place(const SE3& T_cw, float initial_baseline) {
  Stage3d stage;
  const Vector3f centre = T_cw.centre();
  const Vector3f axis = T_cw.R.row(2).transpose();
  const float height = std::max(std::abs(centre.z()), 0.5f * initial_baseline);
  float along = 2 * height;  // a view along the ground never meets it, or far away
  if (axis.z() < -0.2f) along = centre.z() / -axis.z();
  stage.anchor = centre + along * axis;
  stage.anchor.z() = 0;
  const float distance = (stage.anchor - centre).norm();
  stage.house_size = 0.2f * distance;
  // The door looks to the camera, turned by 35 degrees so that two walls show.
  Vector3f towards = T_cw.R.row(1).transpose();  // image down
  towards.z() = 0;
  if (towards.norm() < 0.1f) towards = Vector3f(0, -1, 0);
  const float angle =
      std::atan2(towards.y(), towards.x()) + 0.5f * std::numbers::pi_v<float> + 0.6f;  // 0.6: 35 degrees
  stage.R_wh << std::cos(angle), -std::sin(angle), 0, std::sin(angle), std::cos(angle), 0, 0, 0, 1;
  stage.grid_spacing = initial_baseline;
  while (stage.grid_spacing > 0.2f * distance) stage.grid_spacing *= 0.5f;
  while (stage.grid_spacing < 0.1f * distance) stage.grid_spacing *= 2;
  return stage;
}

void draw_grid(cairo_t* cr, const Projector& projector, const Stage3d& stage) {
  constexpr int kCells = 10;  // to each side
  const float step = stage.grid_spacing;
  const float reach = kCells * step;
  const float x0 = std::round(stage.anchor.x() / step) * step;
  const float y0 = std::round(stage.anchor.y() / step) * step;
  cairo_set_line_width(cr, 1.2);
  // Strokes of like opacity share one path: fading out with the distance from the anchor in a few steps.
  constexpr int kShades = 8;
  for (int shade = 0; shade < kShades; ++shade) {
    for (int line = -kCells; line <= kCells; ++line) {
      for (int piece = -kCells; piece < kCells; ++piece) {
        const float u = static_cast<float>(line) * step;
        const float v = static_cast<float>(piece) * step;
        const float far = std::hypot(u, v + 0.5f * step) / reach;
        if (static_cast<int>(far * kShades) != shade) continue;
        projector.line(cr, {x0 + u, y0 + v, 0}, {x0 + u, y0 + v + step, 0});
        projector.line(cr, {x0 + v, y0 + u, 0}, {x0 + v + step, y0 + u, 0});
      }
    }
    set_colour(cr, kGrid, 0.55 * (1 - (shade + 0.5) / kShades));
    cairo_stroke(cr);
  }
}

void draw_house(cairo_t* cr, const Projector& projector, const Stage3d& stage) {
  static const std::vector<Face> walls = make_walls();
  static const std::vector<Face> roof = make_roof();
  const Vector3f light = Vector3f(0.45f, -0.35f, 0.82f).normalized();  // in the house's frame
  const auto world_corners = [&](const Face& face) {
    std::array<Vector3f, 4> corners;
    for (size_t i = 0; i < 4; ++i) corners[i] = stage.to_world(face.corners[i]);
    return corners;
  };

  cairo_push_group(cr);  // one flat shadow, not one for each face
  cairo_set_source_rgb(cr, 0, 0, 0);
  for (const std::vector<Face>* faces : {&walls, &roof}) {
    for (const Face& face : *faces) {
      std::array<Vector3f, 4> corners;
      for (size_t i = 0; i < 4; ++i) {
        const Vector3f& p = face.corners[i];
        Vector3f on_ground = p - light * (p.z() / light.z());
        on_ground.z() = 0;
        corners[i] = stage.to_world(on_ground);
      }
      if (projector.polygon(cr, corners)) cairo_fill(cr);
    }
  }
  cairo_pop_group_to_source(cr);
  cairo_paint_with_alpha(cr, 0.38);

  const auto draw = [&](const Face& face) {
    const Vector3f normal = (face.corners[1] - face.corners[0]).cross(face.corners[2] - face.corners[0]).normalized();
    const std::array<Vector3f, 4> corners = world_corners(face);
    if ((projector.camera_centre() - corners[0]).dot(stage.R_wh * normal) <= 0) return;
    const double shade = 0.55 + 0.45 * static_cast<double>(std::max(0.0f, normal.dot(light)));
    if (!projector.polygon(cr, corners)) return;
    set_colour(cr, {face.colour.r * shade, face.colour.g * shade, face.colour.b * shade});
    cairo_fill_preserve(cr);
    cairo_set_line_width(cr, 1);
    set_colour(cr, {face.colour.r * shade * 0.6, face.colour.g * shade * 0.6, face.colour.b * shade * 0.6});
    cairo_stroke(cr);
  };
  // Painter's order: the walls are convex (hidden ones are culled) and the roof covers them, its far half first.
  for (const Face& face : walls) draw(face);
  std::array<const Face*, 2> halves = {&roof[0], &roof[1]};
  const auto distance = [&](const Face* face) {
    return (projector.camera_centre() - stage.to_world(0.5f * (face->corners[0] + face->corners[1]))).norm();
  };
  if (distance(halves[0]) < distance(halves[1])) std::swap(halves[0], halves[1]);
  for (const Face* face : halves) draw(*face);
}

void draw_points(cairo_t* cr, const Projector& projector, std::span<const ObservedPoint> points) {
  constexpr double kFullTurn = 2 * std::numbers::pi;
  for (const ObservedPoint& point : points) {
    const double x = projector.x(point.px);
    const double y = projector.y(point.px);
    const double radius = point.level >= 2 ? 4.5 : 3.0;
    cairo_new_path(cr);
    switch (point.kind) {
      case ObservedKind::kMissed:
      case ObservedKind::kHidden:
        set_colour(cr, kGrey, 0.7);
        cairo_arc(cr, x, y, 1.8, 0, kFullTurn);
        cairo_fill(cr);
        continue;
      case ObservedKind::kInitial:
        set_colour(cr, kBlue, 0.9);
        cairo_set_line_width(cr, 1.6);
        cairo_move_to(cr, projector.x(point.predicted_px), projector.y(point.predicted_px));
        cairo_line_to(cr, x, y);
        cairo_stroke(cr);
        cairo_arc(cr, x, y, 2.4, 0, kFullTurn);
        cairo_fill(cr);
        continue;
      case ObservedKind::kOutlier:
        set_colour(cr, kRed);
        cairo_set_line_width(cr, 2);
        cairo_move_to(cr, x - 3.5, y - 3.5);
        cairo_line_to(cr, x + 3.5, y + 3.5);
        cairo_move_to(cr, x - 3.5, y + 3.5);
        cairo_line_to(cr, x + 3.5, y - 3.5);
        cairo_stroke(cr);
        continue;
      case ObservedKind::kPartial:
        set_colour(cr, kYellow);
        cairo_set_line_width(cr, 1.8);
        cairo_arc(cr, x, y, radius + 1, 0, kFullTurn);
        cairo_stroke(cr);
        continue;
      case ObservedKind::kInlier:
        cairo_arc(cr, x, y, radius, 0, kFullTurn);
        set_colour(cr, kGreen);
        cairo_fill_preserve(cr);
        set_colour(cr, {0.02, 0.25, 0.10}, 0.9);
        cairo_set_line_width(cr, 1);
        cairo_stroke(cr);
        continue;
    }
  }
}

Colour colour_of(const FrameLog& log) {
  switch (log.state) {
    case TrackingState::kWaiting:
      return kGrey;
    case TrackingState::kInitialising:
      return kBlue;
    case TrackingState::kLost:
      return kRed;
    case TrackingState::kTracking:
      break;
  }
  return log.quality == TrackingQuality::kGood ? kGreen : kYellow;
}

void rounded_box(cairo_t* cr, double x, double y, double width, double height, double radius) {
  constexpr double kQuarter = 0.5 * std::numbers::pi;
  cairo_new_sub_path(cr);
  cairo_arc(cr, x + width - radius, y + radius, radius, -kQuarter, 0);
  cairo_arc(cr, x + width - radius, y + height - radius, radius, 0, kQuarter);
  cairo_arc(cr, x + radius, y + height - radius, radius, kQuarter, 2 * kQuarter);
  cairo_arc(cr, x + radius, y + radius, radius, 2 * kQuarter, 3 * kQuarter);
  cairo_close_path(cr);
}

double text_width(cairo_t* cr, const std::string& text) {
  cairo_text_extents_t extents;
  cairo_text_extents(cr, text.c_str(), &extents);
  return extents.x_advance;
}

void draw_text(cairo_t* cr, double x, double y, const std::string& text) {
  cairo_move_to(cr, x, y);
  cairo_show_text(cr, text.c_str());
}

// The strip under the picture: state, quality and hint; counts and cost; progress of the initialisation. unit is 1 for
// a picture 480 wide.
void draw_panel(cairo_t* cr, const FrameLog& log, double top, double width, double height, double unit) {
  set_colour(cr, kPanel);
  cairo_rectangle(cr, 0, top, width, height);
  cairo_fill(cr);
  const Colour colour = colour_of(log);
  set_colour(cr, colour);
  const double share = log.state == TrackingState::kInitialising ? std::clamp<double>(log.progress, 0, 1) : 1;
  cairo_rectangle(cr, 0, top, width * share, 4 * unit);
  cairo_fill(cr);

  cairo_select_font_face(cr, "sans", CAIRO_FONT_SLANT_NORMAL, CAIRO_FONT_WEIGHT_BOLD);
  cairo_set_font_size(cr, 15 * unit);
  const std::string state = name_of(log.state);
  const double chip = text_width(cr, state) + 18 * unit;
  rounded_box(cr, 10 * unit, top + 12 * unit, chip, 24 * unit, 6 * unit);
  cairo_fill(cr);
  set_colour(cr, kPanel);
  draw_text(cr, 19 * unit, top + 29.5 * unit, state);

  cairo_select_font_face(cr, "sans", CAIRO_FONT_SLANT_NORMAL, CAIRO_FONT_WEIGHT_NORMAL);
  set_colour(cr, kText);
  std::string words;
  if (log.state == TrackingState::kTracking) words = std::string("quality ") + name_of(log.quality);
  const std::string hint = sentence_for(log.hint);
  if (!hint.empty()) words += (words.empty() ? "" : ", ") + hint;
  if (log.blurred) words += words.empty() ? "blurred" : ", blurred";
  if (log.misfit) words += words.empty() ? "does not fit the map" : ", does not fit the map";
  draw_text(cr, 22 * unit + chip, top + 29.5 * unit, words);
  if (log.keyframe_added) {
    const std::string added = "+ keyframe";
    set_colour(cr, kYellow);
    draw_text(cr, width - 10 * unit - text_width(cr, added), top + 29.5 * unit, added);
  }

  cairo_set_font_size(cr, 13 * unit);
  set_colour(cr, kText, 0.75);
  char text[160];
  if (log.state == TrackingState::kInitialising) {
    std::snprintf(text, sizeof text, "%.0f %% ready", 100 * share);
  } else {
    std::snprintf(text, sizeof text, "found %d of %d    keyframes %d    points %d    %.0f ms", log.points_found,
                  log.points_attempted, log.keyframes, log.map_points, 1e-6 * static_cast<double>(log.track_ns));
  }
  draw_text(cr, 12 * unit, top + 54 * unit, text);
}

}  // namespace

struct Overlay::Impl {
  Impl(const CameraInfo& camera, const std::filesystem::path& video_file, std::vector<std::string>* warnings)
      : model(prepared(camera.model)),
        scale(model.width > 960 ? 1 : 2),
        projector(model, scale),
        unit(std::max(0.5, model.width * scale / 480.0)),
        width(even(model.width * scale)),
        picture_height(model.height * scale),
        height(even(picture_height + static_cast<int>(std::lround(66 * unit)))),
        canvas(make_surface(width, height)),
        picture(make_surface(model.width, model.height)),
        grey(static_cast<size_t>(model.width) * static_cast<size_t>(model.height)),
        video(video_file, width, height, camera.frames_per_s > 0 ? camera.frames_per_s : 30, warnings) {}

  static CameraModel prepared(CameraModel m) {
    m.prepare();
    return m;
  }
  static int even(int n) { return (n + 1) / 2 * 2; }  // yuv420p halves both sides

  void draw(const Frame& frame, const TrackResult& result, const FrameLog& log) {
    const GreyView view = to_grey(frame, GreyImage{grey.data(), model.width, model.height, model.width});
    unsigned char* pixels = cairo_image_surface_get_data(picture.get());
    const int stride = cairo_image_surface_get_stride(picture.get());
    for (int y = 0; y < model.height; ++y) {
      auto* row = reinterpret_cast<uint32_t*>(pixels + static_cast<ptrdiff_t>(y) * stride);
      for (int x = 0; x < model.width; ++x) row[x] = 0xff000000u | view.at(x, y) * 0x010101u;
    }
    cairo_surface_mark_dirty(picture.get());

    Context context(cairo_create(canvas.get()));
    cairo_t* cr = context.get();
    cairo_save(cr);
    cairo_rectangle(cr, 0, 0, width, picture_height);
    cairo_clip(cr);
    cairo_save(cr);
    cairo_scale(cr, scale, scale);
    cairo_set_source_surface(cr, picture.get(), 0, 0);
    cairo_pattern_set_extend(cairo_get_source(cr), CAIRO_EXTEND_PAD);
    cairo_pattern_set_filter(cairo_get_source(cr), CAIRO_FILTER_BILINEAR);
    cairo_paint(cr);
    cairo_restore(cr);
    if (result.pose_valid) {
      if (!stage) stage = place(result.T_cw, initial_baseline);
      projector.set_pose(result.T_cw);
      draw_grid(cr, projector, *stage);
    } else if (log.state == TrackingState::kInitialising) {
      stage.reset();  // a new map will be another world
    }
    draw_points(cr, projector, result.points);
    if (result.pose_valid) draw_house(cr, projector, *stage);
    cairo_restore(cr);
    draw_panel(cr, log, picture_height, width, height - picture_height, unit);
    cairo_surface_flush(canvas.get());
  }

  void keep(Surface* still) const {
    if (!*still) *still = make_surface(width, height);
    const Context context(cairo_create(still->get()));
    cairo_set_source_surface(context.get(), canvas.get(), 0, 0);
    cairo_paint(context.get());
  }

  CameraModel model;
  int scale;
  Projector projector;
  float initial_baseline = Config().initial_baseline;
  double unit;  // of the panel's sizes
  int width, picture_height, height;
  Surface canvas, picture;
  std::vector<uint8_t> grey;
  std::optional<Stage3d> stage;
  VideoWriter video;

  Surface start_still, good_still;
  bool seen_tracking = false;
  uint64_t good_views = 0;
};

Overlay::Overlay(const CameraInfo& camera, const std::filesystem::path& video, std::vector<std::string>* warnings)
    : impl_(std::make_unique<Impl>(camera, video, warnings)) {}

Overlay::~Overlay() = default;

void Overlay::add(const Frame& frame, const TrackResult& result, const FrameLog& log) {
  impl_->draw(frame, result, log);
  impl_->video.add(cairo_image_surface_get_data(impl_->canvas.get()),
                   static_cast<size_t>(cairo_image_surface_get_stride(impl_->canvas.get())), frame.timestamp_ns);
  if (log.state == TrackingState::kInitialising && !impl_->seen_tracking) impl_->keep(&impl_->start_still);
  if (!result.pose_valid) return;
  impl_->seen_tracking = true;
  // The last power of two among the good views lies in their second half.
  if (result.quality == TrackingQuality::kGood && std::has_single_bit(++impl_->good_views)) {
    impl_->keep(&impl_->good_still);
  }
}

bool Overlay::finish() {
  return impl_->video.finish();
}

std::string Overlay::start_png() const {
  return png_of(impl_->start_still);
}

std::string Overlay::good_png() const {
  return png_of(impl_->good_still);
}

}  // namespace pptam::platform
