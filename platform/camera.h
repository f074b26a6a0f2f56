// What every source of images implements: recorded sequences, real cameras and the emulated phone.
//
// platform/README.md draws its states: opened, ready, streaming, unplugged, end. Errors are InputErrors of one line
// that say what to do. They are thrown while opening, by configure() and by start(); a source of files that breaks
// throws from wait(), and frames delivered so far remain good. A device that fails while it streams is kUnplugged, with
// the reason in CameraStatus::trouble: it is looked for until it is there again.
#pragma once

#include <cstdint>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include <pocket_ptam/pocket_ptam.h>
#include "platform/camera_picture.h"
#include "platform/input_error.h"
#include "platform/trajectory.h"

namespace pptam::platform {

struct CameraInfo {
  CameraModel model;               // of the images delivered (after rotation, cropping and resizing)
  RollingShutter shutter;          // likewise
  float exposure_s = 0;            // 0: unknown
  double frames_per_s = 0;         // nominal
  std::optional<int> frame_count;  // known length, for progress
  std::string name;                // for reports: "tag_desk", "desk, seed 3"
};

// A format and size that a device offers.
struct CameraMode {
  std::string format;  // four characters, as the driver's: "YUYV"
  int width = 0;       // pixels
  int height = 0;
  std::vector<double> frames_per_s;  // falling; empty: unknown
};

struct CameraDescription {
  std::string address;  // as --camera takes it
  std::string name;
  std::string driver;
  std::vector<CameraMode> modes;
};

// What is wanted of a device; zeros and an empty format: whatever suits.
struct CameraRequest {
  int width = 0;  // of the device's images, pixels
  int height = 0;
  double frames_per_s = 0;
  std::string format;
};

enum class ConfigurationAnswer { kValid, kAdjusted, kInvalid };

struct Configuration {
  ConfigurationAnswer answer = ConfigurationAnswer::kValid;
  CameraMode mode;   // what it is now; of kInvalid, what it was
  std::string text;  // what was adjusted, and to what; or why it is invalid
};

enum class CameraEvent { kFrame, kTimeout, kEnd, kUnplugged, kReplugged };

// How the source has fared so far.
struct CameraStatus {
  int64_t arrived_ns = 0;  // when the last frame's last line was read out, CLOCK_MONOTONIC; 0: not a live source
  int64_t frames = 0;      // delivered
  int64_t dropped = 0;     // a newer one was there already
  int64_t missed = 0;      // gaps in the driver's numbers
  int64_t broken = 0;      // erroneous, incomplete, or with a time that did not advance
  int unplugged = 0;       // times
  std::string trouble;     // of the last kUnplugged: one line
  std::string clock;       // whose times they are
  std::vector<std::string> locks;  // what of the sensor was locked and what not, a line each; before: empty
};

class Camera {
 public:
  static constexpr int64_t kForEver = std::numeric_limits<int64_t>::max();

  virtual ~Camera() = default;
  virtual const CameraInfo& info() const = 0;

  virtual CameraDescription describe() const {
    const CameraInfo& known = info();
    return {"", known.name, "", {{"GREY", known.model.width, known.model.height, {known.frames_per_s}}}};
  }
  // Not while streaming. Afterwards info() is that of the new images.
  virtual Configuration configure(const CameraRequest& wanted) {
    const CameraMode mode = describe().modes.front();
    const bool same = (wanted.width == 0 || (wanted.width == mode.width && wanted.height == mode.height)) &&
                      (wanted.format.empty() || wanted.format == mode.format);
    if (same) return {ConfigurationAnswer::kValid, mode, ""};
    return {ConfigurationAnswer::kInvalid, mode, info().name + ": its images are as they are"};
  }
  virtual void start() {}
  virtual void stop() {}

  // Waits for a frame until deadline_ns (CLOCK_MONOTONIC; in the past: does not wait). The newest frame wins, and older
  // ones are counted as dropped. The frame's pixels stay valid until give_back() or the next wait(). Sources of files
  // always have the next one: they are neither late nor do they drop any. A signal ends the waiting, too.
  virtual CameraEvent wait(Frame* frame, int64_t deadline_ns) = 0;
  // Of the frame last delivered: the device may fill its buffer again.
  virtual void give_back() {}

  // Of the frame last delivered, while its pixels are valid: the image that it was made of, with its colours. False:
  // there is none.
  virtual bool picture(Picture* /*picture*/) const { return false; }

  virtual CameraStatus status() const { return {}; }

  // Camera-to-world poses with the frames' time base, empty when unknown.
  virtual Trajectory ground_truth() const { return {}; }

  // One-line warnings about the frames delivered so far, such as times that ran backwards; asked for at a run's end.
  virtual std::vector<std::string> remarks() const { return {}; }

  // The next frame of a source of files; false at the end.
  bool read(Frame* frame) {
    for (;;) {
      const CameraEvent event = wait(frame, kForEver);
      if (event == CameraEvent::kFrame || event == CameraEvent::kEnd) return event == CameraEvent::kFrame;
    }
  }
};

}  // namespace pptam::platform
