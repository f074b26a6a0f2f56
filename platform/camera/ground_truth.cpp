#include "platform/camera/ground_truth.h"

#include <array>
#include <charconv>
#include <cmath>
#include <string_view>

#include "platform/camera/calibration.h"
#include "platform/input_error.h"
#include "platform/text_file.h"

namespace pptam::platform {
namespace {

namespace fs = std::filesystem;

// state_groundtruth_estimate0/data.csv: "timestamp, p_x, p_y, p_z, q_w, q_x, q_y, q_z, ..." of the body in the world.
Trajectory read_euroc_poses(const fs::path& file, const Eigen::Isometry3d& T_bc) {
  Trajectory trajectory;
  for_each_line(file, [&](std::string_view line, const LineError& fail) {
    std::array<std::string_view, 8> words;
    for (std::string_view& word : words) {
      const size_t cut = std::min(line.find(','), line.size());
      word = trimmed(line.substr(0, cut));
      line = cut < line.size() ? line.substr(cut + 1) : std::string_view();
    }
    StampedPose pose;
    if (!parse_integer(words[0], &pose.timestamp_ns)) fail("the timestamp is not a number of nanoseconds");
    std::array<double, 7> v{};
    for (size_t i = 0; i < v.size(); ++i) {
      const std::string_view word = words[i + 1];
      const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), v[i]);
      if (error != std::errc() || end != word.data() + word.size() || !std::isfinite(v[i])) {
        fail("expected a timestamp and 7 finite numbers, p_x p_y p_z q_w q_x q_y q_z");
      }
    }
    Eigen::Quaterniond q(v[3], v[4], v[5], v[6]);
    if (!(std::abs(q.norm() - 1) < 0.1)) fail("the quaternion is not of unit length");
    if (!trajectory.empty() && pose.timestamp_ns <= trajectory.back().timestamp_ns) {
      fail("the timestamp is not later than the one before");
    }
    q.normalize();
    Eigen::Isometry3d T_wb = Eigen::Isometry3d::Identity();
    T_wb.linear() = q.toRotationMatrix();
    T_wb.translation() = Eigen::Vector3d(v[0], v[1], v[2]);
    pose.T_wc = T_wb * T_bc;
    trajectory.push_back(pose);
  });
  return trajectory;
}
}  // namespace

Trajectory read_ground_truth(const GroundTruthFile& file) {
  if (!file.tum.empty()) return read_tum_trajectory(file.tum);
  if (!file.euroc.empty()) return read_euroc_poses(file.euroc, read_camera_to_body(file.euroc_sensor));
  return {};
}

}  // namespace pptam::platform
