// What the benchmarks work on: two successive frames of the emulated phone's desk and 50 points to find in the second.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <pocket_ptam/camera_model.h>
#include "image/corners.h"
#include "image/patch.h"
#include "image/pyramid.h"
#include "map/patch_search.h"

namespace pptam::bench {

constexpr int kPoints = 50;      // searched per frame [phone 4]
constexpr int kMinGood = 40;     // of them must be found by either side: nobody is timed on failures
constexpr int kSearchLevel = 1;  // L1, with a radius of 4 pixels of it: SearchOptions' defaults
constexpr float kRadius_px = 4;
constexpr int kRefineSteps = 8;  // at most, as in find_template

struct SearchedPoint {
  Vector2f source_px;     // in the previous frame, level 0
  Matrix2f A_t_s;         // affine warp from the previous to the current frame, as for a point of the map
  Vector2f predicted_px;  // in the current frame, from the full-frame rotation
  PatchTemplate patch;    // warped for L1
  int32_t max_zmssd = 0;  // of a match, in find_template
  Vector2f found_px;      // what find_template makes of it, if found
  Vector2f hit_px;        // L1: the whole-pixel position that refinement starts from
  bool found = false;
};

struct BenchScene {
  CameraModel camera;
  std::vector<std::max_align_t> memory;  // of the pyramids
  std::vector<uint8_t> pixels[2];        // previous and current frame, 240x320
  Pyramid pyramid[2];
  GreyView small[2];  // for the full-frame rotation
  std::vector<Corner> corners;
  std::vector<SearchedPoint> points;     // kPoints of them
  std::vector<uint8_t> bgra, rgb, yuyv;  // the current frame, coloured

  BenchScene();  // throws std::runtime_error when the kernels do not do on it what is to be timed
  BenchScene(const BenchScene&) = delete;
  BenchScene& operator=(const BenchScene&) = delete;

  Frame frame(PixelFormat format) const;  // the current one; kBgra, kRgb24 or kYuyv
  int found() const;
};

}  // namespace pptam::bench
