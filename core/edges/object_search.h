// Where in an image an object may be of which nothing is known but its model: every view of it at every place, compared
// coarsely with the image's edges. For a start without a pose.
//
// In a small pyramid level the steepest pixels are edges, and in maps, one for each direction of edges, every pixel
// knows how far the next one is. For views from all sides, rolled and in some sizes, the object's sites are shifted
// over these maps; what is much nearer to edges than chance would have it is proposed. The object must be wholly in
// view.
//
// Cost: 2304 views, 150 thousand instructions each at 320x240. A fit by servoing tells which proposal is right.
#pragma once

#include <pocket_ptam/model_tracker.h>
#include "base/containers.h"
#include "edges/model_view.h"
#include "image/pyramid.h"

namespace pptam {

class ObjectSearch {
 public:
  // The camera must be prepared and outlive this, like the parts.
  ObjectSearch(Arena& arena, const Camera& camera, const ModelParts& parts);

  static constexpr int kProposals = 16;
  // Poses, the likeliest first. sites: working storage; the view is left at some pose.
  std::span<const SE3> run(const Pyramid& pyramid, ModelView& view, FixedVector<ContourSite>* sites);

 private:
  static constexpr int kDirections = 6;  // of edges, 30 degrees each, whatever their polarity
  struct Mark {                          // of a site, from the object's middle
    int16_t dx, dy;                      // pixels of the level
    uint8_t direction;
  };
  struct Proposal {
    SE3 T;
    float unlikelihood;  // that edges are so near by chance: how many standard deviations nearer
  };

  void find_edges(const GreyView& image);
  void measure_distances();
  bool make_marks(const SE3& T, ModelView& view, FixedVector<ContourSite>* sites);
  void shift_marks(const SE3& T);
  void propose(const SE3& T, float unlikelihood);
  const uint8_t* distances(int direction) const { return maps_.data() + direction * width_ * height_; }

  const Camera& camera_;
  const ModelParts& parts_;
  int level_ = 0, width_, height_;
  FixedVector<uint8_t> maps_;       // of each direction: thirds of a pixel to the next edge
  FixedVector<int16_t> steepness_;  // of each pixel; working storage
  FixedVector<Mark> marks_;
  float mean_ = 0, deviation_ = 1;  // of all distances
  Proposal kept_[kProposals];
  SE3 poses_[kProposals];
  int count_ = 0;
};

}  // namespace pptam
