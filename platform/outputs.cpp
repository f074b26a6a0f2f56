#include "platform/outputs.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cinttypes>
#include <cstring>
#include <utility>

#include "platform/input_error.h"
#include "platform/text.h"

namespace pptam::platform {
namespace {

namespace fs = std::filesystem;

constexpr size_t kMaxListBytes = 16 << 20;              // some 200 000 lines; not swept
constexpr size_t kMaxKnownFileBytes = size_t{1} << 30;  // of a single output that is looked at: the largest map
constexpr size_t kTrialBytes = 256 * 1024;              // a folder is tried with; not swept
constexpr const char* kListHead =
    "# Files that pocket-ptam made here and may replace: FNV-1a hash, bytes, name. Others it leaves alone.\n";

// FNV-1a of 64 bits: told apart are accidents, not attacks.
class Hash {
 public:
  void add(const void* data, size_t bytes) {
    const auto* p = static_cast<const unsigned char*>(data);
    for (size_t i = 0; i < bytes; ++i) value_ = (value_ ^ p[i]) * 0x100000001b3u;
    bytes_ += bytes;
  }
  uint64_t value() const { return value_; }
  uint64_t bytes() const { return bytes_; }

 private:
  uint64_t value_ = 0xcbf29ce484222325u;
  uint64_t bytes_ = 0;
};

// False when there is no such regular file, or it cannot be read.
bool hash_file(const fs::path& file, Hash* hash) {
  const int fd = ::open(file.c_str(), O_RDONLY | O_NONBLOCK | O_NOFOLLOW | O_NOCTTY | O_CLOEXEC);
  if (fd < 0) return false;
  struct stat status = {};
  bool good = ::fstat(fd, &status) == 0 && S_ISREG(status.st_mode);
  std::vector<char> chunk(1 << 16);
  while (good) {
    const ssize_t got = ::read(fd, chunk.data(), chunk.size());
    if (got < 0 && errno == EINTR) continue;
    good = got >= 0;
    if (got <= 0) break;
    hash->add(chunk.data(), static_cast<size_t>(got));
  }
  ::close(fd);
  return good;
}

bool is_there(const fs::path& file) {  // a link that leads nowhere is there
  struct stat status = {};
  return ::lstat(file.c_str(), &status) == 0;
}

// Writes and removes something. Throws InputError.
void try_to_write(const fs::path& beside) {
  const std::vector<std::byte> content(kTrialBytes);
  Draft(beside).write(content);
}

}  // namespace

void Inputs::add(const std::string& what, const fs::path& file) {
  if (!file.empty()) inputs_.push_back({what, file});
}

void Inputs::refuse(const std::string& output, const fs::path& file) const {
  struct stat there = {};
  if (::stat(file.c_str(), &there) != 0) return;
  for (const Input& input : inputs_) {
    struct stat other = {};
    if (::stat(input.file.c_str(), &other) != 0 || other.st_dev != there.st_dev || other.st_ino != there.st_ino)
      continue;
    throw InputError(output + " would replace " + input.what + " " + input.file.string() +
                     ", which is read: name another output");
  }
}

OutputFolder::OutputFolder(const fs::path& folder, const std::string& option, std::vector<std::string> names,
                           const Inputs& inputs)
    : folder_(folder), option_(option), names_(std::move(names)) {
  struct stat status = {};
  if (is_there(folder_) && (::stat(folder_.c_str(), &status) != 0 || !S_ISDIR(status.st_mode)))
    throw InputError(option_ + " " + folder_.string() + ": is there and not a folder");
  inputs.refuse(option_ + ": " + path(kListName).string(), path(kListName));
  read_list();  // throws when it is none of ours
  for (const std::string& name : names_) {
    inputs.refuse(option_ + ": " + path(name).string(), path(name));
    refuse_foreign(name);
  }
}

void OutputFolder::refuse_foreign(const std::string& name) const {
  if (!is_there(path(name)) || ours(name)) return;
  throw InputError(path(name).string() +
                   ": was not made by an earlier run or was changed since, and is not replaced: move it away, or name "
                   "another folder with " +
                   option_);
}

bool OutputFolder::ours(const std::string& name) const {
  Hash hash;
  if (!hash_file(path(name), &hash)) return false;
  const std::vector<Made> list = read_list();
  return std::any_of(list.begin(), list.end(), [&](const Made& made) {
    return made.name == name && made.hash == hash.value() && made.bytes == hash.bytes();
  });
}

std::vector<OutputFolder::Made> OutputFolder::read_list() const {
  const fs::path file = path(kListName);
  if (!is_there(file)) return {};
  const auto refuse = [&] {
    throw InputError(file.string() + ": is not the list of results that pocket-ptam keeps: move it away, or name " +
                     "another folder with " + option_);
  };
  std::error_code error;
  if (fs::is_symlink(file, error) || !fs::is_regular_file(file, error)) refuse();
  const std::vector<std::byte> bytes = read_file(file, kMaxListBytes);
  std::string text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  if (text.rfind(kListHead, 0) != 0) refuse();
  std::vector<Made> list;
  for (size_t begin = std::strlen(kListHead); begin < text.size();) {
    const size_t end = std::min(text.find('\n', begin), text.size());
    Made made;
    int used = 0;
    const std::string line = text.substr(begin, end - begin);
    if (std::sscanf(line.c_str(), "%16" SCNx64 " %20" SCNu64 " %n", &made.hash, &made.bytes, &used) != 2 || used == 0)
      refuse();
    made.name = line.substr(static_cast<size_t>(used));
    list.push_back(std::move(made));
    begin = end + 1;
  }
  return list;
}

void OutputFolder::write_list(const std::vector<Made>& list) const {
  std::string text = kListHead;
  for (const Made& made : list) text += format("%016" PRIx64 " %" PRIu64 " ", made.hash, made.bytes) + made.name + "\n";
  write_text_atomically(path(kListName), text);
}

void OutputFolder::prepare() const {
  std::vector<fs::path> made;
  try {
    for (const std::string& name : names_) {
      const fs::path folder = path(name).parent_path();
      const std::vector<fs::path> missing = missing_folders(folder);
      made.insert(made.end(), missing.begin(), missing.end());
      make_folder(folder, option_);
    }
    if (!names_.empty()) try_to_write(path(names_.front()));
    if (is_there(path(kListName))) write_list(read_list());  // may be another user's, in a folder that all may write to
  } catch (const InputError&) {
    std::error_code ignored;
    for (auto folder = made.rbegin(); folder != made.rend(); ++folder) fs::remove(*folder, ignored);  // if empty
    throw;
  }
}

void OutputFolder::write(const std::string& name, std::string_view content) {
  tried_.push_back(name);
  Draft draft(path(name));
  draft.write(std::as_bytes(std::span(content)));
  keep(name, &draft);
}

void OutputFolder::keep(const std::string& name, Draft* draft) {
  if (std::find(tried_.begin(), tried_.end(), name) == tried_.end()) tried_.push_back(name);
  refuse_foreign(name);
  Hash hash;
  if (!hash_file(draft->path(), &hash)) throw InputError(path(name).string() + ": its draft is gone");
  // Told first: should the process end between the two, the list knows the old file and the new one.
  std::vector<Made> list = read_list();
  list.push_back({name, hash.value(), hash.bytes()});
  try {
    write_list(list);
  } catch (const InputError& error) {
    throw InputError(path(name).string() + ": not written: " + error.what());
  }
  draft->keep();
  written_.push_back(name);
}

void OutputFolder::finish(const std::string& below) {
  std::vector<std::string> names = names_;
  for (const Made& made : read_list()) {
    const bool inside =
        !below.empty() && made.name.starts_with(below) && made.name.find('/', below.size()) == std::string::npos;
    if (inside) names.push_back(made.name);
  }
  for (const std::string& name : names) {
    const bool tried = std::find(tried_.begin(), tried_.end(), name) != tried_.end();
    std::error_code ignored;
    if (!tried && ours(name)) fs::remove(path(name), ignored);
  }
  // Of files of several lines the last one holds.
  const std::vector<Made> all = read_list();
  std::vector<Made> list;
  for (size_t i = 0; i < all.size(); ++i) {
    const bool newer = std::any_of(all.begin() + static_cast<ptrdiff_t>(i) + 1, all.end(),
                                   [&](const Made& made) { return made.name == all[i].name; });
    const bool failed = std::find(tried_.begin(), tried_.end(), all[i].name) != tried_.end() &&
                        std::find(written_.begin(), written_.end(), all[i].name) == written_.end();
    if ((!newer || failed) && is_there(path(all[i].name))) list.push_back(all[i]);
  }
  write_list(list);
}

void judge_output_file(const std::string& option, const fs::path& file, const Inputs& inputs, const std::string& a_kind,
                       const std::function<bool(std::span<const std::byte>)>& ours) {
  const std::string named = option + " " + file.string();
  std::error_code error;
  if (file.empty()) throw InputError(option + ": the file's name is empty");
  if (fs::is_directory(file, error)) throw InputError(named + ": is a folder");
  const fs::path folder = file.parent_path();
  if (!folder.empty() && !fs::is_directory(folder, error))
    throw InputError(named + ": there is no folder " + folder.string());
  inputs.refuse(named, file);
  if (is_there(file)) {
    if (!fs::exists(file, error)) throw InputError(named + ": is a link that leads nowhere; name another file");
    if (!fs::is_regular_file(file, error)) throw InputError(named + ": there is something that is not a file");
    if (!ours(read_file(file, kMaxKnownFileBytes)))
      throw InputError(named + ": is there and is not " + a_kind +
                       " as this program made it, and is not replaced: move it away or name another file");
  }
}

void check_output_file(const std::string& option, const fs::path& file, const Inputs& inputs, const std::string& a_kind,
                       const std::function<bool(std::span<const std::byte>)>& ours, const fs::path& to_be_made) {
  const fs::path folder = file.parent_path();
  if (!to_be_made.empty() && file.has_filename() && !folder.empty() && !is_there(folder) &&
      same_place(folder, to_be_made))
    return;
  judge_output_file(option, file, inputs, a_kind, ours);
  try_to_write(file);
}

std::string sealed(std::string text) {
  const size_t at = text.find(kOpenSeal);
  if (at == std::string::npos) return text;
  Hash hash;
  hash.add(text.data(), text.size());
  return text.replace(at + kOpenSeal.size() - 16, 16, format("%016" PRIx64, hash.value()));
}

bool is_sealed(std::span<const std::byte> content) {
  std::string text(reinterpret_cast<const char*>(content.data()), content.size());
  const std::string_view words = kOpenSeal.substr(0, kOpenSeal.size() - 16);
  const size_t at = text.find(words);
  if (at == std::string::npos || at + kOpenSeal.size() > text.size()) return false;
  std::string open = text;
  open.replace(at, kOpenSeal.size(), kOpenSeal);
  return sealed(std::move(open)) == text;
}

bool same_place(const fs::path& a, const fs::path& b) {
  std::error_code error;
  if (fs::equivalent(a, b, error)) return true;
  const auto place_of = [&error](const fs::path& path) {
    fs::path place = fs::weakly_canonical(fs::absolute(path, error), error).lexically_normal();
    return place.has_filename() ? place : place.parent_path();  // "folder/" is "folder"
  };
  const fs::path a_place = place_of(a);
  const fs::path b_place = place_of(b);
  return !a_place.empty() && a_place == b_place;
}

}  // namespace pptam::platform
