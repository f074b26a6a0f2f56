// Point source of the desktop profile: corners of a new keyframe, sought along their epipolar lines in the nearest
// keyframe, become map points at once [ptam 6.2].
//
//   corner ─▶ warped patch ─▶ zero-mean SSD along the line ─▶ unlike the second best? ─▶ sub-pixel ─▶ triangulated
//     ─▶ sought where the other keyframes should see it [ptam 6.4] ─▶ map point, if most of them do
//
// The line is as long as the depths of what the keyframe measures allow. It is walked at the times of its lines, so
// that neither a lens' distortion nor a rolling shutter bends it away.
#pragma once

#include "image/corner_source.h"
#include "map/map.h"
#include "map/patch_search.h"
#include "mapping/point_source.h"

namespace pptam {

class EpipolarPoints final : public PointSource {
 public:
  EpipolarPoints(Arena& arena, const Config& config, Map& map, WorkMeter& meter, Background& background,
                 CornerSource* corner_source);

  // Turns the corners of the keyframe that no point of the same level is near into map points, while there is room, up
  // to as many in each level as a frame needs.
  Task<> grow(int keyframe) override;

  FrameStack& frames() { return background_.frames(); }

 private:
  static constexpr int kMaxSteps = 400;  // positions of one line; a longer one is walked in larger steps
  struct Candidate {
    PatchSource source;
    Vector3f ray = Vector3f::UnitZ();  // of the source's pixel, in the frame of exposed_pose()
    SE3 T_we;                          // exposed_pose()
    Vector3f p_w = Vector3f::Zero();
    ImagePoint found;  // in other_
    Vector3f at(float inverse_depth) const { return T_we * Vector3f(ray / inverse_depth); }
  };
  struct Step {            // a position on the line
    int16_t x = 0, y = 0;  // top-left pixel of the best 8x8 there
    int32_t zmssd = 0;     // grey^2
  };
  Task<> prepare(int keyframe);
  int partner(int keyframe) const;
  void clear_occupied();
  void occupy(const ImagePoint& at);
  bool occupied(const Corner& corner) const;
  Task<bool> locate(int keyframe, const Corner& corner, Candidate* candidate);
  Task<> walk(const Candidate& candidate, const PatchTemplate& patch, int level, int32_t limit);
  bool best_of_line(const PatchTemplate& patch, int level, ImagePoint* found);
  Task<> add(int keyframe, const Candidate& candidate);

  const Config& config_;
  Map& map_;
  WorkMeter& meter_;
  Background& background_;
  CornerSource* corner_source_;
  PatchFinder finder_;
  FixedVector<uint8_t> occupied_[kPointLevels];  // of each cell of a level: whether a point is in it
  FixedVector<Step> line_;
  struct Seen {
    int16_t keyframe = -1;
    ImagePoint at;
  };
  FixedVector<Seen> seen_;                    // of one candidate, in the other keyframes
  int other_ = -1;                            // keyframe in which corners are sought; -1: there is none
  float mean_q_ = 1, min_q_ = 1, max_q_ = 1;  // inverse depths of the keyframe, 1 / world units
  int wanted_[kPointLevels] = {};             // points, by level
  int room_ = 0;                              // for map points
};

}  // namespace pptam
