// What OpenCV does for us: finding the board's corners in an image, and solving for the lens.
//
// It lies in a module of its own, pocket-ptam-opencv.so (module_of_program()), that is loaded when first asked for: the
// program starts without OpenCV, in time and on systems that do not have it.
#pragma once

#include <Eigen/Core>
#include <array>
#include <filesystem>
#include <string>
#include <vector>

#include <pocket_ptam/camera_model.h>
#include <pocket_ptam/image.h>

namespace pptam::platform {

using Eigen::Vector2d;

// Distortions that are solved for, in the core's and OpenCV's order: radial k1, k2 and tangential p1, p2; these and k3;
// equidistant k1 to k4.
enum class LensKind { kNormal, kWide, kFisheye };

struct LensSolution {
  std::string trouble;  // why there is none; empty: there is one
  LensKind kind = LensKind::kNormal;
  double fx = 0, fy = 0, cx = 0, cy = 0;            // pixels
  std::array<double, 5> coeffs = {};                // as of CameraModel::coeffs
  double sigma_fx = 0, sigma_cx = 0, sigma_cy = 0;  // one standard deviation, pixels; 0: not told
  std::vector<std::vector<Vector2d>> predicted;     // where the lens shows the corners of each view
};

class BoardVision {
 public:
  virtual ~BoardVision() = default;

  // The corners of a board with so many, row by row, to a fraction of a pixel. thorough: also where a quick look finds
  // none, which takes ten times as long.
  virtual bool find(const GreyView& image, int across, int down, bool thorough,
                    std::vector<Vector2d>* corners) const = 0;
  // The largest board of any number of corners. False: none.
  virtual bool find_any(const GreyView& image, int* across, int* down) const = 0;
  // plane: the corners on the board; views: their pixels in each view.
  virtual LensSolution solve(int width, int height, const std::vector<Vector2d>& plane,
                             const std::vector<std::vector<Vector2d>>& views, LensKind kind) const = 0;
};

// The module's, loaded once; a test may name its file. Throws InputError that says
// what to install when the program was built without OpenCV or it cannot be loaded.
const BoardVision& board_vision(const std::filesystem::path& module = {});

}  // namespace pptam::platform
