#include "mapping/keyframe_votes.h"

#include <algorithm>

#include "mapping/measurement_culling.h"

namespace pptam {

namespace {

constexpr int kProtectedKeyframes = 2;  // newest keyframes that are never erased: their corners are not found again yet

// ARMv6 instructions of the parts of a decision. Their sum is as counted for the ARM1176 (tests/budget); the shares
// follow the compiled code.
constexpr int64_t kVoteInstructions = 40;    // of one measurement
constexpr int64_t kPairInstructions = 34;    // of two measurements: their order, and the count of common points
constexpr int64_t kPointInstructions = 120;  // of one map point
// ARMv6 instructions, estimates.
constexpr int64_t kSlotInstructions = 10;  // of one keyframe slot, to set the votes to zero
constexpr int64_t kEdgeInstructions = 17;  // of one pair of keyframes, in the search for connected parts

}  // namespace

float keyframe_vote(int observers, int rank) {
  if (observers == 2) return 0.5f;
  const int o = std::min(observers, 4);  // the four best ranks share a point's vote [phone 3.3]
  const int all = o * (o + 1) / 2;
  return static_cast<float>(std::max(0, o - (rank - 1))) / static_cast<float>(all);
}

KeyframeVotes::KeyframeVotes(Arena& arena, const Config& config, Map& map, WorkMeter& meter, Background& background)
    : config_(config),
      map_(map),
      meter_(meter),
      background_(background),
      live_(arena, config.max_keyframes + 1),
      place_(arena, keyframe_slots(config.max_keyframes, config.max_erased_keyframes)),
      votes_(arena, keyframe_slots(config.max_keyframes, config.max_erased_keyframes)),
      judged_(arena, keyframe_slots(config.max_keyframes, config.max_erased_keyframes)),
      common_(arena, (config.max_keyframes + 1) * (config.max_keyframes + 1)),
      reached_(arena, config.max_keyframes + 1),
      frontier_(arena, config.max_keyframes + 1) {}

Task<int> KeyframeVotes::choose() {
  co_await count_votes();
  // Number of common points that makes an edge of the keyframe graph: the largest one, up to kMinCommonPoints, at which
  // the graph has as few parts as with edges of one common point. Erasing a keyframe must not add a part.
  const int parts = co_await count_components(-1, 1);
  int common = kMinCommonPoints;
  for (; common > 1; --common) {
    const int parts_now = co_await count_components(-1, common);
    if (parts_now <= parts) break;
  }
  for (int k = 0; k < map_.keyframes().size(); ++k) judged_[k] = !map_.keyframes()[k].live() || k == 0;
  for (int newest = 0; newest < kProtectedKeyframes; ++newest) {
    int youngest = -1;
    for (const int16_t k : live_)
      if (!judged_[k] && (youngest < 0 || map_.keyframes()[k].id > map_.keyframes()[youngest].id)) youngest = k;
    if (youngest >= 0) judged_[youngest] = 1;
  }
  for (;;) {
    int lowest = -1;
    for (const int16_t k : live_)
      if (!judged_[k] && votes_[k] < kMaxVotesToErase && (lowest < 0 || votes_[k] < votes_[lowest])) lowest = k;
    if (lowest < 0) co_return -1;
    judged_[lowest] = 1;
    const int parts_without = co_await count_components(place_[lowest], common);
    if (parts_without <= parts) co_return lowest;
  }
}

Task<> KeyframeVotes::count_votes() {
  live_.clear();
  place_.resize(map_.keyframes().size());
  votes_.resize(map_.keyframes().size());
  judged_.resize(map_.keyframes().size());
  for (int k = 0; k < map_.keyframes().size(); ++k) {
    votes_[k] = 0;
    place_[k] = -1;
    if (!map_.keyframes()[k].live()) continue;
    place_[k] = static_cast<int16_t>(live_.size());
    live_.push_back(static_cast<int16_t>(k));
  }
  reached_.resize(live_.size());
  common_.resize(live_.size() * live_.size());
  std::fill(common_.begin(), common_.end(), uint8_t{0});
  meter_.charge(Work::kOther, common_.size() + kSlotInstructions * map_.keyframes().size());
  for (const MapPoint& point : map_.points()) {
    if (point.id == 0) continue;
    const int observers = point.measurements.size();
    float m[kMaxMeasurementsPerPoint + 1];
    if (observers > 2) measure_usefulness(map_, config_.camera, point, m);
    int keyframe[kMaxMeasurementsPerPoint + 1], place[kMaxMeasurementsPerPoint + 1];
    int rank[kMaxMeasurementsPerPoint + 1];  // by usefulness, from 0; equal ones in the order of the measurements
    int j = 0;
    for (const Measurement& measurement : map_.measurements(point)) {
      const int b = place_[measurement.keyframe];
      keyframe[j] = measurement.keyframe;
      place[j] = b;
      rank[j] = 0;
      for (int i = 0; i < j; ++i) {
        const int a = place[i];
        if (observers > 2) ++rank[m[j] > m[i] ? i : j];
        if (common(a, b) < 255) common(b, a) = ++common(a, b);
      }
      ++j;
    }
    for (j = 0; j < observers; ++j) votes_[keyframe[j]] += keyframe_vote(observers, rank[j] + 1);
    co_await background_.spend(Work::kOther, kPointInstructions +
                                                 kPairInstructions * (observers * (observers - 1) / 2) +
                                                 (kUsefulnessInstructions + kVoteInstructions) * observers);
  }
}

// Number of connected parts of the graph of live keyframes, in which an edge joins two that share at least
// common_points points. `without`: place of a keyframe that is left out; -1: none is.
Task<int> KeyframeVotes::count_components(int without, int common_points) {
  int components = 0;
  std::fill(reached_.begin(), reached_.end(), uint8_t{0});
  for (int start = 0; start < live_.size(); ++start) {
    if (start == without || reached_[start]) continue;
    ++components;
    frontier_.clear();
    frontier_.push_back(static_cast<int16_t>(start));
    reached_[start] = 1;
    for (int next = 0; next < frontier_.size(); ++next) {
      const int a = frontier_[next];
      for (int b = 0; b < live_.size(); ++b) {
        if (b == without || reached_[b] || common(a, b) < common_points) continue;
        reached_[b] = 1;
        frontier_.push_back(static_cast<int16_t>(b));
      }
      co_await background_.spend(Work::kOther, kEdgeInstructions * live_.size());
    }
  }
  co_return components;
}

KeyframeCulling* create_keyframe_votes(Arena& arena, const Config& config, Map& map, WorkMeter& meter,
                                       Background& background) {
  return arena.create<KeyframeVotes>(config, map, meter, background);
}

}  // namespace pptam
