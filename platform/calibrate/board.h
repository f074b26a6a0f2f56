// The checkerboard that a camera is calibrated with: its squares, its corners, and a page to print.
#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

namespace pptam::platform {

using Eigen::Vector2d;

// Squares as one counts them on the paper; its corners are the places where four of them meet.
struct Board {
  int columns = 10;
  int rows = 7;

  int corners_across() const { return columns - 1; }
  int corners_down() const { return rows - 1; }
  size_t corners() const { return static_cast<size_t>(corners_across()) * static_cast<size_t>(corners_down()); }
  // Row by row, from the middle of the board, in squares: the camera's focal length and the shutter's time do not
  // depend on how large a square is.
  std::vector<Vector2d> plane() const;
};

// "10x7". Throws InputError.
Board parse_board(const std::string& text);

// A PDF of one page: the board, a ruler of 100 mm to check the print, and what to do with it. paper: "A4" or "Letter".
// square_mm 0: as large as fits, in whole millimetres. Sealed (platform/outputs.h). Throws InputError when it does not
// fit.
std::string board_pdf(const Board& board, const std::string& paper, double square_mm);

}  // namespace pptam::platform
