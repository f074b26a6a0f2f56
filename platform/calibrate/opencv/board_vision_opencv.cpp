// The module pocket-ptam-opencv.so: platform/calibrate/board_vision.h by OpenCV.

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "platform/calibrate/board_vision.h"

namespace pptam::platform {
namespace {

constexpr int kSearchSide_px = 1000;   // longer side of the image in which boards are sought: more costs time only
constexpr double kWindowShare = 0.45;  // of the distance between corners: a corner's window holds no other corner
constexpr int kMinWindow_px = 2;       // half sides of that window
constexpr int kMaxWindow_px = 15;
constexpr double kSoftness_px = 1.0;    // of a blur before corners are centred: between pixels the image is smooth then
constexpr double kMaxBoardRatio = 3.0;  // between neighbouring distances of corners, else it is no board

cv::Mat as_mat(const GreyView& image) {
  return {image.height, image.width, CV_8UC1, const_cast<uint8_t*>(image.data), static_cast<size_t>(image.stride)};
}

// The smallest distance between two corners that are neighbours on the board, pixels.
double min_spacing(const std::vector<cv::Point2f>& corners, int across) {
  double least = 1e9;
  for (size_t i = 0; i < corners.size(); ++i) {
    const bool last = (i + 1) % static_cast<size_t>(across) == 0;
    if (!last) least = std::min(least, cv::norm(corners[i + 1] - corners[i]));
    if (i + static_cast<size_t>(across) < corners.size())
      least = std::min(least, cv::norm(corners[i + static_cast<size_t>(across)] - corners[i]));
  }
  return least;
}

// Along rows and columns distances change slowly, whatever the tilt.
bool is_regular(const std::vector<cv::Point2f>& corners, int across) {
  const auto smooth = [&](size_t a, size_t b, size_t c) {
    const double first = cv::norm(corners[b] - corners[a]), second = cv::norm(corners[c] - corners[b]);
    return first < kMaxBoardRatio * second && second < kMaxBoardRatio * first;
  };
  const size_t row = static_cast<size_t>(across);
  for (size_t i = 0; i < corners.size(); ++i) {
    if (i % row + 2 < row && !smooth(i, i + 1, i + 2)) return false;
    if (i + 2 * row < corners.size() && !smooth(i, i + row, i + 2 * row)) return false;
  }
  return true;
}

double sample_at(const cv::Mat& image, double x, double y) {
  const int ix = std::clamp(static_cast<int>(x), 0, image.cols - 2),
            iy = std::clamp(static_cast<int>(y), 0, image.rows - 2);
  const double fx = x - ix, fy = y - iy;
  const float* const top = image.ptr<float>(iy) + ix;
  const float* const bottom = image.ptr<float>(iy + 1) + ix;
  return (1 - fy) * ((1 - fx) * static_cast<double>(top[0]) + fx * static_cast<double>(top[1])) +
         fy * ((1 - fx) * static_cast<double>(bottom[0]) + fx * static_cast<double>(bottom[1]));
}

// Moves a corner to where the image round it is most alike to itself turned by 180 degrees, which holds for a corner of
// the board under any tilt, blur and gamma: least squares of I(q + d) - I(q - d) over a round window. What the light
// changes across the window, P (a d) with P the mean of both, is solved for besides. image: floats.
void centre_corner(const cv::Mat& image, double radius, cv::Point2f* corner) {
  constexpr int kSteps = 8;
  constexpr double kFarthest_px = 1;  // from the start: beyond, something else was found
  Vector2d q(static_cast<double>(corner->x), static_cast<double>(corner->y));
  const Vector2d start = q;
  const int reach = static_cast<int>(radius);
  for (int step = 0; step < kSteps; ++step) {
    Eigen::Matrix4d A = Eigen::Matrix4d::Zero();
    Eigen::Vector4d b = Eigen::Vector4d::Zero();
    for (int y = 0; y <= reach; ++y) {  // half of the window: the other half is the same pairs
      for (int x = y == 0 ? 1 : -reach; x <= reach; ++x) {
        const double distance_sq = x * x + y * y;
        if (distance_sq > radius * radius) continue;
        const double ahead = sample_at(image, q.x() + x, q.y() + y), behind = sample_at(image, q.x() - x, q.y() - y);
        const auto slope = [&](double dx, double dy) {
          return 0.5 *
                 (sample_at(image, q.x() + x + dx, q.y() + y + dy) - sample_at(image, q.x() + x - dx, q.y() + y - dy) -
                  sample_at(image, q.x() - x + dx, q.y() - y + dy) + sample_at(image, q.x() - x - dx, q.y() - y - dy));
        };
        const double mean = 0.5 * (ahead + behind);
        const Eigen::Vector4d row(slope(1, 0), slope(0, 1), mean * x / radius, mean * y / radius);
        const double weight = std::exp(-2 * distance_sq / (radius * radius));
        A += weight * row * row.transpose();
        b -= weight * row * (ahead - behind);
      }
    }
    const Vector2d move = A.ldlt().solve(b).head<2>();
    if (!move.allFinite()) return;
    q += move;
    if ((q - start).norm() > kFarthest_px) return;
    if (move.norm() < 1e-4) break;
  }
  *corner = {static_cast<float>(q.x()), static_cast<float>(q.y())};
}

class OpenCvVision : public BoardVision {
 public:
  bool find(const GreyView& view, int across, int down, bool thorough, std::vector<Vector2d>* corners) const override {
    try {
      return find_corners(as_mat(view), {across, down}, thorough, corners);
    } catch (const cv::Exception&) {
      return false;
    }
  }

  bool find_any(const GreyView& view, int* across, int* down) const override {
    try {
      cv::Mat small;
      shrink(as_mat(view), &small);
      std::vector<cv::Point2f> found;
      cv::Mat meta;
      if (!cv::findChessboardCornersSB(small, {3, 3}, found, cv::CALIB_CB_LARGER | cv::CALIB_CB_NORMALIZE_IMAGE, meta))
        return false;
      *across = meta.cols;
      *down = meta.rows;
      return true;
    } catch (const cv::Exception&) {
      return false;
    }
  }

  LensSolution solve(int width, int height, const std::vector<Vector2d>& plane,
                     const std::vector<std::vector<Vector2d>>& views, LensKind kind) const override {
    LensSolution solution;
    solution.kind = kind;
    try {
      kind == LensKind::kFisheye ? solve_fisheye({width, height}, plane, views, &solution)
                                 : solve_radial({width, height}, plane, views, &solution);
    } catch (const cv::Exception& error) {
      solution.trouble = error.err;
    }
    return solution;
  }

 private:
  static int shrink(const cv::Mat& image, cv::Mat* small) {
    const int factor = (std::max(image.cols, image.rows) + kSearchSide_px - 1) / kSearchSide_px;
    if (factor <= 1) {
      *small = image;
    } else {
      cv::resize(image, *small, {image.cols / factor, image.rows / factor}, 0, 0, cv::INTER_AREA);
    }
    return factor;
  }

  static bool find_corners(const cv::Mat& image, cv::Size size, bool thorough, std::vector<Vector2d>* corners) {
    cv::Mat small;
    shrink(image, &small);
    std::vector<cv::Point2f> found;
    const int flags = cv::CALIB_CB_ADAPTIVE_THRESH | cv::CALIB_CB_NORMALIZE_IMAGE;
    if (!cv::findChessboardCorners(small, size, found, flags | cv::CALIB_CB_FAST_CHECK) &&
        !(thorough && cv::findChessboardCornersSB(small, size, found, cv::CALIB_CB_NORMALIZE_IMAGE)))
      return false;
    const double scale_x = static_cast<double>(image.cols) / small.cols;
    const double scale_y = static_cast<double>(image.rows) / small.rows;
    for (cv::Point2f& corner : found) {
      corner.x = static_cast<float>((corner.x + 0.5) * scale_x - 0.5);
      corner.y = static_cast<float>((corner.y + 0.5) * scale_y - 0.5);
    }
    const int window =
        std::clamp(static_cast<int>(kWindowShare * min_spacing(found, size.width)), kMinWindow_px, kMaxWindow_px);
    cv::cornerSubPix(image, found, {window, window}, {-1, -1},
                     {cv::TermCriteria::EPS | cv::TermCriteria::COUNT, 60, 0.001});
    cv::Mat soft;
    image.convertTo(soft, CV_32F);
    cv::GaussianBlur(soft, soft, {0, 0}, kSoftness_px);
    for (cv::Point2f& corner : found) centre_corner(soft, window, &corner);
    if (!is_regular(found, size.width)) return false;
    corners->clear();
    for (const cv::Point2f& corner : found) corners->emplace_back(corner.x, corner.y);
    return true;
  }

  static void convert(const std::vector<Vector2d>& plane, const std::vector<std::vector<Vector2d>>& views,
                      std::vector<std::vector<cv::Point3f>>* objects, std::vector<std::vector<cv::Point2f>>* images) {
    for (const std::vector<Vector2d>& view : views) {
      objects->emplace_back();
      images->emplace_back();
      for (size_t i = 0; i < plane.size(); ++i) {
        objects->back().emplace_back(static_cast<float>(plane[i].x()), static_cast<float>(plane[i].y()), 0.0f);
        images->back().emplace_back(static_cast<float>(view[i].x()), static_cast<float>(view[i].y()));
      }
    }
  }

  static void take_matrix(const cv::Mat& K, LensSolution* solution) {
    solution->fx = K.at<double>(0, 0);
    solution->fy = K.at<double>(1, 1);
    solution->cx = K.at<double>(0, 2);
    solution->cy = K.at<double>(1, 2);
  }

  static void solve_radial(cv::Size size, const std::vector<Vector2d>& plane,
                           const std::vector<std::vector<Vector2d>>& views, LensSolution* solution) {
    std::vector<std::vector<cv::Point3f>> objects;
    std::vector<std::vector<cv::Point2f>> images;
    convert(plane, views, &objects, &images);
    cv::Mat K, D, sigma, sigma_poses, errors;
    std::vector<cv::Mat> rotations, translations;
    const int flags = solution->kind == LensKind::kNormal ? cv::CALIB_FIX_K3 : 0;
    cv::calibrateCamera(objects, images, size, K, D, rotations, translations, sigma, sigma_poses, errors, flags,
                        {cv::TermCriteria::EPS | cv::TermCriteria::COUNT, 100, 1e-9});
    take_matrix(K, solution);
    for (int i = 0; i < 5; ++i) solution->coeffs[static_cast<size_t>(i)] = D.at<double>(i);
    solution->sigma_fx = sigma.at<double>(0);
    solution->sigma_cx = sigma.at<double>(2);
    solution->sigma_cy = sigma.at<double>(3);
    for (size_t i = 0; i < views.size(); ++i) {
      std::vector<cv::Point2d> projected;
      std::vector<cv::Point3d> object(objects[i].begin(), objects[i].end());
      cv::projectPoints(object, rotations[i], translations[i], K, D, projected);
      keep(projected, solution);
    }
  }

  static void solve_fisheye(cv::Size size, const std::vector<Vector2d>& plane,
                            const std::vector<std::vector<Vector2d>>& views, LensSolution* solution) {
    std::vector<std::vector<cv::Point3f>> objects;
    std::vector<std::vector<cv::Point2f>> images;
    convert(plane, views, &objects, &images);
    cv::Mat K, D;
    std::vector<cv::Mat> rotations, translations;
    const int flags = cv::fisheye::CALIB_RECOMPUTE_EXTRINSIC | cv::fisheye::CALIB_FIX_SKEW;
    const cv::TermCriteria until(cv::TermCriteria::EPS | cv::TermCriteria::COUNT, 100, 1e-9);
    for (const double focal : {0.0, 0.5, 0.4, 0.65}) {  // by the longer side; 0: OpenCV's guess, from which it may fail
      try {
        K = (cv::Mat_<double>(3, 3) << focal * std::max(size.width, size.height), 0, 0.5 * (size.width - 1), 0,
             focal * std::max(size.width, size.height), 0.5 * (size.height - 1), 0, 0, 1);
        D = cv::Mat::zeros(4, 1, CV_64F);
        cv::fisheye::calibrate(objects, images, size, K, D, rotations, translations,
                               flags | (focal > 0 ? cv::fisheye::CALIB_USE_INTRINSIC_GUESS : 0), until);
        break;
      } catch (const cv::Exception&) {
        if (focal == 0.65) throw;
      }
    }
    take_matrix(K, solution);
    for (int i = 0; i < 4; ++i) solution->coeffs[static_cast<size_t>(i)] = D.at<double>(i);
    for (size_t i = 0; i < views.size(); ++i) {
      std::vector<cv::Point2d> projected;
      std::vector<cv::Point3d> object(objects[i].begin(), objects[i].end());
      cv::fisheye::projectPoints(object, projected, rotations[i], translations[i], K, D);
      keep(projected, solution);
    }
  }

  static void keep(const std::vector<cv::Point2d>& projected, LensSolution* solution) {
    solution->predicted.emplace_back();
    for (const cv::Point2d& p : projected) solution->predicted.back().emplace_back(p.x, p.y);
  }
};

}  // namespace
}  // namespace pptam::platform

// NOLINTNEXTLINE(readability-identifier-naming)
extern "C" __attribute__((visibility("default"))) const pptam::platform::BoardVision* pptam_board_vision() {
  static const pptam::platform::OpenCvVision vision;
  return &vision;
}
