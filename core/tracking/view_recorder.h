// Records views during a start; they become the keyframes of the initial map. Beyond the paper, which keeps two or
// three: two views cannot tell structure from the shutter's distortion, several can. With each view the points found in
// the frames before and after it are kept, which give the camera's velocity [phone 6].
#pragma once

#include <span>

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

  // Takes the first view.
  void start(const FrameInput& frame, std::span<const TrackedPoint> points);
  // To be called at each frame, before its points are tracked: keeps the last frame's points, if that frame was good.
  void note_last(bool good, int64_t timestamp_ns, std::span<const TrackedPoint> points);
  // To be called after a frame was tracked well: every stride-th sharp frame becomes a view.
  void note(const FrameInput& frame, std::span<const TrackedPoint> points, bool sharp);
  // Takes the last view; it replaces another one when all places are taken.
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
  const int places_;  // that are used of views_; the others have no memory
  View views_[kMaxInitialKeyframes];
  Neighbour last_;  // points of the frame before the present one
  int count_ = 0;
  int stride_ = 1;  // sharp frames from one recorded view to the next
  int frames_since_view_ = 0;
};

}  // namespace pptam
