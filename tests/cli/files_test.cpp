// Files are written whole or not at all: by calls that fail, by a process that ends at any of them, and on a disk that
// forgets at a power cut whatever was not made durable.
#include "platform/files.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <fstream>
#include <map>
#include <string>
#include <vector>

#include "platform/camera.h"
#include "tests/support/scratch_folder.h"

namespace pptam::platform {
namespace {

namespace fs = std::filesystem;
using Bytes = std::vector<std::byte>;

Bytes bytes_of(size_t size, int value) {
  Bytes bytes(size);
  for (size_t i = 0; i < size; ++i) bytes[i] = static_cast<std::byte>(static_cast<int>(i % 251) * value);
  return bytes;
}

constexpr size_t kSize = 300'000;  // several calls of write

class Files : public ::testing::Test {
 protected:
  size_t entries() const {
    size_t count = 0;
    for (const auto& entry : fs::directory_iterator(folder_)) count += entry.exists();
    return count;
  }

  const test::ScratchFolder scratch_;
  const fs::path& folder_ = scratch_.path();
  const fs::path file_ = folder_ / "desk.map";
  const Bytes old_ = bytes_of(kSize / 2, 3), new_ = bytes_of(kSize, 5);
};

TEST_F(Files, WriteReplacesAndReadGivesBack) {
  write_atomically(file_, old_);
  EXPECT_EQ(read_file(file_, kSize), old_);
  write_atomically(file_, new_);
  EXPECT_EQ(read_file(file_, kSize), new_);
  write_atomically(file_, {});
  EXPECT_EQ(read_file(file_, kSize), Bytes());
  EXPECT_EQ(entries(), 1u);

  // Without a folder in its name, and through a link, which stays one.
  fs::create_symlink(file_, folder_ / "link.map");
  write_atomically(folder_ / "link.map", new_);
  EXPECT_TRUE(fs::is_symlink(folder_ / "link.map"));
  EXPECT_EQ(read_file(file_, kSize), new_);
  const fs::path here = fs::current_path();
  fs::current_path(folder_);
  write_atomically("bare.map", old_);
  fs::current_path(here);
  EXPECT_EQ(read_file(folder_ / "bare.map", kSize), old_);
}

TEST_F(Files, WhatCannotBeWrittenOrReadIsNamed) {
  const auto message = [](const auto& action) -> std::string {
    try {
      action();
    } catch (const InputError& error) {
      return error.what();
    }
    return "nothing was refused";
  };
  const auto names = [&](const std::string& text, const char* part) {
    EXPECT_NE(text.find(part), std::string::npos) << text;
  };
  names(message([&] { write_atomically(folder_ / "missing" / "desk.map", new_); }), "missing/desk.map");
  names(message([&] { write_atomically(folder_, new_); }), "not a file");
  names(message([&] { write_atomically("/dev/null", new_); }), "not a file");
  EXPECT_TRUE(fs::is_character_file("/dev/null"));
  names(message([&] { read_file(file_, kSize); }), "no such file");
  names(message([&] { read_file(folder_, kSize); }), "not a file");
  write_atomically(file_, new_);
  names(message([&] { read_file(file_, kSize - 1); }), "is larger than 292 kB, too large");
}

TEST_F(Files, PermissionsAreThoseOfTheFileReplacedOrOfTheUmask) {
  const auto mode_of = [](const fs::path& file) { return static_cast<int>(fs::status(file).permissions()) & 0777; };
  const mode_t before = ::umask(027);
  write_atomically(file_, old_);
  EXPECT_EQ(mode_of(file_), 0640);
  for (const int mode : {0600, 0664, 0444}) {  // narrower and wider than the umask
    fs::permissions(file_, static_cast<fs::perms>(mode));
    write_atomically(file_, new_);
    EXPECT_EQ(mode_of(file_), mode);
  }
  ::umask(before);
}

// Somebody who may write to the folder, and who knew the draft's name, has put a link there.
TEST_F(Files, ADraftFollowsNoPlantedLink) {
  class Planting final : public FileOperations {
   public:
    explicit Planting(fs::path victim) : victim_(std::move(victim)) {}
    int open(const char* path, int flags, mode_t mode) override {
      if ((flags & O_CREAT) != 0 && planted_.size() < 3) {
        fs::create_symlink(victim_, path);
        planted_.emplace_back(path);
      }
      return FileOperations::open(path, flags, mode);
    }
    const std::vector<fs::path>& planted() const { return planted_; }

   private:
    fs::path victim_;
    std::vector<fs::path> planted_;
  };
  const fs::path victim = folder_ / "victim.txt";
  write_atomically(victim, old_);
  Planting planting(victim);
  write_atomically(file_, new_, &planting);
  EXPECT_EQ(read_file(victim, kSize), old_);
  EXPECT_EQ(read_file(file_, kSize), new_);
  EXPECT_FALSE(fs::is_symlink(file_));
  ASSERT_EQ(planting.planted().size(), 3u) << "another name was tried each time";
  EXPECT_NE(planting.planted()[0], planting.planted()[1]);
  for (const fs::path& link : planting.planted()) EXPECT_TRUE(fs::is_symlink(link)) << "it is not ours to remove";
}

TEST_F(Files, DraftsCanBeRemovedByAHandlerOfSignals) {
  write_atomically(file_, old_);
  const pid_t child = ::fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    Draft one(file_), other(folder_ / "other.txt");
    one.write(new_);
    if (entries() != 3) ::_exit(1);
    remove_drafts();
    ::_exit(0);
  }
  int status = 0;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  EXPECT_EQ(status, 0);
  EXPECT_EQ(entries(), 1u);
  EXPECT_EQ(read_file(file_, kSize), old_);
}

// The n-th call fails, or is the last thing that the process does: of a write half is done then.
class Faulty final : public FileOperations {
 public:
  Faulty(int nth, int error_or_kill) : nth_(nth), error_(error_or_kill) {}
  int open(const char* path, int flags, mode_t mode) override {
    return strikes() ? -1 : FileOperations::open(path, flags, mode);
  }
  ssize_t write(int fd, const void* data, size_t bytes) override {
    if (calls_ + 1 == nth_) {
      if (FileOperations::write(fd, data, bytes / 2) < 0) return -1;
    }
    return strikes() ? -1 : FileOperations::write(fd, data, bytes);
  }
  int fchmod(int fd, mode_t mode) override { return strikes() ? -1 : FileOperations::fchmod(fd, mode); }
  int fsync(int fd) override { return strikes() ? -1 : FileOperations::fsync(fd); }
  int close(int fd) override {
    const bool strike = strikes();
    const int closed = FileOperations::close(fd);
    return strike ? -1 : closed;
  }
  int rename(const char* from, const char* to) override { return strikes() ? -1 : FileOperations::rename(from, to); }
  int calls() const { return calls_; }

 private:
  bool strikes() {
    if (++calls_ != nth_) return false;
    if (error_ == 0) ::raise(SIGKILL);
    errno = error_;
    return true;
  }
  int nth_;
  int error_;
  int calls_ = 0;
};

TEST_F(Files, AnyCallMayFail) {
  write_atomically(file_, old_);
  Faulty counter(0, EIO);
  write_atomically(file_, new_, &counter);
  // open, five writes of 64 KB, fchmod, fsync, close, rename; open, fsync and close of the folder.
  EXPECT_EQ(counter.calls(), 13);
  int failed = 0;
  for (int nth = 1; nth <= counter.calls(); ++nth) {
    for (const int error : {ENOSPC, EIO}) {
      write_atomically(file_, old_);
      Faulty operations(nth, error);
      bool thrown = false;
      try {
        write_atomically(file_, new_, &operations);
      } catch (const InputError& trouble) {
        thrown = true;
        EXPECT_NE(std::string(trouble.what()).find("desk.map"), std::string::npos);
      }
      failed += thrown;
      const Bytes left = read_file(file_, kSize);
      EXPECT_TRUE(left == new_ || (thrown && left == old_)) << nth;
      EXPECT_EQ(entries(), 1u) << "nothing else is left, call " << nth;
    }
  }
  EXPECT_EQ(failed, 2 * (counter.calls() - 1)) << "all but the folder's close matter";
}

TEST_F(Files, AnInterruptedWriteGoesOn) {
  class Interrupted final : public FileOperations {
   public:
    ssize_t write(int fd, const void* data, size_t bytes) override {
      if (++calls_ % 2 == 0) {
        errno = EINTR;
        return -1;
      }
      return FileOperations::write(fd, data, std::min<size_t>(bytes, 1000));
    }

   private:
    int calls_ = 0;
  } interrupted;
  write_atomically(file_, new_, &interrupted);
  EXPECT_EQ(read_file(file_, kSize), new_);
}

TEST_F(Files, AProcessKilledAtAnyCallLeavesTheOldFileOrTheNew) {
  int killed = 0, old_left = 0, new_left = 0;
  for (int nth = 1; nth <= 20; ++nth) {
    write_atomically(file_, old_);
    const pid_t child = ::fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      Faulty operations(nth, 0);
      write_atomically(file_, new_, &operations);
      ::_exit(0);
    }
    int status = 0;
    ASSERT_EQ(::waitpid(child, &status, 0), child);
    const Bytes left = read_file(file_, kSize);
    if (left == old_) ++old_left;
    if (left == new_) ++new_left;
    EXPECT_TRUE(left == old_ || left == new_) << "call " << nth << " left " << left.size() << " bytes";
    if (WIFSIGNALED(status)) {
      EXPECT_EQ(WTERMSIG(status), SIGKILL);
      ++killed;
    } else {
      EXPECT_EQ(left, new_) << nth;
    }
  }
  EXPECT_EQ(killed, 13);
  EXPECT_EQ(old_left, 10) << "up to the call of rename";
  EXPECT_EQ(new_left, 10);
}

struct PowerCut {};

// A disk in memory, as pessimistic as POSIX allows: what was written is durable after the file's fsync, a name after
// the folder's. After a cut at the n-th call it may hold anything between what is durable and what was asked for.
class Disk final : public FileOperations {
 public:
  Disk(int cut_at, bool fsync_works) : cut_at_(cut_at), fsync_works_(fsync_works) {}

  void put(const std::string& path, const Bytes& content) {
    nodes_.push_back({content, content});
    names_[path] = durable_names_[path] = static_cast<int>(nodes_.size()) - 1;
  }
  // Everything that may be found under the path once the power is back.
  std::vector<Bytes> remains(const std::string& path) const {
    std::vector<Bytes> all;
    for (const auto* names : {&durable_names_, &names_}) {
      const auto found = names->find(path);
      if (found == names->end()) {
        all.push_back({});
        continue;
      }
      const Node& node = nodes_[static_cast<size_t>(found->second)];
      all.push_back(node.durable);
      all.push_back(node.written);
      Bytes torn = node.written;  // a part has reached the disk
      torn.resize((node.durable.size() + node.written.size()) / 2);
      if (node.durable != node.written) all.push_back(torn);
    }
    return all;
  }

  int open(const char* path, int flags, mode_t) override {
    call();
    if ((flags & O_DIRECTORY) != 0) return kFolder;
    nodes_.push_back({});
    names_[path] = static_cast<int>(nodes_.size()) - 1;
    return names_[path];
  }
  ssize_t write(int fd, const void* data, size_t bytes) override {
    call();
    const auto* p = static_cast<const std::byte*>(data);
    Bytes& written = nodes_[static_cast<size_t>(fd)].written;
    written.insert(written.end(), p, p + bytes);
    return static_cast<ssize_t>(bytes);
  }
  int fsync(int fd) override {
    call();
    if (!fsync_works_) return 0;
    if (fd == kFolder) {
      durable_names_ = names_;
    } else {
      nodes_[static_cast<size_t>(fd)].durable = nodes_[static_cast<size_t>(fd)].written;
    }
    return 0;
  }
  int close(int) override {
    if (!cut_) call();
    return 0;
  }
  int rename(const char* from, const char* to) override {
    call();
    names_[to] = names_.at(from);
    names_.erase(from);
    return 0;
  }
  int unlink(const char*) override { return 0; }  // only when unwinding: the power is off

 private:
  static constexpr int kFolder = 1000;
  struct Node {
    Bytes written, durable;
  };
  void call() {
    if (++calls_ != cut_at_) return;
    cut_ = true;
    throw PowerCut();
  }
  int cut_at_;
  bool fsync_works_;
  int calls_ = 0;
  bool cut_ = false;
  std::vector<Node> nodes_;
  std::map<std::string, int> names_, durable_names_;
};

TEST_F(Files, APowerCutAtAnyCallLeavesTheOldFileOrTheNew) {
  for (const bool fsync_works : {true, false}) {
    int cuts = 0, neither = 0, undone = 0;
    for (int nth = 1; nth <= 20; ++nth) {
      Disk disk(nth, fsync_works);
      disk.put(file_.string(), old_);
      bool cut = false;
      try {
        write_atomically(file_, new_, &disk);
      } catch (const PowerCut&) {
        cut = true;
      }
      cuts += cut;
      for (const Bytes& left : disk.remains(file_.string())) {
        neither += left != old_ && left != new_;
        undone += !cut && left != new_;
      }
    }
    EXPECT_EQ(cuts, 12);
    if (fsync_works) {
      EXPECT_EQ(neither, 0);
      EXPECT_EQ(undone, 0) << "once written it stays";
    } else {  // the disk that forgets is really pessimistic
      EXPECT_GT(neither, 0);
      EXPECT_GT(undone, 0);
    }
  }
}

}  // namespace
}  // namespace pptam::platform
