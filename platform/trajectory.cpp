#include "platform/trajectory.h"

#include <charconv>
#include <cmath>
#include <fstream>
#include <limits>
#include <string_view>
#include <system_error>

#include "platform/input_error.h"

namespace pptam::platform {
namespace {

constexpr std::string_view kBlanks = " \t\r";
constexpr int64_t kNsPerS = 1'000'000'000;

std::string_view next_word(std::string_view* rest) {
  const size_t begin = std::min(rest->find_first_not_of(kBlanks), rest->size());
  const size_t end = std::min(rest->find_first_of(kBlanks, begin), rest->size());
  const std::string_view word = rest->substr(begin, end - begin);
  *rest = rest->substr(end);
  return word;
}

bool parse_number(std::string_view word, double* number) {
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), *number);
  return error == std::errc() && end == word.data() + word.size() && std::isfinite(*number);
}

void append_number(std::string* line, double number) {
  char text[40];
  const double positive_zero = number + 0.0;  // -0 becomes 0
  const auto [end, error] = std::to_chars(text, text + sizeof text, positive_zero, std::chars_format::general, 9);
  line->push_back(' ');
  line->append(text, end);
}

std::string timestamp_text(int64_t timestamp_ns) {
  const bool negative = timestamp_ns < 0;
  const uint64_t ns = negative ? 0 - static_cast<uint64_t>(timestamp_ns) : static_cast<uint64_t>(timestamp_ns);
  std::string fraction = std::to_string(ns % kNsPerS);
  fraction.insert(0, 9 - fraction.size(), '0');
  if (ns % 1000 == 0) fraction.resize(6);
  return (negative ? "-" : "") + std::to_string(ns / kNsPerS) + "." + fraction;
}

}  // namespace

bool parse_timestamp_s(std::string_view text, int64_t* timestamp_ns) {
  // mantissa * 10^exponent seconds, in integers: a double holds an epoch time only to 0.2 microseconds.
  size_t i = 0;
  const bool negative = !text.empty() && text[0] == '-';
  if (negative || (!text.empty() && text[0] == '+')) ++i;
  uint64_t mantissa = 0;
  int exponent = 0;
  bool any_digit = false;
  bool after_point = false;
  for (; i < text.size() && (text[i] == '.' || (text[i] >= '0' && text[i] <= '9')); ++i) {
    if (text[i] == '.') {
      if (after_point) return false;
      after_point = true;
      continue;
    }
    any_digit = true;
    if (mantissa > (std::numeric_limits<uint64_t>::max() - 9) / 10) {  // further digits are below a nanosecond, or
      if (!after_point) return false;                                  // the number is too large for the result
      continue;
    }
    mantissa = 10 * mantissa + static_cast<uint64_t>(text[i] - '0');
    if (after_point) --exponent;
  }
  if (!any_digit) return false;
  if (i < text.size()) {  // 1.305031102e+09, as numpy writes it
    if (text[i] != 'e' && text[i] != 'E') return false;
    ++i;
    if (i < text.size() && text[i] == '+') ++i;
    int given = 0;
    const auto [end, error] = std::from_chars(text.data() + i, text.data() + text.size(), given);
    if (error != std::errc() || end != text.data() + text.size() || given < -99 || given > 99) return false;
    exponent += given;
  }
  exponent += 9;  // to nanoseconds
  constexpr uint64_t kMax = std::numeric_limits<int64_t>::max();
  for (; exponent > 0 && mantissa != 0; --exponent) {
    if (mantissa > kMax / 10) return false;
    mantissa *= 10;
  }
  uint64_t last_digit = 0;
  for (; exponent < 0 && mantissa != 0; ++exponent) {
    last_digit = mantissa % 10;
    mantissa /= 10;
  }
  if (exponent == 0 && last_digit >= 5) ++mantissa;  // round half up
  if (mantissa > kMax) return false;
  *timestamp_ns = negative ? -static_cast<int64_t>(mantissa) : static_cast<int64_t>(mantissa);
  return true;
}

Trajectory read_tum_trajectory(const std::filesystem::path& file) {
  std::error_code ignored;
  std::ifstream stream(file);
  if (!std::filesystem::is_regular_file(file, ignored) || !stream) {
    throw InputError("cannot read trajectory " + file.string() + ": there is no such readable file");
  }
  Trajectory trajectory;
  std::string line;
  for (int number = 1; std::getline(stream, line); ++number) {
    const auto fail = [&](const std::string& what) {
      throw InputError(file.string() + ":" + std::to_string(number) + ": " + what);
    };
    std::string_view rest = line;
    const std::string_view first = next_word(&rest);
    if (first.empty() || first[0] == '#') continue;

    StampedPose pose;
    if (!parse_timestamp_s(first, &pose.timestamp_ns)) fail("the timestamp is not a number of seconds");
    double v[7];
    for (double& value : v) {
      if (!parse_number(next_word(&rest), &value)) {
        fail("expected 8 finite numbers: timestamp tx ty tz qx qy qz qw");
      }
    }
    if (!next_word(&rest).empty()) fail("more than 8 numbers; expected timestamp tx ty tz qx qy qz qw");
    Eigen::Quaterniond q(v[6], v[3], v[4], v[5]);
    // Written with few digits a unit quaternion is off by 1e-2 at most; anything further is not a rotation.
    if (!(std::abs(q.norm() - 1) < 0.1)) fail("the quaternion is not of unit length");
    if (!trajectory.empty() && pose.timestamp_ns <= trajectory.back().timestamp_ns) {
      fail("the timestamp is not later than the one before");
    }
    q.normalize();
    pose.T_wc.linear() = q.toRotationMatrix();
    pose.T_wc.translation() = Eigen::Vector3d(v[0], v[1], v[2]);
    trajectory.push_back(pose);
  }
  if (stream.bad()) throw InputError("cannot read trajectory " + file.string() + ": the file broke off");
  return trajectory;
}

void write_tum_trajectory(const std::filesystem::path& file, const Trajectory& trajectory, const std::string& header) {
  std::ofstream stream(file, std::ios::binary);
  if (!header.empty()) {
    std::string one_line = header;
    for (char& c : one_line) {
      if (c == '\n' || c == '\r') c = ' ';
    }
    stream << "# " << one_line << '\n';
  }
  for (const StampedPose& pose : trajectory) {
    Eigen::Quaterniond q(pose.T_wc.linear());
    q.normalize();
    if (q.w() < 0) q.coeffs() = -q.coeffs();
    const Eigen::Vector3d t = pose.T_wc.translation();
    std::string line = timestamp_text(pose.timestamp_ns);
    for (const double number : {t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w()}) append_number(&line, number);
    stream << line << '\n';
  }
  stream.close();
  if (!stream) throw InputError("cannot write " + file.string() + ": check that the folder exists and has space");
}

}  // namespace pptam::platform
