#include "platform/run/overlay.h"

#include <bit>
#include <cstdint>

#include "platform/display/display.h"
#include "platform/run/composer.h"
#include "platform/run/picture.h"
#include "platform/run/video_writer.h"

namespace pptam::platform {

struct Overlay::Impl {
  Impl(const CameraInfo& camera, const std::filesystem::path& video_file, std::vector<std::string>* warnings)
      : composer(camera),
        canvas(composer.usual_canvas()),
        display(open_offscreen(canvas.width, canvas.height)),
        video(video_file, canvas.width, canvas.height, camera.frames_per_s > 0 ? camera.frames_per_s : 30, warnings) {}

  std::string png(const std::vector<uint8_t>& still) const {
    return still.empty() ? std::string() : png_of_rgba(still, canvas.width, canvas.height);
  }

  Composer composer;
  Canvas canvas;
  std::unique_ptr<Display> display;
  VideoWriter video;
  std::vector<uint8_t> pixels;  // RGBA

  std::vector<uint8_t> start_still, good_still;
  bool seen_tracking = false;
  uint64_t good_views = 0;
};

Overlay::Overlay(const CameraInfo& camera, const std::filesystem::path& video, std::vector<std::string>* warnings)
    : impl_(std::make_unique<Impl>(camera, video, warnings)) {}

Overlay::~Overlay() = default;

void Overlay::add(const Frame& frame, const TrackResult& result, const FrameLog& log) {
  impl_->display->draw(impl_->composer.camera_view({frame}, result, log, impl_->canvas), &impl_->pixels);
  impl_->video.add(impl_->pixels.data(), static_cast<size_t>(impl_->canvas.width) * 4, frame.timestamp_ns);
  if (log.state == TrackingState::kInitialising && !impl_->seen_tracking) impl_->start_still = impl_->pixels;
  if (!result.pose_valid) return;
  impl_->seen_tracking = true;
  // The last power of two among the good views lies in their second half.
  if (result.quality == TrackingQuality::kGood && std::has_single_bit(++impl_->good_views))
    impl_->good_still = impl_->pixels;
}

bool Overlay::finish() {
  return impl_->video.finish();
}

std::string Overlay::start_png() const {
  return impl_->png(impl_->start_still);
}

std::string Overlay::good_png() const {
  return impl_->png(impl_->good_still);
}

}  // namespace pptam::platform
