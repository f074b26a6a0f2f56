#include "platform/camera/device_camera.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <iterator>
#include <tuple>
#include <utility>

#include "platform/camera/calibration.h"
#include "platform/camera/image_reduction.h"
#include "platform/camera/luminance.h"
#include "platform/text.h"

namespace pptam::platform {
namespace {

constexpr int kTrackedLonger = 320;  // pixels: the phone's image, which the tracker is made for
constexpr int kTrackedShorter = 240;
constexpr double kUsualFps = 30;
constexpr double kRateTolerance = 0.02;  // 30 may be 29.97

constexpr int64_t kMs = 1'000'000;
constexpr int64_t kStall_ns = 1500 * kMs;      // without a usable frame: it has failed, which is to be told within 2 s
constexpr int64_t kSlowStart_ns = 1900 * kMs;  // the same for the first frame: sensors take up to a second to start
constexpr int64_t kSettle_ns = 700 * kMs;      // for the device's own exposure control to find its values; not swept
constexpr int64_t kRetry_ns = 200 * kMs;       // between two looks for a device that has gone
constexpr int kMostBuffers = 32;               // taken at once; V4L2 has no more

std::string sides_text(int width, int height) {
  return std::to_string(width) + "x" + std::to_string(height);
}

double nearest_rate(const CameraMode& mode, double wanted) {
  double best = 0;
  for (const double rate : mode.frames_per_s) {
    if (best == 0 || std::abs(rate - wanted) < std::abs(best - wanted)) best = rate;
  }
  return best;
}

bool is_upright(int rotate_degrees) {
  return rotate_degrees % 180 != 0;
}

bool same_shape(const CameraModel& model, int width, int height) {
  return int64_t{model.width} * height == int64_t{model.height} * width;
}

// What the calibration of the device's images is, from that of images of perhaps another size.
CameraModel reduced_model(const CameraModel& calibrated, const CameraMode& mode, const ImageReduction& reduction,
                          const std::string& file, std::vector<std::string>* warnings) {
  const auto scaled = [&](int width, int height) {
    CameraModel model = calibrated;
    const double s = static_cast<double>(width) / calibrated.width;
    model.width = width;
    model.height = height;
    model.fx = static_cast<float>(s * static_cast<double>(calibrated.fx));
    model.fy = static_cast<float>(s * static_cast<double>(calibrated.fy));
    model.cx = static_cast<float>(s * (static_cast<double>(calibrated.cx) + 0.5) - 0.5);
    model.cy = static_cast<float>(s * (static_cast<double>(calibrated.cy) + 0.5) - 0.5);
    return model;
  };
  if (calibrated.width == mode.width && calibrated.height == mode.height) return reduction.model(calibrated);
  const std::string sizes = "calibration " + file + " is for images of " +
                            sides_text(calibrated.width, calibrated.height) + ", the camera's are " +
                            sides_text(mode.width, mode.height);
  if (same_shape(calibrated, mode.width, mode.height)) {
    if (warnings) warnings->push_back(sizes + ": taken as the same view, scaled");
    return reduction.model(scaled(mode.width, mode.height));
  }
  const int width = reduction.cropped_width();
  const int height = reduction.cropped_height();
  if (same_shape(calibrated, width, height)) {
    if (warnings) warnings->push_back(sizes + ": taken as that of their middle, " + sides_text(width, height));
    return reduction.model_of_cropped(scaled(width, height));
  }
  throw InputError(sizes + ": calibrate at that size, or choose it with --mode");
}

class DeviceCamera : public Camera {
 public:
  DeviceCamera(std::unique_ptr<CameraDevice> device, DeviceOptions options, std::vector<std::string>* warnings)
      : device_(std::move(device)), options_(std::move(options)), description_(device_->describe()) {
    const Configuration configuration = set_up(options_.request, warnings);
    if (configuration.answer == ConfigurationAnswer::kInvalid) throw InputError(configuration.text);
    if (configuration.answer == ConfigurationAnswer::kAdjusted && warnings) warnings->push_back(configuration.text);
  }
  ~DeviceCamera() override { device_->stop(); }

  const CameraInfo& info() const override { return info_; }
  CameraDescription describe() const override { return description_; }
  Configuration configure(const CameraRequest& wanted) override { return set_up(wanted, nullptr); }

  void start() override {
    locked_ = false;  // stop() has put the sensor back
    device_->prepare(options_.sensor);
    device_->start();
    state_ = State::kStarting;
    heard_ns_ = device_->now_ns();
    settle_until_ns_ = heard_ns_ + (device_->can_lock() ? kSettle_ns : 0);
    if (options_.sensor.exposure_s > 0 && !device_->can_lock()) lock();
  }
  void stop() override {
    give_back();
    device_->stop();
    state_ = State::kStopped;
  }

  CameraEvent wait(Frame* frame, int64_t deadline_ns) override;
  void give_back() override {
    if (held_.buffer < 0) return;
    const int buffer = std::exchange(held_.buffer, -1);
    try {
      device_->give_back(buffer);
    } catch (const InputError&) {  // seen again by the next wait()
    }
  }
  bool picture(Picture* picture) const override;
  CameraStatus status() const override {
    CameraStatus status = status_;
    status.clock = device_->clock();
    return status;
  }
  std::vector<std::string> remarks() const override;

 private:
  enum class State { kStopped, kStarting, kStreaming, kGone, kReturning };

  Configuration set_up(const CameraRequest& wanted, std::vector<std::string>* warnings);
  void make_info(const CameraMode& mode, std::vector<std::string>* warnings);
  void lock();
  void adopt_readout(double readout_s);
  bool take_newest();
  bool use(const DeviceFrame& raw, Frame* frame);
  CameraEvent lose(const std::string& why);
  CameraEvent look_again(int64_t deadline_ns);
  bool broken(const std::string& why);

  std::unique_ptr<CameraDevice> device_;
  DeviceOptions options_;
  CameraDescription description_;
  std::optional<ImageReduction> reduction_;
  CameraInfo info_;
  CameraStatus status_;
  Luminance luminance_;
  State state_ = State::kStopped;
  DeviceFrame held_;  // buffer -1: none
  bool locked_ = false;
  double readout_s_ = 0;                      // of the device's whole image, not signed
  int source_width_ = 0, source_height_ = 0;  // what the reduction is for
  int64_t settle_until_ns_ = 0;
  int64_t heard_ns_ = 0;  // when the last usable frame came
  int64_t look_ns_ = 0;   // when a device that has gone is looked for again
  int64_t last_sequence_ = -1;
  std::optional<int64_t> last_timestamp_ns_;
  std::string last_broken_;  // why the last broken one was
};

Configuration DeviceCamera::set_up(const CameraRequest& wanted, std::vector<std::string>* warnings) {
  if (state_ != State::kStopped) throw InputError(description_.address + ": stop it before it is configured");
  int width = options_.width;
  int height = options_.height;
  if (width == 0 || height == 0) {
    width = is_upright(options_.rotate_degrees) ? kTrackedShorter : kTrackedLonger;
    height = is_upright(options_.rotate_degrees) ? kTrackedLonger : kTrackedShorter;
  }
  Calibration calibration;
  if (!options_.calibration.empty()) calibration = read_calibration(options_.calibration, nullptr);
  int source_width = width;
  int source_height = height;
  if (is_upright(options_.rotate_degrees)) std::swap(source_width, source_height);
  const CameraMode* chosen = choose_mode(description_.modes, wanted, source_width, source_height,
                                         calibration.model.width, calibration.model.height);
  CameraRequest request = wanted;
  if (chosen != nullptr) {
    request.width = chosen->width;
    request.height = chosen->height;
    request.format = chosen->format;
    if (request.frames_per_s == 0) request.frames_per_s = nearest_rate(*chosen, kUsualFps);
  }
  if (request.frames_per_s == 0) request.frames_per_s = kUsualFps;
  Configuration configuration = device_->configure(request);
  if (configuration.answer == ConfigurationAnswer::kInvalid) return configuration;
  reduction_.emplace(configuration.mode.width, configuration.mode.height, options_.rotate_degrees, width, height);
  make_info(configuration.mode, warnings);
  return configuration;
}

void DeviceCamera::make_info(const CameraMode& mode, std::vector<std::string>* warnings) {
  const std::string& name = description_.address;
  Calibration calibration;
  if (!options_.calibration.empty()) {
    calibration = read_calibration(options_.calibration, warnings);
    info_.model = reduced_model(calibration.model, mode, *reduction_, options_.calibration.string(), warnings);
  } else if (options_.fov_degrees > 0) {
    calibration = guess_calibration(mode.width, mode.height, options_.fov_degrees);
    info_.model = reduction_->model(calibration.model);
    if (warnings) {
      warnings->push_back(format("%s: no calibration: assuming a field of view of %.4g degrees and no distortion",
                                 name.c_str(), options_.fov_degrees));
    }
  } else {
    throw InputError("no calibration for " + name +
                     ": give --calibration FILE, or for a first try --fov DEGREES, the horizontal field of view (60 "
                     "is usual of webcams)");
  }
  const Status status = info_.model.validate();
  if (!status.ok()) throw InputError(name + ": its images cannot be used: " + status.message());
  info_.model.prepare();
  const bool rows = options_.readout_axis.value_or(calibration.shutter.axis) == RollingShutter::Axis::kRows;
  const bool calibrated_rows = calibration.shutter.axis == RollingShutter::Axis::kRows;
  double calibrated_s = static_cast<double>(calibration.shutter.line_time_s) *
                        (calibrated_rows ? calibration.model.height : calibration.model.width);
  if (!same_shape(calibration.model, mode.width, mode.height)) {  // it is that of the middle
    calibrated_s *= calibrated_rows ? static_cast<double>(mode.height) / reduction_->cropped_height()
                                    : static_cast<double>(mode.width) / reduction_->cropped_width();
  }
  const double readout_s = options_.readout_s.value_or(calibrated_s);
  RollingShutter shutter;
  shutter.axis = rows ? RollingShutter::Axis::kRows : RollingShutter::Axis::kColumns;
  shutter.line_time_s = static_cast<float>(readout_s / (rows ? mode.height : mode.width));
  readout_s_ = std::abs(readout_s);
  source_width_ = mode.width;
  source_height_ = mode.height;
  info_.shutter = reduction_->shutter(shutter);
  info_.exposure_s = static_cast<float>(options_.sensor.exposure_s);
  if (info_.exposure_s == 0) info_.exposure_s = calibration.exposure_s;
  info_.frames_per_s = mode.frames_per_s.empty() ? 0 : mode.frames_per_s.front();
  info_.name = description_.name.empty() ? name : description_.name;
}

void DeviceCamera::lock() {
  status_.locks = device_->lock(options_.sensor);
  locked_ = true;
  if (device_->exposure_s() > 0) info_.exposure_s = static_cast<float>(device_->exposure_s());
}

// As the device reports it, when nobody has said it.
void DeviceCamera::adopt_readout(double readout_s) {
  if (readout_s <= 0 || readout_s_ > 0) return;
  readout_s_ = readout_s;
  info_.shutter =
      reduction_->shutter({RollingShutter::Axis::kRows, static_cast<float>(readout_s / std::max(1, source_height_))});
}

bool DeviceCamera::broken(const std::string& why) {
  ++status_.broken;
  last_broken_ = why;
  return false;
}

// Into held_.
bool DeviceCamera::take_newest() {
  DeviceFrame next;
  for (int i = 0; i < kMostBuffers && device_->take(&next); ++i) {
    if (next.sequence >= 0 && last_sequence_ >= 0 && next.sequence > last_sequence_ + 1)
      status_.missed += next.sequence - last_sequence_ - 1;
    if (next.sequence >= 0) last_sequence_ = next.sequence;
    if (next.broken) {
      broken("the driver says that it is erroneous");
      device_->give_back(next.buffer);
      continue;
    }
    if (held_.buffer >= 0) {
      ++status_.dropped;
      give_back();
    }
    held_ = next;
  }
  return held_.buffer >= 0;
}

// The frame in held_, as it is tracked.
bool DeviceCamera::use(const DeviceFrame& raw, Frame* frame) {
  if (raw.width != source_width_ || raw.height != source_height_)
    return broken("its images are " + sides_text(raw.width, raw.height) + " now");
  GreyView view;
  if (!luminance_.read(raw, &view)) return broken(luminance_.trouble());
  if (state_ == State::kStarting) adopt_readout(raw.readout_s);
  view = reduction_->apply(view);
  const double exposure_s = raw.exposure_s > 0 ? raw.exposure_s : static_cast<double>(info_.exposure_s);
  const double readout_s = readout_s_ > 0 ? readout_s_ : raw.readout_s;
  const int64_t timestamp_ns = mid_exposure_ns(raw.stamp, raw.stamp_ns, exposure_s, readout_s);
  if (last_timestamp_ns_ && timestamp_ns <= *last_timestamp_ns_) return broken("its time does not advance");
  last_timestamp_ns_ = timestamp_ns;
  *frame = {view.data, view.width, view.height, view.stride, PixelFormat::kGrey, timestamp_ns};
  // Not later than it is seen, whatever the exposure and readout were said to be.
  status_.arrived_ns = std::min(last_line_ns(raw.stamp, raw.stamp_ns, exposure_s, readout_s), device_->now_ns());
  return true;
}

bool DeviceCamera::picture(Picture* picture) const {
  const bool packed = held_.layout == PixelLayout::kYuyv;
  if (held_.buffer < 0 || (!packed && held_.chroma[0] == nullptr)) return false;
  const PixelFormat planar = held_.chroma[1] != nullptr ? PixelFormat::kI420 : PixelFormat::kNv12;
  *picture = {};
  picture->frame = {held_.data, held_.width, held_.height, held_.stride, packed ? PixelFormat::kYuyv : planar, 0};
  std::copy(std::begin(held_.chroma), std::end(held_.chroma), picture->chroma);
  picture->chroma_stride_bytes = held_.chroma_stride;
  picture->x = reduction_->crop_x();
  picture->y = reduction_->crop_y();
  picture->width = reduction_->cropped_width();
  picture->height = reduction_->cropped_height();
  picture->turn_degrees = options_.rotate_degrees;
  return true;
}

CameraEvent DeviceCamera::lose(const std::string& why) {
  held_.buffer = -1;
  device_->stop();
  const bool told = state_ == State::kReturning;  // it never was back
  state_ = State::kGone;
  look_ns_ = device_->now_ns() + kRetry_ns;
  if (told) return CameraEvent::kTimeout;
  ++status_.unplugged;
  status_.trouble = why;
  return CameraEvent::kUnplugged;
}

CameraEvent DeviceCamera::look_again(int64_t deadline_ns) {
  for (;;) {
    const int64_t now_ns = device_->now_ns();
    if (now_ns >= look_ns_) {
      look_ns_ = now_ns + kRetry_ns;
      try {
        if (device_->find_again()) {
          device_->start();
          if (locked_) lock();
          state_ = State::kReturning;
          heard_ns_ = device_->now_ns();
          last_sequence_ = -1;
          return CameraEvent::kTimeout;  // until its first frame has come
        }
      } catch (const InputError&) {  // not yet
        device_->stop();
      }
    }
    if (now_ns >= deadline_ns) return CameraEvent::kTimeout;
    if (device_->wait(std::min(deadline_ns, look_ns_)) == CameraDevice::Wake::kSignal) return CameraEvent::kTimeout;
  }
}

CameraEvent DeviceCamera::wait(Frame* frame, int64_t deadline_ns) {
  if (state_ == State::kStopped) throw InputError(description_.address + ": wait() before start()");
  give_back();
  if (state_ == State::kGone) return look_again(deadline_ns);
  try {
    for (;;) {
      if (take_newest()) {
        const int64_t now_ns = device_->now_ns();
        if (use(held_, frame)) {
          heard_ns_ = now_ns;
          if (state_ == State::kReturning) {
            state_ = State::kStreaming;
            give_back();
            return CameraEvent::kReplugged;
          }
          state_ = State::kStreaming;
          if (locked_) {
            ++status_.frames;
            return CameraEvent::kFrame;
          }
        }
        give_back();
        if (!locked_ && now_ns >= settle_until_ns_) {
          lock();  // frames from now on are as they will be
          heard_ns_ = device_->now_ns();
        }
        continue;
      }
      const int64_t now_ns = device_->now_ns();
      const int64_t silent_from_ns = heard_ns_ + (state_ == State::kStreaming ? kStall_ns : kSlowStart_ns);
      if (now_ns >= silent_from_ns) {
        return lose(format("%s: no %sframe for %.1f s", description_.address.c_str(),
                           last_broken_.empty() ? "" : "usable ", 1e-9 * static_cast<double>(now_ns - heard_ns_)) +
                    (last_broken_.empty() ? "" : ", " + last_broken_));
      }
      if (now_ns >= deadline_ns) return CameraEvent::kTimeout;
      if (device_->wait(std::min(deadline_ns, silent_from_ns)) == CameraDevice::Wake::kSignal)
        return CameraEvent::kTimeout;
    }
  } catch (const InputError& error) {
    return lose(error.what());
  }
}

std::vector<std::string> DeviceCamera::remarks() const {
  std::vector<std::string> lines;
  const std::string& name = description_.address;
  if (status_.broken > 0)
    lines.push_back(name +
                    format(": %lld broken frames were left out, the last one because of: ",
                           static_cast<long long>(status_.broken)) +
                    last_broken_);
  if (status_.missed > 0)
    lines.push_back(
        name + format(": %lld frames are missing in the driver's numbers", static_cast<long long>(status_.missed)));
  return lines;
}

}  // namespace

const CameraMode* choose_mode(const std::vector<CameraMode>& modes, const CameraRequest& request, int width, int height,
                              int calibrated_width, int calibrated_height) {
  const double wanted_fps = request.frames_per_s > 0 ? request.frames_per_s : kUsualFps;
  const auto rank = [&](const CameraMode& mode) {
    const bool uncalibrated = mode.width != calibrated_width || mode.height != calibrated_height;
    const double rate = mode.frames_per_s.empty() ? wanted_fps : nearest_rate(mode, wanted_fps);
    const bool slow = rate < wanted_fps * (1 - kRateTolerance);
    const bool small = mode.width < width || mode.height < height;
    const int64_t area = int64_t{mode.width} * mode.height;
    const bool jpeg = mode.format == "MJPG" || mode.format == "JPEG";
    const int cost = jpeg ? 2 : mode.format == "YUYV" ? 1 : 0;
    return std::tuple(uncalibrated, small, slow, small ? -area : area, cost);
  };
  const CameraMode* best = nullptr;
  for (const CameraMode& mode : modes) {
    if (request.width > 0 && (mode.width != request.width || mode.height != request.height)) continue;
    if (!request.format.empty() && mode.format != request.format) continue;
    if (best == nullptr || rank(mode) < rank(*best)) best = &mode;
  }
  return best;
}

std::unique_ptr<Camera> make_device_camera(std::unique_ptr<CameraDevice> device, const DeviceOptions& options,
                                           std::vector<std::string>* warnings) {
  return std::make_unique<DeviceCamera>(std::move(device), options, warnings);
}

}  // namespace pptam::platform
