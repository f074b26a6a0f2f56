// The measurements of all points in one pool. Each point has a linked list, so that it takes memory for its own
// measurements only. Lists keep their order. Places of erased measurements are used again.
#pragma once

#include <pocket_ptam/camera.h>
#include "base/assert.h"
#include "base/containers.h"

namespace pptam {

// Where a point was found in a keyframe.
struct Measurement {
  ImagePoint at;
  int16_t keyframe = -1;  // index into Map::keyframes(); a live one
  float weight = 1;       // of the M-estimator at the last bundle adjustment, 0 to 1
};

class MeasurementPool {
  struct Node {
    Measurement measurement;
    int32_t next = -1;
  };

 public:
  struct List {
    int32_t first = -1;
    int16_t count = 0;
    int size() const { return count; }
  };

  class Iterator {
   public:
    Iterator(const Node* nodes, int32_t at) : nodes_(nodes), at_(at) {}
    const Measurement& operator*() const { return nodes_[at_].measurement; }
    const Measurement* operator->() const { return &nodes_[at_].measurement; }
    Iterator& operator++() {
      at_ = nodes_[at_].next;
      return *this;
    }
    bool operator!=(const Iterator& other) const { return at_ != other.at_; }

   private:
    const Node* nodes_;
    int32_t at_;
  };
  struct Range {
    Iterator first, last;
    int count;
    Iterator begin() const { return first; }
    Iterator end() const { return last; }
    int size() const { return count; }
    const Measurement& operator[](int i) const {
      PPTAM_ASSERT(i >= 0 && i < count);
      Iterator at = first;
      for (; i > 0; --i) ++at;
      return *at;
    }
  };

  MeasurementPool() = default;
  MeasurementPool(Arena& arena, int capacity) : nodes_(arena, capacity) { clear(); }

  Range range(const List& list) const {
    return {Iterator(nodes_.data(), list.first), Iterator(nodes_.data(), -1), list.count};
  }
  // False, with nothing changed, when the pool is full.
  bool push_back(List* list, const Measurement& measurement) {
    if (free_ < 0) return false;
    const int32_t added = free_;
    free_ = nodes_[added].next;
    nodes_[added] = {measurement, -1};
    *link(list, list->count) = added;
    ++list->count;
    return true;
  }
  Measurement& at(List* list, int i) {
    PPTAM_ASSERT(i >= 0 && i < list->count);
    return nodes_[*link(list, i)].measurement;
  }
  // Calls change(i, measurement) for each measurement of the list, in order.
  template <class Change>
  void update(const List& list, Change&& change) {
    int i = 0;
    for (int32_t at = list.first; at >= 0; at = nodes_[at].next) change(i++, nodes_[at].measurement);
  }
  void erase(List* list, int i) {  // keeps the order
    PPTAM_ASSERT(i >= 0 && i < list->count);
    int32_t* const place = link(list, i);
    const int32_t gone = *place;
    *place = nodes_[gone].next;
    nodes_[gone].next = free_;
    free_ = gone;
    --list->count;
  }
  void erase_all(List* list) {
    while (list->count > 0) erase(list, 0);
  }
  void clear() {  // empties the pool: lists made before are invalid
    nodes_.resize(nodes_.capacity());
    for (int i = 0; i < nodes_.size(); ++i) nodes_[i].next = i + 1 < nodes_.size() ? i + 1 : -1;
    free_ = nodes_.empty() ? -1 : 0;
  }

 private:
  // Address of the index that leads to the list's i-th node.
  int32_t* link(List* list, int i) {
    int32_t* place = &list->first;
    for (; i > 0; --i) place = &nodes_[*place].next;
    return place;
  }

  FixedVector<Node> nodes_;
  int32_t free_ = -1;  // first node of the chain of unused nodes; -1: none
};

}  // namespace pptam
