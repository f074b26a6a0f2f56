// pocket-ptam: tracks and maps a recorded, an emulated or a live sequence, and judges the result. Here the command is
// chosen.

#include <fcntl.h>
#include <poll.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <exception>
#include <new>
#include <sstream>
#include <string>
#include <vector>

#include "platform/app/commands.h"
#include "platform/input_error.h"
#include "platform/run/console.h"
#include "platform/run/interruption.h"
#include "platform/text.h"

namespace {

using namespace pptam::app;
using pptam::platform::InputError;
using pptam::platform::print_error;
using pptam::platform::shell_word;

std::string command_of(int argc, char** argv) {
  std::string command = "pocket-ptam";
  for (int i = 1; i < argc; ++i) command += " " + shell_word(argv[i]);
  return command;
}

int run_program(int argc, char** argv) {
  CLI::App app("Pocket PTAM: camera tracking and mapping for one small core.", "pocket-ptam");
  app.require_subcommand(0, 1);
  app.set_version_flag("--version", std::string("pocket-ptam ") + PPTAM_VERSION);
  app.footer(
      "Examples:\n"
      "  pocket-ptam sim                                  a desk seen by the emulated phone\n"
      "  pocket-ptam budget --phone pi_zero               does it fit? Times, stage by stage\n"
      "  pocket-ptam replay clip.mp4 --fov 50             a video, with a guessed field of view\n"
      "  pocket-ptam cameras                              what can be used live\n"
      "  pocket-ptam live --fov 60                        the first camera; poses on standard output\n"
      "  pocket-ptam calibrate views/                     a camera, from views of a checkerboard\n"
      "  pocket-ptam eval trajectory.txt groundtruth.txt  compare two trajectories\n"
      "  pocket-ptam map info desk.map                    what is in a saved map\n"
      "  pocket-ptam model box.cao clip.mp4 --fov 50 --initial-pose box.pos    a known object, by its edges\n"
      "Each command has its own --help.\n"
      "Exit codes: 0 done; 1 broke midway, a signal ended it or an output could not be written: what came before is\n"
      "written; 2 bad input: nothing was done. The first Ctrl-C (SIGINT, SIGTERM, SIGHUP) ends a run like a recording\n"
      "that breaks off, the second ends the program at once.");
  const std::string command_line = command_of(argc, argv);
  const std::vector<Command> commands = {
      add_sim(app, command_line),       add_budget(app),  add_replay(app, command_line),
      add_live(app, command_line),      add_cameras(app), add_readout(app, command_line),
      add_calibrate(app, command_line), add_eval(app),    add_map(app),
      add_model(app, command_line)};

  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    if (error.get_exit_code() == 0) {  // --help and --version
      std::ostringstream says;
      app.exit(error, says, says);
      std::fputs(says.str().c_str(), stdout);
      return kExitOk;
    }
    std::string with_command = "pocket-ptam";
    for (const CLI::App* used = &app; !used->get_subcommands().empty();) {
      used = used->get_subcommands().front();
      with_command += " " + used->get_name();
    }
    throw InputError(std::string(error.what()) + "; see " + with_command + " --help");
  }
  for (const Command& command : commands) {
    if (command.options->parsed()) return command.run();
  }
  throw InputError(
      "no command given: sim, budget, replay, live, cameras, readout, calibrate, eval, map or model; see pocket-ptam "
      "--help");
}

int exit_code_of(int argc, char** argv) {
  try {
    return run_program(argc, argv);
  } catch (const InputError& error) {
    print_error(error.what());
    return kExitBadInput;
  } catch (const std::bad_alloc&) {  // of inputs that are too large; a run that has begun handles its own
    print_error("not enough memory for this input");
    return kExitBadInput;
  } catch (const std::exception& error) {
    print_error(error.what());
    return kExitBroken;
  }
}

// A closed standard stream would give its number to the next file that is opened, and what is printed would go there.
void occupy_standard_streams() {
  for (const int fd : {STDIN_FILENO, STDOUT_FILENO, STDERR_FILENO}) {
    // Of the three only stderr may be written to in vain: results that go nowhere are to fail.
    if (::fcntl(fd, F_GETFD) < 0) ::open("/dev/null", fd == STDERR_FILENO ? O_WRONLY : O_RDONLY);
  }
}

// False, and told, when some of the results could not be printed.
bool all_printed() {
  errno = 0;
  const bool flushed = std::fflush(stdout) == 0;
  if (flushed && std::ferror(stdout) == 0) return true;
  pollfd reader = {STDOUT_FILENO, POLLOUT, 0};
  if (::poll(&reader, 1, 0) == 1 && (reader.revents & POLLERR) != 0) return false;  // has seen enough, such as head
  print_error(std::string("results could not be printed") +
              (errno != 0 ? std::string(": ") + std::strerror(errno) : ""));
  return false;
}

}  // namespace

int main(int argc, char** argv) {
  occupy_standard_streams();
  pptam::platform::handle_signals();
  const int code = exit_code_of(argc, argv);
  return all_printed() || code != kExitOk ? code : kExitBroken;
}
