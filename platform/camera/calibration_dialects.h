// The lens that a calibration file describes, for each program that writes such files.
//
// Our pixel centres lie at integers. Kalibr, OpenCV, ROS, EuRoC, ORB-SLAM and camodocal have them there too;
// Nerfstudio, as COLMAP, half a pixel further.
#pragma once

#include <pocket_ptam/camera_model.h>
#include "platform/camera/calibration_section.h"

namespace pptam::platform {

// The section of a file that holds one camera: the whole file, or the first camera of Kalibr's.
CalibrationSection first_camera(const CalibrationSection& root);

// Not validated. Throws InputError, also for lenses that are not supported: it names them and the way out.
CameraModel read_lens(const CalibrationSection& section);

}  // namespace pptam::platform
