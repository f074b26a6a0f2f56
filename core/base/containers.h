// Fixed-capacity storage: an arena over the caller's block, and vectors that never grow past their capacity.
//
// All state of the core lives in one block of memory that the caller provides. An Arena divides it once, at the start;
// afterwards nothing is allocated. Constructed without a block, an Arena only measures: System::required_bytes()
// runs the same construction code and reads used(). Not thread-safe.
#pragma once

#include <cstddef>
#include <cstdint>
#include <new>
#include <span>
#include <type_traits>
#include <utility>

#include <pocket_ptam/status.h>
#include "base/assert.h"

namespace pptam {

class Arena {
 public:
  Arena() = default;  // measures only: allocate() returns null
  explicit Arena(std::span<std::byte> block) : block_(block), measuring_(false) {}

  // Uninitialised bytes, aligned to kAlignment. Null when measuring or when the block is too small; overflowed() tells
  // which.
  void* allocate(size_t bytes) {
    used_ = (used_ + kAlignment - 1) / kAlignment * kAlignment;
    const size_t start = used_;
    used_ += bytes;
    if (measuring_ || used_ > block_.size()) return nullptr;
    return block_.data() + start;
  }
  // An array of value-initialised T; null when allocate() returns null.
  template <class T>
  T* allocate_array(size_t count) {
    static_assert(alignof(T) <= kAlignment && std::is_trivially_destructible_v<T>);
    T* array = static_cast<T*>(allocate(count * sizeof(T)));
    if (array)
      for (size_t i = 0; i < count; ++i) new (array + i) T();
    return array;
  }
  // Builds a T, whose constructor's first argument is this arena. Null when measuring, and when the block is too small.
  // A T that fits may still have empty storage: overflowed() tells.
  template <class T, class... Args>
  T* create(Args&&... args) {
    static_assert(alignof(T) <= kAlignment && std::is_trivially_destructible_v<T>);
    void* place = allocate(sizeof(T));
    if (place) return new (place) T(*this, std::forward<Args>(args)...);
    const T measured(*this, std::forward<Args>(args)...);  // counts what its constructor allocates
    return nullptr;
  }
  size_t used() const { return used_; }  // bytes
  bool measuring() const { return measuring_; }
  bool overflowed() const { return !measuring_ && used_ > block_.size(); }

  static constexpr size_t kAlignment = alignof(std::max_align_t);  // bytes, as malloc's

 private:
  std::span<std::byte> block_;
  size_t used_ = 0;
  bool measuring_ = true;
};

// A vector whose storage lies in an arena. push_back on a full vector returns false and changes nothing.
template <class T>
class FixedVector {
 public:
  FixedVector() = default;
  FixedVector(Arena& arena, int capacity) : data_(arena.allocate_array<T>(capacity)), capacity_(data_ ? capacity : 0) {}

  bool push_back(const T& value) {
    if (size_ == capacity_) return false;
    data_[size_++] = value;
    return true;
  }
  void clear() { size_ = 0; }
  void resize(int size) {
    PPTAM_ASSERT(size >= 0 && size <= capacity_);
    size_ = size;
  }
  int size() const { return size_; }
  int capacity() const { return capacity_; }
  bool empty() const { return size_ == 0; }
  T* data() { return data_; }
  const T* data() const { return data_; }
  T& operator[](int i) {
    PPTAM_ASSERT(i >= 0 && i < size_);
    return data_[i];
  }
  const T& operator[](int i) const {
    PPTAM_ASSERT(i >= 0 && i < size_);
    return data_[i];
  }
  T* begin() { return data_; }
  T* end() { return data_ + size_; }
  const T* begin() const { return data_; }
  const T* end() const { return data_ + size_; }
  T& back() { return (*this)[size_ - 1]; }
  operator std::span<T>() { return {data_, static_cast<size_t>(size_)}; }
  operator std::span<const T>() const { return {data_, static_cast<size_t>(size_)}; }

 private:
  T* data_ = nullptr;
  int size_ = 0;
  int capacity_ = 0;
};

// A vector of at most N elements whose storage lies in the object. push_back on a full vector returns false.
template <class T, int N>
class InlineVector {
 public:
  bool push_back(const T& value) {
    if (size_ == N) return false;
    data_[size_++] = value;
    return true;
  }
  void clear() { size_ = 0; }
  void erase_at(int i) {  // keeps the order of the other elements
    PPTAM_ASSERT(i >= 0 && i < size_);
    for (int k = i; k + 1 < size_; ++k) data_[k] = data_[k + 1];
    --size_;
  }
  int size() const { return size_; }
  bool full() const { return size_ == N; }
  static constexpr int capacity() { return N; }
  T& operator[](int i) {
    PPTAM_ASSERT(i >= 0 && i < size_);
    return data_[i];
  }
  const T& operator[](int i) const {
    PPTAM_ASSERT(i >= 0 && i < size_);
    return data_[i];
  }
  T* begin() { return data_; }
  T* end() { return data_ + size_; }
  const T* begin() const { return data_; }
  const T* end() const { return data_ + size_; }

 private:
  T data_[N] = {};
  int size_ = 0;
};

}  // namespace pptam
