#include "platform/camera/calibration_lens.h"

#include <algorithm>
#include <iterator>

namespace pptam::platform {
namespace {

constexpr const char* kWayOut =
    ": calibrate with five coefficients (k1, k2, p1, p2, k3), or as fisheye (equidistant) with four";

bool is_zero(double value) {
  return value == 0;
}

// Lenses that are not supported, by their plain names.
bool is_other_lens(const std::string& plain) {
  constexpr const char* kNames[] = {
      "omni",      "omnidirectional",  "omniradtan", "mei",          "unified",        "doublesphere",   "ds",
      "eucm",      "extendedunified",  "ucm",        "scaramuzza",   "ocam",           "ocamcalib",      "division",
      "thinprism", "thinprismfisheye", "rational",   "radtan8",      "pinholeradtan8", "rad8",           "fisheye624",
      "ftheta",    "stereographic",    "equisolid",  "orthographic", "spherical",      "equirectangular"};
  return std::find(std::begin(kNames), std::end(kNames), plain) != std::end(kNames);
}

}  // namespace

void set_radtan(const CalibrationSection& section, const std::vector<double>& coeffs, CameraModel* model) {
  if (coeffs.size() < 4 && !coeffs.empty())
    section.fail("radial-tangential distortion needs k1, k2, p1, p2 and maybe k3");
  const auto any_beyond = [&](size_t first) {
    return coeffs.size() > first && !std::all_of(coeffs.begin() + static_cast<ptrdiff_t>(first), coeffs.end(), is_zero);
  };
  if (any_beyond(12)) section.fail(std::string("the tilted sensor's coefficients are not supported") + kWayOut);
  if (any_beyond(8)) section.fail(std::string("thin-prism distortion is not supported") + kWayOut);
  if (any_beyond(5)) {
    section.fail(std::string("rational distortion (more than k1, k2, p1, p2, k3) is not supported") + kWayOut);
  }
  for (size_t i = 0; i < std::min(coeffs.size(), size_t{5}); ++i) model->coeffs[i] = static_cast<float>(coeffs[i]);
  const bool none = std::all_of(coeffs.begin(), coeffs.end(), is_zero);
  model->distortion = none ? Distortion::kNone : Distortion::kRadTan;
}

void set_equidistant(const CalibrationSection& section, const std::vector<double>& coeffs, CameraModel* model) {
  if (coeffs.size() < 4 || !std::all_of(coeffs.begin() + 4, coeffs.end(), is_zero))
    section.fail("equidistant distortion needs four coefficients");
  for (size_t i = 0; i < 4; ++i) model->coeffs[i] = static_cast<float>(coeffs[i]);
  model->distortion = Distortion::kEquidistant;
}

std::optional<Distortion> distortion_named(const std::string& name) {
  const std::string plain = plain_name(name);
  const auto among = [&](std::initializer_list<const char*> names) {
    return std::find(names.begin(), names.end(), plain) != names.end();
  };
  if (among({"radtan", "radialtangential", "plumbbob", "rationalpolynomial", "opencv", "brownconrady", "perspective",
             "pinholeradtan"}))
    return Distortion::kRadTan;
  if (among({"equidistant", "equi", "fisheye", "opencvfisheye", "kannalabrandt", "kannalabrandt4", "kannalabrandt8",
             "kb4", "kb8", "pinholeequi"}))
    return Distortion::kEquidistant;
  if (among({"fov", "atan", "pinholefov"})) return Distortion::kFov;
  if (among({"none", "rectified"})) return Distortion::kNone;
  return {};
}

void set_distortion(const CalibrationSection& section, Distortion kind, const std::vector<double>& coeffs,
                    CameraModel* model) {
  model->distortion = kind;
  if (kind == Distortion::kRadTan) set_radtan(section, coeffs, model);
  if (kind == Distortion::kEquidistant) set_equidistant(section, coeffs, model);
  if (kind == Distortion::kFov) {
    if (coeffs.size() != 1) section.fail("fov distortion needs one coefficient");
    model->coeffs[0] = static_cast<float>(coeffs[0]);
  }
}

void refuse_distortion(const CalibrationSection& section, const std::string& name) {
  section.fail("distortion model " + name +
               " is not supported: use radtan (plumb_bob), equidistant (fisheye), fov or none");
}

std::optional<Distortion> named_distortion(const CalibrationSection& section, std::initializer_list<const char*> names,
                                           std::initializer_list<const char*> weak) {
  std::optional<Distortion> kind;
  std::string key = section.any_of(names);
  if (key.empty()) {
    for (const char* name : weak) {
      const std::string value = section.text_or_empty(name);
      const std::string plain = plain_name(value);
      if (distortion_named(value)) {
        key = name;
        break;
      }
      if (is_other_lens(plain)) refuse_distortion(section, value);
      if (!value.empty() && plain != "pinhole")
        section.warn(std::string(name) + ": " + value + " is not a lens model that is known: not regarded");
    }
  }
  if (!key.empty() && !section.text(key).empty()) {
    const std::string name = section.text(key);
    kind = distortion_named(name);
    // "pinhole" says how light goes through the lens's centre, not how the lens distorts.
    if (!kind && plain_name(name) != "pinhole") refuse_distortion(section, name);
  }
  const std::string flag = section.any_of({"fisheye_model", "fisheye", "is_fisheye", "Camera.bFishEye"});
  if (flag.empty()) return kind;
  const std::string value = plain_name(section.text(flag));
  const bool yes = value == "1" || value == "true" || value == "yes" || value == "on";
  if (!yes && value != "0" && value != "false" && value != "no" && value != "off")
    section.fail(flag + " is neither 0 nor 1");
  if (yes && kind && *kind != Distortion::kEquidistant) section.fail(flag + " and " + key + " contradict each other");
  if (yes) return Distortion::kEquidistant;
  return kind ? kind : Distortion::kRadTan;
}

void set_unnamed_distortion(const CalibrationSection& section, const std::vector<double>& coeffs, CameraModel* model) {
  set_radtan(section, coeffs, model);
  if (coeffs.size() == 4 && model->distortion != Distortion::kNone) {
    section.warn(
        "the file does not name the model of its four coefficients: they are taken for k1, k2, p1, p2; if they are "
        "those "
        "of a fisheye lens, add the line fisheye_model: 1");
  }
}

void set_focal(double fx, double fy, double cx, double cy, CameraModel* model) {
  model->fx = static_cast<float>(fx);
  model->fy = static_cast<float>(fy);
  model->cx = static_cast<float>(cx);
  model->cy = static_cast<float>(cy);
}

}  // namespace pptam::platform
