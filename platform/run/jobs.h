// Independent pieces of work on several threads, with one progress line.
#pragma once

#include <cstddef>
#include <functional>
#include <string>

namespace pptam::platform {

// job(0) to job(count - 1) on so many threads; each returns what the progress line shall say when it is done.
void run_jobs(int threads, size_t count, const std::function<std::string(size_t)>& job);

}  // namespace pptam::platform
