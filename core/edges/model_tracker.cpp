#include <pocket_ptam/model_tracker.h>

#include <algorithm>
#include <cmath>
#include <new>

#include "base/containers.h"
#include "base/deterministic_math.h"
#include "camera/full_frame_rotation.h"
#include "camera/motion_model.h"
#include "camera/small_image.h"
#include "edges/edge_search.h"
#include "edges/model_view.h"
#include "edges/point_pose.h"
#include "edges/servoing.h"
#include "geometry/robust.h"
#include "image/pyramid.h"

namespace pptam {

namespace {

// Pyramid levels searched, at most, 0 to this; coarser ones only while the shorter side has this many pixels. Not swept.
constexpr int kCoarsest = 2, kFewestPixels = 100;
// Reach of a search along the normal, pixels of its level: at the coarsest level, and at finer ones after it. Not swept.
constexpr int kFirstRange = 8, kNextRange = 5, kFinestRange = 4;
constexpr int kIterations = 6;  // of servoing, at most
// Least scale of the robust weights, pixels of the level.
constexpr float kSigmaFloor = 0.6f;
// Distance from its contour within which an edge speaks for the pose, level-0 pixels, and pixels of the finest level.
constexpr float kSupport_px = 2.5f, kSupportOfLevel_px = 1.25f;
// The contrast of a level's edges, as a share of that of the next coarser one, under which the level shows only their
// blur. A sharp edge has the same in all, one blurred over 15 pixels a third in level 0. Not swept.
constexpr float kSharp = 0.6f;
// Likeness from which on a site, with its neighbours, looks as it should.
constexpr float kAlike = 0.3f;
// ... and surely: it may be learnt even while much is hidden.
constexpr float kSure = 0.6f;
constexpr uint8_t kUnsupported = 0, kSupported = 1, kSurely = 2;
constexpr float kAdopt = 0.3f, kForget = 0.002f;  // share of a frame in what is usual: of better ones, of worse ones
constexpr float kUsual = 0.7f;  // quality of a good frame, before there was one
constexpr float kSuddenly = 0.9f;  // share of the usual sites that a pose must show
// Ratio to the frame's usual change of contrast: up to the first an edge is another one, from the second on the same.
constexpr float kOtherContrast = 0.4f, kSameContrast = 0.7f;
constexpr int kNeighbours = 3;     // sites on either side along a contour
constexpr float kAlone = 0.03f;     // share of its likelihood that an edge keeps when its neighbours look unlike theirs
// Quality under which a frame is weak, and above which a pose that was lost is believed, shares of what is usual.
constexpr float kWeak = 0.30f, kBelieved = 0.60f;
// Shares of the last frames' quality and of the usual one under which a wider search is made.
constexpr float kDoubted = 0.85f, kPoor = 0.5f;
constexpr float kRecent = 0.3f;     // share of a frame in the last frames' quality
constexpr float kLearning = 0.65f;  // share of the usual quality from which on less certain sites are learnt
// By how much a wider search's quality must be better, ratio.
constexpr float kBetter = 1.1f;
// 1-sigma of the prior on a pose: none, radians and shares of the distance; near a prediction that many times the rms
// error of the last predictions, at least that many pixels in the image. Not swept.
constexpr float kFree = 0.5f, kPriorErrors = 3, kPriorLeast_px = 5;
constexpr float kErrorBlend = 0.1f;  // share of the newest error in the mean square
// Turns tried in a search for the object, radians about each axis.
constexpr float kStartTurn = 0.18f;
constexpr int kTurns = 27;
constexpr int kWeakFrames = 3;  // in a row: lost
constexpr int kOtherLevels = 4;  // coarser levels are looked at every so many frames
constexpr int kViews = 16;      // kept for a restart
constexpr float kPointError_px = 20;  // of a start from points

// Of a frame whose full-frame rotation was not needed.
const RotationEstimate kNoRotation = {};

Status bad(const char* message) {
  return {StatusCode::kInvalidArgument, message};
}

bool all_finite(const Vector3f& v) {
  constexpr float kLargest = 1e6f;
  return std::abs(v.x()) <= kLargest && std::abs(v.y()) <= kLargest && std::abs(v.z()) <= kLargest;
}

}  // namespace

struct ModelTracker::Impl {
  // A pose and how well the picture agrees with it.
  struct Hypothesis {
    SE3 T;
    float quality = 0;
    ServoingResult fit;
  };
  struct Search {  // of many poses
    Impl& tracker;
    static constexpr int kKept = 5;
    Hypothesis kept[kKept] = {};
    int count = 0;
    void add(const SE3& T_start);
    void add_turned(const SE3& T, int i);
    Hypothesis best() const;
  };
  struct View {  // of a frame that was tracked well
    GreyImage small;
    SE3 T;
  };

  Impl(Arena& arena, const ModelTrackerConfig& configuration);

  ModelResult track(const Frame& frame);
  void begin(const Frame& frame);
  Hypothesis refine(SE3 T, int from_level, int range);
  ServoingResult fit(const SE3& T, int level, int range, int iterations);
  float evidence(const SE3& T, int level);
  float support() const;
  float doubted() const { return std::max(kDoubted * recent_, kPoor * usual_); }
  float support_px() const { return std::max(kSupport_px, kSupportOfLevel_px * static_cast<float>(1 << finest_)); }
  void weigh_by_contrast();
  void weigh_by_neighbours();
  Hypothesis track_on();
  void refit(Hypothesis* hypothesis);
  void free_prior(const SE3& T);
  void set_prior(const SE3& T);
  void note_error(const SE3& T_predicted, const SE3& T);
  void look(const SE3& T, bool may_learn);
  void keep_view(const SE3& T);
  Hypothesis start_search(const SE3& T);
  Hypothesis restart();
  void report(const Hypothesis& found, ModelResult* result);
  SiteMemory& memory(const ContourSite& site, int level) {
    return memory_[(level * parts.contours() + site.contour) * kSiteBuckets + site.bucket];
  }
  SE3 turned(const SE3& T, const Vector3f& turn, const Vector3f& shift_in_depths) const;

  ModelTrackerConfig config;
  ModelParts parts;
  ModelView view;
  Servoing servoing;
  FullFrameRotation rotation;
  MotionModel motion;
  GreyImage grey_;
  PyramidStorage storage_;
  GreyImage small_[2];
  FixedVector<ContourSite> sites_;
  FixedVector<EdgeMeasurement> measurements_;
  FixedVector<float> best_likeness_;  // by site
  FixedVector<int16_t> profiles_;     // by site, of the last search
  FixedVector<SiteMemory> memory_;
  FixedVector<uint8_t> supported_;  // by contour and bucket, in the last reported frame
  FixedVector<ModelSite> reported_;
  FixedVector<View> views_;
  int views_used_ = 0, next_view_ = 0;

  Pyramid pyramid_;
  int coarsest_ = 0;  // level of the pyramid that is searched
  int finest_ = 0;    // the same: coarser where the image is blurred
  bool use_memory_ = true;
  // Of the pose in this frame, and what the predictions of the last frames were off by: mean squares by component.
  SE3 T_prior_;
  float prior_turn_ = kFree, prior_shift_ = kFree;
  float turn_error_sq_ = 0, shift_error_sq_ = 0;
  float usual_sites_ = 0;  // visible in good frames, as if level 0 was searched
  Vector6f velocity_ = Vector6f::Zero();  // of T_co, for the rolling shutter
  ModelState state_ = ModelState::kWaiting;
  bool starting_ = false;
  SE3 T_start_;
  int frames_ = 0;  // since small images are there
  float usual_ = 0;   // quality of good frames
  float recent_ = 0;  // of the last frames
  int weak_ = 0;
  int sites_visible_ = 0, sites_level_ = 0;  // in the last reported frame
  int lost_frames_ = 0;
  SE3 T_good_;  // last good pose
  int64_t last_timestamp_ns_ = INT64_MIN, last_pose_ns_ = 0;
};

ModelTracker::Impl::Impl(Arena& arena, const ModelTrackerConfig& configuration)
    : config(configuration),
      parts(arena, config.model),
      view(arena, parts, config.camera),
      servoing(arena, view, parts, config.camera, config.max_sites),
      rotation(arena, config.camera),
      sites_(arena, config.max_sites),
      measurements_(arena, config.max_sites),
      best_likeness_(arena, config.max_sites),
      profiles_(arena, config.max_sites * kMaxProfile),
      memory_(arena, (kCoarsest + 1) * parts.contours_at_most() * kSiteBuckets),
      supported_(arena, parts.contours_at_most() * kSiteBuckets),
      reported_(arena, config.max_sites),
      views_(arena, kViews) {
  const int width = config.camera.model.width, height = config.camera.model.height;
  const auto image = [&](int level) {
    GreyImage made;
    made.width = made.stride = width >> level;
    made.height = height >> level;
    made.data = arena.allocate_array<uint8_t>(static_cast<size_t>(made.stride) * made.height);
    return made;
  };
  grey_ = image(0);
  storage_ = PyramidStorage(arena, width, height, 1);
  for (GreyImage& small : small_) small = image(kPyramidLevels - 1);
  for (int i = 0; i < kViews; ++i) {
    View kept;
    kept.small = image(kPyramidLevels - 1);
    views_.push_back(kept);
  }
  while (coarsest_ < kCoarsest && std::min(width, height) >> (coarsest_ + 1) >= kFewestPixels) ++coarsest_;
  if (memory_.capacity() == 0) return;
  profiles_.resize(profiles_.capacity());
  memory_.resize((kCoarsest + 1) * parts.contours() * kSiteBuckets);
  supported_.resize(parts.contours() * kSiteBuckets);
}

// The object turned about its middle, and shifted by parts of its distance; camera axes.
SE3 ModelTracker::Impl::turned(const SE3& T, const Vector3f& turn, const Vector3f& shift_in_depths) const {
  const Vector3f c = T * parts.middle();
  const Matrix3f R = so3_exp(turn);
  SE3 moved(R * T.R, R * (T.t - c) + c + c.z() * shift_in_depths);
  moved.R = orthonormalised(moved.R);
  return moved;
}

// One search and servoing in a level.
ServoingResult ModelTracker::Impl::fit(const SE3& T, int level, int range, int iterations) {
  view.set_pose(T);
  view.make_sites(level, config.site_spacing_px, velocity_, &sites_);
  measurements_.clear();
  const GreyView& image = pyramid_.level[level];
  const float unit = static_cast<float>(1 << level);
  for (int i = 0; i < sites_.size(); ++i) {
    const ContourSite& site = sites_[i];
    const Vector2f px(from_level0(site.px.x(), level), from_level0(site.px.y(), level));
    int reach = range;
    while (reach > 1 && !profile_inside(image, px, site.normal, reach + kMatchHalf)) --reach;
    if (!profile_inside(image, px, site.normal, reach + kMatchHalf)) continue;
    int16_t* profile = &profiles_[i * kMaxProfile];
    sample_profile(image, px, site.normal, reach + kMatchHalf, profile);
    EdgeCandidate found[kMaxCandidates];
    const int count = find_edges(profile, reach, use_memory_ ? &memory(site, level) : nullptr, found);
    if (count == 0) continue;
    EdgeMeasurement m;
    m.contour = site.contour;
    m.site = static_cast<uint16_t>(i);
    m.candidates = static_cast<uint8_t>(count);
    for (int k = 0; k < count; ++k) {
      Vector2f at = site.px + site.normal * (found[k].offset * unit);
      if (config.camera.shutter.line_time_s != 0) at = config.camera.global_shutter_px(velocity_, site.p_c, at);
      m.ray[k] = config.camera.unproject(at);
      m.likelihood[k] = found[k].likelihood;
      m.likeness[k] = found[k].likeness;
      m.contrast[k] = found[k].contrast;
      m.index[k] = static_cast<uint8_t>(found[k].index);
    }
    measurements_.push_back(m);
  }
  if (use_memory_) {
    weigh_by_contrast();
    weigh_by_neighbours();
  }
  ServoingOptions options;
  options.iterations = iterations;
  options.range_px = static_cast<float>(range) * unit;
  options.sigma_floor_px = kSigmaFloor * unit;
  options.T_prior = T_prior_;
  options.prior_turn = prior_turn_;
  options.prior_shift = prior_shift_;
  return servoing.run(T, options, &measurements_);
}

// Light changes all contrasts alike: by the median of edges that look as they should. Who differs from that is another
// edge.
void ModelTracker::Impl::weigh_by_contrast() {
  best_likeness_.clear();
  for (const EdgeMeasurement& m : measurements_) {
    int best = 0;
    for (int k = 1; k < m.candidates; ++k)
      if (m.likeness[k] > m.likeness[best]) best = k;
    if (m.likeness[best] > kAlike) best_likeness_.push_back(m.contrast[best]);
  }
  if (best_likeness_.empty()) return;
  const float usual = median_of(best_likeness_);
  for (EdgeMeasurement& m : measurements_) {
    for (int k = 0; k < m.candidates; ++k) {
      if (m.contrast[k] == 1) continue;  // unknown
      const float ratio = std::min(m.contrast[k], usual) / std::max(m.contrast[k], usual);
      const float share = std::clamp((ratio - kOtherContrast) / (kSameContrast - kOtherContrast), 0.0f, 1.0f);
      m.likeness[k] *= share;
      m.likelihood[k] *= std::max(kAlone, share);
    }
  }
}

// What hides an object hides neighbouring sites; what looks alike there by chance stands alone.
void ModelTracker::Impl::weigh_by_neighbours() {
  best_likeness_.clear();
  for (int i = 0, next = 0; i < sites_.size(); ++i) {
    float best = 0;
    if (next < measurements_.size() && measurements_[next].site == i) {
      const EdgeMeasurement& m = measurements_[next++];
      for (int k = 0; k < m.candidates; ++k) best = std::max(best, m.likeness[k]);
    }
    best_likeness_.push_back(best);
  }
  for (EdgeMeasurement& m : measurements_) {
    float sum = 0;
    int count = 0;
    for (int i = std::max(0, m.site - kNeighbours); i <= std::min(sites_.size() - 1, m.site + kNeighbours); ++i) {
      if (sites_[i].contour != m.contour) continue;
      sum += best_likeness_[i];
      ++count;
    }
    m.coherence = sum / static_cast<float>(count);
    for (int k = 0; k < m.candidates; ++k) m.likelihood[k] *= std::max(kAlone, m.coherence);
  }
}

// From coarse to fine.
ModelTracker::Impl::Hypothesis ModelTracker::Impl::refine(SE3 T, int from_level, int range) {
  Hypothesis found;
  found.T = T;
  for (int level = std::max(from_level, finest_); level >= finest_; --level) {
    const int reach = level == from_level ? range : level == finest_ ? kFinestRange : kNextRange;
    const ServoingResult fitted = fit(found.T, level, reach, kIterations);
    if (fitted.ok) found.T = fitted.T_co;
    found.fit = fitted;
  }
  if (found.fit.ok) found.quality = support();
  return found;
}

// Share of the sites of the last search whose edge is where the pose says and looks as it should.
float ModelTracker::Impl::support() const {
  if (sites_.size() == 0) return 0;
  float sum = 0;
  for (const EdgeMeasurement& m : measurements_) {
    if (!(std::abs(m.distance_px) < support_px())) continue;
    sum += m.likeness[m.chosen];
  }
  // What has turned away suddenly counts as if it were hidden.
  const float usual = usual_sites_ / static_cast<float>(1 << finest_);
  return sum / std::max(static_cast<float>(sites_.size()), kSuddenly * usual);
}

// How well the picture agrees with a pose, without a search beyond a pixel of the level: 0 to 1.
float ModelTracker::Impl::evidence(const SE3& T, int level) {
  view.set_pose(T);
  view.make_sites(level, config.site_spacing_px, velocity_, &sites_);
  if (sites_.size() == 0) return 0;
  const GreyView& image = pyramid_.level[level];
  float sum = 0;
  for (const ContourSite& site : sites_) {
    const Vector2f px(from_level0(site.px.x(), level), from_level0(site.px.y(), level));
    constexpr int kHalf = kMatchHalf + 1;
    if (!profile_inside(image, px, site.normal, kHalf)) continue;
    int16_t profile[kMaxProfile];
    sample_profile(image, px, site.normal, kHalf, profile);
    const SiteMemory& kept = memory(site, level);
    if (use_memory_ && kept.seen > 0) {
      float best = 0;
      for (int i = kMatchHalf; i <= kMatchHalf + 2; ++i) best = std::max(best, likeness(profile, i, kept).shape);
      sum += best;
    } else {
      EdgeCandidate found[kMaxCandidates];
      if (find_edges(profile, 1, nullptr, found) > 0) sum += found[0].likelihood;
    }
  }
  return sum / static_cast<float>(sites_.size());
}

// After report(): what the sites show in the last search, and at the pose found in the other levels, which are not
// needed in every frame. Learns it, where it may, and sees how sharp the image is.
void ModelTracker::Impl::look(const SE3& T, bool may_learn) {
  float contrast[kCoarsest + 1] = {};
  int seen[kCoarsest + 1] = {};
  const auto show = [&](const ContourSite& site, int level, const int16_t* profile, int index) {
    const uint8_t supported = supported_[site.contour * kSiteBuckets + site.bucket];
    if (may_learn || supported == kSurely) learn(profile, index, &memory(site, level));
    contrast[level] += static_cast<float>(std::abs(convolution(profile, index)));
    ++seen[level];
  };
  for (const EdgeMeasurement& m : measurements_) {
    const ContourSite& site = sites_[m.site];
    if (m.weight == 0 || supported_[site.contour * kSiteBuckets + site.bucket] == kUnsupported) continue;
    show(site, finest_, &profiles_[m.site * kMaxProfile], m.index[m.chosen]);
  }
  view.set_pose(T);
  int known = finest_;  // levels up to it are compared
  for (int level = 0; level <= coarsest_; ++level) {
    if (level == finest_) continue;
    if (level > finest_ + 1 && frames_ % kOtherLevels != 0) continue;
    known = std::max(known, level);
    view.make_sites(level, config.site_spacing_px, velocity_, &sites_);
    const GreyView& image = pyramid_.level[level];
    for (const ContourSite& site : sites_) {
      if (supported_[site.contour * kSiteBuckets + site.bucket] == kUnsupported) continue;
      const Vector2f px(from_level0(site.px.x(), level), from_level0(site.px.y(), level));
      if (!profile_inside(image, px, site.normal, kMatchHalf)) continue;
      int16_t profile[kMaxProfile];
      sample_profile(image, px, site.normal, kMatchHalf, profile);
      show(site, level, profile, kMatchHalf);
    }
  }
  for (int level = 0; level <= known; ++level) contrast[level] /= static_cast<float>(std::max(seen[level], 1));
  const int before = finest_;
  finest_ = 0;
  while (finest_ < known && contrast[finest_] < kSharp * contrast[finest_ + 1]) ++finest_;
  if (finest_ == known && before < known) finest_ = std::min(finest_, before + 1);
}

void ModelTracker::Impl::keep_view(const SE3& T) {
  for (int i = 0; i < views_used_; ++i) {
    const Vector3f turn = so3_log(T.R * views_[i].T.R.transpose());
    const Vector3f shift = (T * parts.middle() - views_[i].T * parts.middle()) / (T * parts.middle()).z();
    if (turn.norm() < 0.1f && shift.norm() < 0.1f) return;
  }
  View& kept = views_[next_view_];
  next_view_ = (next_view_ + 1) % kViews;
  views_used_ = std::min(views_used_ + 1, kViews);
  kept.T = T;
  const GreyImage& from = small_[frames_ & 1];
  for (int y = 0; y < from.height; ++y) std::copy_n(from.row(y), from.width, kept.small.row(y));
}

// Coarsely searched from each of the poses; the best few are refined.
void ModelTracker::Impl::Search::add(const SE3& T_start) {
  SE3 T = T_start;
  for (int pass = 0; pass < 2; ++pass) {
    const ServoingResult fitted = tracker.fit(T, tracker.coarsest_, kFirstRange, 8);
    if (fitted.ok) T = fitted.T_co;
  }
  Hypothesis tried;
  tried.T = T;
  tried.quality = tracker.evidence(T, std::max(tracker.coarsest_ - 1, 0));
  int place = count;
  while (place > 0 && kept[place - 1].quality < tried.quality) --place;
  if (place >= kKept) return;
  count = std::min(count + 1, kKept);
  for (int k = count - 1; k > place; --k) kept[k] = kept[k - 1];
  kept[place] = tried;
}

// The 27 turns by nothing or kStartTurn about each axis.
void ModelTracker::Impl::Search::add_turned(const SE3& T, int i) {
  const Vector3f turn(static_cast<float>(i % 3 - 1), static_cast<float>(i / 3 % 3 - 1), static_cast<float>(i / 9 - 1));
  const float length = std::sqrt(std::max(1.0f, turn.squaredNorm()));
  add(tracker.turned(T, turn * (kStartTurn / std::sqrt(length)), Vector3f::Zero()));
}

ModelTracker::Impl::Hypothesis ModelTracker::Impl::Search::best() const {
  Hypothesis best;
  for (int i = 0; i < count; ++i) {
    Hypothesis tried = tracker.refine(kept[i].T, tracker.coarsest_, kNextRange);
    tried = tracker.refine(tried.T, std::max(tracker.coarsest_ - 1, 0), kNextRange);
    if (tried.fit.ok && tried.quality > best.quality) best = tried;
  }
  return best;
}

ModelTracker::Impl::Hypothesis ModelTracker::Impl::start_search(const SE3& T_rough) {
  Search search{*this};
  for (int i = 0; i < kTurns; ++i) search.add_turned(T_rough, i);
  return search.best();
}

// Round the last good pose, a third of the turns in each frame, and where the kept view most like this one was seen.
ModelTracker::Impl::Hypothesis ModelTracker::Impl::restart() {
  Search search{*this};
  search.add(T_good_);
  int nearest = -1;
  int64_t least = INT64_MAX;
  for (int i = 0; i < views_used_; ++i) {
    const int64_t difference = small_image_zmssd(views_[i].small, small_[frames_ & 1]);
    if (difference < least) {
      least = difference;
      nearest = i;
    }
  }
  if (nearest >= 0) search.add(views_[nearest].T);
  for (int i = lost_frames_ % 3; i < kTurns; i += 3) search.add_turned(nearest >= 0 && lost_frames_ % 2 ? views_[nearest].T : T_good_, i);
  Hypothesis best = search.best();
  if (best.quality < kBelieved * usual_) best.fit.ok = false;
  return best;
}

void ModelTracker::Impl::begin(const Frame& frame) {
  const GreyView level0 = to_grey(frame, grey_);
  pyramid_ = build_pyramid(level0, storage_);
  ++frames_;
  make_small_image(pyramid_, small_[frames_ & 1]);
}

// Near the prediction by the velocity first. Only where that leaves doubt: from other predictions, and farther. A wide
// search costs more and finds more of what is not the object.
ModelTracker::Impl::Hypothesis ModelTracker::Impl::track_on() {
  const int level = std::min(finest_ + 1, coarsest_);
  SE3 T_predicted = motion.expected_motion() * motion.T_cw();
  velocity_ = motion.prior(T_predicted).mean;
  set_prior(T_predicted);
  Hypothesis best = refine(T_predicted, level, kNextRange);
  if (best.quality > doubted()) {
    motion.turn(&kNoRotation);
    note_error(T_predicted, best.T);
    return best;
  }
  const RotationEstimate turn = rotation.estimate(small_[(frames_ - 1) & 1], small_[frames_ & 1],
                                                  motion.expected_motion().R, motion.expected_shift());
  motion.turn(&turn);
  const SE3 starts[3] = {motion.T_predicted(), T_predicted, motion.T_cw()};
  const auto attempt = [&](const SE3& T, int from_level, int range) {
    const Hypothesis tried = refine(T, from_level, range);
    if (!tried.fit.ok || !(tried.quality > kBetter * best.quality)) return false;
    best = tried;
    return true;
  };
  bool wide = false;
  for (const SE3& start : {starts[0], starts[2]}) {
    if (best.quality > doubted()) break;
    set_prior(start);
    if (attempt(start, level, kNextRange)) T_predicted = start;
  }
  free_prior(T_predicted);
  for (int i = 0; i < 3 && best.quality <= doubted(); ++i) wide = attempt(starts[i], coarsest_, kFirstRange) || wide;
  if (!wide) set_prior(T_predicted);
  refit(&best);
  if (best.quality > doubted()) note_error(T_predicted, best.T);
  return best;
}

void ModelTracker::Impl::free_prior(const SE3& T) {
  T_prior_ = T;
  prior_turn_ = prior_shift_ = kFree;
}

void ModelTracker::Impl::set_prior(const SE3& T) {
  const float focal = 0.5f * (config.camera.model.fx + config.camera.model.fy);
  const float depth = std::max((T * parts.middle()).z(), 0.1f * parts.extent());
  T_prior_ = T;
  prior_turn_ = std::min(kFree, std::max(kPriorErrors * std::sqrt(turn_error_sq_),
                                         kPriorLeast_px * depth / (focal * parts.extent())));
  prior_shift_ = std::min(kFree, std::max(kPriorErrors * std::sqrt(shift_error_sq_), kPriorLeast_px / focal));
}

void ModelTracker::Impl::note_error(const SE3& T_predicted, const SE3& T) {
  const float depth = std::max((T * parts.middle()).z(), 0.1f * parts.extent());
  const float turn_sq = so3_log(T.R * T_predicted.R.transpose()).squaredNorm() / 3;
  const float shift_sq = (T * parts.middle() - T_predicted * parts.middle()).squaredNorm() / (3 * depth * depth);
  turn_error_sq_ += kErrorBlend * (turn_sq - turn_error_sq_);
  shift_error_sq_ += kErrorBlend * (shift_sq - shift_error_sq_);
}

// Sites and measurements are those of the last attempt: makes them those of this hypothesis.
void ModelTracker::Impl::refit(Hypothesis* hypothesis) {
  if (!hypothesis->fit.ok) return;
  hypothesis->fit = fit(hypothesis->T, finest_, kFinestRange, kIterations);
  if (!hypothesis->fit.ok) return;
  hypothesis->T = hypothesis->fit.T_co;
  hypothesis->quality = support();
}

void ModelTracker::Impl::report(const Hypothesis& found, ModelResult* result) {
  result->pose_valid = true;
  result->T_co = found.T;
  result->covariance = found.fit.covariance;
  result->quality = found.quality;
  result->sites_visible = sites_visible_ = sites_.size();
  sites_level_ = finest_;
  reported_.clear();
  std::fill(supported_.begin(), supported_.end(), kUnsupported);
  float sum[kModelFeatures] = {};
  int next = 0;
  const SE3 since_search = found.T * view.T_co().inverse();
  for (int i = 0; i < sites_.size(); ++i) {
    const ContourSite& site = sites_[i];
    ModelSite shown;
    shown.contour = site.contour;
    shown.px = site.px;
    Vector2f px;
    PredictedPoint seen;
    shown.model_px = config.camera.project_rolling(since_search, velocity_, site.p_c, &seen) ? seen.px : site.px;
    shown.kind = SiteKind::kRejectedLocally;
    if (next < measurements_.size() && measurements_[next].site == i) {
      const EdgeMeasurement& m = measurements_[next++];
      const Vector2f& ray = m.ray[m.chosen];
      if (config.camera.project(Vector3f(ray.x(), ray.y(), 1), &px)) shown.px = px;
      const bool alike = m.likeness[m.chosen] > kAlike && m.coherence > kAlike;
      const bool near = m.weight > 0 && std::abs(m.distance_px) < support_px();
      if (near && alike) {
        shown.kind = SiteKind::kInlier;
        const bool surely = m.likeness[m.chosen] > kSure && m.coherence > kSure;
        supported_[site.contour * kSiteBuckets + site.bucket] = surely ? kSurely : kSupported;
        const int feature = static_cast<int>(parts.feature(site.contour));
        sum[feature] += m.distance_px * m.distance_px;
        ++result->feature_inliers[feature];
        ++result->sites_inliers;
      } else if (alike) {
        shown.kind = SiteKind::kRejectedRobustly;
      }
    }
    reported_.push_back(shown);
  }
  float all = 0;
  for (int f = 0; f < kModelFeatures; ++f) {
    all += sum[f];
    if (result->feature_inliers[f] > 0)
      result->feature_error_px[f] = std::sqrt(sum[f] / static_cast<float>(result->feature_inliers[f]));
  }
  if (result->sites_inliers > 0) result->error_px = std::sqrt(all / static_cast<float>(result->sites_inliers));
  result->sites = reported_;
}

ModelResult ModelTracker::Impl::track(const Frame& frame) {
  ModelResult result;
  result.timestamp_ns = frame.timestamp_ns;
  result.status = validate_frame(frame);
  if (!result.status.ok()) return result;
  if (frame.width != config.camera.model.width || frame.height != config.camera.model.height) {
    result.status = bad("the frame has another size than ModelTrackerConfig::camera");
    return result;
  }
  if (frame.timestamp_ns <= last_timestamp_ns_) {
    result.status = {StatusCode::kTimeWentBackwards, "the frame's timestamp is not later than the one before"};
    return result;
  }
  const float dt_s = last_timestamp_ns_ == INT64_MIN
                         ? 1.0f
                         : std::clamp(static_cast<float>(frame.timestamp_ns - last_timestamp_ns_) * 1e-9f, 1e-3f, 1.0f);
  last_timestamp_ns_ = frame.timestamp_ns;
  begin(frame);
  Hypothesis found;
  use_memory_ = true;
  if (starting_) {
    starting_ = false;
    velocity_.setZero();
    std::fill(memory_.begin(), memory_.end(), SiteMemory{});
    views_used_ = next_view_ = 0;
    usual_ = recent_ = kUsual;
    usual_sites_ = 0;
    turn_error_sq_ = shift_error_sq_ = 0;
    free_prior(T_start_);
    finest_ = 0;
    found = start_search(T_start_);
    weak_ = 0;
    if (found.fit.ok) {
      motion.forget();
      motion.start(found.T, Vector6f::Zero(), (found.T * parts.middle()).z());
      state_ = ModelState::kTracking;
      result.restarted = true;
    } else {
      T_good_ = T_start_;
      state_ = ModelState::kLost;
    }
  } else if (state_ == ModelState::kTracking) {
    motion.begin_frame(dt_s, true);
    found = track_on();
    if (!found.fit.ok || found.quality < kWeak * usual_) {
      ++weak_;
      if (weak_ >= kWeakFrames) {
        state_ = ModelState::kLost;
        lost_frames_ = 0;
      }
    } else {
      weak_ = 0;
    }
    if (found.fit.ok) {
      PoseUpdate pose;
      pose.T_cw = found.T;
      motion.believe(pose, dt_s, std::max((found.T * parts.middle()).z(), 0.1f * parts.extent()));
    } else {
      motion.miss();
    }
  } else if (state_ == ModelState::kLost) {
    velocity_.setZero();
    free_prior(T_good_);
    found = restart();
    ++lost_frames_;
    if (found.fit.ok) {
      motion.forget();
      motion.start(found.T, Vector6f::Zero(), (found.T * parts.middle()).z());
      state_ = ModelState::kTracking;
      weak_ = 0;
      result.restarted = true;
    }
  }
  result.state = state_;
  if (state_ == ModelState::kTracking && found.fit.ok) {
    if (result.restarted) refit(&found);
    report(found, &result);
    look(found.T, found.quality >= kLearning * usual_);
    // They rise fast and fall slowly: what hides the object is not usual.
    const float visible = static_cast<float>(sites_visible_ << sites_level_);
    usual_ += (found.quality > usual_ ? kAdopt : kForget) * (found.quality - usual_);
    recent_ += kRecent * (found.quality - recent_);
    usual_sites_ += (visible > usual_sites_ ? kAdopt : kForget) * (visible - usual_sites_);
    if (found.quality >= kBelieved * usual_) {
      T_good_ = found.T;
      keep_view(found.T);
    }
  }
  return result;
}

Status ObjectModel::validate() const {
  constexpr float kLeast = 1e-6f, kMost = 1e6f;
  if (points.size() > kMaxPoints) return bad("ObjectModel::points: at most 4096");
  if (faces.size() > kMaxFaces) return bad("ObjectModel::faces: at most 2048");
  if (cylinders.size() > kMaxCurved || circles.size() > kMaxCurved || spheres.size() > kMaxCurved)
    return bad("ObjectModel: at most 1024 cylinders, circles and spheres each");
  if (lines.empty() && faces.empty() && cylinders.empty() && circles.empty() && spheres.empty())
    return bad("ObjectModel: nothing to track: no lines, faces, cylinders, circles or spheres");
  for (const Vector3f& p : points)
    if (!all_finite(p)) return bad("ObjectModel::points: coordinates must be within 1e6");
  const int count = static_cast<int>(points.size());
  const auto apart = [&](int a, int b) {
    return a >= 0 && b >= 0 && a < count && b < count &&
           (points[static_cast<size_t>(a)] - points[static_cast<size_t>(b)]).squaredNorm() > kLeast * kLeast;
  };
  const auto positive = [](float v) { return v >= kLeast && v <= kMost; };
  const auto threshold = [](float v) { return v >= 0 && v <= kMost; };
  size_t sides = lines.size();
  for (const ModelLine& line : lines)
    if (!apart(line.a, line.b) || !threshold(line.min_length_px))
      return bad("ObjectModel::lines: two points at different places are needed");
  for (const ModelFace& face : faces) {
    if (face.count < 2 || face.first < 0 || face.count > static_cast<int>(corners.size()) ||
        face.first > static_cast<int>(corners.size()) - face.count)
      return bad("ObjectModel::faces: a face needs two or more corners that are in ObjectModel::corners");
    sides += static_cast<size_t>(face.count);
    if (sides > kMaxSides) return bad("ObjectModel: at most 4096 lines and sides of faces");
    for (int i = 0; i < face.count; ++i) {
      const int here = corners[static_cast<size_t>(face.first + i)];
      const int next = corners[static_cast<size_t>(face.first + (i + 1) % face.count)];
      if (!apart(here, next)) return bad("ObjectModel::faces: neighbouring corners must be points at different places");
    }
    if (!threshold(face.min_area_px2) || !threshold(face.min_length_px))
      return bad("ObjectModel::faces: thresholds must be 0 to 1e6");
  }
  for (const ModelCylinder& cylinder : cylinders)
    if (!apart(cylinder.a, cylinder.b) || !positive(cylinder.radius) || !threshold(cylinder.min_length_px))
      return bad("ObjectModel::cylinders: two points at different places and a radius are needed");
  for (const ModelCircle& circle : circles)
    if (!all_finite(circle.centre) || !all_finite(circle.normal) || !positive(circle.radius) ||
        !(circle.normal.squaredNorm() > 1e-20f))
      return bad("ObjectModel::circles: a centre, a normal with a length and a radius are needed");
  for (const ModelSphere& sphere : spheres)
    if (!all_finite(sphere.centre) || !positive(sphere.radius))
      return bad("ObjectModel::spheres: a centre and a radius are needed");
  return {};
}

Status ModelTrackerConfig::validate() const {
  const Status status = camera.model.validate();
  if (!status.ok()) return status;
  if (camera.model.width < 64 || camera.model.height < 64 || camera.model.width > 4096 || camera.model.height > 4096)
    return bad("ModelTrackerConfig::camera: width and height must be within 64 to 4096 pixels");
  if (!(camera.readout_s() <= 1))
    return bad("ModelTrackerConfig::camera.shutter: the readout must be under 1 s; line_time_s is per line");
  if (!(site_spacing_px >= 1 && site_spacing_px <= 100))
    return bad("ModelTrackerConfig::site_spacing_px must be within 1 to 100");
  if (max_sites < 50 || max_sites > 5000) return bad("ModelTrackerConfig::max_sites must be within 50 to 5000");
  return model.validate();
}

size_t ModelTracker::required_bytes(const ModelTrackerConfig& config) {
  if (!config.validate().ok()) return 0;
  Arena arena;
  arena.create<ModelTracker::Impl>(config);
  arena.allocate(sizeof(ModelTracker));
  return arena.used();
}

Status ModelTracker::create(const ModelTrackerConfig& config, std::span<std::byte> memory, ModelTracker** tracker) {
  const Status status = config.validate();
  if (!status.ok()) return status;
  ModelTrackerConfig prepared = config;
  prepared.camera.model.prepare();
  Arena arena(memory);
  Impl* impl = arena.create<Impl>(prepared);
  void* place = arena.allocate(sizeof(ModelTracker));
  if (arena.overflowed())
    return {StatusCode::kOutOfMemory, "the block is smaller than ModelTracker::required_bytes(config)"};
  *tracker = new (place) ModelTracker(impl);
  return {};
}

Status ModelTracker::start(const SE3& T_co) {
  const Matrix3f RtR = T_co.R * T_co.R.transpose();
  if (!all_finite(T_co.t) || !((RtR - Matrix3f::Identity()).squaredNorm() < 1e-4f) || !(T_co.R.determinant() > 0))
    return bad("start: the pose is not a rotation and a finite translation");
  if (!((T_co * impl_->parts.middle()).z() > 0.1f * impl_->parts.extent()))
    return bad("start: the object's middle is not in front of the camera: T_co takes object to camera");
  impl_->T_start_ = T_co;
  impl_->T_start_.R = orthonormalised(T_co.R);
  impl_->starting_ = true;
  return {};
}

Status ModelTracker::start(std::span<const Vector3f> points_o, std::span<const Vector2f> px) {
  if (points_o.size() < 4 || points_o.size() > 100 || points_o.size() != px.size())
    return bad("start: 4 to 100 points and as many pixels are needed");
  for (size_t i = 0; i < px.size(); ++i)
    if (!all_finite(points_o[i]) || !all_finite(Vector3f(px[i].x(), px[i].y(), 0)))
      return bad("start: coordinates must be within 1e6");
  SE3 T_co;
  if (!pose_from_points(impl_->config.camera, points_o, px, kPointError_px, &T_co))
    return bad("start: no pose shows the points within 20 px of their pixels: are they in the same order, and three of "
               "them not in a line?");
  return start(T_co);
}

void ModelTracker::reset() {
  impl_->starting_ = false;
  impl_->state_ = ModelState::kWaiting;
}

ModelResult ModelTracker::track(const Frame& frame) {
  return impl_->track(frame);
}

const ModelTrackerConfig& ModelTracker::config() const {
  return impl_->config;
}

}  // namespace pptam
