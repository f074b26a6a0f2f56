#include "edges/edge_matching.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "geometry/robust.h"

namespace pptam {

namespace {

constexpr int kFewestPixels = 100;  // of the shorter side in the coarsest level. Not swept
// Reach of a search along the normal after that of a coarser level, pixels of the level: in the finest one, and before.
constexpr int kNextRange = 5, kFinestRange = 4;
constexpr int kIterations = 6;       // of servoing, at most
constexpr float kSigmaFloor = 0.6f;  // least scale of the robust weights, pixels of the level; 0.3 lets models that are
                                     // inexact by a pixel jump between subsets of their edges
// Distance from its contour within which an edge speaks for the pose, level-0 pixels, and pixels of the finest level.
constexpr float kSupport_px = 2.5f, kSupportOfLevel_px = 1.25f;
constexpr float kClose_px = 1.5f;  // pixels of the finest level: of sites without a memory
// The contrast of a level's edges, as a share of that of the next coarser one, under which the level shows only their
// blur. A sharp edge has the same in all, one blurred over 15 pixels a third in level 0. Not swept.
constexpr float kSharp = 0.6f;
// Likeness from which on a site, with its neighbours, looks as it should, and surely does. Not swept; learning the
// latter in uncertain frames, too, is better than not to.
constexpr float kAlike = 0.3f, kSure = 0.6f;
constexpr uint8_t kUnsupported = 0, kSupported = 1, kSurely = 2, kNoSite = 3;
// Ratio to the frame's usual change of contrast: up to the first an edge is another one, from the second on the same.
constexpr float kOtherContrast = 0.4f, kSameContrast = 0.7f;
constexpr int kNeighbours = 3;     // sites on either side along a contour
constexpr float kAlone = 0.03f;    // share of its likelihood that an edge keeps when its neighbours look unlike theirs
constexpr float kSuddenly = 0.9f;  // share of the usual length of contours that a pose must show
// Share of a frame in the usual length of contours: of more, and of less.
constexpr float kMoreSeen = 0.3f, kLessSeen = 0.002f;
constexpr float kLeastShare = 0.05f;     // of the contours within the image, with which what is outside is reckoned
constexpr float kCoarserSpacing = 1.5f;  // of sites in levels coarser than the finest searched, ratio
constexpr int kOtherLevels = 4;          // levels that are not searched are looked at every so many frames

}  // namespace

EdgeMatching::EdgeMatching(Arena& arena, const ModelTrackerConfig& config)
    : config_(config),
      parts_(arena, config.model),
      view_(arena, parts_, config.camera),
      servoing_(arena, view_, parts_, config),
      memory_(arena, kModelLevels * parts_.contours_at_most() * kSiteBuckets),
      supported_(arena, parts_.contours_at_most() * kSiteBuckets),
      sites_(arena, config.max_sites),
      measurements_(arena, config.max_sites),
      profiles_(arena, config.max_sites * kMaxProfile),
      values_(arena, config.max_sites),
      reported_(arena, config.max_sites) {
  const int shorter = std::min(config.camera.model.width, config.camera.model.height);
  while (coarsest_ + 1 < kModelLevels && shorter >> (coarsest_ + 1) >= kFewestPixels) ++coarsest_;
  if (memory_.capacity() == 0 || supported_.capacity() == 0 || profiles_.capacity() == 0) return;  // only measured
  memory_.resize(kModelLevels * parts_.contours() * kSiteBuckets);
  supported_.resize(parts_.contours() * kSiteBuckets);
  profiles_.resize(profiles_.capacity());
}

void EdgeMatching::forget() {
  std::fill(memory_.begin(), memory_.end(), SiteMemory{});
  usual_length_ = 0;
  finest_ = 0;
}

void EdgeMatching::begin(const Pyramid& pyramid, const Vector6f& velocity) {
  pyramid_ = pyramid;
  velocity_ = velocity;
  frames_ = (frames_ + 1) % kOtherLevels;
}

// Coarser levels only lead to the finest one.
float EdgeMatching::spacing(int level) const {
  return config_.site_spacing_px * (level > finest_ ? kCoarserSpacing : 1);
}

float EdgeMatching::support_px() const {
  return std::max(kSupport_px, kSupportOfLevel_px * static_cast<float>(1 << finest_));
}

// Of one site: a measurement where something was found.
void EdgeMatching::search(int i, int level, int range) {
  const ContourSite& site = sites_[i];
  const GreyView& image = pyramid_.level[level];
  const Vector2f px = in_level(site, level);
  while (range > 1 && !profile_inside(image, px, site.normal, range + kMatchHalf)) --range;
  if (!profile_inside(image, px, site.normal, range + kMatchHalf)) return;
  int16_t* profile = &profiles_[i * kMaxProfile];
  sample_profile(image, px, site.normal, range + kMatchHalf, profile);
  EdgeCandidate found[kMaxCandidates];
  const SiteMemory nothing;
  const int count = find_edges(profile, range, config_.method.no_weights ? nothing : memory(site, level), found);
  if (count == 0) return;
  EdgeMeasurement m;
  m.contour = site.contour;
  m.site = static_cast<uint16_t>(i);
  m.candidates = static_cast<uint8_t>(count);
  for (int k = 0; k < count; ++k) {
    Vector2f at = site.px + site.normal * (found[k].offset * static_cast<float>(1 << level));
    if (config_.camera.shutter.line_time_s != 0) at = config_.camera.global_shutter_px(velocity_, site.p_c, at);
    m.ray[k] = config_.camera.unproject(at);
    m.edge[k] = found[k];
  }
  measurements_.push_back(m);
}

ServoingResult EdgeMatching::fit(const SE3& T_co, int level, int range) {
  view_.set_pose(T_co);
  spacing_px_ = view_.make_sites(level, spacing(level), velocity_, &sites_) * static_cast<float>(1 << level);
  measurements_.clear();
  for (int i = 0; i < sites_.size(); ++i) search(i, level, range);
  weigh_by_contrast();
  weigh_by_neighbours();
  ServoingOptions options;
  options.iterations = kIterations;
  options.range_px = static_cast<float>(range << level);
  options.sigma_floor_px = kSigmaFloor * static_cast<float>(1 << level);
  options.T_prior = prior_.T_co;
  options.prior_turn = prior_.turn;
  options.prior_shift = prior_.shift;
  return servoing_.run(T_co, options, &measurements_);
}

// Light changes all contrasts alike: by the median of edges that look as they should. What differs from that is another
// edge.
void EdgeMatching::weigh_by_contrast() {
  values_.clear();
  for (const EdgeMeasurement& m : measurements_) {
    int best = 0;
    for (int k = 1; k < m.candidates; ++k)
      if (m.edge[k].likeness > m.edge[best].likeness) best = k;
    if (m.edge[best].known && m.edge[best].likeness > kAlike) values_.push_back(m.edge[best].contrast);
  }
  if (values_.empty()) return;
  const float usual = median_of(values_);
  for (EdgeMeasurement& m : measurements_) {
    for (int k = 0; k < m.candidates; ++k) {
      EdgeCandidate& edge = m.edge[k];
      if (!edge.known || edge.likeness == 0) continue;
      const float ratio = std::min(edge.contrast, usual) / std::max(edge.contrast, usual);
      const float share = std::clamp((ratio - kOtherContrast) / (kSameContrast - kOtherContrast), 0.0f, 1.0f);
      edge.likeness *= share;
      edge.likelihood *= std::max(kAlone, share);
    }
  }
}

// What hides an object hides neighbouring sites; what looks alike there by chance stands alone.
void EdgeMatching::weigh_by_neighbours() {
  values_.clear();
  for (int i = 0, next = 0; i < sites_.size(); ++i) {
    float best = 0;
    if (next < measurements_.size() && measurements_[next].site == i) {
      const EdgeMeasurement& m = measurements_[next++];
      for (int k = 0; k < m.candidates; ++k) best = std::max(best, m.edge[k].likeness);
    }
    values_.push_back(best);
  }
  for (EdgeMeasurement& m : measurements_) {
    float sum = 0;
    int count = 0;
    for (int i = std::max(0, m.site - kNeighbours); i <= std::min(sites_.size() - 1, m.site + kNeighbours); ++i) {
      if (sites_[i].contour != m.contour) continue;
      sum += values_[i];
      ++count;
    }
    m.coherence = sum / static_cast<float>(count);
    for (int k = 0; k < m.candidates; ++k) m.edge[k].likelihood *= std::max(kAlone, m.coherence);
  }
}

Hypothesis EdgeMatching::refine(const SE3& T_co, int from, int range) {
  Hypothesis found;
  found.T_co = T_co;
  for (int level = std::max(from, finest_); level >= finest_; --level) {
    const int reach = level == from ? range : level == finest_ ? kFinestRange : kNextRange;
    found.fit = fit(found.T_co, level, reach);
    if (found.fit.ok) found.T_co = found.fit.T_co;
  }
  if (found.fit.ok) found.quality = quality();
  return found;
}

void EdgeMatching::refit(Hypothesis* hypothesis) {
  hypothesis->fit = fit(hypothesis->T_co, finest_, kFinestRange);
  if (!hypothesis->fit.ok) return;
  hypothesis->T_co = hypothesis->fit.T_co;
  hypothesis->quality = quality();
}

// How much the last search's pose shows of the object: length of contours that nothing of the object hides, as if they
// were at the distance 1 and whole within the image, level-0 pixels times model units. The same when the object goes
// away, comes near or leaves the image; less when it turns so that fewer contours face the camera.
float EdgeMatching::shown_length() const {
  const float depth = std::max((view_.T_co() * parts_.middle()).z(), 0.1f * parts_.extent());
  return static_cast<float>(sites_.size()) * spacing_px_ * depth / std::max(view_.share_in_image(), kLeastShare);
}

// Of the last search. What has turned away suddenly counts as if it were hidden. Of sites that have shown nothing yet
// strong edges count that lie close to their contours: anything has some edge near.
float EdgeMatching::quality() const {
  if (sites_.empty()) return 0;
  const float close_sq = kClose_px * kClose_px * static_cast<float>(1 << (2 * finest_));
  float sum = 0;
  for (const EdgeMeasurement& m : measurements_) {
    if (!(std::abs(m.distance_px) < support_px())) continue;
    const EdgeCandidate& edge = m.edge[m.chosen];
    sum += edge.known ? edge.likeness : edge.strength * std::max(0.0f, 1 - m.distance_px * m.distance_px / close_sq);
  }
  const float usual = kSuddenly * usual_length_, shown = shown_length();
  const float turned_away = shown < usual ? shown / usual : 1;
  return turned_away * sum / static_cast<float>(sites_.size());
}

float EdgeMatching::evidence(const SE3& T_co, int level) {
  view_.set_pose(T_co);
  view_.make_sites(level, spacing(level), velocity_, &sites_);
  if (sites_.empty()) return 0;
  float sum = 0;
  for (const ContourSite& site : sites_) {
    const Vector2f px = in_level(site, level);
    constexpr int kHalf = kMatchHalf + 1;
    if (!profile_inside(pyramid_.level[level], px, site.normal, kHalf)) continue;
    int16_t profile[kMaxProfile];
    sample_profile(pyramid_.level[level], px, site.normal, kHalf, profile);
    const SiteMemory& kept = memory(site, level);
    if (kept.seen > 0) {
      float best = 0;
      for (int i = kMatchHalf; i <= kMatchHalf + 2; ++i) best = std::max(best, likeness(profile, i, kept).shape);
      sum += best;
    } else {
      EdgeCandidate found[kMaxCandidates];
      if (find_edges(profile, 1, kept, found) > 0) sum += found[0].likelihood;
    }
  }
  return sum / static_cast<float>(sites_.size());
}

// measurement: null, nothing was found. since_search: from the pose of the search to that of the result.
ModelSite EdgeMatching::judged(const ContourSite& site, const EdgeMeasurement* measurement,
                               const SE3& since_search) const {
  ModelSite shown;
  shown.contour = site.contour;
  PredictedPoint seen;
  shown.model_px = config_.camera.project_rolling(since_search, velocity_, site.p_c, &seen) ? seen.px : site.px;
  shown.px = shown.model_px;
  if (!measurement) return shown;
  const EdgeMeasurement& m = *measurement;
  const EdgeCandidate& edge = m.edge[m.chosen];
  if (!(edge.likeness > kAlike && m.coherence > kAlike)) return shown;
  shown.px = site.px + site.normal * (edge.offset * static_cast<float>(1 << finest_));
  shown.kind = SiteKind::kRejectedRobustly;
  if (!(m.weight > 0 && std::abs(m.distance_px) < support_px())) return shown;
  shown.kind = SiteKind::kInlier;
  return shown;
}

uint8_t EdgeMatching::support_of(const ModelSite& judged, const EdgeMeasurement* measurement) const {
  if (judged.kind != SiteKind::kInlier) return kUnsupported;
  const bool sure = measurement->edge[measurement->chosen].likeness > kSure && measurement->coherence > kSure;
  return sure ? kSurely : kSupported;
}

void EdgeMatching::report(const Hypothesis& found, ModelResult* result) {
  result->pose_valid = true;
  result->T_co = found.T_co;
  result->covariance = found.fit.covariance;
  result->quality = found.quality;
  result->sites_visible = sites_.size();
  reported_.clear();
  std::fill(supported_.begin(), supported_.end(), kNoSite);
  float sum[kModelFeatures] = {}, all = 0;
  int next = 0;
  const SE3 since_search = found.T_co * view_.T_co().inverse();
  for (int i = 0; i < sites_.size(); ++i) {
    const bool measured = next < measurements_.size() && measurements_[next].site == i;
    const EdgeMeasurement* m = measured ? &measurements_[next++] : nullptr;
    reported_.push_back(judged(sites_[i], m, since_search));
    // The worst of a bucket's sites decides: the others may be beside what hides it.
    uint8_t& bucket = supported(sites_[i]);
    bucket = std::min(bucket, support_of(reported_.back(), m));
    if (reported_.back().kind != SiteKind::kInlier) continue;
    const int feature = static_cast<int>(parts_.feature(sites_[i].contour));
    sum[feature] += m->distance_px * m->distance_px;
    ++result->feature_inliers[feature];
    ++result->sites_inliers;
  }
  for (int f = 0; f < kModelFeatures; ++f) {
    all += sum[f];
    if (result->feature_inliers[f] > 0)
      result->feature_error_px[f] = std::sqrt(sum[f] / static_cast<float>(result->feature_inliers[f]));
  }
  if (result->sites_inliers > 0) result->error_px = std::sqrt(all / static_cast<float>(result->sites_inliers));
  result->sites = reported_;
}

// The level that was searched shows its profiles again; the next coarser one is looked at in each frame, the others in
// some.
void EdgeMatching::learn(const SE3& T_co, bool certain) {
  const float shown = shown_length();
  usual_length_ += (shown > usual_length_ ? kMoreSeen : kLessSeen) * (shown - usual_length_);
  float contrast[kModelLevels] = {};
  int seen[kModelLevels] = {};
  const auto show = [&](const ContourSite& site, uint8_t support, int level, const int16_t* profile, int index) {
    if (certain || support == kSurely) pptam::learn(profile, index, &memory(site, level));
    contrast[level] += static_cast<float>(std::abs(convolution(profile, index)));
    ++seen[level];
  };
  for (const EdgeMeasurement& m : measurements_) {
    const uint8_t support = support_of(reported_[m.site], &m);
    if (m.weight == 0 || support == kUnsupported) continue;
    show(sites_[m.site], support, finest_, &profiles_[m.site * kMaxProfile], m.edge[m.chosen].index);
  }
  view_.set_pose(T_co);
  int known = finest_;  // levels up to it are compared
  for (int level = 0; level <= coarsest_; ++level) {
    if (level == finest_ || (level > finest_ + 1 && frames_ != 0)) continue;
    known = std::max(known, level);
    view_.make_sites(level, spacing(level), velocity_, &sites_);
    for (const ContourSite& site : sites_) {
      const Vector2f px = in_level(site, level);
      const uint8_t support = supported(site);
      if (support == kUnsupported || support == kNoSite ||
          !profile_inside(pyramid_.level[level], px, site.normal, kMatchHalf))
        continue;
      int16_t profile[kMaxProfile];
      sample_profile(pyramid_.level[level], px, site.normal, kMatchHalf, profile);
      show(site, support, level, profile, kMatchHalf);
    }
  }
  for (int level = 0; level <= known; ++level) contrast[level] /= static_cast<float>(std::max(seen[level], 1));
  finest_ = 0;
  while (finest_ < known && contrast[finest_] < kSharp * contrast[finest_ + 1]) ++finest_;
}

}  // namespace pptam
