// pocket-ptam: tracks and maps a recorded or an emulated sequence, and judges the result. Here the command is chosen.

#include <CLI/CLI.hpp>
#include <exception>
#include <string>
#include <vector>

#include "platform/app/commands.h"
#include "platform/input_error.h"
#include "platform/run/console.h"

namespace {

using namespace pptam::app;
using pptam::platform::InputError;
using pptam::platform::print_error;

std::string quoted(const std::string& word) {
  constexpr const char* kPlain = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-+./:=,%";
  if (!word.empty() && word.find_first_not_of(kPlain) == std::string::npos) return word;
  std::string text = "'";
  for (const char c : word) text += c == '\'' ? std::string("'\\''") : std::string(1, c);
  return text + "'";
}

std::string command_of(int argc, char** argv) {
  std::string command = "pocket-ptam";
  for (int i = 1; i < argc; ++i) command += " " + quoted(argv[i]);
  return command;
}

int run_program(int argc, char** argv) {
  CLI::App app("Pocket PTAM: camera tracking and mapping for one small core.", "pocket-ptam");
  app.require_subcommand(0, 1);
  app.set_version_flag("--version", std::string("pocket-ptam ") + PPTAM_VERSION);
  app.footer(
      "Examples:\n"
      "  pocket-ptam sim                                  a desk seen by the emulated phone\n"
      "  pocket-ptam replay clip.mp4 --fov 50             a video, with a guessed field of view\n"
      "  pocket-ptam eval trajectory.txt groundtruth.txt  compare two trajectories\n"
      "  pocket-ptam map info desk.map                    what is in a saved map\n"
      "Each command has its own --help. Exit codes: 0 done, 1 broke midway, 2 bad input.");
  const std::string command_line = command_of(argc, argv);
  const std::vector<Command> commands = {add_sim(app, command_line), add_replay(app, command_line), add_readout(app),
                                         add_eval(app), add_map(app)};

  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    if (error.get_exit_code() == 0) return app.exit(error);  // --help and --version
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
  throw InputError("no command given: sim, replay, readout, eval or map; see pocket-ptam --help");
}

}  // namespace

int main(int argc, char** argv) {
  try {
    return run_program(argc, argv);
  } catch (const InputError& error) {
    print_error(error.what());
    return kExitBadInput;
  } catch (const std::exception& error) {
    print_error(error.what());
    return kExitBroken;
  }
}
