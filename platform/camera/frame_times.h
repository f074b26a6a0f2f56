// The times of a recording's frames, as videos and lists give them, made fit for tracking: rising, and in nanoseconds.
// What was mended and what looks wrong is told in one line each.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace pptam::platform {

class FrameTimes {
 public:
  // The time of the next frame, from its stamp. None: leave the frame out, its stamp is not later than the one before.
  // Stamps that have jumped back for good (three in a row that rise) are moved behind what came before.
  std::optional<int64_t> next(int64_t stamp_ns);

  size_t accepted() const { return times_ns_.size(); }
  // The usual one of the times accepted so far; 0 with fewer than two.
  double frames_per_s() const;
  // Frames left out, jumps, gaps, an implausible rate, frames that come in bursts; one line each.
  std::vector<std::string> remarks() const;

 private:
  std::vector<int64_t> times_ns_;  // accepted
  int64_t offset_ns_ = 0;          // added to stamps, after a jump
  int64_t last_stamp_ns_ = 0;      // of the frame before, whether accepted or not
  size_t frames_ = 0;
  size_t rising_ = 0;  // stamps in a row that rise, but lie before the last time accepted
  size_t left_out_ = 0;
  size_t first_left_out_ = 0;  // frame, counted from 1
  size_t jumps_ = 0;
  size_t first_jump_ = 0;       // likewise
  std::vector<size_t> joints_;  // indices of times_ns_ that come after a jump: the step before them is made up
};

// Whether the usual step between sorted times is between 1/500 and 2 seconds; true for a single time.
bool is_plausible(const std::vector<int64_t>& times_ns);
// Whether rising times come in bursts, several together and then a pause: those are times of arrival.
bool in_bursts(const std::vector<int64_t>& times_ns);
// Such times evened out: each the mean of those within four frames before and after. Still rising, but perhaps not by
// a whole nanosecond.
std::vector<int64_t> evened_out(const std::vector<int64_t>& times_ns);

enum class TimeUnit { kSeconds, kMilliseconds, kMicroseconds, kNanoseconds };

// A decimal number in that unit to nanoseconds. False when text is not a number or does not fit.
bool parse_stamp(std::string_view text, TimeUnit unit, int64_t* stamp_ns);

// The unit in which the stamps make sense: the documented one if the usual step is then plausible, between 1/500 and 2
// seconds; else one in which it is plausible, best with times since 1970; else one that gives slow times since 1970.
// Says so in *remark when it is not the documented one.
TimeUnit recognised_unit(const std::vector<std::string>& stamps, TimeUnit documented, std::string* remark);

// The order in which frames with these stamps are to be taken: sorted, unless they rise in long runs that overlap in
// time, as when a recorder's clock was set back; then as they are.
std::vector<size_t> order_in_time(const std::vector<int64_t>& stamps_ns);

}  // namespace pptam::platform
