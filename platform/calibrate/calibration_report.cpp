#include "platform/calibrate/calibration_report.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "platform/run/html.h"
#include "platform/run/names.h"
#include "platform/run/picture.h"
#include "platform/text.h"

namespace pptam::platform {
namespace {

constexpr double kLonger_px = 640;  // of the image's sides in the pictures
constexpr int kSide_px = 300;       // of the diagram beside it
constexpr int kHead_px = 34, kGap_px = 20;

constexpr Colour kPaper = {1, 1, 1};
constexpr Colour kInk = {0.13, 0.15, 0.19};
constexpr Colour kFaint = {0.80, 0.82, 0.85};
constexpr Colour kSeen = {0.25, 0.68, 0.42};
constexpr Colour kLacking = {0.93, 0.45, 0.42};
constexpr Colour kDot = {0.13, 0.30, 0.55};
constexpr Colour kArrow = {0.85, 0.33, 0.15};

// The image's frame on the left, a square for a diagram on the right, words above both.
struct Sheet {
  Sheet(int image_width, int image_height)
      : scale(kLonger_px / std::max(image_width, image_height)),
        width(static_cast<int>(std::lround(image_width * scale))),
        height(static_cast<int>(std::lround(image_height * scale))),
        surface(make_surface(width + kSide_px + 3 * kGap_px, std::max(height, kSide_px) + kHead_px + kGap_px)),
        context(cairo_create(surface.get())),
        cr(context.get()) {
    set_colour(cr, kPaper);
    cairo_paint(cr);
    cairo_select_font_face(cr, "sans-serif", CAIRO_FONT_SLANT_NORMAL, CAIRO_FONT_WEIGHT_NORMAL);
    cairo_set_font_size(cr, 14);
    cairo_set_line_width(cr, 1);
  }
  double x(double px) const { return kGap_px + (px + 0.5) * scale; }
  double y(double px) const { return kHead_px + (px + 0.5) * scale; }
  double diagram_x() const { return 2 * kGap_px + width + 0.5 * kSide_px; }  // its middle
  double diagram_y() const { return kHead_px + 0.5 * kSide_px; }
  void words(double at_x, double at_y, const std::string& text) const {
    set_colour(cr, kInk);
    cairo_move_to(cr, at_x, at_y);
    cairo_show_text(cr, text.c_str());
  }
  // About a middle.
  void centred(double at_x, double at_y, const std::string& text) const {
    cairo_text_extents_t extents;
    cairo_text_extents(cr, text.c_str(), &extents);
    words(at_x - 0.5 * extents.x_advance, at_y, text);
  }
  void dot(double at_x, double at_y, double radius) const {
    cairo_arc(cr, at_x, at_y, radius, 0, 2 * std::numbers::pi);
    cairo_fill(cr);
  }
  void circle(double radius) const {
    cairo_new_path(cr);
    cairo_arc(cr, diagram_x(), diagram_y(), radius, 0, 2 * std::numbers::pi);
    cairo_stroke(cr);
  }
  void image_frame() const {
    set_colour(cr, kInk);
    cairo_rectangle(cr, kGap_px, kHead_px, width, height);
    cairo_stroke(cr);
  }

  double scale;
  int width, height;
  Surface surface;
  Context context;
  cairo_t* cr;
};

// A dot for each view: towards the edge of the board that is nearer.
void draw_tilts(const Sheet& sheet, const std::vector<BoardView>& views) {
  cairo_t* cr = sheet.cr;
  constexpr double kRadius_px = 105, kRim = 0.6;  // tilt at the rim
  sheet.centred(sheet.diagram_x(), 22, "tilts: which edge was nearer");
  set_colour(cr, kFaint);
  sheet.circle(kRadius_px);
  sheet.circle(kRadius_px * Coverage::kMinTilt / kRim);
  sheet.centred(sheet.diagram_x(), sheet.diagram_y() - kRadius_px - 8, "upper");
  sheet.centred(sheet.diagram_x(), sheet.diagram_y() + kRadius_px + 20, "lower");
  sheet.words(sheet.diagram_x() + kRadius_px + 6, sheet.diagram_y() + 5, "right");
  sheet.centred(sheet.diagram_x() - kRadius_px - 18, sheet.diagram_y() + 5, "left");
  set_colour(cr, kDot, 0.75);
  for (const BoardView& view : views) {
    const Vector2d shown = view.tilt * (kRadius_px * std::min(1 / kRim, 1 / std::max(view.tilt.norm(), 1e-9)));
    sheet.dot(sheet.diagram_x() - shown.x(), sheet.diagram_y() - shown.y(), 4);
  }
}

// How large an error is drawn, and how large the largest ring.
double round_up(double value) {
  const double power = std::pow(10, std::floor(std::log10(std::max(value, 1e-3))));
  for (const double step : {1.0, 2.0, 5.0}) {
    if (step * power >= value) return step * power;
  }
  return 10 * power;
}

}  // namespace

std::string coverage_png(const Board& board, int width, int height, const std::vector<BoardView>& views) {
  const Sheet sheet(width, height);
  cairo_t* cr = sheet.cr;
  Coverage coverage(width, height);
  for (const BoardView& view : views) coverage.add(view);
  const double cell_w = static_cast<double>(sheet.width) / Coverage::kCells;
  const double cell_h = static_cast<double>(sheet.height) / Coverage::kCells;
  for (int row = 0; row < Coverage::kCells; ++row) {
    for (int column = 0; column < Coverage::kCells; ++column) {
      const int seen = coverage.views_at(column, row);
      if (seen > 0) {
        set_colour(cr, kSeen, std::min(0.2 + 0.08 * seen, 0.8));
      } else {
        set_colour(cr, kLacking, coverage.is_lacking(column / 3, row / 3) ? 0.8 : 0.15);
      }
      cairo_rectangle(cr, kGap_px + column * cell_w, kHead_px + row * cell_h, cell_w - 1, cell_h - 1);
      cairo_fill(cr);
    }
  }
  for (const BoardView& view : views) {
    set_colour(cr, kDot, 0.35);
    const size_t across = static_cast<size_t>(board.corners_across()), all = view.corners.size();
    for (const size_t corner : {size_t{0}, across - 1, all - 1, all - across})
      cairo_line_to(cr, sheet.x(view.corners[corner].x()), sheet.y(view.corners[corner].y()));
    cairo_close_path(cr);
    cairo_stroke(cr);
    for (const Vector2d& px : view.corners) sheet.dot(sheet.x(px.x()), sheet.y(px.y()), 1.3);
  }
  sheet.image_frame();
  sheet.words(
      kGap_px, 22,
      format("%zu views. Green: the board was seen; pale: not; red: hardly seen in all of that part", views.size()));
  draw_tilts(sheet, views);
  return png_of(sheet.surface);
}

std::string residuals_png(const LensFit& fit) {
  const Sheet sheet(fit.model.width, fit.model.height);
  cairo_t* cr = sheet.cr;
  const double ring_px = round_up(2.5 * fit.rms_px);
  const double enlarged = 30 / ring_px;  // of the ring's error, on the sheet
  const double radius = 0.4 * kSide_px;
  set_colour(cr, kFaint);
  sheet.circle(radius);
  sheet.circle(0.5 * radius);
  for (size_t v = 0; v < fit.views.size(); ++v) {
    for (size_t i = 0; i < fit.views[v].corners.size(); ++i) {
      const Vector2d& px = fit.views[v].corners[i];
      const Vector2d error = px - fit.solution.predicted[v][i];
      set_colour(cr, kArrow, 0.6);
      cairo_move_to(cr, sheet.x(px.x()), sheet.y(px.y()));
      cairo_rel_line_to(cr, enlarged * error.x(), enlarged * error.y());
      cairo_stroke(cr);
      const Vector2d shown = error * (radius / ring_px);
      if (shown.norm() > 0.5 * kSide_px) continue;
      set_colour(cr, kDot, 0.35);
      sheet.dot(sheet.diagram_x() + shown.x(), sheet.diagram_y() + shown.y(), 1.6);
    }
  }
  sheet.image_frame();
  sheet.words(kGap_px, 22, format("residuals, %.0f times as long as they are", enlarged / sheet.scale));
  sheet.centred(sheet.diagram_x(), 22, format("%.3f px rms; outer ring: %g px", fit.rms_px, ring_px));
  return png_of(sheet.surface);
}

std::string calibration_page(const CalibrationReport& report, std::vector<std::string>* warnings) {
  std::string page = html_head("Pocket PTAM: calibration of " + report.name) + "<h1>Calibration of " +
                     html_escaped(report.name) + "</h1>\n<section><table>\n";
  for (const SummaryRow& row : report.rows)
    page += "<tr><th>" + html_escaped(row.label) + "</th><td>" + html_escaped(row.value) + "</td></tr>\n";
  page += "</table></section>\n";
  if (!report.advice.empty()) {
    page += "<section><h2>What would make it better</h2><ul>\n";
    for (const std::string& line : report.advice) page += "<li>" + html_escaped(line) + "</li>\n";
    page += "</ul></section>\n";
  }
  const auto add_section = [&page](const char* title, const std::string& content, const char* note) {
    page += std::string("<section><h2>") + title + "</h2>" + content + "<p>" + note + "</p></section>\n";
  };
  if (!report.coverage_png.empty()) {
    add_section(
        "Coverage", image_tag("image/png", report.coverage_png, "where the board was seen"),
        "Each outline is a view of the board. Right: a dot for each view, towards the edge that was nearer; dots "
        "in the inner circle are views from straight ahead.");
  }
  if (!report.residuals_png.empty()) {
    add_section("Residuals", image_tag("image/png", report.residuals_png, "residuals of the corners"),
                "They should point in all directions everywhere. Strokes that point inwards or outwards together near "
                "the image's edge mean that the lens needs another --lens.");
  }
  if (report.readout != nullptr && !report.readout->trials.empty()) {
    try {
      add_section("Readout",
                  svg_tag(readout_plot(report.readout->trials, report.readout->readout_s, "corners"),
                          "readout against residuals"),
                  "How well the moving clip's corners fit, by the readout that is assumed.");
    } catch (const InputError& error) {
      warnings->push_back(std::string(error.what()) + "; report.html is written without plots");
    }
  }
  if (report.lens != nullptr) {
    std::string table =
        "<table class=\"wide\"><tr><th>frame</th><th>corners, px rms</th><th>edges' blur, px</th></tr>\n";
    for (size_t i = 0; i < report.lens->views.size(); ++i) {
      const BoardView& view = report.lens->views[i];
      table += format("<tr><td>%d</td><td>%.3f</td><td>%.1f</td></tr>\n", view.frame, report.lens->view_rms_px[i],
                      view.blur_px);
    }
    add_section("Views", table + "</table>", "Frames of the source, from 0.");
  }
  page += "<section><h2>To repeat this</h2><code>" + html_escaped(report.command) + "</code><p>pocket-ptam " +
          html_escaped(report.version) + "</p></section>\n</main></body></html>\n";
  return page;
}

}  // namespace pptam::platform
