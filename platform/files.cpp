#include "platform/files.h"

#include <fcntl.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <string>

#include "platform/input_error.h"

namespace pptam::platform {
namespace {

constexpr size_t kChunkBytes = 64 * 1024;

// ---- Drafts that a handler of signals can remove -----------------------------------------------------------------

// At once in one process; further ones are left behind by a signal.
constexpr size_t kMaxKnownDrafts = 64;
std::atomic<char*> known_drafts[kMaxKnownDrafts];

void remember_draft(const std::string& path) {
  char* copy = ::strdup(path.c_str());
  for (std::atomic<char*>& slot : known_drafts) {
    char* none = nullptr;
    if (copy != nullptr && slot.compare_exchange_strong(none, copy)) return;
  }
  std::free(copy);
}

void forget_draft(const std::string& path) {
  for (std::atomic<char*>& slot : known_drafts) {
    char* known = slot.load();
    if (known != nullptr && path == known && slot.compare_exchange_strong(known, nullptr)) {
      std::free(known);
      return;
    }
  }
}

bool sync_folder(const std::string& folder, FileOperations& operations) {
  const int fd = operations.open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC, 0);
  if (fd < 0) return false;
  const bool synced = operations.fsync(fd) == 0 || errno == EINVAL;  // not every file system can
  const int trouble = errno;
  operations.close(fd);
  errno = trouble;
  return synced;
}

// Not to be foretold, so that nobody takes all names beforehand. A computer that has just booted may have no entropy
// yet, and nobody has to wait for it: O_EXCL alone keeps others' files safe.
uint64_t draft_number() {
  uint64_t number = 0;
  if (::getrandom(&number, sizeof number, GRND_NONBLOCK) == sizeof number) return number;
  timespec now = {};
  ::clock_gettime(CLOCK_MONOTONIC, &now);
  return (static_cast<uint64_t>(now.tv_sec) << 50) ^ (static_cast<uint64_t>(now.tv_nsec) << 20) ^
         static_cast<uint64_t>(::getpid());
}

}  // namespace

int FileOperations::open(const char* path, int flags, mode_t mode) {
  return ::open(path, flags, mode);
}
ssize_t FileOperations::write(int fd, const void* data, size_t bytes) {
  return ::write(fd, data, bytes);
}
int FileOperations::fchmod(int fd, mode_t mode) {
  return ::fchmod(fd, mode);
}
int FileOperations::fsync(int fd) {
  return ::fsync(fd);
}
int FileOperations::close(int fd) {
  return ::close(fd);
}
int FileOperations::rename(const char* from, const char* to) {
  return ::rename(from, to);
}
int FileOperations::unlink(const char* path) {
  return ::unlink(path);
}

Draft::Draft(const std::filesystem::path& file, FileOperations* operations)
    : name_(file), target_(file), calls_(operations ? *operations : system_) {
  std::error_code error;
  if (std::filesystem::is_symlink(file, error)) {
    target_ = std::filesystem::weakly_canonical(file, error);
    if (error) throw InputError(file.string() + ": cannot be written: " + error.message());
  }
  if (std::filesystem::exists(target_, error) && !std::filesystem::is_regular_file(target_, error))
    throw InputError(file.string() + ": cannot be written, there is something that is not a file");
  do {
    char name[48];
    std::snprintf(name, sizeof name, ".pocket-ptam-%016llx.tmp", static_cast<unsigned long long>(draft_number()));
    path_ = target_.parent_path() / name;
    fd_ = calls_.open(path_.c_str(), O_RDWR | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, 0666);
  } while (fd_ < 0 && errno == EEXIST);
  require(fd_ >= 0);
  there_ = true;
  remember_draft(path_.string());
}

Draft::~Draft() {
  if (fd_ >= 0) calls_.close(fd_);
  if (!there_) return;
  calls_.unlink(path_.c_str());
  forget_draft(path_.string());
}

void Draft::require(bool done) const {
  if (!done) throw InputError(name_.string() + ": cannot be written: " + std::strerror(errno));
}

void Draft::write(std::span<const std::byte> content) {
  while (!content.empty()) {
    const ssize_t written = calls_.write(fd_, content.data(), std::min(content.size(), kChunkBytes));
    if (written < 0 && errno == EINTR) continue;
    require(written > 0);
    content = content.subspan(static_cast<size_t>(written));
  }
}

void Draft::keep() {
  struct stat old = {};
  if (::stat(target_.c_str(), &old) == 0) require(calls_.fchmod(fd_, old.st_mode & 0777) == 0);
  require(calls_.fsync(fd_) == 0);
  const int fd = fd_;
  fd_ = -1;
  require(calls_.close(fd) == 0);
  require(calls_.rename(path_.c_str(), target_.c_str()) == 0);
  there_ = false;
  forget_draft(path_.string());
  const std::filesystem::path parent = target_.parent_path();
  require(sync_folder(parent.empty() ? "." : parent.string(), calls_));
}

void remove_drafts() noexcept {
  for (const std::atomic<char*>& slot : known_drafts) {
    if (const char* path = slot.load()) ::unlink(path);
  }
}

void write_atomically(const std::filesystem::path& file, std::span<const std::byte> content,
                      FileOperations* operations) {
  Draft draft(file, operations);
  draft.write(content);
  draft.keep();
}

void write_text_atomically(const std::filesystem::path& file, std::string_view content) {
  write_atomically(file, std::as_bytes(std::span(content)));
}

void make_folder(const std::filesystem::path& folder, const std::string& option) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) {
    throw InputError((option.empty() ? "" : option + " ") + folder.string() + ": cannot be made: " + error.message());
  }
}

std::vector<std::filesystem::path> missing_folders(std::filesystem::path folder) {
  std::vector<std::filesystem::path> missing;
  std::error_code error;
  folder = std::filesystem::absolute(folder, error).lexically_normal();
  for (; !folder.empty() && !std::filesystem::exists(std::filesystem::symlink_status(folder, error));
       folder = folder.parent_path()) {
    missing.insert(missing.begin(), folder);
  }
  return missing;
}

std::filesystem::path module_of_program(const std::string& name) {
  std::error_code error;
  const std::filesystem::path folder = std::filesystem::read_symlink("/proc/self/exe", error).parent_path();
  for (const std::filesystem::path& place : {folder, folder.parent_path() / "lib/pocket-ptam"}) {
    if (std::filesystem::exists(place / name, error)) return place / name;
  }
  return {};
}

std::vector<std::byte> read_file(const std::filesystem::path& file, size_t most) {
  std::error_code error;
  if (!std::filesystem::exists(file, error)) throw InputError(file.string() + ": there is no such file");
  if (!std::filesystem::is_regular_file(file, error)) throw InputError(file.string() + ": is not a file");
  // Not blocking: another kind of file may have taken its place meanwhile, and opening a FIFO would wait.
  const int fd = ::open(file.c_str(), O_RDONLY | O_NONBLOCK | O_NOCTTY | O_CLOEXEC);
  if (fd < 0) throw InputError(file.string() + ": cannot be read: " + std::strerror(errno));
  std::vector<std::byte> content;
  std::string trouble;
  struct stat status = {};
  if (::fstat(fd, &status) != 0) {
    trouble = std::string("cannot be read: ") + std::strerror(errno);
  } else if (!S_ISREG(status.st_mode)) {
    trouble = "is not a file";
  } else if (static_cast<uint64_t>(status.st_size) > most) {
    const bool small = most < size_t{1} << 20;
    trouble = "is larger than " + std::to_string(most >> (small ? 10 : 20)) + (small ? " kB" : " MB") + ", too large";
  } else {
    content.resize(static_cast<size_t>(status.st_size));
    size_t done = 0;
    while (done < content.size()) {
      const ssize_t got = ::read(fd, content.data() + done, content.size() - done);
      if (got < 0 && errno == EINTR) continue;
      if (got < 0) trouble = std::string("cannot be read: ") + std::strerror(errno);
      if (got <= 0) break;
      done += static_cast<size_t>(got);
    }
    content.resize(done);  // it may have shrunk meanwhile
  }
  ::close(fd);
  if (!trouble.empty()) throw InputError(file.string() + ": " + trouble);
  return content;
}

}  // namespace pptam::platform
