#include "platform/run/composer.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

#include "platform/run/names.h"
#include "platform/text.h"

namespace pptam::platform {
namespace {

constexpr Rgba kGreen = {51, 217, 102, 255};
constexpr Rgba kDarkGreen = {5, 64, 26, 230};
constexpr Rgba kRed = {242, 64, 64, 255};
constexpr Rgba kYellow = {255, 209, 51, 255};
constexpr Rgba kBlue = {77, 166, 255, 255};
constexpr Rgba kGrey = {184, 184, 184, 255};
constexpr Rgba kPanel = {26, 28, 33, 255};
constexpr Rgba kMapGround = {36, 40, 48, 255};
constexpr Rgba kText = {237, 240, 242, 255};

constexpr float kPanelUnits = 66;  // height

Rgba faint(Rgba colour, float alpha) {
  colour.a = static_cast<uint8_t>(std::lround(255 * alpha));
  return colour;
}

// Sizes follow the smaller of width and height, so that a wide screen keeps most of itself for the image.
float unit_of(float width, float height) {
  constexpr float kUnitsWide = 480, kUnitsHigh = 486, kSmallest = 0.5f;
  return std::max(kSmallest, std::min(width / kUnitsWide, height / kUnitsHigh));
}

int even(float length) {  // video encoders halve both sides
  return static_cast<int>(std::ceil(0.5f * length)) * 2;
}

Rgba colour_of(const FrameLog& log) {
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

Shape disc(const Vector2f& centre, float radius, const Rgba& colour) {
  Shape shape;
  shape.centre = centre;
  shape.radius = radius;
  shape.colour = colour;
  return shape;
}

Shape ring(const Vector2f& centre, float radius, float stroke, const Rgba& colour) {
  Shape shape = disc(centre, radius, colour);
  shape.stroke = stroke;
  return shape;
}

Shape stroke(const Vector2f& from, const Vector2f& to, float width, const Rgba& colour) {
  Shape shape = disc(0.5f * (from + to), 0.5f * width, colour);
  const float length = (to - from).norm();
  shape.half.x() = 0.5f * length;
  if (length > 0) shape.direction = (to - from) / length;
  return shape;
}

}  // namespace

Composer::Composer(const CameraInfo& camera) : camera_(camera), initial_baseline_(Config().initial_baseline) {
  camera_.model.prepare();
}

Canvas Composer::usual_canvas() const {
  const int scale = camera_.model.width > 960 ? 1 : 2;
  const auto width = static_cast<float>(camera_.model.width * scale);
  const auto height = static_cast<float>(camera_.model.height * scale);
  constexpr float kShare = 420.0f / 486;  // of a canvas' height that the panel leaves at its largest
  return {even(width), even(height + std::round(kPanelUnits * unit_of(width, height / kShare))), 0};
}

// shape: width over height of what the view shows; the view is as large as the canvas allows, in its middle.
void Composer::begin(const Canvas& canvas, float shape, const TrackResult& result, const FrameLog& log) {
  const auto width = static_cast<float>(canvas.width);
  const auto height = static_cast<float>(canvas.height);
  const float unit = unit_of(width, height);
  if (!lettering_ || unit != unit_) lettering_.emplace(unit);
  unit_ = unit;
  scene_.width = canvas.width;
  scene_.height = canvas.height;
  scene_.turn_degrees = canvas.turn_degrees;
  scene_.background = {};
  scene_.picture.reset();
  scene_.eye.reset();
  scene_.marks.clear();
  scene_.models.clear();
  scene_.shapes.clear();
  scene_.glyphs.clear();
  scene_.letters = &lettering_->image();
  const float room = std::max(1.0f, height - std::round(kPanelUnits * unit));
  const float view_width = std::floor(std::min(width, room * shape));
  const float view_height = std::floor(std::min(room, width / shape));
  scene_.view = {std::floor(0.5f * (width - view_width)), std::floor(0.5f * (room - view_height)), view_width,
                 view_height};
  add_panel(log, room, width);
  follow(result);
}

// A ground that was chosen has its origin where the house is wanted.
Site Composer::place_site(const TrackResult& result) const {
  Site site = place_house(result.T_cw, initial_baseline_);
  Vector2f px;
  if (result.world_changes > 0 && camera_.model.project(result.T_cw.t, &px) && camera_.model.in_image(px, 0))
    site.anchor_w.setZero();
  return site;
}

void Composer::follow(const TrackResult& result) {
  if (result.maps == 0 || result.world_changes != world_changes_) {  // another world
    sites_.clear();
    site_model_map_ = 0;
  }
  world_changes_ = result.world_changes;
  site_ = nullptr;
  if (result.map == 0) return;
  const auto known = sites_.find(result.map);
  if (known == sites_.end() && !result.pose_valid) return;
  if (known != sites_.end()) {
    site_ = &known->second;
  } else {
    site_ = &sites_.emplace(result.map, place_site(result)).first->second;
  }
  if (result.map == site_model_map_) return;
  site_model_ = make_site_model(*site_);
  site_model_map_ = result.map;
}

const Scene& Composer::camera_view(const Picture& picture, const TrackResult& result, const FrameLog& log,
                                   const Canvas& canvas, double ahead_s) {
  const auto width = static_cast<float>(camera_.model.width);  // of the tracked image
  begin(canvas, width / static_cast<float>(camera_.model.height), result, log);
  scene_.picture = picture;
  add_points(result.points, scene_.view.width / width);
  if (!result.pose_valid || site_ == nullptr) return scene_;
  Eye eye;
  eye.camera = pptam::Camera{camera_.model, camera_.shutter};
  eye.T_cw = pose_at(result.T_cw, result.velocity, static_cast<float>(ahead_s));
  eye.velocity = result.velocity;
  eye.near_z = 0.05f * site_->house_size;
  float nearest_z = std::numeric_limits<float>::max();
  for (const Vector3f& p_h : house_corners()) nearest_z = std::min(nearest_z, (eye.T_cw * site_->to_world(p_h)).z());
  eye.near_faces_z = std::max(eye.near_z, 0.5f * nearest_z);  // half of it: the shutter moves corners, too
  scene_.eye = eye;
  scene_.models.push_back(&site_model_);
  return scene_;
}

const Scene& Composer::map_view(const TrackResult& result, const FrameLog& log, std::span<const MapPointInfo> points,
                                std::span<const KeyframeInfo> keyframes, const Canvas& canvas) {
  begin(canvas, static_cast<float>(canvas.width) / std::max(1.0f, static_cast<float>(canvas.height)), result, log);
  scene_.view = {0, 0, static_cast<float>(canvas.width),
                 std::max(1.0f, static_cast<float>(canvas.height) - std::round(kPanelUnits * unit_))};
  scene_.background = kMapGround;
  scene_.eye = eye_above(points, keyframes, static_cast<int>(scene_.view.width), static_cast<int>(scene_.view.height));
  map_model_ = make_map_model(points, keyframes, pptam::Camera{camera_.model, camera_.shutter},
                              result.pose_valid ? &result.T_cw : nullptr);
  if (site_) scene_.models.push_back(&site_model_);
  scene_.models.push_back(&map_model_);
  return scene_;
}

void Composer::add_notice(const std::string& text) {
  const float x = scene_.view.x + 10 * unit_;
  const float y = scene_.view.y + 10 * unit_;
  const float width = lettering_->width(TextStyle::kNormal, text) + 18 * unit_;
  add_box(&scene_.shapes, {x, y, width, 26 * unit_}, 6 * unit_, faint(kPanel, 0.8f));
  add_text(TextStyle::kNormal, x + 9 * unit_, y + 18.5f * unit_, text, kText);
}

void Composer::add_box(std::vector<Shape>* shapes, const Area& area, float radius, const Rgba& colour) const {
  Shape shape;
  shape.half = {std::max(0.0f, 0.5f * area.width - radius), std::max(0.0f, 0.5f * area.height - radius)};
  shape.centre = {area.x + 0.5f * area.width, area.y + 0.5f * area.height};
  shape.radius = radius;
  shape.colour = colour;
  shapes->push_back(shape);
}

void Composer::add_text(TextStyle style, float x, float y, const std::string& text, const Rgba& colour) {
  lettering_->add(style, x, y, text, colour, &scene_.glyphs);
}

// scale: pixels of the canvas for one of the image.
void Composer::add_points(std::span<const ObservedPoint> points, float scale) {
  std::vector<Shape>& marks = scene_.marks;
  const float u = 0.5f * scale;  // sizes are those of an image shown twice as large
  for (const ObservedPoint& point : points) {
    const auto canvas = [&](const Vector2f& px) -> Vector2f {
      return Vector2f(scene_.view.x, scene_.view.y) + scale * (px + Vector2f(0.5f, 0.5f));
    };
    const Vector2f at = canvas(point.px);
    const float radius = u * (point.level >= 2 ? 4.5f : 3.0f);
    switch (point.kind) {
      case ObservedKind::kMissed:
      case ObservedKind::kHidden:
        marks.push_back(disc(at, 1.8f * u, faint(kGrey, 0.7f)));
        break;
      case ObservedKind::kInitial:
        marks.push_back(stroke(canvas(point.predicted_px), at, 1.6f * u, faint(kBlue, 0.9f)));
        marks.push_back(disc(at, 2.4f * u, faint(kBlue, 0.9f)));
        break;
      case ObservedKind::kOutlier:
        for (const float way : {-1.0f, 1.0f}) {
          const Vector2f arm(3.5f * u, way * 3.5f * u);
          marks.push_back(stroke(at - arm, at + arm, 2 * u, kRed));
        }
        break;
      case ObservedKind::kPartial:
        marks.push_back(ring(at, radius + u, 1.8f * u, kYellow));
        break;
      case ObservedKind::kInlier:
        marks.push_back(disc(at, radius, kGreen));
        marks.push_back(ring(at, radius, u, kDarkGreen));
        break;
    }
  }
}

// State, quality and hint; counts, residual and cost; progress of the initialisation above, below how much of the time
// between two frames tracking took.
void Composer::add_panel(const FrameLog& log, float top, float width) {
  const float unit = unit_;
  const Rgba colour = colour_of(log);
  std::vector<Shape>& shapes = scene_.shapes;
  add_box(&shapes, {0, top, width, static_cast<float>(scene_.height) - top}, 0, kPanel);
  const float progress = log.state == TrackingState::kInitialising ? std::clamp(log.progress, 0.0f, 1.0f) : 1;
  add_box(&shapes, {0, top, width * progress, 4 * unit}, 0, colour);

  const std::string state = name_of(log.state);
  const float chip = lettering_->width(TextStyle::kStrong, state) + 18 * unit;
  add_box(&shapes, {10 * unit, top + 12 * unit, chip, 24 * unit}, 6 * unit, colour);
  add_text(TextStyle::kStrong, 19 * unit, top + 29.5f * unit, state, kPanel);
  std::string words;
  if (log.state == TrackingState::kTracking) words = std::string("quality ") + name_of(log.quality);
  const std::string hint = sentence_for(log.hint);
  if (!hint.empty()) words += (words.empty() ? "" : ", ") + hint;
  if (log.blurred) words += words.empty() ? "blurred" : ", blurred";
  if (log.misfit) words += words.empty() ? "does not fit the map" : ", does not fit the map";
  add_text(TextStyle::kNormal, 22 * unit + chip, top + 29.5f * unit, words, kText);
  if (log.keyframe_added) {
    const std::string added = "+ keyframe";
    add_text(TextStyle::kNormal, width - 10 * unit - lettering_->width(TextStyle::kNormal, added), top + 29.5f * unit,
             added, kYellow);
  }

  const double track_ms = 1e-6 * static_cast<double>(log.track_ns);
  std::string text;
  if (log.state == TrackingState::kInitialising) {
    text = format("%.0f %% ready", static_cast<double>(100 * progress));
  } else {
    text = format("found %d of %d", log.points_found, log.points_attempted);
    if (log.pose_valid) text += format("   residual %.2f px", static_cast<double>(log.reprojection_px));
    text += format("   keyframes %d   points %d   %.0f ms", log.keyframes, log.map_points, track_ms);
  }
  add_text(TextStyle::kSmall, 12 * unit, top + 54 * unit, text, faint(kText, 0.75f));
  const double rate = camera_.frames_per_s > 0 ? camera_.frames_per_s : 30;
  const auto share = static_cast<float>(1e-3 * track_ms * rate);
  const float bar = 3 * unit;
  add_box(&shapes, {0, static_cast<float>(scene_.height) - bar, width * std::min(share, 1.0f), bar}, 0,
          share < 0.7f ? kGreen
          : share < 1  ? kYellow
                       : kRed);
}

}  // namespace pptam::platform
