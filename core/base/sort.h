// Sorting by a total order: all results are the same then, whatever the algorithm.
#pragma once

#include <utility>

namespace pptam {

// Sorts in place. `before` is a strict total order: of two entries it puts one first. Shell's algorithm with Ciura's
// gaps: fewer comparisons than std::sort() up to 100 entries, as many at 300, an eighth more at 1000; a tenth of the
// code.
template <class List, class Before>
void sort_list(List& list, const Before& before) {
  constexpr int kGaps[] = {1750, 701, 301, 132, 57, 23, 10, 4, 1};
  const auto begin = list.begin();
  const auto count = static_cast<int>(list.end() - begin);
  for (const int gap : kGaps) {
    for (int i = gap; i < count; ++i) {
      auto entry = std::move(begin[i]);
      int place = i;
      for (; place >= gap && before(entry, begin[place - gap]); place -= gap)
        begin[place] = std::move(begin[place - gap]);
      begin[place] = std::move(entry);
    }
  }
}

}  // namespace pptam
