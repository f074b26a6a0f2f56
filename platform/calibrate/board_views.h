// The board seen by a camera, frame by frame: which frames show it, how sharp and how still, and which of them to
// calibrate with. Any camera will do, recorded or live: who shows what is still missing asks Coverage after each frame.
#pragma once

#include <cstdint>
#include <functional>
#include <limits>
#include <string>
#include <vector>

#include "platform/calibrate/board.h"
#include "platform/calibrate/board_vision.h"
#include "platform/camera.h"

namespace pptam::platform {

struct BoardView {
  int frame = 0;  // of the camera's, from 0
  int64_t timestamp_ns = 0;
  std::vector<Vector2d> corners;  // pixels, row by row on the board
  double blur_px = 0;             // width of the edges between its squares, from dark to light
  double spacing_px = 0;          // mean distance of neighbouring corners
  // How fast the corners move, px/s, by the views just before and after it; infinity: there are none.
  double speed_px_s = std::numeric_limits<double>::infinity();
  Vector2d tilt = Vector2d::Zero();  // by how much the depth grows over the board, rightwards and downwards, by itself
};

struct BoardViews {
  int width = 0, height = 0;  // pixels
  int frames = 0;             // read
  int looked_at = 0;          // of these
  int without_board = 0;      // of these
  std::vector<BoardView> views;
  std::string other_board;  // where none was found: another one that was seen, as --board takes it
  std::string broken;       // why the camera ended before its end
};

struct LookOptions {
  bool every_frame = false;  // of a moving clip; else a few in each second
};

// Reads the camera to its end. go_on is asked after each frame.
BoardViews look_for_board(Camera& camera, const Board& board, const BoardVision& vision, const LookOptions& options,
                          const std::function<bool(const BoardViews& so_far)>& go_on);

// One view of an image, as look_for_board() makes it. False: no board.
bool find_board(const GreyView& image, const Board& board, const BoardVision& vision, bool thorough, BoardView* view);

// Which parts of the image and which tilts of the board the views cover.
class Coverage {
 public:
  static constexpr int kCells = 9;         // across and down: three by three for each ninth of the image
  static constexpr double kMinTilt = 0.1;  // of BoardView::tilt: about 10 degrees of a board that fills half the view

  Coverage(int width, int height) : width_(width), height_(height) {}
  void add(const BoardView& view);

  int views_at(int column, int row) const {
    return cells_[static_cast<size_t>(row) * kCells + static_cast<size_t>(column)];
  }
  double share() const;                        // of cells that were seen
  bool is_lacking(int column, int row) const;  // a ninth of the image in which the board was hardly seen
  // What is missing, a sentence each of what to do; empty: nothing.
  std::vector<std::string> missing() const;
  // How much a view would add; 0 for nothing new.
  double gain(const BoardView& view) const;

 private:
  std::vector<int> cells_of(const BoardView& view) const;  // each once

  int width_, height_;
  std::vector<int> cells_ = std::vector<int>(size_t{kCells} * kCells, 0);  // views with a corner in it
  int tilts_[5] = {};                                                      // by Tilt
};

// Those to calibrate with: without the blurred ones, whose number is added to *blurred, and at most `most`, which cover
// the most, the stillest and sharpest first.
std::vector<BoardView> choose_views(const BoardViews& found, size_t most, int* blurred);

}  // namespace pptam::platform
