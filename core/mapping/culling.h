// Culling: removes measurements of a point beyond the most useful ones [phone 3.2], and keyframes when there is one too
// many [phone 3.3], whichever kind of KeyframeCulling chooses them.
//
// Usefulness is the information that would be lost. V = sum_j V_j is the information about a point's position, and
// V_j = w_j B_j^T Sigma_j^-1 B_j is keyframe j's part of it (B_j the projection's Jacobian, w_j the M-estimator's
// weight). m_j = |V| - |V - V_j| is the usefulness of keyframe j for the point.
//
// Called by the mapper.
#pragma once

#include "map/map.h"
#include "scheduler/task.h"

namespace pptam {

// ARMv6 instructions of measure_usefulness() for one measurement, as counted for the ARM1176 (tests/budget).
constexpr int64_t kUsefulnessInstructions = 210;

// m[j]: usefulness m_j of each of the point's measurements, up to a common factor. Lens distortion is left out: it
// changes all by nearly the same factor.
void measure_usefulness(const Map& map, const Camera& camera, const MapPoint& point, float* m);

// Removes the point's least useful measurements until Map::max_measurements_per_point() are left. The measurement in
// the patch's source keyframe always stays.
void cull_measurements(Map& map, int point, const Camera& camera, WorkMeter& meter);

// Interface of keyframe culling: chooses the keyframe to erase when there is one too many. Config chooses the kind.
class KeyframeCulling {
 public:
  // Returns the live keyframe to erase; -1: none can be, the map is full. A coroutine run by the mapper.
  virtual Task<int> choose() = 0;

 protected:
  ~KeyframeCulling() = default;
};

// Erases keyframes in slices, for every kind of KeyframeCulling [phone 3.3, footnote].
class KeyframeEraser {
 public:
  KeyframeEraser(Arena& arena, const Config& config, Map& map, Background& background);

  // Turns a live keyframe into an erased one. To be followed by forget_surplus().
  Task<> erase(int keyframe);
  // If there are more erased keyframes than Config allows, one of them is removed from the map. It is the one with the
  // least value: view distance to the nearest other keyframe, times 1 + the number of patches that it is the source of.
  Task<> forget_surplus();

  FrameStack& frames() { return background_.frames(); }

 private:
  Task<int> choose_forgotten();

  const Config& config_;
  Map& map_;
  Background& background_;
  FixedVector<float> patches_;  // by keyframe: number of patches that it is the source of
};

}  // namespace pptam
