#include "platform/calibrate/board.h"

#include <cairo-pdf.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>

#include "platform/input_error.h"
#include "platform/outputs.h"
#include "platform/text.h"

namespace pptam::platform {
namespace {

constexpr int kMinSquares = 4;  // in either direction: three corners
constexpr int kMaxSquares = 40;
constexpr double kPointsPerMm = 72 / 25.4;  // PDF's unit

// Of the page, mm. Printers leave about 5 mm at the edges white; the board needs a white rim.
constexpr double kSide_mm = 10;
constexpr double kTop_mm = 12;
constexpr double kFoot_mm = 30;  // for the ruler and the words
constexpr double kMinSquare_mm = 3;

struct Page {
  double width_mm, height_mm;
};

Page page_of(const std::string& paper, bool landscape) {
  if (paper != "A4" && paper != "Letter") throw InputError("--paper " + paper + ": choose A4 or Letter");
  const Page portrait = paper == "A4" ? Page{210, 297} : Page{215.9, 279.4};
  return landscape ? Page{portrait.height_mm, portrait.width_mm} : portrait;
}

void draw_squares(cairo_t* cr, const Board& board, double left, double top, double square) {
  for (int y = 0; y < board.rows; ++y) {
    for (int x = y % 2; x < board.columns; x += 2)
      cairo_rectangle(cr, left + x * square, top + y * square, square, square);
  }
  cairo_fill(cr);
}

void draw_words(cairo_t* cr, double x, double y, double size, const std::string& words) {
  cairo_set_font_size(cr, size);
  cairo_move_to(cr, x, y);
  cairo_show_text(cr, words.c_str());
}

void draw_ruler(cairo_t* cr, double left, double top) {
  cairo_set_line_width(cr, 0.2);
  for (int mm = 0; mm <= 100; ++mm) {
    cairo_move_to(cr, left + mm, top);
    cairo_line_to(cr, left + mm, top + (mm % 10 == 0 ? 4 : mm % 5 == 0 ? 3 : 2));
  }
  cairo_move_to(cr, left, top);
  cairo_line_to(cr, left + 100, top);
  cairo_stroke(cr);
  draw_words(cr, left - 0.8, top + 7, 3, "0");
  draw_words(cr, left + 96, top + 7, 3, "100 mm");
}

cairo_status_t append_bytes(void* text, const unsigned char* bytes, unsigned int count) {
  static_cast<std::string*>(text)->append(reinterpret_cast<const char*>(bytes), count);
  return CAIRO_STATUS_SUCCESS;
}

}  // namespace

std::vector<Vector2d> Board::plane() const {
  std::vector<Vector2d> points;
  for (int y = 0; y < corners_down(); ++y) {
    for (int x = 0; x < corners_across(); ++x)
      points.emplace_back(x - 0.5 * (corners_across() - 1), y - 0.5 * (corners_down() - 1));
  }
  return points;
}

Board parse_board(const std::string& text) {
  Board board;
  int used = 0;
  if (std::sscanf(text.c_str(), "%dx%d%n", &board.columns, &board.rows, &used) != 2 ||
      static_cast<size_t>(used) != text.size())
    throw InputError("--board " + text + ": write the squares across and down, for example 10x7");
  if (std::min(board.columns, board.rows) < kMinSquares || std::max(board.columns, board.rows) > kMaxSquares)
    throw InputError("--board " + text +
                     format(": from %d to %d squares in either direction", kMinSquares, kMaxSquares));
  if (board.columns == board.rows) {
    throw InputError("--board " + text +
                     ": with as many squares down as across it looks alike when turned by 90 degrees: take another "
                     "number of one of them, such as the usual 10x7");
  }
  return board;
}

std::string board_pdf(const Board& board, const std::string& paper, double square_mm) {
  const Page page = page_of(paper, board.columns > board.rows);
  const double fits =
      std::min((page.width_mm - 2 * kSide_mm) / board.columns, (page.height_mm - kTop_mm - kFoot_mm) / board.rows);
  if (square_mm == 0) square_mm = std::floor(fits);
  if (square_mm > fits || square_mm < kMinSquare_mm) {
    throw InputError(format("%dx%d squares of %g mm do not fit on %s paper: at most %.1f mm, at least %g",
                            board.columns, board.rows, square_mm, paper.c_str(), std::floor(10 * fits) / 10,
                            kMinSquare_mm));
  }
  std::string pdf;
  cairo_surface_t* surface = cairo_pdf_surface_create_for_stream(append_bytes, &pdf, kPointsPerMm * page.width_mm,
                                                                 kPointsPerMm * page.height_mm);
  cairo_pdf_surface_set_metadata(surface, CAIRO_PDF_METADATA_TITLE, "Checkerboard of Pocket PTAM");
  cairo_t* cr = cairo_create(surface);
  cairo_scale(cr, kPointsPerMm, kPointsPerMm);
  const double width = board.columns * square_mm, height = board.rows * square_mm;
  const double left = 0.5 * (page.width_mm - width);
  const double top = kTop_mm + 0.5 * (page.height_mm - kTop_mm - kFoot_mm - height);
  draw_squares(cr, board, left, top, square_mm);

  cairo_select_font_face(cr, "sans-serif", CAIRO_FONT_SLANT_NORMAL, CAIRO_FONT_WEIGHT_NORMAL);
  const double foot = page.height_mm - 21;
  draw_ruler(cr, kSide_mm + 2, foot);
  const double text = kSide_mm + 116;
  const double size = page.width_mm > page.height_mm ? 3.2 : 2.5;
  draw_words(cr, text, foot + 1.2, size,
             format("%d x %d squares of %g mm: together %g mm by %g mm.", board.columns, board.rows, square_mm, width,
                    height));
  draw_words(cr, text, foot + 1.2 + 1.4 * size, size,
             "Print at 100 %, not \"fit to page\"; check with the ruler on the left.");
  draw_words(cr, text, foot + 1.2 + 2.8 * size, size,
             "Glue it to something flat and stiff: glass, a tray, a book's cover.");
  draw_words(cr, text, foot + 1.2 + 4.2 * size, size,
             format("pocket-ptam calibrate VIEWS --board %dx%d", board.columns, board.rows));
  cairo_show_page(cr);
  cairo_destroy(cr);
  cairo_surface_finish(surface);
  const cairo_status_t status = cairo_surface_status(surface);
  cairo_surface_destroy(surface);
  if (status != CAIRO_STATUS_SUCCESS)
    throw InputError(std::string("the board's PDF: ") + cairo_status_to_string(status));
  return sealed(pdf + "% " + std::string(kOpenSeal) + "\n");  // a comment after the end is allowed
}

}  // namespace pptam::platform
