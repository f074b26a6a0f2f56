#include "tracking/view_recorder.h"

#include <algorithm>
#include <utility>

namespace pptam {

namespace {

// Views that are always recorded: two give no map that tells structure from the shutter's distortion. Not swept.
constexpr int kMinPlaces = 3;
constexpr int64_t kNoteInstructions = 5;  // to copy one point: an estimate

}  // namespace

ViewRecorder::ViewRecorder(Arena& arena, const Config& config, WorkMeter& meter)
    : config_(config),
      meter_(meter),
      // Leaves half of the keyframes for the map to grow.
      places_(std::min(kMaxInitialKeyframes, std::max(kMinPlaces, config.max_keyframes / 2))) {
  for (View& view : std::span(views_).first(static_cast<size_t>(places_))) {
    for (FixedVector<ViewPoint>* points : {&view.points, &view.before.points, &view.after.points})
      *points = FixedVector<ViewPoint>(arena, config.max_initial_points);
    view.frame = Keyframe(arena, config.camera.model);
  }
  last_.points = FixedVector<ViewPoint>(arena, config.max_initial_points);
}

void ViewRecorder::note_points(std::span<const TrackedPoint> points, FixedVector<ViewPoint>& noted) const {
  noted.clear();
  for (const TrackedPoint& point : points) noted.push_back({point.px_2, point.found});
  meter_.charge(Work::kOther, kNoteInstructions * noted.size());
}

void ViewRecorder::note_neighbour(int64_t timestamp_ns, std::span<const TrackedPoint> points,
                                  Neighbour& neighbour) const {
  neighbour.known = true;
  neighbour.timestamp_ns = timestamp_ns;
  note_points(points, neighbour.points);
}

void ViewRecorder::store(const FrameInput& frame, std::span<const TrackedPoint> points, View& view) {
  view.frame.timestamp_ns = frame.timestamp_ns();
  view.frame.set_images(frame.pyramid(), frame.small());
  note_points(points, view.points);
  std::swap(view.before, last_);
  view.after.known = false;
  const CameraModel& model = config_.camera.model;
  // A pyramid has 4/3 of level 0's pixels, and two of them are a unit.
  meter_.charge(Work::kKeyframePixel, static_cast<int64_t>(model.width) * model.height * 2 / 3);
}

void ViewRecorder::start(const FrameInput& frame, std::span<const TrackedPoint> points) {
  count_ = 0;
  stride_ = 1;
  last_.known = false;
  store(frame, points, views_[count_++]);
  frames_since_view_ = 0;
}

void ViewRecorder::note_last(bool good, int64_t timestamp_ns, std::span<const TrackedPoint> points) {
  last_.known = false;
  if (good) note_neighbour(timestamp_ns, points, last_);
}

void ViewRecorder::note(const FrameInput& frame, std::span<const TrackedPoint> points, bool sharp) {
  View& newest = views_[count_ - 1];
  if (last_.known && newest.frame.timestamp_ns == last_.timestamp_ns)
    note_neighbour(frame.timestamp_ns(), points, newest.after);
  if (sharp) record(frame, points, false);  // a blurred view makes a poor keyframe
}

// When the places run out every second view is dropped and the stride doubles, so that the views stay spread over the
// whole path.
void ViewRecorder::record(const FrameInput& frame, std::span<const TrackedPoint> points, bool last) {
  if (views_[count_ - 1].frame.timestamp_ns == frame.timestamp_ns()) return;
  ++frames_since_view_;
  if (!last && frames_since_view_ < stride_) return;
  if (count_ == places_ && !last) {
    for (int i = 1; 2 * i < places_; ++i) std::swap(views_[i], views_[2 * i]);
    count_ = (places_ + 1) / 2;
    stride_ *= 2;
    if (frames_since_view_ < stride_) return;
  }
  if (count_ == places_) --count_;  // the newest view is replaced
  store(frame, points, views_[count_++]);
  frames_since_view_ = 0;
}

}  // namespace pptam
