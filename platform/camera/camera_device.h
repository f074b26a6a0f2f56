// A device as its driver shows it: buffers with raw images, one by one. V4L2 (v4l2_device) and libcamera
// (libcamera_device) implement it, and DeviceCamera makes a Camera of either.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "platform/camera.h"
#include "platform/text.h"

namespace pptam::platform {

enum class PixelLayout {
  kGrey,   // also the first plane of NV12 and YU12
  kYuyv,   // every second byte is luminance
  kMjpeg,  // a JPEG in each buffer
};

// What the driver's time of a frame means.
enum class Stamp {
  kStartOfExposure,  // of the first line
  kStartOfReadout,   // the first line has been exposed
  kEndOfFrame,       // the last line has been read out
  kArrival           // the driver does not say: when the buffer was seen here
};

struct DeviceFrame {
  const uint8_t* data = nullptr;
  size_t bytes = 0;  // filled
  int width = 0;     // pixels
  int height = 0;
  int stride = 0;  // bytes
  PixelLayout layout = PixelLayout::kGrey;
  int64_t stamp_ns = 0;  // CLOCK_MONOTONIC
  Stamp stamp = Stamp::kArrival;
  int64_t sequence = -1;  // the driver's number; -1: none
  double exposure_s = 0;  // of this frame; 0: unknown
  double readout_s = 0;   // from the first line to the last; 0: unknown
  bool broken = false;    // says the driver
  int buffer = -1;        // for give_back()
  // Of NV12 one plane, of YU12 both: half as wide and high, whole. Null: there is none.
  const uint8_t* chroma[2] = {nullptr, nullptr};
  int chroma_stride = 0;  // bytes
};

// The middle of the exposure of the image's centre: of a shutter that rolls over the whole image in readout_s, be it in
// whichever direction, each line exposed for exposure_s.
constexpr int64_t mid_exposure_ns(Stamp stamp, int64_t stamp_ns, double exposure_s, double readout_s) {
  const double after_s = stamp == Stamp::kStartOfExposure  ? exposure_s + readout_s
                         : stamp == Stamp::kStartOfReadout ? readout_s - exposure_s
                                                           : -exposure_s - readout_s;
  return saturated_sum(stamp_ns, static_cast<int64_t>(0.5e9 * after_s + (after_s < 0 ? -0.5 : 0.5)));
}

// When the last line was read out.
constexpr int64_t last_line_ns(Stamp stamp, int64_t stamp_ns, double exposure_s, double readout_s) {
  if (stamp != Stamp::kStartOfExposure && stamp != Stamp::kStartOfReadout) return stamp_ns;
  const double after_s = stamp == Stamp::kStartOfExposure ? exposure_s + readout_s : readout_s;
  return saturated_sum(stamp_ns, static_cast<int64_t>(1e9 * after_s + 0.5));
}

// How the sensor is to be held still.
struct SensorRequest {
  int mains_hz = 0;       // against flicker, 50 or 60; 0: as it is
  double exposure_s = 0;  // 0: what the device's own control has found
};

class CameraDevice {
 public:
  enum class Wake { kReady, kDeadline, kSignal };

  virtual ~CameraDevice() = default;
  // All throw InputError of one line when the device fails or has gone.
  virtual CameraDescription describe() = 0;
  virtual Configuration configure(const CameraRequest& wanted) = 0;
  virtual void start() = 0;
  virtual void stop() noexcept = 0;
  virtual Wake wait(int64_t deadline_ns) = 0;
  virtual bool take(DeviceFrame* frame) = 0;  // the oldest filled buffer; false: none
  virtual void give_back(int buffer) = 0;
  // After a failure: opens the same device again, wherever it is now, with the last configuration. False: not there.
  virtual bool find_again() = 0;

  // Before start(): sets what exposure, gain and white balance are to settle under, the filter and an exposure time.
  virtual void prepare(const SensorRequest& request) = 0;
  // Holds exposure, gain, white balance and focus as they are now; a line for each about what was locked and what not.
  virtual std::vector<std::string> lock(const SensorRequest& request) = 0;
  virtual bool can_lock() const = 0;      // there is something to lock, and hence to wait for
  virtual double exposure_s() const = 0;  // as locked; 0: unknown
  virtual std::string clock() const = 0;  // what its times are: "kernel, end of frame"
  virtual int64_t now_ns() const = 0;     // CLOCK_MONOTONIC

 protected:
  // What a configuration came to, kept for a device that comes back, which is to be the same as before.
  Configuration accept(const CameraRequest& wanted, const Configuration& result) {
    if (result.answer != ConfigurationAnswer::kInvalid)
      accepted_ = {result.mode.width, result.mode.height, wanted.frames_per_s, result.mode.format};
    return result;
  }
  bool as_accepted(const Configuration& result) const {
    return result.answer != ConfigurationAnswer::kInvalid && result.mode.width == accepted_.width &&
           result.mode.height == accepted_.height;
  }

  CameraRequest accepted_;  // by the last configure()
};

// "700x500 YUYV became 640x480 YUYV", of what was wanted only; empty: size and format are so.
inline std::string adjustment(const CameraRequest& wanted, const CameraMode& given) {
  const bool other_width = wanted.width > 0 && wanted.width != given.width;
  const bool other_height = wanted.height > 0 && wanted.height != given.height;
  const bool other_format = !wanted.format.empty() && wanted.format != given.format;
  if (!other_width && !other_height && !other_format) return "";
  const auto text_of = [&](int width, int height, const std::string& name) {
    std::string text;
    if (wanted.width > 0 && wanted.height > 0)
      text = format("%dx%d", width, height);
    else if (wanted.width > 0)
      text = format("width %d", width);
    else if (wanted.height > 0)
      text = format("height %d", height);
    if (!wanted.format.empty()) text += (text.empty() ? "" : " ") + name;
    return text;
  };
  return text_of(wanted.width, wanted.height, wanted.format) + " became " +
         text_of(given.width, given.height, given.format);
}

}  // namespace pptam::platform
