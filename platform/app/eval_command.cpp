// pocket-ptam eval: an estimated trajectory against the truth.

#include <memory>
#include <utility>

#include "platform/app/commands.h"
#include "platform/files.h"
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

int compare(const Files& files) {
  const Trajectory estimate = read_tum_trajectory(files.estimate);
  const Trajectory truth = read_tum_trajectory(files.truth);
  const Evaluation evaluation = evaluate(estimate, truth, files.estimate, files.truth);
  std::vector<SummaryRow> rows = {
      {"poses", format("%zu of %d have a time in the truth, which they cover by %.1f %%", evaluation.poses.size(),
                       evaluation.estimate_poses, 100 * evaluation.covered_fraction)}};
  for (SummaryRow& row : summarise(evaluation)) rows.push_back(std::move(row));
  print_rows(rows);
  if (!files.plot.empty()) write_text(files.plot, plot_trajectories(evaluation, truth));
  return kExitOk;
}

}  // namespace

Command add_eval(CLI::App& program) {
  CLI::App* eval = program.add_subcommand("eval", "Compare an estimated trajectory with the truth");
  const auto files = std::make_shared<Files>();
  eval->add_option("estimate", files->estimate, "TUM trajectory")->required()->type_name("ESTIMATE");
  eval->add_option("truth", files->truth, "TUM trajectory")->required()->type_name("TRUTH");
  eval->add_option("--plot", files->plot, "Draw both")->type_name("FILE.svg");
  eval->footer("Example:\n  pocket-ptam eval out/desk-seed-1/trajectory.txt groundtruth.txt --plot both.svg");
  return {eval, [files] { return compare(*files); }};
}

}  // namespace pptam::app
