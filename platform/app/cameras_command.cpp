// pocket-ptam cameras: what can be used live.

#include <cstdio>
#include <map>

#include "platform/app/commands.h"
#include "platform/camera/camera_list.h"
#include "platform/run/console.h"
#include "platform/text.h"

namespace pptam::app {
namespace {

using namespace platform;

std::string rates_text(const CameraMode& mode) {
  if (mode.frames_per_s.empty()) return "";
  std::string text;
  for (const double rate : mode.frames_per_s) text += (text.empty() ? "" : ", ") + format("%.4g", rate);
  return " at " + text + " frames/s";
}

int list_all() {
  const CameraList found = list_cameras();
  for (const CameraDescription& camera : found.cameras) {
    print_line(camera.address + "  " + camera.name + " (" + camera.driver + ")");
    if (camera.modes.empty()) print_line("  no format that can be read: GREY, NV12, YU12, YUYV, MJPG");
    for (const CameraMode& mode : camera.modes)
      print_line(format("  %-4s %dx%d", mode.format.c_str(), mode.width, mode.height) + rates_text(mode));
  }
  for (const std::string& remark : found.remarks) print_warning(remark);
  if (!found.cameras.empty()) return kExitOk;
  print_error("there is no camera here: plug one in, and see what dmesg says of it");
  return kExitBroken;
}

}  // namespace

Command add_cameras(CLI::App& program) {
  CLI::App* cameras = program.add_subcommand("cameras", "List the cameras for live, with sizes and rates");
  cameras->footer(
      "The address in front is what live --camera takes; the first one is used when none is named.\n"
      "Exit code 1 when there is none.\n"
      "Example:\n"
      "  pocket-ptam cameras && pocket-ptam live --fov 60");
  return {cameras, [] { return list_all(); }};
}

}  // namespace pptam::app
