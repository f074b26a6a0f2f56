// Views on the way of a start: keyframes, if the map comes about. Beyond the paper, which keeps two: two views cannot
// tell structure from the shutter's distortion, several can. With each, what was found in the frames before and after
// it, which tells how fast the camera was [phone 6].
#pragma once

#include "map/map.h"
#include "tracking/frame_input.h"
#include "tracking/homography_tracker.h"

namespace pptam {

class ViewRecorder {
 public:
  struct ViewPoint {
    Vector2f px = Vector2f::Zero();
    bool found = false;
  };
  struct Neighbour {  // the frame before or after a view
    bool known = false;
    int64_t timestamp_ns = 0;
    FixedVector<ViewPoint> points;
  };
  struct View {
    Keyframe frame;
    FixedVector<ViewPoint> points;  // one per point
    Neighbour before, after;
  };

  ViewRecorder(Arena& arena, const Config& config, WorkMeter& meter);

  // The first view, whose points are as they are.
  void start(const FrameInput& frame, std::span<const TrackedPoint> points);
  // At each frame, before its points are tracked: what was found in the last one, if its points mean something.
  void note_last(bool good, int64_t timestamp_ns, std::span<const TrackedPoint> points);
  // After it was tracked well: every stride-th sharp frame becomes a view.
  void note(const FrameInput& frame, std::span<const TrackedPoint> points, bool sharp);
  // The last view, which always finds a place.
  void finish(const FrameInput& frame, std::span<const TrackedPoint> points) { record(frame, points, true); }

  int count() const { return count_; }
  View& view(int i) { return views_[i]; }  // 0 is the first view
  const View& view(int i) const { return views_[i]; }
  const Pyramid& first_pyramid() const { return views_[0].frame.pyramid; }

 private:
  void record(const FrameInput& frame, std::span<const TrackedPoint> points, bool last);
  void store(const FrameInput& frame, std::span<const TrackedPoint> points, View& view);
  void note_points(std::span<const TrackedPoint> points, FixedVector<ViewPoint>& noted) const;
  void note_neighbour(int64_t timestamp_ns, std::span<const TrackedPoint> points, Neighbour& neighbour) const;

  const Config& config_;
  WorkMeter& meter_;
  View views_[kMaxInitialKeyframes];
  Neighbour last_;  // the frame before the present one
  int count_ = 0;
  int stride_ = 1;  // frames from one recorded view to the next; doubles whenever the places run out
  int frames_since_view_ = 0;
};

}  // namespace pptam
