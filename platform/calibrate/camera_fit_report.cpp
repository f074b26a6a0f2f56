#include "platform/calibrate/camera_fit_report.h"

#include "platform/calibrate/readout_plot.h"
#include "platform/input_error.h"
#include "platform/run/html.h"
#include "platform/run/names.h"
#include "platform/text.h"

namespace pptam::platform {
namespace {

std::string focal_plot(const CameraFit& fit) {
  std::string data;
  for (const CameraFit::Trial& trial : fit.focals) data += format("%.4f %.5f\n", trial.focal, trial.rms_px);
  return plot_svg(1120, 360,
                  "$focals << EOD\n" + data +
                      "EOD\nset xlabel 'focal length, relative to the one assumed'\nset ylabel 'points, px rms'\n"
                      "set yrange [0:*]\nunset key\n" +
                      format("set arrow from %g,graph 0 to %g,graph 1 nohead dt 2 lc rgb '#aa0000'\n", fit.focal.value,
                             fit.focal.value) +
                      "plot $focals using 1:2 with linespoints pt 7 ps 0.4 lw 1.4\n");
}

std::string row(const std::string& label, const std::string& value) {
  return "<tr><th>" + html_escaped(label) + "</th><td>" + html_escaped(value) + "</td></tr>\n";
}

}  // namespace

std::string camera_fit_page(const CameraFitPage& page, const CameraFit& fit, std::vector<std::string>* warnings) {
  std::string text = html_head("Pocket PTAM: the camera of " + page.name) + "<h1>The camera of " +
                     html_escaped(page.name) + "</h1>\n<section><table>\n";
  const auto add_estimate = [&](const char* label, const CameraFit::Estimate& estimate, const std::string& value) {
    text += row(label, estimate.trouble.empty() ? value : "this recording cannot tell: " + estimate.trouble);
  };
  if (!fit.readouts.empty()) {
    add_estimate("readout", fit.readout_s,
                 readout_text(fit.axis, fit.readout_s.value) + format(", +- %.2f ms%s", 1000 * fit.readout_s.sigma,
                                                                      fit.global ? ": as of a global shutter" : ""));
  }
  if (!fit.focals.empty()) {
    add_estimate(
        "focal length", fit.focal,
        format("%.3f times the one assumed, +- %.1f %%", fit.focal.value, 100 * fit.focal.sigma / fit.focal.value));
  }
  text += row("points", format("%d in %d frames, %.3f px rms", fit.points, fit.frames, fit.rms_px)) +
          "</table></section>\n";
  try {
    if (!fit.readouts.empty()) {
      std::vector<ReadoutTrial> trials;
      for (const CameraFit::Trial& trial : fit.readouts) trials.push_back({trial.axis, trial.readout_s, trial.rms_px});
      text += "<section><h2>Readout</h2>" +
              svg_tag(readout_plot(trials, fit.readout_s.value, "points"), "readout against residuals") +
              "<p>How well the points' tracks fit, by the readout that is assumed of the images as tracked, with all "
              "poses and points adjusted to it.</p></section>\n";
    }
    if (!fit.focals.empty()) {
      text += "<section><h2>Focal length</h2>" + svg_tag(focal_plot(fit), "focal length against residuals") +
              "</section>\n";
    }
  } catch (const InputError& error) {
    warnings->push_back(std::string(error.what()) + "; report.html is written without plots");
  }
  return text + "<section><h2>To repeat this</h2><code>" + html_escaped(page.command) + "</code><p>pocket-ptam " +
         html_escaped(page.version) + "</p></section>\n</main></body></html>\n";
}

}  // namespace pptam::platform
