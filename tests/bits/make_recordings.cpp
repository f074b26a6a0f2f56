// Renders what the library is to give the same bits of on all processors: make_recordings FOLDER board|table|quick.
//   board   desk.frames and tiny.frames, 5 s each, for the microcontroller's test, and what they give here (.result)
//   table   five stories of 20 s, one for the desktop profile, one seen by a small camera, and a known object: for
//           tests/bits/table.sh
//   quick   the last two of these
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

#include "c_interface/conversions.h"
#include "sim_phone/phone_camera.h"
#include "sim_phone/story.h"
#include "tests/bits/run.h"
#include "tests/bits/run_here.h"
#include "tests/support/rendered_object.h"

namespace pptam::test {
namespace {

// A small camera of a microcontroller, turned as the phone is: sim_phone/profiles/cortex_m7_tiny.yaml.
void use_small_camera(sim::PhoneOptions* options) {
  options->width = 120;
  options->height = 160;
  options->readout_s = 0.030;
  options->exposure_s = 0.020;
}

class Frames {
 public:
  void add(int64_t timestamp_ns, const GreyView& image) {
    bytes_.write(reinterpret_cast<const char*>(&timestamp_ns), sizeof timestamp_ns);
    for (int y = 0; y < image.height; ++y) bytes_.write(reinterpret_cast<const char*>(image.row(y)), image.width);
    ++count_;
  }
  void write(const std::filesystem::path& file, RecordingHead head) const {
    head.frames = count_;
    std::ofstream out(file, std::ios::binary);
    out.write(reinterpret_cast<const char*>(&head), sizeof head);
    out << bytes_.str();
    if (!out.flush()) throw std::runtime_error(file.string() + " cannot be written");
  }

 private:
  std::ostringstream bytes_;
  int32_t count_ = 0;
};

void record_phone(const sim::PhoneOptions& options, Tracked tracked, bool tells, const std::filesystem::path& file) {
  const auto camera = sim::make_phone_camera(options);
  const platform::CameraInfo& info = camera->info();
  RecordingHead head = {};
  head.camera = c::to_c(Camera{info.model, info.shutter});
  head.exposure_s = info.exposure_s;
  head.tracked = tracked;
  head.tells_stages = tells ? 1 : 0;
  Frames frames;
  for (Frame frame; camera->read(&frame);)
    frames.add(frame.timestamp_ns, {frame.data, frame.width, frame.height, frame.stride_bytes});
  frames.write(file, head);
}

SE3 swaying(float t_s) {
  Vector6f mu;
  mu << 0, 0, 0, 0.5f + 0.3f * std::sin(0.9f * t_s), 0.5f - 0.25f * std::sin(0.7f * t_s), 0.2f * std::sin(t_s);
  SE3 T = SE3::exp(mu);
  T.t = Vector3f(0.04f * std::sin(1.1f * t_s), 0.03f * std::sin(0.8f * t_s), 0.55f);
  return T;
}

void record_object(const std::filesystem::path& file) {
  const pptam_object_arrays arrays = known_object();
  RenderedObject object;
  for (size_t i = 0; i < arrays.point_count; ++i)
    object.points.emplace_back(arrays.points[3 * i], arrays.points[3 * i + 1], arrays.points[3 * i + 2]);
  object.corners.assign(arrays.corners, arrays.corners + arrays.corner_count);
  for (size_t i = 0; i < arrays.face_count; ++i) {
    ModelFace face;
    face.first = arrays.faces[i].first;
    face.count = arrays.faces[i].count;
    object.faces.push_back(face);
  }
  object.cylinders.push_back({arrays.cylinders->a, arrays.cylinders->b, arrays.cylinders->radius, 0});
  object.spheres.push_back({c::vector3_from(arrays.spheres->centre), arrays.spheres->radius});
  Camera camera;
  camera.model.width = 160;
  camera.model.height = 120;
  camera.model.fx = camera.model.fy = 160;
  camera.model.cx = 79.5f;
  camera.model.cy = 59.5f;
  camera.model.prepare();
  RecordingHead head = {};
  head.camera = c::to_c(camera);
  head.tracked = Tracked::kModel;
  head.tells_stages = 1;
  head.start = c::to_c(swaying(0));
  Frames frames;
  for (int i = 0; i < 150; ++i) {
    const std::vector<uint8_t> image = object.render(camera, swaying(static_cast<float>(i) / 30));
    frames.add(int64_t{i + 1} * 33333333, {image.data(), camera.model.width, camera.model.height, camera.model.width});
  }
  frames.write(file, head);
}

// For the board's test: what comes out here, and that one changed pixel is noticed.
bool note_result(const std::filesystem::path& file) {
  const std::string result = run_here(file, -1).result;
  std::cout << "here: " << result;
  std::ofstream(std::filesystem::path(file).replace_extension(".result")) << result;
  if (result.empty()) return false;
  const std::string changed = run_here(file, 10).result;
  if (!changed.empty() && changed != result) return true;
  std::cout << "FAILED: one pixel of an early frame changes nothing: nothing is compared\n";
  return false;
}

int make_for_board(const std::filesystem::path& folder) {
  sim::PhoneOptions desk;
  desk.duration_s = 5;
  record_phone(desk, Tracked::kBoard, false, folder / "desk.frames");
  use_small_camera(&desk);
  record_phone(desk, Tracked::kTiny, false, folder / "tiny.frames");
  return note_result(folder / "desk.frames") && note_result(folder / "tiny.frames") ? 0 : 1;
}

int make_for_table(const std::filesystem::path& folder, bool quick) {
  const auto story = [&](const char* name, const char* file, Tracked tracked, double duration_s = 20) {
    sim::PhoneOptions options = sim::phone_for_story(name, 1);
    options.duration_s = duration_s;
    if (tracked == Tracked::kTiny) use_small_camera(&options);
    record_phone(options, tracked, true, folder / file);
  };
  if (!quick) {
    // Exploring, losing the view and finding it again, many new views, a lamp's bands; the last on little memory.
    story("desk_calm", "desk.frames", Tracked::kBoard);
    story("orbit", "orbit.frames", Tracked::kPhone);
    story("two_walls", "walls.frames", Tracked::kPhone);
    story("shake", "shake.frames", Tracked::kPhone);
    story("bands_100", "bands.frames", Tracked::kPhone);
    story("corner2007", "desktop.frames", Tracked::kDesktop, 5);  // 150 frames of 600x480
  }
  story("desk_calm", "tiny.frames", Tracked::kTiny);
  record_object(folder / "model.frames");
  return 0;
}

int run(const std::filesystem::path& folder, const std::string& which) {
  std::filesystem::create_directories(folder);
  return which == "board" ? make_for_board(folder) : make_for_table(folder, which == "quick");
}

}  // namespace
}  // namespace pptam::test

int main(int argc, char** argv) {
  const std::string which = argc == 3 ? argv[2] : "";
  if (which != "board" && which != "table" && which != "quick") {
    std::cerr << "usage: make_recordings FOLDER board|table|quick\n";
    return 2;
  }
  return pptam::test::run(argv[1], which);
}
