#include "platform/camera/video_file.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <functional>
#include <iterator>
#include <map>

#include <pocket_ptam/clock.h>
#include "platform/camera/image_files.h"
#include "platform/input_error.h"

namespace pptam::platform {
namespace {

// The count of frames is partly an estimate from the duration, which is off by the rounding of both and by a varying
// frame rate. Fewer than this fraction of it, less two frames, and of the duration, means that the file breaks off.
constexpr double kMinDelivered = 0.9;

// Names of ffmpeg's demuxers for files of cameras and editors, and for raw streams. What is not here is refused, above
// all playlists, which open other files: hls, dash, concat, image2.
constexpr const char* kContainers =
    "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,asf,flv,mpeg,mpegts,ogg,nut,mxf,dv,ivf,yuv4mpegpipe,"
    "h264,hevc,mjpeg,m4v,mpegvideo,obu,vc1";
constexpr const char* kRawStreams[] = {"h264", "hevc", "mjpeg", "m4v", "mpegvideo", "obu", "vc1"};

// From the rate at which frames were taken to that of the file; players' rates are off by far less, slow motion by
// more.
constexpr double kMaxCaptureError = 0.2;

// Measured: 4K with 4 threads needs 400 MB. Each thread holds images of its own.
constexpr const char* kDecoderThreads = "4";
constexpr ChildLimits kDecoderLimits = {.memory_bytes = size_t{1536} << 20};
constexpr ChildLimits kProbeLimits = {.memory_bytes = size_t{1536} << 20, .cpu_s = 60};

// Only the file itself is opened, whatever its contents ask for, and a name is never taken for an option or URL.
std::vector<std::string> input_arguments(const std::filesystem::path& file) {
  return {"-protocol_whitelist", "file", "-format_whitelist",
          kContainers,           "-i",   "file:" + std::filesystem::absolute(file).string()};
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
      ("stream=width,height,avg_frame_rate,r_frame_rate,nb_frames,duration,sample_aspect_ratio,field_order,"
       "color_transfer:stream_side_data=rotation,displaymatrix,crop_top,crop_bottom,crop_left,crop_right:"
       "format=format_name,duration:format_tags=com.android.capture.fps"),
      "-of",
      "default=noprint_wrappers=1"};
  for (const std::string& word : input_arguments(file)) argv.push_back(word);
  ChildProcess child(argv, ChildProcess::Pipe::kReadStdout, kProbeLimits);
  std::string output(64 * 1024, '\0');
  output.resize(child.read(output.data(), output.size()));
  if (child.finish() != 0) {
    // The second is what ffmpeg 7.1 says of an HLS playlist whose name ends otherwise.
    const bool refused = child.errors().find("not on whitelist") != std::string::npos ||
                         child.errors().find("Not detecting m3u8") != std::string::npos;
    if (refused) {
      throw InputError("video " + file.string() +
                       " is a playlist or in another format that is not read: give the video file itself, or convert "
                       "it to MP4 or Matroska");
    }
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
    if (line.starts_with("0000000") && line.find(": ") == 8) values.emplace(line.substr(0, 8), line.substr(10));
    begin = end + 1;
  }
  return values;
}

// "30000/1001", "4:3" or "12.5"; 0 when it is neither.
double ratio(const std::string& text) {
  const char* end = text.data() + text.size();
  double numerator = 0;
  double denominator = 1;
  auto [rest, error] = std::from_chars(text.data(), end, numerator);
  if (error != std::errc()) return 0;
  if (rest != end && (*rest == '/' || *rest == ':')) {
    if (std::from_chars(rest + 1, end, denominator).ec != std::errc()) return 0;
  }
  const double value = numerator / denominator;
  return std::isfinite(value) ? value : 0;
}

// From the first two rows of the matrix that takes stored to shown pixels, "a b u" each.
bool is_mirrored(const std::string& first_row, const std::string& second_row) {
  double a = 0, b = 0, c = 0, d = 0;
  if (std::sscanf(first_row.c_str(), "%lf %lf", &a, &b) != 2) return false;
  if (std::sscanf(second_row.c_str(), "%lf %lf", &c, &d) != 2) return false;
  return a * d - b * c < 0;
}

// What ffmpeg's messages (with -v level+warning) tell of damage: the last error, or a packet cut short, which
// +discardcorrupt drops with just a warning. Empty when there is none.
std::string damage_in(std::string messages) {
  while (!messages.empty()) {
    const size_t separator = messages.rfind("; ");
    const size_t begin = separator == std::string::npos ? 0 : separator;
    const bool of_times =
        messages.find("monoton", begin) != std::string::npos || messages.find("timestamp", begin) != std::string::npos;
    if (of_times) {  // FrameTimes looks after these
      messages.resize(begin);
      continue;
    }
    for (const char* sign : {"[error]", "[fatal]", "[panic]", "Packet corrupt"}) {
      if (messages.find(sign, begin) != std::string::npos) return last_message(messages);
    }
    messages.resize(begin);
  }
  return "";
}

// Whether a message says that the file ends before its contents do. Other damage, such as that of a picture or packet
// cut in two, is also left where a recording was cut without coding it anew: all that is there has come then.
bool says_truncated(const std::string& message) {
  for (const char* sign : {"ended prematurely", "moov", "partial file"}) {
    if (message.find(sign) != std::string::npos) return true;
  }
  return false;
}

// What the user should know about how the images were made.
void warn_of_kind(std::map<std::string, std::string>& values, const std::function<void(const std::string&)>& warn) {
  const std::string& order = values["field_order"];
  if (order == "tt" || order == "bb" || order == "tb" || order == "bt") {
    warn("it is interlaced: each image mixes two times; deinterlace it first (ffmpeg -i IN -vf bwdif OUT)");
  }
  const std::string& transfer = values["color_transfer"];
  if (transfer == "smpte2084" || transfer == "arib-std-b67") {
    warn(std::string("its grey levels are coded for HDR (") + (transfer == "smpte2084" ? "PQ" : "HLG") +
         ") and taken as they are: record without HDR if tracking is poor");
  }
}

}  // namespace

VideoFile::VideoFile(const std::filesystem::path& file, std::vector<std::string>* warnings) : name_(file.string()) {
  read_probe(file, warnings);

  std::vector<std::string> argv = {"ffmpeg",          "-nostdin",      "-v",       "level+warning", "-fflags",
                                   "+discardcorrupt", "-noautorotate", "-threads", kDecoderThreads, "-copyts"};
  // ffmpeg 7.1 applies a container's crop unless it is told otherwise. Versions that show none to ffprobe apply none,
  // and know no such value of the option.
  if (container_crops_) argv.insert(argv.end(), {"-apply_cropping", "codec"});
  for (const std::string& word : input_arguments(file)) argv.push_back(word);
  // -copyts: else ffmpeg closes gaps of over 10 s in streams whose times may start anew (MPEG-TS).
  // The filters write "frame:N pts:T" to the pipe before the frame goes on, T in nanoseconds; from there on frames are
  // a second apart, so that nothing later minds the file's times.
  const std::string filters = std::string("settb=1/1000000000,metadata=mode=add:key=pptam:value=1,") +
                              "metadata=mode=print:key=pptam:file=pipe\\\\:3:direct=1,setpts=N/TB";
  for (const char* word : {"-map", "0:v:0", "-fps_mode", "passthrough", "-vf", filters.c_str(), "-sws_flags",
                           "+accurate_rnd+bitexact", "-pix_fmt", "gray", "-f", "rawvideo", "pipe:1"}) {
    argv.emplace_back(word);
  }
  decoder_ = std::make_unique<ChildProcess>(argv, ChildProcess::Pipe::kReadStdoutAndLines, kDecoderLimits);
}

void VideoFile::read_probe(const std::filesystem::path& file, std::vector<std::string>* warnings) {
  const auto warn = [&](const std::string& text) {
    if (warnings) warnings->push_back("video " + name_ + ": " + text);
  };
  std::map<std::string, std::string> values = probe(file);
  container_ = values["format_name"];
  width_ = static_cast<int>(std::clamp(ratio(values["width"]), 0.0, kMaxSide + 1.0));
  height_ = static_cast<int>(std::clamp(ratio(values["height"]), 0.0, kMaxSide + 1.0));
  if (width_ < 1 || height_ < 1) throw InputError("video " + name_ + " holds no images: give a video file");
  if (width_ > kMaxSide || height_ > kMaxSide) throw InputError("video " + name_ + " has images too large to read");

  has_times_ = std::find(std::begin(kRawStreams), std::end(kRawStreams), container_) == std::end(kRawStreams);
  const double mean_fps = ratio(values["avg_frame_rate"]);
  const double base_fps = ratio(values["r_frame_rate"]);
  frames_per_s_ = mean_fps > 0 ? mean_fps : base_fps;
  if (!(frames_per_s_ > 0 && frames_per_s_ <= kMaxFps)) frames_per_s_ = kDefaultFps;

  const double turn = ratio(values["rotation"]);  // counter-clockwise, of the display
  display_.rotate_degrees = 90 * (static_cast<int>(std::lround(std::fmod(720 - turn, 360) / 90)) % 4);
  display_.mirrored = is_mirrored(values["00000000"], values["00000001"]);
  const double aspect = ratio(values["sample_aspect_ratio"]);
  if (aspect > 0.1 && aspect < 10) pixel_aspect_ = aspect;
  warn_of_kind(values, warn);
  const double captured_fps = ratio(values["TAG:com.android.capture.fps"]);
  if (std::abs(captured_fps / frames_per_s_ - 1) > kMaxCaptureError) captured_frames_per_s_ = captured_fps;
  container_crops_ = values.contains("crop_top");
  if (container_crops_) {
    warn("its container asks to cut off " + values["crop_left"] + ", " + values["crop_right"] + ", " +
         values["crop_top"] + " and " + values["crop_bottom"] +
         " pixels at the left, right, top and bottom: the images are taken whole, as they are stored");
  }

  // Only these say truly how long they are. An edit list (of a trimmed clip) hides some frames from the count.
  const double stored = ratio(values["nb_frames"]);
  counted_ = stored >= 1;
  const bool matroska = container_.starts_with("matroska");
  if (stored >= 1 || matroska) {
    duration_s_ = ratio(values["duration"]);
    double count = std::round(duration_s_ * frames_per_s_);
    if (stored >= 1 && (count < 1 || stored < count)) count = stored;
    if (count >= 1 && count < 1e8) frame_count_ = static_cast<int>(count);
  }
}

bool VideoFile::read(GreyPixels* image, int64_t* stamp_ns) {
  if (!decoder_) return false;
  image->width = width_;
  image->height = height_;
  image->px.resize(static_cast<size_t>(width_) * static_cast<size_t>(height_));
  size_t bytes = 0;
  try {
    bytes = decoder_->read(image->px.data(), image->px.size());
    if (bytes == image->px.size()) {
      *stamp_ns = next_stamp();
      ++frames_read_;
      return true;
    }
  } catch (const InputError& error) {
    throw InputError("video " + name_ + " after frame " + std::to_string(frames_read_) + ": " + error.what());
  }
  check_end(bytes);
  return false;
}

int64_t VideoFile::next_stamp() {
  // "frame:12   pts:400000000 pts_time:0.4", then a line of the filter's own. It counts anew when images change.
  std::string line;
  do {
    if (!decoder_->read_line(&line)) throw InputError("ffmpeg gives no times of the frames");
  } while (!line.starts_with("frame:"));
  if (frames_read_ > 0 && line.starts_with("frame:0 ") && format_change_ == 0) format_change_ = frames_read_ + 1;
  const size_t at = line.find(" pts:");
  int64_t stamp_ns = 0;
  const bool timed = at != std::string::npos &&
                     std::from_chars(line.data() + at + 5, line.data() + line.size(), stamp_ns).ec == std::errc();
  if (has_times_ && !timed) ++untimed_;
  const double step_ns = 1e9 / frames_per_s_;
  if (!has_times_) {
    stamp_ns = std::llround(frames_read_ * step_ns);
  } else if (!timed) {
    stamp_ns = frames_read_ == 0 ? 0 : saturated_sum(last_ns_, std::llround(step_ns));
  }
  if (frames_read_ == 0) first_ns_ = stamp_ns;
  last_ns_ = stamp_ns;
  return stamp_ns;
}

void VideoFile::check_end(size_t bytes_of_last_frame) {
  const int exit_code = decoder_->finish();
  const std::string messages = decoder_->errors();
  const std::string damage = damage_in(messages);
  const std::string last = last_message(messages);
  decoder_.reset();
  const std::string where = "video " + name_ + " is truncated or corrupt after frame " + std::to_string(frames_read_);
  const bool to_the_end = exit_code == 0 && bytes_of_last_frame == 0;
  const bool all_came = to_the_end && frame_count_ && frames_read_ >= *frame_count_;
  const bool some_missing = !to_the_end || counted_ || says_truncated(messages);
  if (!damage.empty() && !all_came && some_missing) throw InputError(where + ": " + damage);
  damage_ = damage;
  if (exit_code != 0) throw InputError(where + ": " + (last.empty() ? "ffmpeg failed" : last));
  if (bytes_of_last_frame != 0) throw InputError(where + ": the last frame is not whole");
  const double seen_s = 1e-9 * static_cast<double>(saturated_difference(last_ns_, first_ns_));
  const bool too_few = frame_count_ && frames_read_ < kMinDelivered * *frame_count_ - 2;
  if (too_few && seen_s < kMinDelivered * duration_s_ - 2 / frames_per_s_) {
    throw InputError(where + " of " + std::to_string(*frame_count_));
  }
  if (frames_read_ == 0) throw InputError("video " + name_ + " holds no frame");
}

std::vector<std::string> VideoFile::remarks() const {
  std::vector<std::string> lines;
  if (untimed_ > 0)
    lines.push_back(std::to_string(untimed_) + " frames carry no time: put one step after the one before");
  if (format_change_ > 0) {
    lines.push_back("the size or format of the images changes at frame " + std::to_string(format_change_) +
                    ": if it is the size, what follows is stretched and fits no calibration");
  }
  if (!damage_.empty()) lines.push_back("ffmpeg reports damage within: " + damage_);
  return lines;
}

}  // namespace pptam::platform
