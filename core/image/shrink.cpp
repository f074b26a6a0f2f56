#include "image/shrink.h"

#include <algorithm>

#include "base/assert.h"

namespace pptam {

namespace {

// The part of old cell `old_cell` that new cell `new_cell` covers, when old_cells cells become new_cells: in units of
// 1 / new_cells of an old cell, so that the parts of one new cell sum to old_cells.
uint64_t overlap(int old_cell, int new_cell, int old_cells, int new_cells) {
  const int64_t begin = std::max(int64_t{old_cell} * new_cells, int64_t{new_cell} * old_cells);
  const int64_t end = std::min(int64_t{old_cell + 1} * new_cells, int64_t{new_cell + 1} * old_cells);
  return static_cast<uint64_t>(std::max<int64_t>(0, end - begin));
}

// One past the last old cell that new cell `new_cell` touches.
int end_of(int new_cell, int old_cells, int new_cells) {
  return static_cast<int>((int64_t{new_cell + 1} * old_cells + new_cells - 1) / new_cells);
}
int begin_of(int new_cell, int old_cells, int new_cells) {
  return static_cast<int>(int64_t{new_cell} * old_cells / new_cells);
}

}  // namespace

void shrink(const GreyView& in, const GreyImage& out) {
  PPTAM_ASSERT(out.width <= in.width && out.height <= in.height);
  if (out.width == in.width && out.height == in.height) {
    for (int y = 0; y < out.height; ++y) std::copy(in.row(y), in.row(y) + in.width, out.row(y));
    return;
  }
  // At most 2^15 * 2^15 * 255 < 2^38.
  const uint64_t area = static_cast<uint64_t>(in.width) * static_cast<uint64_t>(in.height);
  for (int y = 0; y < out.height; ++y) {
    for (int x = 0; x < out.width; ++x) {
      uint64_t sum = 0;
      for (int v = begin_of(y, in.height, out.height); v < end_of(y, in.height, out.height); ++v) {
        uint64_t row = 0;
        for (int u = begin_of(x, in.width, out.width); u < end_of(x, in.width, out.width); ++u)
          row += overlap(u, x, in.width, out.width) * in.at(u, v);
        sum += overlap(v, y, in.height, out.height) * row;
      }
      out.at(x, y) = static_cast<uint8_t>((sum + area / 2) / area);
    }
  }
}

}  // namespace pptam
