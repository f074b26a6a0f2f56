// run_recording() on a file, where there is an operating system.
#pragma once

#include <cstddef>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "tests/bits/run.h"

namespace pptam::test {

struct RunHere {
  std::string said;    // all lines
  std::string result;  // the last one; empty when it failed
};

inline RunHere run_here(const std::filesystem::path& file, int changed_frame) {
  static std::ifstream input;
  static RunHere run;
  std::vector<std::max_align_t> block(kDesktopBlockBytes / sizeof(std::max_align_t));
  std::vector<uint8_t> image(kDesktopImageBytes);
  input = std::ifstream(file, std::ios::binary);
  run = {};
  const auto read = [](void* to, size_t bytes) {
    return static_cast<bool>(input.read(static_cast<char*>(to), static_cast<std::streamsize>(bytes)));
  };
  const auto say = [](const char* text) {
    run.result = text;
    run.said += text;
  };
  if (run_recording({read, say, block.data(), kDesktopBlockBytes, image.data(), image.size()}, changed_frame) != 0)
    run.result.clear();
  return run;
}

}  // namespace pptam::test
