// Compression by blocks, as of a webcam's JPEG: what a quantised 8x8 cosine transform leaves of an image.
#pragma once

#include <cstdint>

namespace pptam::sim {

// Replaces each whole 8x8 block of width * height grey pixels by its transform, rounded to multiples of coarseness
// times the steps that JPEG's standard suggests for luminance (Annex K, table K.1: quality 50 is a coarseness of 1),
// and transformed back. What is left over at the right and bottom edges stays as it is.
void compress(uint8_t* pixels, int width, int height, double coarseness);

}  // namespace pptam::sim
