// The true path of a recording's camera, where the recording brings one: TUM's groundtruth.txt, EuRoC's and TUM-VI's
// poses of the body that carries the camera. It is an extra: nothing that is wrong with it stops a recording.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "platform/trajectory.h"

namespace pptam::platform {

// At most one of the two is set.
struct GroundTruthFile {
  std::filesystem::path tum = {};           // groundtruth.txt
  std::filesystem::path euroc = {};         // the data.csv of a body: see find_euroc_ground_truth()
  std::filesystem::path euroc_sensor = {};  // the sensor.yaml whose T_BS takes the camera to that body
};

// What lies beside TUM's rgb.txt, in folder.
GroundTruthFile find_tum_ground_truth(const std::filesystem::path& folder);

// What lies beside EuRoC's cam0, camera: state_groundtruth_estimate0/data.csv, else mocap0/data.csv (TUM-VI).
GroundTruthFile find_euroc_ground_truth(const std::filesystem::path& camera);

// Camera-to-world poses; empty when there is no file, and when the file is of no use: then warnings (may be null) says
// why. images: when the images were taken, which tells the unit of the truth's time stamps.
Trajectory read_ground_truth(const GroundTruthFile& file, TimeSpan images, std::vector<std::string>* warnings);

}  // namespace pptam::platform
