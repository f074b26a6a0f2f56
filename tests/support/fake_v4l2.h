// A Video4Linux device that is made up: it answers in a kernel's place, one node, with time of its own.
#pragma once

#include <linux/videodev2.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <deque>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include "platform/camera/v4l2_calls.h"

namespace pptam::test {

class FakeV4l2 : public platform::V4l2Calls {
 public:
  struct Size {
    uint32_t fourcc, width, height;
    std::vector<uint32_t> rates;
  };
  struct Picture {
    std::vector<uint8_t> bytes;
    int64_t stamp_ns = 0;
    uint32_t flags = V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC | V4L2_BUF_FLAG_TSTAMP_SRC_SOE;
    uint32_t sequence = 0;
    int64_t at_ns = 0;  // when it is there
  };

  std::string path = "/dev/video0";
  std::string card = "Made-up camera";
  std::string driver = "fake";
  std::string bus = "usb-1.4";
  std::map<std::string, std::string> twins;  // by their paths where others of its name are, which cannot do more
  uint32_t capabilities = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
  std::vector<Size> sizes = {{V4L2_PIX_FMT_YUYV, 320, 240, {30, 15}}, {V4L2_PIX_FMT_YUYV, 640, 480, {30}}};
  std::function<void(v4l2_pix_format*)> on_format = [](v4l2_pix_format*) {};  // what the driver makes of it
  std::map<uint32_t, int32_t> controls;
  std::map<uint32_t, int> refuses;     // controls that cannot be set, with the error
  std::map<unsigned long, int> fails;  // requests that fail for as long as they are here
  std::deque<Picture> pictures;
  bool plugged = true;
  int64_t time_ns = 1'000'000'000;
  uint32_t extra_stride = 0;

  int opened = 0;  // now
  int mapped = 0;  // now
  int calls = 0;
  int twin_calls = 0;  // but for its name
  bool streaming = false;
  std::vector<bool> queued;
  v4l2_pix_format now = {};
  v4l2_fract interval = {1, 30};

  std::vector<std::string> nodes() override {
    std::vector<std::string> all;
    if (plugged) all.push_back(path);
    for (const auto& twin : twins) all.push_back(twin.first);
    return all;
  }
  int open(const char* name) override {
    if (const auto twin = twins.find(name); twin != twins.end()) {
      ++opened;
      twin_bus_ = twin->second;
      return kTwin;
    }
    if (!plugged || path != name) return fail(ENOENT);
    alive_ = true;
    ++opened;
    return 7;
  }
  int close(int fd) override {
    --opened;
    if (fd != kTwin) streaming = false;
    return 0;
  }
  // Pulled out: what is open is dead, even when it is plugged in again.
  void unplug() {
    plugged = false;
    alive_ = false;
  }
  void* mmap(int /*fd*/, size_t bytes, int64_t offset) override {
    ++mapped;
    auto& memory = memory_[offset];
    memory.resize(bytes);
    return memory.data();
  }
  int munmap(void* /*address*/, size_t /*bytes*/) override {
    --mapped;
    return 0;
  }
  int wait(int fd, int64_t wait_ns) override {
    const int64_t until_ns = time_ns + std::max<int64_t>(wait_ns, 0);
    if (fd >= 0 && !alive_) return 1;
    if (fd >= 0 && !pictures.empty() && pictures.front().at_ns <= until_ns) {
      time_ns = std::max(time_ns, pictures.front().at_ns);
      return 1;
    }
    time_ns = until_ns;
    return 0;
  }
  int64_t now_ns() override { return time_ns; }

  int ioctl(int fd, unsigned long request, void* argument) override {
    ++calls;
    if (fd == kTwin) {
      if (request == VIDIOC_QUERYCAP) return query(static_cast<v4l2_capability*>(argument), twin_bus_);
      ++twin_calls;
      return fail(EIO);
    }
    if (!alive_) return fail(ENODEV);
    if (const auto error = fails.find(request); error != fails.end()) return fail(error->second);
    switch (request) {
      case VIDIOC_QUERYCAP:
        return query(static_cast<v4l2_capability*>(argument), bus);
      case VIDIOC_ENUM_FMT:
        return enumerate(static_cast<v4l2_fmtdesc*>(argument));
      case VIDIOC_ENUM_FRAMESIZES:
        return enumerate(static_cast<v4l2_frmsizeenum*>(argument));
      case VIDIOC_ENUM_FRAMEINTERVALS:
        return enumerate(static_cast<v4l2_frmivalenum*>(argument));
      case VIDIOC_G_FMT:
        static_cast<v4l2_format*>(argument)->fmt.pix = now;
        return 0;
      case VIDIOC_S_FMT:
        return set(&static_cast<v4l2_format*>(argument)->fmt.pix);
      case VIDIOC_G_PARM:
      case VIDIOC_S_PARM:
        return parameters(request, static_cast<v4l2_streamparm*>(argument));
      case VIDIOC_QUERYCTRL:
        return controls.count(static_cast<v4l2_queryctrl*>(argument)->id) > 0 ? 0 : fail(EINVAL);
      case VIDIOC_G_CTRL:
      case VIDIOC_S_CTRL:
        return control(request, static_cast<v4l2_control*>(argument));
      case VIDIOC_REQBUFS:
        queued.assign(static_cast<v4l2_requestbuffers*>(argument)->count, false);
        return 0;
      case VIDIOC_QUERYBUF: {
        auto* buffer = static_cast<v4l2_buffer*>(argument);
        buffer->length = 2 * 640 * 480 + 4096;
        buffer->m.offset = buffer->index * 0x100000;
        return 0;
      }
      case VIDIOC_QBUF:
        queued.at(static_cast<v4l2_buffer*>(argument)->index) = true;
        return 0;
      case VIDIOC_DQBUF:
        return dequeue(static_cast<v4l2_buffer*>(argument));
      case VIDIOC_STREAMON:
      case VIDIOC_STREAMOFF:
        streaming = request == VIDIOC_STREAMON;
        return 0;
      default:
        return fail(ENOTTY);
    }
  }

 private:
  static constexpr int kTwin = 8;  // one of them is open at a time

  static int fail(int error) {
    errno = error;
    return -1;
  }
  template <size_t N>
  static void copy(uint8_t (&field)[N], const std::string& text) {
    std::memcpy(field, text.data(), std::min(N - 1, text.size()));
  }
  int query(v4l2_capability* answer, const std::string& where) const {
    copy(answer->driver, driver);
    copy(answer->card, card);
    copy(answer->bus_info, where);
    answer->capabilities = capabilities;
    return 0;
  }
  std::vector<uint32_t> fourccs() const {
    std::vector<uint32_t> all;
    for (const Size& size : sizes) {
      if (std::find(all.begin(), all.end(), size.fourcc) == all.end()) all.push_back(size.fourcc);
    }
    return all;
  }
  int enumerate(v4l2_fmtdesc* entry) const {
    const auto all = fourccs();
    if (entry->index >= all.size()) return fail(EINVAL);
    entry->pixelformat = all[entry->index];
    return 0;
  }
  int enumerate(v4l2_frmsizeenum* entry) const {
    uint32_t index = 0;
    for (const Size& size : sizes) {
      if (size.fourcc != entry->pixel_format || index++ != entry->index) continue;
      entry->type = V4L2_FRMSIZE_TYPE_DISCRETE;
      entry->discrete = {size.width, size.height};
      return 0;
    }
    return fail(EINVAL);
  }
  int enumerate(v4l2_frmivalenum* entry) const {
    for (const Size& size : sizes) {
      if (size.fourcc != entry->pixel_format || size.width != entry->width || size.height != entry->height) continue;
      if (entry->index >= size.rates.size()) return fail(EINVAL);
      entry->type = V4L2_FRMIVAL_TYPE_DISCRETE;
      entry->discrete = {1, size.rates[entry->index]};
      return 0;
    }
    return fail(EINVAL);
  }
  int set(v4l2_pix_format* pix) {
    const Size* nearest = &sizes.front();
    for (const Size& size : sizes) {
      if (size.fourcc == pix->pixelformat && size.width == pix->width && size.height == pix->height) nearest = &size;
    }
    pix->pixelformat = nearest->fourcc;
    pix->width = nearest->width;
    pix->height = nearest->height;
    pix->bytesperline = pix->width * (pix->pixelformat == V4L2_PIX_FMT_YUYV ? 2 : 1) + extra_stride;
    if (pix->pixelformat == V4L2_PIX_FMT_MJPEG) pix->bytesperline = 0;
    pix->field = V4L2_FIELD_NONE;
    on_format(pix);
    now = *pix;
    return 0;
  }
  int parameters(unsigned long request, v4l2_streamparm* answer) {
    if (request == VIDIOC_S_PARM) interval = answer->parm.capture.timeperframe;
    answer->parm.capture.capability = V4L2_CAP_TIMEPERFRAME;
    answer->parm.capture.timeperframe = interval;
    return 0;
  }
  int control(unsigned long request, v4l2_control* answer) {
    const auto found = controls.find(answer->id);
    if (found == controls.end()) return fail(EINVAL);
    if (request == VIDIOC_G_CTRL) {
      answer->value = found->second;
      return 0;
    }
    if (const auto refused = refuses.find(answer->id); refused != refuses.end()) return fail(refused->second);
    found->second = answer->value;
    return 0;
  }
  int dequeue(v4l2_buffer* buffer) {
    if (!streaming) return fail(EINVAL);
    const auto free = std::find(queued.begin(), queued.end(), true);
    if (pictures.empty() || pictures.front().at_ns > time_ns || free == queued.end()) return fail(EAGAIN);
    const Picture picture = pictures.front();
    pictures.pop_front();
    buffer->index = static_cast<uint32_t>(free - queued.begin());
    queued[buffer->index] = false;
    auto& memory = memory_[buffer->index * 0x100000];
    std::copy(picture.bytes.begin(), picture.bytes.end(), memory.begin());
    buffer->bytesused = static_cast<uint32_t>(picture.bytes.size());
    buffer->flags = picture.flags;
    buffer->sequence = picture.sequence;
    buffer->timestamp.tv_sec = picture.stamp_ns / 1'000'000'000;
    buffer->timestamp.tv_usec = picture.stamp_ns % 1'000'000'000 / 1000;
    return 0;
  }

  bool alive_ = false;
  std::string twin_bus_;
  std::map<int64_t, std::vector<uint8_t>> memory_;
};

}  // namespace pptam::test
