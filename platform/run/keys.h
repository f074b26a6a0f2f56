// Single keys from standard input: from a terminal without waiting for Enter, from a pipe as its characters come.
#pragma once

namespace pptam::platform {

class Keys {
 public:
  // A terminal is set to give single keys, if this program is in its foreground, and put back at the end.
  Keys();
  ~Keys();
  Keys(const Keys&) = delete;
  Keys& operator=(const Keys&) = delete;

  bool terminal() const { return terminal_; }
  char next();  // does not wait; 0: none

 private:
  bool terminal_ = false;
  bool open_ = true;  // not yet at its end
};

// For a handler of signals that end the process: puts the terminal back.
void restore_terminal() noexcept;

}  // namespace pptam::platform
