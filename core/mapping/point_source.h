// Interface of what makes new map points. Config chooses the kind. The mapper calls it once for each keyframe, after
// all known points have been searched in it.
#pragma once

#include "scheduler/task.h"

namespace pptam {

class PointSource {
 public:
  // A coroutine run by the mapper: the class has `FrameStack& frames()`, that of its Background, whose 24 KB hold all
  // nested frames. `keyframe` is live and the newest of the map. May add points with at least two
  // measurements each, and add, change and remove partial points. The map must be consistent wherever it pauses.
  virtual Task<> grow(int keyframe) = 0;

 protected:
  ~PointSource() = default;
};

}  // namespace pptam
