// Camera trajectories in the TUM format: "timestamp tx ty tz qx qy qz qw", seconds, camera-to-world.
#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace pptam::platform {

struct StampedPose {
  int64_t timestamp_ns = 0;
  Eigen::Isometry3d T_wc = Eigen::Isometry3d::Identity();
};
using Trajectory = std::vector<StampedPose>;  // increasing timestamps

// Comments (#) and blank lines are skipped. Throws InputError naming file and line on anything else: a missing file,
// too few numbers, NaN, a zero quaternion, time not increasing.
Trajectory read_tum_trajectory(const std::filesystem::path& file);

// Fixed formatting (timestamps with 6 decimals or more if needed to be exact to the nanosecond, numbers with 9
// significant digits): equal trajectories give equal bytes. header goes into a leading comment line when not empty.
void write_tum_trajectory(const std::filesystem::path& file, const Trajectory& trajectory, const std::string& header);

// Decimal seconds ("1305031102.175304", "1.3e+09", "-0.5") to nanoseconds, exactly (rounded beyond the ninth decimal).
// False when text is not a number or does not fit.
bool parse_timestamp_s(std::string_view text, int64_t* timestamp_ns);

}  // namespace pptam::platform
