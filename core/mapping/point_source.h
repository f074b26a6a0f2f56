// Where new map points come from: one kind is chosen by Config. The mapper asks once for each keyframe, when all known
// points have been searched in it.
#pragma once

#include "scheduler/task.h"

namespace pptam {

class PointSource {
 public:
  // A coroutine of the mapper's. The keyframe is live, and the map's newest. May add points, with at least two
  // measurements each, and partial points, and change its own as it likes; the map must be consistent wherever it
  // pauses.
  virtual Task<> grow(int keyframe) = 0;

 protected:
  ~PointSource() = default;
};

}  // namespace pptam
