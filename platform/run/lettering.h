// Letters for pictures: drawn once by cairo in the system's sans-serif font, placed by the display's renderer.
#pragma once

#include <array>
#include <string>
#include <vector>

#include "platform/display/scene.h"

namespace pptam::platform {

enum class TextStyle { kStrong, kNormal, kSmall };

class Lettering {
 public:
  // unit: pixels of the canvas; the styles are 15, 15 and 13 units high.
  explicit Lettering(float unit);

  const LetterImage& image() const { return image_; }
  float width(TextStyle style, const std::string& text) const;  // pixels
  // Appends the text with its baseline beginning at (x, y), pixels. What is not ASCII becomes a question mark.
  void add(TextStyle style, float x, float y, const std::string& text, const Rgba& colour,
           std::vector<Glyph>* glyphs) const;

 private:
  static constexpr int kFirst = ' ', kLetters = 95, kStyles = 3;
  struct Letter {
    Area from;           // in the image, pixels
    float x = 0, y = 0;  // of its corner from where it is put
    float advance = 0;
  };
  const Letter& letter(TextStyle style, char character) const;

  LetterImage image_;
  std::array<std::array<Letter, kLetters>, kStyles> letters_ = {};
};

}  // namespace pptam::platform
