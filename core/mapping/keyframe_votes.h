// The phone's keyframe culling: the keyframe that the map can spare best, by votes [phone 3.3].
//
// Every point spreads one vote over the keyframes that measure it. If these are two, each gets a half. If
// they are more, rank r under the usefulness m_j (measurement_culling.h) gets max(0, o - (r - 1)) / (1 + ... + o), o =
// min(observers, 4). The keyframe with the lowest sum is erased, if the sum is under kMaxVotesToErase. Beyond the
// paper, whose version can split the map: a keyframe that holds the keyframe graph together is never erased. Nor is the
// datum, nor the two newest keyframes, whose corners have not been found a second time yet.
//
// A decision is a coroutine: 1.0 million ARMv6 instructions for the paper's map (35 keyframes,
// 300 points, 8 measurements each), about 3 million for the largest that Config::phone allows; memory from the arena.
#pragma once

#include "mapping/keyframe_culling.h"

namespace pptam {

// A keyframe with fewer votes may be erased: as many votes as a new keyframe of the phone can bring points (25),
// so that the exchange loses nothing. Measured on "walls" (240x320, 20 s, 12 keyframes, three seeds), frames tracked:
// 72 to 80 % under a threshold of 5 or 8, where the map is soon full; 80 to 95 % under 12, 90 to 100 % under 20; all
// under 25, and all without a threshold. On "desk" and "boxes" all frames are tracked at every threshold, and errors
// differ by less than a fifth.
constexpr float kMaxVotesToErase = 25.0f;
// Common points that join two keyframes in the keyframe graph: with fewer inliers the tracker calls no pose good.
constexpr int kMinCommonPoints = 12;

// Vote for the keyframe whose measurement has this rank, counted from 1, among `observers` measurements of a point.
float keyframe_vote(int observers, int rank);

// Keyframe culling by votes [phone 3.3].
class KeyframeVotes final : public KeyframeCulling {
 public:
  KeyframeVotes(Arena& arena, const Config& config, Map& map, WorkMeter& meter, Background& background);

  Task<int> choose() override;
  // Votes of a live keyframe at the last choose(); for tests and figures.
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
  FixedVector<int16_t> place_;     // by keyframe: its place in live_; -1: it is not live
  FixedVector<float> votes_;       // by keyframe: sum of the points' votes
  FixedVector<uint8_t> judged_;    // by keyframe: 1 when it cannot be chosen, or has been rejected
  FixedVector<uint8_t> common_;    // by pair of places: points that both keyframes measure, at most 255
  FixedVector<uint8_t> reached_;   // by place: 1 when count_components() has reached it
  FixedVector<int16_t> frontier_;  // places that count_components() has still to look at
};

}  // namespace pptam
