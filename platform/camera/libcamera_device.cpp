// libcamera: sensors with raw images behind an image processor, as those of the Raspberry Pi; and webcams. Its
// viewfinder stream, of which the luminance is used in place. This is a module that camera_list loads when it is asked
// for, so that the program starts without libcamera. One source for 0.0.3 (Debian 12) and 0.4 (Debian 13).

#include <libcamera/libcamera.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <ctime>
#include <deque>
#include <map>
#include <mutex>
#include <optional>
#include <utility>

#include "platform/camera/camera_list.h"
#include "platform/text.h"

namespace pptam::platform {
namespace {

namespace lc = libcamera;

constexpr unsigned kBuffers = 4;  // one is tracked, the others are being filled
constexpr int kLeastSide = 64;    // pixels, as System's
constexpr int kMostSide = 8192;

struct Format {
  const char* libcamera;
  const char* name;  // as V4L2's
  PixelLayout layout;
};
constexpr Format kFormats[] = {{"R8", "GREY", PixelLayout::kGrey},
                               {"NV12", "NV12", PixelLayout::kGrey},
                               {"YUV420", "YU12", PixelLayout::kGrey},
                               {"YUYV", "YUYV", PixelLayout::kYuyv},
                               {"MJPEG", "MJPG", PixelLayout::kMjpeg}};

const Format* format_of(const lc::PixelFormat& pixels) {
  for (const Format& known : kFormats) {
    if (pixels.toString() == known.libcamera) return &known;
  }
  return nullptr;
}

int64_t clock_ns(clockid_t id) {
  timespec time = {};
  ::clock_gettime(id, &time);
  return int64_t{time.tv_sec} * 1'000'000'000 + time.tv_nsec;
}

// libcamera's times are those of CLOCK_BOOTTIME, which also counts while the computer sleeps; drivers give the
// monotonic clock's. What lies in the future cannot be the latter.
int64_t monotonic_of(int64_t stamp_ns) {
  const int64_t now_ns = clock_ns(CLOCK_MONOTONIC);
  return stamp_ns <= now_ns ? stamp_ns : stamp_ns - (clock_ns(CLOCK_BOOTTIME) - now_ns);
}

// One for the whole process: libcamera allows no more. Never stopped, as nothing of it may be used afterwards.
lc::CameraManager& manager() {
  static lc::CameraManager* const started = [] {
    auto made = std::make_unique<lc::CameraManager>();  // a second one beside it would end the program
    const int error = made->start();
    if (error != 0) throw InputError(std::string("libcamera does not start: ") + std::strerror(-error));
    return made.release();
  }();
  return *started;
}

std::string model_of(const lc::Camera& camera) {
  return std::string(camera.properties().get(lc::properties::Model).value_or(camera.id()));
}

std::vector<CameraMode> modes_of(lc::Camera& camera) {
  std::vector<CameraMode> modes;
  const std::unique_ptr<lc::CameraConfiguration> configuration =
      camera.generateConfiguration({lc::StreamRole::Viewfinder});
  if (configuration == nullptr || configuration->empty()) return modes;
  const lc::StreamFormats& formats = configuration->at(0).formats();
  for (const lc::PixelFormat& pixels : formats.pixelformats()) {
    const Format* known = format_of(pixels);
    if (known == nullptr) continue;
    std::vector<lc::Size> sizes = formats.sizes(pixels);
    const lc::SizeRange range = formats.range(pixels);
    for (const lc::Size& usual : {lc::Size(320, 240), lc::Size(640, 480)}) {
      if (range.contains(usual)) sizes.push_back(usual);
    }
    std::sort(sizes.begin(), sizes.end());
    sizes.erase(std::unique(sizes.begin(), sizes.end()), sizes.end());
    for (const lc::Size& size : sizes) {
      const auto width = static_cast<int>(size.width);
      const auto height = static_cast<int>(size.height);
      if (width >= kLeastSide && height >= kLeastSide && width <= kMostSide && height <= kMostSide)
        modes.push_back({known->name, width, height, {}});
    }
  }
  return modes;
}

CameraDescription describe_camera(lc::Camera& camera, size_t index) {
  return {"libcamera:" + std::to_string(index), model_of(camera), "libcamera", modes_of(camera)};
}

class LibcameraDevice : public CameraDevice {
 public:
  explicit LibcameraDevice(const std::string& which) : event_fd_(::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)) {
    try {
      open(which);
    } catch (...) {
      close();
      throw;
    }
  }
  ~LibcameraDevice() override { close(); }

  CameraDescription describe() override { return description_; }
  Configuration configure(const CameraRequest& wanted) override { return accept(wanted, set_format(wanted)); }
  void prepare(const SensorRequest& request) override;
  void start() override;
  void stop() noexcept override;
  Wake wait(int64_t deadline_ns) override;
  bool take(DeviceFrame* frame) override;
  void give_back(int buffer) override;
  bool find_again() override;
  std::vector<std::string> lock(const SensorRequest& request) override;
  bool can_lock() const override { return control("AeEnable") != nullptr || control("AwbEnable") != nullptr; }
  double exposure_s() const override { return exposure_s_; }
  std::string clock() const override { return clock_; }
  int64_t now_ns() const override { return clock_ns(CLOCK_MONOTONIC); }

 private:
  void open(const std::string& which);
  void close() noexcept {
    release();
    ::close(event_fd_);
  }
  Configuration set_format(const CameraRequest& wanted);
  std::string set_filter(int mains_hz);
  void send_rate(double frames_per_s);
  void acquire(std::shared_ptr<lc::Camera> camera);
  void release() noexcept;
  void on_complete(lc::Request* request);
  void on_disconnect();
  void wake() const;
  const lc::ControlId* control(const std::string& name) const;
  // To be sent with the next requests; false: the camera has no such control.
  template <class T>
  bool send(const std::string& name, const T& value);
  void map(const lc::FrameBuffer& buffer);
  void add_chroma(const lc::FrameBuffer& buffer, DeviceFrame* frame) const;

  std::shared_ptr<lc::Camera> camera_;
  CameraDescription description_;
  std::unique_ptr<lc::CameraConfiguration> configuration_;
  std::unique_ptr<lc::FrameBufferAllocator> allocator_;
  std::vector<std::unique_ptr<lc::Request>> requests_;  // by the buffers' numbers
  std::map<const lc::FrameBuffer*, std::pair<void*, size_t>> mapped_;
  const Format* format_ = nullptr;
  lc::ControlList sent_;                // all that was set since the start, for a camera that comes back
  lc::ControlList fresh_;               // not sent yet
  std::optional<int32_t> exposure_us_;  // of the last frame
  std::optional<float> gain_, lens_;
  std::optional<std::array<float, 2>> colours_;
  double exposure_s_ = 0;
  std::string clock_;
  std::string id_;  // of the camera, also while it is gone
  bool streaming_ = false;

  int event_fd_;
  std::mutex mutex_;  // of what follows, which libcamera's thread writes
  std::deque<lc::Request*> completed_;
  bool disconnected_ = false;
};

void LibcameraDevice::open(const std::string& which) {
  const auto cameras = manager().cameras();
  size_t index = 0;
  while (index < cameras.size() && which != std::to_string(index) && which != cameras[index]->id()) ++index;
  if (index == cameras.size()) {
    throw InputError("camera libcamera:" + which + ": there is no such camera, libcamera sees " +
                     std::to_string(cameras.size()) + "; pocket-ptam cameras lists them");
  }
  acquire(cameras[index]);
  description_ = describe_camera(*camera_, index);
  if (description_.modes.empty())
    throw InputError("camera " + description_.address + " offers none of the formats R8, NV12, YUV420, YUYV and MJPEG");
}

void LibcameraDevice::acquire(std::shared_ptr<lc::Camera> camera) {
  const int error = camera->acquire();
  if (error == -EBUSY) throw InputError("camera " + camera->id() + ": another program uses it, end that first");
  if (error != 0) throw InputError("camera " + camera->id() + ": cannot be acquired: " + std::strerror(-error));
  camera_ = std::move(camera);
  id_ = camera_->id();
  {
    const std::lock_guard<std::mutex> hold(mutex_);
    disconnected_ = false;
  }
  camera_->requestCompleted.connect(this, &LibcameraDevice::on_complete);
  camera_->disconnected.connect(this, &LibcameraDevice::on_disconnect);
  sent_ = lc::ControlList(camera_->controls());
  fresh_ = lc::ControlList(camera_->controls());
}

void LibcameraDevice::release() noexcept {
  stop();
  if (camera_ == nullptr) return;
  camera_->requestCompleted.disconnect(this);
  camera_->disconnected.disconnect(this);
  configuration_.reset();
  camera_->release();
  camera_.reset();
}

void LibcameraDevice::wake() const {
  const uint64_t one = 1;
  if (::write(event_fd_, &one, sizeof one) < 0) return;  // it is awake already
}

void LibcameraDevice::on_complete(lc::Request* request) {
  const std::lock_guard<std::mutex> hold(mutex_);
  completed_.push_back(request);
  wake();
}

void LibcameraDevice::on_disconnect() {
  const std::lock_guard<std::mutex> hold(mutex_);
  disconnected_ = true;
  wake();
}

const lc::ControlId* LibcameraDevice::control(const std::string& name) const {
  for (const auto& [id, info] : camera_->controls()) {
    if (id->name() == name) return id;
  }
  return nullptr;
}

template <class T>
bool LibcameraDevice::send(const std::string& name, const T& value) {
  const lc::ControlId* id = control(name);
  if (id == nullptr) return false;
  lc::ControlValue boxed;
  boxed.set(value);
  for (lc::ControlList* list : {&sent_, &fresh_}) list->set(id->id(), boxed);
  return true;
}

Configuration LibcameraDevice::set_format(const CameraRequest& wanted) {
  Configuration result;
  configuration_ = camera_->generateConfiguration({lc::StreamRole::Viewfinder});
  const auto invalid = [&](const std::string& why) {
    result.answer = ConfigurationAnswer::kInvalid;
    result.text = description_.address + ": " + why;
    return result;
  };
  if (configuration_ == nullptr || configuration_->empty()) return invalid("has no viewfinder stream");
  lc::StreamConfiguration& stream = configuration_->at(0);
  if (wanted.width > 0 && wanted.height > 0)
    stream.size = lc::Size(static_cast<unsigned>(wanted.width), static_cast<unsigned>(wanted.height));
  for (const Format& known : kFormats) {
    if (wanted.format == known.name) stream.pixelFormat = lc::PixelFormat::fromString(known.libcamera);
  }
  stream.bufferCount = kBuffers;
#if LIBCAMERA_VERSION_MAJOR > 0 || LIBCAMERA_VERSION_MINOR >= 2
  configuration_->orientation = lc::Orientation::Rotate0;
#else
  configuration_->transform = lc::Transform::Identity;
#endif
  if (configuration_->validate() == lc::CameraConfiguration::Invalid)
    return invalid(format("%dx%d %s is refused", wanted.width, wanted.height, wanted.format.c_str()));
  const Format* given = format_of(stream.pixelFormat);
  if (given == nullptr) return invalid("its format is " + stream.pixelFormat.toString() + ", which cannot be read");
  const int error = camera_->configure(configuration_.get());
  if (error != 0) throw InputError(description_.address + ": cannot be configured: " + std::strerror(-error));
  format_ = given;
  send_rate(wanted.frames_per_s);
  result.mode = {given->name, static_cast<int>(stream.size.width), static_cast<int>(stream.size.height), {}};
  if (control("FrameDurationLimits") != nullptr) result.mode.frames_per_s = {wanted.frames_per_s};
  const std::string adjusted = adjustment(wanted, result.mode);
  if (!adjusted.empty()) {
    result.answer = ConfigurationAnswer::kAdjusted;
    result.text = description_.address + ": " + adjusted;
  }
  return result;
}

// The first plane, where the luminance lies, or the only one; and those that lie in the same memory.
void LibcameraDevice::map(const lc::FrameBuffer& buffer) {
  const lc::FrameBuffer::Plane& plane = buffer.planes().front();
  size_t bytes = 0;
  for (const lc::FrameBuffer::Plane& other : buffer.planes()) {
    if (other.fd.get() == plane.fd.get()) bytes = std::max(bytes, size_t{other.offset} + other.length);
  }
  void* memory = ::mmap(nullptr, bytes, PROT_READ, MAP_SHARED, plane.fd.get(), 0);
  if (memory == MAP_FAILED) throw InputError(description_.address + ": mapping a buffer: " + std::strerror(errno));
  mapped_[&buffer] = {memory, bytes};
}

void LibcameraDevice::start() {
  const auto require = [&](int error, const char* what) {
    if (error < 0) throw InputError(description_.address + ": " + what + ": " + std::strerror(-error));
  };
  if (configuration_ == nullptr) throw InputError(description_.address + ": is not configured");
  try {
    lc::Stream* stream = configuration_->at(0).stream();
    allocator_ = std::make_unique<lc::FrameBufferAllocator>(camera_);
    require(allocator_->allocate(stream), "allocating buffers");
    for (const std::unique_ptr<lc::FrameBuffer>& buffer : allocator_->buffers(stream)) {
      map(*buffer);
      std::unique_ptr<lc::Request> request = camera_->createRequest(requests_.size());
      require(request == nullptr ? -ENOMEM : request->addBuffer(stream, buffer.get()), "making a request");
      requests_.push_back(std::move(request));
    }
    fresh_ = lc::ControlList(camera_->controls());
    require(camera_->start(&sent_), "starting the stream");
    streaming_ = true;
    for (const std::unique_ptr<lc::Request>& request : requests_)
      require(camera_->queueRequest(request.get()), "giving a buffer");
  } catch (const InputError&) {
    stop();
    throw;
  }
}

void LibcameraDevice::stop() noexcept {
  if (streaming_) camera_->stop();
  streaming_ = false;
  {
    const std::lock_guard<std::mutex> hold(mutex_);
    completed_.clear();
  }
  requests_.clear();
  for (const auto& [buffer, memory] : mapped_) ::munmap(memory.first, memory.second);
  mapped_.clear();
  allocator_.reset();
}

CameraDevice::Wake LibcameraDevice::wait(int64_t deadline_ns) {
  const int64_t left_ns = std::clamp<int64_t>(saturated_difference(deadline_ns, now_ns()), 0, 3'600'000'000'000);
  timespec time = {};
  time.tv_sec = static_cast<time_t>(left_ns / 1'000'000'000);
  time.tv_nsec = static_cast<long>(left_ns % 1'000'000'000);
  pollfd events = {event_fd_, POLLIN, 0};
  const int result = ::ppoll(&events, 1, &time, nullptr);
  uint64_t count = 0;
  if (result > 0 && ::read(event_fd_, &count, sizeof count) > 0) return Wake::kReady;
  return result < 0 && errno == EINTR ? Wake::kSignal : Wake::kDeadline;
}

void LibcameraDevice::add_chroma(const lc::FrameBuffer& buffer, DeviceFrame* frame) const {
  const auto& planes = buffer.planes();
  const bool semi_planar = planes.size() == 2;
  if (format_->layout != PixelLayout::kGrey || planes.size() < 2 || planes.size() > 3) return;
  frame->chroma_stride = semi_planar ? frame->stride : frame->stride / 2;
  const auto rows = static_cast<size_t>((frame->height + 1) / 2);
  for (size_t i = 1; i < planes.size(); ++i) {
    const bool there = planes[i].fd.get() == planes[0].fd.get() &&
                       planes[i].length >= rows * static_cast<size_t>(frame->chroma_stride);
    if (!there) {
      frame->chroma[0] = frame->chroma[1] = nullptr;
      return;
    }
    frame->chroma[i - 1] = static_cast<const uint8_t*>(mapped_.at(&buffer).first) + planes[i].offset;
  }
}

bool LibcameraDevice::take(DeviceFrame* frame) {
  lc::Request* request = nullptr;
  {
    const std::lock_guard<std::mutex> hold(mutex_);
    if (disconnected_) throw InputError(description_.address + ": the device has gone");
    if (completed_.empty()) return false;
    request = completed_.front();
    completed_.pop_front();
  }
  const lc::FrameBuffer* buffer = request->buffers().begin()->second;
  const lc::FrameMetadata& filled = buffer->metadata();
  const lc::ControlList& says = request->metadata();
  const lc::StreamConfiguration& stream = configuration_->at(0);
  const lc::FrameBuffer::Plane& plane = buffer->planes().front();
  *frame = {};
  frame->buffer = static_cast<int>(request->cookie());
  frame->data = static_cast<const uint8_t*>(mapped_.at(buffer).first) + plane.offset;
  // Not every pipeline says how much it has filled.
  const size_t used = filled.planes().empty() ? 0 : filled.planes()[0].bytesused;
  frame->bytes = used > 0 ? std::min<size_t>(used, plane.length) : plane.length;
  frame->width = static_cast<int>(stream.size.width);
  frame->height = static_cast<int>(stream.size.height);
  frame->stride = static_cast<int>(stream.stride);
  frame->layout = format_->layout;
  add_chroma(*buffer, frame);
  frame->broken = request->status() != lc::Request::RequestComplete || filled.status == lc::FrameMetadata::FrameError ||
                  filled.status == lc::FrameMetadata::FrameCancelled;
  if (filled.sequence > 0) frame->sequence = filled.sequence;
  const auto stamp = says.get(lc::controls::SensorTimestamp);
  if (stamp && *stamp > 0) {
    frame->stamp = Stamp::kStartOfExposure;
    frame->stamp_ns = monotonic_of(*stamp);
    clock_ = "libcamera's SensorTimestamp, start of exposure";
  } else {
    frame->stamp = Stamp::kArrival;
    frame->stamp_ns = now_ns();
    clock_ = "this program's, when a frame is seen";
  }
  if (const auto exposure = says.get(lc::controls::ExposureTime)) {
    exposure_us_ = *exposure;
    frame->exposure_s = 1e-6 * *exposure;
  }
  if (const auto skew = says.get(lc::controls::draft::SensorRollingShutterSkew))
    frame->readout_s = 1e-9 * static_cast<double>(*skew);
  if (const auto gain = says.get(lc::controls::AnalogueGain)) gain_ = *gain;
  if (const auto lens = says.get(lc::controls::LensPosition)) lens_ = *lens;
  if (const auto colours = says.get(lc::controls::ColourGains)) colours_ = std::array{(*colours)[0], (*colours)[1]};
  return true;
}

void LibcameraDevice::give_back(int buffer) {
  lc::Request& request = *requests_.at(static_cast<size_t>(buffer));
  request.reuse(lc::Request::ReuseBuffers);
  for (const auto& [id, value] : fresh_) request.controls().set(id, value);
  fresh_.clear();
  const int error = camera_->queueRequest(&request);
  if (error != 0) throw InputError(description_.address + ": giving a buffer back: " + std::strerror(-error));
}

// Periods of the light, which flickers twice in one of the mains.
std::string LibcameraDevice::set_filter(int mains_hz) {
  if (mains_hz == 0) return "power-line filter: as it was, give --mains 50 or 60";
  const int32_t period_us = mains_hz == 50 ? 10000 : 8333;
  if (send("AeFlickerMode", int32_t{1}) && send("AeFlickerPeriod", period_us))
    return format("power-line filter: %d Hz", mains_hz);
  return "power-line filter: not set, the camera has no such control";
}

void LibcameraDevice::send_rate(double frames_per_s) {
  if (frames_per_s <= 0) return;
  const auto period_us = static_cast<int64_t>(std::lround(1e6 / frames_per_s));
  send("FrameDurationLimits", lc::Span<const int64_t, 2>(std::array<int64_t, 2>{period_us, period_us}));
}

void LibcameraDevice::prepare(const SensorRequest& request) {
  sent_ = lc::ControlList(camera_->controls());  // what an earlier start has locked is free again
  send_rate(accepted_.frames_per_s);
  send("AeEnable", true);
  send("AwbEnable", true);
  set_filter(request.mains_hz);
  // With its automatic still on, which finds the gain for it where the camera can do so.
  if (request.exposure_s > 0) send("ExposureTime", static_cast<int32_t>(std::lround(1e6 * request.exposure_s)));
}

std::vector<std::string> LibcameraDevice::lock(const SensorRequest& request) {
  std::vector<std::string> lines;
  if (request.exposure_s > 0) exposure_us_ = static_cast<int32_t>(std::lround(1e6 * request.exposure_s));
  const bool timed = exposure_us_ && send("ExposureTime", *exposure_us_);
  const bool manual = timed && send("AeEnable", false);
  const bool gained = manual && gain_ && send("AnalogueGain", *gain_);
  if (timed) exposure_s_ = 1e-6 * *exposure_us_;
  if (!timed && request.exposure_s > 0) exposure_s_ = request.exposure_s;
  const std::string none = ": not locked, the camera has no such control";
  const std::string silent = ": not locked, the camera does not report it";
  const bool has_time = control("ExposureTime") != nullptr;
  lines.push_back(manual               ? format("exposure: locked at %.4g ms", 1e-3 * *exposure_us_)
                  : !timed && has_time ? "exposure" + silent + "; give --exposure"
                                       : "exposure" + none);
  const bool has_gain = control("AnalogueGain") != nullptr;
  lines.push_back(gained               ? format("gain: locked at %.3g", static_cast<double>(*gain_))
                  : has_gain && manual ? "gain" + silent
                  : has_gain           ? std::string("gain: not locked, as the exposure is not")
                                       : "gain" + none);
  const bool white = colours_ && send("AwbEnable", false);
  if (white) send("ColourGains", lc::Span<const float, 2>(*colours_));
  const bool has_white = control("AwbEnable") != nullptr;
  lines.push_back("white balance" + (white ? std::string(": locked") : has_white ? silent : none));
  const bool focus = send("AfMode", static_cast<int32_t>(lc::controls::AfModeManual));
  if (focus && lens_) send("LensPosition", *lens_);
  lines.push_back("focus" + (focus ? std::string(": locked") : ": fixed, or there is no such control"));
  lines.push_back(set_filter(request.mains_hz));
  return lines;
}

bool LibcameraDevice::find_again() {
  release();
  const std::shared_ptr<lc::Camera> found = manager().get(id_);
  if (found == nullptr) return false;
  acquire(found);
  return as_accepted(set_format(accepted_));
}

std::vector<CameraDescription> list_cameras_of_libcamera() {
  std::vector<CameraDescription> list;
  const auto cameras = manager().cameras();
  for (size_t i = 0; i < cameras.size(); ++i) list.push_back(describe_camera(*cameras[i], i));
  return list;
}

std::unique_ptr<CameraDevice> open_of_libcamera(const std::string& which) {
  return std::make_unique<LibcameraDevice>(which);
}

}  // namespace

extern "C" const LibcameraEntry pptam_libcamera_entry;
const LibcameraEntry pptam_libcamera_entry = {list_cameras_of_libcamera, open_of_libcamera};

}  // namespace pptam::platform
