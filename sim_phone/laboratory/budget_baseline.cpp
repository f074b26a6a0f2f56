#include "sim_phone/laboratory/budget_baseline.h"

#include <algorithm>
#include <charconv>
#include <span>
#include <string_view>

#include "platform/input_error.h"
#include "platform/outputs.h"
#include "platform/run/console.h"
#include "platform/run/names.h"
#include "platform/text.h"

namespace pptam::laboratory {
namespace {

using namespace platform;

constexpr std::string_view kBaselineHead = "# pocket-ptam budget 1";
constexpr std::string_view kPhoneHead = "# phone ";

std::string camera_text(const sim::PhoneOptions& phone) {
  const char* axis = phone.readout_axis == RollingShutter::Axis::kRows ? "rows" : "columns";
  return format("%dx%d, %.6g degrees, %.6g frames/s, readout by %s %+.6g s, exposure %.6g s", phone.width, phone.height,
                phone.horizontal_fov_degrees, phone.frames_per_s, axis, phone.readout_s, phone.exposure_s);
}

// What two budgets must have in common to be compared: the first story's camera, and where another one differs its own.
std::string circumstances(const BudgetOptions& options) {
  const std::string camera = camera_text(phone_of(options, options.stories.at(0)));
  std::vector<std::string> stories;
  stories.reserve(options.stories.size());
  for (const std::string& story : options.stories) {
    const std::string own = camera_text(phone_of(options, story));
    stories.push_back(story);
    if (own != camera) stories.back().append(" (").append(own).append(")");
  }
  return "# " + camera + format(", seed %llu: ", static_cast<unsigned long long>(options.seed)) + joined(stories);
}

struct Figure {
  std::string what;
  double mean_ms;
};

// Stages by their mean over the frames that have them.
std::vector<Figure> figures_of(const BudgetReport& report) {
  std::vector<Figure> figures;
  figures.reserve(kStages + 1);
  for (int s = 0; s < kStages; ++s) figures.push_back({name_of(static_cast<Stage>(s)), 1e-6 * report.stages[s].mean});
  figures.push_back({"tracking", 1e-6 * report.tracking.mean});
  return figures;
}

std::vector<std::string_view> lines_of(std::string_view text) {
  std::vector<std::string_view> lines;
  while (!text.empty()) {
    const size_t end = text.find('\n');
    std::string_view line = text.substr(0, end);
    if (line.ends_with('\r')) line.remove_suffix(1);
    lines.push_back(line);
    text.remove_prefix(end == std::string_view::npos ? text.size() : end + 1);
  }
  return lines;
}

// The seal is that of the text as written: an editor's or a version control's ends of lines are no change.
bool is_unchanged(const std::string& text) {
  std::string plain;
  plain.reserve(text.size());
  for (size_t i = 0; i < text.size(); ++i)
    if (text[i] != '\r' || i + 1 == text.size() || text[i + 1] != '\n') plain += text[i];
  return is_sealed(std::as_bytes(std::span(plain)));
}

}  // namespace

std::string baseline_text(const BudgetOptions& options, const BudgetReport& report) {
  std::string text = std::string(kBaselineHead) + ", " + std::string(kOpenSeal) + "\n" + circumstances(options) + "\n" +
                     std::string(kPhoneHead) + printable(options.phone.name) + "\nstage,mean_ms\n";
  for (const Figure& figure : figures_of(report)) text += figure.what + format(",%.6f\n", figure.mean_ms);
  return sealed(std::move(text));
}

bool is_baseline(std::span<const std::byte> content) {
  const std::string_view text(reinterpret_cast<const char*>(content.data()), content.size());
  return text.starts_with(kBaselineHead) && is_sealed(content);
}

Baseline read_baseline(const std::string& text, const std::string& name, const BudgetOptions& options) {
  const auto refuse = [&](const std::string& why) -> InputError {
    return InputError("--compare " + name + ": " + why);
  };
  const std::vector<std::string_view> lines = lines_of(text);
  if (lines.size() < 3 || !lines[0].starts_with(kBaselineHead))
    throw refuse("is not a baseline that --save has written");
  if (!text.ends_with('\n')) throw refuse("its last line is cut off: save it again");
  if (lines[1] != circumstances(options))
    throw refuse("was made of something else: there '" + std::string(lines[1].substr(0, 200)) + "', here '" +
                 circumstances(options) + "'");
  if (!lines[2].starts_with(kPhoneHead)) throw refuse("does not name its phone");
  Baseline baseline;
  baseline.phone = lines[2].substr(kPhoneHead.size());
  for (const std::string_view line : lines) {
    const size_t comma = line.find(',');
    if (line.starts_with('#') || line.starts_with("stage,") || comma == std::string_view::npos) continue;
    double value = 0;
    const std::string_view number = line.substr(comma + 1);
    const auto [end, error] = std::from_chars(number.data(), number.data() + number.size(), value);
    if (error != std::errc() || end != number.data() + number.size() || !(value >= 0 && value < 1e9))
      throw refuse("'" + std::string(line.substr(0, 80)) + "' holds no time");
    if (!baseline.mean_ms.emplace(line.substr(0, comma), value).second)
      throw refuse("has two lines for " + std::string(line.substr(0, std::min<size_t>(comma, 80))));
  }
  for (const Figure& figure : figures_of({}))
    if (!baseline.mean_ms.contains(figure.what)) throw refuse("has no line for " + figure.what);
  if (!is_unchanged(text)) throw refuse("was changed since --save has written it: save it again");
  return baseline;
}

BudgetComparison compare(const Baseline& before, const BudgetReport& report) {
  const double frame_ms = before.mean_ms.at("tracking");
  BudgetComparison comparison;
  comparison.phone = before.phone;
  for (const Figure& figure : figures_of(report)) {
    BudgetChange change = {figure.what, before.mean_ms.at(figure.what), figure.mean_ms, false};
    const double grown_ms = change.now_ms - change.before_ms;
    const bool whole = figure.what == "tracking";
    change.dearer = (!whole && grown_ms > kStageTolerance * change.before_ms) || grown_ms > kFrameTolerance * frame_ms;
    if (change.dearer) {
      comparison.dearer.push_back(format("%s takes %.3f ms in place of %.3f: %+.1f %%, %+.1f %% of a frame",
                                         change.what.c_str(), change.now_ms, change.before_ms,
                                         change.before_ms > 0 ? 100 * grown_ms / change.before_ms : 0.0,
                                         frame_ms > 0 ? 100 * grown_ms / frame_ms : 0.0));
    }
    comparison.changes.push_back(change);
  }
  return comparison;
}

void print_comparison(const BudgetComparison& comparison) {
  print_line("compared with a baseline of phone " + comparison.phone);
  std::vector<std::vector<std::string>> rows;
  rows.reserve(comparison.changes.size());
  for (const BudgetChange& change : comparison.changes) {
    rows.push_back({change.what, format("%.3f", change.before_ms), format("%.3f", change.now_ms),
                    change.before_ms > 0 ? format("%+.1f", 100 * (change.now_ms / change.before_ms - 1)) : "-",
                    change.dearer ? "dearer" : ""});
  }
  print_table({"stage, mean ms", "before", "now", "%", ""}, rows);
  if (comparison.dearer.empty()) {
    print_line(format("no stage has become dearer by more than %g %% of itself or %g %% of a frame",
                      100 * kStageTolerance, 100 * kFrameTolerance));
  }
  for (const std::string& line : comparison.dearer) print_line("dearer: " + line);
}

}  // namespace pptam::laboratory
