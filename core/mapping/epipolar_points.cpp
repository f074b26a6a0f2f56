#include "mapping/epipolar_points.h"

#include <algorithm>
#include <cmath>

#include "mapping/point_triangulation.h"

namespace pptam {

namespace {

// The keyframe in which corners are sought: nearest of those at least so far away, in mean depths, whose optical axis
// is within 37 degrees. Parallax of 1.1 degrees at the mean depth. Not swept.
constexpr float kPartnerBaseline = 0.02f, kPartnerCosAxes = 0.8f;
// Inverse depths that a corner may have: within so many sigmas of those that the keyframe measures and a share of
// their mean; least, in their mean. Not swept.
constexpr float kDepthSigmas = 3.0f, kDepthMargin = 0.15f, kLeastInverseDepth = 0.1f;
// Measured points without which inverse depths are taken to be within this factor of the mean's. Not swept.
constexpr int kMinMeasured = 10;
constexpr float kUnknownDepthRange = 3.0f;
// Points of a level that a keyframe measures, old and new ones, beyond which no new ones are made there: shares of
// Config::max_measured_points, together under half of it. In [ptam 7.1] 51, 33, 9 and 7 % of the points are of L0 to
// L3. Without this bound the first view of emulated photographs gives 1600 points, and a map of 5000 is full after 7 m
// along such walls; with shares of together 0.7 after 13 m of the 18 that are to be walked.
constexpr float kWantedShare[kPointLevels] = {0.18f, 0.16f, 0.07f, 0.04f};
// Side of the cells that tell whether a corner has a point near it, pixels of the level: corners are at least 5 px and
// at most 10 px from the nearest. Not swept.
constexpr int kCell_px = 5;
constexpr int kBand_px = 1;  // compared on either side of the line, pixels of the level searched: the poses' error
// Largest zero-mean SSD, as a share of the template's energy, and grey^2 that is accepted whatever the energy: noise of
// 3 grey levels rms. Not swept.
constexpr float kMaxRelativeZmssd = 0.25f;
constexpr float kNoise = 64 * 3 * 3;
// The best position of the line is believed if the next best, more than kBesideBest steps away, has a zero-mean SSD at
// least so many times as large. Not swept.
constexpr float kAmbiguity = 1.6f;
constexpr int kBesideBest = 3;
constexpr int kMostRefineSteps = 8;
// Noise of a refined measurement, and the largest distance from the epipolar line, pixels of the level. Not swept.
constexpr float kNoise_px = 0.4f, kMaxOffLine_px = 1.5f;
// Search of a new point in other keyframes: radius, pixels of the level searched, and
// SearchOptions::max_relative_zmssd. Not swept.
constexpr float kSeenRadius_px = 3.0f, kSeenZmssd = 0.3f;
// Of the other keyframes that should see a new point, the share that must. Not swept.
constexpr float kMinSeenShare = 0.5f;

// Largest zero-mean SSD of a match, grey^2.
float accepted_zmssd(const PatchTemplate& patch) {
  return std::max(kNoise, kMaxRelativeZmssd * static_cast<float>(patch.energy()));
}

// ARMv6 instructions, estimates.
constexpr int64_t kOccupyInstructions = 60;
constexpr int64_t kLineAffinityInstructions = 950;
constexpr int64_t kExposureInstructions = 600;

}  // namespace

EpipolarPoints::EpipolarPoints(Arena& arena, const Config& config, Map& map, WorkMeter& meter, Background& background,
                               CornerSource* corner_source)
    : config_(config),
      map_(map),
      meter_(meter),
      background_(background),
      corner_source_(corner_source),
      finder_(map, config, meter),
      line_(arena, kMaxSteps),
      seen_(arena, config.max_measurements_per_point) {
  for (int level = 0; level < kPointLevels; ++level)
    occupied_[level] = FixedVector<uint8_t>(arena, ((config.camera.model.width >> level) / kCell_px + 1) *
                                                       ((config.camera.model.height >> level) / kCell_px + 1));
}

Task<> EpipolarPoints::grow(int keyframe) {
  co_await prepare(keyframe);
  if (other_ < 0 || room_ <= 0) co_return;
  corner_source_->start(map_.keyframes()[keyframe].pyramid);
  Corner corner;
  for (;;) {
    const CornerProgress progress = corner_source_->advance(&corner);
    co_await background_.slice();
    if (progress == CornerProgress::kEnd) co_return;
    if (progress != CornerProgress::kFound || corner.level >= kPointLevels || wanted_[corner.level] <= 0 ||
        occupied(corner))
      continue;
    Candidate candidate;
    const bool located = co_await locate(keyframe, corner, &candidate);
    if (!located) continue;
    co_await add(keyframe, candidate);
    if (room_ <= 0) co_return;
  }
}

// Chooses the other keyframe, and collects where the keyframe measures points and how far away these are.
Task<> EpipolarPoints::prepare(int keyframe) {
  const Keyframe& frame = map_.keyframes()[keyframe];
  other_ = partner(keyframe);
  clear_occupied();
  room_ = map_.points().capacity() - map_.point_count();
  for (int level = 0; level < kPointLevels; ++level)
    wanted_[level] = static_cast<int>(kWantedShare[level] * static_cast<float>(config_.max_measured_points));
  float sum = 0, sum_sq = 0;
  int count = 0;
  for (const MapPoint& point : map_.points()) {
    if (point.id == 0) continue;
    for (const Measurement& m : map_.measurements(point)) {
      if (m.keyframe != keyframe) continue;
      occupy(m.at);
      if (m.at.level < kPointLevels) --wanted_[m.at.level];
      const float q = 1 / (frame.T_kw * point.p_w).z();
      sum += q;
      sum_sq += q * q;
      ++count;
    }
    co_await background_.spend(Work::kOther, kOccupyInstructions);
  }
  mean_q_ = 1 / frame.mean_depth;
  min_q_ = mean_q_ / kUnknownDepthRange;
  max_q_ = mean_q_ * kUnknownDepthRange;
  if (count < kMinMeasured) co_return;
  mean_q_ = sum / static_cast<float>(count);
  const float sigma = std::sqrt(std::max(0.0f, sum_sq / static_cast<float>(count) - mean_q_ * mean_q_));
  const float reach = kDepthSigmas * sigma + kDepthMargin * mean_q_;
  min_q_ = std::max(mean_q_ - reach, kLeastInverseDepth * mean_q_);
  max_q_ = mean_q_ + reach;
}

// The keyframe nearest to another that sees about the same from far enough away; -1: none.
int EpipolarPoints::partner(int keyframe) const {
  const Keyframe& frame = map_.keyframes()[keyframe];
  const Vector3f centre = frame.T_kw.centre();
  const float least = kPartnerBaseline * frame.mean_depth;
  int best = -1;
  float nearest = 0;
  for (int k = 0; k < map_.keyframes().size(); ++k) {
    const Keyframe& other = map_.keyframes()[k];
    if (k == keyframe || !other.live() || other.T_kw.R.row(2).dot(frame.T_kw.R.row(2)) < kPartnerCosAxes) continue;
    const float distance = (other.T_kw.centre() - centre).norm();
    if (distance < least || (best >= 0 && distance >= nearest)) continue;
    best = k;
    nearest = distance;
  }
  return best;
}

void EpipolarPoints::clear_occupied() {
  for (FixedVector<uint8_t>& cells : occupied_) {
    cells.resize(cells.capacity());
    std::fill(cells.begin(), cells.end(), uint8_t{0});
  }
}

void EpipolarPoints::occupy(const ImagePoint& at) {
  if (at.level >= kPointLevels || !config_.camera.in_image(at.px, 0)) return;
  const int x = static_cast<int>(from_level0(at.px.x(), at.level) + 0.5f) / kCell_px;
  const int y = static_cast<int>(from_level0(at.px.y(), at.level) + 0.5f) / kCell_px;
  const int across = (config_.camera.model.width >> at.level) / kCell_px + 1;
  const int cell = y * across + x;
  if (cell < occupied_[at.level].size()) occupied_[at.level][cell] = 1;
}

bool EpipolarPoints::occupied(const Corner& corner) const {
  const int across = (config_.camera.model.width >> corner.level) / kCell_px + 1;
  const FixedVector<uint8_t>& cells = occupied_[corner.level];
  const int x = corner.x / kCell_px, y = corner.y / kCell_px;
  for (int j = std::max(0, y - 1); j <= y + 1; ++j)
    for (int i = std::max(0, x - 1); i <= std::min(x + 1, across - 1); ++i)
      if (j * across + i < cells.size() && cells[j * across + i]) return true;
  return false;
}

// Finds a corner in the other keyframe, and its position.
Task<bool> EpipolarPoints::locate(int keyframe, const Corner& corner, Candidate* candidate) {
  const Camera& camera = config_.camera;
  const Keyframe& frame = map_.keyframes()[keyframe];
  const int level = corner.level;
  // The middle of the 8x8 that has the corner's pixel in it, between four pixels: nothing is interpolated.
  const Vector2f px(to_level0(static_cast<float>(corner.x) + 0.5f, level),
                    to_level0(static_cast<float>(corner.y) + 0.5f, level));
  const Vector2f normalised = camera.unproject(px);
  candidate->ray = {normalised.x(), normalised.y(), 1.0f};
  candidate->source = {static_cast<int16_t>(keyframe), px, -candidate->ray.normalized(), static_cast<uint8_t>(level)};
  candidate->T_we = exposed_pose(map_, camera, candidate->source);
  candidate->p_w = candidate->at(mean_q_);
  PredictedPoint predicted;
  meter_.charge(Work::kOther, kPredictionInstructions + kExposureInstructions + kLineAffinityInstructions);
  if (!predict_in_keyframe(map_, config_, other_, candidate->p_w, &predicted)) co_return false;
  Matrix2f A_t_s;
  if (!patch_affinity(camera, frame.T_kw * candidate->p_w, candidate->source.normal,
                      predicted.T_cw * frame.T_kw.inverse(), &A_t_s))
    co_return false;
  const int target_level = own_level(A_t_s, level);
  PatchTemplate patch;
  meter_.charge(Work::kPatchWarp, 1);
  if (!warp_template(frame.pyramid, px, A_t_s, target_level, &patch)) co_return false;
  co_await walk(*candidate, patch, target_level, static_cast<int32_t>(kAmbiguity * accepted_zmssd(patch)));
  if (!best_of_line(patch, target_level, &candidate->found)) co_return false;
  const float coarser = static_cast<float>(1 << std::max(level, target_level));
  const PointMeasurements measured{
      keyframe, other_, px, candidate->found.px, kNoise_px * coarser, kMaxOffLine_px * coarser};
  meter_.charge(Work::kOther, kTriangulationInstructions);
  co_return triangulate_point(map_, camera, measured, &candidate->p_w) == PointDepth::kKnown;
}

// Compares the template along the candidate's line in the other keyframe; line_ is empty if there is no line.
Task<> EpipolarPoints::walk(const Candidate& candidate, const PatchTemplate& patch, int level, int32_t limit) {
  const Camera& camera = config_.camera;
  const Keyframe& target = map_.keyframes()[other_];
  const GreyView& image = target.pyramid.level[level];
  line_.clear();
  PredictedPoint far, near;
  meter_.charge(Work::kOther, 2 * kPredictionInstructions);
  if (!camera.project_rolling(target.T_kw, target.velocity, candidate.at(min_q_), &far) ||
      !camera.project_rolling(target.T_kw, target.velocity, candidate.at(max_q_), &near))
    co_return;
  const Vector2f along = near.px - far.px;
  const float length = along.norm() / static_cast<float>(1 << level);
  const int steps = std::clamp(static_cast<int>(length) + 2, 2, kMaxSteps);
  const bool lies = std::abs(along.x()) > std::abs(along.y());  // the band is across it
  const PatchComparison comparison(patch);
  for (int i = 0; i < steps; ++i) {
    const float q = min_q_ + (max_q_ - min_q_) * static_cast<float>(i) / static_cast<float>(steps - 1);
    PredictedPoint at;
    Step step;
    step.zmssd = limit;
    if (camera.project_rolling(target.T_kw, target.velocity, candidate.at(q), &at)) {
      const int x = static_cast<int>(std::floor(from_level0(at.px.x(), level) - kPatchCentre + 0.5f));
      const int y = static_cast<int>(std::floor(from_level0(at.px.y(), level) - kPatchCentre + 0.5f));
      for (int k = -kBand_px; k <= kBand_px; ++k) {
        const int x_k = lies ? x : x + k, y_k = lies ? y + k : y;
        const int32_t zmssd = comparison.zmssd(image, x_k, y_k, step.zmssd);
        if (zmssd >= step.zmssd) continue;
        step = {static_cast<int16_t>(x_k), static_cast<int16_t>(y_k), zmssd};
      }
    }
    line_.push_back(step);
    meter_.charge(Work::kPatchCandidate, 2 * kBand_px + 1);
    co_await background_.spend(Work::kOther, kPredictionInstructions);
  }
}

// The place on the line where the template fits, to a fraction of a pixel; false if none fits, or several do.
bool EpipolarPoints::best_of_line(const PatchTemplate& patch, int level, ImagePoint* found) {
  const float accepted = accepted_zmssd(patch);
  int best = -1;
  for (int i = 0; i < line_.size(); ++i)
    if (static_cast<float>(line_[i].zmssd) < accepted && (best < 0 || line_[i].zmssd < line_[best].zmssd)) best = i;
  if (best < 0) return false;
  const auto rival = static_cast<int32_t>(kAmbiguity * static_cast<float>(line_[best].zmssd));
  for (int i = 0; i < line_.size(); ++i)
    if (std::abs(i - best) > kBesideBest && line_[i].zmssd < rival) return false;
  const GreyView& image = map_.keyframes()[other_].pyramid.level[level];
  const Vector2f at(static_cast<float>(line_[best].x) + kPatchCentre, static_cast<float>(line_[best].y) + kPatchCentre);
  RefinedPatch refined;
  const bool converged = refine_patch(image, patch, at, kMostRefineSteps, &refined);
  meter_.charge(Work::kPatchRefineStep, refined.steps);
  if (!converged) return false;
  found->px = {to_level0(refined.position.x(), level), to_level0(refined.position.y(), level)};
  found->level = static_cast<uint8_t>(level);
  return true;
}

// Adds the candidate with its measurements in all keyframes that see it, unless too few of those that should do.
Task<> EpipolarPoints::add(int keyframe, const Candidate& candidate) {
  SearchOptions options;
  options.level = kOwnLevel;
  options.radius_px = kSeenRadius_px;
  options.max_relative_zmssd = kSeenZmssd;
  int sought = 0;
  seen_.clear();
  for (int k = 0; k < map_.keyframes().size() && seen_.size() + 2 < map_.max_measurements_per_point(); ++k) {
    PredictedPoint predicted;
    if (k == keyframe || k == other_ || !map_.keyframes()[k].live()) continue;
    co_await background_.spend(Work::kOther, kPredictionInstructions);
    if (!predict_in_keyframe(map_, config_, k, candidate.p_w, &predicted)) continue;
    Seen seen;
    seen.keyframe = static_cast<int16_t>(k);
    const SearchOutcome outcome =
        finder_.find(candidate.source, candidate.p_w, predicted, map_.keyframes()[k].pyramid, options, &seen.at);
    sought += outcome != SearchOutcome::kNotVisible;
    if (outcome == SearchOutcome::kFound) seen_.push_back(seen);
  }
  if (static_cast<float>(seen_.size()) < kMinSeenShare * static_cast<float>(sought)) co_return;
  const int point = map_.add_point(candidate.p_w, candidate.source);
  if (point < 0) {
    room_ = 0;
    co_return;
  }
  map_.add_measurement(point, {{candidate.source.px, candidate.source.level}, static_cast<int16_t>(keyframe)});
  map_.add_measurement(point, {candidate.found, static_cast<int16_t>(other_)});
  for (const Seen& seen : seen_) map_.add_measurement(point, {seen.at, seen.keyframe});
  occupy({candidate.source.px, candidate.source.level});
  --wanted_[candidate.source.level];
  --room_;
}

PointSource* create_epipolar_points(Arena& arena, const Config& config, Map& map, WorkMeter& meter,
                                    Background& background, CornerSource* corner_source) {
  return arena.create<EpipolarPoints>(config, map, meter, background, corner_source);
}

}  // namespace pptam
