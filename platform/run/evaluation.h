// How far an estimated trajectory is from the truth: absolute and relative error, and the share of wrong poses.
//
// Both trajectories are camera-to-world poses of the same camera. The estimate's world differs from the truth's by an
// unknown similarity (a monocular map has no unit and no north), which is estimated first.
#pragma once

#include <Eigen/Geometry>
#include <string>
#include <vector>

#include "platform/trajectory.h"

namespace pptam::platform {

// p_truth = scale * R * p_estimate + t.
struct Similarity {
  double scale = 1;
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  Eigen::Vector3d t = Eigen::Vector3d::Zero();
  Eigen::Vector3d operator*(const Eigen::Vector3d& p) const { return scale * (R * p) + t; }
};

// One pose of the sparser of the two, and where the other one was then.
struct AssociatedPose {
  int64_t timestamp_ns = 0;                                // of the sparser one
  Eigen::Isometry3d T_wc = Eigen::Isometry3d::Identity();  // estimate, in its own world
  Eigen::Isometry3d truth_T_wc = Eigen::Isometry3d::Identity();
  Eigen::Vector3d aligned = Eigen::Vector3d::Zero();  // alignment * T_wc.translation()
  double position_error = 0;                          // after alignment, units of the truth
  bool wrong = false;
};

struct Evaluation {
  std::vector<AssociatedPose> poses;
  int estimate_poses = 0, truth_poses = 0;  // associated or not
  bool at_truth_times = false;  // the truth is the sparser one: few poses, but what lies between is not invented
  double covered_fraction =
      0;  // of the truth's time span: within successive estimate poses at most 3 usual steps apart
  // Of the truth from the first to the last associated pose; where its poses are over 0.15 s apart, of the scaled
  // estimate between them if it is right at both.
  double path_length = 0;
  double extent = 0;  // diagonal of the box round the associated truth positions

  Similarity alignment;                              // least squares over all associated positions [Umeyama 1991]
  Similarity robust_alignment;                       // over the poses that agree with the majority along the path
  double ate_rmse = 0, ate_median = 0, ate_max = 0;  // position error after alignment, units of the truth
  double ate_percent() const { return 100 * ate_rmse / path_length; }

  // Motion over one second, 0.1 s more or less (translation scaled by the robust alignment): rms error.
  int relative_pairs = 0;           // 0: the trajectory is too short, the two errors below mean nothing
  double relative_translation = 0;  // units of the truth
  double relative_rotation_deg = 0;

  // A pose is wrong when, after the robust alignment, it is off by more than a tenth of the extent or by more than 5
  // degrees. (A hand-held camera one metre away from its scene that moves over half a metre: 5 cm; 5 degrees shift
  // the view by 9 cm. Virtual objects then stand visibly in another place. Independent of the duration.)
  int wrong_poses = 0;
  double wrong_fraction = 0;
  // Angle between the world's z axis in the estimate and in the truth; the rotation between the worlds comes from the
  // orientations of the poses that agree, and so does not suffer when the path is a straight line.
  double vertical_error_deg = 0;
};

constexpr double kWrongExtentFraction = 0.1;
constexpr double kWrongRotationDeg = 5;

// Poses are compared at the times of the estimate, or at those of the truth when its usual interval is more than 1.5
// times the estimate's. The other one is interpolated between neighbours at most 0.15 s apart (positions linearly,
// rotations by slerp); elsewhere its nearest pose within 0.02 s is taken. Throws InputError when there is nothing to
// compare: fewer than 3 associated poses, no motion, numbers that are not finite or beyond 1e15. The names (files, or
// "ground truth") go into the message. Fewer than kFewPoses say little: the alignment, of 7 unknowns, fits them too
// well.
constexpr size_t kFewPoses = 15;
Evaluation evaluate(const Trajectory& estimate, const Trajectory& truth, const std::string& estimate_name,
                    const std::string& truth_name);

}  // namespace pptam::platform
