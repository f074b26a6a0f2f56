#include "sim_phone/laboratory/model_study.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <functional>
#include <memory>
#include <utility>

#include "platform/input_error.h"
#include "platform/model/model_file.h"
#include "platform/run/console.h"
#include "platform/run/interruption.h"
#include "platform/run/jobs.h"
#include "platform/text.h"
#include "sim_phone/laboratory/keeping_camera.h"
#include "sim_phone/model_stories.h"
#include "sim_phone/phone_camera.h"
#include "sim_phone/random.h"

namespace pptam::laboratory {
namespace {

using namespace platform;

constexpr double kKept_px = 10, kWrong_px = 20;

// What is done to the pictures before they are tracked.
struct Pictures {
  const char* name;
  int every;        // of so many frames one
  double contrast;  // about grey 100; under 1 with new noise of 2 grey values
};

class ModelRunJudge {
 public:
  ModelRunJudge(platform::Camera& camera, const std::string& model, const ModelMethod& method)
      : camera_(camera),
        truth_(camera.ground_truth()),
        model_(model_of(model, camera.info().name)),
        view_(model_.view()) {
    ModelTrackerConfig config;
    config.camera.model = camera.info().model;
    config.camera.shutter = camera.info().shutter;
    config.model = view_;
    config.method = method;
    lens_ = config.camera.model;
    lens_.prepare();
    memory_.resize(ModelTracker::required_bytes(config) / sizeof(std::max_align_t) + 1);
    const Status status = ModelTracker::create(config, std::as_writable_bytes(std::span(memory_)), &tracker_);
    if (!status.ok()) throw InputError(camera.info().name + ": " + status.message());
    if (!truth_.empty()) started_ = tracker_->start(pose_of(truth_.front()));
    if (!started_.ok()) throw InputError(camera.info().name + ": " + started_.message());
  }

  ModelJudgement run(const Pictures& pictures) {
    Frame frame;
    for (size_t i = 0; camera_.read(&frame) && i < truth_.size(); ++i) {
      if (i % static_cast<size_t>(pictures.every) != 0) continue;
      if (pictures.contrast < 1) weaken(pictures.contrast, i, &frame);
      add(tracker_->track(frame), pose_of(truth_[i]));
    }
    if (judged_.tracked > 0) {
      judged_.mean_px /= judged_.tracked;
      judged_.mean_degrees /= judged_.tracked;
    }
    return judged_;
  }

 private:
  static SE3 pose_of(const StampedPose& pose) {
    const Eigen::Isometry3d T_cw = pose.T_wc.inverse();
    return {orthonormalised(Matrix3f(T_cw.linear().cast<float>())), Vector3f(T_cw.translation().cast<float>())};
  }
  void weaken(double contrast, size_t index, Frame* frame) {
    sim::Random random(1, index);
    picture_.resize(static_cast<size_t>(frame->width) * static_cast<size_t>(frame->height));
    for (size_t i = 0; i < picture_.size(); ++i) {
      double noise = -4;  // the sum of eight, each evenly within 1: of sigma 0.82; times 2.45
      uint64_t bits = random.bits();
      for (int k = 0; k < 8; ++k, bits >>= 8) noise += static_cast<double>(bits & 255) / 255;
      const double grey = 100 + contrast * (frame->data[i] - 100.0) + 2.45 * noise;
      picture_[i] = static_cast<uint8_t>(std::clamp(std::lround(grey), 0L, 255L));
    }
    frame->data = picture_.data();
  }
  double error_of(const SE3& T, const SE3& truth) const {
    double sum = 0;
    for (const Vector3f& p : model_.points) {
      Vector2f a, b;
      if (!lens_.project(T * p, &a) || !lens_.project(truth * p, &b)) return 1e3;
      sum += static_cast<double>((a - b).norm());
    }
    return sum / static_cast<double>(model_.points.size());
  }
  void add(const ModelResult& result, const SE3& truth) {
    const double error = result.pose_valid ? error_of(result.T_co, truth) : 1e3;
    const bool kept = error < kKept_px;
    if (!kept && judged_.first_bad < 0) judged_.first_bad = judged_.frames;
    ++judged_.frames;
    judged_.kept += kept ? 1 : 0;
    judged_.to_the_end = kept;
    if (!result.pose_valid) return;
    ++judged_.tracked;
    judged_.wrong += error > kWrong_px ? 1 : 0;
    judged_.mean_px += error;
    judged_.worst_px = std::max(judged_.worst_px, error);
    judged_.mean_degrees += static_cast<double>(so3_log(result.T_co.R * truth.R.transpose()).norm()) * 180 / 3.14159265;
  }

  platform::Camera& camera_;
  const Trajectory truth_;
  const ModelFile model_;
  const ObjectModel view_;
  CameraModel lens_;
  std::vector<std::max_align_t> memory_;
  std::vector<uint8_t> picture_;
  ModelTracker* tracker_ = nullptr;
  Status started_;
  ModelJudgement judged_;
};

const std::vector<Pictures> kPictures = {{"as they are", 1, 1}, {"contrast 1/4", 1, 0.25}, {"every 3rd", 3, 1}};
enum PicturesIndex : size_t { kAsTheyAre, kWeakContrast, kEveryThird };

struct Way {
  const char* name;
  ModelMethod method;
};
std::vector<Way> ways() {
  std::vector<Way> all = {
      {"as it is", {}}, {"threshold", {}}, {"no weights", {}}, {"scale once", {}}, {"constant", {}}};
  all[1].method.likelihood_threshold = 0.5f;
  all[2].method.no_weights = true;
  all[3].method.scale_once = true;
  all[4].method.constant_jacobian = true;
  return all;
}
enum WayIndex : size_t { kUsual, kThreshold, kNoWeights, kScaleOnce, kConstant, kWays };

// All that one seed of a story gives, by pictures and way.
using StoryRuns = std::vector<std::vector<ModelJudgement>>;

StoryRuns run_ways(const std::string& story, uint64_t seed) {
  const sim::PhoneOptions phone = sim::phone_for_model_story(story, seed);
  const auto scene = std::make_shared<const sim::Scene>(sim::make_scene(phone));
  KeepingCamera camera(sim::make_phone_camera(phone, scene));
  StoryRuns runs(kPictures.size());
  for (size_t p = 0; p < kPictures.size(); ++p) {
    for (const Way& way : ways()) {
      camera.again();
      runs[p].push_back(ModelRunJudge(camera, scene->model, way.method).run(kPictures[p]));
    }
  }
  return runs;
}

// Kept, in percent of the frames, and the mean error of what is tracked; over a story's seeds.
std::string kept_and_error(const std::vector<StoryRuns>& seeds, size_t pictures, size_t way) {
  double kept = 0, frames = 0, error = 0, tracked = 0;
  for (const StoryRuns& runs : seeds) {
    const ModelJudgement& j = runs[pictures][way];
    kept += j.kept;
    frames += j.frames;
    error += j.mean_px * j.tracked;
    tracked += j.tracked;
  }
  return format("%.0f %% %.2f px", 100 * kept / std::max(frames, 1.0), error / std::max(tracked, 1.0));
}

std::string first_bad_frames(const std::vector<StoryRuns>& seeds, size_t way) {
  std::string text;
  for (const StoryRuns& runs : seeds) {
    const int first = runs[kAsTheyAre][way].first_bad;
    text += (text.empty() ? "" : ", ") + (first < 0 ? std::string("-") : std::to_string(first));
  }
  return text;
}

}  // namespace

ModelJudgement judge_model_run(platform::Camera& camera, const std::string& model, const ModelMethod& method) {
  return ModelRunJudge(camera, model, method).run(kPictures[kAsTheyAre]);
}

std::vector<SummaryRow> summarise(const ModelJudgement& j) {
  std::vector<SummaryRow> rows;
  rows.push_back({"frames", format("%d, with a pose %d, within 10 px %d%s", j.frames, j.tracked, j.kept,
                                   j.to_the_end ? ", tracked to the end" : "; not tracked to the end")});
  rows.push_back(
      {"error", format("%.2f px mean, %.2f px at most, %.2f degrees", j.mean_px, j.worst_px, j.mean_degrees)});
  rows.push_back({"wrong poses", format("%d of %d, off by over 20 px", j.wrong, j.tracked)});
  return rows;
}

bool run_model_study(const ModelStudyOptions& options) {
  std::vector<std::string> stories = options.stories;
  if (stories.empty())
    for (const sim::ModelStory& story : sim::model_stories()) stories.push_back(story.name);
  for (const std::string& story : stories)
    if (!sim::is_model_story(story)) throw InputError("--study model: --story " + story + " is not of a known object");
  const auto seeds = static_cast<size_t>(options.seeds);
  stop_on_signals();
  std::vector<StoryRuns> all(stories.size() * seeds);
  const std::vector<bool> done = run_jobs(options.jobs, all.size(), [&](size_t i) {
    all[i] = run_ways(stories[i / seeds], 1 + i % seeds);
    return stories[i / seeds] + ", seed " + std::to_string(1 + i % seeds);
  });
  bool good = std::all_of(done.begin(), done.end(), [](bool finished) { return finished; });
  using Cells = std::function<std::vector<std::string>(const std::vector<StoryRuns>&)>;
  const auto table = [&](const char* title, const std::vector<std::string>& heads, const Cells& cells) {
    std::vector<std::vector<std::string>> rows;
    for (size_t s = 0; s < stories.size(); ++s) {
      std::vector<StoryRuns> runs;
      for (size_t i = s * seeds; i < (s + 1) * seeds; ++i)
        if (done[i]) runs.push_back(all[i]);
      std::vector<std::string> row = {stories[s]};
      for (std::string& cell : cells(runs)) row.push_back(std::move(cell));
      rows.push_back(row);
    }
    print_line(title);
    print_table(heads, rows);
    print_line("");
  };
  table("As it is, by the truth; the first frame that is not kept, of each seed:",
        {"story", "as it is", "no weights", "first bad", "first bad, no weights"}, [](const auto& runs) {
          return std::vector<std::string>{kept_and_error(runs, kAsTheyAre, kUsual),
                                          kept_and_error(runs, kAsTheyAre, kNoWeights), first_bad_frames(runs, kUsual),
                                          first_bad_frames(runs, kNoWeights)};
        });
  table("Weights by eq. 24, and by a threshold of 0.5 on the likelihood:",
        {"story", "eq. 24", "threshold", "eq. 24, contrast 1/4", "threshold, contrast 1/4"}, [](const auto& runs) {
          return std::vector<std::string>{
              kept_and_error(runs, kAsTheyAre, kUsual), kept_and_error(runs, kAsTheyAre, kThreshold),
              kept_and_error(runs, kWeakContrast, kUsual), kept_and_error(runs, kWeakContrast, kThreshold)};
        });
  const auto compared = [](size_t way) {
    return [way](const std::vector<StoryRuns>& runs) {
      return std::vector<std::string>{kept_and_error(runs, kAsTheyAre, kUsual), kept_and_error(runs, kAsTheyAre, way),
                                      kept_and_error(runs, kEveryThird, kUsual),
                                      kept_and_error(runs, kEveryThird, way)};
    };
  };
  table("The robust scale in each iteration, and once; every frame, and every third:",
        {"story", "each", "once", "each, 3rd", "once, 3rd"}, compared(kScaleOnce));
  table("The full Jacobian, and a constant one (eq. 10, 11); every frame, and every third:",
        {"story", "full", "constant", "full, 3rd", "constant, 3rd"}, compared(kConstant));
  for (size_t i = 0; i < all.size(); ++i) {
    if (!done[i] || all[i][kAsTheyAre][kUsual].to_the_end) continue;
    print_error(stories[i / seeds] + ", seed " + std::to_string(1 + i % seeds) + ": is not tracked to the end");
    good = false;
  }
  return good;
}

}  // namespace pptam::laboratory
