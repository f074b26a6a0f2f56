// Saved maps: `pocket-ptam map info|export`, and the options of a run that load and save one.
#pragma once

#include <cstddef>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "pocket_ptam.h"

namespace pptam::app {

struct MapExportOptions {
  std::filesystem::path map;
  std::string ply;     // file; empty: none
  std::string colmap;  // folder, for COLMAP's text model; empty: none
};

// Each throws InputError naming the file.
void print_map_info(const std::filesystem::path& file);
void export_map(const MapExportOptions& options);

}  // namespace pptam::app
