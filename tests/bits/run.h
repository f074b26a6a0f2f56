// A run of the library on a recorded sequence, with one hash of all that came out, and if wanted the hashes of each
// frame's stages: the same source with an operating system and without.
#pragma once

#include <cstddef>
#include <cstdint>

#include <pocket_ptam/pocket_ptam_c.h>

namespace pptam::test {

// What tracks a recording.
enum class Tracked : int32_t {
  kBoard,   // the phone profile with fewer keyframes: a board with 8 MB of external memory
  kTiny,    // the tiny profile
  kPhone,   // the phone profile
  kModel,   // the model tracker, of the object in known_object()
  kDesktop  // the desktop profile
};

// A recording begins with this, as it stands in memory; then comes each frame: its timestamp in nanoseconds, 8 bytes,
// and its grey pixels. All processors here are little-endian and have the same structures.
struct RecordingHead {
  pptam_camera camera;
  float exposure_s;
  int32_t frames;
  Tracked tracked;
  int32_t tells_stages;  // whether each frame's line is to be said
  pptam_pose start;      // of kModel: the object in the first frame
};

// What the run needs of its surroundings.
struct Surroundings {
  bool (*read)(void* to, size_t bytes);  // the next bytes of the recording; false: there are no more
  void (*say)(const char* text);
  void* block;  // for the library and what looks at its stages, aligned as by malloc
  size_t block_bytes;
  uint8_t* image;  // for a frame
  size_t image_bytes;
};

// Enough for every recording but the desktop profile's, and for that one, too.
constexpr size_t kBlockBytes = size_t{14} << 20, kImageBytes = 320 * 240;
constexpr size_t kDesktopBlockBytes = size_t{72} << 20, kDesktopImageBytes = 640 * 480;

// A box with a bar and a ball, which model trackers are told of.
pptam_object_arrays known_object();

// Tracks the recording, mapping for a while after each frame. Says the size of the library's block, which depends on
// that of a pointer; of each frame, if the recording wants it,
//
//   frame 12 pyramid 0123abcd rotation ... corners ... predict ... search ... pose ... map ... by insert adjust
//
// the hash of what each stage of it gave, in the order in which one needs the other (a stage without a part in the
// frame has 0), and what mapping did; and last how many poses and keyframes there are, and the hashes of all results
// and of the map. changed_frame: in which one pixel is inverted; -1: none. 0 when it went well.
int run_recording(const Surroundings& around, int changed_frame);

}  // namespace pptam::test
