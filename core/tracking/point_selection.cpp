#include "tracking/point_selection.h"

#include <algorithm>

#include "base/sort.h"
#include "map/patch_search.h"

namespace pptam {

namespace {

constexpr int kMaxCells = 16 * 16;  // bounds of Config::cells_x and cells_y
// Cosine of the angle between the viewing directions of patch source and present camera: 60 degrees. Not swept.
constexpr float kMinCosView = 0.5f;
// Present distance of a point over its distance in the patch source: the range of scales that a warp can bridge. Not
// swept.
constexpr float kMinScale = 0.4f, kMaxScale = 2.5f;
// Keyframes whose centre is computed once a frame, on the stack (1.2 KB); those of others are computed for each point.
// More than the 71 slots of the phone profile.
constexpr int kCachedCentres = 96;
// Score of a point: its found share, estimated as if 2 of 3 more searches had succeeded, times 1 + 0.1 for each
// measurement, up to 6 of them. Ratios, not swept. Points with more measurements have better known positions.
constexpr float kPriorFound = 2.0f, kPriorAttempts = 3.0f;
constexpr float kMeasurementBonus = 0.1f;
constexpr int kMaxBonusMeasurements = 6;
// With levels of their own: area of a pixel of the point's level in the present image, level-0 pixels, where a patch
// faces both cameras. Beyond these no level shows it at a suitable scale [ptam 5.3: a factor of 4].
constexpr float kMinPatchArea = 0.25f, kMaxPatchArea = 4.0f * (1 << (2 * (kPointLevels - 1)));

}  // namespace

PointSelection::PointSelection(Arena& arena, const Config& config, WorkMeter& meter)
    : config_(config),
      meter_(meter),
      candidates_(arena, config.max_map_points),
      selected_(arena, config.max_measured_points) {}

void PointSelection::find_visible(const Map& map, const SE3& T_cw) {
  candidates_.clear();
  const Camera& camera = config_.camera;
  int projected = 0;
  const Vector3f centre = T_cw.centre();
  Vector3f source_centre[kCachedCentres];
  const int cached = std::min(map.keyframes().size(), kCachedCentres);
  for (int k = 0; k < cached; ++k) source_centre[k] = map.keyframes()[k].T_kw.centre();
  for (int i = 0; i < map.points().size(); ++i) {
    const MapPoint& point = map.points()[i];
    if (point.id == 0) continue;
    ++projected;
    Vector2f px;
    if (!camera.project(T_cw * point.p_w, &px) || !camera.in_image(px, search_border_px(config_))) continue;
    const int k = point.source.keyframe;
    const Vector3f from_source = point.p_w - (k < cached ? source_centre[k] : map.keyframes()[k].T_kw.centre());
    const Vector3f from_here = point.p_w - centre;
    const float source_sq = from_source.squaredNorm(), here_sq = from_here.squaredNorm();
    int level = 0;
    if (config_.own_levels) {
      const float area = source_sq / here_sq * static_cast<float>(1 << (2 * point.source.level));
      if (!(area > kMinPatchArea && area < kMaxPatchArea)) continue;
      level = level_of_area(area);
    } else if (here_sq < kMinScale * kMinScale * source_sq || here_sq > kMaxScale * kMaxScale * source_sq) {
      continue;
    }
    const float dot = from_source.dot(from_here);
    if (dot < 0 || dot * dot < kMinCosView * kMinCosView * source_sq * here_sq) continue;
    Candidate candidate;
    candidate.point = i;
    candidate.level = static_cast<int8_t>(level);
    const int x = std::clamp(static_cast<int>(px.x()) * config_.cells_x / camera.model.width, 0, config_.cells_x - 1);
    const int y = std::clamp(static_cast<int>(px.y()) * config_.cells_y / camera.model.height, 0, config_.cells_y - 1);
    candidate.cell = static_cast<int16_t>(y * config_.cells_x + x);
    const float reliability =
        (static_cast<float>(point.found) + kPriorFound) / (static_cast<float>(point.attempts) + kPriorAttempts);
    candidate.score =
        reliability *
        (1.0f + kMeasurementBonus * static_cast<float>(std::min(point.measurements.size(), kMaxBonusMeasurements)));
    candidates_.push_back(candidate);
  }
  meter_.charge(Work::kPointProjected, projected);
}

std::span<const int> PointSelection::choose(const Map& map, int count, int finest_level) {
  selected_.clear();
  const bool coarse = finest_level > 0;
  for (Candidate& candidate : candidates_) candidate.taken = candidate.level < finest_level;
  const auto better = [this, coarse, &map](int a, int b) {  // at equal scores the older point
    const Candidate &x = candidates_[a], &y = candidates_[b];
    if (coarse && x.level != y.level) return x.level > y.level;
    if (x.score != y.score) return x.score > y.score;
    return map.points()[x.point].id < map.points()[y.point].id;
  };
  const int cells = config_.cells_x * config_.cells_y;
  for (;;) {
    int best[kMaxCells];
    std::fill_n(best, cells, -1);
    for (int i = 0; i < candidates_.size(); ++i) {
      const Candidate& candidate = candidates_[i];
      if (candidate.taken) continue;
      int& rival = best[candidate.cell];
      if (rival < 0 || better(i, rival)) rival = i;
    }
    std::span<int> round(best, std::remove(best, best + cells, -1));
    if (round.empty()) return selected_;
    sort_list(round, better);
    for (const int i : round) {
      if (selected_.size() == count) return selected_;
      selected_.push_back(candidates_[i].point);
      candidates_[i].taken = true;
    }
  }
}

}  // namespace pptam
