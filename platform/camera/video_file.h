// A video file as grey frames, decoded by the programs ffprobe and ffmpeg in processes of their own.
//
// Frames come as they are stored: none are doubled or dropped to even out the frame rate, and a rotation noted in the
// file is not applied, so that a calibration of the stored images fits. With each frame comes its own time; ffmpeg
// tells it through a pipe of its own while it decodes. Only common containers and raw streams are opened, never
// playlists, and nothing but the file itself.
#pragma once

#include <cstdint>
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
  double frames_per_s() const { return frames_per_s_; }            // on average, or assumed
  std::optional<int> frame_count() const { return frame_count_; }  // that the container promises
  bool has_times() const { return has_times_; }                    // false for raw streams such as .h264
  // Slow motion and time lapse, as Android notes them: the rate of recording where it is another one; 0: not known.
  double captured_frames_per_s() const { return captured_frames_per_s_; }
  const std::string& container() const { return container_; }  // as ffmpeg calls it
  const DisplayNote& display() const { return display_; }
  double pixel_aspect() const { return pixel_aspect_; }  // width of a pixel by its height

  // False at the end. stamp_ns is the frame's time in the file, from any origin; without times, and for a frame that
  // has none, it follows from the average rate. Throws InputError after the last good frame when the file is truncated
  // or corrupt, or the decoder stands still.
  bool read(GreyPixels* image, int64_t* stamp_ns);
  // About the frames read so far.
  std::vector<std::string> remarks() const;

 private:
  void read_probe(const std::filesystem::path& file, std::vector<std::string>* warnings);
  int64_t next_stamp();
  void check_end(size_t bytes_of_last_frame);

  std::string name_;
  std::string container_;
  int width_ = 0;
  int height_ = 0;
  double frames_per_s_ = 0;
  double captured_frames_per_s_ = 0;
  double duration_s_ = 0;  // of the images, as the container says; 0: unknown
  std::optional<int> frame_count_;
  bool counted_ = false;  // frame_count_ is a count of frames, no estimate
  bool has_times_ = true;
  bool container_crops_ = false;  // asks to cut off borders; the codec's own crop belongs to how images are stored
  DisplayNote display_;
  double pixel_aspect_ = 1;
  int frames_read_ = 0;
  int64_t first_ns_ = 0;
  int64_t last_ns_ = 0;
  int untimed_ = 0;                        // frames without a time
  int format_change_ = 0;                  // the first frame of another size or format, counted from 1; 0: none
  std::string damage_;                     // that ffmpeg reported though it read to the end
  std::unique_ptr<ChildProcess> decoder_;  // null once the end is reached
};

}  // namespace pptam::platform
