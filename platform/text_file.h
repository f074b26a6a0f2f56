// Text files of any common editor and system: UTF-8 or UTF-16, with or without a byte order mark; lines that end as on
// Unix, Windows or old Macs.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

namespace pptam::platform {

constexpr size_t kMaxTextBytes = size_t{64} << 20;  // half an hour of poses at 200 per second has 40 MB
constexpr size_t kMaxLineBytes = 64 * 1024;

// The whole text as UTF-8 without a mark; every line ends in '\n'. Throws InputError naming the file when it is
// missing, not a regular file (none other is opened), larger than `most` bytes, or holds zeros (not a text).
std::string read_text(const std::filesystem::path& file, size_t most = kMaxTextBytes);

// The same of a file's bytes. `name` stands for the file in the error.
std::string text_of(std::vector<std::byte> bytes, const std::string& name);

// Throws InputError with file, line number and what.
using LineError = std::function<void(const std::string& what)>;
// Calls f for each line that is neither blank nor a comment (#), without blanks at its ends. Throws as read_text(), and
// for a line longer than kMaxLineBytes.
void for_each_line(const std::filesystem::path& file,
                   const std::function<void(std::string_view line, const LineError& fail)>& f);

// Without blanks at either end: spaces, tabs, carriage returns.
std::string_view trimmed(std::string_view text);

// False unless the whole text is a decimal integer that fits.
bool parse_integer(std::string_view text, int64_t* value);

}  // namespace pptam::platform
