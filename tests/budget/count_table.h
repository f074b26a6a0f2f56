// Counted work beside its budget and beside the counts that a file keeps.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <map>
#include <string>
#include <vector>

#include "tests/budget/instruction_counter.h"

namespace pptam::test {

// Only there are instructions the phone's.
#if defined(__ARM_ARCH) && __ARM_ARCH == 6
constexpr bool kPhone = true;
#else
constexpr bool kPhone = false;
#endif

class Table {
 public:
  explicit Table(const std::string& title) : title_(title) {}
  // budget: most instructions allowed.
  void add(const std::string& name, const Counts& counts, double budget) { rows_.push_back({name, counts, budget}); }

  void print() const {
    std::printf("\n%-44s %12s %12s %12s %9s\n", title_.c_str(), "instructions", "cycles, est.", "budget", "head-room");
    for (const Row& row : rows_) {
      char cycles[24] = "-";  // stages are read from a clock that tells instructions only
      if (row.counts.cycles > 0) std::snprintf(cycles, sizeof cycles, "%.0f", row.counts.cycles);
      std::printf("%-44s %12lld %12s %12.0f %8.0f%%\n", row.name.c_str(),
                  static_cast<long long>(row.counts.instructions), cycles, row.budget,
                  100 * (row.budget / static_cast<double>(row.counts.instructions) - 1));
    }
    std::printf("\n");
  }

  // One compiler gives one count; 1 % is for another version of it or of the C library.
  static bool unchanged(long long count, long long kept) { return 100 * std::llabs(count - kept) <= kept; }

  void check(const std::string& file) const {
    for (const Row& row : rows_)
      EXPECT_LE(static_cast<double>(row.counts.instructions), row.budget) << row.name << " is over its budget";
    if (std::getenv("PPTAM_UPDATE_COUNTS") != nullptr) {
      std::ofstream out(file);
      for (const Row& row : rows_) out << row.counts.instructions << " " << row.name << "\n";
      ASSERT_TRUE(out.good()) << file << " cannot be written";
      return;
    }
    std::map<std::string, long long> golden;
    std::ifstream in(file);
    ASSERT_TRUE(in.good()) << file << " cannot be read";
    long long count = 0;
    std::string name;
    while (in >> count && std::getline(in >> std::ws, name)) golden[name] = count;
    for (const Row& row : rows_) {
      ASSERT_TRUE(golden.contains(row.name)) << "no count of '" << row.name << "' is kept; PPTAM_UPDATE_COUNTS=1";
      EXPECT_TRUE(unchanged(row.counts.instructions, golden[row.name]))
          << row.name << ": " << golden[row.name] << " has become " << row.counts.instructions
          << "; if that is meant, run with PPTAM_UPDATE_COUNTS=1 and say so in the commit";
    }
    EXPECT_EQ(golden.size(), rows_.size()) << file << " has rows that are no longer counted";
  }

 private:
  struct Row {
    std::string name;
    Counts counts;
    double budget;
  };
  std::string title_;
  std::vector<Row> rows_;
};

template <class Work>
Counts count(Work work) {
  const Region region;
  work();
  return region.spent();
}

inline Counts median(std::vector<Counts> counts) {
  const auto middle = counts.begin() + static_cast<ptrdiff_t>(counts.size() / 2);
  std::nth_element(counts.begin(), middle, counts.end(),
                   [](const Counts& a, const Counts& b) { return a.instructions < b.instructions; });
  return *middle;
}
inline Counts worst(const std::vector<Counts>& counts) {
  return *std::max_element(counts.begin(), counts.end(),
                           [](const Counts& a, const Counts& b) { return a.instructions < b.instructions; });
}

}  // namespace pptam::test
