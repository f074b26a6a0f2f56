// Chooses the map points to measure in a frame. They are expected to be visible and are spread over the image; points
// that are found reliably come first. The choice depends on the view alone: a changing choice makes the pose jitter.
#pragma once

#include <span>

#include <pocket_ptam/work_meter.h>
#include "map/map.h"

namespace pptam {

class PointSelection {
 public:
  PointSelection(Arena& arena, const Config& config, WorkMeter& meter);

  // Indices into map.points(), up to Config::max_measured_points: the best of every cell of the image, then the second
  // best of every cell, and so on. Valid until the next call.
  std::span<const int> select(const Map& map, const SE3& T_cw);
  int visible() const { return candidates_.size(); }  // points expected in the image at the last select()
  int capacity() const { return selected_.capacity(); }

 private:
  struct Candidate {
    int32_t point = -1;
    int16_t cell = 0;
    bool taken = false;
    float score = 0;
  };
  void find_visible(const Map& map, const SE3& T_cw);

  const Config& config_;
  WorkMeter& meter_;
  FixedVector<Candidate> candidates_;
  FixedVector<int> selected_;
};

}  // namespace pptam
