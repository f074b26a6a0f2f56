// The true path of a recording's camera, where the recording brings one: TUM's groundtruth.txt, EuRoC's estimate of the
// body's pose.
#pragma once

#include <filesystem>

#include "platform/trajectory.h"

namespace pptam::platform {

// At most one of the two is set.
struct GroundTruthFile {
  std::filesystem::path tum = {};           // groundtruth.txt
  std::filesystem::path euroc = {};         // state_groundtruth_estimate0/data.csv
  std::filesystem::path euroc_sensor = {};  // the sensor.yaml whose T_BS takes the camera to that body
};

// Camera-to-world poses; empty when there is no file. Throws InputError.
Trajectory read_ground_truth(const GroundTruthFile& file);

}  // namespace pptam::platform
