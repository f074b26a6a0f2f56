#include "platform/run/ground_view.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "platform/run/picture.h"
#include "platform/text.h"

namespace pptam::platform {
namespace {

constexpr std::array<Colour, 4> kPlaneColours = {
    {{0.98, 0.76, 0.20}, {0.25, 0.65, 1.00}, {0.95, 0.35, 0.55}, {0.40, 0.85, 0.45}}};
constexpr double kGroundZoom = 2;  // of the image
// System::set_ground() asks for half of so many points round the pixel.
constexpr size_t kNeighboursOfChoice = 12;

// z = 0, to within the spread of its points and 5 degrees.
bool lies_at_zero(const PlaneInfo& plane) {
  return std::abs(plane.normal_w.z()) > 0.996f && std::abs(plane.middle_w.z()) < 2 * plane.threshold;
}

}  // namespace

void GroundView::add(const Frame& frame, const TrackResult& result) {
  if (!result.pose_valid || views_.count(result.map) > 0) return;
  View& view = views_[result.map];
  view.timestamp_ns = frame.timestamp_ns;
  view.width = frame.width;
  view.height = frame.height;
  view.grey.resize(static_cast<size_t>(frame.width) * static_cast<size_t>(frame.height));
  const GreyImage storage = {view.grey.data(), frame.width, frame.height, frame.width};
  const GreyView grey = to_grey(frame, storage);
  if (grey.data == storage.data) return;
  for (int y = 0; y < frame.height; ++y) std::copy_n(grey.row(y), frame.width, storage.row(y));
}

const GroundView::View* GroundView::view_of(const RunLog& log) const {
  const auto found = views_.find(log.main_map());
  return found == views_.end() ? nullptr : &found->second;
}

std::vector<GroundView::Seen> GroundView::seen_points(const RunLog& log, const View& view) {
  std::vector<Seen> seen;
  const auto frame = std::find_if(log.frames.begin(), log.frames.end(),
                                  [&](const FrameLog& f) { return f.timestamp_ns == view.timestamp_ns; });
  if (frame == log.frames.end() || !frame->pose_valid) return seen;
  CameraModel model = log.camera.model;
  model.prepare();
  const Eigen::Isometry3d T_cw = frame->T_wc.inverse();
  seen.reserve(log.map_points.size());
  for (const MapPointInfo& point : log.map_points) {
    Vector2f px;
    const Eigen::Vector3d p_c = T_cw * point.p_w.cast<double>();
    if (!model.project(p_c.cast<float>(), &px) || !model.in_image(px, 0)) continue;
    int plane = -1;
    for (size_t i = 0; i < log.planes.size() && plane < 0; ++i) {
      const PlaneInfo& info = log.planes[i];
      if (std::abs(info.normal_w.dot(point.p_w - info.middle_w)) < info.threshold) plane = static_cast<int>(i);
    }
    seen.push_back({px, plane});
  }
  return seen;
}

// Of each plane the point most of whose neighbours lie on it.
std::vector<GroundView::Choice> GroundView::choices(const RunLog& log) const {
  std::vector<Choice> choices;
  const View* view = view_of(log);
  if (!view) return choices;
  const std::vector<Seen> seen = seen_points(log, *view);
  for (size_t plane = 0; plane < log.planes.size(); ++plane) {
    size_t most = kNeighboursOfChoice / 2;
    float nearest = 0;
    Choice choice{plane, Vector2f::Zero(), lies_at_zero(log.planes[plane])};
    for (const Seen& middle : seen) {
      if (middle.plane != static_cast<int>(plane)) continue;
      std::vector<std::pair<float, bool>> others;
      others.reserve(seen.size());
      for (const Seen& other : seen)
        others.emplace_back((other.px - middle.px).squaredNorm(), other.plane == middle.plane);
      const size_t count = std::min(kNeighboursOfChoice, others.size());
      std::partial_sort(others.begin(), others.begin() + static_cast<ptrdiff_t>(count), others.end());
      size_t same = 0;
      for (size_t i = 0; i < count; ++i) same += others[i].second ? 1 : 0;
      const float reach = others[count - 1].first;
      if (same < most || (same == most && nearest > 0 && reach >= nearest)) continue;
      most = same;
      nearest = reach;
      choice.px = middle.px;
    }
    if (nearest > 0) choices.push_back(choice);
  }
  return choices;
}

std::string GroundView::picture(const RunLog& log) const {
  const std::vector<Choice> all = choices(log);
  if (all.empty()) return "";
  const View& view = *view_of(log);
  std::vector<uint8_t> rgba(view.grey.size() * 4, 255);
  for (size_t i = 0; i < view.grey.size(); ++i)
    std::fill_n(rgba.begin() + static_cast<ptrdiff_t>(4 * i), 3, view.grey[i]);
  const Surface image = surface_of_rgba(rgba, view.width, view.height);
  const Surface surface =
      make_surface(static_cast<int>(kGroundZoom * view.width), static_cast<int>(kGroundZoom * view.height));
  const Context context(cairo_create(surface.get()));
  cairo_t* cr = context.get();
  cairo_scale(cr, kGroundZoom, kGroundZoom);
  cairo_set_source_surface(cr, image.get(), 0, 0);
  cairo_paint(cr);
  for (const Seen& point : seen_points(log, view)) {
    const Colour colour = point.plane < 0 ? Colour{0.6, 0.6, 0.6} : kPlaneColours[static_cast<size_t>(point.plane)];
    cairo_arc(cr, static_cast<double>(point.px.x()) + 0.5, static_cast<double>(point.px.y()) + 0.5, 2, 0, 6.2832);
    set_colour(cr, colour);
    cairo_fill(cr);
  }
  cairo_select_font_face(cr, "sans-serif", CAIRO_FONT_SLANT_NORMAL, CAIRO_FONT_WEIGHT_BOLD);
  cairo_set_font_size(cr, 11);
  for (const Choice& choice : all) {
    const double x = static_cast<double>(choice.px.x()) + 0.5, y = static_cast<double>(choice.px.y()) + 0.5;
    cairo_new_path(cr);  // the text before has left a point
    cairo_arc(cr, x, y, 8, 0, 6.2832);
    set_colour(cr, {0.1, 0.1, 0.1}, 0.85);
    cairo_fill_preserve(cr);
    set_colour(cr, kPlaneColours[choice.plane]);
    cairo_set_line_width(cr, choice.is_ground ? 3 : 1.2);
    cairo_stroke(cr);
    cairo_move_to(cr, x - 3.2, y + 4);
    cairo_show_text(cr, std::to_string(choice.plane + 1).c_str());
  }
  return png_of(surface);
}

std::string GroundView::note(const RunLog& log) const {
  std::string text;
  for (const Choice& choice : choices(log)) {
    const PlaneInfo& plane = log.planes[choice.plane];
    text += format("%zu: %d of %zu points, --ground %.0f,%.0f%s. ", choice.plane + 1, plane.points,
                   log.map_points.size(), static_cast<double>(choice.px.x()), static_cast<double>(choice.px.y()),
                   choice.is_ground ? " (the ground now)" : "");
  }
  return text + "The image is the first one with a pose; grey points lie on none of these planes.";
}

}  // namespace pptam::platform
