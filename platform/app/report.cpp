#include "platform/app/report.h"

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <functional>
#include <iterator>

#include "platform/child_process.h"
#include "platform/files.h"
#include "platform/text.h"
#include "scheduler/clock.h"

namespace pptam::app {
namespace {

using Eigen::Vector3d;
using platform::ChildProcess;
using platform::format;
using platform::InputError;
using platform::write_text;

std::string base64(const std::string& bytes) {
  static constexpr char kDigits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  text.reserve((bytes.size() + 2) / 3 * 4);
  for (size_t i = 0; i < bytes.size(); i += 3) {
    uint32_t group = 0;
    for (size_t k = 0; k < 3; ++k)
      group = group << 8 | (i + k < bytes.size() ? static_cast<uint8_t>(bytes[i + k]) : 0u);
    for (size_t k = 0; k < 4; ++k) text += i + k <= bytes.size() ? kDigits[group >> (18 - 6 * k) & 63] : '=';
  }
  return text;
}

// A script file that goes away with the object.
class TemporaryFile {
 public:
  explicit TemporaryFile(const std::string& content) {
    std::string name = (std::filesystem::temp_directory_path() / "pocket-ptam-XXXXXX").string();
    const int fd = mkstemp(name.data());
    if (fd < 0) throw InputError(name + ": cannot make a temporary file");
    path_ = name;
    close(fd);
    write_text(path_, content);
  }
  ~TemporaryFile() {
    std::error_code ignored;
    std::filesystem::remove(path_, ignored);
  }
  TemporaryFile(const TemporaryFile&) = delete;
  TemporaryFile& operator=(const TemporaryFile&) = delete;
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

std::string run_gnuplot(const std::string& script) {
  const TemporaryFile file(script);
  ChildProcess gnuplot({"gnuplot", file.path().string()}, ChildProcess::Pipe::kReadStdout);
  std::string svg;
  char buffer[65536];
  while (const size_t bytes = gnuplot.read(buffer, sizeof buffer)) svg.append(buffer, bytes);
  if (gnuplot.finish() != 0) throw InputError("gnuplot failed: " + gnuplot.errors());
  return svg;
}

std::string plot_head(int width, int height) {
  return format(
      "set terminal svg size %d,%d dynamic enhanced font 'sans,13' background '#ffffff'\n"
      "set border 3 lc rgb '#777777'\nset tics nomirror textcolor rgb '#444444'\nset grid lc rgb '#e4e6ea' lt 1\n"
      "set key top left reverse Left opaque box lc rgb '#dddddd' samplen 1.5 font ',12'\n"
      "set style fill solid 0.85 noborder\n",
      width, height);
}

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
  const platform::Trajectory keyframes = log.keyframe_trajectory();
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
  for (const FrameLog& frame : log.frames) {
    if (!frame.pose_valid) {
      if (!gap) path += "\n";
      gap = true;
      continue;
    }
    append_row(&path, frame.T_wc.translation(), 0);
    gap = false;
  }
  double size = 0;
  for (const platform::StampedPose& keyframe : keyframes) include(keyframe.T_wc.translation());
  for (int i = 0; i < 3; ++i) size = std::max(size, ranges[i].high - ranges[i].low);
  std::string cameras;  // x y z, and the optical axis as a stroke
  for (const platform::StampedPose& keyframe : keyframes) {
    const Vector3d p = keyframe.T_wc.translation();
    const Vector3d d = keyframe.T_wc.linear().col(2) * (0.07 * size);
    cameras += format("%.6g %.6g %.6g %.6g %.6g %.6g\n", p.x(), p.y(), p.z(), d.x(), d.y(), d.z());
  }
  std::string script = plot_head(1120, 520) + "$points << EOD\n" + points + "EOD\n$path << EOD\n" + path +
                       "EOD\n$cameras << EOD\n" + cameras + "EOD\n" +
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
  return run_gnuplot(script + "unset multiplot\n");
}

std::string plot_times(const RunLog& log) {
  static constexpr const char* kColours[kStages] = {"#8da0cb", "#66c2a5", "#4f81bd", "#e78ac3",
                                                    "#ffd92f", "#fc8d62", "#b3b3b3"};
  std::string data;
  double highest = 0;
  for (const FrameLog& frame : log.frames) {
    data += format("%.4f", log.seconds(frame.timestamp_ns));
    double sum_ms = 0;
    for (const int64_t ns : frame.stage_ns) data += format(" %.4f", sum_ms += 1e-6 * static_cast<double>(ns));
    data += format(" %.4f\n", 1e-6 * static_cast<double>(frame.track_ns));
    highest = std::max({highest, sum_ms, 1e-6 * static_cast<double>(frame.track_ns)});
  }
  const double budget_ms = log.camera.frames_per_s > 0 ? 1000 / log.camera.frames_per_s : 0;
  const bool near_budget = budget_ms > 0 && highest > 0.4 * budget_ms;
  const double top = 1.15 * (near_budget ? std::max(highest, budget_ms) : highest);
  std::string script = plot_head(1120, 380) + "$frames << EOD\n" + data + "EOD\n" +
                       "set xlabel 'time, s'\nset ylabel 'tracking a frame, ms'\nset key outside right top\n" +
                       format("set yrange [0:%g]\nset xrange [0:*]\n", top > 0 ? top : 1.0);
  if (near_budget) {
    script += format("set arrow from graph 0,first %g to graph 1,first %g nohead dt 2 lc rgb '#aa0000' front\n",
                     budget_ms, budget_ms);
  }
  script += "plot ";
  for (int s = kStages - 1; s >= 0; --s) {  // cumulative sums, the highest first, each hides the rest below
    script += format("$frames using 1:%d with filledcurves x1 lc rgb '%s' title '%s', ", s + 2, kColours[s],
                     name_of(static_cast<Stage>(s)));
  }
  return run_gnuplot(script +
                     format("$frames using 1:%d with lines lw 0.8 lc rgb '#333333' title 'in all'\n", kStages + 2));
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
  return run_gnuplot(plot_head(1120, 380) + "$frames << EOD\n" + data + "EOD\n$keyframes << EOD\n" + keyframes +
                     "EOD\nset xlabel 'time, s'\nset ylabel 'share of the points searched'\nset yrange [-0.13:1.05]\n"
                     "set xrange [0:*]\nset ytics 0,0.2,1\nset key outside right top\n" +
                     strips + "plot $frames using 1:2 with lines lw 1.4 lc rgb '#4f81bd' title 'found', " +
                     "$frames using 1:3 with lines lw 1.4 lc rgb '#17375e' title 'inliers', " +
                     (keyframes.empty() ? ""
                                        : "$keyframes using 1:(0.02) with points pt 9 ps 0.7 lc rgb '#e06c2c' "
                                          "title 'keyframe', ") +
                     keys + "\n");
}

std::string image_tag(const std::string& type, const std::string& content, const std::string& alt) {
  return "<img alt=\"" + html_escaped(alt) + "\" src=\"data:" + type + ";base64," + base64(content) + "\">";
}

std::string read_if_there(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
}

std::string limits_of(const RunLog& log) {
  uint32_t bits = 0;
  for (const FrameLog& frame : log.frames) bits |= frame.limits_hit;
  return limit_names(bits);
}

}  // namespace

std::string plot_svg(int width, int height, const std::string& script) {
  return run_gnuplot(plot_head(width, height) + script);
}

std::string svg_tag(const std::string& svg, const std::string& alt) {
  return image_tag("image/svg+xml", svg, alt);
}

std::string html_escaped(const std::string& text) {
  std::string escaped;
  for (const char c : text) {
    switch (c) {
      case '&':
        escaped += "&amp;";
        break;
      case '<':
        escaped += "&lt;";
        break;
      case '>':
        escaped += "&gt;";
        break;
      case '"':
        escaped += "&quot;";
        break;
      default:
        escaped += c;
    }
  }
  return escaped;
}

std::string html_head(const std::string& title) {
  return "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\n"
         "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>" +
         html_escaped(title) +
         "</title>\n<style>\n"
         "body{font:16px/1.5 system-ui,sans-serif;color:#1d2026;background:#f5f6f8;margin:0;padding:2rem 1rem}\n"
         "main{max-width:1160px;margin:auto}\nh1{font-size:1.6rem;margin:0 0 1rem}\nh2{font-size:1.1rem;margin:0 0 "
         ".6rem}\n"
         "section{background:#fff;border:1px solid #e1e4e8;border-radius:10px;padding:1.1rem "
         "1.3rem;margin-bottom:1.2rem}\n"
         "table{border-collapse:collapse}\nth,td{text-align:left;padding:.28rem 1.1rem .28rem 0;vertical-align:top}\n"
         "th{font-weight:500;color:#5b6370}\n.wide td,.wide th{text-align:right;border-bottom:1px solid #eceef1}\n"
         ".wide td:first-child,.wide th:first-child{text-align:left}\n.total td{font-weight:600;background:#f5f6f8}\n"
         "img{max-width:100%;height:auto;display:block}\n.side{display:flex;flex-wrap:wrap;gap:2rem}\n"
         ".side img{max-height:460px;width:auto;border-radius:6px}\n"
         "code{background:#eef0f3;padding:.5rem .7rem;border-radius:6px;display:block;overflow-x:auto}\n"
         "p{margin:.5rem 0 0;color:#5b6370;font-size:.93rem}\n</style></head>\n<body><main>\n";
}

std::vector<SummaryRow> summarise(const Evaluation& e) {
  std::vector<SummaryRow> rows;
  rows.push_back({"trajectory error", format("%.3g %% of the path: rms %.4g, median %.4g, largest %.4g",
                                             e.ate_percent(), e.ate_rmse, e.ate_median, e.ate_max)});
  rows.push_back({"path", format("%.4g, within a box of diagonal %.4g (units of the truth)", e.path_length, e.extent)});
  rows.push_back({"scale", format("%.5g", e.alignment.scale)});
  if (e.relative_pairs > 0) {
    rows.push_back({"error over 1 s", format("%.4g, %.3g degrees (rms of %d pairs)", e.relative_translation,
                                             e.relative_rotation_deg, e.relative_pairs)});
  }
  rows.push_back({"wrong poses", format("%d of %zu (%.1f %%)", e.wrong_poses, e.poses.size(), 100 * e.wrong_fraction)});
  return rows;
}

std::vector<SummaryRow> summarise(const Judgement& j) {
  std::vector<SummaryRow> rows;
  if (!j.initialised) return rows;
  rows.push_back(
      {"after the movement", format("first pose %.2f s after the first sideways movement", j.initialised_s)});
  rows.push_back(
      {"tracked if expected", format("%d of %d frames (%.1f %%)", j.tracked, j.expected, j.tracked_percent())});
  rows.push_back({"wrong as good", format("%d of %d (%.2f %%)", j.wrong_good, j.poses, j.wrong_good_percent())});
  if (j.losses > 0 || j.false_relocalisations > 0) {
    const std::string longest =
        std::isnan(j.recovery_s) ? "not all were recovered" : format("longest %.2f s", j.recovery_s);
    rows.push_back({"recovered", format("%d of %d losses in time, %s; %d false relocalisations", j.recovered, j.losses,
                                        longest.c_str(), j.false_relocalisations)});
  }
  if (!std::isnan(j.jitter_mm)) {
    rows.push_back(
        {"standstill", format("%.3f mm rms, %.2f times the covariance's; %.4f degrees, %.2f times; followed "
                              "%.0f frames after the step",
                              j.jitter_mm, j.jitter_mm_ratio, j.jitter_deg, j.jitter_deg_ratio, j.lag_frames)});
  }
  return rows;
}

std::vector<SummaryRow> summarise(const RunLog& log, const RunSummary& summary) {
  std::vector<SummaryRow> rows;
  const CostSummary cost = cost_of(log);
  const FrameLog* first = log.first_tracked();
  rows.push_back({"sequence", format("%s, %d x %d at %.4g frames/s", log.camera.name.c_str(), log.camera.model.width,
                                     log.camera.model.height, log.camera.frames_per_s)});
  rows.push_back({"frames", format("%zu tracked, %d dropped, %.1f s", log.frames.size(), log.dropped,
                                   log.frames.empty() ? 0.0 : log.seconds(log.frames.back().timestamp_ns))});
  rows.push_back(
      {"initialised", first == nullptr ? "never" : format("after %.2f s", log.seconds(first->timestamp_ns))});
  if (first != nullptr) {
    rows.push_back({"tracked since then", format("%.1f %% of the frames", 100 * log.tracked_fraction())});
    rows.push_back({"reprojection error", format("%.2f px rms", log.reprojection_px())});
    rows.push_back({"map", format("%zu keyframes, %zu points", log.keyframes.size(), log.map_points.size()) +
                               (log.map_parts > 1 ? format(", fallen into %d parts", log.map_parts) : "")});
    rows.push_back(
        {"a tracked frame", format("%.1f ms, %.1f at worst (%s clock); %.2f million instructions (modelled)",
                                   cost.mean_ms, cost.worst_ms, name_of(log.clock), cost.mean_minstructions)});
  }
  rows.push_back({"memory", format("%.1f MB", 1e-6 * static_cast<double>(log.memory_bytes))});
  const std::string limits = limits_of(log);
  if (!limits.empty()) rows.push_back({"limits reached", limits});
  if (summary.evaluation) {
    for (SummaryRow& row : summarise(*summary.evaluation)) rows.push_back(std::move(row));
    if (summary.plane_known) {
      rows.push_back({"ground plane", format("%.2f degrees off", summary.evaluation->vertical_error_deg)});
    }
  } else if (!summary.evaluation_trouble.empty()) {
    rows.push_back({"evaluation", summary.evaluation_trouble});
  }
  if (summary.judgement) {
    for (SummaryRow& row : summarise(*summary.judgement)) rows.push_back(std::move(row));
  }
  rows.push_back({"map hash", format("%016llx", static_cast<unsigned long long>(log.map_hash))});
  if (!log.broken.empty()) rows.push_back({"stopped early", log.broken});
  return rows;
}

std::string plot_trajectories(const Evaluation& e, const platform::Trajectory& truth) {
  std::string truth_rows;
  for (const platform::StampedPose& pose : truth) append_row(&truth_rows, pose.T_wc.translation(), 0);
  std::string right;
  std::string wrong;
  for (size_t i = 0; i < e.poses.size(); ++i) {
    const AssociatedPose& pose = e.poses[i];
    const Vector3d p = e.robust_alignment * pose.T_wc.translation();
    constexpr int64_t kGapNs = 500'000'000;  // where tracking was lost the line breaks
    if (i > 0 && saturated_difference(pose.timestamp_ns, e.poses[i - 1].timestamp_ns) > kGapNs) right += "\n";
    append_row(&right, p, 0);
    if (pose.wrong) append_row(&wrong, p, 0);
  }
  // The picture shows the truth with a margin; wrong poses far away fall outside.
  Range ranges[3];
  double size = 0;
  for (int i = 0; i < 3; ++i) {
    std::vector<double> values;
    for (const platform::StampedPose& pose : truth) values.push_back(pose.T_wc.translation()[i]);
    ranges[i] = range_of(values, 0);
    size = std::max(size, ranges[i].high - ranges[i].low);
  }
  std::string script = plot_head(1120, 500) + "$truth << EOD\n" + truth_rows + "EOD\n$right << EOD\n" + right +
                       "EOD\n$wrong << EOD\n" + wrong + "EOD\nset multiplot layout 1,2\nset size ratio -1\n";
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
  return run_gnuplot(script + "unset multiplot\n");
}

void write_report(const std::filesystem::path& folder, const RunLog& log, const RunSummary& summary,
                  const platform::Trajectory& truth, std::vector<std::string>* warnings) {
  std::string page = html_head("Pocket PTAM: " + log.camera.name) + "<h1>" + html_escaped(log.camera.name) + "</h1>\n";
  page += "<section class=\"side\"><div><table>\n";
  for (const SummaryRow& row : summarise(log, summary)) {
    page += "<tr><th>" + html_escaped(row.label) + "</th><td>" + html_escaped(row.value) + "</td></tr>\n";
  }
  page += "</table></div>\n";
  const std::string still = read_if_there(folder / "overlay.png");
  if (!still.empty()) page += image_tag("image/png", still, "the camera's view with the map's points and a house");
  page += "</section>\n";
  if (std::filesystem::exists(folder / "overlay.mp4")) {
    page += "<section><h2>Video</h2><a href=\"overlay.mp4\">overlay.mp4</a> (beside this file)</section>\n";
  }

  const auto add_plot = [&](const char* title, const char* note, const std::function<std::string()>& plot) {
    page += std::string("<section><h2>") + title + "</h2>" + image_tag("image/svg+xml", plot(), title) + "<p>" + note +
            "</p></section>\n";
  };
  try {
    if (summary.evaluation) {
      add_plot("Trajectory", "After alignment by a similarity that ignores wrong poses, in units of the truth.",
               [&] { return plot_trajectories(*summary.evaluation, truth); });
    }
    if (!log.map_points.empty()) {
      add_plot("Map", "World units: 0.1 is the distance between the first two keyframes; z = 0 is the dominant plane.",
               [&] { return plot_map(log); });
    }
    if (!log.frames.empty()) {
      add_plot("Time per frame", "Stages of tracking, stacked; dashed: the time between two frames.",
               [&] { return plot_times(log); });
      add_plot("Tracking", "The strip at the bottom shows the state and the quality.",
               [&] { return plot_tracking(log); });
    }
  } catch (const InputError& error) {
    warnings->push_back(std::string(error.what()) + "; report.html is written without plots");
  }
  page += "<section><h2>To repeat this run</h2><code>" + html_escaped(summary.command) + "</code><p>pocket-ptam " +
          html_escaped(summary.version) +
          (log.clock == ClockKind::kWork ? ". The work clock makes it repeatable bit for bit."
                                         : ". Timed by a real clock: a repeated run will differ.") +
          "</p></section>\n</main></body></html>\n";
  write_text(folder / "report.html", page);
}

}  // namespace pptam::app
