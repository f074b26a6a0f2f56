// The program's commands, a file each. A command adds its options to the program's and is run when it was named.
#pragma once

#include <CLI/CLI.hpp>
#include <functional>
#include <string>

namespace pptam::app {

// Exit codes; a bad input is an InputError, and nothing was done then.
constexpr int kExitOk = 0;
constexpr int kExitBroken = 1;  // the source or an output broke midway, or a criterion is not met
constexpr int kExitBadInput = 2;

struct Command {
  CLI::App* options;         // parsed() when it was named; owned by the program's
  std::function<int()> run;  // after parsing; the exit code
};

// command_line: how to repeat the run, for reports.
Command add_budget(CLI::App& program);
Command add_sim(CLI::App& program, const std::string& command_line);
Command add_replay(CLI::App& program, const std::string& command_line);
Command add_live(CLI::App& program, const std::string& command_line);
Command add_cameras(CLI::App& program);
Command add_readout(CLI::App& program, const std::string& command_line);
Command add_calibrate(CLI::App& program, const std::string& command_line);
Command add_eval(CLI::App& program);
Command add_map(CLI::App& program);
Command add_model(CLI::App& program, const std::string& command_line);

}  // namespace pptam::app
