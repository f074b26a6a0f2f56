// Collects the times of a run, then prints them, the ratios of OpenCV's times to ours, and whether the targets are met.
#pragma once

#include <benchmark/benchmark.h>

#include <map>
#include <string>
#include <vector>

namespace pptam::bench {

class RatioReport final : public benchmark::BenchmarkReporter {
 public:
  bool ReportContext(const Context& context) override;
  void ReportRuns(const std::vector<Run>& runs) override;

  // Prints everything; true if all targets are met.
  bool print() const;

 private:
  // Microseconds; zero for a benchmark that has not run.
  double median(const std::string& name) const;
  double fastest(const std::string& name) const;

  std::map<std::string, std::vector<double>> times_;  // CPU time of each repetition
  bool failed_ = false;
};

}  // namespace pptam::bench
