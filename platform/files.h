// Whole files: read at once, and written so that a power cut leaves the old content or the new one, never a mixture.
#pragma once

#include <sys/types.h>

#include <cstddef>
#include <cstdint>
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
  virtual int fchmod(int fd, mode_t mode);
  virtual int fsync(int fd);
  virtual int close(int fd);
  virtual int rename(const char* from, const char* to);
  virtual int unlink(const char* path);
};

// A file of a random name beside the one that it shall become; removed with the object unless it was kept. Others may
// write to path() meanwhile, such as an encoder. All throw InputError naming the later file, which is as it was then.
class Draft {
 public:
  // A symbolic link at the later name is followed, and stays. The draft itself is new for certain: whatever lies at its
  // name, a planted link too, is not opened.
  explicit Draft(const std::filesystem::path& file, FileOperations* operations = nullptr);
  ~Draft();
  Draft(const Draft&) = delete;
  Draft& operator=(const Draft&) = delete;

  const std::filesystem::path& path() const { return path_; }
  void write(std::span<const std::byte> content);
  // Makes it durable and renames it, in one step for all who look. It takes the permissions of the file replaced.
  void keep();

 private:
  void require(bool done) const;  // errno says why not

  std::filesystem::path name_;    // as given, for messages
  std::filesystem::path target_;  // links resolved
  std::filesystem::path path_;
  FileOperations system_;
  FileOperations& calls_;
  int fd_ = -1;
  bool there_ = false;  // there is a draft to remove
};

// For a handler of signals that end the process: removes all drafts that are being written.
void remove_drafts() noexcept;

// By a draft. When this fails the old file is as it was. Throws InputError naming the file.
void write_atomically(const std::filesystem::path& file, std::span<const std::byte> content,
                      FileOperations* operations = nullptr);

// The same with text.
void write_text_atomically(const std::filesystem::path& file, std::string_view content);

// With all folders above it; it may be there already. Throws InputError naming it, after the option that named it.
void make_folder(const std::filesystem::path& folder, const std::string& option = "");

// Of a folder and those above it the ones that are not there yet, the outermost first.
std::vector<std::filesystem::path> missing_folders(std::filesystem::path folder);

// A module of the program: beside it, where both are built, or in ../lib/pocket-ptam, where they are installed. Empty:
// there is none of that name.
std::filesystem::path module_of_program(const std::string& name);

// Throws InputError naming the file when it cannot be read or is larger than `most` bytes.
std::vector<std::byte> read_file(const std::filesystem::path& file, size_t most);

}  // namespace pptam::platform
