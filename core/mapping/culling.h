// What the map can do without: measurements of a point beyond the most useful [phone 3.2], and the least useful
// keyframe when there is one too many [phone 3.3].
//
// Both judge by what would be lost. V = sum_j V_j is the information about a point's position, V_j = w_j B_j^T
// Sigma_j^-1 B_j what keyframe j gives of it (B_j the projection's Jacobian, w_j the M-estimator's weight);
// m_j = |V| - |V - V_j| is the usefulness of j for the point.
//
// Keyframes: every point spreads one vote over those that measure it. Two get a half each; of more, rank r under m_j
// gets max(0, o - (r - 1)) / (1 + ... + o), o = min(observers, 4). The keyframe with the lowest sum goes, if the sum is
// under kMaxVotesToErase. Beyond the paper, whose version can split the map: never one that holds the keyframe graph
// together. Never the datum, and not the two newest, whose corners have not been found a second time yet.
//
// The mapper calls. A decision is a coroutine: 1.0 million ARMv6 instructions for the paper's map (35 keyframes, 300
// points, 8 measurements each), about 3 million for the largest that Config::phone allows; memory from the arena.
#pragma once

#include "map/map.h"
#include "scheduler/task.h"

namespace pptam {

// A keyframe with fewer votes may be erased. As many votes as the newcomer can bring points (max_new_partial_points):
// less is no loss. Measured on "walls" (240x320, 20 s, 12 keyframes, three seeds), frames tracked: 72 to 80 % under a
// threshold of 5 or 8, where the map is soon full; 80 to 95 % under 12, 90 to 100 % under 20, all under 25 and without
// any. On "desk" and "boxes" all are tracked under any, with errors within a fifth.
constexpr float kMaxVotesToErase = 25.0f;
// Keyframes that share so many points hold together: by fewer the tracker calls no pose good.
constexpr int kMinCommonPoints = 12;

// m_j of each of the point's measurements, up to a factor that they share. Lens distortion, nearly the same factor for
// all, is left out.
void measure_usefulness(const Map& map, const Camera& camera, const MapPoint& point, float* m);

// Of the measurement whose usefulness has this rank, counted from 1.
float keyframe_vote(int observers, int rank);

// Takes out the point's least useful measurements until Map::max_measurements_per_point() are left. That of the patch's
// source always stays.
void cull_measurements(Map& map, int point, const Camera& camera, WorkMeter& meter);

// Which keyframe goes when there is one too many: one kind is chosen by Config.
class KeyframeCulling {
 public:
  // The live keyframe that can go; -1: none, the map is full. A coroutine of the mapper's.
  virtual Task<int> choose() = 0;

 protected:
  ~KeyframeCulling() = default;
};

// The phone's: by votes.
class UsefulnessCulling final : public KeyframeCulling {
 public:
  UsefulnessCulling(Arena& arena, const Config& config, Map& map, WorkMeter& meter, Background& background);

  Task<int> choose() override;
  // Of the live keyframe, at the last choice; for tests and figures.
  float votes(int keyframe) const { return votes_[keyframe]; }

  FrameStack& frames() { return background_.frames(); }

 private:
  Task<> count_votes();
  Task<int> count_components(int without, int common);
  uint8_t& common(int a, int b) { return common_[a * live_.size() + b]; }

  const Config& config_;
  Map& map_;
  WorkMeter& meter_;
  Background& background_;
  FixedVector<int16_t> live_;      // indices of live keyframes
  FixedVector<int16_t> place_;     // of a keyframe in live_
  FixedVector<float> votes_;       // by keyframe
  FixedVector<uint8_t> judged_;    // by keyframe: not to be chosen (any more)
  FixedVector<uint8_t> common_;    // of each pair of live_: points that both measure, at most 255
  FixedVector<uint8_t> reached_;   // by place: in count_components
  FixedVector<int16_t> frontier_;  // places, likewise
};

// Takes keyframes out of the map in slices, whoever chose them [phone 3.3, footnote].
class KeyframeEraser {
 public:
  KeyframeEraser(Arena& arena, const Config& config, Map& map, Background& background);

  // forget_surplus() is to follow.
  Task<> erase(int keyframe);
  // If there are more erased keyframes than Config allows one is forgotten for good: the one whose view is most like
  // another's, counted once more for every patch that it is the source of.
  Task<> forget_surplus();

  FrameStack& frames() { return background_.frames(); }

 private:
  Task<int> choose_forgotten();

  const Config& config_;
  Map& map_;
  Background& background_;
  FixedVector<float> patches_;  // by keyframe: how many it is the source of
};

}  // namespace pptam
