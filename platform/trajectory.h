// Camera trajectories in the TUM format: "timestamp tx ty tz qx qy qz qw", seconds, camera-to-world; and what other
// programs write in its place: columns between commas, semicolons or tabs, EuRoC's tables (nanoseconds, q_w first).
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
// too few numbers, a quaternion that is none, KITTI's matrices, more than 300000 poses. What can be mended is, with a
// line in warnings: a header line without #, poses of NaN or with a quaternion of zeros (trackers write them when they
// are lost; left out), doubled (the first stays) and unordered time stamps (sorted). Without warnings (null) these are
// errors too.
Trajectory read_tum_trajectory(const std::filesystem::path& file, std::vector<std::string>* warnings = nullptr);

// As above, two that are to be compared. Stamps that are milliseconds, microseconds or nanoseconds are recognised by
// their steps and by what makes the two cover the same time, and converted, with a warning. Throws InputError when two
// units are as likely.
struct TrajectoryPair {
  Trajectory estimate, truth;
};
TrajectoryPair read_trajectories(const std::filesystem::path& estimate, const std::filesystem::path& truth,
                                 std::vector<std::string>* warnings);

// As above, one beside images taken from first_ns to last_ns.
struct TimeSpan {
  int64_t first_ns = 0, last_ns = 0;
};
Trajectory read_trajectory(const std::filesystem::path& file, TimeSpan images, std::vector<std::string>* warnings);

// EuRoC's data.csv of a body, with or without its header: nanoseconds, p_x p_y p_z, q_w q_x q_y q_z, and more that is
// not read.
Trajectory read_euroc_trajectory(const std::filesystem::path& file, std::vector<std::string>* warnings);

// Fixed formatting (timestamps with 6 decimals or more if needed to be exact to the nanosecond, numbers with 9
// significant digits): equal trajectories give equal bytes. header goes into a leading comment line when not empty.
std::string tum_text(const Trajectory& trajectory, const std::string& header);
// The same as a file; throws InputError when it cannot be written.
void write_tum_trajectory(const std::filesystem::path& file, const Trajectory& trajectory, const std::string& header);

// Decimal seconds ("1305031102.175304", "1.3e+09", "-0.5") to nanoseconds, exactly (rounded beyond the ninth decimal).
// False when text is not a number or does not fit.
bool parse_timestamp_s(std::string_view text, int64_t* timestamp_ns);

}  // namespace pptam::platform
