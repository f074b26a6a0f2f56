// A run of the library by its C interface on a recorded sequence: the same source with an operating system and without.
#pragma once

#include <cstddef>
#include <cstdint>

#include <pocket_ptam/pocket_ptam_c.h>

namespace pptam::test {

// A recording begins with this, as it stands in memory; then comes each frame: its timestamp in nanoseconds, 8 bytes,
// and its grey pixels. All processors here are little-endian and have the same structures.
struct RecordingHead {
  pptam_camera camera;
  float exposure_s;
  int32_t frames;
};

// What the run needs of its surroundings.
struct Surroundings {
  bool (*read)(void* to, size_t bytes);  // the next bytes of the recording; false: there are no more
  void (*say)(const char* text);
  void* block;  // for the library, aligned as by malloc
  size_t block_bytes;
  uint8_t* image;  // for a frame
  size_t image_bytes;
};

// Tracks the recording, mapping for a while after each frame, and says two lines: the size of the library's block,
// which depends on that of a pointer; how many poses and keyframes there are, and the hashes of all results and of the
// map. changed_frame: in which one pixel is inverted; -1: none. 0 when it went well.
int run_recording(const Surroundings& around, int changed_frame);

}  // namespace pptam::test
