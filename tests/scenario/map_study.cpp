// Bundle adjustment on maps of the emulated phone: float beside double, and what knowing of the rolling shutter gains.
//
// Every run is seen by the whole system and its map saved. From this one snapshot, in double, at one scale and with one
// set of measurements (scale and inliers of the last of these variants):
//   none       no shutter: all velocities are zero
//   moved      [phone 6]: measurements moved to the frame's time by velocities found before, central differences of
//              the tracked poses; moved again, now with the better map, after each of three adjustments
//   between    the measurements' own times; velocities re-estimated between adjustments, as the mapper does in
//              large maps
//   free       velocities are unknowns of the adjustment, with their prior, as the mapper does in small maps
// All are adjusted to convergence. The objective is Tukey's and holds the velocities' prior where they are estimated.
// Errors are those of the keyframes' positions after the best similarity, and of their rates of rotation.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include "map/map_file.h"
#include "platform/run/console.h"
#include "platform/run/evaluation.h"
#include "platform/run/jobs.h"
#include "platform/run/run.h"
#include "platform/run/statistics.h"
#include "platform/text.h"
#include "sim_phone/phone_camera.h"
#include "sim_phone/story.h"
#include "tests/support/engine_run.h"

namespace pptam::test {
namespace {

using Eigen::Isometry3d;
using Vector6d = Eigen::Matrix<double, 6, 1>;
template <class Scalar>
using Run = EngineRun<Scalar, Pinhole<Scalar>>;

constexpr int kIterations = 200;
constexpr int kRounds = 3;            // of moving or re-estimating
constexpr int kVelocityCameras = 16;  // up to so many the mapper frees velocities
constexpr double kGoalCost = 1e-3, kGoalError = 0.02, kGoalGain = 0.1;

// A map as its adjustment sees it. Measurements keep their pixels, `moved` holds what the correction makes of them.
struct Problem {
  using Engine = Run<double>::Engine;
  std::vector<Engine::Camera> cameras;
  std::vector<float> depths;
  std::vector<int64_t> timestamps_ns;
  std::vector<Engine::Point> points;
  std::vector<Engine::Observation> observations;
  Camera camera;
};

Problem problem_of(std::span<const std::byte> file, const Config& config, float shutter_told) {
  Arena measure;
  const Map measured(measure, config);
  std::vector<std::max_align_t> memory(measure.used() / sizeof(std::max_align_t) + 1);
  Arena arena(std::as_writable_bytes(std::span(memory)));
  Map map(arena, config);
  if (!check_map_file(file, config).ok()) throw std::runtime_error("the saved map cannot be read");
  read_map_file(file, config, map);
  Problem problem;
  problem.camera = config.camera;
  problem.camera.shutter.line_time_s *= shutter_told;
  std::vector<int16_t> view(static_cast<size_t>(map.keyframes().size()), -1);
  for (int k = 0; k < map.keyframes().size(); ++k) {
    const Keyframe& keyframe = map.keyframes()[k];
    if (!keyframe.live()) continue;
    view[static_cast<size_t>(k)] = static_cast<int16_t>(problem.cameras.size());
    Problem::Engine::Camera camera;
    camera.now = {keyframe.T_kw.R.cast<double>(), keyframe.T_kw.t.cast<double>(), keyframe.velocity.cast<double>()};
    camera.velocity_prior = keyframe.velocity_prior.cast<double>();
    for (int i = 0; i < 6; ++i) {
      const double sigma =
          static_cast<double>(i < 3 ? kVelocitySigmaTranslation * keyframe.mean_depth : kVelocitySigmaRotation);
      camera.prior_information[i] = 1 / (sigma * sigma);
    }
    camera.pose_free = !problem.cameras.empty();
    problem.cameras.push_back(camera);
    problem.depths.push_back(keyframe.mean_depth);
    problem.timestamps_ns.push_back(keyframe.timestamp_ns);
  }
  for (const MapPoint& from : map.points()) {
    if (from.id == 0) continue;
    Problem::Engine::Point point;
    point.p = from.p_w.cast<double>();
    point.first = static_cast<int32_t>(problem.observations.size());
    for (const Measurement& m : map.measurements(from)) {
      Problem::Engine::Observation o;
      o.px = m.at.px.cast<double>();
      o.inverse_sigma = 1 / static_cast<double>(m.at.sigma());
      o.dt_s = static_cast<double>(problem.camera.dt_s(m.at.px));
      o.camera = view[static_cast<size_t>(m.keyframe)];
      problem.observations.push_back(o);
    }
    std::sort(problem.observations.begin() + point.first, problem.observations.end(),
              [](const auto& a, const auto& b) { return a.camera < b.camera; });
    point.count = static_cast<int32_t>(problem.observations.size()) - point.first;
    problem.points.push_back(point);
  }
  return problem;
}

template <class Scalar>
Pinhole<Scalar> pinhole(const CameraModel& model) {
  return {Scalar(model.fx), Scalar(model.cx), Scalar(model.cy)};
}

template <class Scalar>
std::unique_ptr<Run<Scalar>> make_run(const Problem& problem, bool velocities) {
  BundleCapacity capacity;
  capacity.cameras = static_cast<int>(problem.cameras.size());
  capacity.points = static_cast<int>(problem.points.size());
  capacity.observations = static_cast<int>(problem.observations.size());
  capacity.observations_per_point = kMaxMeasurementsPerPoint + 1;
  capacity.columns = 2 * capacity.cameras;
  auto run = std::make_unique<Run<Scalar>>(capacity, pinhole<Scalar>(problem.camera.model));
  auto& engine = run->engine();
  using Engine = typename Run<Scalar>::Engine;
  for (const auto& from : problem.cameras) {
    typename Engine::Camera camera;
    camera.now = {from.now.R.cast<Scalar>(), from.now.t.cast<Scalar>(), from.now.velocity.cast<Scalar>()};
    camera.velocity_prior = from.velocity_prior.cast<Scalar>();
    camera.prior_information = from.prior_information.cast<Scalar>();
    camera.pose_free = from.pose_free;
    camera.velocity_free = velocities;
    engine.cameras().push_back(camera);
  }
  for (const auto& from : problem.points) {
    typename Engine::Point point;
    point.first = from.first;
    point.count = from.count;
    point.p = from.p.cast<Scalar>();
    engine.points().push_back(point);
  }
  for (const auto& from : problem.observations) {
    typename Engine::Observation observation;
    observation.px = from.px.cast<Scalar>();
    observation.inverse_sigma = Scalar(from.inverse_sigma);
    observation.dt_s = Scalar(from.dt_s);
    observation.camera = from.camera;
    engine.observations().push_back(observation);
  }
  if (!engine.assign_columns()) throw std::logic_error("the engine is too small");
  return run;
}

template <class Scalar>
void take_state(Run<Scalar>& run, Problem* problem) {
  for (size_t k = 0; k < problem->cameras.size(); ++k) {
    const auto& now = run.engine().cameras()[static_cast<int>(k)].now;
    problem->cameras[k].now = {now.R.template cast<double>(), now.t.template cast<double>(),
                               now.velocity.template cast<double>()};
  }
  for (size_t i = 0; i < problem->points.size(); ++i)
    problem->points[i].p = run.engine().points()[static_cast<int>(i)].p.template cast<double>();
  for (size_t i = 0; i < problem->observations.size(); ++i)
    problem->observations[i].weight = static_cast<double>(run.engine().observations()[static_cast<int>(i)].weight);
}

// To convergence. sigma: the fixed scale; 0: estimated. Returns the scale.
template <class Scalar>
double adjust(Problem* problem, bool velocities, double sigma, float converged_at = 1e-6f) {
  const auto run = make_run<Scalar>(*problem, velocities);
  BundleOptions options;
  options.sigma = static_cast<float>(sigma);
  options.converged_at = converged_at;
  run->run(options, kIterations);
  take_state(*run, problem);
  return static_cast<double>(run->engine().sigma());
}

double objective(const Problem& problem, bool with_prior, double sigma) {
  return cost_in_double(make_run<double>(problem, with_prior)->engine(), sigma, pinhole<double>(problem.camera.model));
}

// Outliers go, and points that are left with fewer than two measurements.
void keep_inliers(Problem* problem) {
  Problem kept = *problem;
  kept.points.clear();
  kept.observations.clear();
  for (auto point : problem->points) {
    const auto from = problem->observations.begin() + point.first, to = from + point.count;
    point.first = static_cast<int32_t>(kept.observations.size());
    std::copy_if(from, to, std::back_inserter(kept.observations), [](const auto& o) { return o.weight != 0; });
    point.count = static_cast<int32_t>(kept.observations.size()) - point.first;
    if (point.count >= 2) {
      kept.points.push_back(point);
    } else {
      kept.observations.resize(static_cast<size_t>(point.first));
    }
  }
  *problem = kept;
}

Problem moved(const Problem& problem) {
  Problem result = problem;
  for (const auto& point : problem.points) {
    for (int k = point.first; k < point.first + point.count; ++k) {
      auto& o = result.observations[static_cast<size_t>(k)];
      const auto& now = problem.cameras[static_cast<size_t>(o.camera)].now;
      o.px = problem.camera
                 .global_shutter_px(now.velocity.cast<float>(), (now.R * point.p + now.t).cast<float>(),
                                    o.px.cast<float>())
                 .cast<double>();
      o.dt_s = 0;
    }
  }
  return result;
}

// As Mapper::update_velocities().
void estimate_velocities(Problem* problem) {
  constexpr int kMaxPoints = 256;
  const bool rolling = problem->camera.shutter.line_time_s != 0;
  WorkMeter meter;
  Arena measure;
  const PoseUpdater measured(measure, kMaxPoints, rolling, meter);
  std::vector<std::max_align_t> memory(measure.used() / sizeof(std::max_align_t) + 1);
  Arena arena(std::as_writable_bytes(std::span(memory)));
  PoseUpdater updater(arena, kMaxPoints, rolling, meter);
  for (size_t k = 0; k < problem->cameras.size(); ++k) {
    auto& camera = problem->cameras[k];
    std::vector<PosePoint> points;
    for (const auto& point : problem->points) {
      for (int i = point.first; i < point.first + point.count; ++i) {
        const auto& o = problem->observations[static_cast<size_t>(i)];
        if (static_cast<size_t>(o.camera) != k) continue;
        PosePoint p;
        p.p_w = point.p.cast<float>();
        p.found = {o.px.cast<float>(), static_cast<uint8_t>(std::lround(-std::log2(o.inverse_sigma)))};
        points.push_back(p);
      }
    }
    VelocityPrior prior;
    prior.mean = camera.velocity_prior.cast<float>();
    prior.sigma_translation = kVelocitySigmaTranslation * problem->depths[k];
    prior.sigma_rotation = kVelocitySigmaRotation;
    const PoseUpdate update = updater.run({camera.now.R.cast<float>(), camera.now.t.cast<float>()}, prior,
                                          PosePoints(problem->camera, points));
    if (update.ok) camera.now.velocity = update.velocity.cast<double>();
  }
}

struct Variant {
  double objective = 0, ate_percent = 0;
  double turn_error = 0;  // rms of the rate of rotation's error, radians/s
};
struct Precision {
  double cost = 0, error = 0;  // relative differences, float to double
};
struct Result {
  std::string name, trouble;
  int keyframes = 0;
  double rejected = 0;  // share of the measurements that Tukey gives no weight without the correction
  Variant none, once, moved, between, free;
  Precision snapshot, uncorrected;
};

class Judge {
 public:
  Judge(const sim::PhoneOptions& phone, const platform::Trajectory& truth, const sim::MotionCurve& curve)
      : readout_s_(std::abs(phone.readout_s)), truth_(truth), curve_(curve) {}

  double ate_percent(const Problem& problem) const {
    platform::Trajectory estimate;
    for (size_t k = 0; k < problem.cameras.size(); ++k) {
      const auto& now = problem.cameras[k].now;
      Isometry3d T_wc = Isometry3d::Identity();
      T_wc.linear() = now.R.transpose();
      T_wc.translation() = -(now.R.transpose() * now.t);
      estimate.push_back({problem.timestamps_ns[k], T_wc});
    }
    std::sort(estimate.begin(), estimate.end(),
              [](const auto& a, const auto& b) { return a.timestamp_ns < b.timestamp_ns; });
    return platform::evaluate(estimate, truth_, "keyframes", "ground truth").ate_percent();
  }
  Variant judge(const Problem& problem, double objective) const {
    double sum = 0;
    for (size_t k = 0; k < problem.cameras.size(); ++k) {
      // The mean rate during the readout.
      const double t_s = 1e-9 * static_cast<double>(problem.timestamps_ns[k]), half_s = 0.5 * readout_s_;
      const Eigen::Matrix3d turn = curve_(t_s + half_s).linear().transpose() * curve_(t_s - half_s).linear();
      const Eigen::AngleAxisd angle(turn);
      const Eigen::Vector3d rate = angle.angle() / readout_s_ * angle.axis();
      sum += (problem.cameras[k].now.velocity.tail<3>() - rate).squaredNorm();
    }
    return {objective, ate_percent(problem), std::sqrt(sum / static_cast<double>(problem.cameras.size()))};
  }

 private:
  double readout_s_;
  const platform::Trajectory& truth_;
  const sim::MotionCurve& curve_;
};

// As the library adjusts a whole map, from what float can hold.
Precision compare(Problem start, double sigma, const Judge& judge) {
  const auto to_float = make_run<float>(start, false);
  take_state(*to_float, &start);
  const bool velocities = start.cameras.size() <= static_cast<size_t>(kVelocityCameras);
  Problem in_float = start, in_double = start;
  adjust<float>(&in_float, velocities, sigma, 1e-5f);
  adjust<double>(&in_double, velocities, sigma, 1e-5f);
  return {std::abs(objective(in_float, velocities, sigma) / objective(in_double, velocities, sigma) - 1),
          std::abs(judge.ate_percent(in_float) / judge.ate_percent(in_double) - 1)};
}

Result study(const sim::PhoneOptions& phone, float shutter_told) {
  Result result;
  const auto scene = std::make_shared<const sim::Scene>(sim::make_scene(phone));
  const auto camera = sim::make_phone_camera(phone, scene);
  const platform::Trajectory truth = camera->ground_truth();
  const sim::Story story = sim::story_of(phone, *scene);
  platform::RunOptions options;
  options.save_map = true;
  const platform::RunLog log = platform::run_sequence(
      *camera, options, [](const platform::CameraInfo&) {}, nullptr);
  if (log.saved_map.empty()) throw std::runtime_error("no map: " + log.save_trouble);
  CameraModel model = log.camera.model;
  model.prepare();
  Config config = Config::phone(model);
  config.camera.shutter = log.camera.shutter;

  const Judge judge(phone, truth, story.curve);
  Problem snapshot = problem_of(log.saved_map, config, shutter_told);
  const double sigma = adjust<double>(&snapshot, true, 0);
  keep_inliers(&snapshot);
  result.keyframes = static_cast<int>(snapshot.cameras.size());

  Problem none = snapshot;
  for (auto& view : none.cameras) view.now.velocity.setZero();
  adjust<double>(&none, false, sigma);
  result.none = judge.judge(none, objective(none, false, sigma));
  const auto rejected =
      std::count_if(none.observations.begin(), none.observations.end(), [](const auto& o) { return o.weight == 0; });
  result.rejected = static_cast<double>(rejected) / static_cast<double>(none.observations.size());

  Problem start = snapshot;
  for (auto& view : start.cameras) view.now.velocity = view.velocity_prior;

  Problem state = start;
  double cost = 0;
  for (int round = 0; round < kRounds; ++round) {
    Problem corrected = moved(state);
    adjust<double>(&corrected, false, sigma);
    cost = objective(corrected, false, sigma);
    state.cameras = corrected.cameras;
    state.points = corrected.points;
    if (round == 0) result.once = judge.judge(state, cost);
  }
  result.moved = judge.judge(state, cost);

  Problem between = start;
  adjust<double>(&between, false, sigma);
  for (int round = 0; round < kRounds; ++round) {
    estimate_velocities(&between);
    adjust<double>(&between, false, sigma);
  }
  result.between = judge.judge(between, objective(between, true, sigma));

  Problem free = start;
  adjust<double>(&free, true, sigma);
  result.free = judge.judge(free, objective(free, true, sigma));

  // Float beside double, from the map as it was and from one that never knew of the shutter.
  for (size_t k = 0; k < none.cameras.size(); ++k) none.cameras[k].now.velocity = start.cameras[k].now.velocity;
  result.snapshot = compare(snapshot, sigma, judge);
  result.uncorrected = compare(none, sigma, judge);
  return result;
}

sim::PhoneOptions phone_for(const std::string& name, uint64_t seed, double duration_s) {
  sim::PhoneOptions phone;
  if (sim::find_story(name)) {
    phone = sim::phone_for_story(name, seed);
  } else {
    phone.scene = name;
    phone.seed = seed;
  }
  phone.duration_s = duration_s;
  sim::check_phone_options(phone);
  return phone;
}

using Value = std::function<double(const Result&)>;
using Results = std::vector<Result>;

std::vector<double> values_of(const Results& results, const Value& value) {
  std::vector<double> values;
  for (const Result& result : results) values.push_back(value(result));
  return values;
}
double median(const Results& results, const Value& value) {
  return platform::percentile(values_of(results, value), 0.5);
}
double worst(const Results& results, const Value& value) {
  return platform::percentile(values_of(results, value), 1);
}
int count(const Results& results, const std::function<bool(const Result&)>& is) {
  return static_cast<int>(std::count_if(results.begin(), results.end(), is));
}

// Of one variant: its objective to that without the correction, or its error.
Value gain(Variant Result::*variant) {
  return [variant](const Result& r) { return (r.*variant).objective / r.none.objective; };
}
Value error(Variant Result::*variant) {
  return [variant](const Result& r) { return (r.*variant).ate_percent; };
}
Value turn(Variant Result::*variant) {
  return [variant](const Result& r) { return (r.*variant).turn_error; };
}

std::vector<std::string> cells(const std::string& name, const Results& results) {
  std::vector<std::string> row = {
      name, platform::format("%d", static_cast<int>(results.size())),
      platform::format("%.0f", median(results, [](const Result& r) { return r.keyframes; })),
      platform::format("%.0f", 100 * median(results, [](const Result& r) { return r.rejected; }))};
  const auto add = [&](const char* form, const Value& value) {
    row.push_back(platform::format(form, median(results, value)) + " (" +
                  platform::format(form, worst(results, value)) + ")");
  };
  using Of = Variant Result::*;
  for (const Of of : {&Result::once, &Result::moved, &Result::between, &Result::free}) add("%.2f", gain(of));
  for (const Of of : {&Result::none, &Result::moved, &Result::between, &Result::free}) add("%.3f", error(of));
  for (const Of of : {&Result::moved, &Result::between, &Result::free})
    row.push_back(platform::format("%.4f", median(results, turn(of))));
  return row;
}

// One map, as soon as it is done; std::printf may be called by several threads.
void print_row(const Result& result) {
  std::string line;
  for (const std::string& cell : cells(result.name, {result})) line += cell.substr(0, cell.find(" (")) + "\t";
  std::printf("%s%.1e\t%.1e\t%.1e\t%.1e\n", line.c_str(), result.snapshot.cost, result.snapshot.error,
              result.uncorrected.cost, result.uncorrected.error);
  std::fflush(stdout);
}

bool report(bool met, const std::string& text) {
  std::printf("%-8s %s\n", met ? "met" : "not met", text.c_str());
  return met;
}

// The goals over all of these maps.
bool judge_goals(const std::vector<std::string>& names, const std::map<std::string, Results>& by_name) {
  using platform::format;
  Results all, general;
  bool gained = true, nearer = true;
  for (const std::string& name : names) {
    const Results& results = by_name.at(name);
    if (results.empty()) continue;
    all.insert(all.end(), results.begin(), results.end());
    if (name == "board") continue;
    general.insert(general.end(), results.begin(), results.end());
    gained = gained && median(results, gain(&Result::moved)) <= 1 - kGoalGain &&
             median(results, gain(&Result::free)) <= 1 - kGoalGain;
    nearer = nearer && median(results, error(&Result::moved)) < median(results, error(&Result::none)) &&
             median(results, error(&Result::free)) < median(results, error(&Result::none));
  }
  if (all.empty()) return report(false, "no map has been made");
  const int maps = static_cast<int>(all.size());
  bool met = true;
  const std::pair<Precision Result::*, const char*> starts[] = {{&Result::snapshot, "as it was"},
                                                                {&Result::uncorrected, "adjusted without a shutter"}};
  for (const auto& [start, says] : starts) {
    const Value cost = [member = start](const Result& r) { return (r.*member).cost; };
    const Value other = [member = start](const Result& r) { return (r.*member).error; };
    const int right = count(all, [&](const Result& r) { return cost(r) <= kGoalCost && other(r) <= kGoalError; });
    met =
        report(right == maps,
               format("float beside double, begun at the map %s: cost within 0.1 %% and error within 2 %% in %d of %d "
                      "maps; cost differs by %.4f %%, median (worst %.4f), error by %.3f %% (%.3f)",
                      says, right, maps, 100 * median(all, cost), 100 * worst(all, cost), 100 * median(all, other),
                      100 * worst(all, other))) &&
        met;
  }
  if (general.empty()) return met;
  const int maps_general = static_cast<int>(general.size());
  met = report(gained, format("the correction lowers the objective by at least 10 %% in the median of each general "
                              "story; over all by %.0f %% (worst map %.0f) moved, %.0f %% (%.0f) free",
                              100 - 100 * median(general, gain(&Result::moved)),
                              100 - 100 * worst(general, gain(&Result::moved)),
                              100 - 100 * median(general, gain(&Result::free)),
                              100 - 100 * worst(general, gain(&Result::free)))) &&
        met;
  met =
      report(nearer, format("the error falls in the median of each general story; in %d of %d maps moved, %d free",
                            count(general, [](const Result& r) { return r.moved.ate_percent < r.none.ate_percent; }),
                            maps_general,
                            count(general, [](const Result& r) { return r.free.ate_percent < r.none.ate_percent; }))) &&
      met;
  const auto rival = [&](Variant Result::*of, const char* name) {
    std::printf(
        "         free against %s: error smaller in %d of %d maps, median of the ratios %.3f; rate of rotation "
        "nearer in %d, median of the ratios %.3f\n",
        name, count(general, [of](const Result& r) { return r.free.ate_percent < (r.*of).ate_percent; }), maps_general,
        median(general, [of](const Result& r) { return r.free.ate_percent / (r.*of).ate_percent; }),
        count(general, [of](const Result& r) { return r.free.turn_error < (r.*of).turn_error; }),
        median(general, [of](const Result& r) { return r.free.turn_error / (r.*of).turn_error; }));
  };
  rival(&Result::moved, "moved");
  rival(&Result::between, "between");
  return met;
}

}  // namespace
}  // namespace pptam::test

int main(int argc, char** argv) {
  using namespace pptam;
  using namespace pptam::test;
  CLI::App cli("Bundle adjustment of emulated maps: float beside double, and the rolling shutter's correction");
  std::vector<std::string> names = {"desk_calm", "boxes", "orbit", "explore_return", "two_walls", "board"};
  int seeds = 20, jobs = 1;
  double duration_s = 20;
  float shutter_told = 1;
  bool check = false, verbose = false;
  cli.add_option("--story", names, "stories, or scenes with the calm motion; may be repeated")->capture_default_str();
  cli.add_option("--seeds", seeds, "of each, from 1")->check(CLI::Range(1, 1000))->capture_default_str();
  cli.add_option("--duration", duration_s, "seconds")->check(CLI::Range(3.0, 60.0))->capture_default_str();
  cli.add_option("--jobs", jobs, "threads")->check(CLI::Range(1, 64))->capture_default_str();
  cli.add_option("--shutter-told", shutter_told,
                 "line time that adjustment believes, as a factor of the truth: others show that goals can be missed")
      ->capture_default_str();
  cli.add_flag("--check", check, "exit code 1 if a goal is missed or a run broke");
  cli.add_flag("--verbose", verbose,
               "a line for every map as soon as it is done: the columns of the table, then the differences "
               "of float from double");
  CLI11_PARSE(cli, argc, argv);

  try {
    std::vector<sim::PhoneOptions> phones;
    for (const std::string& name : names)
      for (int seed = 1; seed <= seeds; ++seed)
        phones.push_back(phone_for(name, static_cast<uint64_t>(seed), duration_s));
    Results results(phones.size());
    platform::run_jobs(jobs, phones.size(), [&](size_t i) {
      try {
        results[i] = study(phones[i], shutter_told);
      } catch (const std::exception& problem) {
        results[i].trouble = problem.what();
      }
      results[i].name = names[i / static_cast<size_t>(seeds)] + " " + std::to_string(phones[i].seed);
      if (verbose && results[i].trouble.empty()) print_row(results[i]);
      return results[i].name;
    });
    bool met = true;
    std::map<std::string, Results> by_name;
    std::vector<std::vector<std::string>> rows;
    for (size_t n = 0; n < names.size(); ++n) {
      Results& group = by_name[names[n]];
      for (size_t i = n * static_cast<size_t>(seeds); i < (n + 1) * static_cast<size_t>(seeds); ++i) {
        if (results[i].trouble.empty()) {
          group.push_back(results[i]);
        } else {
          met = false;
          std::printf("%s: %s\n", results[i].name.c_str(), results[i].trouble.c_str());
        }
      }
      if (!group.empty()) rows.push_back(cells(names[n], group));
    }
    platform::print_table({"story", "maps", "keyfr.", "out %", "| once", "moved", "between", "free", "| none %",
                           "moved", "between", "free", "| moved", "between", "free"},
                          rows);
    std::printf(
        "\nMedian (worst). First: objective, of that without the correction; out: share of the measurements that are "
        "then outliers.\nThen: error of the keyframes, of the path. Last: error of the rate of rotation, "
        "radians/s.\n\n");
    met = judge_goals(names, by_name) && met;
    return check && !met ? 1 : 0;
  } catch (const std::exception& problem) {
    std::fprintf(stderr, "error: %s; nothing was run\n", problem.what());
    return 2;
  }
}
