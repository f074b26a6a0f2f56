#include "sim_phone/laboratory/start_study.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>
#include <utility>

#include "platform/input_error.h"
#include "platform/outputs.h"
#include "platform/run/console.h"
#include "platform/run/evaluation.h"
#include "platform/run/html.h"
#include "platform/run/interruption.h"
#include "platform/run/jobs.h"
#include "platform/run/names.h"
#include "platform/run/statistics.h"
#include "platform/text.h"
#include "sim_phone/hand.h"
#include "sim_phone/laboratory/results.h"
#include "sim_phone/random.h"

namespace pptam::laboratory {
namespace {

using namespace platform;

using Eigen::Isometry3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr uint64_t kTrialsPerScene = 10;  // painting a scene takes as long as two trials

struct Kind {
  const char* name;
  const char* motion;
  std::vector<std::string> scenes;
  bool vary_camera;
  const char* says;
};
const std::vector<Kind>& kinds() {
  static const std::vector<Kind> all = {
      {"planar", "start", {"plane"}, false, "a plane slanted by 0 to 60 degrees, seen from 0.5 to 1.5 m; 8 to 20 cm"},
      {"steep", "steep_start", {"plane"}, false, "the same, slanted by 60 to 70 degrees"},
      {"cameras", "start", {"plane"}, true, "planar, with other readouts, exposures and frame rates"},
      {"rotation", "turn_start", {"plane", "boxes", "walls"}, false, "turns by 8 to 30 degrees first, then moves"},
      {"corners", "start", {"clutter", "walls"}, false, "no plane explains 60 % of the view"},
      {"sparse", "start", {"sparse", "postcards"}, false, "planar, of bare tables with little on them"},
      {"repeated",
       "start",
       {"tiles", "same_tiles"},
       false,
       "planar, of tiles all alike with and without other things"}};
  return all;
}

const Kind& kind_named(const std::string& name) {
  for (const Kind& kind : kinds()) {
    if (name == kind.name) return kind;
  }
  throw InputError("--kind " + name + ": choose one of " + platform::joined(study_kinds()));
}

sim::PhoneOptions phone_for(const Kind& kind, uint64_t seed) {
  sim::PhoneOptions phone;
  const uint64_t group = (seed - 1) / kTrialsPerScene;
  phone.scene = kind.scenes[group % kind.scenes.size()];
  phone.scene_seed = group + 1;
  phone.motion = kind.motion;
  phone.seed = seed;
  phone.duration_s = 20;  // stopped long before
  if (kind.vary_camera) {
    sim::Random random(seed, 40);
    phone.frames_per_s = random.chance(0.5) ? 30 : 15;
    const double frame_s = 1 / phone.frames_per_s;
    phone.readout_axis = random.chance(0.5) ? RollingShutter::Axis::kColumns : RollingShutter::Axis::kRows;
    phone.readout_s = random.chance(0.25) ? 0.0 : random.sign() * random.uniform(0.3, 0.95) * frame_s;
    phone.exposure_s = random.uniform(0.1, 0.9) * frame_s;
  }
  return phone;
}

// Ends when told to, and may tell another shutter than it has.
class StoppableCamera : public platform::Camera {
 public:
  StoppableCamera(std::unique_ptr<platform::Camera> camera, float shutter_told)
      : camera_(std::move(camera)), info_(camera_->info()) {
    info_.shutter.line_time_s *= shutter_told;
  }
  const platform::CameraInfo& info() const override { return info_; }
  platform::Trajectory ground_truth() const override { return camera_->ground_truth(); }
  platform::CameraEvent wait(Frame* frame, int64_t deadline_ns) override {
    return stopped_ ? platform::CameraEvent::kEnd : camera_->wait(frame, deadline_ns);
  }
  void stop() override { stopped_ = true; }

 private:
  std::unique_ptr<platform::Camera> camera_;
  platform::CameraInfo info_;
  bool stopped_ = false;
};

Vector3d ray_through(const CameraModel& m, const Vector2d& px) {
  return {(px.x() - static_cast<double>(m.cx)) / static_cast<double>(m.fx),
          (px.y() - static_cast<double>(m.cy)) / static_cast<double>(m.fy), 1};
}

double angle_deg(const Vector3d& a, const Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b)) / sim::kDegree;
}

// Share of the points on the plane that explains most of them, within 2 % of the depth. All triples of up to 30 points.
double plane_share(const std::vector<Vector3d>& points) {
  if (points.size() < 3) return 0;
  const size_t stride = (points.size() + 29) / 30;
  size_t most = 0;
  for (size_t i = 0; i < points.size(); i += stride) {
    for (size_t j = i + stride; j < points.size(); j += stride) {
      for (size_t k = j + stride; k < points.size(); k += stride) {
        const Vector3d cross = (points[j] - points[i]).cross(points[k] - points[i]);
        if (cross.norm() < 1e-6) continue;
        const Vector3d n = cross.normalized();
        size_t on_plane = 0;
        for (const Vector3d& p : points) on_plane += std::abs(n.dot(p - points[i])) < 0.02 * p.z() ? 1 : 0;
        most = std::max(most, on_plane);
      }
    }
  }
  return static_cast<double>(most) / static_cast<double>(points.size());
}

// Share of the map's points whose depth is right within kRightDepth, but for one scale, in the first, the middle or the
// last tracked view: from one place alone some are hidden.
double right_depths(const RunLog& log, const sim::Scene& scene, const sim::Start& start) {
  std::vector<const FrameLog*> tracked;
  for (const FrameLog& frame : log.frames) {
    if (frame.pose_valid) tracked.push_back(&frame);
  }
  if (tracked.empty()) return 0;
  // A corner on an edge belongs to what is in front, which its own ray may just miss: rays 2 px aside count too.
  const double step = 2 / static_cast<double>(log.camera.model.fx);
  const Vector2d asides[] = {{0, 0}, {step, 0}, {-step, 0}, {0, step}, {0, -step}};
  std::vector<std::vector<double>> ratios(log.map_points.size());  // of each point's depths to the truth's
  for (const size_t index : {size_t{0}, tracked.size() / 2, tracked.size() - 1}) {
    const Isometry3d T_cw = tracked[index]->T_wc.inverse();
    const Isometry3d truth = start.curve(1e-9 * static_cast<double>(tracked[index]->timestamp_ns));
    for (size_t i = 0; i < ratios.size(); ++i) {
      const Vector3d p = T_cw * log.map_points[i].p_w.cast<double>();
      if (p.z() <= 0) continue;
      for (const Vector2d& aside : asides) {
        const Vector3d ray(p.x() / p.z() + aside.x(), p.y() / p.z() + aside.y(), 1);
        const double depth = sim::first_hit(scene, truth.translation(), truth.linear() * ray);
        if (std::isfinite(depth)) ratios[i].push_back(p.z() / depth);
      }
    }
  }
  std::erase_if(ratios, [](const std::vector<double>& choices) { return choices.empty(); });
  if (ratios.empty()) return 0;
  std::vector<double> sorted;
  sorted.reserve(ratios.size());
  for (const std::vector<double>& choices : ratios) sorted.push_back(choices.front());
  std::sort(sorted.begin(), sorted.end());
  const double scale = sorted[sorted.size() / 2];
  int right = 0;
  for (const std::vector<double>& choices : ratios) {
    right += std::any_of(choices.begin(), choices.end(),
                         [&](double ratio) { return std::abs(ratio / scale - 1) < kRightDepth; })
                 ? 1
                 : 0;
  }
  return static_cast<double>(right) / static_cast<double>(ratios.size());
}

std::string replay_options(const StudyTrial& trial) {
  const sim::PhoneOptions& phone = trial.phone;
  return format("--scene %s --scene-seed %d --motion %s --seed %d --readout %s --exposure %.6f --fps %g",
                phone.scene.c_str(), static_cast<int>(phone.scene_seed.value_or(phone.seed)), phone.motion.c_str(),
                static_cast<int>(phone.seed), readout_text(phone.readout_axis, phone.readout_s).c_str(),
                phone.exposure_s, phone.frames_per_s);
}

struct Quantiles {
  double median = kNone, p95 = kNone, worst = kNone;
};
Quantiles quantiles(const std::vector<double>& values) {
  return {percentile(values, 0.5), percentile(values, 0.95), percentile(values, 1)};
}

std::vector<std::string> summary_cells(const std::string& kind, const std::vector<StudyTrial>& trials) {
  int count = 0, initialised = 0, wrong = 0, right = 0, refused = 0, early = 0, planes = 0;
  std::vector<double> normals, ends, times, baselines, ates, costs, shares;
  for (const StudyTrial& trial : trials) {
    if (trial.kind != kind) continue;
    ++count;
    initialised += trial.initialised;
    wrong += trial.wrong_plane();
    right += trial.right();
    refused += trial.refused();
    early += trial.early;
    planes += trial.plane_known;
    costs.push_back(trial.worst_minstructions);
    shares.push_back(100 * trial.plane_share);
    if (!trial.initialised) continue;
    times.push_back(trial.time_s);
    baselines.push_back(100 * trial.baseline_m / trial.start.distance_m);
    if (trial.plane_known) {
      normals.push_back(trial.normal_deg);
      ends.push_back(trial.normal_end_deg);
    }
    if (trial.judged) ates.push_back(trial.ate_percent);
  }
  const auto number = [](const char* pattern, double value) {
    return std::isnan(value) ? std::string("-") : format(pattern, value);
  };
  const auto percent = [&](int n, int of) { return of > 0 ? format("%.1f", 100.0 * n / of) : std::string("-"); };
  const Quantiles normal = quantiles(normals), time = quantiles(times), baseline = quantiles(baselines);
  const Quantiles ate = quantiles(ates), cost = quantiles(costs);
  return {kind,
          std::to_string(count),
          percent(initialised, count),
          percent(right, count),
          percent(refused, count),
          planes > 0 ? std::to_string(wrong) : "-",
          std::to_string(early),
          number("%.2f", time.median),
          number("%.2f", time.p95),
          number("%.1f", baseline.median),
          number("%.2f", normal.median),
          number("%.2f", normal.worst),
          number("%.2f", quantiles(ends).median),
          number("%.3f", ate.median),
          number("%.3f", ate.worst),
          number("%.0f", quantiles(shares).median),
          number("%.2f", cost.median),
          number("%.2f", cost.worst)};
}

const std::vector<std::string> kHeads = {"kind",  "trials", "map %", "right %",    "refused %",  "wrong planes",
                                         "early", "time s", "95 %",  "baseline %", "normal deg", "worst",
                                         "later", "ATE %",  "worst", "plane %",    "M instr.",   "worst"};

std::string csv_of(const std::vector<StudyTrial>& trials) {
  std::string csv =
      "kind,seed,initialised,right,wrong_plane,early,time_s,baseline_m,distance_m,slant_deg,length_m,direction_deg,"
      "speed_m_s,turned_deg,plane_share,normal_deg,normal_end_deg,depth_share,ate_percent,wrong_percent,tracked_"
      "percent,"
      "restarts,worst_minstructions,last_hint,options,trouble\n";
  for (const StudyTrial& t : trials) {
    const sim::Start& s = t.start;
    const auto number = [](bool known, double value) { return known ? format("%.5g", value) : std::string(); };
    csv += t.kind +
           format(",%d,%d,%d,%d,%d,", static_cast<int>(t.seed), t.initialised, t.right(), t.wrong_plane(), t.early) +
           number(t.initialised, t.time_s) + "," + number(t.initialised, t.baseline_m) +
           format(",%.3f,%.1f,%.3f,%.0f,%.3f,%.1f,%.3f,", s.distance_m, s.slant_deg, s.length_m, s.direction_deg,
                  s.length_m / (s.move_end_s - s.move_s), s.turned_deg, t.plane_share) +
           number(t.initialised && t.plane_known, t.normal_deg) + "," +
           number(t.initialised && t.plane_known, t.normal_end_deg) + "," + number(t.initialised, t.depth_share) + "," +
           number(t.judged, t.ate_percent) + "," + number(t.judged, 100 * t.wrong_fraction) + "," +
           number(t.initialised, 100 * t.tracked_fraction) +
           format(",%d,%.3f,%s,", t.restarts, t.worst_minstructions, name_of(t.last_hint)) + replay_options(t) + "," +
           t.trouble + "\n";
  }
  return csv;
}

// Points (x, y) of the trials of each kind, as one scatter plot.
std::string scatter(const std::vector<StudyTrial>& trials, const std::vector<std::string>& names, const char* settings,
                    const std::function<std::optional<Vector2d>(const StudyTrial&)>& place) {
  static constexpr const char* kColours[] = {"#2f6fb5", "#e06c2c", "#3fb76b", "#8e5bb5", "#b59a2f"};
  std::string script, plots;
  size_t colour = 0;
  for (const std::string& kind : names) {
    std::string data;
    for (const StudyTrial& trial : trials) {
      if (trial.kind != kind) continue;
      if (const auto at = place(trial)) data += format("%.6g %.6g\n", at->x(), at->y());
    }
    if (!data.empty()) {
      script.append("$").append(kind).append(" << EOD\n").append(data).append("EOD\n");
      plots +=
          (plots.empty() ? "plot " : ", ") + format("$%s using 1:2 with points pt 7 ps 0.45 lc rgb '%s' title '%s'",
                                                    kind.c_str(), kColours[colour], kind.c_str());
    }
    colour = (colour + 1) % std::size(kColours);
  }
  if (plots.empty()) return "";
  return plot_svg(1120, 380, script + settings + "\nset key outside right top\n" + plots + "\n");
}

std::string html_of(const std::vector<StudyTrial>& trials, const StudyOptions& options,
                    const std::vector<std::vector<std::string>>& rows) {
  std::string page = html_head("Pocket PTAM: initialisation") +
                     "<h1>Initialisation study: " + std::to_string(options.seeds) +
                     " starts of each kind</h1>\n<section><table class=\"wide\"><tr>";
  for (const std::string& head : kHeads) page += "<th>" + head + "</th>";
  page += "</tr>\n";
  for (const std::vector<std::string>& row : rows) {
    page += "<tr>";
    for (const std::string& cell : row) page += "<td>" + html_escaped(cell) + "</td>";
    page += "</tr>\n";
  }
  page += "</table><p>";
  for (const Kind& kind : kinds()) page += std::string("<b>") + kind.name + "</b>: " + kind.says + ". ";
  page +=
      "Map: a pose within 4 s of the first sideways movement. Right: nothing before the movement, the plane's normal "
      "within 10 degrees, four fifths of the map's points at the right depth within a tenth, and 95 % of the following "
      "poses right. Refused: no map, and the last hint is that there is too little texture. Wrong planes: normal off "
      "by more than 10 degrees at the first pose. Early: a map from turning or "
      "holding still. Baseline: from the first view to the first pose, of the distance. Later: the normal at the end. "
      "ATE: rms position error of the following seconds, of their path. Plane: share of the first view's points that "
      "one plane explains. M instr.: dearest frame before the first pose.</p></section>\n";
  const auto add = [&](const char* title, const std::string& svg) {
    if (!svg.empty()) page += std::string("<section><h2>") + title + "</h2>" + svg_tag(svg, title) + "</section>\n";
  };
  using Place = std::optional<Vector2d>;
  add("Time to the map, by slant", scatter(trials, options.kinds,
                                           "set xlabel 'slant of the surface looked at, degrees'\nset yrange [0:4.2]\n"
                                           "set ylabel 'from the first movement, s (4.1: none)'",
                                           [](const StudyTrial& t) -> Place {
                                             return Vector2d(t.start.slant_deg,
                                                             t.initialised ? t.time_s : kStudyLimit_s + 0.1);
                                           }));
  add("Baseline at the map, by the movement's length",
      scatter(
          trials, options.kinds,
          "set xlabel 'first sideways movement, of the distance, %'\nset ylabel 'baseline at the first pose, of the "
          "distance, %'\nset xrange [0:*]\nset yrange [0:*]",
          [](const StudyTrial& t) -> Place {
            if (!t.initialised) return std::nullopt;
            return Vector2d(100 * t.start.length_m / t.start.distance_m, 100 * t.baseline_m / t.start.distance_m);
          }));
  add("Error of the plane's normal, by slant",
      scatter(trials, options.kinds,
              "set xlabel 'slant, degrees'\nset ylabel 'normal off at the first pose, degrees'\nset logscale y",
              [](const StudyTrial& t) -> Place {
                if (!t.initialised || !t.plane_known) return std::nullopt;
                return Vector2d(t.start.slant_deg, std::max(t.normal_deg, 0.01));
              }));
  add("Position error afterwards, by slant",
      scatter(
          trials, options.kinds,
          "set xlabel 'slant of the surface looked at, degrees'\nset ylabel 'ATE of the following seconds, % of the "
          "path'\nset logscale y",
          [](const StudyTrial& t) -> Place {
            if (!t.judged) return std::nullopt;
            return Vector2d(t.start.slant_deg, std::max(t.ate_percent, 0.01));
          }));
  return page + "<section><h2>To repeat this study</h2><code>" + html_escaped(options.command) +
         "</code><p>pocket-ptam " + html_escaped(options.version) + "</p></section>\n</main></body></html>\n";
}

}  // namespace

std::vector<std::string> study_kinds() {
  std::vector<std::string> names;
  for (const Kind& kind : kinds()) names.push_back(kind.name);
  return names;
}

std::shared_ptr<const sim::Scene> study_scene(const std::string& kind, uint64_t seed) {
  const sim::PhoneOptions phone = phone_for(kind_named(kind), seed);
  return std::make_shared<const sim::Scene>(sim::make_scene(phone.scene, *phone.scene_seed));
}

StudyTrial run_study_trial(const std::string& kind, uint64_t seed, double follow_s,
                           std::shared_ptr<const sim::Scene> scene, float shutter_told) {
  StudyTrial trial;
  trial.kind = kind;
  trial.seed = seed;
  trial.phone = phone_for(kind_named(kind), seed);
  if (!scene) scene = study_scene(kind, seed);
  trial.start = sim::make_start(trial.phone.motion, *scene, seed);
  trial.plane_known =
      trial.phone.scene != "boxes" && sim::ground_plane_known(trial.phone.scene);  // no more than a plane
  const sim::Start& start = trial.start;
  const auto seconds = [](int64_t timestamp_ns) { return 1e-9 * static_cast<double>(timestamp_ns); };

  StoppableCamera camera(sim::make_phone_camera(trial.phone, scene), shutter_told);
  double first_view_s = 0, first_pose_s = -1;
  std::vector<Vector3d> points;  // of the first view, from the first frame that found any
  TrackingState last_state = TrackingState::kWaiting;
  const RunLog log = run_sequence(
      camera, {}, [](const platform::CameraInfo&) {},
      [&](const Frame&, const TrackResult& result, const RunLog& so_far) {
        const double now_s = seconds(result.timestamp_ns);
        if (result.state == TrackingState::kInitialising && last_state == TrackingState::kWaiting) first_view_s = now_s;
        if (result.state == TrackingState::kWaiting && last_state == TrackingState::kInitialising) ++trial.restarts;
        last_state = result.state;
        if (now_s < start.move_s && result.keyframes > 0) trial.early = true;
        if (points.empty() && !result.points.empty()) {
          const Isometry3d T = start.curve(first_view_s);
          for (const ObservedPoint& point : result.points) {
            if (point.kind != ObservedKind::kInitial) continue;
            const Vector3d ray = ray_through(so_far.camera.model, point.predicted_px.cast<double>());
            const double depth = sim::first_hit(*scene, T.translation(), T.linear() * ray);
            if (std::isfinite(depth)) points.push_back(depth * ray);
          }
        }
        if (first_pose_s >= 0) {
          if (now_s >= first_pose_s + follow_s) camera.stop();
          return;
        }
        trial.worst_minstructions =
            std::max(trial.worst_minstructions, 1e-6 * static_cast<double>(so_far.frames.back().instructions));
        if (result.pose_valid) {
          first_pose_s = now_s;
          const Isometry3d truth = start.curve(now_s);
          trial.time_s = now_s - start.move_s;
          trial.initialised = trial.time_s <= kStudyLimit_s;
          trial.baseline_m = (truth.translation() - start.curve(first_view_s).translation()).norm();
          trial.normal_deg = angle_deg(result.T_cw.R.cast<double>().col(2), truth.linear().transpose() * start.normal);
        } else {
          trial.last_hint = result.hint;
          if (now_s > start.move_s + kStudyLimit_s) camera.stop();
        }
      });
  trial.trouble = log.broken;
  trial.plane_share = plane_share(points);
  if (first_pose_s < 0) return trial;
  trial.tracked_fraction = log.tracked_fraction();
  trial.depth_share = right_depths(log, *scene, start);
  for (const FrameLog& frame : log.frames) {
    if (!frame.pose_valid) continue;
    const Isometry3d truth = start.curve(seconds(frame.timestamp_ns));
    trial.normal_end_deg = angle_deg(frame.T_wc.linear().row(2), truth.linear().transpose() * start.normal);
  }
  try {
    const Evaluation evaluation = evaluate(log.trajectory(), camera.ground_truth(), "trial", "ground truth");
    trial.judged = true;
    trial.ate_percent = evaluation.ate_percent();
    trial.wrong_fraction = evaluation.wrong_fraction;
  } catch (const InputError&) {
    // Tracked for too short a time.
  }
  return trial;
}

int run_study(const StudyOptions& options) {
  for (const std::string& kind : options.kinds) kind_named(kind);
  OutputFolder folder(options.out, "--out", {"study.csv", "study.html"}, {});
  folder.prepare();
  stop_on_signals();

  const size_t seeds = static_cast<size_t>(options.seeds);
  const size_t groups = (seeds + kTrialsPerScene - 1) / kTrialsPerScene;
  std::vector<StudyTrial> trials(options.kinds.size() * seeds);
  const std::vector<bool> done = run_jobs(options.jobs, options.kinds.size() * groups, [&](size_t job) {
    const size_t kind = job / groups;
    const size_t first = job % groups * kTrialsPerScene;
    std::shared_ptr<const sim::Scene> scene;
    for (size_t i = first; i < std::min<size_t>(first + kTrialsPerScene, seeds); ++i) {
      StudyTrial& trial = trials[kind * seeds + i];
      try {
        if (!scene) scene = study_scene(options.kinds[kind], i + 1);
        trial = run_study_trial(options.kinds[kind], i + 1, options.follow_s, scene);
      } catch (const std::exception& problem) {
        trial.kind = options.kinds[kind];
        trial.seed = i + 1;
        trial.trouble = problem.what();
      }
    }
    return "finished " + options.kinds[kind] + " " + std::to_string(first + 1) + " and following";
  });
  const size_t asked = trials.size();
  std::vector<StudyTrial> whole;  // those of jobs that a signal has not cut short
  for (size_t i = 0; i < asked; ++i) {
    if (done[i / seeds * groups + i % seeds / kTrialsPerScene]) whole.push_back(std::move(trials[i]));
  }
  trials = std::move(whole);

  std::vector<std::vector<std::string>> rows;
  for (const std::string& kind : options.kinds) rows.push_back(summary_cells(kind, trials));
  print_table(kHeads, rows);
  int broken = 0;
  std::printf("\n");
  for (const StudyTrial& trial : trials) {
    if (!trial.trouble.empty()) ++broken;
    if (trial.right()) continue;
    const std::string what = !trial.trouble.empty() ? trial.trouble
                             : trial.early          ? "a map before the movement"
                             : !trial.initialised   ? std::string("no map, last hint: ") + name_of(trial.last_hint)
                             : trial.wrong_plane()  ? format("normal %.1f degrees off", trial.normal_deg)
                                                    : format("%.0f %% of the depths right, %.0f %% of the poses wrong",
                                                             100 * trial.depth_share, 100 * trial.wrong_fraction);
    print_line("not right: " + trial.kind + format(" %d: ", static_cast<int>(trial.seed)) + what);
  }
  if (trials.size() < asked) {
    print_error(interruption() +
                format(": %zu of %zu trials are missing; the others are written", asked - trials.size(), asked));
    ++broken;
  }
  if (!write_results(&folder, "study.csv", csv_of(trials), "study.html",
                     [&] { return html_of(trials, options, rows); }))
    ++broken;
  return broken;
}

}  // namespace pptam::laboratory
