// Puts the numbers of a calibration file into a CameraModel. All throw InputError naming the file.
#pragma once

#include <initializer_list>
#include <optional>
#include <string>
#include <vector>

#include <pocket_ptam/camera_model.h>
#include "platform/camera/calibration_section.h"

namespace pptam::platform {

// In pixels, pixel centres at integers.
void set_focal(double fx, double fy, double cx, double cy, CameraModel* model);

// In OpenCV's order: k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [tx ty]]]]; all beyond k3 must be 0.
void set_radtan(const CalibrationSection& section, const std::vector<double>& coeffs, CameraModel* model);

// k1 k2 k3 k4; what follows must be 0.
void set_equidistant(const CalibrationSection& section, const std::vector<double>& coeffs, CameraModel* model);

void set_distortion(const CalibrationSection& section, Distortion kind, const std::vector<double>& coeffs,
                    CameraModel* model);

// Only where the file names no model: OpenCV's order is the habit. Its fisheye functions have four coefficients, too:
// of four a warning is given.
void set_unnamed_distortion(const CalibrationSection& section, const std::vector<double>& coeffs, CameraModel* model);

// By the many names that they go under; nothing when the name is none of them.
std::optional<Distortion> distortion_named(const std::string& name);

// The value of the first of these keys that is there; OpenCV's samples write `fisheye_model: 1` instead. Nothing where
// the file does not say. weak: keys that may also hold a product's name, such as model: GoPro; they count where they
// name a lens, and a lens that is not supported is refused.
std::optional<Distortion> named_distortion(const CalibrationSection& section, std::initializer_list<const char*> names,
                                           std::initializer_list<const char*> weak);

[[noreturn]] void refuse_distortion(const CalibrationSection& section, const std::string& name);

}  // namespace pptam::platform
