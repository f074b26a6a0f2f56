// Independent pieces of work on several threads, with one progress line.
#pragma once

#include <cstddef>
#include <functional>
#include <string>
#include <vector>

namespace pptam::platform {

// job(0) to job(count - 1) on so many threads; each returns what the progress line shall say when it is done. After a
// signal no further one is begun. Returns which were done: begun before it, and ended before it.
std::vector<bool> run_jobs(int threads, size_t count, const std::function<std::string(size_t)>& job);

}  // namespace pptam::platform
