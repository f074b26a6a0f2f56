#include "platform/camera/calibration_text.h"

#include <algorithm>
#include <string_view>
#include <utility>

#include "platform/camera/calibration_xml.h"
#include "platform/camera/calibration_yaml.h"
#include "platform/text_file.h"

namespace pptam::platform {
namespace {

struct Magic {
  std::string_view bytes;
  size_t offset;
  const char* what;
};

constexpr Magic kMagics[] = {
    {"\x89PNG", 0, "an image (PNG)"},
    {"\xff\xd8\xff", 0, "an image (JPEG)"},
    {"BM", 0, "an image (BMP)"},
    {"II*", 0, "an image (TIFF)"},
    {"MM", 0, "an image (TIFF)"},
    {"P5", 0, "an image (PGM)"},
    {"P6", 0, "an image (PPM)"},
    {"GIF8", 0, "an image (GIF)"},
    {"RIFF", 0, "an image or a video (RIFF)"},
    {"ftyp", 4, "a video (MP4)"},
    {"\x1a\x45\xdf\xa3", 0, "a video (Matroska)"},
    {"%PDF", 0, "a PDF"},
    {"PK\x03\x04", 0, "a zip archive or NumPy's .npz: unpack it, or write the numbers as OpenCV's YAML"},
    {"\x1f\x8b", 0, "a packed archive (gzip), such as calibrationdata.tar.gz: unpack it and give the ost.yaml inside"},
    {"BZh", 0, "a packed archive (bzip2): unpack it"},
    {"\xfd"
     "7zXZ",
     0, "a packed archive (xz): unpack it"},
    {"ustar", 257, "an archive (tar): unpack it and give the ost.yaml inside"},
    {"\x93NUMPY", 0, "NumPy's .npy: write the numbers as OpenCV's YAML"},
    {"\x80\x03", 0, "a Python pickle: write the numbers as OpenCV's YAML"},
    {"\x80\x04", 0, "a Python pickle: write the numbers as OpenCV's YAML"},
    {"MATLAB", 0, "a MATLAB file: write the numbers as OpenCV's YAML"},
    {"#ROSBAG", 0, "a ROS bag: write `rostopic echo -n 1 CAMERA/camera_info` to a file"},
    {"SQLite", 0, "a ROS 2 bag: write `ros2 topic echo --once CAMERA/camera_info` to a file"},
    {"\x7f"
     "ELF",
     0, "a program"},
};

void refuse_other_kinds(const std::vector<std::byte>& bytes, const std::string& file) {
  const std::string_view head(reinterpret_cast<const char*>(bytes.data()), std::min(bytes.size(), size_t{512}));
  for (const Magic& magic : kMagics) {
    const bool text = magic.bytes.size() == 2 && magic.bytes[0] >= 'A' && magic.bytes[0] <= 'P';  // may begin a word
    const bool zeros = head.find('\0') != std::string_view::npos || magic.bytes[0] == 'P';
    if (head.size() > magic.offset && head.substr(magic.offset).starts_with(magic.bytes) && (!text || zeros))
      refuse_calibration(file, std::string("is not a calibration but seems to be ") + magic.what);
  }
}

// Spaces that editors, web pages and word processors put where a plain one belongs.
void plain_spaces(std::string* text) {
  constexpr std::string_view kSpaces[] = {"\xc2\xa0", "\xe2\x80\x87", "\xe2\x80\xaf", "\xe3\x80\x80", "\xef\xbb\xbf"};
  size_t kept = 0;
  for (size_t i = 0; i < text->size();) {
    size_t length = 0;
    for (const std::string_view space : kSpaces) {
      if ((*text)[i] == space[0] && text->compare(i, space.size(), space) == 0) length = space.size();
    }
    (*text)[kept++] = length > 0 ? ' ' : (*text)[i];
    i += std::max(length, size_t{1});
  }
  text->resize(kept);
}

}  // namespace

std::string calibration_text(std::vector<std::byte> bytes, const std::string& file) {
  refuse_other_kinds(bytes, file);
  std::string text = text_of(std::move(bytes), "calibration " + file);
  plain_spaces(&text);
  return text;
}

CalibrationSection parse_calibration(const std::string& text, const std::string& file,
                                     std::vector<std::string>* warnings) {
  const size_t begin = text.find_first_not_of(" \t\n");
  if (begin == std::string::npos) refuse_calibration(file, "is empty: a mapping of keys to values was expected");
  const std::string_view head = std::string_view(text).substr(begin);
  if (head.starts_with("# oST version") || head.starts_with("[image]")) {
    refuse_calibration(file, "is the ost.txt of ROS's calibration: give the ost.yaml beside it");
  }
  const YAML::Node root = head[0] == '<' ? parse_calibration_xml(text, file) : parse_calibration_yaml(text, file);
  return CalibrationSection(file, root, warnings);
}

}  // namespace pptam::platform
