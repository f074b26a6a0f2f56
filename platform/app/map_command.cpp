// pocket-ptam map info|export: what is in a saved map, and the map for other programs.

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <exception>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <utility>

#include "platform/app/commands.h"
#include "platform/camera/image_files.h"
#include "platform/files.h"
#include "platform/input_error.h"
#include "platform/outputs.h"
#include "platform/run/console.h"
#include "platform/run/names.h"
#include "platform/run/run.h"
#include "platform/run/text_outputs.h"
#include "platform/text.h"

namespace pptam::app {
namespace {

using namespace platform;

struct MapExportOptions {
  std::filesystem::path map;
  std::string ply;     // file; empty: none
  std::string colmap;  // folder, for COLMAP's text model; empty: none
};

// A map that was read from a file, inside a System of its own.
class LoadedMap {
 public:
  explicit LoadedMap(const std::filesystem::path& file) : bytes_(read_map_file(file)) {
    const auto require = [&](const Status& status) {
      if (!status.ok()) throw InputError(file.string() + ": " + status.message());
    };
    require(System::map_info(bytes_, &info_));
    Config config = Config::phone(info_.camera.model);
    config.camera.shutter = info_.camera.shutter;
    config.max_maps = std::max(config.max_maps, info_.maps);
    config.max_keyframes = std::max(config.max_keyframes, info_.min_keyframes);
    config.max_erased_keyframes = std::max(config.max_erased_keyframes, info_.min_erased_keyframes);
    config.max_map_points = std::max(config.max_map_points, info_.min_map_points);
    config.max_measurements = std::max(config.max_measurements, info_.min_measurements);
    config.max_measurements_per_point = std::max(config.max_measurements_per_point, info_.min_measurements_per_point);
    config.max_partial_points = std::max(config.max_partial_points, info_.min_partial_points);
    require(config.validate());
    const size_t needed = System::required_bytes(config);
    memory_.resize((needed + sizeof(std::max_align_t) - 1) / sizeof(std::max_align_t));
    require(System::create(config, std::as_writable_bytes(std::span(memory_)), &system_));
    require(system_->load_map(bytes_));
    keyframes_.resize(static_cast<size_t>(system_->keyframes({})));
    system_->keyframes(keyframes_);
    points_.resize(static_cast<size_t>(system_->map_points({})));
    system_->map_points(points_);
    measurements_.resize(static_cast<size_t>(system_->measurements({})));
    system_->measurements(measurements_);
  }

  size_t bytes() const { return bytes_.size(); }
  const MapInfo& info() const { return info_; }
  const System& system() const { return *system_; }
  const std::vector<KeyframeInfo>& keyframes() const { return keyframes_; }
  const std::vector<MapPointInfo>& points() const { return points_; }
  const std::vector<MeasurementInfo>& measurements() const { return measurements_; }

 private:
  std::vector<std::byte> bytes_;
  MapInfo info_;
  std::vector<std::max_align_t> memory_;
  System* system_ = nullptr;
  std::vector<KeyframeInfo> keyframes_;
  std::vector<MapPointInfo> points_;
  std::vector<MeasurementInfo> measurements_;
};

const char* distortion_name(Distortion distortion) {
  switch (distortion) {
    case Distortion::kNone:
      return "no distortion";
    case Distortion::kFov:
      return "FOV distortion";
    case Distortion::kRadTan:
      return "radial-tangential distortion";
    case Distortion::kEquidistant:
      return "equidistant distortion";
  }
  return "?";
}

// The pixel that a global shutter's camera would have shown the point at.
Vector2f reprojection(const System& system, const KeyframeInfo& keyframe, const MapPointInfo& point) {
  Vector2f px = Vector2f::Constant(NAN);
  system.config().camera.project(keyframe.T_cw * point.p_w, &px);
  return px;
}

// Distances between measurements and reprojections, level-0 pixels, as the index of LoadedMap::measurements().
std::vector<float> reprojection_errors(const LoadedMap& map) {
  std::map<uint32_t, const KeyframeInfo*> keyframes;
  for (const KeyframeInfo& keyframe : map.keyframes()) keyframes[keyframe.id] = &keyframe;
  std::map<uint32_t, const MapPointInfo*> points;
  for (const MapPointInfo& point : map.points()) points[point.id] = &point;
  std::vector<float> errors;
  for (const MeasurementInfo& m : map.measurements()) {
    const Vector2f px = reprojection(map.system(), *keyframes.at(m.keyframe_id), *points.at(m.point_id));
    const float error = (px - m.global_px).norm();
    errors.push_back(std::isfinite(error) ? error : INFINITY);
  }
  return errors;
}

// COLMAP's name of the camera model, and its parameters. Its pixel centres are at halves.
std::string colmap_camera(const CameraModel& camera) {
  const float* c = camera.coeffs;
  const std::string size = format(" %d %d", camera.width, camera.height);
  const std::string pinhole = format(" %.9g %.9g %.9g %.9g", camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5);
  switch (camera.distortion) {
    case Distortion::kNone:
      break;
    case Distortion::kFov:
      return "FOV" + size + pinhole + format(" %.9g", c[0]);
    case Distortion::kRadTan:
      if (c[4] == 0) return "OPENCV" + size + pinhole + format(" %.9g %.9g %.9g %.9g", c[0], c[1], c[2], c[3]);
      return "FULL_OPENCV" + size + pinhole + format(" %.9g %.9g %.9g %.9g %.9g 0 0 0", c[0], c[1], c[2], c[3], c[4]);
    case Distortion::kEquidistant:
      return "OPENCV_FISHEYE" + size + pinhole + format(" %.9g %.9g %.9g %.9g", c[0], c[1], c[2], c[3]);
  }
  return "PINHOLE" + size + pinhole;
}

std::string image_name(uint32_t keyframe_id) {
  return format("keyframe_%06u.png", keyframe_id);
}

// cameras.txt, images.txt and points3D.txt as COLMAP reads them, and the images that they name.
void write_colmap(const LoadedMap& map, OutputFolder* folder) {
  for (const KeyframeInfo& keyframe : map.keyframes()) {
    const std::string name = "images/" + image_name(keyframe.id);
    Draft draft(folder->path(name));
    write_png(draft.path(), map.system().keyframe_image(keyframe.id));
    folder->keep(name, &draft);
  }
  folder->write("cameras.txt",
                "# CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]\n1 " + colmap_camera(map.info().camera.model) + "\n");

  // Observations by image; their places in it are what the tracks refer to.
  const std::vector<float> errors = reprojection_errors(map);
  std::map<uint32_t, std::string> observations, tracks;
  std::map<uint32_t, int> observed;
  std::map<uint32_t, std::pair<double, int>> point_errors;  // sum, count
  for (size_t i = 0; i < map.measurements().size(); ++i) {
    const MeasurementInfo& m = map.measurements()[i];
    observations[m.keyframe_id] += format("%.4f %.4f %u ", m.global_px.x() + 0.5, m.global_px.y() + 0.5, m.point_id);
    tracks[m.point_id] += format(" %u %d", m.keyframe_id, observed[m.keyframe_id]++);
    point_errors[m.point_id].first += static_cast<double>(errors[i]);
    ++point_errors[m.point_id].second;
  }
  std::string images =
      "# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME\n# POINTS2D[] as X Y POINT3D_ID: rolling shutter corrected\n";
  for (const KeyframeInfo& keyframe : map.keyframes()) {
    const Eigen::Quaterniond q = Eigen::Quaterniond(keyframe.T_cw.R.cast<double>()).normalized();
    const Vector3f& t = keyframe.T_cw.t;
    images += format("%u %.9g %.9g %.9g %.9g %.9g %.9g %.9g 1 ", keyframe.id, q.w(), q.x(), q.y(), q.z(), t.x(), t.y(),
                     t.z()) +
              image_name(keyframe.id) + "\n" + observations[keyframe.id] + "\n";
  }
  folder->write("images.txt", images);

  std::string points = "# POINT3D_ID X Y Z R G B ERROR TRACK[] as IMAGE_ID POINT2D_IDX\n";
  for (const MapPointInfo& point : map.points()) {
    const auto& [sum, count] = point_errors[point.id];
    points += format("%u %.9g %.9g %.9g %d %d %d %.4f", point.id, point.p_w.x(), point.p_w.y(), point.p_w.z(),
                     point.grey, point.grey, point.grey, count > 0 ? sum / count : 0.0) +
              tracks[point.id] + "\n";
  }
  folder->write("points3D.txt", points);
  folder->finish("images/");
}

void print_map_info(const std::filesystem::path& file) {
  const LoadedMap map(file);
  const MapInfo& info = map.info();
  const CameraModel& camera = info.camera.model;
  const RollingShutter& shutter = info.camera.shutter;
  const bool columns = shutter.axis == RollingShutter::Axis::kColumns;
  std::vector<SummaryRow> rows;
  rows.push_back({"map", format("version %d, %zu bytes, checksum and contents good", info.version, map.bytes())});
  if (info.maps > 1)
    rows.push_back({"maps", format("%d in worlds of their own; what follows is of all, but for extent and reprojection",
                                   info.maps)});
  rows.push_back({"camera", format("%dx%d, fx %.6g, fy %.6g, cx %.6g, cy %.6g, %s", camera.width, camera.height,
                                   camera.fx, camera.fy, camera.cx, camera.cy, distortion_name(camera.distortion))});
  rows.push_back({"shutter", shutter.line_time_s == 0
                                 ? std::string("global")
                                 : format("%s:%c:%.6g", name_of(shutter.axis), shutter.line_time_s > 0 ? '+' : '-',
                                          std::abs(shutter.line_time_s) * (columns ? camera.width : camera.height))});
  rows.push_back({"keyframes", format("%d, and %d erased", info.keyframes, info.erased_keyframes)});
  Eigen::AlignedBox3f box;
  for (const MapPointInfo& point : map.points()) box.extend(point.p_w);
  std::string extent;
  if (!box.isEmpty())
    extent = format(", within %.3g x %.3g x %.3g units", box.sizes().x(), box.sizes().y(), box.sizes().z());
  rows.push_back({"points", format("%d, measured %zu times", info.map_points, map.measurements().size()) + extent +
                                format("; %d of unknown depth", info.partial_points)});
  std::vector<float> errors = reprojection_errors(map);
  if (!errors.empty()) {
    const auto middle = errors.begin() + static_cast<ptrdiff_t>(errors.size() / 2);
    std::nth_element(errors.begin(), middle, errors.end());
    rows.push_back({"reprojection", format("%.2f px, median", *middle)});
  }
  print_rows(rows);
}

int export_map(const MapExportOptions& options) {
  if (options.ply.empty() && options.colmap.empty())
    throw InputError("map export: nothing to do, give --ply or --colmap; see pocket-ptam map export --help");
  const LoadedMap map(options.map);
  Inputs inputs;
  inputs.add("the map", options.map);
  if (!options.ply.empty()) check_output_file("--ply", options.ply, inputs, "a PLY file", is_sealed);
  std::optional<OutputFolder> folder;
  if (!options.colmap.empty()) {
    std::vector<std::string> names = {"cameras.txt", "images.txt", "points3D.txt"};
    for (const KeyframeInfo& keyframe : map.keyframes()) names.push_back("images/" + image_name(keyframe.id));
    folder.emplace(options.colmap, "--colmap", names, inputs);
    names.insert(names.end(), {"", "images", OutputFolder::kListName});
    for (const std::string& name : names) {
      if (!options.ply.empty() && same_place(folder->path(name), options.ply))
        throw InputError("--ply " + options.ply + ": is taken by --colmap " + options.colmap);
    }
    folder->prepare();
  }
  bool failed = false;
  const auto attempt = [&failed](const std::function<void()>& write) {
    try {
      write();
    } catch (const std::exception& error) {
      print_error(error.what());
      failed = true;
    }
  };
  if (!options.ply.empty()) {
    attempt([&] {
      write_text_atomically(options.ply, ply_text(map.points()));
      print_line(format("%zu points written to ", map.points().size()) + options.ply);
    });
  }
  if (folder) {
    attempt([&] {
      write_colmap(map, &*folder);
      print_line(format("%zu images and %zu points written to ", map.keyframes().size(), map.points().size()) +
                 options.colmap);
    });
  }
  return failed ? kExitBroken : kExitOk;
}

}  // namespace

Command add_map(CLI::App& program) {
  CLI::App* command = program.add_subcommand("map", "Look into a saved map, or take it to other programs");
  command->require_subcommand(1);
  const auto options = std::make_shared<MapExportOptions>();
  CLI::App* map_info = command->add_subcommand("info", "What is in it; exit code 2 if it is damaged");
  CLI::App* map_export = command->add_subcommand("export", "Write it for other programs");
  for (CLI::App* part : {map_info, map_export})
    part->add_option("map", options->map, "Saved by --save-map")->required()->type_name("FILE");
  map_export->add_option("--ply", options->ply, "The points, for MeshLab or CloudCompare")->type_name("OUT.ply");
  map_export
      ->add_option("--colmap", options->colmap,
                   "COLMAP's text model (cameras.txt, images.txt, points3D.txt) and the keyframes' images")
      ->type_name("DIR");
  map_info->footer("Example:\n  pocket-ptam map info desk.map");
  map_export->footer(
      "In COLMAP's model the measurements are corrected for the rolling shutter; the images are as they were.\n"
      "Examples:\n"
      "  pocket-ptam map export desk.map --ply desk.ply\n"
      "  pocket-ptam map export desk.map --colmap desk-colmap");
  command->footer(
      "Examples:\n"
      "  pocket-ptam sim --save-map desk.map\n"
      "  pocket-ptam map info desk.map\n"
      "  pocket-ptam map export desk.map --ply desk.ply --colmap desk-colmap");
  return {command, [options, map_info] {
            if (!map_info->parsed()) return export_map(*options);
            print_map_info(options->map);
            return kExitOk;
          }};
}

}  // namespace pptam::app
