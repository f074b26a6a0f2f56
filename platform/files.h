// Whole files: read at once, and written so that a power cut leaves the old content or the new one, never a mixture.
#pragma once

#include <sys/types.h>

#include <cstddef>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace pptam::platform {

// The calls that writing a file takes, as of POSIX, so that a test can let each of them fail or be the last.
class FileOperations {
 public:
  virtual ~FileOperations() = default;
  virtual int open(const char* path, int flags, mode_t mode);
  virtual ssize_t write(int fd, const void* data, size_t bytes);
  virtual int fsync(int fd);
  virtual int close(int fd);
  virtual int rename(const char* from, const char* to);
  virtual int unlink(const char* path);
};

// Writes a file of another name beside it, makes it durable, and renames it; a symbolic link is followed. When this
// fails the old file is as it was. Throws InputError naming the file.
void write_atomically(const std::filesystem::path& file, std::span<const std::byte> content,
                      FileOperations* operations = nullptr);

// The same with text.
void write_text_atomically(const std::filesystem::path& file, std::string_view content);

// For results that can be made again: an older file is overwritten. Throws InputError naming the file.
void write_text(const std::filesystem::path& file, std::string_view content);

// With all folders above it; it may be there already. Throws InputError naming it, after the option that named it.
void make_folder(const std::filesystem::path& folder, const std::string& option = "");

// Throws InputError naming the file when it cannot be read or is larger than `most` bytes.
std::vector<std::byte> read_file(const std::filesystem::path& file, size_t most);

}  // namespace pptam::platform
