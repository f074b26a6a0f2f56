// Keyframe culling [phone 3.3]: when there is one keyframe too many one is chosen, and erased in slices. Config names
// who chooses; the phone's choice is by votes (keyframe_votes.h). Called by the mapper.
#pragma once

#include "map/map.h"
#include "scheduler/task.h"

namespace pptam {

// Interface of keyframe culling: chooses the keyframe to erase when there is one too many. Config chooses the kind.
class KeyframeCulling {
 public:
  // Returns the live keyframe to erase; -1: none can be, the map is full. Never 0, the datum. A coroutine run by the
  // mapper: the class has `FrameStack& frames()`, that of its Background, whose 24 KB hold all nested frames.
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
