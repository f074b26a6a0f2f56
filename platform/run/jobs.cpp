#include "platform/run/jobs.h"

#include <atomic>
#include <mutex>
#include <thread>
#include <vector>

#include "platform/run/console.h"

namespace pptam::platform {

void run_jobs(int threads, size_t count, const std::function<std::string(size_t)>& job) {
  std::atomic<size_t> next = 0;
  std::mutex mutex;
  Progress progress;
  size_t done = 0;
  const auto worker = [&] {
    for (;;) {
      const size_t i = next++;
      if (i >= count) return;
      const std::string text = job(i);
      const std::lock_guard lock(mutex);
      progress.show(static_cast<int>(++done), static_cast<int>(count), text);
    }
  };
  std::vector<std::thread> workers;
  workers.reserve(static_cast<size_t>(threads));
  for (int i = 0; i < threads; ++i) workers.emplace_back(worker);
  for (std::thread& thread : workers) thread.join();
  progress.finish();
}

}  // namespace pptam::platform
