// Where an image has points that can be found again in another: one kind is chosen by Config (Shi-Tomasi: corners.h).
//
// Corners come one after the other, so that a caller takes no more than it needs, in short pieces of work between which
// it may pause:
//
//   corners.start(pyramid);
//   for (CornerProgress p; (p = corners.advance(&corner)) != CornerProgress::kEnd;)
//     if (p == CornerProgress::kFound) ...
//
// The initialiser asks for those of a first view, the mapper for those of a keyframe; there is one corner source for
// both, and start() drops what was being done. The pyramid must stay as it is until the last call. The source charges
// the work meter for what it does.
#pragma once

#include <cstdint>
#include <span>

#include "image/pyramid.h"

namespace pptam {

struct Corner {
  int16_t x = 0;  // level-0 pixels
  int16_t y = 0;
  float score = 0;  // by which one corner is better than another; its unit is the source's own
};

enum class CornerProgress : uint8_t { kWorking, kFound, kEnd };

class CornerSource {
 public:
  virtual void start(const Pyramid& pyramid) = 0;
  // The next piece of work; *corner is set with kFound. The order is fixed, and spreads corners over the image.
  virtual CornerProgress advance(Corner* corner) = 0;

  // Both for all that fit into out; returns their number.
  int detect(const Pyramid& pyramid, std::span<Corner> out) {
    start(pyramid);
    int count = 0;
    while (count < static_cast<int>(out.size())) {
      const CornerProgress progress = advance(&out[static_cast<size_t>(count)]);
      if (progress == CornerProgress::kEnd) break;
      count += progress == CornerProgress::kFound;
    }
    return count;
  }

 protected:
  ~CornerSource() = default;
};

}  // namespace pptam
