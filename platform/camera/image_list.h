// Recordings that are images, each a file: TUM and EuRoC folders, lists, folders and patterns of images.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "platform/camera/ground_truth.h"

namespace pptam::platform {

struct ImageEntry {
  std::filesystem::path file;
  int64_t timestamp_ns = 0;
};

// Where the times of images come from: nowhere, a list, a list whose stamps may only number the images, or the images'
// own names (1305031102.175304.png). A rate that the user gives goes before the last two.
enum class ImageTimes { kUnknown, kListed, kCounted, kNamed };

struct ImageList {
  std::vector<ImageEntry> images;  // with known times: in their order, rising
  ImageTimes times = ImageTimes::kUnknown;
  GroundTruthFile ground_truth;       // that came with the images
  std::filesystem::path calibration;  // likewise
};

// source: a folder, a list like TUM's rgb.txt or EuRoC's data.csv, an image pattern with one %d or %0Nd, or one image.
// Lists may be unordered, in other units or separated otherwise; warnings (may be null) tells what was mended. A folder
// of images named by time is sorted by it; else the order is natural. Throws InputError.
ImageList list_images(const std::filesystem::path& source, std::vector<std::string>* warnings);

bool is_folder(const std::filesystem::path& path);

// By the name's end: .txt, .csv.
bool is_list(const std::filesystem::path& file);

// By its name's end: .png, .jpg and the like.
bool has_image_extension(const std::filesystem::path& file);

}  // namespace pptam::platform
