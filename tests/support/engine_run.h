// Runs the bundle adjustment engine by itself, in float or double: memory, meter and scheduler of its own.
#pragma once

#include <cstddef>
#include <ctime>
#include <memory>
#include <span>
#include <vector>

#include "camera/pose_update.h"
#include "mapping/bundle_engine.h"
#include "tests/support/alignment.h"
#include "tests/support/bundle_problem.h"

namespace pptam::test {

// A camera without distortion: that of BundleProblem unless told otherwise.
template <class Scalar>
struct Pinhole {
  Scalar focal_px = Scalar(BundleProblem::kFocal_px);
  Scalar centre_x_px = Scalar(BundleProblem::kCentreX_px), centre_y_px = Scalar(BundleProblem::kCentreY_px);

  using Vector2 = Eigen::Matrix<Scalar, 2, 1>;
  using Vector3 = Eigen::Matrix<Scalar, 3, 1>;
  using Matrix23 = Eigen::Matrix<Scalar, 2, 3>;
  bool project(int, const Vector3& p, Vector2* px) const {
    if (!(p[2] > 0)) return false;
    const Scalar f = focal_px / p[2];
    *px = {f * p[0] + centre_x_px, f * p[1] + centre_y_px};
    return true;
  }
  bool project(int camera, const Vector3& p, Vector2* px, Matrix23* J) const {
    if (!project(camera, p, px)) return false;
    const Scalar f = focal_px / p[2];
    *J << f, 0, -f * p[0] / p[2], 0, f, -f * p[1] / p[2];
    return true;
  }
};

template <class Scalar, class Projection>
class EngineRun : public Background {
 public:
  using Engine = BundleEngine<Scalar, Projection>;

  EngineRun(const BundleCapacity& capacity, const Projection& projection)
      : EngineRun(capacity, projection, std::make_unique<Memory>(required(capacity, projection))) {}

  Engine& engine() { return engine_; }
  WorkMeter& meter() { return memory_->meter; }

  // Up to so many accepted steps; in between the job pauses as the meter says, and `pauses` is called.
  template <class Pauses>
  void run(const BundleOptions& options, int iterations, Pauses pauses) {
    iterations_ = 0;
    done_ = converged_ = false;
    task_ = work(options, iterations);
    task_.start();
    while (!done_) {
      pauses();
      resume();
    }
  }
  void run(const BundleOptions& options, int iterations) {
    run(options, iterations, [] {});
  }
  int iterations() const { return iterations_; }
  int attempts() const { return attempts_; }
  bool converged() const { return converged_; }
  double seconds() const { return seconds_; }        // of the processor, in all attempts
  double start_cost() const { return start_cost_; }  // at the first step's scale

 private:
  struct Memory {
    explicit Memory(size_t bytes) : block(bytes / sizeof(std::max_align_t) + 1) {
      PhoneProfile free;  // nothing costs anything: no pauses
      free.instructions.fill(0);
      meter.set_profile(free);
      arena = Arena(std::as_writable_bytes(std::span(block)));
    }
    WorkMeter meter;
    std::vector<std::max_align_t> block;
    Arena arena;
  };
  static constexpr size_t kFrames = 8192;
  static size_t required(const BundleCapacity& capacity, const Projection& projection) {
    Memory nothing(0);
    Arena measure;
    EngineRun run(capacity, projection, nothing, measure);
    return measure.used();
  }
  EngineRun(const BundleCapacity& capacity, const Projection& projection, Memory& memory, Arena& arena)
      : Background(arena, kFrames, memory.meter), engine_(arena, capacity, projection, memory.meter, *this) {}
  EngineRun(const BundleCapacity& capacity, const Projection& projection, std::unique_ptr<Memory> memory)
      : EngineRun(capacity, projection, *memory, memory->arena) {
    memory_ = std::move(memory);
  }

  Task<> work(BundleOptions options, int iterations) {
    co_await engine_.start(options);
    const double begin_s = cpu_seconds();
    for (attempts_ = 0; iterations_ < iterations && !converged_; ++attempts_) {
      co_await engine_.linearise();
      if (attempts_ == 0) start_cost_ = static_cast<double>(engine_.cost());
      co_await engine_.attempt();
      const BundleOutcome outcome = engine_.outcome();
      converged_ = outcome == BundleOutcome::kConverged || outcome == BundleOutcome::kExhausted;
      iterations_ += outcome == BundleOutcome::kConverged || outcome == BundleOutcome::kAccepted;
    }
    seconds_ = cpu_seconds() - begin_s;
    done_ = true;
  }
  static double cpu_seconds() {
    timespec now;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
    return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
  }

  std::unique_ptr<Memory> memory_;
  Engine engine_;
  Task<> task_;
  int iterations_ = 0, attempts_ = 0;
  double start_cost_ = 0, seconds_ = 0;
  bool done_ = false, converged_ = false;
};

// The problem at its start; the velocities are unknowns if asked for, with the priors' sigmas of the library.
template <class Scalar>
std::unique_ptr<EngineRun<Scalar, Pinhole<Scalar>>> make_engine(const BundleProblem& problem, bool velocities) {
  BundleCapacity capacity;
  capacity.cameras = static_cast<int>(problem.start.size());
  capacity.points = static_cast<int>(problem.points.size());
  for (const BundleProblem::Point& point : problem.points) {
    const int count = static_cast<int>(point.observations.size());
    capacity.observations += count;
    capacity.observations_per_point = std::max(capacity.observations_per_point, count);
  }
  capacity.columns = 2 * capacity.cameras;
  auto run = std::make_unique<EngineRun<Scalar, Pinhole<Scalar>>>(capacity, Pinhole<Scalar>());
  auto& engine = run->engine();
  using Engine = std::remove_reference_t<decltype(engine)>;
  for (const BundleProblem::View& view : problem.start) {
    typename Engine::Camera camera;
    // What float holds, in double too: both start at the same state.
    camera.now = {view.R.template cast<float>().template cast<Scalar>(),
                  view.t.template cast<float>().template cast<Scalar>(),
                  view.velocity.template cast<float>().template cast<Scalar>()};
    camera.velocity_prior = camera.now.velocity;
    for (int i = 0; i < 6; ++i) {
      const Scalar sigma(i < 3 ? kVelocitySigmaTranslation : kVelocitySigmaRotation);
      camera.prior_information[i] = 1 / (sigma * sigma);
    }
    camera.pose_free = engine.cameras().size() > 0;
    camera.velocity_free = velocities;
    engine.cameras().push_back(camera);
  }
  for (const BundleProblem::Point& from : problem.points) {
    typename Engine::Point point;
    point.first = engine.observations().size();
    point.count = static_cast<int>(from.observations.size());
    point.p = from.start.template cast<float>().template cast<Scalar>();
    engine.points().push_back(point);
    for (const BundleProblem::Observation& o : from.observations) {
      typename Engine::Observation observation;
      observation.px = o.px.template cast<Scalar>();
      observation.inverse_sigma = Scalar(1 / BundleProblem::kSigma_px);
      observation.dt_s = Scalar(static_cast<float>(o.dt_s));
      observation.camera = static_cast<int16_t>(o.view);
      engine.observations().push_back(observation);
    }
  }
  engine.assign_columns();
  return run;
}

// The objective of an engine's state at scale sigma, in double whatever the engine computes with.
template <class Engine>
double cost_in_double(Engine& engine, double sigma, const Pinhole<double>& projection = {}) {
  const double cutoff_sq = std::pow(static_cast<double>(kTukeyCutoff) * sigma, 2);
  double sum = 0;
  for (const auto& camera : engine.cameras()) {
    if (!camera.velocity_free) continue;
    const auto change = (camera.now.velocity - camera.velocity_prior).template cast<double>();
    sum += 0.5 * sigma * sigma * change.cwiseAbs2().dot(camera.prior_information.template cast<double>());
  }
  for (const auto& point : engine.points()) {
    for (int k = point.first; k < point.first + point.count; ++k) {
      const auto& o = engine.observations()[k];
      const auto& camera = engine.cameras()[o.camera].now;
      const Eigen::Vector3d q =
          camera.R.template cast<double>() * point.p.template cast<double>() + camera.t.template cast<double>();
      const Eigen::Matrix<double, 6, 1> v = camera.velocity.template cast<double>();
      const Eigen::Vector3d p = q + static_cast<double>(o.dt_s) * (v.head<3>() + v.tail<3>().cross(q));
      Eigen::Vector2d px;
      double s = cutoff_sq;
      if (projection.project(0, p, &px))
        s = std::min(s, ((o.px.template cast<double>() - px) * static_cast<double>(o.inverse_sigma)).squaredNorm());
      sum += cutoff_sq / 6 * (1 - std::pow(1 - s / cutoff_sq, 3));
    }
  }
  return sum;
}

// Root mean square distance of the cameras' centres from the truth after the best similarity, world units.
template <class Engine>
double trajectory_error(Engine& engine, const BundleProblem& problem) {
  std::vector<Eigen::Vector3d> estimate, truth;
  for (size_t k = 0; k < problem.truth.size(); ++k) {
    const auto& camera = engine.cameras()[static_cast<int>(k)].now;
    estimate.emplace_back(-(camera.R.template cast<double>().transpose() * camera.t.template cast<double>()));
    truth.push_back(problem.truth[k].centre());
  }
  return distance_after_similarity(estimate, truth);
}

}  // namespace pptam::test
