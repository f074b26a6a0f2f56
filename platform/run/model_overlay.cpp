#include "platform/run/model_overlay.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <numbers>
#include <optional>

#include "platform/run/picture.h"
#include "platform/run/video_writer.h"
#include "platform/text.h"

namespace pptam::platform {
namespace {

constexpr Colour kContour = {0.25, 0.50, 1.00};
constexpr Colour kInlierRed = {0.95, 0.20, 0.20};
constexpr Colour kLocalWhite = {1.00, 1.00, 1.00};
constexpr Colour kRobustGreen = {0.20, 0.85, 0.40};
constexpr Colour kStone = {0.96, 0.80, 0.45};

// Where the pyramid stands, object frame.
struct Stand {
  std::array<Vector3f, 4> base;
  Vector3f apex;
};

// On the face that looks largest to the camera, of those with their middle well inside the image.
std::optional<Stand> choose_stand(const ObjectModel& model, const CameraModel& camera, const SE3& T_co) {
  const float border = 0.15f * static_cast<float>(std::min(camera.width, camera.height));
  float largest = 0;
  std::optional<Stand> stand;
  for (const ModelFace& face : model.faces) {
    if (face.count < 3) continue;
    const auto corner = [&](int i) { return model.points[static_cast<size_t>(model.corner(face, i))]; };
    Vector3f middle = Vector3f::Zero(), normal = Vector3f::Zero();
    for (int i = 0; i < face.count; ++i) {
      middle += corner(i) / static_cast<float>(face.count);
      normal += 0.5f * (corner(i) - corner(0)).cross(corner(i + 1) - corner(0));
    }
    const float area = normal.norm();
    const Vector3f p = T_co * middle;
    const float seen = -(T_co.R * normal).dot(p) / p.squaredNorm();
    Vector2f px;
    if (!(seen > largest) || !camera.project(p, &px) || !camera.in_image(px, border)) continue;
    largest = seen;
    const Vector3f n = normal / area;
    const Vector3f u = (corner(1) - corner(0)).normalized(), v = n.cross(u);
    const float half = 0.2f * std::sqrt(area);
    stand.emplace();
    for (int i = 0; i < 4; ++i)
      stand->base[i] = middle + half * ((i == 0 || i == 3 ? -1.0f : 1.0f) * u + (i < 2 ? -1.0f : 1.0f) * v);
    stand->apex = middle + 2.5f * half * n;
  }
  return stand;
}

}  // namespace

struct ModelOverlay::Impl {
  Impl(const CameraInfo& camera, const ObjectModel& known, const std::filesystem::path& video_file,
       std::vector<std::string>* warnings)
      : model(camera.model),
        object(known),
        scale(camera.model.width > 480 ? 1 : 2),
        width((model.width * scale + 1) / 2 * 2),
        height((model.height * scale + 1) / 2 * 2),
        canvas(make_surface(width, height)),
        picture(make_surface(model.width, model.height)),
        grey(static_cast<size_t>(model.width) * static_cast<size_t>(model.height)),
        video(video_file, width, height, camera.frames_per_s > 0 ? camera.frames_per_s : 30, warnings) {
    model.prepare();
  }

  double x(const Vector2f& px) const { return (static_cast<double>(px.x()) + 0.5) * scale; }
  double y(const Vector2f& px) const { return (static_cast<double>(px.y()) + 0.5) * scale; }

  void draw_image(cairo_t* cr, const Frame& frame) {
    const GreyView view = to_grey(frame, GreyImage{grey.data(), model.width, model.height, model.width});
    cairo_surface_flush(picture.get());
    unsigned char* pixels = cairo_image_surface_get_data(picture.get());
    const int stride = cairo_image_surface_get_stride(picture.get());
    for (int row = 0; row < model.height; ++row) {
      auto* out = reinterpret_cast<uint32_t*>(pixels + static_cast<ptrdiff_t>(row) * stride);
      for (int column = 0; column < model.width; ++column) out[column] = 0xff000000u | view.at(column, row) * 0x010101u;
    }
    cairo_surface_mark_dirty(picture.get());
    cairo_save(cr);
    cairo_scale(cr, scale, scale);
    cairo_set_source_surface(cr, picture.get(), 0, 0);
    cairo_pattern_set_extend(cairo_get_source(cr), CAIRO_EXTEND_PAD);
    cairo_paint(cr);
    cairo_restore(cr);
  }

  // Cairo's pixels are words of red, green and blue from the top down; the video's are bytes in this order.
  void read_canvas() {
    cairo_surface_flush(canvas.get());
    const unsigned char* rows = cairo_image_surface_get_data(canvas.get());
    const int stride = cairo_image_surface_get_stride(canvas.get());
    rgba.clear();
    for (int row = 0; row < height; ++row) {
      const auto* from = reinterpret_cast<const uint32_t*>(rows + static_cast<ptrdiff_t>(row) * stride);
      for (int column = 0; column < width; ++column)
        for (const int shift : {16, 8, 0, 24}) rgba.push_back(static_cast<uint8_t>(from[column] >> shift));
    }
  }

  // Sites of a contour follow each other along it; where some are hidden there is a gap of twice the usual step or
  // more. On a circle that is seen aslant steps differ by the perspective, hardly by more than a half.
  void draw_contours(cairo_t* cr, std::span<const ModelSite> sites) const {
    std::vector<float> steps;
    for (size_t i = 1; i < sites.size(); ++i)
      if (sites[i].contour == sites[i - 1].contour) steps.push_back((sites[i].model_px - sites[i - 1].model_px).norm());
    if (steps.empty()) return;
    const auto middle = steps.begin() + static_cast<std::ptrdiff_t>(steps.size() / 2);
    std::nth_element(steps.begin(), middle, steps.end());
    const float gap = 1.7f * *middle;
    for (size_t i = 1; i < sites.size(); ++i) {
      if (sites[i].contour != sites[i - 1].contour) continue;
      if ((sites[i].model_px - sites[i - 1].model_px).norm() > gap) continue;
      cairo_move_to(cr, x(sites[i - 1].model_px), y(sites[i - 1].model_px));
      cairo_line_to(cr, x(sites[i].model_px), y(sites[i].model_px));
    }
    set_colour(cr, kContour);
    cairo_set_line_width(cr, 1.2);
    cairo_stroke(cr);
  }

  void draw_sites(cairo_t* cr, std::span<const ModelSite> sites) const {
    for (const ModelSite& site : sites) {
      cairo_arc(cr, x(site.px), y(site.px), 1.4, 0, 2 * std::numbers::pi);
      set_colour(cr, site.kind == SiteKind::kInlier            ? kInlierRed
                     : site.kind == SiteKind::kRejectedLocally ? kLocalWhite
                                                               : kRobustGreen);
      cairo_fill(cr);
    }
  }

  void draw_pyramid(cairo_t* cr, const SE3& T_co) {
    if (!stand) stand = choose_stand(object, model, T_co);
    if (!stand) return;
    struct Side {
      std::array<Vector3f, 3> corners;
      double shade;
    };
    for (int i = 0; i < 4; ++i) {
      const Side side = {{stand->base[i], stand->base[(i + 1) % 4], stand->apex}, 0.6 + 0.1 * i};
      const Vector3f a = T_co * side.corners[0], b = T_co * side.corners[1], c = T_co * side.corners[2];
      if ((b - a).cross(c - a).dot(a) >= 0) continue;  // turned away
      bool before = true;
      Vector2f px[3];
      const Vector3f* corners[3] = {&a, &b, &c};
      for (size_t k = 0; k < 3; ++k) before = before && model.project(*corners[k], &px[k]);
      if (!before) continue;
      cairo_move_to(cr, x(px[0]), y(px[0]));
      cairo_line_to(cr, x(px[1]), y(px[1]));
      cairo_line_to(cr, x(px[2]), y(px[2]));
      cairo_close_path(cr);
      set_colour(cr, {kStone.r * side.shade, kStone.g * side.shade, kStone.b * side.shade}, 0.85);
      cairo_fill_preserve(cr);
      set_colour(cr, {0.2, 0.15, 0.05});
      cairo_set_line_width(cr, 1);
      cairo_stroke(cr);
    }
  }

  void draw_words(cairo_t* cr, const ModelResult& result) const {
    std::string words = result.state == ModelState::kLost ? "lost" : "waiting";
    if (result.pose_valid)
      words = format("quality %.2f   %d of %d sites", static_cast<double>(result.quality), result.sites_inliers,
                     result.sites_visible);
    set_colour(cr, {0, 0, 0}, 0.6);
    cairo_rectangle(cr, 0, 0, width, 20);
    cairo_fill(cr);
    cairo_select_font_face(cr, "sans", CAIRO_FONT_SLANT_NORMAL, CAIRO_FONT_WEIGHT_NORMAL);
    cairo_set_font_size(cr, 13);
    set_colour(cr, {1, 1, 1});
    cairo_move_to(cr, 8, 14);
    cairo_show_text(cr, words.c_str());
  }

  CameraModel model;
  const ObjectModel& object;
  int scale, width, height;
  Surface canvas, picture;
  std::vector<uint8_t> grey, rgba;
  std::optional<Stand> stand;
  VideoWriter video;
  Surface still;
  uint64_t tracked = 0;
};

ModelOverlay::ModelOverlay(const CameraInfo& camera, const ObjectModel& model, const std::filesystem::path& video,
                           std::vector<std::string>* warnings)
    : impl_(std::make_unique<Impl>(camera, model, video, warnings)) {}

ModelOverlay::~ModelOverlay() = default;

void ModelOverlay::add(const Frame& frame, const ModelResult& result) {
  Impl& o = *impl_;
  {
    const Context context(cairo_create(o.canvas.get()));
    cairo_t* cr = context.get();
    o.draw_image(cr, frame);
    if (result.pose_valid) {
      o.draw_pyramid(cr, result.T_co);
      o.draw_contours(cr, result.sites);
      o.draw_sites(cr, result.sites);
    }
    o.draw_words(cr, result);
  }
  o.read_canvas();
  o.video.add(o.rgba.data(), static_cast<size_t>(o.width) * 4, frame.timestamp_ns);
  // The last power of two among the tracked frames lies in their second half.
  if (!result.pose_valid || !std::has_single_bit(++o.tracked)) return;
  if (!o.still) o.still = make_surface(o.width, o.height);
  const Context context(cairo_create(o.still.get()));
  cairo_set_source_surface(context.get(), o.canvas.get(), 0, 0);
  cairo_paint(context.get());
}

bool ModelOverlay::finish() {
  return impl_->video.finish();
}

std::string ModelOverlay::good_png() const {
  return png_of(impl_->still);
}

}  // namespace pptam::platform
