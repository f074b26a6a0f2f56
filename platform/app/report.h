// What a run amounts to, in words (terminal) and in pictures (report.html, one self-contained file; plots by gnuplot).
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "platform/app/evaluation.h"
#include "platform/app/judgement.h"
#include "platform/app/run.h"

namespace pptam::app {

struct SummaryRow {
  std::string label;
  std::string value;
};

struct RunSummary {
  std::optional<Evaluation> evaluation;
  std::optional<Judgement> judgement;  // of the emulated phone's run, with its story
  std::string evaluation_trouble;      // why there is no evaluation although there is ground truth
  bool plane_known = false;            // the truth's z = 0 is the scene's dominant plane
  std::string command;                 // how to repeat the run
  std::string version;
};

std::vector<SummaryRow> summarise(const RunLog& log, const RunSummary& summary);
std::vector<SummaryRow> summarise(const Evaluation& evaluation);
std::vector<SummaryRow> summarise(const Judgement& judgement);

std::string html_escaped(const std::string& text);
// The common head of our HTML pages, up to and including <body>.
std::string html_head(const std::string& title);

// A gnuplot script's picture in the house style, as SVG, and its HTML tag. Throws InputError without gnuplot.
std::string plot_svg(int width, int height, const std::string& script);
std::string svg_tag(const std::string& svg, const std::string& alt);

// Estimate and truth from above and from the side, after alignment, as SVG. Throws InputError without gnuplot.
std::string plot_trajectories(const Evaluation& evaluation, const platform::Trajectory& truth);

// Shows folder/overlay.png and links folder/overlay.mp4 when they are there. Without gnuplot the plots are missing, and
// warnings says so.
void write_report(const std::filesystem::path& folder, const RunLog& log, const RunSummary& summary,
                  const platform::Trajectory& truth, std::vector<std::string>* warnings);

}  // namespace pptam::app
