#include "platform/camera/calibration_dialects.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <string_view>

#include "platform/camera/calibration_lens.h"

namespace pptam::platform {
namespace {

using Section = CalibrationSection;

// ---- Sizes and matrices --------------------------------------------------------------------------------------------

void set_size(const Section& section, CameraModel* model) {
  constexpr const char* kPairs[][2] = {{"image_width", "image_height"},
                                       {"Camera.width", "Camera.height"},
                                       {"Camera.cols", "Camera.rows"},
                                       {"width", "height"},
                                       {"cols", "rows"},
                                       {"img_width", "img_height"},
                                       {"frame_width", "frame_height"},
                                       {"LEFT.width", "LEFT.height"},
                                       {"w", "h"}};
  for (const auto& [width, height] : kPairs) {
    const bool one_letter = std::string_view(width).size() == 1;  // such a key alone may be anything
    if (one_letter ? !(section.has(width) && section.has(height)) : !section.has(width) && !section.has(height))
      continue;
    model->width = section.pixels(section.number(width), width);
    model->height = section.pixels(section.number(height), height);
    return;
  }
  const std::string list = section.any_of({"resolution", "image_size", "img_size", "image_resolution", "frame_size"});
  if (list.empty()) {
    section.fail(
        "the size of the images is missing: add the lines image_width: W and image_height: H, of the images that were "
        "calibrated");
  }
  const std::vector<double> size = section.numbers(list);
  if (size.size() != 2) section.fail(list + " needs two numbers, [width, height]");
  model->width = section.pixels(size[0], list);
  model->height = section.pixels(size[1], list);
}

// For a list of another length than needed; in a list, a decimal comma makes two numbers of one.
std::string counted(size_t count, bool too_many) {
  return ", it has " + std::to_string(count) + (too_many ? ": are there decimal commas? Write points" : "");
}

void set_matrix(const Section& section, const std::string& key, CameraModel* model) {
  const std::vector<double> K = section.numbers(key);
  if (K.size() != 9) {
    section.fail(key + " needs nine numbers" + counted(K.size(), K.size() > 9));
  }
  if (std::all_of(K.begin(), K.begin() + 8, [](double k) { return k == 0; }))
    section.fail(key + " is all zero: the camera is not calibrated");
  if ((K[6] != 0 || K[7] != 0) && K[2] == 0 && K[5] == 0)
    section.fail(key + " is written column by column, as MATLAB does: write it row by row");
  // Optimisers leave traces of a skew that is fixed at zero.
  const bool skew = std::abs(K[1]) > 1e-6 * std::abs(K[0]);
  if (skew || K[3] != 0 || K[6] != 0 || K[7] != 0 || K[8] != 1)
    section.fail(key + " is not [fx, 0, cx, 0, fy, cy, 0, 0, 1]: skew is not supported");
  set_focal(K[0], K[4], K[2], K[5], model);
}

// ---- Kalibr, EuRoC -------------------------------------------------------------------------------------------------

CameraModel read_kalibr(const Section& section) {
  const std::string camera = section.text("camera_model");
  if (camera != "pinhole") {
    section.fail("camera model " + camera +
                 " is not supported: calibrate with pinhole (pinhole-radtan, or pinhole-equi for wide lenses)");
  }
  CameraModel model;
  if (!section.has("resolution")) section.fail("resolution is missing");
  set_size(section, &model);
  const std::vector<double> f = section.numbers("intrinsics");
  if (f.size() != 4) section.fail("intrinsics needs four numbers, [fu, fv, pu, pv]" + counted(f.size(), f.size() > 4));
  set_focal(f[0], f[1], f[2], f[3], &model);
  const std::string name = section.text("distortion_model");
  const std::optional<Distortion> kind = distortion_named(name);
  if (!kind) refuse_distortion(section, name);
  const std::string key = section.any_of({"distortion_coeffs", "distortion_coefficients"});
  if (*kind != Distortion::kNone && key.empty()) section.fail("distortion_coeffs is missing");
  set_distortion(section, *kind, *kind == Distortion::kNone ? std::vector<double>() : section.numbers(key), &model);
  return model;
}

// ---- camodocal, VINS -----------------------------------------------------------------------------------------------

CameraModel read_camodocal(const Section& section) {
  const std::string type = section.text("model_type");
  const std::string plain = plain_name(type);
  CameraModel model;
  set_size(section, &model);
  const bool kannala_brandt = plain == "kannalabrandt";
  if (!kannala_brandt && plain != "pinhole") {
    section.fail("camera model " + type +
                 " is not supported: calibrate with PINHOLE, or KANNALA_BRANDT for wide lenses");
  }
  const Section projection = section.section("projection_parameters");
  if (kannala_brandt) {
    set_focal(projection.number("mu"), projection.number("mv"), projection.number("u0"), projection.number("v0"),
              &model);
    set_equidistant(
        section, {projection.number("k2"), projection.number("k3"), projection.number("k4"), projection.number("k5")},
        &model);
  } else {
    const Section distortion = section.section("distortion_parameters");
    set_focal(projection.number("fx"), projection.number("fy"), projection.number("cx"), projection.number("cy"),
              &model);
    set_radtan(section,
               {distortion.number("k1"), distortion.number("k2"), distortion.number("p1"), distortion.number("p2")},
               &model);
  }
  return model;
}

// ---- ORB-SLAM, stella_vslam, and others that give each number a key ------------------------------------------------

// prefix: of fx, cx, k1 and so on, "Camera." or nothing.
CameraModel read_single_keys(const Section& section, const std::string& prefix) {
  const bool nerfstudio = prefix.empty() && section.has("fl_x");
  const std::string fx = nerfstudio ? "fl_x" : prefix + "fx";
  const std::string fy = nerfstudio ? "fl_y" : prefix + "fy";
  const double centre = nerfstudio ? 0.5 : 0;
  CameraModel model;
  set_size(section, &model);
  set_focal(section.number(fx), section.number(fy), section.number(prefix + "cx") - centre,
            section.number(prefix + "cy") - centre, &model);

  const std::optional<Distortion> kind =
      named_distortion(section, {"Camera.type", "Camera.model", "distortion_model"}, {"camera_model", "model", "type"});
  const auto numbered = [&](std::initializer_list<const char*> names) {
    std::vector<double> list;
    for (const char* name : names) list.push_back(section.number_or_zero(prefix + name));
    return list;
  };
  const bool radial_only = section.has(prefix + "k3") && !section.has(prefix + "p1");
  if (!kind && radial_only) {
    section.fail("k1, k2, k3 without p1, p2 and the model's name: add the line fisheye_model: 1 (equidistant) or 0");
  }
  if (kind.value_or(Distortion::kRadTan) == Distortion::kRadTan) {
    const std::vector<double> k = numbered({"k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"});
    set_radtan(section, k, &model);
  } else if (*kind == Distortion::kEquidistant) {
    for (const char* name : {"k1", "k2", "k3", "k4"}) (void)section.number(prefix + name);  // none may be missing
    set_equidistant(section, numbered({"k1", "k2", "k3", "k4"}), &model);
  } else if (*kind == Distortion::kFov) {
    section.fail("fov distortion is not read from this kind of file: use Kalibr's form");
  }
  return model;
}

CameraModel read_orb_slam(const Section& section) {
  const std::string prefix = section.has("Camera1.fx") ? "Camera1." : "Camera.";
  const CameraModel model = read_single_keys(section, prefix);
  const std::string reduced = section.any_of({"Camera.newWidth", "Camera.newHeight"});
  if (!reduced.empty()) {
    section.warn(reduced + " is not applied: the images are expected as they were calibrated; --resize shrinks them");
  }
  if (section.has("Camera2.fx")) section.warn("holds two cameras: Camera1 is taken");
  const bool rectified = section.has("Camera.type") && plain_name(section.text("Camera.type")) == "rectified";
  if (rectified || section.has("LEFT.K")) {
    section.warn(
        "Camera.fx and so on are those of rectified images: the recording must hold such images, not raw ones");
  }
  return model;
}

// ---- OpenCV, ROS, and others that give a matrix and a list ---------------------------------------------------------

// What sensor_msgs/CameraInfo says: the matrix is that of the whole sensor; of it a region is read out, in pixels
// before binning, and neighbours are joined into larger pixels. Centres at integers: x in it is (x + 0.5) / binning -
// 0.5.
void apply_readout_region(const Section& section, CameraModel* model) {
  const double binning_x = std::max(1.0, section.number_or_zero("binning_x"));
  const double binning_y = std::max(1.0, section.number_or_zero("binning_y"));
  double x = 0, y = 0, width = model->width, height = model->height;
  if (section.has_section("roi")) {
    const Section roi = section.section("roi");
    x = roi.number_or_zero("x_offset");
    y = roi.number_or_zero("y_offset");
    if (roi.number_or_zero("width") != 0) width = roi.number("width");
    if (roi.number_or_zero("height") != 0) height = roi.number("height");
    if (x < 0 || y < 0 || width < 1 || height < 1 || x + width > model->width || y + height > model->height)
      section.fail("roi is not inside the image");
  }
  if (binning_x != std::floor(binning_x) || binning_y != std::floor(binning_y) || binning_x > width ||
      binning_y > height)
    section.fail("binning_x or binning_y is not a whole number of pixels of the image");
  model->width = section.pixels(std::floor(width / binning_x), "roi");
  model->height = section.pixels(std::floor(height / binning_y), "roi");
  set_focal(model->fx / binning_x, model->fy / binning_y, (model->cx - x + 0.5) / binning_x - 0.5,
            (model->cy - y + 0.5) / binning_y - 0.5, model);
}

struct MatrixKeys {
  std::string matrix;
  std::string coeffs;  // empty: there are none
};

// A key of nine numbers; `k` may be a coefficient elsewhere.
MatrixKeys find_matrix(const Section& section) {
  const auto first_list = [&](std::initializer_list<const char*> keys) -> std::string {
    for (const char* key : keys) {
      if (section.has_list(key)) return section.any_of({key});
    }
    return "";
  };
  const std::string single = first_list({"camera_matrix", "K", "intrinsic_matrix", "mtx"});
  if (!single.empty()) {
    return {single, section.any_of({"distortion_coefficients", "distortion_coeffs", "dist_coeffs", "dist_coeff",
                                    "dist_coefs", "distortion", "dist", "D"})};
  }
  constexpr const char* kStereo[][2] = {{"camera_matrix_1", "dist_coeffs_1"},
                                        {"camera_matrix_1", "distortion_coefficients_1"},
                                        {"camera_matrix_left", "dist_coeffs_left"},
                                        {"left_camera_matrix", "left_distortion_coefficients"},
                                        {"M1", "D1"},
                                        {"K1", "D1"},
                                        {"LEFT.K", "LEFT.D"}};
  for (const auto& [matrix, coeffs] : kStereo) {
    if (!section.has_list(matrix) || !section.has(coeffs)) continue;
    section.warn("holds two cameras: the first is taken, " + section.any_of({matrix}) + " and " +
                 section.any_of({coeffs}));
    return {section.any_of({matrix}), section.any_of({coeffs})};
  }
  return {};
}

CameraModel read_matrix(const Section& section, const MatrixKeys& keys) {
  CameraModel model;
  set_size(section, &model);
  set_matrix(section, keys.matrix, &model);
  if (keys.coeffs.empty()) {
    section.fail(
        "the distortion coefficients are missing: if the lens has none, add distortion_coefficients: [0,0,0,0]");
  }
  const std::vector<double> coeffs = section.numbers(keys.coeffs);
  const std::optional<Distortion> kind = named_distortion(section, {"distortion_model"}, {"camera_model", "model"});
  if (kind) {
    set_distortion(section, *kind, coeffs, &model);
  } else {
    set_unnamed_distortion(section, coeffs, &model);
  }
  if (!section.any_of({"binning_x", "binning_y", "roi"}).empty()) apply_readout_region(section, &model);
  return model;
}

}  // namespace

Section first_camera(const Section& root) {
  constexpr int kMaxCameras = 16;  // of one rig
  std::vector<std::string> cameras;
  for (int i = 0; i < kMaxCameras; ++i) {
    if (root.has("cam" + std::to_string(i))) cameras.push_back("cam" + std::to_string(i));
  }
  if (cameras.empty()) return root;
  if (cameras.size() > 1) {
    root.warn("holds " + std::to_string(cameras.size()) + " cameras: the first is taken, " + cameras[0]);
  }
  return root.section(cameras[0]);
}

CameraModel read_lens(const Section& section) {
  if (section.has("model_type")) return read_camodocal(section);
  if (section.has("intrinsics") && !section.has_section("intrinsics")) return read_kalibr(section);
  if (section.has("Camera.fx") || section.has("Camera1.fx")) return read_orb_slam(section);
  if (section.has_section("Camera") && section.section("Camera").has("fx"))
    return read_single_keys(section.section("Camera"), "");
  if (const MatrixKeys keys = find_matrix(section); !keys.matrix.empty()) return read_matrix(section, keys);
  if (section.has("fx") || section.has("fl_x")) return read_single_keys(section, "");

  if (section.has_section("value0")) {
    section.fail(
        "this is Basalt's calibration, which is not read: calibrate with Kalibr's pinhole-radtan or pinhole-equi");
  }
  if (section.has("cam0_calib")) {
    section.fail("this is VINS-Fusion's configuration: give the file that cam0_calib names, " +
                 section.text("cam0_calib"));
  }
  section.fail(
      "neither intrinsics (Kalibr, EuRoC) nor camera_matrix or K (OpenCV, ROS) nor Camera.fx (ORB-SLAM) is there, and "
      "it "
      "is not COLMAP's cameras.txt; it holds " +
      section.keys());
}

}  // namespace pptam::platform
