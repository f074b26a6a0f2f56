#include "platform/camera/v4l2_device.h"

#include <linux/videodev2.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <functional>
#include <optional>

#include "platform/camera/v4l2_controls.h"
#include "platform/text.h"

namespace pptam::platform {
namespace {

constexpr uint32_t kBuffers = 4;   // one is tracked, one is filled; what has come meanwhile lies in the others
constexpr int kMostEntries = 256;  // of a driver's list: none is as long
constexpr int kMostSide = 8192;    // pixels
constexpr int kLeastSide = 64;     // pixels, as System's
constexpr uint32_t kCapture = V4L2_BUF_TYPE_VIDEO_CAPTURE;

struct Format {
  uint32_t fourcc;
  const char* name;
  PixelLayout layout;
};
constexpr Format kFormats[] = {
    {V4L2_PIX_FMT_GREY, "GREY", PixelLayout::kGrey},   {V4L2_PIX_FMT_NV12, "NV12", PixelLayout::kGrey},
    {V4L2_PIX_FMT_YUV420, "YU12", PixelLayout::kGrey}, {V4L2_PIX_FMT_YUYV, "YUYV", PixelLayout::kYuyv},
    {V4L2_PIX_FMT_MJPEG, "MJPG", PixelLayout::kMjpeg}, {V4L2_PIX_FMT_JPEG, "JPEG", PixelLayout::kMjpeg}};

const Format* format_of(uint32_t fourcc) {
  for (const Format& known : kFormats) {
    if (known.fourcc == fourcc) return &known;
  }
  return nullptr;
}

template <size_t N>
std::string text_of_field(const uint8_t (&field)[N]) {
  return {reinterpret_cast<const char*>(field), strnlen(reinterpret_cast<const char*>(field), N)};
}

std::string fourcc_text(uint32_t fourcc) {
  std::string text;
  for (int shift = 0; shift < 32; shift += 8) text += static_cast<char>((fourcc >> shift) & 0x7fU);
  return text;
}

// Sizes to try of a device that takes any in a range.
constexpr struct {
  int width, height;
} kUsualSizes[] = {{160, 120}, {320, 240}, {640, 480}, {800, 600}, {1280, 720}, {1280, 960}, {1920, 1080}};

// An open node.
class Node {
 public:
  Node(V4l2Calls& calls, std::string path) : calls_(calls), path_(std::move(path)) {}
  ~Node() { close(); }
  Node(const Node&) = delete;
  Node& operator=(const Node&) = delete;

  bool open() {
    fd_ = calls_.open(path_.c_str());
    return fd_ >= 0;
  }
  void close() {
    if (fd_ >= 0) calls_.close(fd_);
    fd_ = -1;
  }
  bool try_ioctl(unsigned long request, void* argument) const { return calls_.ioctl(fd_, request, argument) == 0; }
  // Throws InputError: "/dev/video0: what: No such device".
  void ioctl(unsigned long request, void* argument, const std::string& what) const {
    if (!try_ioctl(request, argument)) fail(what);
  }
  [[noreturn]] void fail(const std::string& what) const {
    const int error = errno;
    std::string why = std::strerror(error);
    if (error == EBUSY) why = "another program uses the camera, end that first";
    if (error == ENODEV) why = "the device has gone";
    throw InputError(path_ + ": " + what + ": " + why);
  }
  int fd() const { return fd_; }
  const std::string& path() const { return path_; }

 private:
  V4l2Calls& calls_;
  std::string path_;
  int fd_ = -1;
};

std::vector<double> rates_of(const Node& node, uint32_t fourcc, int width, int height) {
  std::vector<double> rates;
  v4l2_frmivalenum entry = {};
  entry.pixel_format = fourcc;
  entry.width = static_cast<uint32_t>(width);
  entry.height = static_cast<uint32_t>(height);
  const auto add = [&](const v4l2_fract& interval) {
    if (interval.numerator > 0 && interval.denominator > 0)
      rates.push_back(static_cast<double>(interval.denominator) / interval.numerator);
  };
  for (; entry.index < kMostEntries && node.try_ioctl(VIDIOC_ENUM_FRAMEINTERVALS, &entry); ++entry.index) {
    if (entry.type == V4L2_FRMIVAL_TYPE_DISCRETE) {
      add(entry.discrete);
      continue;
    }
    add(entry.stepwise.min);
    const double fastest = rates.empty() ? 0 : rates.front();
    const double slowest = entry.stepwise.max.numerator > 0 && entry.stepwise.max.denominator > 0
                               ? static_cast<double>(entry.stepwise.max.denominator) / entry.stepwise.max.numerator
                               : 0;
    for (const double usual : {60.0, 30.0, 15.0}) {
      if (usual < fastest && usual > slowest) rates.push_back(usual);
    }
    add(entry.stepwise.max);
    break;
  }
  std::sort(rates.begin(), rates.end(), std::greater<>());
  rates.erase(std::unique(rates.begin(), rates.end()), rates.end());
  return rates;
}

void add_modes(const Node& node, const Format& known, std::vector<CameraMode>* modes) {
  const auto add = [&](int width, int height) {
    if (width < kLeastSide || height < kLeastSide || width > kMostSide || height > kMostSide) return;
    modes->push_back({known.name, width, height, rates_of(node, known.fourcc, width, height)});
  };
  v4l2_frmsizeenum entry = {};
  entry.pixel_format = known.fourcc;
  for (; entry.index < kMostEntries && node.try_ioctl(VIDIOC_ENUM_FRAMESIZES, &entry); ++entry.index) {
    if (entry.type == V4L2_FRMSIZE_TYPE_DISCRETE) {
      add(static_cast<int>(entry.discrete.width), static_cast<int>(entry.discrete.height));
      continue;
    }
    const v4l2_frmsize_stepwise& range = entry.stepwise;
    const auto on_step = [](int side, uint32_t least, uint32_t most, uint32_t step) {
      const auto wanted = static_cast<uint32_t>(side);
      return wanted >= least && wanted <= most && (wanted - least) % std::max(step, 1U) == 0;
    };
    for (const auto& size : kUsualSizes) {
      if (on_step(size.width, range.min_width, range.max_width, range.step_width) &&
          on_step(size.height, range.min_height, range.max_height, range.step_height)) {
        add(size.width, size.height);
      }
    }
    return;
  }
  if (entry.index > 0) return;
  v4l2_format now = {};  // a driver that does not list sizes has one
  now.type = kCapture;
  if (node.try_ioctl(VIDIOC_G_FMT, &now))
    add(static_cast<int>(now.fmt.pix.width), static_cast<int>(now.fmt.pix.height));
}

// False: it does not capture single-planar video by streaming; why says so. driver_only: nothing but names is asked.
bool describe_node(const Node& node, CameraDescription* description, std::string* bus, std::string* why, bool modes) {
  v4l2_capability capability = {};
  if (!node.try_ioctl(VIDIOC_QUERYCAP, &capability)) {
    *why = "is not a Video4Linux device";
    return false;
  }
  const uint32_t can =
      (capability.capabilities & V4L2_CAP_DEVICE_CAPS) != 0 ? capability.device_caps : capability.capabilities;
  description->address = node.path();
  description->name = text_of_field(capability.card);
  description->driver = text_of_field(capability.driver);
  *bus = text_of_field(capability.bus_info);
  if ((can & V4L2_CAP_VIDEO_CAPTURE) == 0 || (can & (V4L2_CAP_VIDEO_M2M | V4L2_CAP_VIDEO_M2M_MPLANE)) != 0) {
    *why = (can & V4L2_CAP_VIDEO_CAPTURE_MPLANE) != 0 ? "delivers images in several planes: try --camera libcamera:0"
                                                      : "does not capture video";
    return false;
  }
  if ((can & V4L2_CAP_STREAMING) == 0) {
    *why = "has no memory-mapped streaming";
    return false;
  }
  if (!modes) return true;
  v4l2_fmtdesc entry = {};
  entry.type = kCapture;
  for (; entry.index < kMostEntries && node.try_ioctl(VIDIOC_ENUM_FMT, &entry); ++entry.index) {
    if (const Format* known = format_of(entry.pixelformat)) add_modes(node, *known, &description->modes);
  }
  return true;
}

class V4l2Device : public CameraDevice {
 public:
  V4l2Device(const std::string& path, V4l2Calls& calls)
      : calls_(calls), node_(std::make_unique<Node>(calls, path)), controls_(calls) {
    open();
  }
  ~V4l2Device() override { stop(); }

  CameraDescription describe() override { return description_; }
  Configuration configure(const CameraRequest& wanted) override { return accept(wanted, set_format(wanted)); }
  void prepare(const SensorRequest& request) override {
    controls_.prepare(node_->fd(), request);
    can_lock_ = controls_.has_automatic(node_->fd());
  }
  void start() override;
  void stop() noexcept override;
  Wake wait(int64_t deadline_ns) override;
  bool take(DeviceFrame* frame) override;
  void give_back(int buffer) override;
  bool find_again() override;
  std::vector<std::string> lock(const SensorRequest& request) override { return controls_.lock(node_->fd(), request); }
  bool can_lock() const override { return can_lock_; }
  double exposure_s() const override { return controls_.exposure_s(); }
  std::string clock() const override { return clock_; }
  int64_t now_ns() const override { return calls_.now_ns(); }

 private:
  struct Buffer {
    void* data = nullptr;
    size_t bytes = 0;
  };

  void open();
  std::vector<std::string> alike() const;
  std::unique_ptr<Node> find_node(std::string* place) const;
  Configuration set_format(const CameraRequest& wanted);
  double set_rate(double frames_per_s);
  void add_chroma(DeviceFrame* frame) const;
  void map_buffers();
  void unmap_buffers() noexcept;

  V4l2Calls& calls_;
  std::unique_ptr<Node> node_;
  V4l2Controls controls_;
  CameraDescription description_;
  std::string bus_;
  std::vector<std::string> others_;  // where cameras of the same name were at the start
  const Format* format_ = nullptr;
  int width_ = 0, height_ = 0, stride_ = 0;
  bool can_lock_ = false;
  bool streaming_ = false;
  std::vector<Buffer> buffers_;
  std::vector<int> refused_;  // buffers that could not be given back, to be tried again
  std::string clock_;
};

void V4l2Device::open() {
  const std::string& path = node_->path();
  if (!node_->open()) {
    const int error = errno;
    if (error == ENOENT || error == ENXIO || error == ENODEV)
      throw InputError("camera " + path + ": there is no such device; pocket-ptam cameras lists those that there are");
    if (error == EACCES)
      throw InputError("camera " + path +
                       ": permission denied: add yourself to the group video (adduser $USER video) " +
                       "and log in again");
    throw InputError("camera " + path + ": " + std::strerror(error));
  }
  description_ = {};
  std::string why;
  if (!describe_node(*node_, &description_, &bus_, &why, true))
    throw InputError("camera " + path + " " + why + "; pocket-ptam cameras lists those that do");
  if (description_.modes.empty())
    throw InputError("camera " + path +
                     " offers none of the formats GREY, NV12, YU12, YUYV and MJPG; a sensor with raw " +
                     "images needs libcamera: try --camera libcamera:0");
  can_lock_ = controls_.has_automatic(node_->fd());
  others_ = alike();
}

// What the driver says afterwards; 0: it does not say.
double V4l2Device::set_rate(double frames_per_s) {
  v4l2_streamparm parameters = {};
  parameters.type = kCapture;
  if (!node_->try_ioctl(VIDIOC_G_PARM, &parameters)) return 0;
  if (frames_per_s > 0 && (parameters.parm.capture.capability & V4L2_CAP_TIMEPERFRAME) != 0) {
    parameters.parm.capture.timeperframe.numerator = 1000;
    parameters.parm.capture.timeperframe.denominator = static_cast<uint32_t>(std::lround(1000 * frames_per_s));
    node_->try_ioctl(VIDIOC_S_PARM, &parameters);
  }
  const v4l2_fract& interval = parameters.parm.capture.timeperframe;
  if (interval.numerator == 0 || interval.denominator == 0) return 0;
  return static_cast<double>(interval.denominator) / interval.numerator;
}

Configuration V4l2Device::set_format(const CameraRequest& wanted) {
  const std::string& path = node_->path();
  Configuration result;
  v4l2_format asked = {};
  asked.type = kCapture;
  node_->ioctl(VIDIOC_G_FMT, &asked, "asking for its format");
  v4l2_pix_format& pix = asked.fmt.pix;
  if (wanted.width > 0 && wanted.height > 0) {
    pix.width = static_cast<uint32_t>(wanted.width);
    pix.height = static_cast<uint32_t>(wanted.height);
  }
  for (const Format& known : kFormats) {
    if (wanted.format == known.name) pix.pixelformat = known.fourcc;
  }
  pix.field = V4L2_FIELD_NONE;
  pix.bytesperline = 0;
  pix.sizeimage = 0;
  const auto invalid = [&](const std::string& why) {
    result.answer = ConfigurationAnswer::kInvalid;
    result.text = path + ": " + why;
    return result;
  };
  if (!node_->try_ioctl(VIDIOC_S_FMT, &asked)) {
    if (errno == EBUSY || errno == ENODEV) node_->fail("setting its format");
    return invalid(
        format("%dx%d %s is refused: %s", wanted.width, wanted.height, wanted.format.c_str(), std::strerror(errno)));
  }
  const Format* given = format_of(pix.pixelformat);
  if (given == nullptr) return invalid("its format is " + fourcc_text(pix.pixelformat) + ", which cannot be read");
  if (pix.field != V4L2_FIELD_NONE && pix.field != V4L2_FIELD_ANY)
    return invalid("it delivers interlaced images, which cannot be tracked");
  if (pix.width < kLeastSide || pix.height < kLeastSide || pix.width > kMostSide || pix.height > kMostSide)
    return invalid(format("its images would be %ux%u", pix.width, pix.height));
  format_ = given;
  width_ = static_cast<int>(pix.width);
  height_ = static_cast<int>(pix.height);
  stride_ = static_cast<int>(pix.bytesperline);
  if (stride_ == 0) stride_ = width_ * (given->layout == PixelLayout::kYuyv ? 2 : 1);
  const double rate = set_rate(wanted.frames_per_s);
  result.mode = {given->name, width_, height_, {}};
  if (rate > 0) result.mode.frames_per_s = {rate};
  std::string adjusted = adjustment(wanted, result.mode);
  if (wanted.frames_per_s > 0 && rate > 0 && std::abs(rate / wanted.frames_per_s - 1) > 0.02)
    adjusted += format("%s%.4g frames/s became %.4g", adjusted.empty() ? "" : ", ", wanted.frames_per_s, rate);
  if (!adjusted.empty()) {
    result.answer = ConfigurationAnswer::kAdjusted;
    result.text = path + ": " + adjusted;
  }
  return result;
}

void V4l2Device::map_buffers() {
  v4l2_requestbuffers request = {};
  request.count = kBuffers;
  request.type = kCapture;
  request.memory = V4L2_MEMORY_MMAP;
  node_->ioctl(VIDIOC_REQBUFS, &request, "asking for buffers");
  if (request.count < 2) throw InputError(node_->path() + ": the driver has no memory for two buffers");
  for (uint32_t i = 0; i < std::min<uint32_t>(request.count, VIDEO_MAX_FRAME); ++i) {
    v4l2_buffer buffer = {};
    buffer.index = i;
    buffer.type = kCapture;
    buffer.memory = V4L2_MEMORY_MMAP;
    node_->ioctl(VIDIOC_QUERYBUF, &buffer, "asking for a buffer");
    void* data = calls_.mmap(node_->fd(), buffer.length, buffer.m.offset);
    if (data == nullptr) node_->fail("mapping a buffer");
    buffers_.push_back({data, buffer.length});
  }
}

void V4l2Device::unmap_buffers() noexcept {
  for (const Buffer& buffer : buffers_) calls_.munmap(buffer.data, buffer.bytes);
  buffers_.clear();
  refused_.clear();
  if (node_->fd() < 0) return;
  v4l2_requestbuffers none = {};
  none.type = kCapture;
  none.memory = V4L2_MEMORY_MMAP;
  node_->try_ioctl(VIDIOC_REQBUFS, &none);
}

void V4l2Device::start() {
  try {
    map_buffers();
    for (size_t i = 0; i < buffers_.size(); ++i) give_back(static_cast<int>(i));
    uint32_t type = kCapture;
    node_->ioctl(VIDIOC_STREAMON, &type, "starting the stream");
    streaming_ = true;
  } catch (const InputError&) {
    unmap_buffers();
    throw;
  }
}

void V4l2Device::stop() noexcept {
  if (streaming_) {
    uint32_t type = kCapture;
    node_->try_ioctl(VIDIOC_STREAMOFF, &type);
  }
  streaming_ = false;
  unmap_buffers();
  if (node_->fd() >= 0) controls_.restore(node_->fd());
}

CameraDevice::Wake V4l2Device::wait(int64_t deadline_ns) {
  const int64_t time_ns = saturated_difference(deadline_ns, calls_.now_ns());
  const int result = calls_.wait(streaming_ ? node_->fd() : -1, time_ns);
  if (result > 0) return Wake::kReady;  // or in error, which take() sees
  if (result == 0) return Wake::kDeadline;
  if (errno == EINTR) return Wake::kSignal;
  node_->fail("waiting for a frame");
}

// Behind the luminance, where they are whole; of sides that are not even drivers differ.
void V4l2Device::add_chroma(DeviceFrame* frame) const {
  const bool semi_planar = format_->fourcc == V4L2_PIX_FMT_NV12;
  if ((!semi_planar && format_->fourcc != V4L2_PIX_FMT_YUV420) || width_ % 2 != 0 || height_ % 2 != 0) return;
  const size_t luminance = static_cast<size_t>(stride_) * static_cast<size_t>(height_);
  if (frame->bytes < luminance + luminance / 2) return;
  frame->chroma[0] = frame->data + luminance;
  frame->chroma_stride = semi_planar ? stride_ : stride_ / 2;
  if (!semi_planar) frame->chroma[1] = frame->chroma[0] + luminance / 4;
}

bool V4l2Device::take(DeviceFrame* frame) {
  if (!refused_.empty()) give_back(refused_.back());
  v4l2_buffer buffer = {};
  buffer.type = kCapture;
  buffer.memory = V4L2_MEMORY_MMAP;
  if (!node_->try_ioctl(VIDIOC_DQBUF, &buffer)) {
    if (errno == EAGAIN) return false;
    node_->fail("the stream broke");
  }
  if (buffer.index >= buffers_.size()) throw InputError(node_->path() + ": the driver gave a buffer that is none");
  const Buffer& memory = buffers_[buffer.index];
  const uint32_t time = buffer.flags & V4L2_BUF_FLAG_TIMESTAMP_MASK;
  const uint32_t source = buffer.flags & V4L2_BUF_FLAG_TSTAMP_SRC_MASK;
  *frame = {};
  frame->data = static_cast<const uint8_t*>(memory.data);
  frame->bytes = std::min<size_t>(buffer.bytesused, memory.bytes);
  frame->width = width_;
  frame->height = height_;
  frame->stride = stride_;
  frame->layout = format_->layout;
  add_chroma(frame);
  frame->sequence = buffer.sequence;
  frame->broken = (buffer.flags & V4L2_BUF_FLAG_ERROR) != 0;
  frame->buffer = static_cast<int>(buffer.index);
  frame->stamp_ns = int64_t{buffer.timestamp.tv_sec} * 1'000'000'000 + int64_t{buffer.timestamp.tv_usec} * 1000;
  if (time != V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC) {
    frame->stamp = Stamp::kArrival;
    frame->stamp_ns = calls_.now_ns();
    clock_ = "this program's, when a frame is seen";
  } else if (source == V4L2_BUF_FLAG_TSTAMP_SRC_SOE && description_.driver == "uvcvideo") {
    frame->stamp = Stamp::kStartOfReadout;  // it says so, but takes the time when a frame's first packet arrives
    clock_ = "the kernel's monotonic, a frame's first packet";
  } else if (source == V4L2_BUF_FLAG_TSTAMP_SRC_SOE) {
    frame->stamp = Stamp::kStartOfExposure;
    clock_ = "the kernel's monotonic, start of exposure";
  } else {
    frame->stamp = Stamp::kEndOfFrame;
    clock_ = "the kernel's monotonic, end of frame";
  }
  return true;
}

void V4l2Device::give_back(int index) {
  v4l2_buffer buffer = {};
  buffer.index = static_cast<uint32_t>(index);
  buffer.type = kCapture;
  buffer.memory = V4L2_MEMORY_MMAP;
  std::erase(refused_, index);
  if (node_->try_ioctl(VIDIOC_QBUF, &buffer)) return;
  if (errno == ENODEV || !streaming_) node_->fail("giving a buffer back");
  refused_.push_back(index);
}

// Where the other cameras of its name are in the machine.
std::vector<std::string> V4l2Device::alike() const {
  std::vector<std::string> places;
  for (const std::string& path : calls_.nodes()) {
    Node node(calls_, path);
    CameraDescription found;
    std::string bus, why;
    if (node.open() && describe_node(node, &found, &bus, &why, false) && found.name == description_.name &&
        bus != bus_) {
      places.push_back(bus);
    }
  }
  return places;
}

// The node may have got another number: what was where in the machine tells, then the name, if only one has it that was
// not there before. The path as the user gave it comes first: it may be a link that udev keeps. Null: none.
std::unique_ptr<Node> V4l2Device::find_node(std::string* place) const {
  std::vector<std::string> paths = {description_.address};
  for (std::string& path : calls_.nodes()) paths.push_back(std::move(path));
  std::unique_ptr<Node> moved;
  bool several = false;
  for (const std::string& path : paths) {
    auto node = std::make_unique<Node>(calls_, path);
    CameraDescription found;
    std::string bus, why;
    if (!node->open() || !describe_node(*node, &found, &bus, &why, false) || found.name != description_.name) continue;
    if (bus == bus_) {
      *place = bus;
      return node;
    }
    if (std::find(others_.begin(), others_.end(), bus) != others_.end()) continue;
    several = several || (moved != nullptr && bus != *place);
    if (moved != nullptr) continue;
    moved = std::move(node);
    *place = bus;
  }
  return several ? nullptr : std::move(moved);
}

bool V4l2Device::find_again() {
  stop();
  node_->close();
  std::string place;
  std::unique_ptr<Node> node = find_node(&place);
  if (node == nullptr) return false;
  node_ = std::move(node);
  if (!as_accepted(set_format(accepted_))) return false;
  bus_ = place;
  return true;
}

V4l2Calls& system_calls() {
  static V4l2Calls calls;
  return calls;
}

}  // namespace

std::vector<CameraDescription> list_v4l2_cameras(V4l2Calls* calls) {
  V4l2Calls& used = calls != nullptr ? *calls : system_calls();
  std::vector<CameraDescription> cameras;
  for (const std::string& path : used.nodes()) {
    Node node(used, path);
    CameraDescription description;
    std::string bus, why;
    if (node.open() && describe_node(node, &description, &bus, &why, true)) cameras.push_back(std::move(description));
  }
  return cameras;
}

std::unique_ptr<CameraDevice> open_v4l2_device(const std::string& path, V4l2Calls* calls) {
  return std::make_unique<V4l2Device>(path, calls != nullptr ? *calls : system_calls());
}

}  // namespace pptam::platform
