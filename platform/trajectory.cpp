#include "platform/trajectory.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <fstream>
#include <limits>
#include <numeric>
#include <optional>
#include <string_view>
#include <system_error>
#include <utility>

#include "platform/files.h"
#include "platform/input_error.h"
#include "platform/text.h"
#include "platform/text_file.h"

namespace pptam::platform {
namespace {

constexpr int64_t kNsPerS = 1'000'000'000;

// ---- Numbers -----------------------------------------------------------------------------------------------------

// mantissa * 10^exponent: a double holds an epoch time only to 0.2 microseconds.
struct Decimal {
  bool negative = false;
  uint64_t mantissa = 0;
  int exponent = 0;

  double value() const { return (negative ? -1 : 1) * static_cast<double>(mantissa) * std::pow(10.0, exponent); }
};

bool parse_decimal(std::string_view text, Decimal* number) {
  size_t i = 0;
  *number = {};
  number->negative = !text.empty() && text[0] == '-';
  if (number->negative || (!text.empty() && text[0] == '+')) ++i;
  bool any_digit = false;
  bool after_point = false;
  for (; i < text.size() && (text[i] == '.' || (text[i] >= '0' && text[i] <= '9')); ++i) {
    if (text[i] == '.') {
      if (after_point) return false;
      after_point = true;
      continue;
    }
    any_digit = true;
    if (number->mantissa > (std::numeric_limits<uint64_t>::max() - 9) / 10) {
      if (!after_point) return false;  // too large for any result; further decimals are below a nanosecond
      continue;
    }
    number->mantissa = 10 * number->mantissa + static_cast<uint64_t>(text[i] - '0');
    if (after_point) --number->exponent;
  }
  if (!any_digit) return false;
  if (i == text.size()) return true;
  if (text[i] != 'e' && text[i] != 'E') return false;  // 1.305031102e+09, as numpy writes it
  ++i;
  if (i < text.size() && text[i] == '+') ++i;
  int given = 0;
  const auto [end, error] = std::from_chars(text.data() + i, text.data() + text.size(), given);
  if (error != std::errc() || end != text.data() + text.size() || given < -99 || given > 99) return false;
  number->exponent += given;
  return true;
}

// number * 10^shift, rounded half up. False when it does not fit.
bool to_integer(const Decimal& number, int shift, int64_t* result) {
  uint64_t mantissa = number.mantissa;
  int exponent = number.exponent + shift;
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
  if (exponent == 0 && last_digit >= 5) ++mantissa;
  if (mantissa > kMax) return false;
  *result = number.negative ? -static_cast<int64_t>(mantissa) : static_cast<int64_t>(mantissa);
  return true;
}

// NaN and infinity are numbers here.
bool parse_number(std::string_view word, double* number) {
  if (word.starts_with('+')) word.remove_prefix(1);
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), *number);
  return !word.empty() && error == std::errc() && end == word.data() + word.size();
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

// ---- Rows of a file, their times not yet understood --------------------------------------------------------------

// 25 minutes at 200 per second; two such files are compared within 200 MB.
constexpr size_t kMaxPoses = 300'000;

struct PoseTable {
  std::string file;
  std::vector<Decimal> stamps;  // one of each for every pose
  std::vector<int> lines;
  Trajectory poses;  // without their times
};

enum class QuaternionOrder { kUnknown, kWLast, kWFirst };

// Columns between semicolons, else between commas, else between blanks.
std::vector<std::string_view> columns_of(std::string_view line) {
  constexpr std::string_view kBlanks = " \t\r";
  std::vector<std::string_view> columns;
  const char separator = line.find(';') != std::string_view::npos ? ';' : ',';
  if (line.find(separator) == std::string_view::npos) {
    for (size_t begin = 0; (begin = line.find_first_not_of(kBlanks, begin)) != std::string_view::npos;) {
      const size_t end = std::min(line.find_first_of(kBlanks, begin), line.size());
      columns.push_back(line.substr(begin, end - begin));
      begin = end;
    }
    return columns;
  }
  while (true) {
    const size_t cut = std::min(line.find(separator), line.size());
    columns.push_back(trimmed(line.substr(0, cut)));
    if (cut == line.size()) break;
    line = line.substr(cut + 1);
  }
  if (columns.back().empty()) columns.pop_back();  // the line ends in a separator
  return columns;
}

// From a header such as "#timestamp, p_RS_R_x [m], ..., q_RS_w [], q_RS_x [], ..." or "# timestamp tx ty tz qx qy qz
// qw".
QuaternionOrder order_in_header(std::string_view header) {
  std::string letters;  // of the quaternion's columns, in their order
  for (size_t begin = 0; (begin = header.find_first_not_of(" \t,;#%\"", begin)) != std::string_view::npos;) {
    const size_t end = std::min(header.find_first_of(" \t,;\"", begin), header.size());
    const std::string_view word = header.substr(begin, end - begin);
    if (word.size() > 1 && (word[0] == 'q' || word[0] == 'Q')) letters.push_back(word.back());
    begin = end;
  }
  for (char& c : letters) c = c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
  if (letters == "xyzw") return QuaternionOrder::kWLast;
  return letters == "wxyz" ? QuaternionOrder::kWFirst : QuaternionOrder::kUnknown;
}

bool is_number(std::string_view word) {
  double ignored = 0;
  return parse_number(word, &ignored);
}

// "FILE: doubled time stamps, left out: 3, the first in line 7".
class Counted {
 public:
  void add(int line) {
    if (count_++ == 0) first_line_ = line;
  }
  int count() const { return count_; }
  void tell(const std::string& file, const char* what, std::vector<std::string>* warnings) const {
    if (count_ == 0) return;
    warnings->push_back(file + ": " + what + format(": %d, the first in line %d", count_, first_line_));
  }

 private:
  int count_ = 0;
  int first_line_ = 0;
};

void refuse_other_format(size_t columns, const LineError& fail) {
  if (columns == 12 || columns == 13 || columns == 16 || columns == 17) {
    fail(std::to_string(columns) +
         " numbers are a matrix, as KITTI writes poses; each line needs a time and a quaternion instead: timestamp tx "
         "ty tz qx qy qz qw (evo's kitti_poses_and_timestamps_to_trajectory.py writes that from poses and times)");
  }
  fail("has " + std::to_string(columns) + " columns, expected 8 finite numbers: timestamp tx ty tz qx qy qz qw");
}

// NaN where the position or the rotation is none.
Eigen::Isometry3d parse_pose(const std::vector<std::string_view>& columns, QuaternionOrder order,
                             const LineError& fail) {
  std::array<double, 7> v{};
  for (size_t i = 0; i < v.size(); ++i) {
    if (!parse_number(columns[i + 1], &v[i])) {
      fail("expected 8 finite numbers: timestamp tx ty tz qx qy qz qw" +
           std::string(columns[i + 1].find(',') == std::string_view::npos ? "" : "; decimals need points, not commas"));
    }
  }
  const Eigen::Quaterniond q = order == QuaternionOrder::kWFirst ? Eigen::Quaterniond(v[3], v[4], v[5], v[6])
                                                                 : Eigen::Quaterniond(v[6], v[3], v[4], v[5]);
  Eigen::Isometry3d T_wc = Eigen::Isometry3d::Identity();
  T_wc.translation() = Eigen::Vector3d(v[0], v[1], v[2]);
  if (!T_wc.translation().allFinite() || !q.coeffs().allFinite() || q.coeffs().isZero(0)) {
    T_wc.translation().setConstant(std::numeric_limits<double>::quiet_NaN());
    return T_wc;
  }
  // Written with few digits a unit quaternion is off by 1e-2 at most; anything further is not a rotation.
  if (!(std::abs(q.norm() - 1) < 0.1)) fail("the quaternion is not of unit length");
  T_wc.linear() = q.normalized().toRotationMatrix();
  return T_wc;
}

// Commas without a header: EuRoC has q_w first, TUM last.
void check_order_is_clear(const std::string& file, const std::vector<std::string_view>& columns, const LineError& fail,
                          std::vector<std::string>* warnings) {
  Decimal stamp;
  constexpr double kSurelyNs = 1e15;  // as seconds: 30 million years
  if (columns.size() > 8 || (parse_decimal(columns[0], &stamp) && stamp.value() > kSurelyNs)) {
    fail(
        "commas, and no header that tells whether q_w is first (EuRoC) or last (TUM): begin the file with "
        "\"#timestamp, "
        "p_x, p_y, p_z, q_w, q_x, q_y, q_z\" or with \"#timestamp, tx, ty, tz, qx, qy, qz, qw\"");
  }
  if (warnings != nullptr) warnings->push_back(file + ": no header: taken for timestamp, tx, ty, tz, qx, qy, qz, qw");
}

// A line of names and no numbers, which should have been a comment.
bool is_header(const std::vector<std::string_view>& columns) {
  return columns.size() >= 8 && std::none_of(columns.begin(), columns.end(), is_number);
}

// What is not given of the order comes from the comments and from the header. Rows in the file's order.
PoseTable read_rows(const std::filesystem::path& file, QuaternionOrder order, std::vector<std::string>* warnings) {
  PoseTable table;
  table.file = file.string();
  const std::string text = read_text(file);
  Counted lost;
  bool begun = false;
  int number = 0;
  for (size_t begin = 0; begin < text.size();) {
    const size_t end = text.find('\n', begin);
    const std::string_view line = trimmed(std::string_view(text).substr(begin, end - begin));
    begin = end + 1;
    ++number;
    const LineError fail = [&](const std::string& what) {
      throw InputError(table.file + ":" + std::to_string(number) + ": " + what);
    };
    if (line.size() > kMaxLineBytes) fail("a line of more than 64 kB");
    if (line.empty()) continue;
    if (line[0] == '#') {
      if (!begun && order == QuaternionOrder::kUnknown) order = order_in_header(line);
      continue;
    }
    const std::vector<std::string_view> columns = columns_of(line);
    const bool commas = line.find_first_of(",;") != std::string_view::npos;
    if (!begun) {
      begun = true;
      const bool header = warnings != nullptr && is_header(columns);
      if (header) {
        if (order == QuaternionOrder::kUnknown) order = order_in_header(line);
        warnings->push_back(table.file + ":" + std::to_string(number) + ": taken for a header; comments begin with #");
      }
      if (commas && order == QuaternionOrder::kUnknown) check_order_is_clear(table.file, columns, fail, warnings);
      if (header) continue;
    }
    const bool more_allowed = order == QuaternionOrder::kWFirst && commas;  // EuRoC has velocities behind
    if (columns.size() < 8 || (columns.size() > 8 && !more_allowed)) refuse_other_format(columns.size(), fail);
    Decimal stamp;
    if (!parse_decimal(columns[0], &stamp)) fail("the timestamp is not a number of seconds");
    const Eigen::Isometry3d T_wc = parse_pose(columns, order, fail);
    if (!T_wc.translation().allFinite()) {
      if (warnings == nullptr) fail("expected 8 finite numbers and a quaternion of unit length");
      lost.add(number);
      continue;
    }
    if (table.poses.size() == kMaxPoses) fail("more than 300000 poses: keep a part of the file");
    table.stamps.push_back(stamp);
    table.lines.push_back(number);
    table.poses.push_back({0, T_wc});
  }
  if (warnings != nullptr) lost.tell(table.file, "poses of NaN or zeros (lost?), left out", warnings);
  return table;
}

// ---- Times -------------------------------------------------------------------------------------------------------

// In order of time, each time once. shift: the power of ten that makes the stamps nanoseconds.
Trajectory in_order(PoseTable table, int shift, std::vector<std::string>* warnings) {
  Trajectory& poses = table.poses;
  Counted unordered;
  Counted doubled;
  for (size_t i = 0; i < poses.size(); ++i) {
    const auto fail = [&](const std::string& what) {
      throw InputError(table.file + ":" + std::to_string(table.lines[i]) + ": " + what);
    };
    if (!to_integer(table.stamps[i], shift, &poses[i].timestamp_ns)) fail("the timestamp is not a number of seconds");
    if (i == 0 || poses[i].timestamp_ns > poses[i - 1].timestamp_ns) continue;
    if (warnings == nullptr) fail("the timestamp is not later than the one before");
    if (poses[i].timestamp_ns < poses[i - 1].timestamp_ns) unordered.add(table.lines[i]);
  }
  std::vector<size_t> order(poses.size());
  std::iota(order.begin(), order.end(), size_t{0});
  std::stable_sort(order.begin(), order.end(),
                   [&](size_t a, size_t b) { return poses[a].timestamp_ns < poses[b].timestamp_ns; });
  Trajectory sorted;
  sorted.reserve(poses.size());
  for (const size_t i : order) {
    if (!sorted.empty() && poses[i].timestamp_ns == sorted.back().timestamp_ns) {
      doubled.add(table.lines[i]);
    } else {
      sorted.push_back(poses[i]);
    }
  }
  if (warnings == nullptr) return sorted;
  if (2 * static_cast<size_t>(doubled.count()) > poses.size()) {
    throw InputError(table.file + ": " + std::to_string(doubled.count()) + " of " + std::to_string(poses.size()) +
                     " time stamps are doubled: too few digits were written, six decimals are usual");
  }
  doubled.tell(table.file, "doubled time stamps, left out", warnings);
  unordered.tell(table.file, "time stamps before the one above, sorted", warnings);
  return sorted;
}

struct TimeUnit {
  int shift;  // power of ten that makes it nanoseconds
  const char* name;
};
constexpr std::array<TimeUnit, 4> kUnits = {
    {{9, "seconds"}, {6, "milliseconds"}, {3, "microseconds"}, {0, "nanoseconds"}}};
constexpr size_t kSeconds = 0;

// Between two poses. Usual: 500 to 0.4 per second, a factor of little more than 1000, so that hardly any step is usual
// in two units. Possible: from fast motion capture to keyframes of a slow camera.
constexpr double kUsualStepS[] = {0.0019, 2.6};
constexpr double kPossibleStepS[] = {1e-4, 10};

// What of a file's stamps tells their unit, in the numbers of the file.
struct StampSummary {
  double first = 0, last = 0;
  double step = 0;           // the median of those that are not zero; 0: none
  bool are_seconds = false;  // known

  double seconds(double number, size_t unit) const { return number * std::pow(10.0, kUnits[unit].shift - 9); }
  bool step_within(const double (&limits)[2], size_t unit) const {
    const double step_s = seconds(step, unit);
    return step == 0 || (step_s >= limits[0] && step_s <= limits[1]);
  }
  // Without knowledge of what it is compared with.
  size_t likely_unit() const {
    if (are_seconds || step_within(kPossibleStepS, kSeconds)) return kSeconds;
    for (size_t unit = 1; unit < kUnits.size(); ++unit) {
      if (step_within(kUsualStepS, unit)) return unit;
    }
    return kSeconds;
  }
};

StampSummary summary_of(const PoseTable& table) {
  StampSummary summary;
  std::vector<double> stamps;
  for (const Decimal& stamp : table.stamps) stamps.push_back(stamp.value());
  if (stamps.empty()) return summary;
  std::sort(stamps.begin(), stamps.end());
  summary.first = stamps.front();
  summary.last = stamps.back();
  for (size_t i = stamps.size(); --i > 0;) stamps[i] -= stamps[i - 1];
  stamps[0] = 0;
  std::erase(stamps, 0);
  if (stamps.empty()) return summary;
  const auto middle = stamps.begin() + static_cast<std::ptrdiff_t>(stamps.size() / 2);
  std::nth_element(stamps.begin(), middle, stamps.end());
  summary.step = *middle;
  return summary;
}

// The time that both cover, of that which either covers; negative: they do not meet.
double shared_time(const StampSummary& a, size_t unit_a, const StampSummary& b, size_t unit_b) {
  const double first[] = {a.seconds(a.first, unit_a), b.seconds(b.first, unit_b)};
  const double last[] = {a.seconds(a.last, unit_a), b.seconds(b.last, unit_b)};
  const double shared = std::min(last[0], last[1]) - std::max(first[0], first[1]);
  const double all = std::max(last[0], last[1]) - std::min(first[0], first[1]);
  constexpr double kTouchS = 0.02;  // as far apart as poses may be that are compared
  if (shared < -kTouchS) return -1;
  return all > 0 ? std::max(shared, 0.0) / all : 1;
}

struct UnitChoice {
  size_t a = kSeconds, b = kSeconds;
  double shared = -1;
};

// Seconds, unless another unit explains the two much better. Nothing when that cannot be told.
std::optional<UnitChoice> choose_units(const StampSummary& a, const StampSummary& b) {
  UnitChoice other;
  double second_best = -1;
  for (size_t i = 0; i < kUnits.size(); ++i) {
    for (size_t j = 0; j < kUnits.size(); ++j) {
      if (i == kSeconds && j == kSeconds) continue;
      if ((a.are_seconds && i != kSeconds) || (b.are_seconds && j != kSeconds)) continue;
      if (!a.step_within(kUsualStepS, i) || !b.step_within(kUsualStepS, j)) continue;
      const double shared = shared_time(a, i, b, j);
      if (shared > other.shared) {
        second_best = other.shared;
        other = {i, j, shared};
      } else {
        second_best = std::max(second_best, shared);
      }
    }
  }
  const UnitChoice seconds = {kSeconds, kSeconds, shared_time(a, kSeconds, b, kSeconds)};
  const bool possible = a.step_within(kPossibleStepS, kSeconds) && b.step_within(kPossibleStepS, kSeconds);
  constexpr double kMuch = 10;  // times: units differ by a thousand
  if (possible && seconds.shared >= 0) {
    const bool usual = a.step_within(kUsualStepS, kSeconds) && b.step_within(kUsualStepS, kSeconds);
    if (usual && other.shared >= 0.5 && seconds.shared < 0.02) return std::nullopt;
    return !usual && other.shared > kMuch * seconds.shared ? other : seconds;
  }
  if (other.shared >= 0) {
    if (kMuch * second_best > other.shared) return std::nullopt;
    return other;
  }
  return UnitChoice{a.likely_unit(), b.likely_unit(), -1};
}

Trajectory with_unit(PoseTable table, const StampSummary& summary, size_t unit, std::vector<std::string>* warnings) {
  if (unit != kSeconds) {
    warnings->push_back(table.file + format(": the stamps are not seconds: taken for %s, one pose every %.3g s",
                                            kUnits[unit].name, summary.seconds(summary.step, unit)));
  }
  return in_order(std::move(table), kUnits[unit].shift, warnings);
}

}  // namespace

bool parse_timestamp_s(std::string_view text, int64_t* timestamp_ns) {
  Decimal seconds;
  return parse_decimal(text, &seconds) && to_integer(seconds, 9, timestamp_ns);
}

Trajectory read_tum_trajectory(const std::filesystem::path& file, std::vector<std::string>* warnings) {
  return in_order(read_rows(file, QuaternionOrder::kUnknown, warnings), kUnits[kSeconds].shift, warnings);
}

TrajectoryPair read_trajectories(const std::filesystem::path& estimate, const std::filesystem::path& truth,
                                 std::vector<std::string>* warnings) {
  PoseTable a = read_rows(estimate, QuaternionOrder::kUnknown, warnings);
  PoseTable b = read_rows(truth, QuaternionOrder::kUnknown, warnings);
  const StampSummary of_a = summary_of(a);
  const StampSummary of_b = summary_of(b);
  const std::optional<UnitChoice> units = choose_units(of_a, of_b);
  if (!units) {
    throw InputError(
        a.file + format(" has stamps from %.9g to %.9g, ", of_a.first, of_a.last) + b.file +
        format(" from %.9g to %.9g: in one of them the stamps are not seconds; convert them", of_b.first, of_b.last));
  }
  TrajectoryPair pair;
  pair.estimate = with_unit(std::move(a), of_a, units->a, warnings);
  pair.truth = with_unit(std::move(b), of_b, units->b, warnings);
  return pair;
}

Trajectory read_trajectory(const std::filesystem::path& file, TimeSpan images, std::vector<std::string>* warnings) {
  PoseTable table = read_rows(file, QuaternionOrder::kUnknown, warnings);
  const StampSummary summary = summary_of(table);
  StampSummary of_images;
  of_images.first = 1e-9 * static_cast<double>(images.first_ns);
  of_images.last = 1e-9 * static_cast<double>(images.last_ns);
  of_images.are_seconds = true;
  const std::optional<UnitChoice> units = choose_units(summary, of_images);
  if (!units) throw InputError(table.file + ": the stamps are not seconds; convert them");
  return with_unit(std::move(table), summary, units->a, warnings);
}

Trajectory read_euroc_trajectory(const std::filesystem::path& file, std::vector<std::string>* warnings) {
  return in_order(read_rows(file, QuaternionOrder::kWFirst, warnings), 0, warnings);
}

std::string tum_text(const Trajectory& trajectory, const std::string& header) {
  std::string text;
  if (!header.empty()) {
    std::string one_line = header;
    for (char& c : one_line) {
      if (c == '\n' || c == '\r') c = ' ';
    }
    text += "# " + one_line + "\n";
  }
  for (const StampedPose& pose : trajectory) {
    Eigen::Quaterniond q(pose.T_wc.linear());
    q.normalize();
    if (q.w() < 0) q.coeffs() = -q.coeffs();
    const Eigen::Vector3d t = pose.T_wc.translation();
    text += timestamp_text(pose.timestamp_ns);
    for (const double number : {t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w()}) append_number(&text, number);
    text += '\n';
  }
  return text;
}

void write_tum_trajectory(const std::filesystem::path& file, const Trajectory& trajectory, const std::string& header) {
  write_text_atomically(file, tum_text(trajectory, header));
}

}  // namespace pptam::platform
