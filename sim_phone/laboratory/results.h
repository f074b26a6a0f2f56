// The table and the page that a study of many runs leaves in its folder.
#pragma once

#include <exception>
#include <functional>
#include <string>

#include "platform/input_error.h"
#include "platform/outputs.h"
#include "platform/run/console.h"

namespace pptam::laboratory {

// Each on its own. False when one could not be written, which is told; a page without gnuplot is left out with a
// warning.
inline bool write_results(platform::OutputFolder* folder, const std::string& table_name, const std::string& table,
                          const std::string& page_name, const std::function<std::string()>& page) {
  bool good = true;
  const auto attempt = [&good](const std::function<void()>& write) {
    try {
      write();
    } catch (const std::exception& error) {
      platform::print_error(error.what());
      good = false;
    }
  };
  attempt([&] { folder->write(table_name, table); });
  std::string text;
  try {
    text = page();
  } catch (const platform::InputError& error) {
    platform::print_warning(std::string(error.what()) + "; " + page_name + " is not written");
  }
  if (!text.empty()) attempt([&] { folder->write(page_name, text); });
  attempt([&] { folder->finish(); });
  std::string written;
  for (const std::string& name : folder->written()) written += " " + name;
  platform::print_line("");
  platform::print_line("written to " + folder->path("").parent_path().string() + ":" + written);
  return good;
}

}  // namespace pptam::laboratory
