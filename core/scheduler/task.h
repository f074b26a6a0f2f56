// Background work as coroutines that run in slices of idle time, on one thread, without the heap.
//
// A job is a member coroutine of a class derived from Background. It says `co_await spend(kind, units)` wherever it may
// pause: its work is charged to the work meter, and it pauses once the slice's instructions are used up. Because the
// meter decides and not a timer, a job gives the same result however the idle time is divided. A job may `co_await`
// other jobs of the same class. Coroutine frames lie on a stack (FrameStack) in the arena.
//
//   Task<> Mapper::run() {
//     for (;;) {
//       if (!map_.ready()) good = co_await finish_initial_map();     // Task<bool>
//       ...
//       co_await spend(Work::kOther, 100);
//     }
//   }
#pragma once

#include <coroutine>
#include <cstddef>
#include <type_traits>
#include <utility>

#include <pocket_ptam/work_meter.h>
#include "base/containers.h"

namespace pptam {

// Memory for coroutine frames, last in first out.
class FrameStack {
 public:
  FrameStack() = default;
  FrameStack(Arena& arena, size_t bytes) : memory_(static_cast<std::byte*>(arena.allocate(bytes))), size_(bytes) {}
  void* push(size_t bytes);
  void pop(void* frame);

 private:
  std::byte* memory_ = nullptr;
  size_t size_ = 0;
  size_t used_ = 0;
};

// Longest slice, ARMv6 instructions: about 1 ms on the 412 MHz phone. A frame that arrives waits no longer. Not swept.
constexpr int64_t kSliceInstructions = 250'000;

class Background {
 public:
  Background(Arena& arena, size_t frame_bytes, WorkMeter& meter) : meter_(meter), frames_(arena, frame_bytes) {}
  Background(const Background&) = delete;
  Background& operator=(const Background&) = delete;

  FrameStack& frames() { return frames_; }

  // Runs the paused job, if any, for one slice.
  void resume() {
    slice_start_ = meter_.instructions();
    const std::coroutine_handle<> paused = std::exchange(paused_, nullptr);
    if (paused) paused.resume();
  }

  struct Slice {
    Background& self;
    bool always;
    bool await_ready() const { return !always && self.meter_.instructions() - self.slice_start_ < kMaxSlice; }
    void await_suspend(std::coroutine_handle<> handle) const { self.paused_ = handle; }
    void await_resume() const {}
  };
  // Pauses if this slice is used up.
  Slice slice() { return {*this, false}; }
  // Charges what was just done, and pauses if this slice is used up.
  Slice spend(Work kind, int64_t units) {
    meter_.charge(kind, units);
    return slice();
  }
  // Pauses in any case, for a job that has nothing to do now.
  Slice rest() { return {*this, true}; }

 protected:
  // Forgets the paused job; its Task must be destroyed or replaced.
  void abandon() { paused_ = nullptr; }

  WorkMeter& meter_;

 private:
  // Instructions after which the next slice() pauses. The other half of kSliceInstructions is for what runs between two
  // slice() calls: the longest is a map's change of coordinates, 0.06 million instructions (tests/budget).
  static constexpr int64_t kMaxSlice = kSliceInstructions / 2;
  FrameStack frames_;
  std::coroutine_handle<> paused_ = nullptr;
  int64_t slice_start_ = 0;
};

template <class T = void>
class Task;

namespace detail {

// Base of all tasks' promises: takes frames from the job's FrameStack and resumes the awaiting job at the end.
struct PromiseBase {
  std::coroutine_handle<> parent = nullptr;  // the job that awaits this one

  // The first argument of a member coroutine is its object, which has frames(). A header before the frame tells
  // operator delete which FrameStack it came from.
  template <class Self, class... Args>
  static void* operator new(size_t bytes, Self& self, Args&&...) {
    const size_t header = Arena::kAlignment;
    auto* memory = static_cast<std::byte*>(self.frames().push(bytes + header));
    *reinterpret_cast<FrameStack**>(memory) = &self.frames();
    return memory + header;
  }
  static void operator delete(void* frame, size_t) {
    std::byte* memory = static_cast<std::byte*>(frame) - Arena::kAlignment;
    (*reinterpret_cast<FrameStack**>(memory))->pop(memory);
  }

  std::suspend_always initial_suspend() noexcept { return {}; }
  struct Final {
    bool await_ready() noexcept { return false; }
    template <class Promise>
    std::coroutine_handle<> await_suspend(std::coroutine_handle<Promise> handle) noexcept {
      return handle.promise().parent ? handle.promise().parent : std::noop_coroutine();
    }
    void await_resume() noexcept {}
  };
  Final final_suspend() noexcept { return {}; }
  void unhandled_exception() { __builtin_trap(); }
};

template <class T>
struct Promise : PromiseBase {
  T value = T();
  Task<T> get_return_object();
  void return_value(const T& result) { value = result; }
};
template <>
struct Promise<void> : PromiseBase {
  Task<void> get_return_object();
  void return_void() {}
};

}  // namespace detail

// A job, or a part of one. T: type of the value it returns; returned by copy.
template <class T>
class [[nodiscard]] Task {
 public:
  using promise_type = detail::Promise<T>;

  Task() = default;
  explicit Task(std::coroutine_handle<promise_type> handle) : handle_(handle) {}
  Task(Task&& other) noexcept : handle_(std::exchange(other.handle_, nullptr)) {}
  Task& operator=(Task&& other) noexcept {
    if (this != &other) {
      destroy();
      handle_ = std::exchange(other.handle_, nullptr);
    }
    return *this;
  }
  ~Task() { destroy(); }

  // Runs until the first pause.
  void start() { handle_.resume(); }

  bool await_ready() const { return false; }
  std::coroutine_handle<> await_suspend(std::coroutine_handle<> parent) {
    handle_.promise().parent = parent;
    return handle_;
  }
  T await_resume() const {
    if constexpr (!std::is_void_v<T>) return handle_.promise().value;
  }

 private:
  void destroy() {
    if (handle_) handle_.destroy();
    handle_ = nullptr;
  }
  std::coroutine_handle<promise_type> handle_ = nullptr;
};

template <class T>
Task<T> detail::Promise<T>::get_return_object() {
  return Task<T>(std::coroutine_handle<Promise>::from_promise(*this));
}
inline Task<void> detail::Promise<void>::get_return_object() {
  return Task<void>(std::coroutine_handle<Promise>::from_promise(*this));
}

}  // namespace pptam
