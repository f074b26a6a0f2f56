// The text console (virtual terminal) that the program runs on, if it does: the kernel asks it before it gives the
// screen to another console, and tells it when it is back.
#pragma once

#include <linux/vt.h>

#include <csignal>

namespace pptam::platform {

// One at a time: signals have one owner.
class TextConsole {
 public:
  TextConsole();
  ~TextConsole();
  TextConsole(const TextConsole&) = delete;
  TextConsole& operator=(const TextConsole&) = delete;

  bool there() const { return fd_ >= 0; }
  // Since the last call: the screen is asked for, to be answered by give(); or it is ours again. Ctrl-Alt-F2 and the
  // like.
  enum class Change { kNone, kAsked, kBack };
  Change change();
  void give() const;

 private:
  int fd_ = -1;
  vt_mode mode_before_ = {};
  struct sigaction asked_before_ = {}, back_before_ = {};
};

}  // namespace pptam::platform
