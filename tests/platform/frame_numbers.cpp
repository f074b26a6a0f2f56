// Tells which of the images of a file each frame of a live recording is: lines "TIME NUMBER DIFFERENCE NEXT", of
// likeness.h.
#include <cstdio>
#include <fstream>
#include <sstream>
#include <string>

#include "tests/platform/likeness.h"

using namespace pptam::test;

int main(int count, char** words) {
  if (count != 3) {
    std::puts("Usage: frame_numbers FILE RECORDING\nFILE: raw grey images of 240x320, by grey_frames.");
    return 2;
  }
  constexpr size_t kPixels = size_t{240} * 320;
  const std::vector<GreyImage> images = read_grey_images(words[1], kPixels);
  const std::string folder = words[2];
  std::ifstream list(folder + "/rgb.txt");
  for (std::string line, time, name; std::getline(list, line);) {
    if (line.rfind('#', 0) == 0) continue;
    std::istringstream(line) >> time >> name;
    std::ifstream file(folder + "/" + name, std::ios::binary);
    std::string size, most, kind;
    std::getline(file, kind);
    std::getline(file, size);
    std::getline(file, most);
    GreyImage frame(kPixels);
    if (kind != "P5" || size != "240 320" || !file.read(reinterpret_cast<char*>(frame.data()), kPixels)) {
      std::fprintf(stderr, "frame_numbers: %s is no image of 240x320\n", name.c_str());
      return 1;
    }
    const Likeness found = find_alike(frame, images);
    std::printf("%s %zu %.3f %.3f\n", time.c_str(), found.number, found.best, found.next);
  }
  return images.empty() ? 1 : 0;
}
