#include <algorithm>
#include <cmath>
#include <new>

#include <pocket_ptam/model_tracker.h>
#include "base/containers.h"
#include "camera/full_frame_rotation.h"
#include "camera/motion_model.h"
#include "camera/small_image.h"
#include "edges/edge_matching.h"
#include "edges/object_search.h"
#include "edges/point_pose.h"

namespace pptam {

namespace {

// Reach of a search along the normal, pixels of its level: in the coarsest level, and near a prediction. Not swept.
constexpr int kFirstRange = 8, kNearRange = 5;
// Quality under which a frame is weak, and above which a pose is believed that was lost, shares of what is usual.
constexpr float kWeak = 0.3f, kBelieved = 0.55f;
constexpr int kWeakFrames = 3;          // in a row: lost
constexpr float kStartQuality = 0.25f;  // of a start: half of the contours have an edge, whatever it looks like
constexpr float kFoundQuality = 0.65f;  // the same of a pose that nothing was known of. Not swept
constexpr float kUsual = 0.7f;          // quality of a good frame, before there was one
// Share of a frame in what is usual: of better ones, and of worse ones, because what hides an object is not usual.
constexpr float kAdopt = 0.3f, kDecline = 0.002f;
constexpr float kTypical = 0.05f;  // share of a good frame in their mean quality
constexpr float kRecent = 0.3f;    // share of a frame in the last frames' quality
// Shares of the last frames' quality and of the usual one under which a wider search is made.
constexpr float kDoubted = 0.85f, kPoor = 0.5f;
// Share of the usual quality from which on the pose is certain enough to learn by. With 0.75 too little is learnt.
constexpr float kLearning = 0.65f;
constexpr float kBetter = 1.1f;  // by how much the quality of another hypothesis must be better, ratio
// 1-sigma of the prior near a prediction: that many times the rms error of the last predictions, at least that many
// pixels in the image; 2 pixels hold the pose back in quick motion.
constexpr float kPriorErrors = 3, kPriorLeast_px = 5;
// While the last frames' quality is under that share of the usual one much is hidden, and the prior is once the error
// and so many pixels: few edges are left to hold the pose against those of what hides the object.
constexpr float kHidden = 0.5f, kPriorHidden_px = 1;
constexpr float kErrorBlend = 0.1f;  // share of the newest error in their mean square
// Turns tried in a search for the object: by nothing or so much about each axis, radians.
constexpr float kStartTurn = 0.18f;
constexpr int kTurns = 27;
constexpr int kTurnShares = 3;  // after a loss they are tried in as many frames
constexpr int kViews = 16;      // kept for a restart
// A view is new when the object has turned or moved by so much, radians and shares of its distance.
constexpr float kNewTurn = 0.1f, kNewShift = 0.1f;
constexpr float kPointError_px = 20;  // of a start from points
constexpr float kNearest = 0.1f;      // least distance of the object's middle, shares of its extent

Status bad_call(const char* message) {
  return {StatusCode::kInvalidArgument, message};
}

bool finite_vector(const Vector3f& v) {
  constexpr float kMost = 1e6f;
  return std::abs(v.x()) <= kMost && std::abs(v.y()) <= kMost && std::abs(v.z()) <= kMost;
}

// Poses from which the object is sought coarsely; the best few are refined.
class PoseSearch {
 public:
  explicit PoseSearch(EdgeMatching& matching) : matching_(matching) {}
  void add(const SE3& T_start) {
    SE3 T = T_start;
    for (int pass = 0; pass < 2; ++pass) {
      const ServoingResult fitted = matching_.fit(T, matching_.coarsest(), kFirstRange);
      if (fitted.ok) T = fitted.T_co;
    }
    const float quality = matching_.evidence(T, finer_level());
    int place = count_;
    while (place > 0 && kept_[place - 1].quality < quality) --place;
    if (place >= kKept) return;
    count_ = std::min(count_ + 1, kKept);
    for (int k = count_ - 1; k > place; --k) kept_[k] = kept_[k - 1];
    kept_[place] = {T, quality};
  }
  // Turn i of kTurns about the object's middle.
  void add_turned(const SE3& T, int i) {
    const int x = i % 3 - 1, y = i / 3 % 3 - 1, z = i / 9 - 1;
    const Vector3f turn(static_cast<float>(x), static_cast<float>(y), static_cast<float>(z));
    const float axes = std::max(1.0f, turn.squaredNorm());
    const Matrix3f R = so3_exp(turn * (kStartTurn / std::sqrt(std::sqrt(axes))));
    const Vector3f c = T * matching_.parts().middle();
    add(SE3(orthonormalised(R * T.R), R * (T.t - c) + c));
  }
  // The best of them, or what is known already. own_priors: each is refined about itself, where they have nothing in
  // common; otherwise by the prior that is set.
  Hypothesis best(const Hypothesis& known, bool own_priors = false) {
    Hypothesis best;
    for (int i = 0; i < count_; ++i) {
      if (own_priors) matching_.set_prior({kept_[i].T});
      Hypothesis tried = matching_.refine(kept_[i].T, matching_.coarsest(), kNearRange);
      tried = matching_.refine(tried.T_co, finer_level(), kNearRange);
      if (tried.fit.ok && tried.quality > best.quality) best = tried;
    }
    return best.quality > known.quality ? best : known;
  }

 private:
  static constexpr int kKept = 5;
  struct Kept {
    SE3 T;
    float quality;
  };
  int finer_level() const { return std::max(matching_.coarsest() - 1, matching_.finest()); }

  EdgeMatching& matching_;
  Kept kept_[kKept];
  int count_ = 0;
};

}  // namespace

struct ModelTracker::Impl {
  struct View {  // of a frame that was tracked well
    GreyImage small;
    SE3 T;
  };

  Impl(Arena& arena, const ModelTrackerConfig& configuration);

  ModelResult track(const Frame& frame);
  Status check(const Frame& frame) const;
  void forget();
  Hypothesis start_anew();
  Hypothesis start_anywhere();
  Hypothesis track_on(float dt_s);
  Hypothesis follow();
  Hypothesis restart();
  void begin_at(const SE3& T);
  void conclude(Hypothesis* found, ModelResult* result);
  void keep_view(const SE3& T);
  int nearest_view() const;

  const ModelParts& parts() const { return matching.parts(); }
  float distance(const SE3& T) const { return std::max((T * parts().middle()).z(), kNearest * parts().extent()); }
  float doubted() const { return std::max(kDoubted * recent_quality, kPoor * usual_quality); }
  PosePrior prior_near(const SE3& T) const;
  void note_error(const SE3& T_predicted, const SE3& T);

  ModelTrackerConfig config;
  EdgeMatching matching;
  ObjectSearch object_search;
  FullFrameRotation rotation;
  MotionModel motion;  // its world is the object

  // The frame.
  GreyImage grey;
  PyramidStorage storage;
  GreyImage small, previous_small;
  int64_t last_timestamp_ns = INT64_MIN;

  ModelState state = ModelState::kWaiting;
  bool starting = false, anywhere = false;  // at T_start, or there
  SE3 T_start;
  float usual_quality = kUsual, recent_quality = kUsual;  // of good frames, nearly their best; of the last ones
  float typical_quality = kUsual;                         // of good frames, their mean
  float turn_error_sq = 0, shift_error_sq = 0;            // of predictions, mean squares by component
  int weak_frames = 0;                                    // in a row
  int lost_frames = 0;                                    // since the loss, modulo 2 kTurnShares
  SE3 T_good;                                             // last good pose
  SE3 T_carried;                                          // the same with the camera's turns since the loss
  FixedVector<View> views;
  int views_used = 0, next_view = 0;
};

ModelTracker::Impl::Impl(Arena& arena, const ModelTrackerConfig& configuration)
    : config(configuration),
      matching(arena, config),
      object_search(arena, config.camera, matching.parts()),
      rotation(arena, config.camera),
      views(arena, kViews) {
  const int width = config.camera.model.width, height = config.camera.model.height;
  const auto image = [&](int level) {
    GreyImage made;
    made.width = made.stride = width >> level;
    made.height = height >> level;
    made.data = arena.allocate_array<uint8_t>(static_cast<size_t>(made.stride) * static_cast<size_t>(made.height));
    return made;
  };
  grey = image(0);
  storage = PyramidStorage(arena, width, height, 1);
  small = small_image_storage(arena, width, height);
  previous_small = small_image_storage(arena, width, height);
  for (int i = 0; i < kViews; ++i) {
    View view;
    view.small = small_image_storage(arena, width, height);
    views.push_back(view);
  }
}

PosePrior ModelTracker::Impl::prior_near(const SE3& T) const {
  const float focal = 0.5f * (config.camera.model.fx + config.camera.model.fy);
  const bool hidden = recent_quality < kHidden * usual_quality;
  const float least_px = hidden ? kPriorHidden_px : kPriorLeast_px, errors = hidden ? 1 : kPriorErrors;
  const float turn = std::max(errors * std::sqrt(turn_error_sq), least_px * distance(T) / (focal * parts().extent()));
  const float shift = std::max(errors * std::sqrt(shift_error_sq), least_px / focal);
  return {T, std::min(turn, PosePrior::kFree), std::min(shift, PosePrior::kFree)};
}

void ModelTracker::Impl::note_error(const SE3& T_predicted, const SE3& T) {
  const float depth = distance(T);
  const float turn_sq = so3_log(T.R * T_predicted.R.transpose()).squaredNorm() / 3;
  const float shift_sq = (T * parts().middle() - T_predicted * parts().middle()).squaredNorm() / (3 * depth * depth);
  turn_error_sq += kErrorBlend * (turn_sq - turn_error_sq);
  shift_error_sq += kErrorBlend * (shift_sq - shift_error_sq);
}

void ModelTracker::Impl::begin_at(const SE3& T) {
  motion.forget();
  motion.start(T, Vector6f::Zero(), distance(T));
  state = ModelState::kTracking;
  weak_frames = 0;
}

void ModelTracker::Impl::forget() {
  matching.forget();
  views_used = next_view = 0;
  usual_quality = recent_quality = typical_quality = kUsual;
  turn_error_sq = shift_error_sq = 0;
  lost_frames = 0;
  state = ModelState::kLost;
}

Hypothesis ModelTracker::Impl::start_anew() {
  forget();
  matching.set_prior({T_start});
  Hypothesis found;
  // A blurred image shows its edges in coarser levels only.
  for (int finest = 0; finest <= matching.coarsest() && !(found.quality >= kStartQuality); ++finest) {
    matching.set_finest(finest);
    const Hypothesis as_told = matching.refine(T_start, std::min(finest + 1, matching.coarsest()), kNearRange);
    PoseSearch search(matching);
    for (int i = 0; i < kTurns; ++i) search.add_turned(T_start, i);
    found = search.best(as_told);
  }
  found.fit.ok = found.fit.ok && found.quality >= kStartQuality;
  if (!found.fit.ok) matching.set_finest(0);
  T_good = T_carried = T_start;
  if (found.fit.ok) begin_at(found.T_co);
  return found;
}

Hypothesis ModelTracker::Impl::start_anywhere() {
  forget();
  PoseSearch search(matching);
  for (const SE3& T : matching.propose(object_search)) {
    matching.set_prior({T});
    search.add(T);
  }
  Hypothesis found = search.best({}, true);
  found.fit.ok = found.fit.ok && found.quality >= kFoundQuality;
  matching.set_prior({found.T_co});
  if (found.fit.ok) begin_at(found.T_co);
  return found;
}

Hypothesis ModelTracker::Impl::track_on(float dt_s) {
  motion.begin_frame(dt_s, true);
  Hypothesis found = follow();
  weak_frames = found.fit.ok && found.quality >= kWeak * usual_quality ? 0 : weak_frames + 1;
  if (weak_frames >= kWeakFrames) {
    state = ModelState::kLost;
    T_carried = T_good;
    lost_frames = 0;
  }
  if (found.fit.ok) {
    PoseUpdate pose;
    pose.T_cw = found.T_co;
    motion.believe(pose, dt_s, distance(found.T_co));
  } else {
    motion.miss();
  }
  return found;
}

// Near the prediction by the velocity first. Only where that leaves doubt: from other predictions, and farther. A wide
// search costs more and finds more of what is not the object.
Hypothesis ModelTracker::Impl::follow() {
  const int level = std::min(matching.finest() + 1, matching.coarsest());
  SE3 T_predicted = motion.expected_motion() * motion.T_cw();
  matching.set_velocity(motion.expected_motion().log() / motion.dt_s());
  matching.set_prior(prior_near(T_predicted));
  Hypothesis best = matching.refine(T_predicted, level, kNearRange);
  if (best.quality > doubted()) {
    const RotationEstimate unknown;
    motion.turn(&unknown);
    note_error(T_predicted, best.T_co);
    return best;
  }
  const RotationEstimate turn =
      rotation.estimate(previous_small, small, motion.expected_motion().R, motion.expected_shift());
  motion.turn(&turn);
  const SE3 starts[3] = {motion.T_predicted(), T_predicted, motion.T_cw()};
  const auto attempt = [&](const SE3& T, int from_level, int range) {
    const Hypothesis tried = matching.refine(T, from_level, range);
    if (!tried.fit.ok || !(tried.quality > kBetter * best.quality)) return false;
    best = tried;
    return true;
  };
  for (const SE3& start : {starts[0], starts[2]}) {
    if (best.quality > doubted()) break;
    matching.set_prior(prior_near(start));
    if (attempt(start, level, kNearRange)) T_predicted = start;
  }
  bool wide = false;
  matching.set_prior({T_predicted});
  for (const SE3& start : starts)
    if (best.quality <= doubted()) wide = attempt(start, matching.coarsest(), kFirstRange) || wide;
  // What drifts along what hides the object is far from the last pose that was surely right, and looks worse than
  // there.
  if (best.quality <= doubted()) {
    matching.set_prior({T_good});
    wide = attempt(T_good, matching.coarsest(), kFirstRange) || wide;
    matching.set_prior({T_predicted});
  }
  if (!best.fit.ok) return best;
  if (!wide) matching.set_prior(prior_near(T_predicted));
  matching.refit(&best);
  if (best.quality > doubted()) note_error(T_predicted, best.T_co);
  return best;
}

// Round the last good pose, turned as the camera has since turned, and where the kept view most like this one was seen.
Hypothesis ModelTracker::Impl::restart() {
  const RotationEstimate turn = rotation.estimate(previous_small, small, Matrix3f::Identity(), Vector3f::Zero());
  if (turn.ok) T_carried = SE3(orthonormalised(turn.R_cp * T_carried.R), turn.R_cp * T_carried.t);
  matching.set_prior({T_good});
  const int nearest = nearest_view();
  const SE3& T_nearest = nearest >= 0 ? views[nearest].T : T_good;
  PoseSearch search(matching);
  search.add(T_carried);
  search.add(T_good);
  search.add(T_nearest);
  for (int i = lost_frames % kTurnShares; i < kTurns; i += kTurnShares)
    search.add_turned(lost_frames % 2 == 0 ? T_carried : T_nearest, i);
  lost_frames = (lost_frames + 1) % (2 * kTurnShares);
  Hypothesis found = search.best({});
  if (found.fit.ok) matching.refit(&found);
  found.fit.ok = found.fit.ok && found.quality >= kBelieved * typical_quality;
  if (found.fit.ok) begin_at(found.T_co);
  return found;
}

int ModelTracker::Impl::nearest_view() const {
  int nearest = -1;
  int64_t least = INT64_MAX;
  for (int i = 0; i < views_used; ++i) {
    const int64_t difference = small_image_zmssd(views[i].small, small);
    if (difference >= least) continue;
    least = difference;
    nearest = i;
  }
  return nearest;
}

void ModelTracker::Impl::keep_view(const SE3& T) {
  for (int i = 0; i < views_used; ++i) {
    const Vector3f turn = so3_log(T.R * views[i].T.R.transpose());
    const Vector3f shift = (T * parts().middle() - views[i].T * parts().middle()) / distance(T);
    if (turn.squaredNorm() < kNewTurn * kNewTurn && shift.squaredNorm() < kNewShift * kNewShift) return;
  }
  View& kept = views[next_view];
  next_view = (next_view + 1) % kViews;
  views_used = std::min(views_used + 1, kViews);
  kept.T = T;
  for (int y = 0; y < small.height; ++y) std::copy_n(small.row(y), small.width, kept.small.row(y));
}

// Of a frame with a pose: tells and learns.
void ModelTracker::Impl::conclude(Hypothesis* found, ModelResult* result) {
  matching.report(*found, result);
  const float quality = found->quality;
  matching.learn(found->T_co, quality >= kLearning * usual_quality);
  usual_quality += (quality > usual_quality ? kAdopt : kDecline) * (quality - usual_quality);
  recent_quality += kRecent * (quality - recent_quality);
  if (quality > kLearning * usual_quality) typical_quality += kTypical * (quality - typical_quality);
  if (quality < kBelieved * usual_quality) return;
  T_good = found->T_co;
  keep_view(T_good);
}

Status ModelTracker::Impl::check(const Frame& frame) const {
  const Status status = validate_frame(frame);
  if (!status.ok()) return status;
  if (frame.width != config.camera.model.width || frame.height != config.camera.model.height)
    return bad_call("the frame has another size than ModelTrackerConfig::camera");
  if (frame.timestamp_ns <= last_timestamp_ns)
    return {StatusCode::kTimeWentBackwards, "the frame's timestamp is not later than the one before"};
  return {};
}

ModelResult ModelTracker::Impl::track(const Frame& frame) {
  ModelResult result;
  result.timestamp_ns = frame.timestamp_ns;
  result.status = check(frame);
  if (!result.status.ok()) return result;
  // The first frame, and a long pause, count as a second.
  const bool first = last_timestamp_ns == INT64_MIN || frame.timestamp_ns / 2 - last_timestamp_ns / 2 > 500000000;
  const float dt_s = first ? 1.0f : std::max(static_cast<float>(frame.timestamp_ns - last_timestamp_ns) * 1e-9f, 1e-3f);
  last_timestamp_ns = frame.timestamp_ns;
  const Pyramid pyramid = build_pyramid(to_grey(frame, grey), storage);
  std::swap(small, previous_small);
  make_small_image(pyramid, small);
  matching.begin(pyramid, Vector6f::Zero());

  Hypothesis found;
  const ModelState before = state;
  if (starting) {
    found = anywhere ? start_anywhere() : start_anew();
    starting = anywhere && !found.fit.ok;
    if (found.fit.ok) matching.refit(&found);
    result.restarted = state == ModelState::kTracking;
  } else if (state == ModelState::kTracking) {
    found = track_on(dt_s);
  } else if (state == ModelState::kLost) {
    found = restart();
    result.restarted = before == ModelState::kLost && state == ModelState::kTracking;
  }
  result.state = state;
  if (state == ModelState::kTracking && found.fit.ok) conclude(&found, &result);
  return result;
}

size_t ModelTracker::required_bytes(const ModelTrackerConfig& config) {
  if (!config.validate().ok()) return 0;
  ModelTrackerConfig prepared = config;
  prepared.camera.model.prepare();
  Arena arena;
  arena.create<Impl>(prepared);
  arena.allocate(sizeof(ModelTracker));
  return arena.used();
}

Status ModelTracker::create(const ModelTrackerConfig& config, std::span<std::byte> memory, ModelTracker** tracker) {
  const Status status = config.validate();
  if (!status.ok()) return status;
  if (reinterpret_cast<uintptr_t>(memory.data()) % Arena::kAlignment != 0)
    return bad_call("ModelTracker::create: memory must be aligned as by malloc (alignof(std::max_align_t))");
  if (memory.size() < required_bytes(config))
    return {StatusCode::kOutOfMemory, "the block is smaller than ModelTracker::required_bytes(config)"};
  ModelTrackerConfig prepared = config;
  prepared.camera.model.prepare();
  Arena arena(memory);
  Impl* impl = arena.create<Impl>(prepared);
  *tracker = new (arena.allocate(sizeof(ModelTracker))) ModelTracker(impl);
  return {};
}

Status ModelTracker::start(const SE3& T_co) {
  const Matrix3f RtR = T_co.R * T_co.R.transpose();
  const bool rotation = (RtR - Matrix3f::Identity()).squaredNorm() < 1e-4f && T_co.R.determinant() > 0;
  if (!finite_vector(T_co.t) || !rotation)
    return bad_call("start: the pose is not a rotation and a translation within 1e6");
  if (!((T_co * impl_->parts().middle()).z() > kNearest * impl_->parts().extent()))
    return bad_call("start: the object's middle is not in front of the camera: T_co takes object to camera");
  impl_->T_start = {orthonormalised(T_co.R), T_co.t};
  impl_->starting = true;
  impl_->anywhere = false;
  return {};
}

void ModelTracker::start_anywhere() {
  impl_->starting = impl_->anywhere = true;
}

Status ModelTracker::start(std::span<const Vector3f> points_o, std::span<const Vector2f> px) {
  constexpr size_t kFewest = 4, kMost = 100;
  if (points_o.size() < kFewest || points_o.size() > kMost || points_o.size() != px.size())
    return bad_call("start: 4 to 100 points and as many pixels are needed");
  for (size_t i = 0; i < px.size(); ++i)
    if (!finite_vector(points_o[i]) || !finite_vector(Vector3f(px[i].x(), px[i].y(), 0)))
      return bad_call("start: coordinates must be within 1e6");
  SE3 T_co;
  if (!pose_from_points(impl_->config.camera, points_o, px, kPointError_px, &T_co))
    return bad_call(
        "start: no pose shows the points within 20 px of their pixels: are they in the same order, and not in a line?");
  return start(T_co);
}

void ModelTracker::reset() {
  impl_->starting = false;
  impl_->state = ModelState::kWaiting;
}

ModelResult ModelTracker::track(const Frame& frame) {
  return impl_->track(frame);
}

const ModelTrackerConfig& ModelTracker::config() const {
  return impl_->config;
}

}  // namespace pptam
