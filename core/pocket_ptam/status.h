// Status reports a caller's mistake; the assert handler is called on a bug of the core.
//
// Three kinds of failure are kept apart: a bug of the core (assert handler), a caller's mistake (Status; state
// unchanged), and views that cannot be tracked (ordinary output, see TrackResult). Nothing here allocates; messages are
// string literals.
#pragma once

#include <cstdint>
#include <utility>

namespace pptam {

enum class StatusCode : uint8_t {
  kOk,
  kInvalidArgument,    // a null image, a wrong size or stride, an impossible calibration
  kOutOfMemory,        // the caller's memory block is smaller than required_bytes() or map_bytes()
  kTimeWentBackwards,  // a frame's timestamp is not later than the one before
  kNotReady,           // there is no finished map yet
  kBadFile,            // not a saved map, one of another version, or a damaged one
  kConfigMismatch      // a valid saved map, but of another camera, or too large for Config's capacities
};

// Success, or a code and a message that says what was wrong and what to do.
class [[nodiscard]] Status {
 public:
  constexpr Status() = default;
  constexpr Status(StatusCode code, const char* message) : code_(code), message_(message) {}
  constexpr bool ok() const { return code_ == StatusCode::kOk; }
  constexpr StatusCode code() const { return code_; }
  constexpr const char* message() const { return message_; }

 private:
  StatusCode code_ = StatusCode::kOk;
  const char* message_ = "";
};

using AssertHandler = void (*)(const char* expression, const char* file, int line);

namespace detail {
inline void default_assert_handler(const char*, const char*, int) {
  __builtin_trap();
}
inline AssertHandler& assert_handler() {
  static AssertHandler handler = default_assert_handler;
  return handler;
}
}  // namespace detail

// Sets the function that a failed assertion of the core calls (default: trap). The core's only process-wide setting.
inline void set_assert_handler(AssertHandler handler) {
  detail::assert_handler() = handler;
}

}  // namespace pptam
