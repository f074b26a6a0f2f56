#include "platform/camera/calibration.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "platform/camera/calibration_colmap.h"
#include "platform/camera/calibration_dialects.h"
#include "platform/camera/calibration_section.h"
#include "platform/camera/calibration_text.h"
#include "platform/files.h"
#include "platform/input_error.h"
#include "platform/text.h"

namespace pptam::platform {
namespace {

constexpr size_t kMaxCalibrationBytes = size_t{32} << 20;  // OpenCV's with the corners of a thousand views: under 20 MB

// Not swept: each is far from what lenses have and near what mistakes make.
constexpr double kMinFocalFraction = 0.15;  // of the longer side; of a fisheye of 220 degrees 0.26
constexpr double kMaxFocalFraction = 20;    // 3 degrees across
constexpr double kMaxFocalRatio = 1.2;      // fx against fy: pixels of common sensors are square
constexpr double kMaxCentreOffset = 0.25;   // of the principal point from the image's, in widths and heights
constexpr double kMaxSwappedOffset = 0.04;  // likewise, where width and height have changed places
constexpr double kMinSwappedOffset = 0.08;  // likewise, before that is thought of

// What the model's own check would only call invalid, and what is valid but hardly meant.
void check_plausible(const CameraModel& model, const std::string& file, double pixel_aspect,
                     std::vector<std::string>* warnings) {
  const auto fail = [&](const std::string& what) { throw InputError("calibration " + file + ": " + what); };
  const auto warn = [&](const std::string& what) {
    if (warnings) warnings->push_back("calibration " + file + ": " + what);
  };
  const double width = model.width, height = model.height;
  const std::string size = format("%dx%d", model.width, model.height);
  const std::string centre = format("(%.6g, %.6g)", double{model.cx}, double{model.cy});
  const double longer = std::max(width, height);
  const double focal = std::max(model.fx, model.fy);
  if (focal > 0 && longer >= 16) {
    if (focal < 10 && model.cx <= 1 && model.cy <= 1) {
      fail(format("fx = %.6g and the principal point ", double{model.fx}) + centre +
           " seem to be fractions of the image's size: give them in pixels");
    }
    if (focal < kMinFocalFraction * longer) {
      fail(format("fx = %.6g is too short for images of ", double{model.fx}) + size +
           ": give it in pixels, millimetres x width / the sensor's width in millimetres");
    }
  }
  const auto offset = [&](double w, double h) {
    return std::max(std::abs(model.cx / w - 0.5), std::abs(model.cy / h - 0.5));
  };
  const bool swapped =
      offset(width, height) > kMinSwappedOffset && offset(height, width) < kMaxSwappedOffset && width != height;
  const std::string swapped_text = "the principal point " + centre + " is not near the centre of " + size +
                                   format(" but of %dx%d", model.height, model.width) +
                                   ": are width and height swapped, or was the image turned after calibration?";
  const bool inside = model.cx >= 0 && model.cy >= 0 && model.cx <= width - 1 && model.cy <= height - 1;
  if (!inside && swapped) fail(swapped_text);
  if (!inside) {
    fail("the principal point " + centre + " is outside the image of " + size +
         ": were the images cropped or resized after calibration?");
  }
  if (swapped) {
    warn(swapped_text);
  } else if (offset(width, height) > kMaxCentreOffset) {
    warn("the principal point " + centre + " is far from the centre of " + size +
         ": were the images cropped or resized after calibration?");
  }
  if (focal > kMaxFocalFraction * longer)
    warn(format("fx = %.6g is very long for images of ", double{model.fx}) + size + ": is it in pixels?");
  const double aspect = model.fy / model.fx;
  const auto differs = [aspect](double other) { return std::max(aspect / other, other / aspect) > kMaxFocalRatio; };
  if (differs(1) && differs(pixel_aspect) && differs(1 / pixel_aspect)) {  // the last: of turned images
    warn(format("fx = %.6g and fy = %.6g differ by over 20 %%: are the pixels that far from square?", double{model.fx},
                double{model.fy}));
  }
}

void read_shutter(const CalibrationSection& section, Calibration* calibration) {
  const auto seconds = [&](const char* key) {
    const double value = section.number_or_zero(key);
    if (value < 0 || value > 1) section.fail(std::string(key) + " is not between 0 and 1 second");
    return value;
  };
  calibration->exposure_s = static_cast<float>(seconds("exposure_s"));
  const double readout_s = seconds("readout_s");
  const std::string axis = section.has("readout_axis") ? section.text("readout_axis") : "rows";
  if (axis != "rows" && axis != "columns") section.fail("readout_axis is neither rows nor columns");
  const double direction = section.has("readout_direction") ? section.number("readout_direction") : 1;
  if (direction != 1 && direction != -1) section.fail("readout_direction is neither 1 nor -1");
  const bool rows = axis == "rows";
  calibration->shutter.axis = rows ? RollingShutter::Axis::kRows : RollingShutter::Axis::kColumns;
  const int lines = rows ? calibration->model.height : calibration->model.width;
  calibration->shutter.line_time_s = static_cast<float>(direction * readout_s / lines);
}

// What yaml-cpp throws becomes an InputError.
template <typename Read>
auto with_yaml_errors(const std::string& file, const Read& read) {
  try {
    return read();
  } catch (const YAML::Exception& error) {
    throw InputError("calibration " + file + ": " + error.msg);
  }
}

std::vector<std::byte> bytes_of(const std::filesystem::path& file) {
  std::error_code ignored;
  if (std::filesystem::is_directory(file, ignored)) {
    throw InputError("calibration " + file.string() + ": is a folder, give the file in it");
  }
  std::error_code no_size;
  if (std::filesystem::file_size(file, no_size) > kMaxCalibrationBytes && !no_size) {
    throw InputError("calibration " + file.string() +
                     ": has over 32 MB; if it is a calibration, keep only the camera's lines in a copy");
  }
  try {
    return read_file(file, kMaxCalibrationBytes);
  } catch (const InputError& error) {
    throw InputError(std::string("calibration ") + error.what());
  }
}

}  // namespace

Calibration read_calibration(const std::filesystem::path& file, std::vector<std::string>* warnings,
                             double pixel_aspect) {
  return calibration_of(bytes_of(file), file.string(), warnings, pixel_aspect);
}

Calibration calibration_of(std::vector<std::byte> bytes, const std::string& name, std::vector<std::string>* warnings,
                           double pixel_aspect) {
  const std::string text = calibration_text(std::move(bytes), name);
  return with_yaml_errors(name, [&] {
    Calibration calibration;
    if (is_colmap(text)) {
      calibration.model = read_colmap_lens(text, name, warnings);
      check_plausible(calibration.model, name, pixel_aspect, warnings);
    } else {
      const CalibrationSection camera = first_camera(parse_calibration(text, name, warnings));
      calibration.model = read_lens(camera);
      check_plausible(calibration.model, name, pixel_aspect, warnings);
      read_shutter(camera, &calibration);
    }
    const Status status = calibration.model.validate();
    if (!status.ok()) throw InputError("calibration " + name + ": " + status.message());
    return calibration;
  });
}

Eigen::Isometry3d read_camera_to_body(const std::filesystem::path& file) {
  const std::string name = file.string();
  const std::string text = calibration_text(bytes_of(file), name);
  return with_yaml_errors(name, [&] {
    const CalibrationSection root = parse_calibration(text, name, nullptr);
    const bool kalibr = !root.has("T_BS") && root.has("cam0");
    const std::string key = kalibr ? "T_cam_imu" : "T_BS";
    const std::vector<double> data = kalibr ? root.section("cam0").numbers(key) : root.numbers(key);
    if (data.size() != 16) root.fail(key + " needs sixteen numbers");
    const Eigen::Matrix4d T = Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(data.data());
    const Eigen::Matrix3d R = T.topLeftCorner<3, 3>();
    // Printed with six digits or more, a rotation is orthogonal to 1e-5.
    const bool rotation = (R * R.transpose() - Eigen::Matrix3d::Identity()).norm() < 1e-3 && R.determinant() > 0;
    if (!rotation || T.row(3) != Eigen::RowVector4d(0, 0, 0, 1)) root.fail(key + " is not a rigid motion");
    Eigen::Isometry3d told = Eigen::Isometry3d::Identity();
    told.linear() = Eigen::Quaterniond(R).normalized().toRotationMatrix();
    told.translation() = T.topRightCorner<3, 1>();
    return kalibr ? told.inverse() : told;
  });
}

std::string calibration_yaml(const Calibration& calibration) {
  const CameraModel& m = calibration.model;
  const bool columns = calibration.shutter.axis == RollingShutter::Axis::kColumns;
  const double line_time_s = static_cast<double>(calibration.shutter.line_time_s);
  const double readout_s = std::abs(line_time_s) * (columns ? m.width : m.height);
  const char* distortion = "none";
  int coefficients = 0;
  if (m.distortion == Distortion::kFov) {
    distortion = "fov";
    coefficients = 1;
  } else if (m.distortion == Distortion::kRadTan) {
    distortion = "radtan";
    coefficients = m.coeffs[4] == 0 ? 4 : 5;
  } else if (m.distortion == Distortion::kEquidistant) {
    distortion = "equidistant";
    coefficients = 4;
  }
  const auto number = [](double value, int digits = 9) { return format("%.*g", digits, value); };
  std::string coeffs;
  for (int i = 0; i < coefficients; ++i) coeffs += (i > 0 ? ", " : "") + number(static_cast<double>(m.coeffs[i]));
  const auto px = [&](float value) { return number(static_cast<double>(value)); };
  return "# Pixel centres at integers. readout_* and exposure_s: rolling shutter, seconds; direction 1: larger\n"
         "# coordinates are exposed later. A frame's timestamp is the mid-exposure of the image centre.\n"
         "cam0:\n"
         "  camera_model: pinhole\n"
         "  intrinsics: [" +
         px(m.fx) + ", " + px(m.fy) + ", " + px(m.cx) + ", " + px(m.cy) +
         "]\n"
         "  distortion_model: " +
         distortion +
         "\n"
         "  distortion_coeffs: [" +
         coeffs +
         "]\n"
         "  resolution: [" +
         std::to_string(m.width) + ", " + std::to_string(m.height) +
         "]\n"
         "  readout_s: " +
         number(readout_s, 7) +
         "\n"
         "  readout_axis: " +
         (columns ? "columns" : "rows") +
         "\n"
         "  readout_direction: " +
         (line_time_s < 0 ? "-1" : "1") +
         "\n"
         "  exposure_s: " +
         number(static_cast<double>(calibration.exposure_s), 7) + "\n";
}

Calibration guess_calibration(int width, int height, double fov_degrees) {
  if (!(fov_degrees >= 1 && fov_degrees < 170)) {
    throw InputError("a field of view of " + std::to_string(fov_degrees) + " degrees is not between 1 and 170");
  }
  Calibration calibration;
  CameraModel& model = calibration.model;
  model.width = width;
  model.height = height;
  // The image's edges lie at -0.5 and width - 0.5.
  model.fx = static_cast<float>(0.5 * width / std::tan(0.5 * fov_degrees * std::numbers::pi / 180));
  model.fy = model.fx;
  model.cx = 0.5f * static_cast<float>(width - 1);
  model.cy = 0.5f * static_cast<float>(height - 1);
  const Status status = model.validate();
  if (!status.ok()) {
    throw InputError("a field of view of " + std::to_string(fov_degrees) +
                     " degrees does not fit: " + status.message());
  }
  return calibration;
}

}  // namespace pptam::platform
