// pocket-ptam eval: an estimated trajectory against the truth.

#include <memory>
#include <utility>

#include "platform/app/commands.h"
#include "platform/files.h"
#include "platform/input_error.h"
#include "platform/outputs.h"
#include "platform/run/console.h"
#include "platform/run/evaluation.h"
#include "platform/run/report.h"
#include "platform/run/summary.h"
#include "platform/text.h"
#include "platform/trajectory.h"

namespace pptam::app {
namespace {

using namespace platform;

struct Files {
  std::string estimate, truth, plot;
};

std::string compared_poses(const Evaluation& e) {
  if (e.at_truth_times) {
    return format(
        "%zu of %d of the truth compared, between those of the estimate; it covers %.1f %% of the truth's time",
        e.poses.size(), e.truth_poses, 100 * e.covered_fraction);
  }
  return format("%zu of %d have a time in the truth, which they cover by %.1f %%", e.poses.size(), e.estimate_poses,
                100 * e.covered_fraction);
}

int compare(const Files& files) {
  if (!files.plot.empty()) {
    Inputs inputs;
    inputs.add("the estimate", files.estimate);
    inputs.add("the truth", files.truth);
    check_output_file("--plot", files.plot, inputs, "a plot", is_sealed);
  }
  std::vector<std::string> warnings;
  const auto tell = [&] {
    for (const std::string& warning : warnings) print_warning(warning);
    warnings.clear();
  };
  const TrajectoryPair read = read_trajectories(files.estimate, files.truth, &warnings);
  tell();
  const Evaluation evaluation = evaluate(read.estimate, read.truth, files.estimate, files.truth);
  if (evaluation.poses.size() < kFewPoses) {
    warnings.push_back(
        format("%s: only %zu poses can be compared: an alignment fits so few too well, true errors are larger",
               files.truth.c_str(), evaluation.poses.size()));
  }
  tell();
  std::vector<SummaryRow> rows = {{"poses", compared_poses(evaluation)}};
  for (SummaryRow& row : summarise(evaluation)) rows.push_back(std::move(row));
  print_rows(rows);
  if (files.plot.empty()) return kExitOk;
  try {
    write_text_atomically(
        files.plot, sealed(plot_trajectories(evaluation, read.truth) + "<!-- " + std::string(kOpenSeal) + " -->\n"));
  } catch (const InputError& error) {
    print_error(error.what());
    return kExitBroken;
  }
  return kExitOk;
}

}  // namespace

Command add_eval(CLI::App& program) {
  CLI::App* eval = program.add_subcommand("eval", "Compare an estimated trajectory with the truth");
  const auto files = std::make_shared<Files>();
  eval->add_option("estimate", files->estimate, "TUM trajectory")->required()->type_name("ESTIMATE");
  eval->add_option("truth", files->truth, "TUM trajectory")->required()->type_name("TRUTH");
  eval->add_option("--plot", files->plot, "Draw both")->type_name("FILE.svg");
  eval->footer(
      "Files: timestamp tx ty tz qx qy qz qw (TUM), or EuRoC's data.csv with its header, both of the same camera.\n"
      "The estimate is aligned by a similarity. Poses are compared at the times of the sparser of the two; the\n"
      "other is interpolated between poses at most 0.15 s apart, else its nearest within 0.02 s is taken.\n"
      "The error is the rms of positions in percent of the true path; that over 1 s is the rms of what the motion\n"
      "within a second is off. A pose is wrong when it is off by a tenth of the extent or by 5 degrees.\n"
      "Example:\n  pocket-ptam eval out/desk-seed-1/trajectory.txt groundtruth.txt --plot both.svg");
  return {eval, [files] { return compare(*files); }};
}

}  // namespace pptam::app
