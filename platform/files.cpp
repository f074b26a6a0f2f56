#include "platform/files.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <string>

#include "platform/input_error.h"

namespace pptam::platform {
namespace {

constexpr size_t kChunkBytes = 64 * 1024;

// Closes and removes what was begun, unless it is kept.
class Draft {
 public:
  Draft(std::string path, FileOperations& operations) : path_(std::move(path)), operations_(operations) {
    fd_ = operations_.open(path_.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
    begun_ = fd_ >= 0;
  }
  ~Draft() {
    if (fd_ >= 0) operations_.close(fd_);
    if (begun_) operations_.unlink(path_.c_str());
  }
  Draft(const Draft&) = delete;
  Draft& operator=(const Draft&) = delete;

  // Each false with errno set.
  bool begun() const { return begun_; }
  bool write(std::span<const std::byte> content) {
    while (!content.empty()) {
      const ssize_t written = operations_.write(fd_, content.data(), std::min(content.size(), kChunkBytes));
      if (written < 0 && errno == EINTR) continue;
      if (written <= 0) return false;
      content = content.subspan(static_cast<size_t>(written));
    }
    return operations_.fsync(fd_) == 0;
  }
  bool close() {
    const int fd = fd_;
    fd_ = -1;
    return operations_.close(fd) == 0;
  }
  bool rename_to(const std::string& file) {
    if (operations_.rename(path_.c_str(), file.c_str()) != 0) return false;
    begun_ = false;
    return true;
  }

 private:
  std::string path_;
  FileOperations& operations_;
  int fd_ = -1;
  bool begun_ = false;  // there is a file to remove
};

bool sync_folder(const std::string& folder, FileOperations& operations) {
  const int fd = operations.open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC, 0);
  if (fd < 0) return false;
  const bool synced = operations.fsync(fd) == 0 || errno == EINVAL;  // not every file system can
  const int trouble = errno;
  operations.close(fd);
  errno = trouble;
  return synced;
}

}  // namespace

int FileOperations::open(const char* path, int flags, mode_t mode) {
  return ::open(path, flags, mode);
}
ssize_t FileOperations::write(int fd, const void* data, size_t bytes) {
  return ::write(fd, data, bytes);
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

void write_atomically(const std::filesystem::path& file, std::span<const std::byte> content,
                      FileOperations* operations) {
  FileOperations system;
  FileOperations& calls = operations ? *operations : system;
  std::error_code error;
  std::filesystem::path target = file;
  if (std::filesystem::is_symlink(file, error)) {
    target = std::filesystem::weakly_canonical(file, error);
    if (error) throw InputError(file.string() + ": cannot be written: " + error.message());
  }
  if (std::filesystem::exists(target, error) && !std::filesystem::is_regular_file(target, error))
    throw InputError(file.string() + ": cannot be written, there is something that is not a file");
  const std::filesystem::path parent = target.parent_path();
  const std::string folder = parent.empty() ? "." : parent.string();
  const auto require = [&](bool done) {
    if (!done) throw InputError(file.string() + ": cannot be written: " + std::strerror(errno));
  };
  Draft draft(target.string() + "." + std::to_string(::getpid()) + ".tmp", calls);
  require(draft.begun());
  require(draft.write(content));
  require(draft.close());
  require(draft.rename_to(target.string()));
  require(sync_folder(folder, calls));
}

void write_text_atomically(const std::filesystem::path& file, std::string_view content) {
  write_atomically(file, std::as_bytes(std::span(content)));
}

void write_text(const std::filesystem::path& file, std::string_view content) {
  std::ofstream out(file, std::ios::binary);
  out << content;
  out.close();
  if (!out) throw InputError(file.string() + ": cannot be written");
}

void make_folder(const std::filesystem::path& folder, const std::string& option) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) {
    throw InputError((option.empty() ? "" : option + " ") + folder.string() + ": cannot be made: " + error.message());
  }
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
    trouble = "is larger than " + std::to_string(most >> 20) + " MB, too large";
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
