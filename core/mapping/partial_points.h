// Point source of the phone profile: corners of one keyframe, whose depth is found in the frames after it [phone 5.2].
//
//   corner of a keyframe ─▶ partial point ─▶ DepthFilter (tracking), frame by frame ─▶ promoted at a later keyframe
//
// The 25 corners of a keyframe cost 0.51 million ARMv6 instructions, as counted for a desk (tests/budget).
#pragma once

#include "geometry/normal_equations.h"
#include "image/corner_source.h"
#include "map/map.h"
#include "map/patch_search.h"
#include "mapping/point_source.h"

namespace pptam {

// The surface that a keyframe sees, as a plane through its map points: where a new corner's depth is sought first. The
// inverse depth of a plane is linear in the image.
class SeenSurface {
 public:
  void clear();
  void add(const Vector3f& p_c);  // a point in the camera's frame
  // To be called after the last add(). mean_q: inverse of the mean depth, 1 / world units; all that is known where
  // points are few.
  void fit(float mean_q);
  float inverse_depth(const Vector2f& at) const;  // at (x/z, y/z), 1 / world units

 private:
  NormalEquations<3> equations_;
  int points_ = 0;
  float mean_q_ = 1, plane_[3] = {1, 0, 0};
};

class PartialPoints final : public PointSource {
 public:
  PartialPoints(Arena& arena, const Config& config, Map& map, WorkMeter& meter, Background& background,
                CornerSource* corner_source);

  // Turns partial points that are found in the keyframe into map points, and new corners of it into partial points.
  Task<> grow(int keyframe) override;

  FrameStack& frames() { return background_.frames(); }

 private:
  struct OutOfView {  // a partial point that a keyframe does not show
    uint32_t id = 0;
    int32_t slot = 0;  // of Map::partial_points()
  };
  Task<> promote_all(int keyframe);
  bool promote(int partial, int keyframe);
  Task<> add_corners(int keyframe);
  Task<> find_occupied(int keyframe);
  void make_room();

  const Config& config_;
  Map& map_;
  WorkMeter& meter_;
  Background& background_;
  CornerSource* corner_source_;
  PatchFinder finder_;
  FixedVector<Vector2f> occupied_;  // level-0 pixels of a keyframe that already have a point
  SeenSurface surface_;
  FixedVector<OutOfView> out_of_view_;
};

}  // namespace pptam
