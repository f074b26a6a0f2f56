#include "platform/run/summary.h"

#include <algorithm>
#include <map>
#include <utility>

#include "platform/run/names.h"
#include "platform/text.h"

namespace pptam::platform {
namespace {

constexpr double kWorthNaming = 0.1;  // share of the frames with a hint. Not swept
constexpr double kLongLoss_s = 2;     // without a pose: the return to a known view takes a second. Not swept

std::string limits_of(const RunLog& log) {
  uint32_t bits = 0;
  for (const FrameLog& frame : log.frames) bits |= frame.limits_hit;
  return limit_names(bits);
}

// What the system asked for in those frames, the most frequent first: how often, and what the user can do.
void append_reasons(const std::vector<const FrameLog*>& frames, std::vector<SummaryRow>* rows) {
  std::map<Hint, size_t> counts;
  for (const FrameLog* frame : frames) ++counts[frame->hint];
  std::vector<std::pair<size_t, Hint>> order;
  for (const auto& [hint, count] : counts) {
    if (static_cast<double>(count) >= kWorthNaming * static_cast<double>(frames.size()) && *advice_for(hint) != '\0')
      order.emplace_back(count, hint);
  }
  std::stable_sort(order.begin(), order.end(), [](const auto& a, const auto& b) { return a.first > b.first; });
  for (const auto& [count, hint] : order) {
    rows->push_back(
        {"  why", format("in %.0f %% of %zu frames: ",
                         100 * static_cast<double>(count) / static_cast<double>(frames.size()), frames.size()) +
                      advice_for(hint)});
  }
}

// The frames of the longest stretch without a pose after the first one; empty when it was short. blurred: the share of
// blurred ones in the second before it.
std::vector<const FrameLog*> longest_loss(const RunLog& log, double* from_s, double* length_s, double* blurred) {
  size_t begin = 0, end = 0;
  bool tracked = false;
  for (size_t i = 0; i < log.frames.size(); ++i) {
    if (log.frames[i].pose_valid) {
      tracked = true;
      continue;
    }
    if (!tracked) continue;
    size_t last = i;
    while (last < log.frames.size() && !log.frames[last].pose_valid) ++last;
    if (last - i > end - begin) {
      begin = i;
      end = last;
    }
    i = last - 1;
  }
  if (end == begin) return {};
  *from_s = log.seconds(log.frames[begin].timestamp_ns);
  *length_s = log.seconds(log.frames[end - 1].timestamp_ns) - *from_s;
  if (*length_s < kLongLoss_s) return {};
  int before = 0, blurred_before = 0;
  for (size_t i = begin; i-- > 0 && log.seconds(log.frames[i].timestamp_ns) > *from_s - 1; ++before)
    blurred_before += log.frames[i].blurred ? 1 : 0;
  *blurred = before > 0 ? static_cast<double>(blurred_before) / before : 0;
  std::vector<const FrameLog*> frames;
  for (size_t i = begin; i < end; ++i) frames.push_back(&log.frames[i]);
  return frames;
}

// The longest stretch of frames that do not fit the map; empty when it was short.
std::string longest_misfit(const RunLog& log) {
  constexpr double kWorthTelling_s = 0.25;  // a single quick turn is shorter
  double from_s = 0, longest_s = 0;
  const FrameLog* begin = nullptr;
  for (const FrameLog& frame : log.frames) {
    if (!frame.misfit) {
      begin = nullptr;
      continue;
    }
    if (begin == nullptr) begin = &frame;
    const double length_s = log.seconds(frame.timestamp_ns) - log.seconds(begin->timestamp_ns);
    if (length_s <= longest_s) continue;
    longest_s = length_s;
    from_s = log.seconds(begin->timestamp_ns);
  }
  if (longest_s < kWorthTelling_s) return "";
  return format(
      "from %.1f s on, for %.1f s, the points agree far worse than usual: a zoom, a stabiliser's jump, frames "
      "out of order? The map took nothing from such frames unless few points were left",
      from_s, longest_s);
}

// Where the time went, and what was too slow.
void append_processor(const RunLog& log, std::vector<SummaryRow>* rows) {
  ProcessorTime time;
  time.add(log);
  if (time.all_ns() == 0) return;
  const auto percent = [&](int64_t ns) { return 100 * time.share(ns); };
  std::string text = format("tracking %.1f %% of the time", percent(time.tracking_ns));
  if (time.capture_display_ns > 0) text += format(", capture and display %.1f %%", percent(time.capture_display_ns));
  rows->push_back(
      {"processor", text + format(", mapping %.1f %%, idle %.1f %%; longest slice %.2f ms", percent(time.mapping_ns),
                                  percent(time.idle_ns), 1e-6 * static_cast<double>(time.longest_slice_ns))});
  if (time.late > 0) rows->push_back({"late", format("%d results came after the next frame", time.late)});
  if (time.work_left > 0 && time.share(time.mapping_ns + time.idle_ns) < kLeastForMapping) {
    rows->push_back({"  why", format("mapping starves: tracking leaves it %.1f %% of the time, and it was not done at "
                                     "%.0f %% of the frames: smaller images (--resize WxH) or fewer of them",
                                     percent(time.mapping_ns + time.idle_ns), 100 * time.work_left_share())});
  }
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
  if (log.dropped >= kWorthNaming * log.source_frames && log.dropped > 0) {
    rows.push_back({"  why",
                    "dropped because tracking took longer than the time between two frames: smaller images "
                    "(--resize WxH), or --no-drop to take the time"});
  }
  rows.push_back(
      {"initialised", first == nullptr ? "never" : format("after %.2f s", log.seconds(first->timestamp_ns))});
  if (first == nullptr) {
    std::vector<const FrameLog*> all;
    for (const FrameLog& frame : log.frames) all.push_back(&frame);
    append_reasons(all, &rows);
  } else {
    rows.push_back({"tracked since then", format("%.1f %% of the frames", 100 * log.tracked_fraction())});
    double from_s = 0, length_s = 0, blurred = 0;
    const std::vector<const FrameLog*> lost = longest_loss(log, &from_s, &length_s, &blurred);
    if (!lost.empty()) {
      rows.push_back({"longest loss", format("%.1f s, from %.1f s on", length_s, from_s)});
      if (blurred >= kWorthNaming)
        rows.push_back(
            {"  why", format("in %.0f %% of the second before it: ", 100 * blurred) + advice_for(Hint::kTooFast)});
      append_reasons(lost, &rows);
    }
    rows.push_back({"reprojection error", format("%.2f px rms", log.reprojection_px())});
    const std::string misfit = longest_misfit(log);
    if (!misfit.empty()) rows.push_back({"misfit", misfit});
    rows.push_back({"map", format("%zu keyframes, %zu points", log.keyframes.size(), log.map_points.size()) +
                               (log.map_parts > 1 ? format(", fallen into %d parts", log.map_parts) : "")});
    const std::vector<int> maps = log.maps();
    if (maps.size() > 1) {
      std::string poses;
      for (const int map : maps)
        poses += format("%s%zu in map %d", poses.empty() ? "" : ", ", log.trajectory_in(map).size(), map);
      rows.push_back(
          {"maps", poses + ": each has a world of its own. Path, points and errors are of the one with the most"});
    }
    rows.push_back(
        {"a tracked frame", format("%.1f ms, %.1f at worst (%s clock); %.2f million instructions (modelled)",
                                   cost.mean_ms, cost.worst_ms, name_of(log.clock), cost.mean_minstructions)});
    std::string stages;
    for (int s = 0; s < kStages; ++s)
      stages += format("%s%s %.2f", stages.empty() ? "" : ", ", name_of(static_cast<Stage>(s)), cost.stage_ms[s]);
    rows.push_back({"  of it", stages + " ms"});
  }
  append_processor(log, &rows);
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
  for (const std::string& warning : summary.warnings) rows.push_back({"warning", warning});
  return rows;
}

}  // namespace pptam::platform
