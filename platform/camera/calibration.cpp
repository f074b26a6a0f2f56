#include "platform/camera/calibration.h"

#include <yaml-cpp/yaml.h>

#include <cmath>
#include <fstream>
#include <numbers>
#include <string>
#include <vector>

#include "platform/input_error.h"

namespace pptam::platform {
namespace {

constexpr size_t kMaxFileBytes = 64 * 1024;  // a camchain of eight cameras has 5 kB; bounds the parser's time
constexpr double kMaxNumber = 1e6;           // of any entry: beyond it the file is not a calibration

// A YAML mapping and the file that it comes from; every getter throws InputError naming that file and the key.
class Section {
 public:
  Section(std::string file, const YAML::Node& node) : file_(std::move(file)), node_(node) {
    if (!node_.IsMap()) fail("a mapping of keys to values was expected: this is not a camera calibration");
  }

  [[noreturn]] void fail(const std::string& what) const { throw InputError("calibration " + file_ + ": " + what); }

  bool has(const char* key) const { return at(key).IsDefined() && !at(key).IsNull(); }

  // The first of these keys that is there, else the first.
  const char* any_of(std::initializer_list<const char*> keys) const {
    for (const char* key : keys) {
      if (has(key)) return key;
    }
    return *keys.begin();
  }

  Section section(const char* key) const {
    if (!at(key).IsDefined() || !at(key).IsMap()) fail(std::string(key) + " is missing or not a mapping");
    return Section(file_, at(key));
  }

  std::string text(const char* key) const {
    if (!has(key)) fail(std::string(key) + " is missing");
    if (!at(key).IsScalar() || at(key).Scalar().size() > 40) fail(std::string(key) + " is not a word");
    std::string word = at(key).Scalar();
    for (char& c : word) {
      if (static_cast<unsigned char>(c) < ' ') c = ' ';
    }
    return word;
  }

  double number(const char* key) const {
    if (!has(key)) fail(std::string(key) + " is missing");
    return number(at(key), key);
  }

  std::vector<double> numbers(const char* key) const {
    if (!has(key)) fail(std::string(key) + " is missing");
    if (!at(key).IsSequence()) fail(std::string(key) + " is not a list of numbers, such as [1.0, 2.0]");
    std::vector<double> list;
    for (const YAML::Node& entry : at(key)) list.push_back(number(entry, key));
    return list;
  }

  int size_px(double number, const char* key) const {
    if (number != std::floor(number) || number < 1 || number > 16384) {
      fail(std::string(key) + " is not a number of pixels from 1 to 16384");
    }
    return static_cast<int>(number);
  }

 private:
  YAML::Node at(const char* key) const { return std::as_const(node_)[key]; }

  double number(const YAML::Node& node, const char* key) const {
    double value = 0;
    if (!node.IsScalar() || !YAML::convert<double>::decode(node, value)) {
      fail(std::string(key) + " holds something that is not a number");
    }
    if (!std::isfinite(value)) fail(std::string(key) + " holds NaN or infinity");
    if (std::abs(value) > kMaxNumber) fail(std::string(key) + " holds a number over a million: not a calibration");
    return value;
  }

  std::string file_;
  YAML::Node node_;
};

Section load(const std::filesystem::path& path) {
  const std::string file = path.string();
  std::error_code ignored;
  std::ifstream stream(path, std::ios::binary);
  if (!std::filesystem::is_regular_file(path, ignored) || !stream) {
    throw InputError("calibration " + file + ": there is no such readable file");
  }
  std::string text(kMaxFileBytes + 1, '\0');
  stream.read(text.data(), static_cast<std::streamsize>(text.size()));
  text.resize(static_cast<size_t>(stream.gcount()));
  if (text.size() > kMaxFileBytes) throw InputError("calibration " + file + ": larger than 64 kB, not a calibration");
  if (text.starts_with("%YAML")) text.erase(0, text.find('\n'));  // OpenCV writes %YAML:1.0, which is not YAML
  YAML::Node root;
  try {
    root = YAML::Load(text);
  } catch (const YAML::Exception& error) {
    throw InputError("calibration " + file + ": not readable as YAML: line " + std::to_string(error.mark.line + 1) +
                     ": " + error.msg);
  }
  return Section(file, root);
}

// Radial-tangential coefficients in OpenCV's order: k1 k2 p1 p2 [k3 [k4 k5 k6 [s1...]]].
void set_radtan(const Section& section, const std::vector<double>& coeffs, CameraModel* model) {
  if (coeffs.size() < 4 && !coeffs.empty())
    section.fail("radial-tangential distortion needs k1, k2, p1, p2 and maybe k3");
  bool any = false;
  for (size_t i = 0; i < coeffs.size(); ++i) {
    if (i >= 5 && coeffs[i] != 0) {
      section.fail(
          "rational or thin-prism distortion (more than k1, k2, p1, p2, k3) is not supported: calibrate with "
          "five coefficients, or with an equidistant model");
    }
    any = any || coeffs[i] != 0;
    if (i < 5) model->coeffs[i] = static_cast<float>(coeffs[i]);
  }
  model->distortion = any ? Distortion::kRadTan : Distortion::kNone;
}

void set_distortion(const Section& section, const std::string& name, const std::vector<double>& coeffs,
                    CameraModel* model) {
  if (name == "radtan" || name == "radial-tangential" || name == "plumb_bob" || name == "rational_polynomial") {
    set_radtan(section, coeffs, model);
  } else if (name == "equidistant" || name == "fisheye") {
    if (coeffs.size() != 4) section.fail("equidistant distortion needs four coefficients");
    for (size_t i = 0; i < 4; ++i) model->coeffs[i] = static_cast<float>(coeffs[i]);
    model->distortion = Distortion::kEquidistant;
  } else if (name == "fov") {
    if (coeffs.size() != 1) section.fail("fov distortion needs one coefficient");
    model->coeffs[0] = static_cast<float>(coeffs[0]);
    model->distortion = Distortion::kFov;
  } else if (name == "none") {
    model->distortion = Distortion::kNone;
  } else {
    section.fail("distortion model " + name + " is not supported: use radtan (plumb_bob), equidistant, fov or none");
  }
}

// Kalibr's cam0 and EuRoC's sensor.yaml.
void read_kalibr_model(const Section& section, CameraModel* model) {
  const std::string camera = section.text("camera_model");
  if (camera != "pinhole") {
    section.fail("camera model " + camera + " is not supported: calibrate with pinhole (pinhole-radtan, pinhole-equi)");
  }
  const std::vector<double> resolution = section.numbers("resolution");
  if (resolution.size() != 2) section.fail("resolution needs two numbers, [width, height]");
  model->width = section.size_px(resolution[0], "resolution");
  model->height = section.size_px(resolution[1], "resolution");
  const std::vector<double> intrinsics = section.numbers("intrinsics");
  if (intrinsics.size() != 4) section.fail("intrinsics needs four numbers, [fu, fv, pu, pv]");
  model->fx = static_cast<float>(intrinsics[0]);
  model->fy = static_cast<float>(intrinsics[1]);
  model->cx = static_cast<float>(intrinsics[2]);
  model->cy = static_cast<float>(intrinsics[3]);
  const std::string name = section.text("distortion_model");
  const char* key = section.any_of({"distortion_coeffs", "distortion_coefficients"});
  set_distortion(section, name, name == "none" ? std::vector<double>() : section.numbers(key), model);
}

// OpenCV's FileStorage and ROS's camera_info; the former has no distortion_model, and capitals in old files.
void read_opencv_model(const Section& section, CameraModel* model) {
  const char* width = section.any_of({"image_width", "image_Width"});
  const char* height = section.any_of({"image_height", "image_Height"});
  model->width = section.size_px(section.number(width), width);
  model->height = section.size_px(section.number(height), height);
  const char* matrix = section.any_of({"camera_matrix", "Camera_Matrix"});
  const std::vector<double> K = section.section(matrix).numbers("data");
  if (K.size() != 9) section.fail(std::string(matrix) + " needs nine numbers");
  if (K[1] != 0 || K[3] != 0 || K[6] != 0 || K[7] != 0 || K[8] != 1) {
    section.fail(std::string(matrix) + " is not [fx, 0, cx, 0, fy, cy, 0, 0, 1]: skew is not supported");
  }
  model->fx = static_cast<float>(K[0]);
  model->fy = static_cast<float>(K[4]);
  model->cx = static_cast<float>(K[2]);
  model->cy = static_cast<float>(K[5]);
  const char* distortion = section.any_of({"distortion_coefficients", "Distortion_Coefficients"});
  const std::string name = section.has("distortion_model") ? section.text("distortion_model") : "plumb_bob";
  set_distortion(section, name, section.section(distortion).numbers("data"), model);
}

void read_shutter(const Section& section, Calibration* calibration) {
  const auto seconds = [&](const char* key) {
    const double value = section.has(key) ? section.number(key) : 0;
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

}  // namespace

Calibration read_calibration(const std::filesystem::path& file) {
  const Section root = load(file);
  try {
    const Section section = root.has("cam0") ? root.section("cam0") : root;
    Calibration calibration;
    if (section.has("intrinsics")) {
      read_kalibr_model(section, &calibration.model);
    } else if (section.has("camera_matrix") || section.has("Camera_Matrix")) {
      read_opencv_model(section, &calibration.model);
    } else {
      section.fail("neither intrinsics (Kalibr, EuRoC) nor camera_matrix (OpenCV, ROS) is there");
    }
    const Status status = calibration.model.validate();
    if (!status.ok()) section.fail(status.message());
    read_shutter(section, &calibration);
    return calibration;
  } catch (const YAML::Exception& error) {
    root.fail(error.msg);
  }
}

Eigen::Isometry3d read_camera_to_body(const std::filesystem::path& file) {
  const Section root = load(file);
  try {
    const std::vector<double> data = root.section("T_BS").numbers("data");
    if (data.size() != 16) root.fail("T_BS needs sixteen numbers");
    const Eigen::Matrix4d T = Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(data.data());
    const Eigen::Matrix3d R = T.topLeftCorner<3, 3>();
    // Printed with six digits or more, a rotation is orthogonal to 1e-5.
    const bool rotation = (R * R.transpose() - Eigen::Matrix3d::Identity()).norm() < 1e-3 && R.determinant() > 0;
    if (!rotation || T.row(3) != Eigen::RowVector4d(0, 0, 0, 1)) root.fail("T_BS is not a rigid motion");
    Eigen::Isometry3d T_bc = Eigen::Isometry3d::Identity();
    T_bc.linear() = Eigen::Quaterniond(R).normalized().toRotationMatrix();
    T_bc.translation() = T.topRightCorner<3, 1>();
    return T_bc;
  } catch (const YAML::Exception& error) {
    root.fail(error.msg);
  }
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
