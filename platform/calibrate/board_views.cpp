#include "platform/calibrate/board_views.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "platform/calibrate/plane_pose.h"
#include "platform/text.h"

namespace pptam::platform {
namespace {

constexpr double kLooksPerSecond = 6;   // of a clip: enough that a view held for a moment is found
constexpr int kFewFrames = 150;         // so many are all looked at, thoroughly: photographs
constexpr int kSearchedForOthers = 12;  // frames without the board that are searched for boards of other sizes
constexpr double kNeighbour_s = 0.5;    // between views whose difference tells the speed
constexpr double kMaxBlurShare = 0.35;  // of the distance of corners: the squares' middles are grey
constexpr double kMaxBlurRatio = 2;     // to the median's
constexpr int kWantedTilts = 2;         // views of each tilt
constexpr int kWantedCells = 5;         // of the nine in a part of the image
constexpr double kTiltGain = 6;         // of a tilt that is missing, in cells
constexpr double kUnknownPace = 5;      // of a view without neighbours, and at most, in units of the next
constexpr double kStill_px_s = 20;      // slower is as good as at rest: 0.6 px in 30 ms of exposure and readout

enum Tilt { kFlat, kLeftNear, kRightNear, kTopNear, kBottomNear };

Tilt tilt_of(const BoardView& view) {
  const Vector2d& t = view.tilt;
  if (t.norm() < Coverage::kMinTilt) return kFlat;
  if (std::abs(t.x()) > std::abs(t.y())) return t.x() > 0 ? kLeftNear : kRightNear;
  return t.y() > 0 ? kTopNear : kBottomNear;
}

double sample(const GreyView& image, const Vector2d& px) {
  const double x = std::clamp(px.x(), 0.0, image.width - 1.001), y = std::clamp(px.y(), 0.0, image.height - 1.001);
  const int ix = static_cast<int>(x), iy = static_cast<int>(y);
  const double fx = x - ix, fy = y - iy;
  const int right = std::min(ix + 1, image.width - 1), below = std::min(iy + 1, image.height - 1);
  return (1 - fy) * ((1 - fx) * image.at(ix, iy) + fx * image.at(right, iy)) +
         fy * ((1 - fx) * image.at(ix, below) + fx * image.at(right, below));
}

// Width of the edge across the middle of two neighbouring corners: contrast by steepest slope.
double edge_width(const GreyView& image, const Vector2d& a, const Vector2d& b) {
  const Vector2d along = b - a;
  const double reach = 0.4 * along.norm();
  const Vector2d across = Vector2d(-along.y(), along.x()).normalized();
  constexpr double kStep_px = 0.5;
  double low = 255, high = 0, steepest = 0, before = 0;
  for (double s = -reach; s <= reach; s += kStep_px) {
    const double value = sample(image, 0.5 * (a + b) + s * across);
    low = std::min(low, value);
    high = std::max(high, value);
    if (s > -reach) steepest = std::max(steepest, std::abs(value - before) / kStep_px);
    before = value;
  }
  return steepest > 0 ? (high - low) / steepest : 2 * reach;
}

void measure_view(const GreyView& image, const Board& board, BoardView* view) {
  std::vector<double> widths;
  double spacing = 0;
  const size_t across = static_cast<size_t>(board.corners_across());
  const auto measure = [&](size_t a, size_t b) {
    widths.push_back(edge_width(image, view->corners[a], view->corners[b]));
    spacing += (view->corners[a] - view->corners[b]).norm();
  };
  for (size_t i = 0; i < view->corners.size(); ++i) {
    if (i % across + 1 < across) measure(i, i + 1);
    if (i + across < view->corners.size()) measure(i, i + across);
  }
  // The most blurred directions count: a camera that moves along an edge leaves it sharp.
  const auto upper = widths.begin() + static_cast<ptrdiff_t>(widths.size() * 3 / 4);
  std::nth_element(widths.begin(), upper, widths.end());
  view->blur_px = *upper;
  view->spacing_px = spacing / static_cast<double>(widths.size());

  // Near the middle px = (H X) / (1 + h X): the depth grows as 1 + h X does.
  const Eigen::Matrix3d H = plane_homography(board.plane(), view->corners);
  const Eigen::RowVector2d h = H.block<1, 2>(2, 0);
  const Eigen::Matrix2d J = H.topLeftCorner<2, 2>() - H.topRightCorner<2, 1>() * h;
  const double size_px = std::sqrt(std::abs(J.determinant()) * static_cast<double>(view->corners.size()));
  view->tilt = size_px * (J.transpose().inverse() * h.transpose());
}

double mean_step(const BoardView& a, const BoardView& b) {
  double forward = 0, turned = 0;  // a board may be read from either end
  const size_t n = a.corners.size();
  for (size_t i = 0; i < n; ++i) {
    forward += (a.corners[i] - b.corners[i]).norm() / static_cast<double>(n);
    turned += (a.corners[i] - b.corners[n - 1 - i]).norm() / static_cast<double>(n);
  }
  return std::min(forward, turned);
}

void measure_speed(BoardViews* found) {
  for (size_t i = 1; i < found->views.size(); ++i) {
    BoardView &a = found->views[i - 1], &b = found->views[i];
    const double seconds = 1e-9 * static_cast<double>(b.timestamp_ns - a.timestamp_ns);
    if (!(seconds > 0 && seconds < kNeighbour_s)) continue;
    const double speed = mean_step(a, b) / seconds;
    a.speed_px_s = std::min(a.speed_px_s, speed);
    b.speed_px_s = std::min(b.speed_px_s, speed);
  }
}

}  // namespace

bool find_board(const GreyView& image, const Board& board, const BoardVision& vision, bool thorough, BoardView* view) {
  if (!vision.find(image, board.corners_across(), board.corners_down(), thorough, &view->corners)) return false;
  measure_view(image, board, view);
  return true;
}

BoardViews look_for_board(Camera& camera, const Board& board, const BoardVision& vision, const LookOptions& options,
                          const std::function<bool(const BoardViews& so_far)>& go_on) {
  BoardViews found;
  const CameraInfo& info = camera.info();
  found.width = info.model.width;
  found.height = info.model.height;
  const bool few = !options.every_frame && info.frame_count && *info.frame_count <= kFewFrames;
  const int every = options.every_frame || few || info.frames_per_s <= kLooksPerSecond
                        ? 1
                        : static_cast<int>(std::lround(info.frames_per_s / kLooksPerSecond));
  std::vector<uint8_t> storage(static_cast<size_t>(found.width) * static_cast<size_t>(found.height));
  Frame frame;
  try {
    for (; camera.read(&frame); ++found.frames) {
      if (found.frames % every == 0) {
        const GreyView image = to_grey(frame, GreyImage{storage.data(), found.width, found.height, found.width});
        BoardView view;
        view.frame = found.frames;
        view.timestamp_ns = frame.timestamp_ns;
        ++found.looked_at;
        if (find_board(image, board, vision, few, &view)) {
          found.views.push_back(std::move(view));
        } else {
          ++found.without_board;
          int across = 0, down = 0;
          if (found.views.empty() && found.other_board.empty() && found.without_board <= kSearchedForOthers &&
              vision.find_any(image, &across, &down) &&
              (across != board.corners_across() || down != board.corners_down()))
            found.other_board = format("%dx%d", across + 1, down + 1);
        }
      }
      if (!go_on(found)) break;
    }
  } catch (const InputError& error) {
    found.broken = error.what();
  }
  measure_speed(&found);
  return found;
}

std::vector<int> Coverage::cells_of(const BoardView& view) const {
  std::vector<int> cells;
  for (const Vector2d& px : view.corners) {
    const int column = std::clamp(static_cast<int>((px.x() + 0.5) * kCells / width_), 0, kCells - 1);
    const int row = std::clamp(static_cast<int>((px.y() + 0.5) * kCells / height_), 0, kCells - 1);
    cells.push_back(row * kCells + column);
  }
  std::sort(cells.begin(), cells.end());
  cells.erase(std::unique(cells.begin(), cells.end()), cells.end());
  return cells;
}

void Coverage::add(const BoardView& view) {
  for (const int cell : cells_of(view)) ++cells_[static_cast<size_t>(cell)];
  ++tilts_[tilt_of(view)];
}

double Coverage::share() const {
  const auto seen = std::count_if(cells_.begin(), cells_.end(), [](int views) { return views > 0; });
  return static_cast<double>(seen) / static_cast<double>(cells_.size());
}

bool Coverage::is_lacking(int column, int row) const {
  int seen = 0;
  for (int cell = 0; cell < 9; ++cell) seen += views_at(3 * column + cell % 3, 3 * row + cell / 3) > 0 ? 1 : 0;
  return seen < kWantedCells;
}

double Coverage::gain(const BoardView& view) const {
  double gain = 0;
  for (const int cell : cells_of(view)) {
    const double views = cells_[static_cast<size_t>(cell)];
    gain += 1 / ((1 + views) * (1 + views));
  }
  const int alike = tilts_[tilt_of(view)];
  return gain + kTiltGain / ((1 + alike) * (1 + alike));
}

std::vector<std::string> Coverage::missing() const {
  static constexpr const char* kParts[3][3] = {{"upper left", "upper middle", "upper right"},
                                               {"middle left", "middle", "middle right"},
                                               {"lower left", "lower middle", "lower right"}};
  std::vector<std::string> parts;
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) {
      if (is_lacking(column, row)) parts.emplace_back(kParts[row][column]);
    }
  }
  std::vector<std::string> sentences;
  if (!parts.empty()) {
    sentences.push_back("the board was hardly seen in the " + joined(parts) + (parts.size() == 1 ? " part" : " parts") +
                        " of the image: add views that have it there");
  }
  std::vector<std::string> sides;
  if (tilts_[kLeftNear] < kWantedTilts) sides.emplace_back("left");
  if (tilts_[kRightNear] < kWantedTilts) sides.emplace_back("right");
  if (tilts_[kTopNear] < kWantedTilts) sides.emplace_back("upper");
  if (tilts_[kBottomNear] < kWantedTilts) sides.emplace_back("lower");
  if (!sides.empty()) {
    sentences.push_back(format("fewer than %d views are tilted so that the ", kWantedTilts) + joined(sides) +
                        " edge of the board is clearly nearer than the opposite one: add some, tilted by 20 to 40 "
                        "degrees");
  }
  return sentences;
}

std::vector<BoardView> choose_views(const BoardViews& found, size_t most, int* blurred) {
  std::vector<double> widths;
  for (const BoardView& view : found.views) widths.push_back(view.blur_px);
  std::sort(widths.begin(), widths.end());
  const double limit = widths.empty() ? 0 : kMaxBlurRatio * widths[widths.size() / 2];
  std::vector<const BoardView*> sharp;
  for (const BoardView& view : found.views) {
    if (view.blur_px > limit || view.blur_px > kMaxBlurShare * view.spacing_px) {
      ++*blurred;
    } else {
      sharp.push_back(&view);
    }
  }
  std::vector<BoardView> chosen;
  Coverage coverage(found.width, found.height);
  while (chosen.size() < most && !sharp.empty()) {
    const auto worth = [&](const BoardView* view) {
      const double pace = std::min(view->speed_px_s / kStill_px_s, kUnknownPace);  // photographs: all alike
      return coverage.gain(*view) / (1 + pace * pace) / std::max(1.0, view->blur_px);
    };
    const auto best = std::max_element(sharp.begin(), sharp.end(),
                                       [&](const BoardView* a, const BoardView* b) { return worth(a) < worth(b); });
    coverage.add(**best);
    chosen.push_back(**best);
    sharp.erase(best);
  }
  std::sort(chosen.begin(), chosen.end(), [](const BoardView& a, const BoardView& b) { return a.frame < b.frame; });
  return chosen;
}

}  // namespace pptam::platform
