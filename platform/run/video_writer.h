// Pictures with timestamps into a video file of a constant rate, encoded by the program ffmpeg.
//
// The file keeps the pictures' time: where some are missing the one before is repeated.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "platform/child_process.h"

namespace pptam::platform {

class VideoWriter {
 public:
  // width and height are even; the file becomes an MP4 whatever its name. Without ffmpeg nothing is written, and
  // warnings says so.
  VideoWriter(const std::filesystem::path& file, int width, int height, double fps, std::vector<std::string>* warnings);

  // Rows of red, green, blue, alpha; every picture has the same stride, width times 4.
  // Throws InputError when ffmpeg has failed.
  void add(const unsigned char* pixels, size_t stride_bytes, int64_t timestamp_ns);
  bool finish();  // false: there is no video. Throws InputError when ffmpeg has failed

 private:
  [[noreturn]] void break_off();  // ends an encoder that takes no more; throws InputError

  int height_;
  double fps_;
  std::unique_ptr<ChildProcess> encoder_;  // null: there is none, or it has ended
  std::vector<unsigned char> previous_;
  int64_t first_ns_ = 0;
  int64_t encoded_ = 0;  // pictures
  int64_t skipped_ = 0;  // pictures of long pauses that were left out
  bool whole_ = false;
};

}  // namespace pptam::platform
