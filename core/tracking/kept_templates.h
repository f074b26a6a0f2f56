// The templates of the map points searched last. A point looks alike in successive frames: most templates need not be
// warped again.
#pragma once

#include "base/containers.h"
#include "map/patch_search.h"

namespace pptam {

class KeptTemplates {
 public:
  // points: slots of Map::points(). Keeps `capacity` templates.
  KeptTemplates(Arena& arena, int points, int capacity) : place_(arena, points), templates_(arena, capacity) {
    place_.resize(place_.capacity());
    templates_.resize(templates_.capacity());
  }

  void begin_search() { ++search_; }
  // The template kept of the point in a slot of the map; another's place, emptied, if there is none. One that was asked
  // for neither in this search nor in the last one gives way, if there is any.
  KeptTemplate* of(int slot, uint32_t point_id) {
    if (templates_[place_[slot]].point_id != point_id) {
      for (int k = 0; k < templates_.size() && templates_[next_].asked_for + 1 >= search_; ++k) advance();
      place_[slot] = static_cast<int16_t>(next_);
      templates_[next_] = KeptTemplate();
      templates_[next_].point_id = point_id;
      advance();
    }
    KeptTemplate& kept = templates_[place_[slot]];
    kept.asked_for = search_;
    return &kept;
  }
  void forget() {
    for (KeptTemplate& kept : templates_) kept = KeptTemplate();
  }

 private:
  void advance() { next_ = next_ + 1 < templates_.size() ? next_ + 1 : 0; }

  FixedVector<int16_t> place_;  // in templates_, of each slot of the map's points
  FixedVector<KeptTemplate> templates_;
  int next_ = 0;
  uint32_t search_ = 1;
};

}  // namespace pptam
