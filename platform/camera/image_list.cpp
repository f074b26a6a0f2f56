#include "platform/camera/image_list.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <functional>
#include <string>
#include <string_view>
#include <utility>

#include "platform/input_error.h"
#include "platform/text_file.h"
#include "platform/trajectory.h"

namespace pptam::platform {
namespace {

namespace fs = std::filesystem;

// "timestamp name" (TUM, seconds) or "timestamp,name" (EuRoC, nanoseconds), names relative to folder.
std::vector<ImageEntry> read_list(const fs::path& list, const fs::path& folder, char separator) {
  std::vector<ImageEntry> images;
  for_each_line(list, [&](std::string_view line, const LineError& fail) {
    const bool euroc = separator == ',';
    const size_t cut = std::min(euroc ? line.find(',') : line.find_first_of(" \t"), line.size());
    ImageEntry entry;
    const std::string_view stamp = trimmed(line.substr(0, cut));
    const bool good = euroc ? parse_integer(stamp, &entry.timestamp_ns) : parse_timestamp_s(stamp, &entry.timestamp_ns);
    const std::string_view name = cut < line.size() ? trimmed(line.substr(cut + 1)) : std::string_view();
    if (!good || name.empty()) {
      fail(euroc ? "expected \"timestamp [ns],file name\"" : "expected \"timestamp [s] file name\"");
    }
    if (!images.empty() && entry.timestamp_ns <= images.back().timestamp_ns) {
      fail("the timestamp is not later than the one before");
    }
    entry.file = folder / name;
    images.push_back(std::move(entry));
  });
  if (images.empty()) throw InputError(list.string() + " lists no images");
  return images;
}

ImageList open_tum(const fs::path& list) {
  ImageList result;
  const fs::path folder = list.parent_path();
  result.images = read_list(list, folder, ' ');
  result.has_timestamps = true;
  result.ground_truth = find_tum_ground_truth(folder);
  return result;
}
ImageList open_euroc(const fs::path& camera) {
  ImageList result;
  result.images = read_list(camera / "data.csv", camera / "data", ',');
  result.has_timestamps = true;
  const fs::path sensor = camera / "sensor.yaml";
  if (fs::exists(sensor)) result.calibration = sensor;
  result.ground_truth = find_euroc_ground_truth(camera);
  return result;
}
bool is_digit(char c) {
  return c >= '0' && c <= '9';
}

// img2 before img10: runs of digits compare as numbers, everything else by bytes; ties ("1", "01") by all bytes.
bool natural_less(const std::string& a, const std::string& b) {
  size_t i = 0;
  size_t j = 0;
  while (i < a.size() && j < b.size()) {
    if (is_digit(a[i]) && is_digit(b[j])) {
      while (i < a.size() && a[i] == '0') ++i;
      while (j < b.size() && b[j] == '0') ++j;
      size_t i_end = i;
      size_t j_end = j;
      while (i_end < a.size() && is_digit(a[i_end])) ++i_end;
      while (j_end < b.size() && is_digit(b[j_end])) ++j_end;
      if (i_end - i != j_end - j) return i_end - i < j_end - j;
      const int order = a.compare(i, i_end - i, b, j, j_end - j);
      if (order != 0) return order < 0;
      i = i_end;
      j = j_end;
    } else {
      if (a[i] != b[j]) return static_cast<unsigned char>(a[i]) < static_cast<unsigned char>(b[j]);
      ++i;
      ++j;
    }
  }
  const size_t rest_a = a.size() - i;
  const size_t rest_b = b.size() - j;
  return rest_a != rest_b ? rest_a < rest_b : a < b;
}

std::vector<std::string> file_names(const fs::path& folder) {
  std::vector<std::string> names;
  std::error_code error;
  fs::directory_iterator entry(folder, error);
  for (; !error && entry != fs::directory_iterator(); entry.increment(error)) {
    names.push_back(entry->path().filename().string());
  }
  if (error) throw InputError("cannot read folder " + folder.string() + ": " + error.message());
  return names;
}

ImageList open_image_folder(const fs::path& folder) {
  std::vector<std::string> names = file_names(folder);
  std::erase_if(names, [](const std::string& name) { return name[0] == '.' || !has_image_extension(name); });
  if (names.empty()) {
    throw InputError("folder " + folder.string() +
                     " holds no images (png, jpg, pgm, ppm, bmp, tiff), no rgb.txt (TUM) and no mav0 (EuRoC)");
  }
  std::sort(names.begin(), names.end(), natural_less);
  ImageList result;
  for (const std::string& name : names) result.images.push_back({folder / name});
  return result;
}

// The numbers that stand for %d or %0Nd in the names of the pattern's folder, from the first to the last without a gap.
ImageList open_pattern(const fs::path& pattern) {
  const auto refuse = [&] {
    throw InputError("image pattern " + pattern.string() +
                     ": the file name needs exactly one %d or %0Nd (N from 1 to 9), such as image%04d.png");
  };
  const std::string name = pattern.filename().string();
  const fs::path folder = pattern.has_parent_path() ? pattern.parent_path() : fs::path(".");
  const size_t percent = name.find('%');
  if (percent == std::string::npos || folder.string().find('%') != std::string::npos) refuse();
  size_t end = percent + 1;
  size_t digits = 1;
  if (name.compare(end, 1, "0") == 0 && end + 1 < name.size() && name[end + 1] >= '1' && name[end + 1] <= '9') {
    digits = static_cast<size_t>(name[end + 1] - '0');
    end += 2;
  }
  if (name.compare(end, 1, "d") != 0 || name.find('%', end) != std::string::npos) refuse();
  const std::string head = name.substr(0, percent);
  const std::string tail = name.substr(end + 1);
  const auto numbered = [&](int number) {
    std::string text = std::to_string(number);
    if (text.size() < digits) text.insert(0, digits - text.size(), '0');
    return head + text + tail;
  };

  std::vector<int> numbers;
  for (const std::string& found : file_names(folder)) {
    if (found.size() <= head.size() + tail.size() || !found.starts_with(head) || !found.ends_with(tail)) continue;
    int number = -1;
    const char* begin = found.data() + head.size();
    std::from_chars(begin, found.data() + found.size() - tail.size(), number);
    if (number >= 0 && numbered(number) == found) numbers.push_back(number);
  }
  if (numbers.empty()) throw InputError("no image matches the pattern " + pattern.string());
  std::sort(numbers.begin(), numbers.end());
  ImageList result;
  for (size_t i = 0; i < numbers.size(); ++i) {
    const int expected = numbers.front() + static_cast<int>(i);
    if (numbers[i] != expected) {
      throw InputError("image " + (folder / numbered(expected)).string() +
                       " is missing, though later ones are there: give the folder instead, to take them all");
    }
    result.images.push_back({folder / numbered(expected)});
  }
  return result;
}
bool is_folder(const fs::path& path) {
  std::error_code ignored;
  return fs::is_directory(path, ignored);
}

}  // namespace

ImageList list_images(const fs::path& source) {
  if (is_folder(source)) {
    if (fs::exists(source / "rgb.txt")) return open_tum(source / "rgb.txt");
    for (const fs::path& camera : {source / "mav0/cam0", source / "cam0", source}) {
      if (fs::exists(camera / "data.csv")) return open_euroc(camera);
    }
    return open_image_folder(source);
  }
  if (!fs::exists(source)) return open_pattern(source);
  if (source.extension() == ".txt") return open_tum(source);
  ImageList single;
  single.images.push_back({source});
  return single;
}
bool has_image_extension(const fs::path& file) {
  std::string extension = file.extension().string();
  for (char& c : extension) {
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  }
  constexpr std::array kExtensions = {".png", ".jpg", ".jpeg", ".pgm", ".ppm", ".pnm", ".pbm", ".bmp", ".tif", ".tiff"};
  return std::find(kExtensions.begin(), kExtensions.end(), extension) != kExtensions.end();
}

}  // namespace pptam::platform
