// A video file as grey frames, decoded by the programs ffprobe and ffmpeg in processes of their own.
//
// Frames come as they are stored: none are doubled or dropped to even out the frame rate, and a rotation noted in the
// file is not applied (a warning names it), so that a calibration of the stored images fits.
#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "platform/camera/image_files.h"
#include "platform/child_process.h"

namespace pptam::platform {

constexpr double kDefaultFps = 30;  // of videos and images that say nothing about time
constexpr double kMaxFps = 10000;

class VideoFile {
 public:
  // Throws InputError naming the file when it is no video. warnings may be null.
  VideoFile(const std::filesystem::path& file, std::vector<std::string>* warnings);

  int width() const { return width_; }
  int height() const { return height_; }
  double frames_per_s() const { return frames_per_s_; }
  std::optional<int> frame_count() const { return frame_count_; }  // that the container promises

  // False at the end. Throws InputError after the last good frame when the file is truncated or corrupt.
  bool read(GreyPixels* image);

 private:
  void check_end(size_t bytes_of_last_frame);

  std::string name_;
  int width_ = 0;
  int height_ = 0;
  double frames_per_s_ = 0;
  std::optional<int> frame_count_;
  int frames_read_ = 0;
  std::unique_ptr<ChildProcess> decoder_;  // null once the end is reached
};

}  // namespace pptam::platform
