#include "platform/run/video_writer.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include <pocket_ptam/clock.h>
#include "platform/input_error.h"

namespace pptam::platform {

VideoWriter::VideoWriter(const std::filesystem::path& file, int width, int height, double fps,
                         std::vector<std::string>* warnings)
    : height_(height), fps_(fps) {
  const std::string size = std::to_string(width) + "x" + std::to_string(height);
  const std::string rate = std::to_string(fps_);
  const std::string output = "file:" + file.string();  // a name is never taken for an option or URL
  std::vector<std::string> command = {"ffmpeg", "-nostdin", "-loglevel", "error", "-y"};
  // superfast takes 60 % of veryfast's time, a tenth of a run's, for a file a fifth larger.
  for (const char* word :
       {"-f", "rawvideo", "-pix_fmt", "rgba",      "-s",         size.c_str(), "-r",        rate.c_str(),
        "-i", "pipe:0",   "-an",      "-c:v",      "libx264",    "-preset",    "superfast", "-crf",
        "21", "-pix_fmt", "yuv420p",  "-movflags", "+faststart", "-f",         "mp4",       output.c_str()}) {
    command.emplace_back(word);
  }
  try {
    encoder_ = std::make_unique<ChildProcess>(command, ChildProcess::Pipe::kWriteStdin);
  } catch (const InputError& error) {
    warnings->push_back(std::string(error.what()) + "; overlay.mp4 is not written");
  }
}

void VideoWriter::add(const unsigned char* pixels, size_t stride_bytes, int64_t timestamp_ns) {
  if (!encoder_) return;
  if (encoded_ == 0) first_ns_ = timestamp_ns;
  constexpr int64_t kMaxStill = 150;  // pictures; a longer pause in the source is cut short
  const double elapsed_s = 1e-9 * static_cast<double>(saturated_difference(timestamp_ns, first_ns_));
  const int64_t due = std::llround(elapsed_s * fps_) + 1 - skipped_;
  const int64_t missing = std::max<int64_t>(1, due - encoded_);
  if (missing > kMaxStill) skipped_ += missing - kMaxStill;
  const size_t bytes = stride_bytes * static_cast<size_t>(height_);
  if (encoded_ > 0) {
    for (int64_t i = 1; i < std::min(missing, kMaxStill); ++i, ++encoded_) {
      if (!encoder_->write(previous_.data(), bytes)) break_off();
    }
  }
  if (!encoder_->write(pixels, bytes)) break_off();
  ++encoded_;
  previous_.assign(pixels, pixels + bytes);
}

void VideoWriter::break_off() {
  const std::unique_ptr<ChildProcess> encoder = std::move(encoder_);
  encoder->finish();
  const std::string why = encoder->errors().empty() ? "it took no more pictures" : encoder->errors();
  throw InputError("overlay.mp4: ffmpeg failed: " + why);
}

bool VideoWriter::finish() {
  if (!encoder_) return whole_;
  const std::unique_ptr<ChildProcess> encoder = std::move(encoder_);
  if (encoder->finish() != 0) throw InputError("overlay.mp4: ffmpeg failed: " + encoder->errors());
  whole_ = encoded_ > 0;
  return whole_;
}

}  // namespace pptam::platform
