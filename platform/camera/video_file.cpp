#include "platform/camera/video_file.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <map>
#include <string_view>

#include "platform/camera/image_files.h"
#include "platform/input_error.h"

namespace pptam::platform {
namespace {

// The count of frames is partly an estimate from the duration, which is off by the rounding of both and by a varying
// frame rate. Fewer than this fraction of it, less two frames, means that the file breaks off.
constexpr double kMinDelivered = 0.9;

// Only local files are opened, whatever the file's contents ask for, and a name is never taken for an option or URL.
std::vector<std::string> input_arguments(const std::filesystem::path& file) {
  return {"-protocol_whitelist", "file,pipe", "-i", "file:" + std::filesystem::absolute(file).string()};
}

// Of messages joined by "; ": the last, without the "[part @ address] [level]" in front.
std::string last_message(const std::string& messages) {
  const size_t separator = messages.rfind("; ");
  std::string last = separator == std::string::npos ? messages : messages.substr(separator + 2);
  while (last.starts_with('[') && last.find("] ") != std::string::npos) last.erase(0, last.find("] ") + 2);
  return last;
}

// The first value of each key that ffprobe knows.
std::map<std::string, std::string> probe(const std::filesystem::path& file) {
  std::vector<std::string> argv = {
      "ffprobe",
      "-v",
      "error",
      "-select_streams",
      "v:0",
      "-show_entries",
      ("stream=width,height,avg_frame_rate,r_frame_rate,nb_frames,duration:stream_side_data=rotation:"
       "format=format_name,duration"),
      "-of",
      "default=noprint_wrappers=1"};
  for (const std::string& word : input_arguments(file)) argv.push_back(word);
  ChildProcess child(argv, ChildProcess::Pipe::kReadStdout);
  std::string output(64 * 1024, '\0');
  output.resize(child.read(output.data(), output.size()));
  if (child.finish() != 0) {
    const std::string first = child.errors().substr(0, child.errors().find("; "));  // the later ones say less
    throw InputError("video " + file.string() + " cannot be read: " + last_message(first));
  }
  std::map<std::string, std::string> values;
  for (size_t begin = 0; begin < output.size();) {
    const size_t end = std::min(output.find('\n', begin), output.size());
    const std::string line = output.substr(begin, end - begin);
    const size_t equals = line.find('=');
    if (equals != std::string::npos && line.substr(equals + 1) != "N/A") {
      values.emplace(line.substr(0, equals), line.substr(equals + 1));
    }
    begin = end + 1;
  }
  return values;
}

// "30000/1001" or "12.5"; 0 when it is neither.
double ratio(const std::string& text) {
  const char* end = text.data() + text.size();
  double numerator = 0;
  double denominator = 1;
  auto [rest, error] = std::from_chars(text.data(), end, numerator);
  if (error != std::errc()) return 0;
  if (rest != end && *rest == '/') {
    if (std::from_chars(rest + 1, end, denominator).ec != std::errc()) return 0;
  }
  const double value = numerator / denominator;
  return std::isfinite(value) ? value : 0;
}

// What ffmpeg's messages (with -v level+warning) tell of damage: the last error, or a packet cut short, which
// +discardcorrupt drops with just a warning. Empty when there is none.
std::string damage_in(std::string messages) {
  while (!messages.empty()) {
    const size_t separator = messages.rfind("; ");
    const size_t begin = separator == std::string::npos ? 0 : separator;
    for (const char* sign : {"[error]", "[fatal]", "[panic]", "Packet corrupt"}) {
      if (messages.find(sign, begin) != std::string::npos) return last_message(messages);
    }
    messages.resize(begin);
  }
  return "";
}

}  // namespace

VideoFile::VideoFile(const std::filesystem::path& file, std::vector<std::string>* warnings) : name_(file.string()) {
  const auto warn = [&](const std::string& text) {
    if (warnings) warnings->push_back("video " + name_ + ": " + text);
  };
  std::map<std::string, std::string> values = probe(file);
  width_ = static_cast<int>(std::clamp(ratio(values["width"]), 0.0, kMaxSide + 1.0));
  height_ = static_cast<int>(std::clamp(ratio(values["height"]), 0.0, kMaxSide + 1.0));
  if (width_ < 1 || height_ < 1 || values["format_name"] == "tty") {  // tty draws any text file as a video
    throw InputError("video " + name_ + " holds no images: give a video file");
  }
  if (width_ > kMaxSide || height_ > kMaxSide) throw InputError("video " + name_ + " has images too large to read");

  const double mean_fps = ratio(values["avg_frame_rate"]);
  const double base_fps = ratio(values["r_frame_rate"]);
  frames_per_s_ = mean_fps > 0 ? mean_fps : base_fps;
  if (!(frames_per_s_ > 0 && frames_per_s_ <= kMaxFps)) {
    frames_per_s_ = kDefaultFps;
    warn("no frame rate in the file: assuming 30 per second");
  } else if (base_fps > 0 && std::abs(base_fps / frames_per_s_ - 1) > 0.05) {
    warn("the frame rate varies: timestamps follow the mean rate");
  }
  const double turn = ratio(values["rotation"]);  // counter-clockwise, of the display
  if (turn != 0) {
    const int clockwise = static_cast<int>(std::lround(std::fmod(720 - turn, 360)));
    warn("the rotation by " + std::to_string(clockwise) + " degrees noted in the file is not applied: add --rotate " +
         std::to_string(clockwise) + " if wanted");
  }
  // Only these say truly how long they are. An edit list (of a trimmed clip) hides some frames from the count.
  const double stored = ratio(values["nb_frames"]);
  const bool matroska = values["format_name"].starts_with("matroska");
  if (stored >= 1 || matroska) {
    double count = std::round(ratio(values["duration"]) * frames_per_s_);
    if (stored >= 1 && (count < 1 || stored < count)) count = stored;
    if (count >= 1 && count < 1e8) frame_count_ = static_cast<int>(count);
  }

  std::vector<std::string> argv = {"ffmpeg",  "-nostdin",        "-v",           "level+warning",
                                   "-fflags", "+discardcorrupt", "-noautorotate"};
  for (const std::string& word : input_arguments(file)) argv.push_back(word);
  for (const char* word : {"-map", "0:v:0", "-fps_mode", "passthrough", "-sws_flags", "+accurate_rnd+bitexact",
                           "-pix_fmt", "gray", "-f", "rawvideo", "pipe:1"}) {
    argv.emplace_back(word);
  }
  decoder_ = std::make_unique<ChildProcess>(argv, ChildProcess::Pipe::kReadStdout);
}

bool VideoFile::read(GreyPixels* image) {
  if (!decoder_) return false;
  image->width = width_;
  image->height = height_;
  image->px.resize(static_cast<size_t>(width_) * static_cast<size_t>(height_));
  const size_t bytes = decoder_->read(image->px.data(), image->px.size());
  if (bytes == image->px.size()) {
    ++frames_read_;
    return true;
  }
  check_end(bytes);
  return false;
}

void VideoFile::check_end(size_t bytes_of_last_frame) {
  const int exit_code = decoder_->finish();
  const std::string damage = damage_in(decoder_->errors());
  const std::string last = last_message(decoder_->errors());
  decoder_.reset();
  const std::string where = "video " + name_ + " is truncated or corrupt after frame " + std::to_string(frames_read_);
  if (!damage.empty()) throw InputError(where + ": " + damage);
  if (exit_code != 0) throw InputError(where + ": " + (last.empty() ? "ffmpeg failed" : last));
  if (bytes_of_last_frame != 0) throw InputError(where + ": the last frame is not whole");
  if (frame_count_ && frames_read_ < kMinDelivered * *frame_count_ - 2) {
    throw InputError(where + " of " + std::to_string(*frame_count_));
  }
  if (frames_read_ == 0) throw InputError("video " + name_ + " holds no frame");
}

}  // namespace pptam::platform
