// Interface of corner detectors: points of an image that can be found again in another. Config chooses the detector
// (Shi-Tomasi: corners.h; FAST: fast.h).
//
// Corners come one at a time, so that a caller takes only as many as it needs, and in short pieces of work between
// which it may pause:
//
//   corners.start(pyramid);
//   for (CornerProgress p; (p = corners.advance(&corner)) != CornerProgress::kEnd;)
//     if (p == CornerProgress::kFound) ...
//
// The initialiser takes the corners of a first view, the mapper those of a keyframe. Both share one corner source:
// start() drops a detection in progress. The pyramid must not change until the last call. The source charges its work
// to the work meter.
#pragma once

#include <cstdint>
#include <span>

#include <pocket_ptam/se3.h>
#include "image/pyramid.h"

namespace pptam {

struct Corner {
  int16_t x = 0;  // pixels of `level`
  int16_t y = 0;
  float score = 0;    // larger is better; the unit is the detector's own
  uint8_t level = 0;  // in which it was found

  Vector2f px() const {  // level-0 pixels
    return {to_level0(static_cast<float>(x), level), to_level0(static_cast<float>(y), level)};
  }
};

enum class CornerProgress : uint8_t {
  kWorking,
  kFound,
  kWeaker,  // all corners of one kind have been given; finding weaker ones is the next work
  kEnd
};

class CornerSource {
 public:
  virtual void start(const Pyramid& pyramid) = 0;
  // Does the next piece of work. Sets *corner when it returns kFound. The order of corners is fixed and spreads them
  // over the image.
  virtual CornerProgress advance(Corner* corner) = 0;

  // Runs start() and advance() until out is full, no corner is left, or only weaker ones are and there are `enough`;
  // returns the number of corners.
  int detect(const Pyramid& pyramid, std::span<Corner> out, int enough = 0) {
    start(pyramid);
    int count = 0;
    while (count < static_cast<int>(out.size())) {
      const CornerProgress progress = advance(&out[static_cast<size_t>(count)]);
      if (progress == CornerProgress::kEnd || (progress == CornerProgress::kWeaker && count >= enough)) break;
      count += progress == CornerProgress::kFound;
    }
    return count;
  }

 protected:
  ~CornerSource() = default;
};

}  // namespace pptam
