#include "platform/run/summary.h"

#include <utility>

#include "platform/run/names.h"
#include "platform/text.h"

namespace pptam::platform {
namespace {

std::string limits_of(const RunLog& log) {
  uint32_t bits = 0;
  for (const FrameLog& frame : log.frames) bits |= frame.limits_hit;
  return limit_names(bits);
}

}  // namespace

std::vector<SummaryRow> summarise(const Evaluation& e) {
  std::vector<SummaryRow> rows;
  rows.push_back({"trajectory error", format("%.3g %% of the path: rms %.4g, median %.4g, largest %.4g",
                                             e.ate_percent(), e.ate_rmse, e.ate_median, e.ate_max)});
  rows.push_back({"path", format("%.4g, within a box of diagonal %.4g (units of the truth)", e.path_length, e.extent)});
  rows.push_back({"scale", format("%.5g", e.alignment.scale)});
  if (e.relative_pairs > 0) {
    rows.push_back({"error over 1 s", format("%.4g, %.3g degrees (rms of %d pairs)", e.relative_translation,
                                             e.relative_rotation_deg, e.relative_pairs)});
  }
  rows.push_back({"wrong poses", format("%d of %zu (%.1f %%)", e.wrong_poses, e.poses.size(), 100 * e.wrong_fraction)});
  return rows;
}

std::vector<SummaryRow> summarise(const RunLog& log, const RunSummary& summary) {
  std::vector<SummaryRow> rows;
  const CostSummary cost = cost_of(log);
  const FrameLog* first = log.first_tracked();
  rows.push_back({"sequence", format("%s, %d x %d at %.4g frames/s", log.camera.name.c_str(), log.camera.model.width,
                                     log.camera.model.height, log.camera.frames_per_s)});
  rows.push_back({"frames", format("%zu tracked, %d dropped, %.1f s", log.frames.size(), log.dropped,
                                   log.frames.empty() ? 0.0 : log.seconds(log.frames.back().timestamp_ns))});
  rows.push_back(
      {"initialised", first == nullptr ? "never" : format("after %.2f s", log.seconds(first->timestamp_ns))});
  if (first != nullptr) {
    rows.push_back({"tracked since then", format("%.1f %% of the frames", 100 * log.tracked_fraction())});
    rows.push_back({"reprojection error", format("%.2f px rms", log.reprojection_px())});
    rows.push_back({"map", format("%zu keyframes, %zu points", log.keyframes.size(), log.map_points.size()) +
                               (log.map_parts > 1 ? format(", fallen into %d parts", log.map_parts) : "")});
    rows.push_back(
        {"a tracked frame", format("%.1f ms, %.1f at worst (%s clock); %.2f million instructions (modelled)",
                                   cost.mean_ms, cost.worst_ms, name_of(log.clock), cost.mean_minstructions)});
  }
  rows.push_back({"memory", format("%.1f MB", 1e-6 * static_cast<double>(log.memory_bytes))});
  const std::string limits = limits_of(log);
  if (!limits.empty()) rows.push_back({"limits reached", limits});
  if (summary.evaluation) {
    for (SummaryRow& row : summarise(*summary.evaluation)) rows.push_back(std::move(row));
    if (summary.plane_known) {
      rows.push_back({"ground plane", format("%.2f degrees off", summary.evaluation->vertical_error_deg)});
    }
  } else if (!summary.evaluation_trouble.empty()) {
    rows.push_back({"evaluation", summary.evaluation_trouble});
  }
  rows.insert(rows.end(), summary.judgement.begin(), summary.judgement.end());
  rows.push_back({"map hash", format("%016llx", static_cast<unsigned long long>(log.map_hash))});
  if (!log.broken.empty()) rows.push_back({"stopped early", log.broken});
  return rows;
}

}  // namespace pptam::platform
