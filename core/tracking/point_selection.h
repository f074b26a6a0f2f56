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
  std::span<const int> select(const Map& map, const SE3& T_cw) {
    find_visible(map, T_cw);
    return choose(map, selected_.capacity(), 0);
  }
  // Likewise of those that the last select() or select_coarse() found visible.
  std::span<const int> select_again(const Map& map) { return choose(map, selected_.capacity(), 0); }
  // Up to `count` points that are expected in levels above L0, those in the coarsest levels first (Config::own_levels).
  std::span<const int> select_coarse(const Map& map, const SE3& T_cw, int count) {
    find_visible(map, T_cw);
    return choose(map, count, 1);
  }
  int visible() const { return candidates_.size(); }  // points expected in the image at the last select()
  int capacity() const { return selected_.capacity(); }

 private:
  struct Candidate {
    int32_t point = -1;
    int16_t cell = 0;
    int8_t level = 0;  // expected, with Config::own_levels
    bool taken = false;
    float score = 0;
  };
  void find_visible(const Map& map, const SE3& T_cw);
  std::span<const int> choose(const Map& map, int count, int finest_level);

  const Config& config_;
  WorkMeter& meter_;
  FixedVector<Candidate> candidates_;
  FixedVector<int> selected_;
};

}  // namespace pptam
