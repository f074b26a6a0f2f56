#include "mapping/keyframe_culling.h"

#include <algorithm>

namespace pptam {

namespace {

constexpr float kNoneNear = 1e9f;  // view distance of a keyframe that has no other
// ARMv6 instructions, as counted for the ARM1176.
constexpr int64_t kViewDistanceInstructions = 145;  // of Map::view_distance() for two keyframes
// ARMv6 instructions, estimates.
constexpr int64_t kErasePointInstructions = 35;   // of one slot of map points, when a keyframe is erased
constexpr int64_t kForgetPointInstructions = 15;  // of one slot of points, when a keyframe is forgotten
constexpr int64_t kCountPatchInstructions = 8;    // of one slot of points, to count the patches of keyframes

}  // namespace

KeyframeEraser::KeyframeEraser(Arena& arena, const Config& config, Map& map, Background& background)
    : config_(config),
      map_(map),
      background_(background),
      patches_(arena, keyframe_slots(config.max_keyframes, config.max_erased_keyframes)) {}

Task<> KeyframeEraser::erase(int keyframe) {
  const int64_t anchoring = kViewDistanceInstructions * map_.live_count();
  // Keyframes anchored to it are anchored to others first, one at a time, so that slices stay short.
  for (int k = 0; k < map_.keyframes().size(); ++k) {
    const Keyframe& other = map_.keyframes()[k];
    if (other.id == 0 || !other.erased || other.anchor != keyframe) continue;
    map_.anchor_keyframe(k, keyframe);
    co_await background_.spend(Work::kOther, anchoring);
  }
  map_.erase_keyframe(keyframe);
  co_await background_.spend(Work::kOther, kErasePointInstructions * map_.points().size() + anchoring);
}

Task<> KeyframeEraser::forget_surplus() {
  if (map_.erased_count() <= map_.max_erased()) co_return;
  const int forgotten = co_await choose_forgotten();
  const auto sources = static_cast<int64_t>(patches_[forgotten]);
  map_.forget_keyframe(forgotten);
  co_await background_.spend(Work::kOther,
                             kForgetPointInstructions * (map_.points().size() + map_.partial_points().size()) +
                                 sources * config_.max_measurements_per_point * kViewDistanceInstructions);
}

Task<int> KeyframeEraser::choose_forgotten() {
  patches_.resize(map_.keyframes().size());
  std::fill(patches_.begin(), patches_.end(), 0.0f);
  for (const MapPoint& point : map_.points())
    if (point.id != 0) patches_[point.source.keyframe] += 1;
  for (const PartialPoint& partial : map_.partial_points())
    if (partial.id != 0) patches_[partial.source.keyframe] += 1;
  co_await background_.spend(Work::kOther,
                             kCountPatchInstructions * (map_.points().size() + map_.partial_points().size()));
  int forgotten = -1;
  float least = 0;
  for (int k = 0; k < map_.keyframes().size(); ++k) {
    const Keyframe& keyframe = map_.keyframes()[k];
    if (keyframe.id == 0 || !keyframe.erased) continue;
    float nearest = kNoneNear;
    for (int other = 0; other < map_.keyframes().size(); ++other)
      if (other != k && map_.keyframes()[other].id != 0)
        nearest = std::min(nearest, Map::view_distance(keyframe, map_.keyframes()[other]));
    const float value = nearest * (1 + patches_[k]);
    if (forgotten < 0 || value < least) {
      forgotten = k;
      least = value;
    }
    co_await background_.spend(Work::kOther, kViewDistanceInstructions * map_.keyframes().size());
  }
  co_return forgotten;
}

}  // namespace pptam
