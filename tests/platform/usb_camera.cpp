// A USB camera for tests, by USB/IP: with the module vhci_hcd it is plugged into the very computer it runs on, whose
// uvcvideo then finds it. The camera is plugged in while this program runs, and pulled out by its end.
//
// It speaks USB Video Class 1.0 over a bulk endpoint: a camera terminal, a processing unit, and the formats YUYV, NV12,
// YU12, GREY and MJPEG, each in the frames' size and in twice that with each pixel four times, which halves to the same
// pixels. Frames come from a file of raw grey images, one each 1/rate seconds from the moment the host asks for the
// stream. Prints "plugged TIME_NS", "commit FORMAT WIDTH", "frame N TIME_NS" (CLOCK_MONOTONIC, when its last byte was
// sent) and "set UNIT SELECTOR VALUE".
//
// USB/IP: Linux's Documentation/usb/usbip_protocol.rst. Everything comes through one socket, and one thread answers it
// in order: the control endpoint's requests at once, those for images when there are some.
#include <arpa/inet.h>
#include <linux/usb/ch9.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <deque>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "tests/support/jpeg.h"

namespace {

constexpr int64_t kSecond = 1'000'000'000;
constexpr int kPayloadBytes = 16384;  // of one transfer, header included
constexpr int kHeaderBytes = 2;
constexpr int kPacketBytes = 512;
constexpr uint8_t kEndpoint = 0x81;
constexpr int kStreamingInterface = 1;
constexpr int kPorts = 8;  // of vhci_hcd that are tried
enum Unit { kCamera = 1, kProcessing = 2, kOutput = 3 };

using Bytes = std::vector<uint8_t>;

struct Format {
  const char* name;        // Linux's
  const char* guid_start;  // null: MJPEG
  uint8_t bits_per_pixel;  // at most
};
constexpr Format kFormats[] = {
    {"YUYV", "YUY2", 16}, {"NV12", "NV12", 12}, {"YU12", "I420", 12}, {"GREY", "Y800", 8}, {"MJPG", nullptr, 16}};

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
  std::string frames;
} settings;

struct Choice {
  uint8_t format = 1;  // of kFormats, from 1
  uint8_t scale = 1;   // the size: 1, or 2 for twice that
};
Choice probed, committed;

// A message of the host, and what it is answered by: 48 bytes before the data.
struct Message {
  enum Command : uint32_t { kSubmit = 1, kUnlink, kSubmitted, kUnlinked };
  uint32_t command, sequence, device, direction, endpoint;
  union {
    uint32_t flags, unlinked, status;  // of kSubmit; of kUnlink; of the answers
  };
  uint32_t bytes, start_frame, packets, interval;
  usb_ctrlrequest setup;
};
static_assert(sizeof(Message) == 48);

int host = -1;  // the socket

int64_t now_ns() {
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * kSecond + now.tv_nsec;
}

[[noreturn]] void fail(const std::string& what) {
  std::perror(("usb_camera: " + what).c_str());
  std::exit(1);
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

int64_t interval_ns() {
  return int64_t{100} * interval_100ns();
}

uint32_t most_bytes(Choice choice) {
  const auto pixels = static_cast<uint32_t>(settings.width * settings.height * choice.scale * choice.scale);
  return pixels * kFormats[choice.format - 1].bits_per_pixel / 8;
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

// 3.9, and the classes' Uncompressed 3.1 and Motion-JPEG 3.1: a format with its two sizes.
Bytes format_descriptors(uint8_t index) {
  const Format& format = kFormats[index - 1];
  Bytes all;
  if (format.guid_start != nullptr) {
    all = {27, 0x24, 0x04, index, 2};
    for (int i = 0; i < 4; ++i) all.push_back(static_cast<uint8_t>(format.guid_start[i]));
    append(&all, {0x00, 0x00, 0x10, 0x00, 0x80, 0x00, 0x00, 0xaa, 0x00, 0x38, 0x9b, 0x71});
    append(&all, {format.bits_per_pixel, 1, 0, 0, 0, 0});
  } else {
    all = {11, 0x24, 0x06, index, 2, 0, 1, 0, 0, 0, 0};
  }
  for (uint8_t scale = 1; scale <= 2; ++scale) {
    const uint32_t bytes = most_bytes({index, scale});
    append(&all, {30, 0x24, static_cast<uint8_t>(all[2] + 1), scale, 0});
    put(&all, static_cast<uint32_t>(settings.width * scale), 2);
    put(&all, static_cast<uint32_t>(settings.height * scale), 2);
    put(&all, static_cast<uint32_t>(bytes * 8 * settings.rate_hz), 4);
    put(&all, static_cast<uint32_t>(bytes * 8 * settings.rate_hz), 4);
    put(&all, bytes, 4);
    put(&all, interval_100ns(), 4);
    put(&all, 1, 1);
    put(&all, interval_100ns(), 4);
  }
  return all;
}

Bytes streaming_descriptors() {
  constexpr uint8_t kCount = std::size(kFormats);
  Bytes formats;
  for (uint8_t index = 1; index <= kCount; ++index) append(&formats, format_descriptors(index));
  Bytes all = {13 + kCount, 0x24, 0x01, kCount};
  put(&all, static_cast<uint32_t>(13 + kCount + formats.size()), 2);
  append(&all, {kEndpoint, 0, kOutput, 0, 0, 0, 1});
  append(&all, Bytes(kCount, 0));
  append(&all, formats);
  return all;
}

Bytes configuration_descriptor() {
  Bytes inside = {8, USB_DT_INTERFACE_ASSOCIATION, 0, 2, USB_CLASS_VIDEO, 3, 0, 0};
  append(&inside, {USB_DT_INTERFACE_SIZE, USB_DT_INTERFACE, 0, 0, 0, USB_CLASS_VIDEO, 1, 0, 0});
  append(&inside, control_descriptors());
  append(&inside, {USB_DT_INTERFACE_SIZE, USB_DT_INTERFACE, kStreamingInterface, 0, 1, USB_CLASS_VIDEO, 2, 0, 0});
  append(&inside, streaming_descriptors());
  append(&inside, {USB_DT_ENDPOINT_SIZE, USB_DT_ENDPOINT, kEndpoint, USB_ENDPOINT_XFER_BULK});
  put(&inside, kPacketBytes, 2);
  put(&inside, 0, 1);
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

Bytes string_descriptor(int index) {
  if (index == 0) return {4, USB_DT_STRING, 0x09, 0x04};
  Bytes name = {0, USB_DT_STRING};
  for (const char c : std::string("Test camera")) put(&name, static_cast<uint8_t>(c), 2);
  name[0] = static_cast<uint8_t>(name.size());
  return name;
}

// UVC 1.0's probe and commit.
Bytes negotiation(Choice choice) {
  Bytes all = {0, 0, choice.format, choice.scale};
  put(&all, interval_100ns(), 4);
  all.resize(18);
  put(&all, most_bytes(choice), 4);
  put(&all, kPayloadBytes, 4);
  return all;
}

// The answer to a request that reads; empty: it is refused.
Bytes answer(const usb_ctrlrequest& setup) {
  enum Request { kCurrent = 0x81, kLowest, kHighest, kStep, kLength, kInfo, kInitial };
  const int selector = setup.wValue >> 8, unit = setup.wIndex >> 8;
  if ((setup.bRequestType & USB_TYPE_MASK) == USB_TYPE_STANDARD) {
    if (setup.bRequest == USB_REQ_GET_STATUS) return {1, 0};
    if (setup.bRequest != USB_REQ_GET_DESCRIPTOR) return {};
    if (selector == USB_DT_DEVICE) return device_descriptor();
    if (selector == USB_DT_CONFIG) return configuration_descriptor();
    return selector == USB_DT_STRING ? string_descriptor(setup.wValue & 255) : Bytes();
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

// One image of the file in the format and size that the host chose; chroma is grey.
Bytes image(Choice choice, const Bytes& grey) {
  const size_t times = choice.scale, source_width = static_cast<size_t>(settings.width);
  const size_t width = source_width * times, height = static_cast<size_t>(settings.height) * times;
  const Format& format = kFormats[choice.format - 1];
  const bool compressed = format.guid_start == nullptr;
  const size_t step = !compressed && format.bits_per_pixel == 16 ? 2 : 1;
  Bytes all(compressed ? width * height : most_bytes(choice), 128);
  for (size_t y = 0; y < height; ++y) {
    for (size_t x = 0; x < width; ++x) all[(y * width + x) * step] = grey[y / times * source_width + x / times];
  }
  return compressed ? pptam::test::encode_jpeg(static_cast<int>(width), static_cast<int>(height), all, 100) : all;
}

// The first bytes of data go with it when the host reads and is not refused.
void reply(const Message& asked, uint32_t command, int status, const Bytes& data, size_t bytes) {
  Message message{};
  message.command = command;
  message.sequence = asked.sequence;
  message.status = static_cast<uint32_t>(status);
  message.bytes = static_cast<uint32_t>(bytes);
  std::array<uint32_t, sizeof message / 4> words{};
  std::memcpy(words.data(), &message, sizeof message);
  for (uint32_t& word : words) word = htonl(word);
  Bytes all(sizeof message);
  std::memcpy(all.data(), words.data(), sizeof message);
  if (asked.direction == 1 && status == 0) all.insert(all.end(), data.begin(), data.begin() + static_cast<long>(bytes));
  for (size_t at = 0; at < all.size();) {
    const ssize_t sent = send(host, &all[at], all.size() - at, MSG_NOSIGNAL);
    if (sent < 0 && errno != EINTR) fail("the host is gone");
    if (sent > 0) at += static_cast<size_t>(sent);
  }
}

// False: the host is gone.
bool receive(void* to, size_t bytes) {
  return bytes == 0 || recv(host, to, bytes, MSG_WAITALL) == static_cast<ssize_t>(bytes);
}

// The images: payloads that wait for the host to fetch them, and the host's transfers that wait for payloads.
class Stream {
 public:
  Stream() : file_(settings.frames, std::ios::binary) {
    if (!file_) fail(settings.frames);
    const long bytes = static_cast<long>(settings.width) * settings.height;
    const long there = static_cast<long>(std::filesystem::file_size(settings.frames)) / bytes - settings.first;
    count_ = settings.count < 0 ? there : std::min(there, settings.count);
    if (count_ <= 0) {
      std::fprintf(stderr, "usb_camera: %s has no frame %ld\n", settings.frames.c_str(), settings.first);
      std::exit(1);
    }
    grey_.resize(static_cast<size_t>(bytes));
    file_.seekg(settings.first * bytes);
  }

  void begin() { due_ns_ = now_ns() + interval_ns(); }
  void halt() {
    payloads_.clear();
    due_ns_ = kNever;
  }
  void add(const Message& transfer) { transfers_.push_back(transfer); }
  bool remove(uint32_t sequence) {
    const auto found = std::find_if(transfers_.begin(), transfers_.end(),
                                    [&](const Message& transfer) { return transfer.sequence == sequence; });
    if (found == transfers_.end()) return false;
    transfers_.erase(found);
    return true;
  }

  bool ended() const { return index_ == count_ && payloads_.empty(); }
  // The next frame waits for the one before.
  int64_t due_ns() const { return payloads_.empty() && index_ < count_ ? due_ns_ : kNever; }

  void serve() {
    if (now_ns() >= due_ns()) make_payloads();
    while (!payloads_.empty() && !transfers_.empty()) {
      const Bytes& payload = payloads_.front();
      const Message transfer = transfers_.front();
      transfers_.pop_front();
      reply(transfer, Message::kSubmitted, 0, payload, std::min<size_t>(payload.size(), transfer.bytes));
      payloads_.pop_front();
      if (!payloads_.empty()) continue;
      std::printf("frame %ld %lld%s\n", settings.first + index_ - 1, static_cast<long long>(now_ns()),
                  broken_ ? " broken" : "");
    }
  }

 private:
  static constexpr int64_t kNever = INT64_MAX;

  void make_payloads() {
    due_ns_ = std::max(due_ns_ + interval_ns(), now_ns());
    file_.read(reinterpret_cast<char*>(grey_.data()), static_cast<std::streamsize>(grey_.size()));
    ++index_;
    broken_ = settings.broken_every > 0 && index_ % settings.broken_every == 0;
    const Bytes frame = image(committed, grey_);
    for (size_t at = 0; at < frame.size();) {
      size_t bytes = std::min<size_t>(frame.size() - at, kPayloadBytes - kHeaderBytes);
      // A payload ends with a short packet.
      if (at + bytes == frame.size() && (bytes + kHeaderBytes) % kPacketBytes == 0) bytes -= 1;
      Bytes payload = {kHeaderBytes, static_cast<uint8_t>(0x80 | (index_ & 1))};
      if (at + bytes == frame.size()) payload[1] |= 0x02;             // the frame's end
      if (broken_ && at + bytes == frame.size()) payload[1] |= 0x40;  // an error
      payload.insert(payload.end(), frame.begin() + static_cast<long>(at),
                     frame.begin() + static_cast<long>(at + bytes));
      payloads_.push_back(payload);
      at += bytes;
    }
  }

  std::ifstream file_;
  Bytes grey_;
  long index_ = 0, count_ = 0;
  bool broken_ = false;
  int64_t due_ns_ = kNever;
  std::deque<Bytes> payloads_;
  std::deque<Message> transfers_;
};

// A request that writes: false when it is not known.
bool accept(const usb_ctrlrequest& setup, const Bytes& data, Stream* stream) {
  const int selector = setup.wValue >> 8, unit = setup.wIndex >> 8;
  if ((setup.bRequestType & USB_TYPE_MASK) == USB_TYPE_STANDARD) {
    if (setup.bRequest == USB_REQ_CLEAR_FEATURE && setup.wIndex == kEndpoint)
      stream->halt();  // uvcvideo ends a stream by it
    return true;
  }
  if ((setup.bRequestType & USB_TYPE_MASK) != USB_TYPE_CLASS || setup.bRequest != 1) return false;
  if ((setup.wIndex & 255) == kStreamingInterface) {
    if (data.size() < 26) return false;
    probed = {std::clamp<uint8_t>(data[2], 1, std::size(kFormats)), std::clamp<uint8_t>(data[3], 1, 2)};
    if (selector == 2) {
      committed = probed;
      stream->begin();
      std::printf("commit %s %d\n", kFormats[committed.format - 1].name, settings.width * committed.scale);
    }
    return true;
  }
  for (Control& control : controls) {
    if (control.unit != unit || control.selector != selector || data.size() < control.bytes) continue;
    control.value = static_cast<int32_t>(get(data.data(), control.bytes));
    std::printf("set %d %d %d\n", unit, selector, control.value);
    return true;
  }
  return false;
}

// One message of the host. False: it is gone.
bool serve(Stream* stream) {
  std::array<uint32_t, sizeof(Message) / 4> words{};
  if (!receive(words.data(), sizeof words)) return false;
  for (size_t i = 0; i < 10; ++i) words[i] = ntohl(words[i]);  // what follows is a setup packet, in USB's own order
  Message message{};
  std::memcpy(&message, words.data(), sizeof message);
  if (message.command == Message::kUnlink) {
    const bool waited = stream->remove(message.unlinked);
    reply(message, Message::kUnlinked, waited ? -ECONNRESET : 0, {}, 0);
    return true;
  }
  Bytes data(message.direction == 0 ? message.bytes : 0);
  if (!receive(data.data(), data.size())) return false;
  if (message.endpoint != 0) {
    stream->add(message);
    return true;
  }
  if (message.direction == 0) {
    const bool known = accept(message.setup, data, stream);
    reply(message, Message::kSubmitted, known ? 0 : -EPIPE, {}, known ? data.size() : 0);
    return true;
  }
  const Bytes found = answer(message.setup);
  reply(message, Message::kSubmitted, found.empty() ? -EPIPE : 0, found, std::min<size_t>(found.size(), message.bytes));
  return true;
}

void plug_in() {
  int ends[2];
  if (socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends) != 0) fail("socketpair");
  for (int port = 0; port < kPorts; ++port) {  // one is taken until the kernel is done with the camera before
    std::ofstream attach("/sys/devices/platform/vhci_hcd.0/attach");
    attach << port << ' ' << ends[1] << " 1 " << USB_SPEED_HIGH << std::flush;
    if (!attach) continue;
    close(ends[1]);
    host = ends[0];
    std::printf("plugged %lld\n", static_cast<long long>(now_ns()));
    return;
  }
  fail("vhci_hcd takes no camera");
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
    else {
      settings.frames = word;
      continue;
    }
    ++i;
  }
  if (settings.frames.empty() || settings.width < 1 || settings.height < 1 || !(settings.rate_hz > 0) ||
      settings.first < 0 || settings.count == 0) {
    std::puts(
        "Usage: usb_camera [--width 320] [--height 240] [--rate 15] [--first N] [--count N] [--broken-every N] FILE\n"
        "FILE: raw grey images. After the last one, or COUNT, the camera is pulled out. As root, with the module\n"
        "vhci_hcd.");
    std::exit(2);
  }
}

}  // namespace

int main(int count, char** words) {
  std::setvbuf(stdout, nullptr, _IOLBF, 0);
  parse(count, words);
  Stream stream;
  plug_in();
  int64_t end_ns = INT64_MAX;
  while (now_ns() < end_ns) {
    stream.serve();
    if (stream.ended() && end_ns == INT64_MAX) end_ns = now_ns() + kSecond / 5;  // the host fetches the last one
    const int64_t until_ns = std::min({stream.due_ns(), end_ns, now_ns() + kSecond});
    pollfd waiting = {host, POLLIN, 0};
    if (poll(&waiting, 1, static_cast<int>(std::max<int64_t>(0, (until_ns - now_ns()) / 1'000'000))) > 0 &&
        !serve(&stream))
      fail("the host is gone");
  }
  return 0;
}
