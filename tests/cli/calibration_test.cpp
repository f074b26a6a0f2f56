// Calibrations of every program that writes them: the same camera out of each, what is refused and how, hostile bytes;
// and the text files that they and others are read from.

#include "platform/camera/calibration.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <cstddef>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <string>
#include <vector>

#include "platform/input_error.h"
#include "platform/text_file.h"
#include "tests/support/random.h"
#include "tests/support/scratch_folder.h"

namespace pptam::platform {
namespace {

namespace fs = std::filesystem;

std::vector<std::byte> bytes_of_text(const std::string& text) {
  std::vector<std::byte> bytes(text.size());
  std::memcpy(bytes.data(), text.data(), text.size());
  return bytes;
}

Calibration from(const std::string& text, std::vector<std::string>* warnings) {
  return calibration_of(bytes_of_text(text), "c.yaml", warnings);
}

// One that gives no warning.
Calibration quiet(const std::string& text) {
  std::vector<std::string> warnings;
  const Calibration calibration = from(text, &warnings);
  for (const std::string& warning : warnings) ADD_FAILURE() << warning;
  return calibration;
}

std::string input_error(const std::function<void()>& f) {
  try {
    f();
  } catch (const InputError& error) {
    const std::string message = error.what();
    EXPECT_EQ(message.find('\n'), std::string::npos) << message;
    return message;
  }
  ADD_FAILURE() << "nothing was thrown";
  return "";
}

std::string refusal(const std::string& text) {
  const std::string error = input_error([&] { (void)from(text, nullptr); });
  EXPECT_TRUE(error.starts_with("calibration c.yaml: ")) << error << "\n" << text.substr(0, 300);
  return error;
}

::testing::AssertionResult holds(const std::string& text, const std::string& part) {
  if (text.find(part) != std::string::npos) return ::testing::AssertionSuccess();
  return ::testing::AssertionFailure() << "\"" << part << "\" is not in \"" << text << "\"";
}

::testing::AssertionResult only(const std::vector<std::string>& warnings, const std::string& part) {
  if (warnings.size() != 1) return ::testing::AssertionFailure() << warnings.size() << " warnings in place of one";
  if (!warnings[0].starts_with("calibration c.yaml: ")) return ::testing::AssertionFailure() << warnings[0];
  return holds(warnings[0], part);
}

const char* const kKalibr =
    "cam0:\n  camera_model: pinhole\n  intrinsics: [461.6, 460.3, 363.0, 248.1]\n  distortion_model: radtan\n"
    "  distortion_coeffs: [-0.27, 0.06, 0.0009, 1.7e-05]\n  resolution: [752, 480]\n  T_cam_imu:\n  - [1, 0, 0, 0]\n";
const char* const kEuroc =
    "sensor_type: camera\ncomment: VI-Sensor cam0\nT_BS:\n  cols: 4\n  rows: 4\n"
    "  data: [0, -1, 0, 1.0,\n         1, 0, 0, 2.0,\n         0, 0, 1, 3.0,\n         0.0, 0.0, 0.0, 1.0]\n"
    "rate_hz: 20\nresolution: [64, 48]\ncamera_model: pinhole\nintrinsics: [60, 61, 31, 24]\n"
    "distortion_model: radial-tangential\ndistortion_coefficients: [-0.02, 0.007, 0.0002, 1.8e-05]\n";
const char* const kOpenCv =
    "%YAML:1.0\n---\ncalibration_time: \"Thu 01 Jan 1970\"\nimage_width: 640\nimage_height: 480\n"
    "camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
    "   data: [ 5.2e+02, 0., 3.1e+02, 0.,\n       5.1e+02, 2.4e+02, 0., 0., 1. ]\n"
    "distortion_coefficients: !!opencv-matrix\n   rows: 5\n   cols: 1\n   dt: d\n"
    "   data: [ 0.1, -0.18, 0.001, 0.002, 0.03 ]\n";
const char* const kRos =
    "image_width: 640\nimage_height: 480\ncamera_name: narrow_stereo\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
    "  data: [520, 0, 310, 0, 510, 240, 0, 0, 1]\ndistortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n"
    "  cols: 5\n  data: [0.1, -0.18, 0.001, 0.002, 0.03]\nprojection_matrix:\n  rows: 3\n  cols: 4\n  data: [1]\n";

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return at == std::string::npos ? text : text.replace(at, from.size(), to);
}

TEST(Calibration, KalibrEurocOpenCvRos) {
  const auto read = [](const std::string& text) { return quiet(text); };
  const CameraModel kalibr = read(kKalibr).model;
  EXPECT_EQ(kalibr.width, 752);
  EXPECT_EQ(kalibr.height, 480);
  EXPECT_EQ(kalibr.fx, 461.6f);
  EXPECT_EQ(kalibr.fy, 460.3f);
  EXPECT_EQ(kalibr.cx, 363.0f);
  EXPECT_EQ(kalibr.cy, 248.1f);
  EXPECT_EQ(kalibr.distortion, Distortion::kRadTan);
  EXPECT_EQ(kalibr.coeffs[0], -0.27f);
  EXPECT_EQ(kalibr.coeffs[1], 0.06f);
  EXPECT_EQ(kalibr.coeffs[2], 0.0009f);
  EXPECT_EQ(kalibr.coeffs[3], 1.7e-05f);
  EXPECT_EQ(kalibr.coeffs[4], 0.0f);

  const CameraModel euroc = read(kEuroc).model;
  EXPECT_EQ(euroc.width, 64);
  EXPECT_EQ(euroc.fy, 61.0f);
  EXPECT_EQ(euroc.coeffs[3], 1.8e-05f);

  for (const char* text : {kOpenCv, kRos}) {
    const CameraModel model = read(text).model;
    EXPECT_EQ(model.width, 640);
    EXPECT_EQ(model.height, 480);
    EXPECT_EQ(model.fx, 520.0f);
    EXPECT_EQ(model.fy, 510.0f);
    EXPECT_EQ(model.cx, 310.0f);
    EXPECT_EQ(model.cy, 240.0f);
    EXPECT_EQ(model.distortion, Distortion::kRadTan);
    EXPECT_EQ(model.coeffs[2], 0.001f);
    EXPECT_EQ(model.coeffs[4], 0.03f);
  }
  const std::string four = replaced(kOpenCv, "0.1, -0.18, 0.001, 0.002, 0.03", "0.1, -0.18, 0.001, 0.002");
  std::vector<std::string> warnings;
  EXPECT_EQ(from(four, &warnings).model.coeffs[4], 0.0f);
  EXPECT_TRUE(only(warnings, "k1, k2, p1, p2"));  // they might be a fisheye lens's
  const std::string eight = replaced(kOpenCv, "0.03 ]", "0.03, 0, 0, 0 ]");
  EXPECT_EQ(read(eight).model.coeffs[4], 0.03f);
  const std::string fisheye = replaced(replaced(kRos, "plumb_bob", "equidistant"), "[0.1, -0.18, 0.001, 0.002, 0.03]",
                                       "[0.01, 0.02, 0.0, 0.0]");
  EXPECT_EQ(read(fisheye).model.distortion, Distortion::kEquidistant);
  const std::string fov = replaced(replaced(kKalibr, "radtan", "fov"), "[-0.27, 0.06, 0.0009, 1.7e-05]", "[0.9]");
  EXPECT_EQ(read(fov).model.distortion, Distortion::kFov);
  EXPECT_EQ(read(fov).model.coeffs[0], 0.9f);
  const std::string none = replaced(replaced(kKalibr, "radtan", "none"), "[-0.27, 0.06, 0.0009, 1.7e-05]", "[]");
  EXPECT_EQ(read(none).model.distortion, Distortion::kNone);
  const std::string zeros = replaced(kKalibr, "[-0.27, 0.06, 0.0009, 1.7e-05]", "[0, 0, 0, 0]");
  EXPECT_EQ(read(zeros).model.distortion, Distortion::kNone);
}

TEST(Calibration, ShutterKeys) {
  EXPECT_EQ(quiet(kKalibr).shutter.line_time_s, 0.0f);
  EXPECT_EQ(quiet(kKalibr).exposure_s, 0.0f);
  const Calibration columns =
      quiet(std::string(kKalibr) +
            "  readout_s: 0.0376\n  readout_axis: columns\n  readout_direction: -1\n  exposure_s: 0.008\n");
  EXPECT_EQ(columns.shutter.axis, RollingShutter::Axis::kColumns);
  EXPECT_FLOAT_EQ(columns.shutter.line_time_s, -0.0376f / 752);
  EXPECT_EQ(columns.exposure_s, 0.008f);
  const Calibration rows = quiet(std::string(kRos) + "readout_s: 0.024\n");
  EXPECT_EQ(rows.shutter.axis, RollingShutter::Axis::kRows);
  EXPECT_FLOAT_EQ(rows.shutter.line_time_s, 0.024f / 480);
}

// ---- One camera in every dialect -----------------------------------------------------------------------------------

// 240x320, f = 358.64, centre (119.5, 159.5), k1 = 0.01.
void expect_normal_lens(const CameraModel& model) {
  EXPECT_EQ(model.width, 240);
  EXPECT_EQ(model.height, 320);
  EXPECT_EQ(model.fx, 358.64f);
  EXPECT_EQ(model.fy, 358.64f);
  EXPECT_EQ(model.cx, 119.5f);
  EXPECT_EQ(model.cy, 159.5f);
  EXPECT_EQ(model.distortion, Distortion::kRadTan);
  EXPECT_EQ(model.coeffs[0], 0.01f);
  for (int i = 1; i < 5; ++i) EXPECT_EQ(model.coeffs[i], 0.0f);
}

// 240x320, f = 400, centre (119.5, 159.5), equidistant with k1 = 0.03, k2 = 0.01.
void expect_fisheye_lens(const CameraModel& model) {
  EXPECT_EQ(model.width, 240);
  EXPECT_EQ(model.height, 320);
  EXPECT_EQ(model.fx, 400.0f);
  EXPECT_EQ(model.fy, 400.0f);
  EXPECT_EQ(model.cx, 119.5f);
  EXPECT_EQ(model.cy, 159.5f);
  EXPECT_EQ(model.distortion, Distortion::kEquidistant);
  EXPECT_EQ(model.coeffs[0], 0.03f);
  EXPECT_EQ(model.coeffs[1], 0.01f);
  for (int i = 2; i < 5; ++i) EXPECT_EQ(model.coeffs[i], 0.0f);
}

const char* const kSize = "image_width: 240\nimage_height: 320\n";
const char* const kMatrix = "[358.64, 0, 119.5, 0, 358.64, 159.5, 0, 0, 1]";
const char* const kWideMatrix = "[400, 0, 119.5, 0, 400, 159.5, 0, 0, 1]";

std::string opencv_xml(const std::string& fisheye, const std::string& f, const std::string& coeffs) {
  return "<?xml version=\"1.0\"?>\n<opencv_storage>\n<calibration_time>\"Thu 01 Jan 1970\"</calibration_time>\n"
         "<image_width>240</image_width>\n<image_height>320</image_height>\n<fisheye_model>" +
         fisheye +
         "</fisheye_model>\n<camera_matrix type_id=\"opencv-matrix\">\n  <rows>3</rows>\n  <cols>3</cols>\n  "
         "<dt>d</dt>\n"
         "  <data>\n    " +
         f + " 0. 119.5 0. " + f +
         "\n    1.595e+02 0. 0. 1.</data></camera_matrix>\n"
         "<distortion_coefficients type_id=\"opencv-matrix\">\n  <data>\n    " +
         coeffs + "</data></distortion_coefficients>\n</opencv_storage>\n";
}

std::string ros_message(const char* k, const char* d, const std::string& width_and_height, const std::string& end) {
  return "header:\n  stamp:\n    sec: 5\n  frame_id: camera\n" + width_and_height + "distortion_model: plumb_bob\n" +
         d + ":\n- 0.01\n- 0.0\n- 0.0\n- 0.0\n- 0.0\n" + k +
         ":\n- 358.64\n- 0.0\n- 119.5\n- 0.0\n- 358.64\n- 159.5\n- 0.0\n- 0.0\n- 1.0\n"
         "r: [1, 0, 0, 0, 1, 0, 0, 0, 1]\np: [9, 0, 9, 0, 0, 9, 9, 0, 0, 0, 1, 0]\n" +
         end + "---\n";
}

// As ORB-SLAM's examples are, with what OpenCV's parser forgives: no blank after a colon.
std::string orb_slam(const std::string& more) {
  return "%YAML:1.0\n\n#----\nCamera.type: \"PinHole\"\n\nCamera.fx: 358.64\nCamera.fy:358.64\nCamera.cx: 119.5\n"
         "Camera.cy: 159.5\nCamera.k1: 0.01\nCamera.k2: 0.0\nCamera.p1: 0.0\nCamera.p2: 0.0\nCamera.fps: 30\n"
         "Viewer.PointSize:2\nRIGHT.D: !!opencv-matrix\n   rows: 1\n   data:[-0.28, 0.07]\n" +
         more;
}

std::string camodocal(const std::string& type, const std::string& parameters) {
  return "%YAML:1.0\n---\nmodel_type: " + type + "\ncamera_name: camera\n" + kSize + parameters;
}

TEST(Calibration, EveryDialectGivesTheSameLens) {
  const std::string size = kSize, matrix = kMatrix;
  const std::string rows = "[[358.64, 0, 119.5], [0, 358.64, 159.5], [0, 0, 1]]";
  const std::vector<std::string> texts = {
      "cam0:\n  camera_model: pinhole\n  intrinsics: [358.64, 358.64, 119.5, 159.5]\n  distortion_model: radtan\n"
      "  distortion_coeffs: [0.01, 0, 0, 0]\n  resolution: [240, 320]\n",
      opencv_xml("0", "358.64", "0.01 0. 0. 0. 0."),
      size + "fisheye_model: 0\ncamera_matrix: {data: " + matrix + "}\ndistortion_coefficients: {data: [0.01,0,0,0]}\n",
      size + "cameraMatrix: " + rows + "\ndistCoeffs: [[0.01, 0, 0, 0, 0]]\n",
      "mtx:\n- - 358.64\n  - 0.0\n  - 119.5\n- - 0.0\n  - 358.64\n  - 159.5\n- - 0.0\n  - 0.0\n  - 1.0\ndist:\n- - "
      "0.01\n"
      "  - 0\n  - 0\n  - 0\n  - 0\n" +
          size,
      "{\"image_size\": [240, 320], \"K\": " + rows + ", \"D\": [0.01, 0.0, 0.0, 0.0, 0.0]}",
      "{\n\t\"image_width\":240,\n\t\"image_height\":320,\n\t\"camera_matrix\":" + rows +
          ",\n\t\"dist_coeff\":[0.01,0,0,0,0]\n}",
      ros_message("k", "d", "height: 320\nwidth: 240\n", "binning_x: 0\nbinning_y: 0\n"),
      ros_message("K", "D", "height: 320\nwidth: 240\n", "") + ros_message("K", "D", "height: 3\nwidth: 2\n", ""),
      orb_slam("Camera.width: 240\nCamera.height: 320\n"),
      orb_slam(size),
      "Camera:\n  model: perspective\n  fx: 358.64\n  fy: 358.64\n  cx: 119.5\n  cy: 159.5\n  k1: 0.01\n  k2: 0\n"
      "  p1: 0\n  p2: 0\n  k3: 0\n  cols: 240\n  rows: 320\n",
      camodocal("PINHOLE",
                "distortion_parameters:\n   k1: 0.01\n   k2: 0\n   p1: 0\n   p2: 0\nprojection_parameters:\n"
                "   fx: 358.64\n   fy: 358.64\n   cx: 119.5\n   cy: 159.5\n"),
      "# Camera list\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n1 SIMPLE_RADIAL 240 320 358.64 120 160 0.01\n",
      "7 RADIAL 240 320 358.64 120 160 0.01 0\n",
      "1 OPENCV 240 320 358.64 358.64 120 160 0.01 0 0 0\n",
      "1 FULL_OPENCV 240 320 358.64 358.64 120 160 0.01 0 0 0 0 0 0 0\n",
      "{\"camera_model\": \"OPENCV\", \"fl_x\": 358.64, \"fl_y\": 358.64, \"cx\": 120, \"cy\": 160, \"w\": 240, \"h\": "
      "320,\n"
      "\"k1\": 0.01, \"k2\": 0, \"p1\": 0, \"p2\": 0, \"frames\": [{\"transform_matrix\": [[1, 0], [0, 1]]}]}",
  };
  for (const std::string& text : texts) {
    SCOPED_TRACE(text);
    expect_normal_lens(quiet(text).model);
  }
}

TEST(Calibration, EveryDialectGivesTheSameFisheyeLens) {
  const std::string size = kSize, matrix = kWideMatrix;
  const std::string four = "[0.03, 0.01, 0, 0]";
  const std::vector<std::string> texts = {
      "cam0:\n  camera_model: pinhole\n  intrinsics: [400, 400, 119.5, 159.5]\n  distortion_model: equidistant\n"
      "  distortion_coeffs: " +
          four + "\n  resolution: [240, 320]\n",
      opencv_xml("1", "400.", "0.03 0.01 0. 0."),
      size + "fisheye_model: 1\ncamera_matrix: {data: " + matrix + "}\ndistortion_coefficients: {data: " + four + "}\n",
      size + "fisheye_model: true\nK: " + matrix + "\nD: " + four + "\n",
      size + "distortion_model: fisheye\nK: " + matrix + "\nD: " + four + "\n",
      size + "distortion_model: \"equidistant\"\nk: " + matrix + "\nd: " + four + "\n",
      "Camera.type: \"KannalaBrandt8\"\nCamera1.fx: 400\nCamera1.fy: 400\nCamera1.cx: 119.5\nCamera1.cy: 159.5\n"
      "Camera1.k1: 0.03\nCamera1.k2: 0.01\nCamera1.k3: 0\nCamera1.k4: 0\nCamera.width: 240\nCamera.height: 320\n",
      camodocal("KANNALA_BRANDT",
                "projection_parameters:\n   k2: 0.03\n   k3: 0.01\n   k4: 0\n   k5: 0\n   mu: 400\n"
                "   mv: 400\n   u0: 119.5\n   v0: 159.5\n"),
      "1 OPENCV_FISHEYE 240 320 400 400 120 160 0.03 0.01 0 0\n",
      "1 RADIAL_FISHEYE 240 320 400 120 160 0.03 0.01\n",
  };
  for (const std::string& text : texts) {
    SCOPED_TRACE(text);
    expect_fisheye_lens(quiet(text).model);
  }
  const CameraModel fov = quiet("1 FOV 240 320 358.64 358.64 120 160 0.9\n").model;
  EXPECT_EQ(fov.distortion, Distortion::kFov);
  EXPECT_EQ(fov.coeffs[0], 0.9f);
  EXPECT_EQ(quiet("1 PINHOLE 240 320 358.64 358.64 120 160\n").model.distortion, Distortion::kNone);
  EXPECT_EQ(quiet("1 SIMPLE_PINHOLE 240 320 358.64 120 160\n").model.cx, 119.5f);
}

TEST(Calibration, ReadoutRegionAndBinningOfRosAreApplied) {
  const std::string whole = "height: 640\nwidth: 480\n";
  const auto message = [&](const std::string& end) {
    return quiet(replaced(replaced(ros_message("K", "D", whole, end), "119.5", "239.5"), "159.5", "319.5")).model;
  };
  // The sensor's centre stays the image's centre, which is at (W - 1) / 2: binned by two, of 239 and 319 pixels.
  const CameraModel binned =
      message("binning_x: 2\nbinning_y: 2\nroi: {x_offset: 0, y_offset: 0, height: 0, width: 0}\n");
  EXPECT_EQ(binned.width, 240);
  EXPECT_EQ(binned.height, 320);
  EXPECT_EQ(binned.fx, 358.64f / 2);
  EXPECT_EQ(binned.cx, 119.5f);
  EXPECT_EQ(binned.cy, 159.5f);
  const CameraModel cropped =
      message("roi: {x_offset: 40, y_offset: 60, height: 500, width: 400, do_rectify: false}\n");
  EXPECT_EQ(cropped.width, 400);
  EXPECT_EQ(cropped.height, 500);
  EXPECT_EQ(cropped.fx, 358.64f);
  EXPECT_EQ(cropped.cx, 199.5f);
  EXPECT_EQ(cropped.cy, 259.5f);
  const CameraModel both =
      message("binning_x: 2\nbinning_y: 2\nroi: {x_offset: 40, y_offset: 60, height: 500, width: 400}\n");
  EXPECT_EQ(both.width, 200);
  EXPECT_EQ(both.height, 250);
  EXPECT_EQ(both.cx, 99.5f);
  EXPECT_EQ(both.cy, 129.5f);
  const std::string outside = ros_message("K", "D", "height: 320\nwidth: 240\n", "roi: {x_offset: 9, width: 240}\n");
  EXPECT_TRUE(holds(refusal(outside), "roi is not inside"));
}

TEST(Calibration, LongListsAreCutBeforeParsing) {
  // 12 MB each: parsed whole, YAML would take over a gigabyte.
  std::string numbers, entries;
  while (numbers.size() < (size_t{12} << 20)) numbers += "4.03092732e+01, 2.5e+02,\n       ";
  while (entries.size() < (size_t{12} << 20)) entries += "- - 4.03092732e+01\n  - 2.5e+02\n";
  const std::string head = std::string(kSize) + "fisheye_model: 0\n";
  const std::string tail =
      std::string("camera_matrix: {data: ") + kMatrix + "}\ndistortion_coefficients: {data: [0.01, 0, 0, 0, 0]}\n";
  expect_normal_lens(quiet(head + "image_points: !!opencv-matrix\n   data: [ " + numbers + "1. ]\n" + tail).model);
  expect_normal_lens(quiet(head + "image_points:\n" + entries + tail).model);
  expect_normal_lens(quiet("# [ ' \" {\n" + head + "note: it's [fine]\n" + tail).model);
  std::string xml = opencv_xml("0", "358.64", "0.01 0. 0. 0. 0.");
  expect_normal_lens(
      quiet(replaced(xml, "<rows>3", "<points>" + std::string(size_t{12} << 20, '7') + "</points><rows>3")).model);
}

TEST(Calibration, TextOfAnyEditor) {
  const std::string text =
      "cam0:\n  camera_model: pinhole\n  intrinsics: [358.64, 358.64, 119.5, 159.5]\n  distortion_model: radtan\n"
      "  distortion_coeffs: [0.01, 0, 0, 0]\n  resolution: [240, 320]\n";
  const auto all = [&](std::string from_text, const std::string& old, const std::string& now) {
    for (size_t at = 0; (at = from_text.find(old, at)) != std::string::npos; at += now.size())
      from_text.replace(at, old.size(), now);
    return from_text;
  };
  std::string little, big;
  for (const char c : text) {
    little += {c, '\0'};
    big += {'\0', c};
  }
  expect_normal_lens(quiet("\xef\xbb\xbf" + text).model);
  expect_normal_lens(quiet("\xff\xfe" + little).model);
  expect_normal_lens(quiet("\xfe\xff" + big).model);
  expect_normal_lens(quiet(little).model);
  expect_normal_lens(quiet(big).model);
  expect_normal_lens(quiet(all(text, "\n", "\r\n")).model);
  expect_normal_lens(quiet(all(text, "\n", "\r")).model);
  expect_normal_lens(quiet(all(text, "  ", "\t")).model);
  expect_normal_lens(quiet(all(all(text, "  ", "\xc2\xa0 "), ", ", ",\xc2\xa0")).model);
  expect_normal_lens(quiet("# f\xfcr die Kamera\n" + text).model);
  EXPECT_TRUE(holds(refusal(all(text, "358.64", "358,64")), "decimal commas"));
  EXPECT_TRUE(holds(refusal(orb_slam(std::string(kSize) + "Camera.k3: 0,25\n")), "0,25\", with a decimal comma"));
}

TEST(Calibration, WhatIsAssumedIsSaid) {
  const auto warning = [](const std::string& text, const std::string& part) {
    std::vector<std::string> warnings;
    const CameraModel model = from(text, &warnings).model;
    EXPECT_TRUE(only(warnings, part)) << text;
    return model;
  };
  const std::string kalibr =
      "  camera_model: pinhole\n  intrinsics: [358.64, 358.64, 119.5, 159.5]\n  distortion_model: radtan\n"
      "  distortion_coeffs: [0.01, 0, 0, 0]\n  resolution: [240, 320]\n";
  const std::string other = replaced(kalibr, "0.01", "0.05");
  expect_normal_lens(warning("cam1:\n" + other + "cam0:\n" + kalibr, "2 cameras: the first is taken, cam0"));
  expect_normal_lens(quiet("cam1:\n" + kalibr).model);
  expect_normal_lens(warning("3 OPENCV 240 320 358.64 358.64 120 160 0.01 0 0 0\n4 PINHOLE 1 1 1 1 1 1\n", "camera 3"));
  expect_normal_lens(warning(
      std::string(kSize) + "M1: {data: " + kMatrix + "}\nD1: {data: [0.01, 0, 0, 0, 0]}\nM2: [1]\n", "M1 and D1"));
  expect_normal_lens(warning(std::string(kSize) + "cameraMatrix1: " + kMatrix + "\ndistCoeffs1: [0.01, 0, 0, 0, 0]\n",
                             "cameraMatrix1 and distCoeffs1"));
  expect_normal_lens(
      warning(orb_slam(std::string(kSize) + "Camera.newWidth: 120\n"), "Camera.newWidth is not applied"));
  expect_normal_lens(warning(orb_slam(std::string(kSize) + "LEFT.K: [1]\n"), "rectified"));
  expect_normal_lens(warning(std::string(kSize) + "K: " + kMatrix + "\nD: [0.01, 0, 0, 0]\n", "fisheye_model: 1"));
  const std::string camera = "cam0:\n" + kalibr;
  warning(replaced(camera, "[240, 320]", "[320, 240]"), "width and height swapped");
  warning(replaced(camera, "119.5", "30.5"), "far from the centre");
  warning(replaced(camera, "358.64", "250"), "over 20 %");
  warning(replaced(camera, "358.64, 358.64", "9999, 9999"), "very long");
}

TEST(Calibration, WhatIsNotSupportedIsNamedWithTheWayOut) {
  const std::string size = kSize;
  const std::string matrix = size + "camera_matrix: {data: " + kMatrix + "}\n";
  const auto coeffs = [&](const std::string& list) {
    return matrix + "distortion_coefficients: {data: [" + list + "]}\n";
  };
  const std::string kalibr =
      "cam0:\n  camera_model: pinhole\n  intrinsics: [358.64, 358.64, 119.5, 159.5]\n  distortion_model: radtan\n"
      "  distortion_coeffs: [0.01, 0, 0, 0]\n  resolution: [240, 320]\n";
  struct Case {
    std::string text;
    const char* name;
    const char* way_out;
  };
  const std::vector<Case> cases = {
      {replaced(kalibr, "pinhole", "omni"), "omni", "pinhole-equi"},
      {replaced(kalibr, "pinhole", "ds"), "camera model ds", "pinhole-equi"},
      {replaced(kalibr, "pinhole", "eucm"), "eucm", "pinhole-equi"},
      {camodocal("MEI", ""), "MEI", "KANNALA_BRANDT"},
      {"%YAML:1.0\nimu: 1\ncam0_calib: \"left.yaml\"\n", "VINS", "left.yaml"},
      {"{\"value0\": {\"intrinsics\": [{\"camera_type\": \"ds\"}]}}", "Basalt", "pinhole-equi"},
      {coeffs("0.1, 0.02, 0, 0, 0.01, 0.1, 0.02, 0.001"), "rational", "five coefficients"},
      {coeffs("0.1, 0, 0, 0, 0, 0, 0, 0, 1e-3, 0, 0, 0"), "thin-prism", "five coefficients"},
      {coeffs("0.1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1e-3, 0"), "tilted", "five coefficients"},
      {"1 THIN_PRISM_FISHEYE 240 320 400 400 120 160 0 0 0 0 0 0 0 0\n", "THIN_PRISM_FISHEYE", "OPENCV_FISHEYE"},
      {"1 OPENCV 240 320 400 120 160\n", "OPENCV", "8 parameters"},
      {orb_slam(""), "size of the images is missing", "image_width: W"},
      {matrix, "distortion coefficients are missing", "distortion_coefficients: [0,0,0,0]"},
      {coeffs("0, 0, 0, 0, .Nan"), "NaN", "distortion_coefficients"},
      {coeffs("0, 0, 0, 0, 1e400"), "million", "distortion_coefficients"},
      {size + "K: [358.64, 0, 0, 0, 358.64, 0, 119.5, 159.5, 1]\nD: []\n", "MATLAB", "row by row"},
      {size + "K: [0, 0, 0, 0, 0, 0, 0, 0, 0]\nD: []\n", "all zero", "not calibrated"},
      {size + "fisheye_model: 1\ndistortion_model: plumb_bob\nK: " + kMatrix + "\nD: [0, 0, 0, 0]\n", "contradict",
       "fish"},
      {matrix + "camera_matrix: {data: [1]}\n", "camera_matrix", "more than once"},
      {replaced(replaced(kalibr, "358.64", "4.2"), "358.64", "4.2"), "fx = 4.2", "millimetres"},
      {replaced(kalibr, "358.64, 358.64, 119.5, 159.5", "1.49, 1.12, 0.5, 0.5"), "fractions", "in pixels"},
      {replaced(kalibr, "[240, 320]", "[100, 320]"), "outside the image", "cropped or resized"},
      {replaced(replaced(replaced(kalibr, "[240, 320]", "[900, 200]"), "119.5", "99.5"), "159.5", "449.5"), "swapped",
       "of 200x900"},
      {replaced(replaced(kalibr, "radtan", "equidistant"), "358.64, 358.64", "60, 60"), "field of view", "170 degrees"},
      {"# oST version 5.0 parameters\n\n[image]\n\nwidth\n640\n", "ost.txt", "ost.yaml"},
      {"<calibration><width>240</width></calibration>", "<calibration>", "opencv_storage"},
      {"\x89PNG\r\n\x1a\n", "image", "PNG"},
      {std::string("\x1f\x8b\x08\0", 4), "gzip", "unpack it"},
      {"PK\x03\x04", "zip", "unpack it"},
      {"%PDF-1.7\n", "PDF", "not a calibration"},
      {std::string("\0\0\0\x20"
                   "ftypisom",
                   12),
       "video", "not a calibration"},
      {"focal: 3\nname: x\n", "Camera.fx (ORB-SLAM)", "it holds focal, name"},
  };
  for (const Case& c : cases) {
    const std::string error = refusal(c.text);
    EXPECT_TRUE(holds(error, c.name)) << c.text;
    EXPECT_TRUE(holds(error, c.way_out)) << c.text;
  }
  // Coefficients of zero are none.
  EXPECT_EQ(quiet(coeffs("0.01, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0")).model.coeffs[0], 0.01f);
}

TEST(Calibration, FilesThatAreNone) {
  const test::ScratchFolder scratch;
  const fs::path& folder = scratch.path();
  const auto error = [](const fs::path& file) {
    const std::string message = input_error([&] { (void)read_calibration(file, nullptr); });
    EXPECT_TRUE(holds(message, "calibration " + file.string() + ": "));
    return message;
  };
  EXPECT_TRUE(holds(error(folder), "is a folder"));
  EXPECT_TRUE(holds(error(folder / "none"), "there is no such file"));
  std::ofstream(folder / "large").put('a');
  fs::resize_file(folder / "large", 5'000'000'000);  // takes no space
  EXPECT_TRUE(holds(error(folder / "large"), "over 32 MB"));
  std::ofstream(folder / "good") << "1 OPENCV 240 320 358.64 358.64 120 160 0.01 0 0 0\n";
  expect_normal_lens(read_calibration(folder / "good", nullptr).model);
}

// The name of a product is no lens; a lens that is named is honoured, or refused, under any key.
TEST(Calibration, NamesOfProductsAreNoLenses) {
  const std::string matrix =
      "image_width: 240\nimage_height: 320\ncamera_matrix: [[358.64,0,119.5],[0,358.64,159.5],[0,0,1]]\n"
      "distortion_coefficients: [0.01, 0, 0, 0, 0]\n";
  const std::string keys =
      "width: 240\nheight: 320\nfx: 358.64\nfy: 358.64\ncx: 119.5\ncy: 159.5\nk1: 0.01\nk2: 0\np1: 0\np2: 0\n";
  for (const std::string& text : {matrix, keys}) {
    for (const char* name : {"camera_model: GoPro HERO9\n", "model: OmniVision OV5647\n"}) {
      std::vector<std::string> warnings;
      const Calibration calibration = from(text + name, &warnings);
      EXPECT_EQ(calibration.model.distortion, Distortion::kRadTan);
      EXPECT_TRUE(only(warnings, "is not a lens model that is known")) << name;
    }
    EXPECT_EQ(quiet(text + "camera_model: pinhole\n").model.distortion, Distortion::kRadTan);
    EXPECT_TRUE(holds(refusal(text + "camera_model: double_sphere\n"), "double_sphere is not supported"));
    EXPECT_TRUE(holds(refusal(text + "distortion_model: GoPro\n"), "GoPro is not supported"));
  }
  std::string fisheye = matrix + "model: fisheye\n";
  fisheye.replace(fisheye.find("0, 0, 0, 0]"), 11, "0, 0, 0]");
  EXPECT_EQ(quiet(fisheye).model.distortion, Distortion::kEquidistant);
}

// ---- Hostile -------------------------------------------------------------------------------------------------------

TEST(Calibration, HostileAndWrongOnesAreRefused) {
  struct Case {
    std::string text;
    const char* expected;
  };
  std::string nested = "cam0: ";
  for (int i = 0; i < 20000; ++i) nested += "[";
  std::string laughs = "a: &a [x,x,x,x,x,x,x,x,x]\n";  // nine aliases of nine aliases ...
  for (char c = 'b'; c < 'n'; ++c) {
    const std::string alias = std::string("*") + static_cast<char>(c - 1);
    laughs += std::string("x") + c + ": &" + c + " [";
    for (int i = 0; i < 9; ++i) laughs += (i == 0 ? "" : ",") + alias;
    laughs += "]\n";
  }
  const std::vector<Case> cases = {
      {"", "empty"},
      {"just text", "mapping"},
      {"[1, 2, 3]", "mapping"},
      {"a: 1\n", "neither intrinsics"},
      {"cam0: 5\n", "cam0"},
      {"cam0: [1]\n", "cam0"},
      {"cam0: {intrinsics: 5}\n", "camera_model"},
      {"\t- [}", "YAML"},
      {std::string("\0\xff\xfe\x01 abc", 8), "calibration c.yaml: "},
      {nested, "64 deep"},
      {laughs, "neither intrinsics"},
      {laughs + "intrinsics: *m\ncamera_model: pinhole\nresolution: [640, 480]\n", "not a number"},
      {std::string(100000, ' '), "empty"},
      {"a: " + std::string(100000, 'x'), "64 kB"},
      {replaced(kKalibr, "pinhole", "omni"), "omni"},
      {replaced(kKalibr, "pinhole", "ds"), "camera model ds"},
      {replaced(kKalibr, "radtan", "magic"), "magic"},
      {replaced(kKalibr, "461.6", ".nan"), "NaN"},
      {replaced(kKalibr, "461.6", "1e300"), "million"},
      {replaced(kKalibr, "461.6", ".inf"), "infinity"},
      {replaced(kKalibr, "461.6", "0"), "calibration c.yaml: "},
      {replaced(kKalibr, "461.6", "-5"), "calibration c.yaml: "},
      {replaced(kKalibr, "461.6", "abc"), "intrinsics"},
      {replaced(kKalibr, "461.6", "[1]"), "intrinsics"},
      {replaced(kKalibr, "461.6, ", ""), "four numbers"},
      {replaced(kKalibr, "[752, 480]", "[752.5, 480]"), "resolution"},
      {replaced(kKalibr, "[752, 480]", "[0, 480]"), "resolution"},
      {replaced(kKalibr, "[752, 480]", "[-752, 480]"), "resolution"},
      {replaced(kKalibr, "[752, 480]", "[752]"), "resolution"},
      {replaced(kKalibr, "[752, 480]", "752x480"), "resolution"},
      {replaced(kKalibr, "  resolution: [752, 480]\n", ""), "resolution is missing"},
      {replaced(kKalibr, "  distortion_model: radtan\n", ""), "distortion_model is missing"},
      {replaced(kKalibr, "[-0.27, 0.06, 0.0009, 1.7e-05]", "[-0.27]"), "k1, k2, p1, p2"},
      {replaced(kKalibr, "[-0.27, 0.06, 0.0009, 1.7e-05]", "{a: 1}"), "distortion_coeffs"},
      {replaced(kKalibr, "-0.27", "-9"), "calibration c.yaml: "},  // not monotonic over the image
      {replaced(kOpenCv, "0.03 ]", "0.03, 0.1, 0, 0 ]"), "rational"},
      {replaced(kOpenCv, "5.2e+02, 0.,", "5.2e+02, 3.,"), "skew"},
      {replaced(kOpenCv, "image_width: 640\n", ""), "image_width is missing"},
      {replaced(kRos, "plumb_bob", "equidistant"), "four coefficients"},
      {replaced(kRos, "  data: [520, 0, 310, 0, 510, 240, 0, 0, 1]\n", ""), "data is missing"},
      {std::string(kRos) + "readout_s: 2\n", "readout_s"},
      {std::string(kRos) + "readout_s: -0.01\n", "readout_s"},
      {std::string(kRos) + "readout_axis: diagonal\n", "readout_axis"},
      {std::string(kRos) + "readout_direction: 0\n", "readout_direction"},
      {std::string(kRos) + "exposure_s: never\n", "exposure_s"},
  };
  for (const Case& c : cases) {
    const std::string error = refusal(c.text);
    EXPECT_TRUE(holds(error, c.expected)) << c.text.substr(0, 300);
  }
}

TEST(Calibration, DeepOrLongOnesEndSoon) {
  const auto many = [](const std::string& text, int times) {
    std::string all;
    for (int i = 0; i < times; ++i) all += text;
    return all;
  };
  std::string deeper;
  for (int i = 0; i < 300; ++i) deeper += std::string(static_cast<size_t>(i), ' ') + "a:\n";
  for (const std::string& text :
       {many("[", 100000), many("{a: ", 100000), many("- ", 30000), many("? ", 30000), many("&a ", 20000),
        many("!", 60000), many(":", 60000), many("a: \"", 10000), "a: '" + many("''\n", 20000),
        "a: >\n" + many("  b\n\n", 10000), many("<a>", 50000), "<a " + many("b=\"\" ", 100000) + ">", deeper,
        many("a: [1,\n", 5000), many("\xff", 1000),
        std::string(
            "<!DOCTYPE a [<!ENTITY b \"bb\"><!ENTITY c \"&b;&b;\">]><opencv_storage><k>&c;</k></opencv_storage>"),
        std::string(
            "<!DOCTYPE a [<!ENTITY b SYSTEM \"file:///dev/zero\">]><opencv_storage><k>&b;</k></opencv_storage>")})
    (void)refusal(text);
}

TEST(Calibration, AlteredOnesGiveALensOrAnError) {
  test::Random random;
  int refused = 0;
  for (const std::string& whole : {std::string(kKalibr), std::string(kEuroc), std::string(kOpenCv), std::string(kRos),
                                   orb_slam(kSize), opencv_xml("1", "400.", "0.03 0.01 0. 0."),
                                   ros_message("k", "d", "height: 320\nwidth: 240\n", "binning_x: 2\n"),
                                   std::string("1 OPENCV 240 320 358.64 358.64 120 160 0.01 0 0 0\n")}) {
    for (int i = 0; i < 300; ++i) {
      std::string text = whole;
      if (i < 100) {
        text.resize(static_cast<size_t>(random.integer(0, static_cast<int>(text.size()) - 1)));
      } else {
        for (int changes = i % 3; changes >= 0; --changes) {
          const auto at = static_cast<size_t>(random.integer(0, static_cast<int>(text.size()) - 1));
          text[at] =
              i % 2 ? static_cast<char>(random.integer(0, 255)) : "[]{}:,-'\"#&*!<>\n\t 0.e"[random.integer(0, 21)];
        }
      }
      try {
        EXPECT_TRUE(from(text, nullptr).model.validate().ok());
      } catch (const InputError&) {
        ++refused;
      }
    }
  }
  EXPECT_GT(refused, 800);
  EXPECT_LT(refused, 2300);  // some still are calibrations
}

// ---- Text files ----------------------------------------------------------------------------------------------------

TEST(TextFile, IsTheSameFromEveryEditor) {
  const auto text = [](const std::string& bytes) { return text_of(bytes_of_text(bytes), "t.txt"); };
  EXPECT_EQ(text(""), "");
  EXPECT_EQ(text("a\nb"), "a\nb\n");
  EXPECT_EQ(text("a\r\nb\r\n"), "a\nb\n");
  EXPECT_EQ(text("a\rb\r"), "a\nb\n");
  EXPECT_EQ(text("a\r\n\r\rb"), "a\n\n\nb\n");
  EXPECT_EQ(text("\xef\xbb\xbf"
                 "a"),
            "a\n");
  EXPECT_EQ(text(std::string("\xff\xfe"
                             "a\0\r\0\n\0b\0",
                             10)),
            "a\nb\n");
  EXPECT_EQ(text(std::string("\xfe\xff"
                             "\0a\0\n",
                             6)),
            "a\n");
  EXPECT_EQ(text(std::string("a\0b\0c\0", 6)), "abc\n");
  EXPECT_EQ(text(std::string("\0a\0b\0c", 6)), "abc\n");
  // U+00E4, U+20AC, U+1F600 as a pair, half a pair alone.
  EXPECT_EQ(text(std::string("\xff\xfe\xe4\0\xac\x20\x3d\xd8\x00\xde\x3d\xd8", 12)),
            "\xc3\xa4\xe2\x82\xac\xf0\x9f\x98\x80\xef\xbf\xbd\n");
  EXPECT_EQ(text("\xc2\xa0"), "\xc2\xa0\n");  // file names may hold it
  for (const std::string& binary : {std::string("a\0b", 3), std::string("\0\0\0\0", 4), std::string("\xff\xfe\0\0", 4)})
    EXPECT_EQ(input_error([&] { (void)text(binary); }), "t.txt: is not a text file");
}

TEST(TextFile, LinesAndIntegers) {
  const fs::path file = fs::path(::testing::TempDir()) / ("pptam_lines_" + std::to_string(::getpid()) + ".txt");
  const auto lines = [&](const std::string& text) {
    std::ofstream(file, std::ios::binary) << text;
    std::vector<std::string> list;
    for_each_line(file, [&](std::string_view line, const LineError& fail) {
      if (line == "bad") fail("is bad");
      list.emplace_back(line);
    });
    return list;
  };
  EXPECT_EQ(lines("\xef\xbb\xbf# c\r\n a b\t\r\n\r\n#\r\nc"), (std::vector<std::string>{"a b", "c"}));
  EXPECT_EQ(input_error([&] { lines("a\r\rbad\r"); }), file.string() + ":3: is bad");
  EXPECT_TRUE(holds(input_error([&] { lines("a\n" + std::string(70000, 'x')); }), ":2: a line of more than 64 kB"));
  fs::remove(file);
  EXPECT_TRUE(holds(input_error([&] { (void)read_text(file); }), "there is no such file"));
  int64_t value = 0;
  EXPECT_TRUE(parse_integer("-9223372036854775808", &value));
  EXPECT_EQ(value, INT64_MIN);
  for (const char* none : {"", "-", "1.0", "9223372036854775808", "1 ", "x"}) EXPECT_FALSE(parse_integer(none, &value));
}

}  // namespace
}  // namespace pptam::platform
