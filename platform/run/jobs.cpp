#include "platform/run/jobs.h"

#include <atomic>
#include <exception>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

#include "platform/run/console.h"
#include "platform/run/interruption.h"

namespace pptam::platform {

std::vector<bool> run_jobs(int threads, size_t count, const std::function<std::string(size_t)>& job) {
  std::atomic<size_t> next = 0;
  std::mutex mutex;
  Progress progress;
  size_t count_done = 0;
  std::vector<bool> done(count);
  std::exception_ptr trouble;  // the first
  const auto worker = [&] {
    while (!interrupted()) {
      const size_t i = next++;
      if (i >= count) return;
      std::string text;
      try {
        text = job(i);
      } catch (...) {
        const std::lock_guard lock(mutex);
        if (!trouble) trouble = std::current_exception();
        next = count;  // the others finish what they do
        return;
      }
      if (interrupted()) return;  // it may have been cut short
      const std::lock_guard lock(mutex);
      done[i] = true;
      progress.show(static_cast<int>(++count_done), static_cast<int>(count), text);
    }
  };
  std::vector<std::thread> workers;
  workers.reserve(static_cast<size_t>(threads));
  try {
    for (int i = 0; i < threads; ++i) workers.emplace_back(worker);
  } catch (const std::system_error&) {  // no more threads: those that are there do it all, else this one
    if (workers.empty()) worker();
  }
  for (std::thread& thread : workers) thread.join();
  progress.finish();
  if (trouble) std::rethrow_exception(trouble);
  return done;
}

}  // namespace pptam::platform
