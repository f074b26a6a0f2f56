#include "platform/calibrate/readout_plot.h"

#include "platform/run/html.h"
#include "platform/text.h"

namespace pptam::platform {

std::string readout_plot(const std::vector<ReadoutTrial>& trials, double best_s, const std::string& what) {
  std::string data[2];
  for (const ReadoutTrial& trial : trials)
    data[trial.axis == RollingShutter::Axis::kColumns ? 1 : 0] +=
        format("%.4f %.5f\n", 1000 * trial.readout_s, trial.rms_px);
  std::string script = "$rows << EOD\n" + data[0] + "EOD\n$columns << EOD\n" + data[1] +
                       "EOD\nset xlabel 'readout, ms (positive: from the top or the left)'\nset ylabel '" + what +
                       ", px rms'\nset yrange [0:*]\nset key outside right top\n";
  script += format("set arrow from %g,graph 0 to %g,graph 1 nohead dt 2 lc rgb '#aa0000'\nplot ", 1000 * best_s,
                   1000 * best_s);
  std::string curves;
  for (const char* name : {"rows", "columns"}) {
    if (data[std::string(name) == "columns" ? 1 : 0].empty()) continue;
    curves += (curves.empty() ? "" : ", ") + std::string("$") + name +
              " using 1:2 with linespoints pt 7 ps 0.4 lw 1.4 title '" + name + "'";
  }
  return plot_svg(1120, 360, script + curves + "\n");
}

}  // namespace pptam::platform
