// The pictures of run/composer.h, drawn off-screen, as a video and stills. overlay.mp4 keeps the source's time: a
// dropped frame repeats the picture before it.
#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "platform/camera.h"
#include "platform/run/run_log.h"

namespace pptam::platform {

class Overlay {
 public:
  // video: the file to encode into, MP4 whatever its name. Without ffmpeg there are only the stills, and a warning.
  // Throws InputError where nothing can be drawn: without EGL.
  Overlay(const CameraInfo& camera, const std::filesystem::path& video, std::vector<std::string>* warnings);
  ~Overlay();
  Overlay(const Overlay&) = delete;
  Overlay& operator=(const Overlay&) = delete;

  // Throws InputError when the video cannot go on.
  void add(const Frame& frame, const TrackResult& result, const FrameLog& log);
  // Closes the video; false: there is none. Throws InputError when it failed.
  bool finish();
  // As PNG files; empty when there was no such view.
  std::string start_png() const;  // the last view of the initialisation
  std::string good_png() const;   // a good view from the second half

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace pptam::platform
