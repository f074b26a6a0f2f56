// The camera's image with what the tracker saw and a small house standing on the map's ground, as a video and stills.
//
// The house and the ground grid go through the camera model, distortion included, so a wrong pose shows as a house that
// slides. overlay.mp4 keeps the source's time: a dropped frame repeats the picture before it.
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
  // Writes into folder, which exists. Without ffmpeg there are only the stills, and a warning.
  Overlay(const CameraInfo& camera, const std::filesystem::path& folder, std::vector<std::string>* warnings);
  ~Overlay();
  Overlay(const Overlay&) = delete;
  Overlay& operator=(const Overlay&) = delete;

  void add(const Frame& frame, const TrackResult& result, const FrameLog& log);
  // Closes the video and writes start.png (the last view of the initialisation) and overlay.png (a good view from the
  // second half), when there were such views.
  void finish();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace pptam::platform
