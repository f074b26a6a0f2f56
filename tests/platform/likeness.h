// Which of many raw grey images a frame is.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

namespace pptam::test {

using GreyImage = std::vector<uint8_t>;

// Of a file in which they lie one behind the other.
inline std::vector<GreyImage> read_grey_images(const std::string& file, size_t pixels) {
  std::ifstream stream(file, std::ios::binary);
  const std::vector<char> all{std::istreambuf_iterator<char>(stream), {}};
  std::vector<GreyImage> images;
  for (size_t at = 0; at + pixels <= all.size(); at += pixels)
    images.emplace_back(all.begin() + static_cast<long>(at), all.begin() + static_cast<long>(at + pixels));
  return images;
}

struct Likeness {
  size_t number = 0;  // of the image that is most alike, from 1
  double best = 1e9;  // mean difference to it, grey levels
  double next = 1e9;  // to the image after it, of the last one before it: what there would be if it were the wrong one
};

inline Likeness find_alike(const GreyImage& frame, const std::vector<GreyImage>& images) {
  std::vector<double> means;
  for (const GreyImage& image : images) {
    int64_t sum = 0;
    for (size_t i = 0; i < image.size(); ++i) sum += std::abs(frame[i] - image[i]);
    means.push_back(static_cast<double>(sum) / static_cast<double>(image.size()));
  }
  Likeness found;
  const auto best = std::min_element(means.begin(), means.end());
  if (best == means.end()) return found;
  found.number = static_cast<size_t>(best - means.begin()) + 1;
  found.best = *best;
  if (means.size() > 1) found.next = best + 1 != means.end() ? *(best + 1) : *(best - 1);
  return found;
}

}  // namespace pptam::test
