#include "platform/camera/recorded_camera.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <fstream>
#include <functional>
#include <string>
#include <string_view>
#include <utility>

#include <pocket_ptam/clock.h>
#include "platform/camera/calibration.h"
#include "platform/camera/frame_transform.h"
#include "platform/camera/image_files.h"
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

// ---- Lists of images --------------------------------------------------------------------------------------------

struct ImageEntry {
  fs::path file;
  int64_t timestamp_ns = 0;
};

struct ImageList {
  std::vector<ImageEntry> images;
  bool has_timestamps = false;
  Trajectory ground_truth;
  fs::path calibration;  // that came with the images
};

std::string_view trimmed(std::string_view text) {
  const size_t begin = std::min(text.find_first_not_of(" \t\r"), text.size());
  const size_t end = text.find_last_not_of(" \t\r");
  return end == std::string_view::npos ? std::string_view() : text.substr(begin, end + 1 - begin);
}

bool parse_timestamp_ns(std::string_view text, int64_t* timestamp_ns) {
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), *timestamp_ns);
  return error == std::errc() && end == text.data() + text.size();
}

// Calls f(line, fail) for each line that is neither blank nor a comment; fail(what) throws with file and line number.
using Fail = std::function<void(const std::string& what)>;
void for_each_line(const fs::path& file, const std::function<void(std::string_view line, const Fail& fail)>& f) {
  std::ifstream stream(file);
  if (!is_file(file) || !stream) throw InputError("cannot read " + file.string() + ": there is no such readable file");
  std::string line;
  for (int number = 1; std::getline(stream, line); ++number) {
    const std::string_view content = trimmed(line);
    if (content.empty() || content[0] == '#') continue;
    f(content,
      [&](const std::string& what) { throw InputError(file.string() + ":" + std::to_string(number) + ": " + what); });
  }
}

// "timestamp name" (TUM, seconds) or "timestamp,name" (EuRoC, nanoseconds), names relative to folder.
std::vector<ImageEntry> read_list(const fs::path& list, const fs::path& folder, char separator) {
  std::vector<ImageEntry> images;
  for_each_line(list, [&](std::string_view line, const Fail& fail) {
    const bool euroc = separator == ',';
    const size_t cut = std::min(euroc ? line.find(',') : line.find_first_of(" \t"), line.size());
    ImageEntry entry;
    const std::string_view stamp = trimmed(line.substr(0, cut));
    const bool good =
        euroc ? parse_timestamp_ns(stamp, &entry.timestamp_ns) : parse_timestamp_s(stamp, &entry.timestamp_ns);
    const std::string_view name = cut < line.size() ? trimmed(line.substr(cut + 1)) : std::string_view();
    if (!good || name.empty()) {
      fail(euroc ? "expected \"timestamp [ns],file name\"" : "expected \"timestamp [s] file name\"");
    }
    if (!images.empty() && entry.timestamp_ns <= images.back().timestamp_ns) {
      fail("the timestamp is not later than the one before");
    }
    entry.file = folder / name;
    images.push_back(std::move(entry));
  });
  if (images.empty()) throw InputError(list.string() + " lists no images");
  return images;
}

ImageList open_tum(const fs::path& list) {
  ImageList result;
  const fs::path folder = list.parent_path();
  result.images = read_list(list, folder, ' ');
  result.has_timestamps = true;
  if (fs::exists(folder / "groundtruth.txt")) result.ground_truth = read_tum_trajectory(folder / "groundtruth.txt");
  return result;
}

// state_groundtruth_estimate0/data.csv: "timestamp, p_x, p_y, p_z, q_w, q_x, q_y, q_z, ..." of the body in the world.
Trajectory read_euroc_poses(const fs::path& file, const Eigen::Isometry3d& T_bc) {
  Trajectory trajectory;
  for_each_line(file, [&](std::string_view line, const Fail& fail) {
    std::array<std::string_view, 8> words;
    for (std::string_view& word : words) {
      const size_t cut = std::min(line.find(','), line.size());
      word = trimmed(line.substr(0, cut));
      line = cut < line.size() ? line.substr(cut + 1) : std::string_view();
    }
    StampedPose pose;
    if (!parse_timestamp_ns(words[0], &pose.timestamp_ns)) fail("the timestamp is not a number of nanoseconds");
    std::array<double, 7> v{};
    for (size_t i = 0; i < v.size(); ++i) {
      const std::string_view word = words[i + 1];
      const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), v[i]);
      if (error != std::errc() || end != word.data() + word.size() || !std::isfinite(v[i])) {
        fail("expected a timestamp and 7 finite numbers, p_x p_y p_z q_w q_x q_y q_z");
      }
    }
    Eigen::Quaterniond q(v[3], v[4], v[5], v[6]);
    if (!(std::abs(q.norm() - 1) < 0.1)) fail("the quaternion is not of unit length");
    if (!trajectory.empty() && pose.timestamp_ns <= trajectory.back().timestamp_ns) {
      fail("the timestamp is not later than the one before");
    }
    q.normalize();
    Eigen::Isometry3d T_wb = Eigen::Isometry3d::Identity();
    T_wb.linear() = q.toRotationMatrix();
    T_wb.translation() = Eigen::Vector3d(v[0], v[1], v[2]);
    pose.T_wc = T_wb * T_bc;
    trajectory.push_back(pose);
  });
  return trajectory;
}

ImageList open_euroc(const fs::path& camera) {
  ImageList result;
  result.images = read_list(camera / "data.csv", camera / "data", ',');
  result.has_timestamps = true;
  const fs::path sensor = camera / "sensor.yaml";
  if (fs::exists(sensor)) result.calibration = sensor;
  const fs::path poses = fs::absolute(camera).lexically_normal().parent_path() / "state_groundtruth_estimate0/data.csv";
  if (fs::exists(poses)) result.ground_truth = read_euroc_poses(poses, read_camera_to_body(sensor));
  return result;
}

bool has_image_extension(const fs::path& file) {
  std::string extension = file.extension().string();
  for (char& c : extension) {
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  }
  constexpr std::array kExtensions = {".png", ".jpg", ".jpeg", ".pgm", ".ppm", ".pnm", ".pbm", ".bmp", ".tif", ".tiff"};
  return std::find(kExtensions.begin(), kExtensions.end(), extension) != kExtensions.end();
}

bool is_digit(char c) {
  return c >= '0' && c <= '9';
}

// img2 before img10: runs of digits compare as numbers, everything else by bytes; ties ("1", "01") by all bytes.
bool natural_less(const std::string& a, const std::string& b) {
  size_t i = 0;
  size_t j = 0;
  while (i < a.size() && j < b.size()) {
    if (is_digit(a[i]) && is_digit(b[j])) {
      while (i < a.size() && a[i] == '0') ++i;
      while (j < b.size() && b[j] == '0') ++j;
      size_t i_end = i;
      size_t j_end = j;
      while (i_end < a.size() && is_digit(a[i_end])) ++i_end;
      while (j_end < b.size() && is_digit(b[j_end])) ++j_end;
      if (i_end - i != j_end - j) return i_end - i < j_end - j;
      const int order = a.compare(i, i_end - i, b, j, j_end - j);
      if (order != 0) return order < 0;
      i = i_end;
      j = j_end;
    } else {
      if (a[i] != b[j]) return static_cast<unsigned char>(a[i]) < static_cast<unsigned char>(b[j]);
      ++i;
      ++j;
    }
  }
  const size_t rest_a = a.size() - i;
  const size_t rest_b = b.size() - j;
  return rest_a != rest_b ? rest_a < rest_b : a < b;
}

std::vector<std::string> file_names(const fs::path& folder) {
  std::vector<std::string> names;
  std::error_code error;
  fs::directory_iterator entry(folder, error);
  for (; !error && entry != fs::directory_iterator(); entry.increment(error)) {
    names.push_back(entry->path().filename().string());
  }
  if (error) throw InputError("cannot read folder " + folder.string() + ": " + error.message());
  return names;
}

ImageList open_image_folder(const fs::path& folder) {
  std::vector<std::string> names = file_names(folder);
  std::erase_if(names, [](const std::string& name) { return name[0] == '.' || !has_image_extension(name); });
  if (names.empty()) {
    throw InputError("folder " + folder.string() +
                     " holds no images (png, jpg, pgm, ppm, bmp, tiff), no rgb.txt (TUM) and no mav0 (EuRoC)");
  }
  std::sort(names.begin(), names.end(), natural_less);
  ImageList result;
  for (const std::string& name : names) result.images.push_back({folder / name});
  return result;
}

// The numbers that stand for %d or %0Nd in the names of the pattern's folder, from the first to the last without a gap.
ImageList open_pattern(const fs::path& pattern) {
  const auto refuse = [&] {
    throw InputError("image pattern " + pattern.string() +
                     ": the file name needs exactly one %d or %0Nd (N from 1 to 9), such as image%04d.png");
  };
  const std::string name = pattern.filename().string();
  const fs::path folder = pattern.has_parent_path() ? pattern.parent_path() : fs::path(".");
  const size_t percent = name.find('%');
  if (percent == std::string::npos || folder.string().find('%') != std::string::npos) refuse();
  size_t end = percent + 1;
  size_t digits = 1;
  if (name.compare(end, 1, "0") == 0 && end + 1 < name.size() && name[end + 1] >= '1' && name[end + 1] <= '9') {
    digits = static_cast<size_t>(name[end + 1] - '0');
    end += 2;
  }
  if (name.compare(end, 1, "d") != 0 || name.find('%', end) != std::string::npos) refuse();
  const std::string head = name.substr(0, percent);
  const std::string tail = name.substr(end + 1);
  const auto numbered = [&](int number) {
    std::string text = std::to_string(number);
    if (text.size() < digits) text.insert(0, digits - text.size(), '0');
    return head + text + tail;
  };

  std::vector<int> numbers;
  for (const std::string& found : file_names(folder)) {
    if (found.size() <= head.size() + tail.size() || !found.starts_with(head) || !found.ends_with(tail)) continue;
    int number = -1;
    const char* begin = found.data() + head.size();
    std::from_chars(begin, found.data() + found.size() - tail.size(), number);
    if (number >= 0 && numbered(number) == found) numbers.push_back(number);
  }
  if (numbers.empty()) throw InputError("no image matches the pattern " + pattern.string());
  std::sort(numbers.begin(), numbers.end());
  ImageList result;
  for (size_t i = 0; i < numbers.size(); ++i) {
    const int expected = numbers.front() + static_cast<int>(i);
    if (numbers[i] != expected) {
      throw InputError("image " + (folder / numbered(expected)).string() +
                       " is missing, though later ones are there: give the folder instead, to take them all");
    }
    result.images.push_back({folder / numbered(expected)});
  }
  return result;
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

ImageList list_images(const fs::path& source) {
  if (is_folder(source)) {
    if (fs::exists(source / "rgb.txt")) return open_tum(source / "rgb.txt");
    for (const fs::path& camera : {source / "mav0/cam0", source / "cam0", source}) {
      if (fs::exists(camera / "data.csv")) return open_euroc(camera);
    }
    return open_image_folder(source);
  }
  if (!fs::exists(source)) return open_pattern(source);
  if (source.extension() == ".txt") return open_tum(source);
  ImageList single;
  single.images.push_back({source});
  return single;
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
    source = std::make_unique<ImageSource>(std::move(kept));
    ground_truth = std::move(list.ground_truth);
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
