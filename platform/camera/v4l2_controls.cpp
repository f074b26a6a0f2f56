#include "platform/camera/v4l2_controls.h"

#include <linux/videodev2.h>

#include <algorithm>
#include <cmath>

#include "platform/text.h"

namespace pptam::platform {
namespace {

constexpr double kExposureUnit_s = 1e-4;  // of V4L2_CID_EXPOSURE_ABSOLUTE

}  // namespace

bool V4l2Controls::exists(int fd, uint32_t id) {
  v4l2_queryctrl query = {};
  query.id = id;
  return calls_.ioctl(fd, VIDIOC_QUERYCTRL, &query) == 0 &&
         (query.flags & (V4L2_CTRL_FLAG_DISABLED | V4L2_CTRL_FLAG_READ_ONLY)) == 0;
}

bool V4l2Controls::get(int fd, uint32_t id, int32_t* value) {
  v4l2_control control = {};
  control.id = id;
  if (calls_.ioctl(fd, VIDIOC_G_CTRL, &control) != 0) return false;
  *value = control.value;
  return true;
}

// Kept, too, for restore().
bool V4l2Controls::set(int fd, uint32_t id, int32_t value) {
  int32_t old = 0;
  const bool known = get(fd, id, &old);
  v4l2_control control = {};
  control.id = id;
  control.value = value;
  if (calls_.ioctl(fd, VIDIOC_S_CTRL, &control) != 0) return false;
  const bool first =
      std::none_of(before_.begin(), before_.end(), [id](const auto& entry) { return entry.first == id; });
  if (known && first) before_.emplace_back(id, old);
  return true;
}

bool V4l2Controls::has_automatic(int fd) {
  int32_t value = 0;
  if (exists(fd, V4L2_CID_EXPOSURE_AUTO) && get(fd, V4L2_CID_EXPOSURE_AUTO, &value) && value != V4L2_EXPOSURE_MANUAL)
    return true;
  for (const uint32_t id : {uint32_t{V4L2_CID_AUTOGAIN}, uint32_t{V4L2_CID_AUTO_WHITE_BALANCE}}) {
    if (exists(fd, id) && get(fd, id, &value) && value != 0) return true;
  }
  return false;
}

std::string V4l2Controls::lock_value(int fd, const std::string& what, uint32_t automatic, int32_t off, uint32_t value) {
  const auto kept = std::find_if(kept_.begin(), kept_.end(), [&](const auto& entry) { return entry.first == value; });
  int32_t found = 0;
  bool known = false;
  if (value != 0 && exists(fd, value)) {
    known = kept != kept_.end() || get(fd, value, &found);
    if (kept != kept_.end()) found = kept->second;
  }
  const bool by_itself = exists(fd, automatic);
  if (!by_itself && !known) return what + ": not locked, the device has no such control";
  if (by_itself && !set(fd, automatic, off)) return what + ": not locked, the device refuses it";
  if (!known) return what + ": locked";
  if (kept == kept_.end()) kept_.emplace_back(value, found);
  const bool written = set(fd, value, found);  // some devices jump to another value when they are switched
  return what + ": locked" + (written ? format(" at %d", found) : "");
}

std::string V4l2Controls::lock_exposure(int fd, double wanted_s) {
  constexpr uint32_t kTime = V4L2_CID_EXPOSURE_ABSOLUTE;
  if (exists(fd, V4L2_CID_EXPOSURE_AUTO_PRIORITY)) set(fd, V4L2_CID_EXPOSURE_AUTO_PRIORITY, 0);  // keeps the rate
  const bool timed = exists(fd, kTime);
  if (timed && wanted_s > 0) {
    std::erase_if(kept_, [](const auto& entry) { return entry.first == kTime; });
    kept_.emplace_back(kTime, std::max(1, static_cast<int32_t>(std::lround(wanted_s / kExposureUnit_s))));
  }
  std::string line = lock_value(fd, "exposure", V4L2_CID_EXPOSURE_AUTO, V4L2_EXPOSURE_MANUAL, kTime);
  int32_t manual = V4L2_EXPOSURE_MANUAL;
  if (exists(fd, V4L2_CID_EXPOSURE_AUTO)) get(fd, V4L2_CID_EXPOSURE_AUTO, &manual);
  int32_t units = 0;
  if (timed && manual == V4L2_EXPOSURE_MANUAL && get(fd, kTime, &units) && units > 0) {
    exposure_s_ = kExposureUnit_s * units;
    line += format(" (%.4g ms)", 1e3 * exposure_s_);
  } else if (wanted_s > 0) {
    line += "; --exposure is taken as what it is";
    exposure_s_ = wanted_s;
  }
  return line;
}

std::string V4l2Controls::set_filter(int fd, int mains_hz) {
  if (mains_hz == 0) return "power-line filter: as it was, give --mains 50 or 60";
  const int32_t filter = mains_hz == 50 ? V4L2_CID_POWER_LINE_FREQUENCY_50HZ : V4L2_CID_POWER_LINE_FREQUENCY_60HZ;
  const bool there = exists(fd, V4L2_CID_POWER_LINE_FREQUENCY);
  if (there && set(fd, V4L2_CID_POWER_LINE_FREQUENCY, filter)) return format("power-line filter: %d Hz", mains_hz);
  return std::string("power-line filter: not set, the device ") + (there ? "refuses it" : "has no such control");
}

void V4l2Controls::prepare(int fd, const SensorRequest& request) {
  kept_.clear();
  set_filter(fd, request.mains_hz);
  if (request.exposure_s > 0) lock_exposure(fd, request.exposure_s);
}

std::vector<std::string> V4l2Controls::lock(int fd, const SensorRequest& request) {
  std::vector<std::string> lines;
  lines.push_back(lock_exposure(fd, request.exposure_s));
  lines.push_back(lock_value(fd, "gain", V4L2_CID_AUTOGAIN, 0, V4L2_CID_GAIN));
  lines.push_back(lock_value(fd, "white balance", V4L2_CID_AUTO_WHITE_BALANCE, 0, V4L2_CID_WHITE_BALANCE_TEMPERATURE));
  lines.push_back(lock_value(fd, "focus", V4L2_CID_FOCUS_AUTO, 0, V4L2_CID_FOCUS_ABSOLUTE));
  lines.push_back(set_filter(fd, request.mains_hz));
  return lines;
}

void V4l2Controls::restore(int fd) {
  for (auto entry = before_.rbegin(); entry != before_.rend(); ++entry) {
    v4l2_control control = {};
    control.id = entry->first;
    control.value = entry->second;
    calls_.ioctl(fd, VIDIOC_S_CTRL, &control);  // what cannot be put back stays: the device may have gone
  }
  before_.clear();
}

}  // namespace pptam::platform
