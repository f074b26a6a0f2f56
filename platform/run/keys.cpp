#include "platform/run/keys.h"

#include <poll.h>
#include <termios.h>
#include <unistd.h>

#include <csignal>

namespace pptam::platform {
namespace {

termios terminal_before;  // for a signal's handler
volatile std::sig_atomic_t terminal_changed = 0;

// In the background a read or a change of the terminal would stop the program.
bool in_foreground() {
  return ::tcgetpgrp(STDIN_FILENO) == ::getpgrp();
}

}  // namespace

Keys::Keys() {
  if (::isatty(STDIN_FILENO) == 0) return;
  open_ = in_foreground();
  if (!open_ || ::tcgetattr(STDIN_FILENO, &terminal_before) != 0) return;
  termios single = terminal_before;
  single.c_lflag &= ~static_cast<tcflag_t>(ICANON | ECHO);  // Ctrl-C stays
  single.c_cc[VMIN] = 1;
  single.c_cc[VTIME] = 0;
  terminal_changed = 1;
  terminal_ = ::tcsetattr(STDIN_FILENO, TCSANOW, &single) == 0;
}

Keys::~Keys() {
  restore_terminal();
}

char Keys::next() {
  if (!open_ || (terminal_ && !in_foreground())) return 0;
  pollfd input = {STDIN_FILENO, POLLIN, 0};
  if (::poll(&input, 1, 0) < 1) return 0;
  char key = 0;
  const ssize_t got = ::read(STDIN_FILENO, &key, 1);
  if (got == 0) open_ = false;
  return got == 1 ? key : '\0';
}

void restore_terminal() noexcept {
  if (terminal_changed == 0) return;
  terminal_changed = 0;
  if (!in_foreground()) return;  // who is there has set it as it is to be
  ::tcsetattr(STDIN_FILENO, TCSANOW, &terminal_before);
}

}  // namespace pptam::platform
