// pocket-ptam budget: does it fit a phone?

#include <exception>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "platform/app/commands.h"
#include "platform/app/options.h"
#include "platform/files.h"
#include "platform/input_error.h"
#include "platform/outputs.h"
#include "platform/run/console.h"
#include "platform/run/interruption.h"
#include "platform/text.h"
#include "platform/text_file.h"
#include "sim_phone/laboratory/budget.h"
#include "sim_phone/laboratory/budget_baseline.h"
#include "sim_phone/laboratory/phone_calibration.h"

namespace pptam::app {
namespace {

using namespace platform;

struct BudgetChoice {
  std::string phone = "iphone3g";
  laboratory::BudgetOptions budget;
  std::string save, compare;
  std::string calibrate;  // a profile to be written
  std::optional<double> clock_mhz;
};

bool save(const std::string& file, const Inputs& inputs, const std::string& baseline) {
  try {  // something may have come there meanwhile
    judge_output_file("--save", file, inputs, "an earlier baseline", laboratory::is_baseline);
    write_text_atomically(file, baseline);
  } catch (const std::exception& error) {
    print_error(error.what());
    return false;
  }
  print_line("baseline saved to " + file);
  return true;
}

// A start and a growing map, and one that is culled.
const std::vector<std::string> kCalibrationStories = {"desk_calm", "explore_return"};

int run_calibration(BudgetChoice* chosen, const Inputs& inputs) {
  laboratory::BudgetOptions& budget = chosen->budget;
  if (budget.stories.empty()) budget.stories = kCalibrationStories;
  laboratory::check_budget(budget);
  constexpr const char* kKind = "a profile of an earlier calibration";
  check_output_file("--calibrate", chosen->calibrate, inputs, kKind, laboratory::is_profile);
  stop_on_signals();
  const laboratory::Calibration calibration =
      laboratory::calibrate(budget, chosen->clock_mhz.value_or(laboratory::clock_rate_mhz()));
  judge_output_file("--calibrate", chosen->calibrate, inputs, kKind,
                    laboratory::is_profile);  // may have come meanwhile
  write_text_atomically(chosen->calibrate, laboratory::profile_text(budget.phone, calibration));
  laboratory::print_calibration(calibration);
  print_line("");
  print_line(format("%.4g cycles an ARMv6 instruction at %.4g MHz; profile written to ",
                    static_cast<double>(calibration.processor.cycles_per_instruction),
                    static_cast<double>(calibration.processor.clock_mhz)) +
             chosen->calibrate);
  return kExitOk;
}

int run_budget(BudgetChoice* chosen) {
  laboratory::BudgetOptions& budget = chosen->budget;
  budget.phone = laboratory::load_phone(chosen->phone);
  Inputs inputs;
  for (const std::string& name : laboratory::phone_names())
    if (name == chosen->phone) chosen->phone.clear();
  inputs.add("the phone's profile", chosen->phone);
  if (!chosen->calibrate.empty()) return run_calibration(chosen, inputs);
  if (budget.stories.empty()) budget.stories = laboratory::budget_stories();
  inputs.add("the baseline of --compare", chosen->compare);
  laboratory::check_budget(budget);
  laboratory::Baseline before;
  if (!chosen->compare.empty()) {
    const std::string text = read_text(chosen->compare, laboratory::kMaxBaselineBytes);
    before = laboratory::read_baseline(text, chosen->compare, budget);
  }
  if (!chosen->save.empty())
    check_output_file("--save", chosen->save, inputs, "an earlier baseline", laboratory::is_baseline);
  stop_on_signals();
  const laboratory::BudgetReport report = laboratory::measure_budget(budget);
  // Nothing of it holds for stories that were cut short.
  for (const std::string& broken : report.broken) print_error(broken);
  if (!report.broken.empty()) return kExitBroken;
  laboratory::print_budget(budget, report);
  bool good = report.faults.empty();
  if (!chosen->compare.empty()) {
    const laboratory::BudgetComparison comparison = laboratory::compare(before, report);
    print_line("");
    laboratory::print_comparison(comparison);
    good = good && comparison.dearer.empty();
  }
  if (!chosen->save.empty()) good = save(chosen->save, inputs, laboratory::baseline_text(budget, report)) && good;
  return good ? kExitOk : kExitBroken;
}

}  // namespace

Command add_budget(CLI::App& program) {
  CLI::App* command = program.add_subcommand("budget", "Does it fit a phone? Times by the work clock, a verdict");
  const auto chosen = std::make_shared<BudgetChoice>();
  command->add_option("--phone", chosen->phone, phone_option_says() + " [iphone3g]")->type_name("NAME|FILE");
  command
      ->add_option("--story", chosen->budget.stories,
                   "One of pocket-ptam sim --help's stories; may be repeated [the sixteen of calm and quick hands]")
      ->type_name("NAME")
      ->expected(1)
      ->multi_option_policy(CLI::MultiOptionPolicy::TakeAll);
  command->add_option("--seed", chosen->budget.seed, "Of the stories")->capture_default_str()->type_name("N");
  command->add_option("--jobs", chosen->budget.jobs, "Threads")
      ->capture_default_str()
      ->check(CLI::Range(1, 256))
      ->type_name("N");
  command
      ->add_option("--save", chosen->save, "Keep the stages' means as a baseline; only an earlier baseline is replaced")
      ->type_name("FILE");
  command
      ->add_option("--compare", chosen->compare,
                   format("Compare with a baseline of the same stories: a stage that has grown by more than %g %% of "
                          "itself, or by %g %% of a frame, is named, and the exit code is 1",
                          100 * laboratory::kStageTolerance, 100 * laboratory::kFrameTolerance))
      ->type_name("FILE");
  CLI::Option* calibrate =
      command
          ->add_option(
              "--calibrate", chosen->calibrate,
              "No verdict: write a profile of this computer's processor, from the times that stages and slices "
              "take here in --story [desk_calm, explore_return]; camera, capture and display are --phone's")
          ->type_name("FILE")
          ->excludes("--save")
          ->excludes("--compare");
  command
      ->add_option("--clock-mhz", chosen->clock_mhz, "Of --calibrate, this computer's [what the system says, or 1000]")
      ->check(CLI::Range(1.0, 1e5))
      ->type_name("MHZ")
      ->needs(calibrate);
  command->footer(
      "It fits when no frame is dropped, the worst one takes no longer than the time between two, with capture and\n"
      "display, and a tenth of the time is left to mapping. The same command gives the same figures on every "
      "computer.\n"
      "Exit codes: 0 it fits; 1 it does not, a stage has become dearer, it was interrupted, or --save failed; 2 bad\n"
      "input.\n"
      "Examples:\n"
      "  pocket-ptam budget --phone iphone3g                      all sixteen stories\n"
      "  pocket-ptam budget --phone pi_zero --story desk_calm --seed 3\n"
      "  pocket-ptam budget --phone myphone.yaml --jobs 2         a profile of one's own: sim_phone/README.md\n"
      "  pocket-ptam budget --calibrate board.yaml                on the board: its profile, for --phone board.yaml\n"
      "  pocket-ptam budget --save before.csv                     then change something, and\n"
      "  pocket-ptam budget --compare before.csv                  see which stage has become dearer\n"
      "  pocket-ptam sim --phone iphone3g --trace desk.json       one run's trace, for ui.perfetto.dev");
  return {command, [chosen] { return run_budget(chosen.get()); }};
}

}  // namespace pptam::app
