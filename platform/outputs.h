// Where results go, so that nothing of the user's is lost: an output is never an input, and what is replaced or removed
// was made by an earlier run.
//
// In a folder, earlier results are known by a list that is kept there (kListName), with a hash of each: what was
// changed since is the user's. A single file is known by its content: a sound map, or a text with a seal.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "platform/files.h"

namespace pptam::platform {

// The files that a command reads.
class Inputs {
 public:
  // what: as messages name it, such as "the calibration". Empty paths are left out.
  void add(const std::string& what, const std::filesystem::path& file);
  // Throws InputError, naming both, when the output is one of them, be it through links.
  void refuse(const std::string& output, const std::filesystem::path& file) const;

 private:
  struct Input {
    std::string what;
    std::filesystem::path file;
  };
  std::vector<Input> inputs_;
};

// A folder of results with fixed names, some of them perhaps in folders below.
class OutputFolder {
 public:
  static constexpr const char* kListName = ".pocket-ptam";

  // option: what named the folder, "--out". names: all that may be written. Changes nothing yet. Throws InputError when
  // one of them is an input, or there without being an earlier run's.
  OutputFolder(const std::filesystem::path& folder, const std::string& option, std::vector<std::string> names,
               const Inputs& inputs);

  // Makes the folder and tries to write there. Throws InputError; then nothing is left of it.
  void prepare() const;

  // Throws InputError when it cannot be written, or when a file that is not ours has appeared there meanwhile.
  void write(const std::string& name, std::string_view content);
  // The same for what was written into a draft of path(name).
  void keep(const std::string& name, Draft* draft);
  // It was to be written and could not be: an earlier run's stays.
  void give_up(const std::string& name) { tried_.push_back(name); }
  // Once all is written: removes what an earlier run made and this one did not even try, of the names given and, where
  // names vary from run to run, of those in the folder `below` ("images/"). Other commands may have results in the same
  // folder: those stay. Throws InputError.
  void finish(const std::string& below = "");

  std::filesystem::path path(const std::string& name) const { return folder_ / name; }
  const std::vector<std::string>& written() const { return written_; }

 private:
  struct Made {
    std::string name;
    uint64_t hash = 0;
    uint64_t bytes = 0;
  };
  std::vector<Made> read_list() const;
  void write_list(const std::vector<Made>& list) const;
  bool ours(const std::string& name) const;  // there, and made by a run
  void refuse_foreign(const std::string& name) const;

  std::filesystem::path folder_;
  std::string option_;
  std::vector<std::string> names_, tried_, written_;
};

// A single output. Throws InputError when it is an input, or is there without being `a_kind` ("a map") by the judgement
// of ours.
void judge_output_file(const std::string& option, const std::filesystem::path& file, const Inputs& inputs,
                       const std::string& a_kind, const std::function<bool(std::span<const std::byte>)>& ours);

// The same before anything is done: also when it cannot be written. Changes nothing. to_be_made: a folder that will be
// made, and tried, before the file is written; empty: none.
void check_output_file(const std::string& option, const std::filesystem::path& file, const Inputs& inputs,
                       const std::string& a_kind, const std::function<bool(std::span<const std::byte>)>& ours,
                       const std::filesystem::path& to_be_made = {});

// A text with this in some comment can be sealed: the zeros become a hash of the rest.
constexpr std::string_view kOpenSeal = "made by pocket-ptam, 0000000000000000";
std::string sealed(std::string text);
// Nothing in it has been changed since.
bool is_sealed(std::span<const std::byte> content);

// The same place in the file system, now or once both exist.
bool same_place(const std::filesystem::path& a, const std::filesystem::path& b);

}  // namespace pptam::platform
