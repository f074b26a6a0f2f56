// A USB camera for tests, by Linux's gadgetfs: with the module dummy_hcd it is plugged into the very computer it runs
// on, whose uvcvideo then finds it. The camera is plugged in while this program runs, and pulled out by its end.
//
// It speaks USB Video Class 1.0 over a bulk endpoint (dummy_hcd has no isochronous ones): a camera terminal, a
// processing unit, and one format (gadgetfs hands out 256 bytes of descriptors, which hold no more): YUYV, NV12, YU12
// or GREY, in the frames' size and in twice that with each pixel four times, which halves to the same pixels. Frames
// come from a file of raw grey images, one each 1/rate seconds from the moment the host asks for the stream. Prints
// "plugged TIME_NS", "commit WIDTH", "frame N TIME_NS" (CLOCK_MONOTONIC, when its last byte was taken) and "set UNIT
// SELECTOR VALUE".
#include <fcntl.h>
#include <linux/usb/ch9.h>
#include <linux/usb/gadgetfs.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <thread>
#include <vector>

namespace {

constexpr int kPayloadBytes = 16384;  // of one transfer, header included
constexpr int kHeaderBytes = 2;
constexpr uint8_t kEndpoint = 0x81;
constexpr int kStreamingInterface = 1;
enum Unit { kCamera = 1, kProcessing = 2, kOutput = 3 };

using Bytes = std::vector<uint8_t>;

struct Format {
  const char* name;  // Linux's
  const char* guid_start;
  uint8_t bits_per_pixel;
};
constexpr Format kFormats[] = {{"YUYV", "YUY2", 16}, {"NV12", "NV12", 12}, {"YU12", "I420", 12}, {"GREY", "Y800", 8}};

// A control as the host sees it. USB Video Class 1.0, A.9.
struct Control {
  uint8_t unit, selector, bytes;
  int32_t lowest, highest, initial, value;
};
Control controls[] = {
    {kCamera, 0x02, 1, 1, 8, 8, 8},                  // automatic exposure: a bit each, 1 manual, 8 aperture's priority
    {kCamera, 0x03, 1, 0, 1, 1, 1},                  // may the exposure lower the rate
    {kCamera, 0x04, 4, 1, 2500, 156, 200},           // exposure, 0.1 ms
    {kCamera, 0x06, 2, 0, 250, 0, 30},               // focus
    {kCamera, 0x08, 1, 0, 1, 1, 1},                  // automatic focus
    {kProcessing, 0x02, 2, -64, 64, 0, 0},           // brightness
    {kProcessing, 0x04, 2, 0, 100, 0, 20},           // gain
    {kProcessing, 0x05, 1, 0, 2, 1, 1},              // the mains: off, 50, 60 Hz
    {kProcessing, 0x0a, 2, 2800, 6500, 4600, 5100},  // white balance, kelvin
    {kProcessing, 0x0b, 1, 0, 1, 1, 1},              // automatic white balance
};

struct Settings {
  int width = 320, height = 240;
  double rate_hz = 15;
  long first = 0, count = -1, broken_every = 0;
  const Format* format = kFormats;
  std::string frames;
} settings;

uint8_t probed = 1, committed = 1;  // the size: 1, or 2 for twice that
std::atomic<int> commits = 0;

int64_t now_ns() {
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * 1'000'000'000LL + now.tv_nsec;
}

[[noreturn]] void fail(const std::string& what) {
  std::perror(("usb_camera: " + what).c_str());
  std::_Exit(1);
}

void put(Bytes* to, uint32_t value, int bytes) {
  for (int i = 0; i < bytes; ++i) to->push_back(static_cast<uint8_t>(value >> (8 * i)));
}

uint32_t get(const uint8_t* from, int bytes) {
  uint32_t value = 0;
  for (int i = 0; i < bytes; ++i) value |= static_cast<uint32_t>(from[i]) << (8 * i);
  return value;
}

void append(Bytes* to, const Bytes& more) {
  to->insert(to->end(), more.begin(), more.end());
}

uint32_t interval_100ns() {
  return static_cast<uint32_t>(1e7 / settings.rate_hz + 0.5);
}

uint32_t frame_bytes(int scale) {
  const auto pixels = static_cast<uint32_t>(settings.width * settings.height * scale * scale);
  return pixels * settings.format->bits_per_pixel / 8;
}

// USB Video Class 1.0, 3.7: what belongs to the control interface.
Bytes control_descriptors() {
  Bytes camera = {18, 0x24, 0x02, kCamera, 0x01, 0x02, 0, 0, 0, 0, 0, 0, 0, 0, 3, 0x2e, 0x00, 0x02};
  Bytes processing = {11, 0x24, 0x05, kProcessing, kCamera, 0, 0, 2, 0x41, 0x16, 0};
  Bytes output = {9, 0x24, 0x03, kOutput, 0x01, 0x01, 0, kProcessing, 0};
  Bytes all = {13, 0x24, 0x01, 0x00, 0x01};
  put(&all, static_cast<uint32_t>(13 + camera.size() + processing.size() + output.size()), 2);
  put(&all, 48'000'000, 4);
  append(&all, {1, kStreamingInterface});
  append(&all, camera);
  append(&all, processing);
  append(&all, output);
  return all;
}

// 3.9: the format with its two sizes.
Bytes streaming_descriptors() {
  Bytes format = {27, 0x24, 0x04, 1, 2};
  format.insert(format.end(), settings.format->guid_start, settings.format->guid_start + 4);
  append(&format, {0x00, 0x00, 0x10, 0x00, 0x80, 0x00, 0x00, 0xaa, 0x00, 0x38, 0x9b, 0x71});
  append(&format, {settings.format->bits_per_pixel, 1, 0, 0, 0, 0});
  for (uint8_t scale = 1; scale <= 2; ++scale) {
    const uint32_t bytes = frame_bytes(scale);
    append(&format, {30, 0x24, 0x05, scale, 0});
    put(&format, static_cast<uint32_t>(settings.width * scale), 2);
    put(&format, static_cast<uint32_t>(settings.height * scale), 2);
    put(&format, static_cast<uint32_t>(bytes * 8 * settings.rate_hz), 4);
    put(&format, static_cast<uint32_t>(bytes * 8 * settings.rate_hz), 4);
    put(&format, bytes, 4);
    put(&format, interval_100ns(), 4);
    put(&format, 1, 1);
    put(&format, interval_100ns(), 4);
  }
  Bytes all = {14, 0x24, 0x01, 1};
  put(&all, static_cast<uint32_t>(14 + format.size()), 2);
  append(&all, {kEndpoint, 0, kOutput, 0, 0, 0, 1, 0});
  append(&all, format);
  return all;
}

Bytes endpoint_descriptor(bool high_speed) {
  Bytes all = {USB_DT_ENDPOINT_SIZE, USB_DT_ENDPOINT, kEndpoint, USB_ENDPOINT_XFER_BULK};
  put(&all, high_speed ? 512 : 64, 2);
  put(&all, 0, 1);
  return all;
}

Bytes configuration_descriptor(bool high_speed) {
  Bytes inside = {8, USB_DT_INTERFACE_ASSOCIATION, 0, 2, USB_CLASS_VIDEO, 3, 0, 0};
  append(&inside, {USB_DT_INTERFACE_SIZE, USB_DT_INTERFACE, 0, 0, 0, USB_CLASS_VIDEO, 1, 0, 0});
  append(&inside, control_descriptors());
  append(&inside, {USB_DT_INTERFACE_SIZE, USB_DT_INTERFACE, kStreamingInterface, 0, 1, USB_CLASS_VIDEO, 2, 0, 0});
  append(&inside, streaming_descriptors());
  append(&inside, endpoint_descriptor(high_speed));
  Bytes all = {USB_DT_CONFIG_SIZE, USB_DT_CONFIG};
  put(&all, static_cast<uint32_t>(USB_DT_CONFIG_SIZE + inside.size()), 2);
  append(&all, {2, 1, 0, USB_CONFIG_ATT_ONE | USB_CONFIG_ATT_SELFPOWER, 1});
  append(&all, inside);
  return all;
}

Bytes device_descriptor() {
  Bytes all = {USB_DT_DEVICE_SIZE, USB_DT_DEVICE, 0x00, 0x02, 0xef, 0x02, 0x01, 64};
  append(&all, {0x25, 0x05, 0xa4, 0xa4, 0x00, 0x01, 0, 2, 0, 1});  // a vendor and product that Linux uses for gadgets
  return all;
}

// One frame of the file in the size that the host chose; chroma is grey.
Bytes image(int scale, const Bytes& grey) {
  const auto times = static_cast<size_t>(scale), source_width = static_cast<size_t>(settings.width);
  const size_t width = source_width * times, height = static_cast<size_t>(settings.height) * times;
  const bool yuyv = settings.format->bits_per_pixel == 16;
  Bytes all(frame_bytes(scale), 128);
  for (size_t y = 0; y < height; ++y) {
    for (size_t x = 0; x < width; ++x)
      all[(y * width + x) * (yuyv ? 2 : 1)] = grey[y / times * source_width + x / times];
  }
  return all;
}

void send(int endpoint, const Bytes& frame, bool broken, bool* toggle) {
  for (size_t at = 0; at < frame.size();) {
    size_t bytes = std::min<size_t>(frame.size() - at, kPayloadBytes - kHeaderBytes);
    // A payload ends with a short packet.
    if (at + bytes == frame.size() && (bytes + kHeaderBytes) % 512 == 0) bytes -= 1;
    Bytes payload = {kHeaderBytes, static_cast<uint8_t>(0x80 | (*toggle ? 1 : 0))};
    if (at + bytes == frame.size()) payload[1] |= 0x02;            // the frame's end
    if (broken && at + bytes == frame.size()) payload[1] |= 0x40;  // an error
    payload.insert(payload.end(), frame.begin() + static_cast<long>(at), frame.begin() + static_cast<long>(at + bytes));
    if (write(endpoint, payload.data(), payload.size()) < 0) fail("stream");
    at += bytes;
  }
  *toggle = !*toggle;
}

[[noreturn]] void stream(int endpoint) {
  const auto size = static_cast<long>(settings.width) * settings.height;
  const long there = static_cast<long>(std::filesystem::file_size(settings.frames)) / size - settings.first;
  const long count = settings.count < 0 ? there : std::min(there, settings.count);
  std::ifstream file(settings.frames, std::ios::binary);
  file.seekg(settings.first * size);
  Bytes grey(static_cast<size_t>(size));
  while (commits == 0) usleep(1000);
  bool toggle = false;
  int64_t due_ns = now_ns();
  for (long i = 0; i < count; ++i) {
    due_ns = std::max(due_ns + static_cast<int64_t>(1e9 / settings.rate_hz), now_ns());
    while (now_ns() < due_ns) usleep(500);
    file.read(reinterpret_cast<char*>(grey.data()), size);
    const bool broken = settings.broken_every > 0 && (i + 1) % settings.broken_every == 0;
    send(endpoint, image(committed, grey), broken, &toggle);
    std::printf("frame %ld %lld%s\n", settings.first + i, static_cast<long long>(now_ns()), broken ? " broken" : "");
    std::fflush(stdout);
  }
  usleep(200'000);  // the host fetches the last one
  std::_Exit(0);    // and the camera is pulled out
}

int open_endpoint() {
  const int endpoint = open("/dev/gadget/ep1in-bulk", O_RDWR | O_CLOEXEC);
  if (endpoint < 0) fail("/dev/gadget/ep1in-bulk");
  Bytes descriptors;
  put(&descriptors, 1, 4);
  append(&descriptors, endpoint_descriptor(false));
  append(&descriptors, endpoint_descriptor(true));
  if (write(endpoint, descriptors.data(), descriptors.size()) < 0) fail("endpoint");
  return endpoint;
}

// UVC 1.0's probe and commit.
Bytes negotiation(uint8_t scale) {
  Bytes all = {0, 0, 1, scale};
  put(&all, interval_100ns(), 4);
  all.resize(18);
  put(&all, frame_bytes(scale), 4);
  put(&all, kPayloadBytes, 4);
  return all;
}

// The answer to a request that reads; empty: there is none.
Bytes answer(const usb_ctrlrequest& setup) {
  enum Request { kCurrent = 0x81, kLowest, kHighest, kStep, kLength, kInfo, kInitial };
  const int selector = setup.wValue >> 8, unit = setup.wIndex >> 8;
  if (setup.bRequestType == (USB_DIR_IN | USB_TYPE_STANDARD | USB_RECIP_DEVICE)) {
    if (setup.bRequest != USB_REQ_GET_DESCRIPTOR || selector != USB_DT_STRING) return {};
    if ((setup.wValue & 255) == 0) return {4, USB_DT_STRING, 0x09, 0x04};
    Bytes name = {0, USB_DT_STRING};
    for (const char c : std::string("Test camera")) put(&name, static_cast<uint8_t>(c), 2);
    name[0] = static_cast<uint8_t>(name.size());
    return name;
  }
  if ((setup.bRequestType & USB_TYPE_MASK) != USB_TYPE_CLASS) return {};
  if ((setup.wIndex & 255) == kStreamingInterface) {
    if (setup.bRequest == kInfo) return {3};
    if (setup.bRequest == kLength) return {26, 0};
    return negotiation(selector == 1 && setup.bRequest == kCurrent ? probed : committed);
  }
  for (const Control& control : controls) {
    if (control.unit != unit || control.selector != selector) continue;
    Bytes value;
    switch (setup.bRequest) {
      case kCurrent:
        put(&value, static_cast<uint32_t>(control.value), control.bytes);
        break;
      case kLowest:
        put(&value, static_cast<uint32_t>(control.lowest), control.bytes);
        break;
      case kHighest:
        put(&value, static_cast<uint32_t>(control.highest), control.bytes);
        break;
      case kInitial:
        put(&value, static_cast<uint32_t>(control.initial), control.bytes);
        break;
      case kStep:
        put(&value, unit == kCamera && selector == 0x02 ? 9 : 1, control.bytes);
        break;  // modes: bits 1 and 8
      case kLength:
        put(&value, control.bytes, 2);
        break;
      case kInfo:
        put(&value, 3, 1);
        break;
      default:
        break;
    }
    return value;
  }
  return {};
}

// A request that writes: false when it is not known.
bool accept(const usb_ctrlrequest& setup, const Bytes& data) {
  const int selector = setup.wValue >> 8, unit = setup.wIndex >> 8;
  if ((setup.bRequestType & USB_TYPE_MASK) != USB_TYPE_CLASS || setup.bRequest != 1) return false;
  if ((setup.wIndex & 255) == kStreamingInterface) {
    if (data.size() < 26) return false;
    probed = std::clamp<uint8_t>(data[3], 1, 2);
    if (selector == 2) {
      committed = probed;
      ++commits;
      std::printf("commit %d\n", settings.width * committed);
      std::fflush(stdout);
    }
    return true;
  }
  for (Control& control : controls) {
    if (control.unit != unit || control.selector != selector || data.size() < control.bytes) continue;
    control.value = static_cast<int32_t>(get(data.data(), control.bytes));
    std::printf("set %d %d %d\n", unit, selector, control.value);
    std::fflush(stdout);
    return true;
  }
  return false;
}

// One request of the host. gadgetfs: reading or writing the wrong way refuses it.
void serve(int device, const usb_ctrlrequest& setup) {
  static int endpoint = -1;
  uint8_t none = 0;
  if ((setup.bRequestType & USB_DIR_IN) != 0) {
    const Bytes data = answer(setup);
    if (data.empty()) {
      if (read(device, &none, 0) < 0 && errno != EL2HLT) fail("refusal");
    } else if (write(device, data.data(), std::min<size_t>(data.size(), setup.wLength)) < 0) {
      std::perror("usb_camera: answer");
    }
    return;
  }
  if (setup.bRequestType == USB_RECIP_DEVICE && setup.bRequest == USB_REQ_SET_CONFIGURATION && setup.wValue == 1) {
    if (endpoint < 0) std::thread(stream, endpoint = open_endpoint()).detach();
    if (read(device, &none, 0) < 0) fail("configuration");
    return;
  }
  Bytes data(setup.wLength);
  if ((setup.bRequestType & USB_TYPE_MASK) == USB_TYPE_STANDARD) {
    if (read(device, &none, 0) < 0) std::perror("usb_camera: interface");
    return;
  }
  // gadgetfs hands the data over before it asks whether they are liked.
  if (read(device, data.data(), data.size()) < 0) {
    std::perror("usb_camera: data");
    return;
  }
  if (!accept(setup, data)) std::fprintf(stderr, "usb_camera: unknown request %d\n", setup.bRequest);
}

void parse(int count, char** words) {
  for (int i = 1; i < count; ++i) {
    const std::string word = words[i];
    const char* value = i + 1 < count ? words[i + 1] : "";
    if (word == "--width")
      settings.width = std::atoi(value);
    else if (word == "--height")
      settings.height = std::atoi(value);
    else if (word == "--rate")
      settings.rate_hz = std::atof(value);
    else if (word == "--first")
      settings.first = std::atol(value);
    else if (word == "--count")
      settings.count = std::atol(value);
    else if (word == "--broken-every")
      settings.broken_every = std::atol(value);
    else if (word == "--format") {
      settings.format = std::find_if(std::begin(kFormats), std::end(kFormats),
                                     [&](const Format& format) { return std::string(value) == format.name; });
      if (settings.format == std::end(kFormats)) fail(std::string("no format ") + value);
    } else {
      settings.frames = word;
      continue;
    }
    ++i;
  }
  if (settings.frames.empty()) {
    std::puts(
        "Usage: usb_camera [--width 320] [--height 240] [--rate 15] [--first N] [--count N] [--broken-every N]\n"
        "       [--format YUYV|NV12|YU12|GREY] FILE\n"
        "FILE: raw grey images. After the last one, or COUNT, the camera is pulled out. As root, with gadgetfs "
        "mounted\n"
        "at /dev/gadget and the modules dummy_hcd and gadgetfs.");
    std::exit(2);
  }
}

}  // namespace

int main(int count, char** words) {
  parse(count, words);
  const int device = open("/dev/gadget/dummy_udc", O_RDWR | O_CLOEXEC);
  if (device < 0) fail("/dev/gadget/dummy_udc");
  Bytes descriptors;
  put(&descriptors, 0, 4);
  append(&descriptors, configuration_descriptor(false));
  append(&descriptors, configuration_descriptor(true));
  append(&descriptors, device_descriptor());
  if (write(device, descriptors.data(), descriptors.size()) < 0) fail("descriptors");
  std::printf("plugged %lld\n", static_cast<long long>(now_ns()));
  std::fflush(stdout);
  for (int failures = 0; failures < 100;) {
    usb_gadgetfs_event event{};
    if (read(device, &event, sizeof event) < static_cast<ssize_t>(sizeof event)) {
      ++failures;  // of a request that the host, on a busy computer, has given up meanwhile
      std::perror("usb_camera: event");
      usleep(1000);
      continue;
    }
    failures = 0;
    if (event.type == GADGETFS_SETUP) serve(device, event.u.setup);
  }
  fail("events");
}
