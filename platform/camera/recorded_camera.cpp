#include "platform/camera/recorded_camera.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <functional>
#include <string>
#include <utility>

#include <pocket_ptam/clock.h>
#include "platform/camera/calibration.h"
#include "platform/camera/frame_times.h"
#include "platform/camera/frame_transform.h"
#include "platform/camera/ground_truth.h"
#include "platform/camera/image_files.h"
#include "platform/camera/image_list.h"
#include "platform/camera/video_file.h"

namespace pptam::platform {
namespace {

namespace fs = std::filesystem;

constexpr double kNsPerS = 1e9;
constexpr double kAnyFov_degrees = 60;    // of a camera whose calibration nobody asks for
constexpr double kMaxAspectError = 0.05;  // of pixels, between file and calibration; calibrations are better than 1 %

bool is_file(const fs::path& path) {
  std::error_code ignored;
  return fs::is_regular_file(path, ignored);
}

std::string size_text(int width, int height) {
  return std::to_string(width) + "x" + std::to_string(height);
}

int64_t timestamp_of(size_t index, double fps) {
  return std::llround(static_cast<double>(index) * kNsPerS / fps);
}

// ---- Sources: images one after the other, before rotation and resizing -------------------------------------------

class Source {
 public:
  virtual ~Source() = default;
  virtual bool read(GreyPixels* image, int64_t* timestamp_ns) = 0;
  // How the first image says that it wants to be shown.
  virtual DisplayNote display() const = 0;
  virtual std::vector<std::string> remarks() const = 0;
};

class ImageSource : public Source {
 public:
  explicit ImageSource(std::vector<ImageEntry> images) : images_(std::move(images)) {}

  bool read(GreyPixels* image, int64_t* timestamp_ns) override {
    if (next_ == images_.size()) return false;
    const ImageEntry& entry = images_[next_];
    ImageNotes notes;
    *image = read_image(entry.file, &notes);
    if (next_ == 0) {
      width_ = image->width;
      height_ = image->height;
      display_ = notes.display;
    } else if (image->width != width_ || image->height != height_) {
      throw InputError("image " + entry.file.string() + " is " + size_text(image->width, image->height) +
                       ", but the first one is " + size_text(width_, height_));
    }
    if (notes.display.rotate_degrees != display_.rotate_degrees && turned_.empty()) turned_ = entry.file.string();
    if (!notes.dark.empty() && dark_.empty()) dark_ = notes.dark;
    *timestamp_ns = entry.timestamp_ns;
    ++next_;
    return true;
  }
  DisplayNote display() const override { return display_; }
  std::vector<std::string> remarks() const override {
    std::vector<std::string> lines;
    if (!turned_.empty()) lines.push_back("image " + turned_ + " is noted as turned otherwise than the first one");
    if (!dark_.empty()) lines.push_back(dark_);
    return lines;
  }

 private:
  std::vector<ImageEntry> images_;
  size_t next_ = 0;
  int width_ = 0;
  int height_ = 0;
  DisplayNote display_;
  std::string turned_;  // the first image that is noted as turned otherwise
  std::string dark_;    // the first warning of that kind
};

class VideoSource : public Source {
 public:
  // fps of 0: the frames' own times, from 0 for the first one.
  VideoSource(std::unique_ptr<VideoFile> video, std::string name, double fps, int every)
      : video_(std::move(video)), name_(std::move(name)), fps_(fps), every_(every) {}

  bool read(GreyPixels* image, int64_t* timestamp_ns) override {
    for (;;) {
      int64_t stamp_ns = 0;
      if (!video_->read(image, &stamp_ns)) return false;
      const size_t index = times_.accepted();
      if (index == 0) first_ns_ = stamp_ns;
      if (fps_ > 0) stamp_ns = timestamp_of(index, fps_);
      const std::optional<int64_t> time_ns =
          times_.next(fps_ > 0 ? stamp_ns : saturated_difference(stamp_ns, first_ns_));
      if (!time_ns || index % every_ != 0) continue;
      *timestamp_ns = *time_ns;
      return true;
    }
  }
  DisplayNote display() const override { return video_->display(); }
  std::vector<std::string> remarks() const override {
    std::vector<std::string> lines = video_->remarks();
    const bool from_file = fps_ == 0 && video_->has_times();
    if (from_file) {
      for (const std::string& line : times_.remarks()) lines.push_back(line);
    }
    for (std::string& line : lines) line.insert(0, name_ + ": ");
    return lines;
  }

 private:
  std::unique_ptr<VideoFile> video_;
  std::string name_;
  double fps_;
  size_t every_;
  FrameTimes times_;
  int64_t first_ns_ = 0;
};

// ---- The camera --------------------------------------------------------------------------------------------------

class RecordedCamera : public Camera {
 public:
  RecordedCamera(std::unique_ptr<Source> source, FrameTransform transform, CameraInfo info, Trajectory ground_truth,
                 GreyPixels first, int64_t first_timestamp_ns)
      : source_(std::move(source)),
        transform_(std::move(transform)),
        info_(std::move(info)),
        ground_truth_(std::move(ground_truth)),
        image_(std::move(first)),
        timestamp_ns_(first_timestamp_ns) {}

  const CameraInfo& info() const override { return info_; }
  Trajectory ground_truth() const override { return ground_truth_; }

  CameraEvent wait(Frame* frame, int64_t /*deadline_ns*/) override {
    if (!first_waits_) {
      std::swap(image_, before_);
      if (!source_->read(&image_, &timestamp_ns_)) return CameraEvent::kEnd;
      if (image_.px == before_.px) ++repeats_;
    }
    first_waits_ = false;
    ++frames_;
    const GreyView view = transform_.apply(image_.view());
    *frame = {view.data, view.width, view.height, view.stride, PixelFormat::kGrey, timestamp_ns_};
    return CameraEvent::kFrame;
  }

  std::vector<std::string> remarks() const override {
    std::vector<std::string> lines = source_->remarks();
    if (repeats_ > 0 && repeats_ == frames_ - 1) {
      lines.push_back(info_.name + ": all " + std::to_string(frames_) + " frames are the same image, bit for bit");
    } else if (repeats_ > 0) {
      lines.push_back(info_.name + ": " + std::to_string(repeats_) + " of " + std::to_string(frames_) +
                      " frames repeat the one before bit for bit: a recorder that stalled, or a converted frame rate");
    }
    return lines;
  }

 private:
  std::unique_ptr<Source> source_;
  FrameTransform transform_;
  CameraInfo info_;
  Trajectory ground_truth_;
  GreyPixels image_;   // of the source
  GreyPixels before_;  // the one before
  int64_t timestamp_ns_;
  bool first_waits_ = true;  // open_recording() has read it, for its size
  size_t frames_ = 0;
  size_t repeats_ = 0;
};

void check(const RecordingOptions& options) {
  if (options.every < 1) throw InputError("cannot keep one frame of " + std::to_string(options.every));
  if (!(options.fps >= 0 && options.fps <= kMaxFps)) {
    throw InputError("a frame rate of " + std::to_string(options.fps) + " per second is not between 0 and 10000");
  }
  if (options.readout_s && !(std::abs(*options.readout_s) <= 1)) {
    throw InputError("a readout of " + std::to_string(*options.readout_s) + " s is not between -1 and 1");
  }
}

// The last part of the path that tells one recording from another.
std::string name_of(const fs::path& source) {
  fs::path path = fs::absolute(source).lexically_normal();
  while (path.has_relative_path() && (path.filename().empty() || path.filename() == "mav0" ||
                                      path.filename() == "cam0" || path.filename() == "rgb.txt")) {
    path = path.parent_path();
  }
  return path.filename().string();
}

double median_fps(const std::vector<ImageEntry>& images) {
  FrameTimes times;
  for (const ImageEntry& image : images) times.next(image.timestamp_ns);
  return times.frames_per_s() > 0 ? times.frames_per_s() : kDefaultFps;
}

RollingShutter source_shutter(const RollingShutter& calibrated, const RecordingOptions& options, int width,
                              int height) {
  const auto lines = [&](RollingShutter::Axis axis) {
    return static_cast<double>(axis == RollingShutter::Axis::kRows ? height : width);
  };
  const double calibrated_readout_s = double{calibrated.line_time_s} * lines(calibrated.axis);
  RollingShutter shutter;
  shutter.axis = options.readout_axis.value_or(calibrated.axis);
  shutter.line_time_s = static_cast<float>(options.readout_s.value_or(calibrated_readout_s) / lines(shutter.axis));
  return shutter;
}

using Warn = std::function<void(const std::string&)>;

std::string number_text(double value) {
  char digits[32] = {};
  std::to_chars(digits, digits + sizeof digits - 1, value, std::chars_format::general, 4);
  return digits;
}

std::string turn_text(const DisplayNote& note) {
  return "rotation by " + std::to_string(note.rotate_degrees) + " degrees";
}

// Images are tracked as they are stored, unless the user turns them.
void warn_of_display(const DisplayNote& note, int rotate_degrees, const std::string& name, const Warn& warn) {
  if (note.mirrored) {
    warn(name + " is noted to be shown mirrored: its images are taken as they are stored, and if those are mirrored " +
         "the map is so too");
  }
  if (note.rotate_degrees == rotate_degrees || note.mirrored) return;
  const std::string degrees = std::to_string(note.rotate_degrees);
  if (rotate_degrees == 0) {
    warn(name + ": the " + turn_text(note) + " noted in the file is not applied: add --rotate " + degrees +
         " if wanted");
  } else if (note.rotate_degrees != 0) {
    warn(name + ": --rotate " + std::to_string(rotate_degrees) + " is given, the file notes " + degrees);
  }
}

// The calibration of the stored images. One whose size fits only the turned images is theirs, as OpenCV makes it: it
// turns images by what the file notes.
Calibration stored_calibration(Calibration calibration, const RecordingOptions& options, const fs::path& file,
                               const GreyPixels& first, const DisplayNote& note, const Warn& warn) {
  const int width = calibration.model.width;
  const int height = calibration.model.height;
  const bool fits = width == first.width && height == first.height;
  const bool fits_turned = width == first.height && height == first.width;
  const int rotate = options.rotate_degrees;
  if (fits && (rotate == 180 || (rotate != 0 && fits_turned) || (rotate == 0 && note.rotate_degrees == 180) ||
               (rotate == 0 && note.rotate_degrees != 0 && fits_turned))) {
    warn("calibration " + file.string() + ": taken as that of the images as stored, before they are turned");
  }
  if (fits) return calibration;
  if (!fits_turned || rotate % 180 == 0) {
    std::string remedy = "calibrate at that size";
    if (fits_turned) {
      const std::string degrees = note.rotate_degrees % 180 != 0 ? std::to_string(note.rotate_degrees) : "90 or 270";
      remedy = "it fits the turned images, add --rotate " + degrees;
    }
    throw InputError("calibration " + file.string() + " is for images of " + size_text(width, height) +
                     ", but those of " + options.source.string() + " are " + size_text(first.width, first.height) +
                     ": " + remedy);
  }
  const FrameTransform back(width, height, 360 - rotate, 0, 0);
  calibration.model = back.model(calibration.model);
  calibration.shutter = back.shutter(calibration.shutter);
  return calibration;
}

// The source, its images' times and what came with it.
struct Opened {
  std::unique_ptr<Source> source;
  double frames_per_s = 0;
  std::optional<int> frame_count;
  Trajectory ground_truth;
  fs::path calibration;
  double pixel_aspect = 1;
};

Opened open_video(const RecordingOptions& options, std::vector<std::string>* warnings, const Warn& warn) {
  Opened opened;
  auto video = std::make_unique<VideoFile>(options.source, warnings);
  const std::string name = "video " + options.source.string();
  if (!video->has_times() && options.fps == 0) {
    warn(name + " is a raw " + video->container() + " stream, which holds no times: assuming " +
         number_text(video->frames_per_s()) + " frames/s; give the true rate with --fps");
  }
  if (video->captured_frames_per_s() > 0 && options.fps == 0) {
    const std::string captured = number_text(video->captured_frames_per_s());
    warn(name + " was recorded at " + captured + " frames/s and is played at " + number_text(video->frames_per_s()) +
         " (slow motion or time lapse): give the true rate with --fps " + captured);
  }
  const double fps = options.fps > 0 ? options.fps : video->frames_per_s();
  if (video->frame_count()) opened.frame_count = (*video->frame_count() + options.every - 1) / options.every;
  opened.frames_per_s = fps / options.every;
  opened.pixel_aspect = video->pixel_aspect();
  opened.source = std::make_unique<VideoSource>(std::move(video), name, options.fps, options.every);
  return opened;
}

Opened open_images(const RecordingOptions& options, std::vector<std::string>* warnings, const Warn& warn) {
  Opened opened;
  ImageList list = list_images(options.source, warnings);
  const bool timed = list.times == ImageTimes::kListed || (list.times != ImageTimes::kUnknown && options.fps == 0);
  if (timed && options.fps > 0) warn("the recording has timestamps: the given frame rate is ignored");
  if (!timed && options.fps == 0 && list.images.size() > 1) {
    warn("the images of " + options.source.string() + " come without times: assuming " + number_text(kDefaultFps) +
         " frames/s; give the true rate with --fps");
  }
  const double fps = options.fps > 0 ? options.fps : kDefaultFps;
  std::vector<ImageEntry> kept;
  for (size_t i = 0; i < list.images.size(); i += static_cast<size_t>(options.every)) {
    kept.push_back(list.images[i]);
    if (!timed) kept.back().timestamp_ns = timestamp_of(i, fps);
  }
  opened.frame_count = static_cast<int>(kept.size());
  opened.frames_per_s = timed ? median_fps(kept) : fps / options.every;
  // Without EuRoC's sensor.yaml, where the camera sits in the body may be told by Kalibr's camchain: T_cam_imu.
  if (!is_file(list.ground_truth.euroc_sensor) && !options.calibration.empty())
    list.ground_truth.euroc_sensor = options.calibration;
  opened.ground_truth =
      read_ground_truth(list.ground_truth, {kept.front().timestamp_ns, kept.back().timestamp_ns}, warnings);
  opened.source = std::make_unique<ImageSource>(std::move(kept));
  opened.calibration = list.calibration;
  return opened;
}

std::unique_ptr<Camera> open(const RecordingOptions& options, const Warn& warn, std::vector<std::string>* warnings) {
  check(options);
  const fs::path& source_path = options.source;
  const bool exists = fs::exists(source_path);
  if (!exists && source_path.filename().string().find('%') == std::string::npos) {
    throw InputError("recording " + source_path.string() + ": there is no such file or folder");
  }
  if (exists && !is_folder(source_path) && !is_file(source_path)) {
    throw InputError("recording " + source_path.string() + " is neither a folder nor a regular file");
  }
  const bool is_video = exists && is_file(source_path) && !has_image_extension(source_path) && !is_list(source_path);
  Opened opened = is_video ? open_video(options, warnings, warn) : open_images(options, warnings, warn);
  CameraInfo info;
  info.name = name_of(source_path);
  info.frame_count = opened.frame_count;
  info.frames_per_s = opened.frames_per_s;
  Trajectory ground_truth = std::move(opened.ground_truth);
  fs::path calibration_path = options.calibration.empty() ? opened.calibration : options.calibration;
  if (options.uncalibrated) calibration_path.clear();

  if (calibration_path.empty() && options.fov_degrees == 0 && !options.uncalibrated) {
    throw InputError("no calibration for " + source_path.string() + ": give --calibration FILE or --fov DEGREES");
  }
  GreyPixels first;
  int64_t first_timestamp_ns = 0;
  if (!opened.source->read(&first, &first_timestamp_ns)) throw InputError(source_path.string() + " holds no images");
  const DisplayNote note = opened.source->display();
  warn_of_display(note, options.rotate_degrees, (is_video ? "video " : "") + source_path.string(), warn);

  Calibration calibration;
  const std::string aspect = number_text(opened.pixel_aspect) + " times as wide as high";
  if (options.uncalibrated) {
    calibration = guess_calibration(first.width, first.height, kAnyFov_degrees);
  } else if (calibration_path.empty()) {
    calibration = guess_calibration(first.width, first.height, options.fov_degrees);
    calibration.model.fy *= static_cast<float>(opened.pixel_aspect);
    warn("no calibration: assuming a field of view of " + number_text(options.fov_degrees) +
         (opened.pixel_aspect == 1 ? " degrees and no distortion"
                                   : " degrees, no distortion, and pixels " + aspect + " as the file says"));
  } else {
    calibration = stored_calibration(read_calibration(calibration_path, warnings, opened.pixel_aspect), options,
                                     calibration_path, first, note, warn);
    if (options.fov_degrees != 0) warn("a calibration is there: the given field of view is ignored");
    const double calibrated = static_cast<double>(calibration.model.fy / calibration.model.fx);
    if (opened.pixel_aspect != 1 && std::abs(calibrated / opened.pixel_aspect - 1) > kMaxAspectError) {
      warn("the file says that its pixels are " + aspect + ", calibration " + calibration_path.string() + " says " +
           number_text(calibrated) + ", which is taken");
    }
  }

  FrameTransform transform(first.width, first.height, options.rotate_degrees, options.resize_width,
                           options.resize_height);
  info.model = transform.model(calibration.model);
  info.model.fx *= static_cast<float>(options.focal_factor);
  info.model.fy *= static_cast<float>(options.focal_factor);
  const Status status = info.model.validate();
  if (!status.ok()) throw InputError(source_path.string() + " after rotation and resizing: " + status.message());
  info.model.prepare();
  info.shutter = transform.shutter(source_shutter(calibration.shutter, options, first.width, first.height));
  if (options.shutter) info.shutter = *options.shutter;
  info.exposure_s = calibration.exposure_s;
  for (StampedPose& pose : ground_truth) pose.T_wc.linear() = pose.T_wc.linear() * transform.rotation().transpose();
  return std::make_unique<RecordedCamera>(std::move(opened.source), std::move(transform), std::move(info),
                                          std::move(ground_truth), std::move(first), first_timestamp_ns);
}

}  // namespace

std::unique_ptr<Camera> open_recording(const RecordingOptions& options, std::vector<std::string>* warnings) {
  const Warn warn = [&](const std::string& text) {
    if (warnings) warnings->push_back(text);
  };
  try {
    return open(options, warn, warnings);
  } catch (const fs::filesystem_error& error) {  // a folder that may not be searched, a name that is too long
    throw InputError("recording " + options.source.string() + ": " + error.code().message());
  }
}

}  // namespace pptam::platform
