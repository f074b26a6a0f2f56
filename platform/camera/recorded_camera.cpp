#include "platform/camera/recorded_camera.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <functional>
#include <string>
#include <utility>

#include <pocket_ptam/clock.h>
#include "platform/camera/calibration.h"
#include "platform/camera/frame_transform.h"
#include "platform/camera/ground_truth.h"
#include "platform/camera/image_files.h"
#include "platform/camera/image_list.h"
#include "platform/camera/video_file.h"

namespace pptam::platform {
namespace {

namespace fs = std::filesystem;

constexpr double kNsPerS = 1e9;

bool is_folder(const fs::path& path) {
  std::error_code ignored;
  return fs::is_directory(path, ignored);
}

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
};

class ImageSource : public Source {
 public:
  explicit ImageSource(std::vector<ImageEntry> images) : images_(std::move(images)) {}

  bool read(GreyPixels* image, int64_t* timestamp_ns) override {
    if (next_ == images_.size()) return false;
    const ImageEntry& entry = images_[next_];
    *image = read_image(entry.file);
    if (next_ == 0) {
      width_ = image->width;
      height_ = image->height;
    } else if (image->width != width_ || image->height != height_) {
      throw InputError("image " + entry.file.string() + " is " + size_text(image->width, image->height) +
                       ", but the first one is " + size_text(width_, height_));
    }
    *timestamp_ns = entry.timestamp_ns;
    ++next_;
    return true;
  }

 private:
  std::vector<ImageEntry> images_;
  size_t next_ = 0;
  int width_ = 0;
  int height_ = 0;
};

class VideoSource : public Source {
 public:
  VideoSource(std::unique_ptr<VideoFile> video, double fps, int every)
      : video_(std::move(video)), fps_(fps), every_(every) {}

  bool read(GreyPixels* image, int64_t* timestamp_ns) override {
    for (int skip = next_ == 0 ? 0 : every_ - 1; skip > 0; --skip) {
      if (!video_->read(image)) return false;
      ++next_;
    }
    if (!video_->read(image)) return false;
    *timestamp_ns = timestamp_of(next_, fps_);
    ++next_;
    return true;
  }

 private:
  std::unique_ptr<VideoFile> video_;
  double fps_;
  int every_;
  size_t next_ = 0;  // index of the video's next frame
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

  bool read(Frame* frame) override {
    if (!first_waits_ && !source_->read(&image_, &timestamp_ns_)) return false;
    first_waits_ = false;
    const GreyView view = transform_.apply(image_.view());
    *frame = {view.data, view.width, view.height, view.stride, PixelFormat::kGrey, timestamp_ns_};
    return true;
  }

 private:
  std::unique_ptr<Source> source_;
  FrameTransform transform_;
  CameraInfo info_;
  Trajectory ground_truth_;
  GreyPixels image_;  // of the source
  int64_t timestamp_ns_;
  bool first_waits_ = true;  // open_recording() has read it, for its size
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
  std::vector<int64_t> steps_ns;
  for (size_t i = 1; i < images.size(); ++i)
    steps_ns.push_back(saturated_difference(images[i].timestamp_ns, images[i - 1].timestamp_ns));
  if (steps_ns.empty()) return kDefaultFps;
  std::sort(steps_ns.begin(), steps_ns.end());
  return kNsPerS / static_cast<double>(steps_ns[steps_ns.size() / 2]);
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

std::unique_ptr<Camera> open(const RecordingOptions& options, const std::function<void(const std::string&)>& warn,
                             std::vector<std::string>* warnings) {
  check(options);
  const fs::path& source_path = options.source;
  const bool exists = fs::exists(source_path);
  if (!exists && source_path.filename().string().find('%') == std::string::npos) {
    throw InputError("recording " + source_path.string() + ": there is no such file or folder");
  }
  const bool is_video =
      exists && is_file(source_path) && !has_image_extension(source_path) && source_path.extension() != ".txt";
  if (exists && !is_folder(source_path) && !is_file(source_path)) {
    throw InputError("recording " + source_path.string() + " is neither a folder nor a regular file");
  }

  CameraInfo info;
  info.name = name_of(source_path);
  const auto every = static_cast<size_t>(options.every);
  std::unique_ptr<Source> source;
  Trajectory ground_truth;
  fs::path calibration_path = options.calibration;
  if (is_video) {
    auto video = std::make_unique<VideoFile>(source_path, warnings);
    const double fps = options.fps > 0 ? options.fps : video->frames_per_s();
    if (video->frame_count()) info.frame_count = (*video->frame_count() + options.every - 1) / options.every;
    info.frames_per_s = fps / options.every;
    source = std::make_unique<VideoSource>(std::move(video), fps, options.every);
  } else {
    ImageList list = list_images(source_path);
    if (list.has_timestamps && options.fps > 0) warn("the recording has timestamps: the given frame rate is ignored");
    const double fps = options.fps > 0 ? options.fps : kDefaultFps;
    std::vector<ImageEntry> kept;
    for (size_t i = 0; i < list.images.size(); i += every) {
      kept.push_back(list.images[i]);
      if (!list.has_timestamps) kept.back().timestamp_ns = timestamp_of(i, fps);
    }
    info.frame_count = static_cast<int>(kept.size());
    info.frames_per_s = list.has_timestamps ? median_fps(kept) : fps / options.every;
    ground_truth =
        read_ground_truth(list.ground_truth, {kept.front().timestamp_ns, kept.back().timestamp_ns}, warnings);
    source = std::make_unique<ImageSource>(std::move(kept));
    if (calibration_path.empty()) calibration_path = list.calibration;
  }

  if (calibration_path.empty() && options.fov_degrees == 0) {
    throw InputError("no calibration for " + source_path.string() + ": give --calibration FILE or --fov DEGREES");
  }
  GreyPixels first;
  int64_t first_timestamp_ns = 0;
  if (!source->read(&first, &first_timestamp_ns)) throw InputError(source_path.string() + " holds no images");

  Calibration calibration;
  if (calibration_path.empty()) {
    calibration = guess_calibration(first.width, first.height, options.fov_degrees);
    char degrees[32] = {};
    std::to_chars(degrees, degrees + sizeof degrees - 1, options.fov_degrees, std::chars_format::general, 4);
    warn(std::string("no calibration: assuming a field of view of ") + degrees + " degrees and no distortion");
  } else {
    calibration = read_calibration(calibration_path);
    if (options.fov_degrees != 0) warn("a calibration is there: the given field of view is ignored");
    const CameraModel& model = calibration.model;
    if (model.width != first.width || model.height != first.height) {
      throw InputError("calibration " + calibration_path.string() + " is for images of " +
                       size_text(model.width, model.height) + ", but those of " + source_path.string() + " are " +
                       size_text(first.width, first.height) + ": calibrate at that size");
    }
  }

  FrameTransform transform(first.width, first.height, options.rotate_degrees, options.resize_width,
                           options.resize_height);
  info.model = transform.model(calibration.model);
  const Status status = info.model.validate();
  if (!status.ok()) throw InputError(source_path.string() + " after rotation and resizing: " + status.message());
  info.model.prepare();
  info.shutter = transform.shutter(source_shutter(calibration.shutter, options, first.width, first.height));
  info.exposure_s = calibration.exposure_s;
  for (StampedPose& pose : ground_truth) pose.T_wc.linear() = pose.T_wc.linear() * transform.rotation().transpose();
  return std::make_unique<RecordedCamera>(std::move(source), std::move(transform), std::move(info),
                                          std::move(ground_truth), std::move(first), first_timestamp_ns);
}

}  // namespace

std::unique_ptr<Camera> open_recording(const RecordingOptions& options, std::vector<std::string>* warnings) {
  const auto warn = [&](const std::string& text) {
    if (warnings) warnings->push_back(text);
  };
  try {
    return open(options, warn, warnings);
  } catch (const fs::filesystem_error& error) {  // a folder that may not be searched, a name that is too long
    throw InputError("recording " + options.source.string() + ": " + error.code().message());
  }
}

}  // namespace pptam::platform
