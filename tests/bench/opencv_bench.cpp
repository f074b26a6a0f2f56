// OpenCV's nearest to each of our kernels, on the same images. Whatever a choice decides, it favours OpenCV: outputs
// are allocated beforehand, no error measures are asked for, and prebuilt pyramids come with their derivatives.
#include "tests/bench/opencv_bench.h"

#include <benchmark/benchmark.h>

#include <algorithm>
#include <cstdio>
#include <opencv2/core.hpp>
#include <opencv2/core/utility.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <pocket_ptam/image.h>

namespace pptam::bench {
namespace {

using benchmark::ClobberMemory;
using benchmark::DoNotOptimize;
using benchmark::State;

constexpr int kMinDistance = 6;  // between corners, as detect_corners keeps it
constexpr int kBlockSize = 7;    // its window in level 0

void require(bool good, const std::string& message) {
  if (!good) throw std::runtime_error(message);
}

// The same pixels; cv::Mat has no read-only form.
cv::Mat mat(const GreyView& view) {
  return {view.height, view.width, CV_8UC1, const_cast<uint8_t*>(view.data), static_cast<size_t>(view.stride)};
}

cv::Mat mat(const Frame& frame, int type) {
  return {frame.height, frame.width, type, const_cast<uint8_t*>(frame.data), static_cast<size_t>(frame.stride_bytes)};
}

int largest_difference(const cv::Mat& a, const GreyView& b) {
  return static_cast<int>(cv::norm(a, mat(b), cv::NORM_INF));
}

// --- grey

struct GreyPeer {
  PixelFormat format;
  int type;
  int code;
};
constexpr GreyPeer kBgra{PixelFormat::kBgra, CV_8UC4, cv::COLOR_BGRA2GRAY};
constexpr GreyPeer kRgb{PixelFormat::kRgb24, CV_8UC3, cv::COLOR_RGB2GRAY};
constexpr GreyPeer kYuyv{PixelFormat::kYuyv, CV_8UC2, cv::COLOR_YUV2GRAY_YUY2};

void grey(State& state, const BenchScene& scene, GreyPeer peer) {
  const cv::Mat source = mat(scene.frame(peer.format), peer.type);
  cv::Mat out(source.size(), CV_8UC1);
  for (auto _ : state) {
    cv::cvtColor(source, out, peer.code);
    ClobberMemory();
  }
}

void check_grey(const BenchScene& scene, GreyPeer peer) {
  const Frame frame = scene.frame(peer.format);
  std::vector<uint8_t> pixels(static_cast<size_t>(frame.width * frame.height));
  const GreyView ours = to_grey(frame, {pixels.data(), frame.width, frame.height, frame.width});
  cv::Mat theirs;
  cv::cvtColor(mat(frame, peer.type), theirs, peer.code);
  require(largest_difference(theirs, ours) <= 2,
          "cvtColor's grey differs from ours");  // their weights are rounded less
}

// --- pyramid

enum class Halving { kPyrDown, kResizeArea };

// levels[0] is the image; the others are written, in place when they have the right size already.
void halve(Halving how, std::vector<cv::Mat>& levels) {
  for (size_t l = 1; l < levels.size(); ++l) {
    const cv::Size size(levels[l - 1].cols / 2, levels[l - 1].rows / 2);
    if (how == Halving::kPyrDown) {
      cv::pyrDown(levels[l - 1], levels[l], size);
    } else {
      cv::resize(levels[l - 1], levels[l], size, 0, 0, cv::INTER_AREA);
    }
  }
}

void pyramid(State& state, const BenchScene& scene, Halving how) {
  std::vector<cv::Mat> levels(kPyramidLevels);
  levels[0] = mat(scene.pyramid[1].level[0]);
  for (auto _ : state) {
    halve(how, levels);
    ClobberMemory();
  }
}

void check_pyramid(const BenchScene& scene) {
  std::vector<cv::Mat> levels(kPyramidLevels);
  levels[0] = mat(scene.pyramid[1].level[0]);
  halve(Halving::kResizeArea, levels);
  for (int l = 1; l < kPyramidLevels; ++l)
    require(largest_difference(levels[static_cast<size_t>(l)], scene.pyramid[1].level[l]) == 0,
            "resize INTER_AREA gives another pyramid than ours");
}

// --- corners

std::vector<cv::Point2f> good_features(const BenchScene& scene, double quality) {
  std::vector<cv::Point2f> corners;
  cv::goodFeaturesToTrack(mat(scene.pyramid[0].level[0]), corners, static_cast<int>(scene.corners.size()), quality,
                          kMinDistance, cv::noArray(), kBlockSize);
  return corners;
}

// The highest quality level at which as many corners are found as by us: a lower one leaves more of them to be sorted.
double equal_count_quality(const BenchScene& scene) {
  for (double quality = 0.5; quality > 1e-5; quality *= 0.9)
    if (good_features(scene, quality).size() == scene.corners.size()) return quality;
  throw std::runtime_error("goodFeaturesToTrack cannot find as many corners as detect_corners");
}

void corners(State& state, const BenchScene& scene, double quality) {
  for (auto _ : state) DoNotOptimize(good_features(scene, quality));
}

// --- patches

// From the pixels of the 10x10 template to those of the source, as in warp_patch.
cv::Matx23f warp_matrix(const SearchedPoint& point) {
  const Matrix2f J = point.A_t_s.inverse();
  const Vector2f centre(from_level0(point.source_px.x(), kSearchLevel), from_level0(point.source_px.y(), kSearchLevel));
  const Vector2f origin = centre - J * Vector2f::Constant(kPatchCentre + 1);
  return {J(0, 0), J(0, 1), origin.x(), J(1, 0), J(1, 1), origin.y()};
}

void warp_affine(const BenchScene& scene, const cv::Matx23f& matrix, cv::Mat& out) {
  cv::warpAffine(mat(scene.pyramid[0].level[kSearchLevel]), out, matrix, {kPatchFramed, kPatchFramed},
                 cv::INTER_LINEAR | cv::WARP_INVERSE_MAP);
}

void warp(State& state, const BenchScene& scene) {
  std::vector<cv::Matx23f> matrices;
  for (const SearchedPoint& point : scene.points) matrices.push_back(warp_matrix(point));
  cv::Mat out;
  for (auto _ : state) {
    for (const cv::Matx23f& matrix : matrices) {
      warp_affine(scene, matrix, out);
      ClobberMemory();
    }
  }
}

void check_warp(const BenchScene& scene) {
  cv::Mat out;
  for (const SearchedPoint& point : scene.points) {
    warp_affine(scene, warp_matrix(point), out);
    // It samples at multiples of 1/32 pixel: at a step of 255 grey levels that is up to 4 of them, in each direction.
    require(largest_difference(out, {point.patch.px, kPatchFramed, kPatchFramed, kPatchFramed}) <= 8,
            "warpAffine gives another patch than warp_patch");
  }
}

// The best whole-pixel position, as cv::Point of its top-left pixel in the window.
cv::Point best_match(const cv::Mat& window, const cv::Mat& patch, cv::Mat& scores) {
  cv::matchTemplate(window, patch, scores, cv::TM_CCOEFF);
  cv::Point best;
  cv::minMaxLoc(scores, nullptr, nullptr, nullptr, &best);
  return best;
}

// The square round the circle that search_patch compares.
std::vector<std::pair<cv::Mat, cv::Mat>> windows_and_templates(const BenchScene& scene) {
  std::vector<std::pair<cv::Mat, cv::Mat>> pairs;
  const cv::Mat image = mat(scene.pyramid[1].level[kSearchLevel]);
  for (const SearchedPoint& point : scene.points) {
    const int x = cvCeil(from_level0(point.predicted_px.x(), kSearchLevel) - kPatchCentre - kRadius_px);
    const int y = cvCeil(from_level0(point.predicted_px.y(), kSearchLevel) - kPatchCentre - kRadius_px);
    const int size = kPatchSize + 2 * static_cast<int>(kRadius_px);
    const cv::Mat framed = mat(GreyView{point.patch.px, kPatchFramed, kPatchFramed, kPatchFramed});
    pairs.emplace_back(image(cv::Rect(x, y, size, size)), framed(cv::Rect(1, 1, kPatchSize, kPatchSize)));
  }
  return pairs;
}

void search(State& state, const BenchScene& scene) {
  const auto pairs = windows_and_templates(scene);
  cv::Mat scores;
  for (auto _ : state) {
    for (const auto& [window, patch] : pairs) DoNotOptimize(best_match(window, patch, scores));
  }
}

void check_search(const BenchScene& scene) {
  const auto pairs = windows_and_templates(scene);
  cv::Mat scores;
  int same = 0;
  for (size_t i = 0; i < pairs.size(); ++i) {
    cv::Size whole;
    cv::Point corner;
    pairs[i].first.locateROI(whole, corner);
    const cv::Point best = corner + best_match(pairs[i].first, pairs[i].second, scores);
    const Vector2f hit = scene.points[i].hit_px - Vector2f::Constant(kPatchCentre);
    same += static_cast<float>(best.x) == hit.x() && static_cast<float>(best.y) == hit.y();
  }
  std::printf("opencv/matchTemplate_50 (not normalised) takes our position for %d of %d points\n", same, kPoints);
}

// --- Lucas and Kanade

struct LucasKanade {
  const char* name;
  bool prebuilt;         // pyramids, with derivatives
  int level;             // of our pyramid that is level 0 to them
  int window;            // pixels
  int max_level;         // above that
  bool start_from_ours;  // at our prediction (or, for the refinement, at our whole-pixel hit), with our stopping rule
};
constexpr LucasKanade kLucasKanade[] = {
    {"opencv/LK", false, 0, 21, 3, false},  // the defaults
    {"opencv/LK_prebuilt", true, 0, 21, 3, false},
    {"opencv/LK_8x8", false, 0, 8, 2, false},  // the smallest window that works
    {"opencv/LK_8x8_prebuilt", true, 0, 8, 2, false},
    {"opencv/LK_8x8_as_ours", true, kSearchLevel, 8, 1, true},  // the same patch of the image as ours
    {"opencv/LK_refine_50", true, kSearchLevel, 8, 0, true},
};

class LucasKanadeRun {
 public:
  LucasKanadeRun(const BenchScene& scene, const LucasKanade& options) : options_(options) {
    for (int i = 0; i < 2; ++i) {
      images_[i] = mat(scene.pyramid[i].level[options.level]);
      const cv::Size window(options.window, options.window);
      if (options.prebuilt) cv::buildOpticalFlowPyramid(images_[i], pyramids_[i], window, options.max_level, true);
    }
    for (const SearchedPoint& point : scene.points) {
      const auto at_level = [&](const Vector2f& px) {
        return cv::Point2f(from_level0(px.x(), options.level), from_level0(px.y(), options.level));
      };
      sources_.push_back(at_level(point.source_px));
      starts_.push_back(options.max_level == 0 ? cv::Point2f(point.hit_px.x(), point.hit_px.y())
                                               : at_level(point.predicted_px));
    }
  }

  void run() {
    const cv::Size window(options_.window, options_.window);
    const cv::_InputArray previous = options_.prebuilt ? cv::_InputArray(pyramids_[0]) : cv::_InputArray(images_[0]);
    const cv::_InputArray current = options_.prebuilt ? cv::_InputArray(pyramids_[1]) : cv::_InputArray(images_[1]);
    if (options_.start_from_ours) {
      found_ = starts_;
      cv::calcOpticalFlowPyrLK(previous, current, sources_, found_, status_, cv::noArray(), window, options_.max_level,
                               {cv::TermCriteria::COUNT + cv::TermCriteria::EPS, kRefineSteps, 0.03},
                               cv::OPTFLOW_USE_INITIAL_FLOW);
    } else {
      cv::calcOpticalFlowPyrLK(previous, current, sources_, found_, status_, cv::noArray(), window, options_.max_level);
    }
  }

  int tracked() const { return static_cast<int>(std::count(status_.begin(), status_.end(), 1)); }
  // Of the points that we found, how many it puts at most a pixel (of level 0) from there.
  int agreeing(const BenchScene& scene) const {
    int count = 0;
    for (size_t i = 0; i < found_.size(); ++i) {
      const Vector2f px(to_level0(found_[i].x, options_.level), to_level0(found_[i].y, options_.level));
      count += scene.points[i].found && status_[i] && (px - scene.points[i].found_px).norm() <= 1;
    }
    return count;
  }

 private:
  LucasKanade options_;
  cv::Mat images_[2];
  std::vector<cv::Mat> pyramids_[2];
  std::vector<cv::Point2f> sources_, starts_, found_;
  std::vector<uint8_t> status_;
};

void lucas_kanade(State& state, const BenchScene& scene, LucasKanade options) {
  LucasKanadeRun lk(scene, options);
  for (auto _ : state) {
    lk.run();
    ClobberMemory();
  }
}

void check_lucas_kanade(const BenchScene& scene) {
  for (const LucasKanade& options : kLucasKanade) {
    LucasKanadeRun lk(scene, options);
    lk.run();
    std::printf("%s tracks %d of %d points, %d to within a pixel of ours\n", options.name, lk.tracked(), kPoints,
                lk.agreeing(scene));
    require(lk.tracked() >= kMinGood, std::string(options.name) + " tracks too few points");
  }
}

}  // namespace

void register_opencv(const BenchScene& scene) {
  cv::setNumThreads(1);
  std::printf("OpenCV %s\n", CV_VERSION);
  for (const GreyPeer& peer : {kBgra, kRgb, kYuyv}) check_grey(scene, peer);
  check_pyramid(scene);
  check_warp(scene);
  check_search(scene);
  check_lucas_kanade(scene);
  const double quality = equal_count_quality(scene);

  const auto add = [&](const char* name, auto function, auto... arguments) {
    benchmark::RegisterBenchmark(
        name, [&scene, function, arguments...](State& state) { function(state, scene, arguments...); });
  };
  add("opencv/cvtColor_bgra", grey, kBgra);
  add("opencv/cvtColor_rgb", grey, kRgb);
  add("opencv/cvtColor_yuyv", grey, kYuyv);
  add("opencv/pyrDown", pyramid, Halving::kPyrDown);
  add("opencv/resize_area", pyramid, Halving::kResizeArea);
  add("opencv/goodFeaturesToTrack", corners, quality);
  add("opencv/warpAffine_50", warp);
  add("opencv/matchTemplate_50", search);
  for (const LucasKanade& options : kLucasKanade) add(options.name, lucas_kanade, options);
}

}  // namespace pptam::bench
