// Recordings that are images, each a file: TUM and EuRoC folders, lists, folders and patterns of images.
#pragma once

#include <cstdint>
#include <filesystem>
#include <vector>

#include "platform/camera/ground_truth.h"

namespace pptam::platform {

struct ImageEntry {
  std::filesystem::path file;
  int64_t timestamp_ns = 0;
};

struct ImageList {
  std::vector<ImageEntry> images;
  bool has_timestamps = false;
  GroundTruthFile ground_truth;       // that came with the images
  std::filesystem::path calibration;  // likewise
};

// source: a folder, a list like TUM's rgb.txt, an image pattern with one %d or %0Nd, or one image. Throws InputError.
ImageList list_images(const std::filesystem::path& source);

// By its name's end: .png, .jpg and the like.
bool has_image_extension(const std::filesystem::path& file);

}  // namespace pptam::platform
