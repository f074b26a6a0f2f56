// The camera's image with a known object's contours drawn over it, the edges that were found, and a pyramid that stands
// on one of the object's faces, as a video and a still.
//
// Colours as in [vvs figure 7]: inliers red, rejected by the local test white, rejected by the robust one green; the
// model's contours blue.
#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include <pocket_ptam/model_tracker.h>
#include "platform/camera.h"

namespace pptam::platform {

class ModelOverlay {
 public:
  // model: must outlive this. video: the file to encode into, MP4 whatever its name. Without ffmpeg there is only the
  // still, and a warning.
  ModelOverlay(const CameraInfo& camera, const ObjectModel& model, const std::filesystem::path& video,
               std::vector<std::string>* warnings);
  ~ModelOverlay();
  ModelOverlay(const ModelOverlay&) = delete;
  ModelOverlay& operator=(const ModelOverlay&) = delete;

  // Throws InputError when the video cannot go on.
  void add(const Frame& frame, const ModelResult& result);
  // Closes the video; false: there is none. Throws InputError when it failed.
  bool finish();
  // As a PNG file, of a tracked frame from the second half; empty when there was none.
  std::string good_png() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace pptam::platform
