#include "platform/camera/image_list.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "platform/camera/frame_times.h"
#include "platform/input_error.h"
#include "platform/text_file.h"

namespace pptam::platform {
namespace {

namespace fs = std::filesystem;

std::string extension_of(const fs::path& file) {
  std::string extension = file.extension().string();
  for (char& c : extension) {
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  }
  return extension;
}

// The fields of a line: between commas if there are any, else between blanks; quotes around a field are taken off.
std::vector<std::string> fields_of(std::string_view line) {
  const bool commas = line.find(',') != std::string_view::npos;
  const auto separates = [&](char c) { return commas ? c == ',' : c == ' ' || c == '\t'; };
  std::vector<std::string> fields(1);
  char quote = 0;
  for (const char c : line) {
    if (quote != 0 && c == quote) {
      quote = 0;
    } else if (quote == 0 && (c == '"' || c == '\'') && trimmed(fields.back()).empty()) {
      quote = c;
    } else if (quote == 0 && separates(c)) {
      if (commas || !fields.back().empty()) fields.emplace_back();
    } else {
      fields.back().push_back(c);
    }
  }
  for (std::string& field : fields) field = std::string(trimmed(field));
  return fields;
}

struct ListedImage {
  std::string stamp;
  std::string name;
  std::string second = {};  // a number between stamp and name: the stamp itself where the first one is an index
};

// "stamp name", also with further columns, as associations.txt has them (stamp rgb stamp depth): the first name that
// ends like an image's, rather not the depth image. A name may hold blanks.
ListedImage listed_image(std::string_view line) {
  const std::vector<std::string> fields = fields_of(line);
  const bool commas = line.find(',') != std::string_view::npos;
  std::string stamp = fields[0];
  std::string second;
  std::string name;
  ListedImage depth;
  for (size_t i = 1; i < fields.size(); ++i) {
    int64_t ignored = 0;
    if (name.empty() && parse_stamp(fields[i], TimeUnit::kNanoseconds, &ignored)) {
      if (!depth.name.empty()) stamp = fields[i];
      if (i == 1) second = fields[i];
      continue;
    }
    if (!name.empty()) name += ' ';
    name += fields[i];
    if (has_image_extension(fields[i])) {
      if (name.find("depth") == std::string::npos) return {stamp, name, second};
      if (depth.name.empty()) depth = {stamp, name, second};
      name.clear();
    } else if (commas) {
      name.clear();
    }
  }
  if (!depth.name.empty()) return depth;
  // No name ends like an image's: all that follows the stamp is the name.
  const size_t cut = std::min(line.find_first_of(" \t"), line.size());
  if (fields.size() > 2 && !commas) return {fields[0], std::string(trimmed(line.substr(cut)))};
  return {fields[0], fields.size() > 1 ? fields[1] : ""};
}

using WarnOfList = std::function<void(const std::string&)>;

// Puts the images in the order of their times; without those whose time is not later than the one before.
void stamp_images(std::vector<ImageEntry>* images, const std::vector<std::string>& stamps, TimeUnit documented,
                  const std::string& where, const WarnOfList& warn) {
  std::string remark;
  const TimeUnit unit = recognised_unit(stamps, documented, &remark);
  if (!remark.empty()) warn(where + ": " + remark);
  std::vector<int64_t> stamps_ns(stamps.size());
  for (size_t i = 0; i < stamps.size(); ++i) {
    if (!parse_stamp(stamps[i], unit, &stamps_ns[i])) {
      throw InputError(where + ": the timestamp " + stamps[i] + " is too large");
    }
  }
  const std::vector<size_t> order = order_in_time(stamps_ns);
  if (!std::is_sorted(order.begin(), order.end())) warn(where + ": is not in the order of its times: sorted");
  FrameTimes times;
  std::vector<ImageEntry> kept;
  for (const size_t i : order) {
    const std::optional<int64_t> time_ns = times.next(stamps_ns[i]);
    if (time_ns) kept.push_back({std::move((*images)[i].file), *time_ns});
  }
  for (std::string& line : times.remarks()) warn(line.insert(0, where + ": "));
  std::vector<int64_t> times_ns;
  times_ns.reserve(kept.size());
  for (const ImageEntry& entry : kept) times_ns.push_back(entry.timestamp_ns);
  if (in_bursts(times_ns)) {
    warn(where + ": the times of these bursts are evened out");
    times_ns = evened_out(times_ns);
    if (std::adjacent_find(times_ns.begin(), times_ns.end(), std::greater_equal<>()) == times_ns.end()) {
      for (size_t i = 0; i < kept.size(); ++i) kept[i].timestamp_ns = times_ns[i];
    }
  }
  *images = std::move(kept);
}

// Whether these number the images: whole, each by one more than that before, and no times since 1970.
bool are_counts(const std::vector<std::string>& numbers) {
  constexpr size_t kMinCounts = 3;             // fewer may be anything
  constexpr int64_t kSince1970S = 1000000000;  // 2001
  int64_t before = 0;
  for (size_t i = 0; i < numbers.size(); ++i) {
    int64_t value = 0;
    if (!parse_integer(numbers[i], &value) || value >= kSince1970S || (i > 0 && value != before + 1)) return false;
    before = value;
  }
  return numbers.size() >= kMinCounts;
}

bool rise(const std::vector<std::string>& numbers) {
  int64_t before = 0;
  for (size_t i = 0; i < numbers.size(); ++i) {
    int64_t value = 0;  // in any unit: nanoseconds have the widest range, but no decimals
    const TimeUnit unit = numbers[i].find('.') == std::string::npos ? TimeUnit::kNanoseconds : TimeUnit::kSeconds;
    if (!parse_stamp(numbers[i], unit, &value) || (i > 0 && value <= before)) return false;
    before = value;
  }
  return true;
}

// Stamps and names, which are relative to folder; a first line that is no such pair is taken for a header. counted: the
// stamps only number the images, as far as can be seen.
std::vector<ImageEntry> read_list(const fs::path& list, const fs::path& folder, TimeUnit documented,
                                  const WarnOfList& warn, bool* counted) {
  std::vector<ImageEntry> images;
  std::vector<std::string> stamps;
  std::vector<std::string> second_numbers;  // the numbers after the stamps, where each line has one
  bool first = true;
  bool backslashes = false;
  for_each_line(list, [&](std::string_view line, const LineError& fail) {
    ListedImage image = listed_image(line);
    int64_t ignored = 0;
    const bool header = std::exchange(first, false) && !image.stamp.empty() && image.stamp[0] != '-' &&
                        image.stamp.find_first_of("0123456789") == std::string::npos && !image.name.empty() &&
                        !has_image_extension(image.name);
    if (header) return;
    // Any unit will do here: nanoseconds have the widest range.
    if (!parse_stamp(image.stamp, TimeUnit::kNanoseconds, &ignored) || image.name.empty()) {
      fail(documented == TimeUnit::kSeconds ? "expected \"timestamp [s] file name\""
                                            : "expected \"timestamp [ns],file name\"");
    }
    if (image.name.find('\\') != std::string::npos) {  // written on Windows
      backslashes = true;
      std::replace(image.name.begin(), image.name.end(), '\\', '/');
    }
    images.push_back({folder / image.name});
    stamps.push_back(std::move(image.stamp));
    if (!image.second.empty()) second_numbers.push_back(std::move(image.second));
  });
  if (images.empty()) throw InputError(list.string() + " lists no images");
  if (backslashes) warn(list.string() + ": its names hold backslashes: read as slashes");
  *counted = are_counts(stamps);
  if (*counted && second_numbers.size() == stamps.size() && !are_counts(second_numbers) && rise(second_numbers)) {
    warn(list.string() + ": its first column numbers the images: the second one is taken for their times");
    stamps = std::move(second_numbers);
    *counted = false;
  }
  if (*counted) {
    warn(list.string() + ": its times are whole numbers that count on by one: if they only number the images, give " +
         "their rate with --fps");
  }
  stamp_images(&images, stamps, documented, list.string(), warn);
  return images;
}

ImageList open_tum(const fs::path& list, const WarnOfList& warn) {
  ImageList result;
  const fs::path folder = list.parent_path();
  const bool csv = extension_of(list) == ".csv";
  bool counted = false;
  result.images = read_list(list, folder, csv ? TimeUnit::kNanoseconds : TimeUnit::kSeconds, warn, &counted);
  result.times = counted ? ImageTimes::kCounted : ImageTimes::kListed;
  result.ground_truth = find_tum_ground_truth(folder);
  return result;
}

ImageList open_euroc(const fs::path& camera, const WarnOfList& warn) {
  ImageList result;
  const fs::path folder = is_folder(camera / "data") ? camera / "data" : camera;
  bool counted = false;
  result.images = read_list(camera / "data.csv", folder, TimeUnit::kNanoseconds, warn, &counted);
  result.times = counted ? ImageTimes::kCounted : ImageTimes::kListed;
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

// The numbers by which images are named, if they are times: they have decimals, or the digits of a time since 1970, or
// steps too large for a count. Empty when they are not. What is around the number is the same in all names.
std::vector<std::string> times_in_names(const std::vector<std::string>& names, TimeUnit* unit) {
  std::vector<std::string> numbers;
  std::string around;
  bool decimals = false;
  for (const std::string& name : names) {
    const std::string stem = fs::path(name).stem().string();
    const size_t last = stem.find_last_of("0123456789");
    if (last == std::string::npos) return {};
    size_t begin = last;
    bool point = false;
    while (begin > 0 && (is_digit(stem[begin - 1]) ||
                         (stem[begin - 1] == '.' && !point && begin > 1 && is_digit(stem[begin - 2])))) {
      --begin;
      point = point || stem[begin] == '.';
    }
    const std::string rest = stem.substr(0, begin) + '\n' + stem.substr(last + 1);
    if (numbers.empty()) around = rest;
    if (rest != around) return {};
    numbers.push_back(stem.substr(begin, last + 1 - begin));
    decimals = decimals || point;
  }
  *unit = TimeUnit::kSeconds;
  if (numbers.size() < 2) return {};
  std::vector<int64_t> values;
  if (decimals) {  // unless it is a count after a point: shot1.0001
    for (const std::string& number : numbers) {
      int64_t value = 0;
      if (!parse_stamp(number, *unit, &value)) return {};
      values.push_back(value);
    }
    std::sort(values.begin(), values.end());
    return is_plausible(values) ? numbers : std::vector<std::string>();
  }
  for (const std::string& number : numbers) {
    int64_t value = 0;
    if (!parse_integer(number, &value)) return {};
    values.push_back(value);
  }
  std::sort(values.begin(), values.end());
  std::vector<int64_t> steps;
  for (size_t i = 1; i < values.size(); ++i) steps.push_back(values[i] - values[i - 1]);
  std::nth_element(steps.begin(), steps.begin() + static_cast<ptrdiff_t>(steps.size() / 2), steps.end());
  constexpr int64_t kSince1970S = 1000000000;  // 2001; times in milliseconds have three digits more, and so on
  const int64_t value = values[values.size() / 2];
  if (value >= kSince1970S) {
    if (value / 1000 >= kSince1970S) *unit = TimeUnit::kMilliseconds;
    if (value / 1000000 >= kSince1970S) *unit = TimeUnit::kMicroseconds;
    if (value / 1000000000 >= kSince1970S) *unit = TimeUnit::kNanoseconds;
    return numbers;
  }
  constexpr int64_t kLargestCount = 1000;  // from one image to the next: every 1000th frame of a film
  if (steps[steps.size() / 2] <= kLargestCount) return {};
  *unit = TimeUnit::kMicroseconds;
  return numbers;
}

// KITTI's times.txt beside the folder: a line for each image, seconds.
std::vector<std::string> times_beside(const fs::path& folder) {
  const fs::path file = fs::absolute(folder / "").lexically_normal().parent_path().parent_path() / "times.txt";
  std::error_code ignored;
  std::vector<std::string> stamps;
  if (!fs::is_regular_file(file, ignored)) return stamps;
  bool single = true;  // others keep names and exposures in a file of that name
  for_each_line(file, [&](std::string_view line, const LineError&) {
    single = single && line.find_first_of(" \t,;") == std::string_view::npos;
    stamps.emplace_back(line);
  });
  return single ? stamps : std::vector<std::string>();
}

// The words of a name that tell what kind of image it is: all but its numbers, in small letters. The number of a camera
// ("cam0"), one digit, counts as a word.
std::string kind_of(const std::string& name) {
  const std::string stem = fs::path(name).stem().string();
  std::string kind;
  for (size_t i = 0; i < stem.size(); ++i) {
    const char c = stem[i];
    const bool decimal = c == '.' && kind.ends_with('0') && i + 1 < stem.size() && is_digit(stem[i + 1]);
    if (decimal) continue;
    const bool of_camera = (kind.ends_with("cam") || kind.ends_with("camera") || kind.ends_with("infra")) &&
                           i + 1 < stem.size() && !is_digit(stem[i + 1]);
    if (!is_digit(c) || of_camera) {
      kind.push_back(c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c);
    } else if (!kind.ends_with('0')) {
      kind.push_back('0');
    }
  }
  return kind;
}

// Throws InputError when the folder holds images of two cameras, or of depth beside colour: no film. Warns where there
// are several kinds of names otherwise.
void check_one_kind(const fs::path& folder, const std::vector<std::string>& names, const WarnOfList& warn) {
  constexpr size_t kMinShare = 4;  // a kind with less than that part of the images is a stray one
  std::map<std::string, std::vector<std::string>> kinds;
  for (const std::string& name : names) kinds[kind_of(name)].push_back(name);
  std::vector<std::string> examples;  // the first name of each kind
  bool cameras = false;
  for (const auto& [kind, members] : kinds) {
    if (members.size() < 2 || members.size() * kMinShare < names.size()) continue;
    examples.push_back(members.front());
    for (const char* word : {"left", "right", "depth", "disp", "infra", "cam0", "cam1", "camera0", "camera1", "_l",
                             "_r", "l_", "r_", "-l", "-r", "l", "r"}) {
      const bool letter = std::string_view(word).size() <= 2;
      cameras = cameras || (letter ? kind == word || kind == std::string("0") + word || kind == std::string(word) + "0"
                                   : kind.find(word) != std::string::npos);
    }
  }
  if (examples.size() < 2) return;
  const std::string found =
      "folder " + folder.string() + " holds images of several kinds, such as " + examples[0] + " and " + examples[1];
  const std::string way_out =
      ": move all but one kind to another folder, or give that kind by a pattern (NAME%04d.png)";
  if (cameras) throw InputError(found + way_out);
  warn(found + ", and all are taken as one film; if they are not" + way_out);
}

ImageList open_image_folder(const fs::path& folder, const WarnOfList& warn) {
  std::vector<std::string> names = file_names(folder);
  std::erase_if(names, [](const std::string& name) { return name[0] == '.' || !has_image_extension(name); });
  if (names.empty()) {
    for (const char* inner : {"image_0", "rgb", "images", "image_00", "cam0", "data"}) {
      if (is_folder(folder / inner)) {
        throw InputError("folder " + folder.string() + " holds no images, but there is a folder in it: give " +
                         (folder / inner).string());
      }
    }
    throw InputError("folder " + folder.string() +
                     " holds no images (png, jpg, pgm, ppm, bmp, tiff), no rgb.txt (TUM) and no mav0 (EuRoC)");
  }
  std::sort(names.begin(), names.end(), natural_less);
  check_one_kind(folder, names, warn);
  ImageList result;
  for (const std::string& name : names) result.images.push_back({folder / name});

  TimeUnit unit = TimeUnit::kSeconds;
  const std::vector<std::string> beside = times_beside(folder);
  const std::vector<std::string> named = times_in_names(names, &unit);
  if (!beside.empty() && beside.size() == names.size()) {
    const fs::path file = fs::absolute(folder / "").lexically_normal().parent_path().parent_path() / "times.txt";
    stamp_images(&result.images, beside, TimeUnit::kSeconds, file.string(), warn);
    result.times = ImageTimes::kListed;
  } else if (!named.empty()) {
    // In natural order 1.1 comes before 1.07; as numbers they are sorted here, which is nothing to warn of.
    // Their order is the same in any unit: in the smallest one no whole number is too large.
    const auto has_point = [](const std::string& number) { return number.find('.') != std::string::npos; };
    const bool decimals = std::any_of(named.begin(), named.end(), has_point);
    std::vector<std::pair<int64_t, size_t>> order;
    for (size_t i = 0; i < named.size(); ++i) {
      int64_t value = 0;
      if (!parse_stamp(named[i], decimals ? TimeUnit::kSeconds : TimeUnit::kNanoseconds, &value))
        throw InputError(names[i] + ": the number in its name is too large");
      order.emplace_back(value, i);
    }
    std::sort(order.begin(), order.end());
    std::vector<std::string> stamps;
    std::vector<ImageEntry> images;
    for (const auto& [value, i] : order) {
      stamps.push_back(named[i]);
      images.push_back(result.images[i]);
    }
    stamp_images(&images, stamps, unit, "folder " + folder.string() + ", named by time", warn);
    result.images = std::move(images);
    result.times = ImageTimes::kNamed;
  }
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
}  // namespace

ImageList list_images(const fs::path& source, std::vector<std::string>* warnings) {
  const WarnOfList warn = [&](const std::string& text) {
    if (warnings) warnings->push_back(text);
  };
  if (is_folder(source)) {
    if (fs::exists(source / "rgb.txt")) return open_tum(source / "rgb.txt", warn);
    for (const fs::path& camera : {source / "mav0/cam0", source / "cam0", source}) {
      if (fs::exists(camera / "data.csv")) return open_euroc(camera, warn);
    }
    return open_image_folder(source, warn);
  }
  if (!fs::exists(source)) return open_pattern(source);
  if (is_list(source)) return open_tum(source, warn);
  ImageList single;
  single.images.push_back({source});
  return single;
}

bool is_folder(const fs::path& path) {
  std::error_code ignored;
  return fs::is_directory(path, ignored);
}

bool is_list(const fs::path& file) {
  return extension_of(file) == ".txt" || extension_of(file) == ".csv";
}

bool has_image_extension(const fs::path& file) {
  constexpr std::array kExtensions = {".png", ".jpg", ".jpeg", ".pgm", ".ppm", ".pnm", ".pbm", ".bmp", ".tif", ".tiff"};
  return std::find(kExtensions.begin(), kExtensions.end(), extension_of(file)) != kExtensions.end();
}

}  // namespace pptam::platform
