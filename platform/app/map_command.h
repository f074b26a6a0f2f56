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
std::vector<std::byte> read_map_file(const std::filesystem::path& file);
void print_map_info(const std::filesystem::path& file);
void export_map(const MapExportOptions& options);

// Points with normals, grey values and numbers of measurements, as a text file for MeshLab or CloudCompare.
void write_ply(const std::filesystem::path& file, std::span<const MapPointInfo> points);

}  // namespace pptam::app
