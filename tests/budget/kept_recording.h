// A sequence of the emulated phone that is rendered once for several processors: an emulator takes minutes to paint a
// scene. PPTAM_RECORDINGS names a folder for them, which tests/run.sh makes anew; without it the sequence is rendered.
#pragma once

#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>

#include "sim_phone/scene.h"
#include "tests/support/recording.h"

namespace pptam::test {

// Frames of 8-bit grey, each after its timestamp; empty when the file is not there or not whole.
inline Recording read_recording(const std::filesystem::path& file, const platform::CameraInfo& info) {
  Recording recording;
  recording.info = info;
  std::ifstream in(file, std::ios::binary);
  std::vector<uint8_t> image(static_cast<size_t>(info.model.width) * static_cast<size_t>(info.model.height));
  for (int64_t timestamp_ns = 0; in.read(reinterpret_cast<char*>(&timestamp_ns), sizeof timestamp_ns);) {
    if (!in.read(reinterpret_cast<char*>(image.data()), static_cast<std::streamsize>(image.size()))) return {};
    recording.timestamps_ns.push_back(timestamp_ns);
    recording.images.push_back(image);
  }
  return recording;
}

inline void write_recording(const std::filesystem::path& file, const Recording& recording) {
  std::filesystem::create_directories(file.parent_path());
  std::filesystem::path draft = file;  // two tests may write at once
  draft += "." + std::to_string(reinterpret_cast<uintptr_t>(&recording));
  {
    std::ofstream out(draft, std::ios::binary);
    for (size_t i = 0; i < recording.images.size(); ++i) {
      out.write(reinterpret_cast<const char*>(&recording.timestamps_ns[i]), sizeof recording.timestamps_ns[i]);
      out.write(reinterpret_cast<const char*>(recording.images[i].data()),
                static_cast<std::streamsize>(recording.images[i].size()));
    }
  }
  std::filesystem::rename(draft, file);
}

// Without ground truth when it was kept.
inline Recording kept_recording(const std::string& name, const sim::PhoneOptions& options) {
  const char* const folder = std::getenv("PPTAM_RECORDINGS");
  if (folder == nullptr) return record(options);
  const std::filesystem::path file = std::filesystem::path(folder) / (name + ".frames");
  // An empty scene takes no time, and tells all of the camera but its images.
  const auto camera = sim::make_phone_camera(options, std::make_shared<const sim::Scene>());
  Recording recording = read_recording(file, camera->info());
  if (recording.size() > 0) return recording;
  recording = record(options);
  write_recording(file, recording);
  return recording;
}

inline sim::PhoneOptions desk_options() {
  sim::PhoneOptions options;
  options.duration_s = 6;
  return options;
}
// Without a dominant plane, where the search for the motion costs most.
inline sim::PhoneOptions clutter_options() {
  sim::PhoneOptions options;
  options.scene = "clutter";
  options.motion = "start";
  options.duration_s = 4.5;
  return options;
}

}  // namespace pptam::test
