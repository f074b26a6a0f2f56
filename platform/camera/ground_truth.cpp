#include "platform/camera/ground_truth.h"

#include <system_error>

#include "platform/camera/calibration.h"
#include "platform/input_error.h"

namespace pptam::platform {
namespace {

namespace fs = std::filesystem;

constexpr const char* kEurocTruth = "state_groundtruth_estimate0";

bool is_there(const fs::path& file) {
  std::error_code ignored;
  return fs::exists(file, ignored);
}

Trajectory read_body(const GroundTruthFile& file, std::vector<std::string>* warnings) {
  if (!is_there(file.euroc_sensor)) {
    throw InputError(
        file.euroc.string() + ": the poses are of the body, and " + file.euroc_sensor.string() +
        ", whose T_BS says where the camera sits in it, is missing: add it, or give Kalibr's camchain, whose "
        "T_cam_imu says it too, as --calibration");
  }
  const Eigen::Isometry3d T_bc = read_camera_to_body(file.euroc_sensor);
  Trajectory trajectory = read_euroc_trajectory(file.euroc, warnings);
  for (StampedPose& pose : trajectory) pose.T_wc = pose.T_wc * T_bc;
  if (file.euroc.parent_path().filename() != kEurocTruth) {
    warnings->push_back(file.euroc.string() + ": taken for the ground truth, there is no " + kEurocTruth);
  }
  return trajectory;
}

}  // namespace

GroundTruthFile find_tum_ground_truth(const fs::path& folder) {
  const fs::path file = folder / "groundtruth.txt";
  return is_there(file) ? GroundTruthFile{.tum = file} : GroundTruthFile{};
}

GroundTruthFile find_euroc_ground_truth(const fs::path& camera) {
  const fs::path sequence = fs::absolute(camera).lexically_normal().parent_path();
  for (const char* body : {kEurocTruth, "mocap0"}) {
    const fs::path file = sequence / body / "data.csv";
    if (is_there(file)) return {.euroc = file, .euroc_sensor = camera / "sensor.yaml"};
  }
  return {};
}

Trajectory read_ground_truth(const GroundTruthFile& file, TimeSpan images, std::vector<std::string>* warnings) {
  std::vector<std::string> ignored;
  if (warnings == nullptr) warnings = &ignored;
  try {
    if (!file.tum.empty()) return read_trajectory(file.tum, images, warnings);
    if (!file.euroc.empty()) return read_body(file, warnings);
  } catch (const InputError& error) {
    warnings->push_back(std::string("ground truth left out: ") + error.what());
  } catch (const fs::filesystem_error& error) {
    warnings->push_back(std::string("ground truth left out: ") + error.what());
  }
  return {};
}

}  // namespace pptam::platform
