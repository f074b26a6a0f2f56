#include "platform/run/report.h"

#include <algorithm>
#include <cmath>
#include <functional>

#include <pocket_ptam/clock.h>
#include "platform/input_error.h"
#include "platform/run/html.h"
#include "platform/run/names.h"
#include "platform/text.h"

namespace pptam::platform {
namespace {

using Eigen::Vector3d;

// The range of most values with some margin: a few stray points do not shrink the picture.
struct Range {
  double low = 0, high = 1;
};
Range range_of(std::vector<double> values, double trim) {
  if (values.empty()) return {};
  std::sort(values.begin(), values.end());
  const auto at = [&](double share) {
    return values[static_cast<size_t>(share * static_cast<double>(values.size() - 1))];
  };
  return {at(trim), at(1 - trim)};
}

using Axis2 = std::pair<int, int>;  // which world coordinates go right and up
constexpr Axis2 kFromAbove = {0, 1};
constexpr Axis2 kFromTheSide = {0, 2};

void append_row(std::string* data, const Vector3d& p, int value) {
  *data += format("%.6g %.6g %.6g %d\n", p.x(), p.y(), p.z(), value);
}

std::string plot_map(const RunLog& log) {
  const Trajectory keyframes = log.keyframe_trajectory();
  std::vector<double> axis_values[3];
  std::string points;
  for (const MapPointInfo& point : log.map_points) {
    append_row(&points, point.p_w.cast<double>(), point.measurements);
    for (int i = 0; i < 3; ++i) axis_values[i].push_back(static_cast<double>(point.p_w[i]));
  }
  Range ranges[3];
  for (int i = 0; i < 3; ++i) ranges[i] = range_of(axis_values[i], 0.01);
  std::string path;
  bool gap = true;
  const auto include = [&](const Vector3d& p) {
    for (int i = 0; i < 3; ++i) ranges[i] = {std::min(ranges[i].low, p[i]), std::max(ranges[i].high, p[i])};
  };
  const int main_map = log.main_map();
  for (const FrameLog& frame : log.frames) {
    if (!frame.pose_valid || frame.map != main_map) {
      if (!gap) path += "\n";
      gap = true;
      continue;
    }
    append_row(&path, frame.T_wc.translation(), 0);
    gap = false;
  }
  double size = 0;
  for (const StampedPose& keyframe : keyframes) include(keyframe.T_wc.translation());
  for (int i = 0; i < 3; ++i) size = std::max(size, ranges[i].high - ranges[i].low);
  std::string cameras;  // x y z, and the optical axis as a stroke
  for (const StampedPose& keyframe : keyframes) {
    const Vector3d p = keyframe.T_wc.translation();
    const Vector3d d = keyframe.T_wc.linear().col(2) * (0.07 * size);
    cameras += format("%.6g %.6g %.6g %.6g %.6g %.6g\n", p.x(), p.y(), p.z(), d.x(), d.y(), d.z());
  }
  std::string script = "$points << EOD\n" + points + "EOD\n$path << EOD\n" + path + "EOD\n$cameras << EOD\n" + cameras +
                       "EOD\n" +
                       "set multiplot layout 1,2\nset size ratio -1\nset cblabel 'measurements'\n"
                       "set palette defined (0 '#c9d3e0', 1 '#4f81bd', 2 '#17375e')\nset cbrange [2:*]\n";
  for (const Axis2& axes : {kFromAbove, kFromTheSide}) {
    const auto [h, v] = axes;
    const double margin = 0.06 * size;
    script += format("set title '%s'\nset xlabel 'x'\nset ylabel '%c'\nset xrange [%g:%g]\nset yrange [%g:%g]\n",
                     v == 1 ? "from above" : "from the side", "xyz"[v], ranges[h].low - margin, ranges[h].high + margin,
                     ranges[v].low - margin, ranges[v].high + margin);
    script += v == 1 ? "unset colorbox\n" : "set colorbox\n";
    script += format(
        "plot $points using %d:%d:4 with points pt 7 ps 0.35 lc palette title 'map points', "
        "$path using %d:%d with lines lw 1.2 lc rgb '#9aa0a6' title 'path', "
        "$cameras using %d:%d:%d:%d with vectors nohead lw 1.6 lc rgb '#e06c2c' notitle, "
        "$cameras using %d:%d with points pt 7 ps 0.55 lc rgb '#e06c2c' title 'keyframes'\nset key off\n",
        h + 1, v + 1, h + 1, v + 1, h + 1, v + 1, h + 4, v + 4, h + 1, v + 1);
  }
  return plot_svg(1120, 520, script + "unset multiplot\n");
}

// The time between two frames, ms; 0 where it is not known.
double period_of(const RunLog& log) {
  return log.camera.frames_per_s > 0 ? 1000 / log.camera.frames_per_s : 0;
}

// A row of a stacked plot: the time, and the sums of the values so far.
void append_stacked(std::string* data, double time_s, const std::vector<double>& values_ms) {
  *data += format("%.4f", time_s);
  double sum_ms = 0;
  for (const double ms : values_ms) *data += format(" %.4f", sum_ms += ms);
  *data += '\n';
}

struct Layer {
  std::string name;
  const char* colour;
};

// "plot" with the layers as areas: cumulative sums, the highest first, each hides the rest below.
std::string plot_stacked(const char* data, const std::vector<Layer>& layers) {
  std::string script = "plot ";
  for (size_t i = layers.size(); i-- > 0;)
    script += format("%s using 1:%zu with filledcurves x1 lc rgb '%s' title '%s'%s", data, i + 2, layers[i].colour,
                     layers[i].name.c_str(), i > 0 ? ", " : "");
  return script;
}

constexpr const char* kStageColours[kStages] = {"#8da0cb", "#66c2a5", "#4f81bd", "#e78ac3",
                                                "#ffd92f", "#fc8d62", "#b3b3b3"};
constexpr const char* kCaptureColour = "#e5e5e5";
constexpr const char* kDisplayColour = "#d0d7e5";
constexpr const char* kIdleColour = "#eeeeee";
constexpr const char* kJobColours[kJobs] = {"#fc8d62", "#66c2a5", "#9ecae1", "#4f81bd", "#e78ac3", "#ffd92f"};

// "finish map"
std::string words_of(Span job) {
  std::string name = name_of(job);
  std::replace(name.begin(), name.end(), '_', ' ');
  return name;
}

std::string plot_times(const RunLog& log) {
  std::vector<Layer> layers = {{"capture", kCaptureColour}};
  layers.reserve(kStages + 2);
  for (int s = 0; s < kStages; ++s) layers.push_back({name_of(static_cast<Stage>(s)), kStageColours[s]});
  layers.push_back({"display", kDisplayColour});
  std::string data;
  std::string late;
  std::string dropped;
  double highest_ms = 0;
  int next_index = 0;
  for (const FrameLog& frame : log.frames) {
    const double t_s = log.seconds(frame.timestamp_ns);
    std::vector<double> values = {1e-6 * static_cast<double>(frame.capture_ns)};
    values.reserve(kStages + 2);
    for (const int64_t ns : frame.stage_ns) values.push_back(1e-6 * static_cast<double>(ns));
    values.push_back(1e-6 * static_cast<double>(frame.display_ns));
    append_stacked(&data, t_s, values);
    const double whole_ms = 1e-6 * static_cast<double>(frame.capture_ns + frame.track_ns + frame.display_ns);
    highest_ms = std::max(highest_ms, whole_ms);
    if (is_late(frame, log.camera)) late += format("%.4f %.4f\n", t_s, whole_ms);
    if (frame.index > next_index) dropped += format("%.4f 0\n", t_s);
    next_index = frame.index + 1;
  }
  const double period_ms = period_of(log);
  const bool near_deadline = period_ms > 0 && highest_ms > 0.25 * period_ms;
  const double top = 1.15 * (near_deadline ? std::max(highest_ms, period_ms) : highest_ms);
  std::string script = "$frames << EOD\n" + data + "EOD\n$late << EOD\n" + late + "EOD\n$dropped << EOD\n" + dropped +
                       "EOD\nset xlabel 'time, s'\nset ylabel 'a frame, ms'\nset key outside right top\n" +
                       format("set yrange [0:%g]\nset xrange [0:*]\n", top > 0 ? top : 1.0);
  if (near_deadline) {
    script += format("set arrow from graph 0,first %g to graph 1,first %g nohead dt 2 lc rgb '#aa0000' front\n",
                     period_ms, period_ms);
  }
  script += plot_stacked("$frames", layers);
  if (near_deadline) script += ", keyentry with lines dt 2 lc rgb '#aa0000' title 'next frame'";
  if (!late.empty()) script += ", $late using 1:2 with points pt 7 ps 0.4 lc rgb '#e5484d' title 'late'";
  if (!dropped.empty()) script += ", $dropped using 1:2 with points pt 9 ps 0.7 lc rgb '#000000' title 'after dropped'";
  return plot_svg(1120, 380, script + "\n");
}

std::string plot_idle_time(const RunLog& log) {
  std::vector<Layer> layers;
  layers.reserve(kJobs + 1);
  for (int job = 0; job < kJobs; ++job) layers.push_back({words_of(span_of_job(job)), kJobColours[job]});
  layers.push_back({"idle", kIdleColour});
  std::string data;
  std::string slices;
  for (const FrameLog& frame : log.frames) {
    const double t_s = log.seconds(frame.timestamp_ns);
    std::vector<double> values;
    values.reserve(kJobs + 1);
    for (const int64_t ns : frame.job_ns) values.push_back(1e-6 * static_cast<double>(ns));
    values.push_back(1e-6 * static_cast<double>(frame.idle_ns));
    append_stacked(&data, t_s, values);
    if (frame.idle_slices > 0) slices += format("%.4f %.4f\n", t_s, 1e-6 * static_cast<double>(frame.longest_slice_ns));
  }
  const double end_s = log.seconds(log.frames.back().timestamp_ns);  // both halves are as wide
  std::string script = "$idle << EOD\n" + data + "EOD\n$slices << EOD\n" + slices +
                       "EOD\nset multiplot layout 2,1\nset lmargin 9\nset rmargin 20\nset key outside right top\n"
                       "set yrange [0:*]\nset ylabel 'before a frame, ms'\n" +
                       format("set xrange [0:%g]\n", std::max(end_s, 0.1)) + plot_stacked("$idle", layers) +
                       "\nset xlabel 'time, s'\nset ylabel 'longest slice, ms'\n";
  script += slices.empty() ? "plot [0:1] [0:1] NaN notitle\n"
                           : "plot $slices using 1:2 with points pt 7 ps 0.3 lc rgb '#4f81bd' title 'slice'\n";
  return plot_svg(1120, 560, script + "unset multiplot\n");
}

// ------------------------------------------------------------------------------------------------------------ a trace

constexpr double kBeforeWorst_ms = 100, kAfterWorst_ms = 300;  // shown of a trace, around its worst frame
// Lower and upper edges of a trace's rows, of the plot's height.
constexpr double kFrameRow[2] = {2.45, 2.95}, kStageRow[2] = {1.9, 2.4}, kMappingRow[2] = {1, 1.8},
                 kIdleRow[2] = {0, 0.8};

// Which row, and which colour; null: not drawn.
const char* colour_of(TraceWhat what, const double** row) {
  *row = kFrameRow;
  if (what == TraceWhat::kCapture) return kCaptureColour;
  if (what == TraceWhat::kDisplay) return kDisplayColour;
  if (what == trace_of(Span::kFrame)) return "#9aa0a6";
  *row = kIdleRow;
  if (what == TraceWhat::kIdle) return kIdleColour;
  const int span = static_cast<int>(what);
  if (span >= static_cast<int>(Span::kPyramid) && span <= static_cast<int>(Span::kKeyframe)) {
    *row = kStageRow;
    return kStageColours[span - static_cast<int>(Span::kPyramid)];
  }
  if (span < static_cast<int>(Span::kFinishMap) || span > static_cast<int>(Span::kTidy)) return nullptr;
  *row = kMappingRow;
  return kJobColours[job_of(static_cast<Span>(span))];
}

// The trace around the frame that took longest: when frames, mapping and idle time followed each other.
std::string plot_trace(const RunLog& log) {
  const TraceEvent* worst = nullptr;
  const auto length_ns = [](const TraceEvent& e) { return saturated_difference(e.end_ns, e.begin_ns); };
  for (const TraceEvent& event : log.trace) {
    if (event.what == trace_of(Span::kFrame) && (worst == nullptr || length_ns(event) > length_ns(*worst)))
      worst = &event;
  }
  if (worst == nullptr) return {};
  const auto ms = [&](int64_t ns) { return 1e-6 * static_cast<double>(saturated_difference(ns, worst->begin_ns)); };
  const auto shown = [](double t_ms) { return std::clamp(t_ms, -kBeforeWorst_ms, kAfterWorst_ms); };
  std::string script =
      "set xlabel 'ms from the beginning of the frame that took longest'\nset key outside right top\n" +
      format("set xrange [%g:%g]\nset yrange [-0.1:3.3]\n", -kBeforeWorst_ms, kAfterWorst_ms) +
      "set ytics ('frames' 2.7, 'stages' 2.15, 'mapping' 1.4, 'idle' 0.4)\n";
  for (const TraceEvent& event : log.trace) {
    const double begin = shown(ms(event.begin_ns)), end = shown(ms(event.end_ns));
    const double* row = nullptr;
    const char* const colour = colour_of(event.what, &row);
    if (event.what == TraceWhat::kDropped && begin > -kBeforeWorst_ms && begin < kAfterWorst_ms)
      script += format("set label 'x' at %.4f,3.05 center tc rgb '#e5484d'\n", begin);
    if (colour == nullptr || !(end > begin)) continue;
    script += format("set object rect from %.4f,%g to %.4f,%g fc rgb '%s' fs solid border rgb '#ffffff' lw 0.3\n",
                     begin, row[0], end, row[1], colour);
    if (event.what == trace_of(Span::kFrame))
      script += format("set label '%lld' at %.4f,3.05 center\n", static_cast<long long>(event.value), begin);
  }
  std::string keys = format("keyentry with boxes fs solid lc rgb '%s' title 'capture', ", kCaptureColour);
  for (int s = 0; s < kStages; ++s)
    keys += format("keyentry with boxes fs solid lc rgb '%s' title '%s', ", kStageColours[s],
                   name_of(static_cast<Stage>(s)));
  keys += format("keyentry with boxes fs solid lc rgb '%s' title 'display'", kDisplayColour);
  for (int job = 0; job < kJobs; ++job)
    keys += format(", keyentry with boxes fs solid lc rgb '%s' title '%s'", kJobColours[job],
                   words_of(span_of_job(job)).c_str());
  return plot_svg(1120, 380, script + "plot NaN notitle, " + keys + "\n");
}

std::string plot_tracking(const RunLog& log) {
  std::string data;
  std::string keyframes;
  std::string strips;
  for (size_t i = 0; i < log.frames.size(); ++i) {
    const FrameLog& frame = log.frames[i];
    const double t = log.seconds(frame.timestamp_ns);
    const auto share = [&](int n) {
      return frame.points_attempted > 0 ? format("%.4f", static_cast<double>(n) / frame.points_attempted)
                                        : std::string("NaN");
    };
    data += format("%.4f ", t) + share(frame.points_found) + " " + share(frame.points_inliers) + "\n";
    if (frame.keyframe_added) keyframes += format("%.4f 0\n", t);
  }
  const auto colour = [](const FrameLog& frame) {
    switch (frame.state) {
      case TrackingState::kWaiting:
        return "#bbbbbb";
      case TrackingState::kInitialising:
        return "#4da3ff";
      case TrackingState::kLost:
        return "#e5484d";
      case TrackingState::kTracking:
        break;
    }
    return frame.quality == TrackingQuality::kGood   ? "#3fb76b"
           : frame.quality == TrackingQuality::kPoor ? "#f5c542"
                                                     : "#f08a3c";
  };
  for (size_t from = 0; from < log.frames.size();) {  // one rectangle for a stretch of frames of one colour
    size_t to = from;
    while (to < log.frames.size() && colour(log.frames[to]) == colour(log.frames[from])) ++to;
    const double end = log.seconds(log.frames[std::min(to, log.frames.size() - 1)].timestamp_ns);
    strips += format("set object rect from %.4f,-0.10 to %.4f,-0.02 fc rgb '%s' fs solid noborder\n",
                     log.seconds(log.frames[from].timestamp_ns), end, colour(log.frames[from]));
    from = to;
  }
  const std::string keys =
      "keyentry with boxes lc rgb '#4da3ff' title 'initialising', keyentry with boxes lc rgb '#3fb76b' title 'good', "
      "keyentry with boxes lc rgb '#f5c542' title 'poor', keyentry with boxes lc rgb '#f08a3c' title 'bad', "
      "keyentry with boxes lc rgb '#e5484d' title 'lost'";
  return plot_svg(1120, 380,
                  "$frames << EOD\n" + data + "EOD\n$keyframes << EOD\n" + keyframes +
                      "EOD\nset xlabel 'time, s'\nset ylabel 'share of the points searched'\nset yrange [-0.13:1.05]\n"
                      "set xrange [0:*]\nset ytics 0,0.2,1\nset key outside right top\n" +
                      strips + "plot $frames using 1:2 with lines lw 1.4 lc rgb '#4f81bd' title 'found', " +
                      "$frames using 1:3 with lines lw 1.4 lc rgb '#17375e' title 'inliers', " +
                      (keyframes.empty() ? ""
                                         : "$keyframes using 1:(0.02) with points pt 9 ps 0.7 lc rgb '#e06c2c' "
                                           "title 'keyframe', ") +
                      keys + "\n");
}

}  // namespace

std::string plot_trajectories(const Evaluation& e, const Trajectory& truth) {
  std::string truth_rows;
  for (const StampedPose& pose : truth) append_row(&truth_rows, pose.T_wc.translation(), 0);
  std::string right;
  std::string wrong;
  for (size_t i = 0; i < e.poses.size(); ++i) {
    const AssociatedPose& pose = e.poses[i];
    const Vector3d p = e.robust_alignment * pose.T_wc.translation();
    // Where tracking was lost the line breaks; a sparse truth has few poses.
    const int64_t gap_ns = e.at_truth_times ? 5'000'000'000 : 500'000'000;
    if (i > 0 && saturated_difference(pose.timestamp_ns, e.poses[i - 1].timestamp_ns) > gap_ns) right += "\n";
    append_row(&right, p, 0);
    if (pose.wrong) append_row(&wrong, p, 0);
  }
  // The picture shows the truth with a margin; wrong poses far away fall outside.
  Range ranges[3];
  double size = 0;
  for (int i = 0; i < 3; ++i) {
    std::vector<double> values;
    for (const StampedPose& pose : truth) values.push_back(pose.T_wc.translation()[i]);
    ranges[i] = range_of(values, 0);
    size = std::max(size, ranges[i].high - ranges[i].low);
  }
  std::string script = "$truth << EOD\n" + truth_rows + "EOD\n$right << EOD\n" + right + "EOD\n$wrong << EOD\n" +
                       wrong + "EOD\nset multiplot layout 1,2\nset size ratio -1\n";
  for (const Axis2& axes : {kFromAbove, kFromTheSide}) {
    const auto [h, v] = axes;
    const double margin = 0.12 * size;
    script += format("set title '%s'\nset xlabel 'x'\nset ylabel '%c'\nset xrange [%g:%g]\nset yrange [%g:%g]\n",
                     v == 1 ? "from above" : "from the side", "xyz"[v], ranges[h].low - margin, ranges[h].high + margin,
                     ranges[v].low - margin, ranges[v].high + margin);
    script += format(
        "plot $truth using %d:%d with lines lw 4 lc rgb '#c3c8cf' title 'truth', "
        "$right using %d:%d with lines lw 1.5 lc rgb '#2f6fb5' title 'estimate'",
        h + 1, v + 1, h + 1, v + 1);
    if (!wrong.empty()) {
      script += format(", $wrong using %d:%d with points pt 7 ps 0.35 lc rgb '#e5484d' title 'wrong'", h + 1, v + 1);
    }
    script += "\nset key off\n";
  }
  return plot_svg(1120, 500, script + "unset multiplot\n");
}

std::string report_page(const RunLog& log, const RunSummary& summary, const Trajectory& truth, const Pictures& pictures,
                        std::vector<std::string>* warnings) {
  std::string page = html_head("Pocket PTAM: " + log.camera.name) + "<h1>" + html_escaped(log.camera.name) + "</h1>\n";
  page += "<section class=\"side\"><div><table>\n";
  for (const SummaryRow& row : summarise(log, summary)) {
    page += "<tr><th>" + html_escaped(row.label) + "</th><td>" + html_escaped(row.value) + "</td></tr>\n";
  }
  page += "</table></div>\n";
  if (!pictures.good_png.empty())
    page += image_tag("image/png", pictures.good_png, "the camera's view with the map's points and a house");
  page += "</section>\n";
  if (pictures.video) {
    page += "<section><h2>Video</h2><a href=\"overlay.mp4\">overlay.mp4</a> (beside this file)</section>\n";
  }

  const auto add_plot = [&](const char* title, const char* note, const std::function<std::string()>& plot) {
    page += std::string("<section><h2>") + title + "</h2>" + svg_tag(plot(), title) + "<p>" + note + "</p></section>\n";
  };
  try {
    if (summary.evaluation) {
      add_plot("Trajectory", "After alignment by a similarity that ignores wrong poses, in units of the truth.",
               [&] { return plot_trajectories(*summary.evaluation, truth); });
    }
    if (!log.map_points.empty()) {
      add_plot("Map", "World units: 0.1 is the distance between the first two keyframes; z = 0 is the ground.",
               [&] { return plot_map(log); });
    }
    if (!log.frames.empty()) {
      std::string times = "Capture, stages of tracking and display, stacked.";
      if (period_of(log) > 0) times += format(" The next frame comes after %.1f ms.", period_of(log));
      add_plot("Time per frame", times.c_str(), [&] { return plot_times(log); });
      add_plot("Between frames", "What mapping did with the time, and idle time, stacked.",
               [&] { return plot_idle_time(log); });
      if (!log.trace.empty()) {
        add_plot("Trace", "Where the processor's time went around its longest frame; frames by their number.",
                 [&] { return plot_trace(log); });
      }
      add_plot("Tracking", "The strip at the bottom shows the state and the quality.",
               [&] { return plot_tracking(log); });
    }
  } catch (const InputError& error) {
    warnings->push_back(std::string(error.what()) + "; report.html is written without plots");
  }
  if (!pictures.ground_png.empty()) {
    page += "<section><h2>The ground</h2>" +
            image_tag("image/png", pictures.ground_png, "the planes of the map, which may be its ground") + "<p>" +
            html_escaped(pictures.ground_note) + "</p></section>\n";
  }
  page += "<section><h2>To repeat this run</h2><code>" + html_escaped(summary.command) + "</code><p>pocket-ptam " +
          html_escaped(summary.version) +
          (log.clock == ClockKind::kWork ? ". The work clock makes it repeatable bit for bit."
                                         : ". Timed by a real clock: a repeated run will differ.") +
          "</p></section>\n</main></body></html>\n";
  return page;
}

}  // namespace pptam::platform
