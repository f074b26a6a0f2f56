// What example.c does, by the C++ interface: see there. Built by cmake_project/CMakeLists.txt.
#include <cinttypes>
#include <cstdio>
#include <vector>

#include <pocket_ptam/inspection.h>
#include <pocket_ptam/pocket_ptam.h>

static int fail(const char* message) {
  std::fprintf(stderr, "example: %s\n", message);
  return 1;
}

int main(int argc, char** argv) {
  if (argc != 3) return fail("usage: example camera.txt times.txt < frames");
  std::FILE* camera_file = std::fopen(argv[1], "r");
  std::FILE* times = std::fopen(argv[2], "r");
  if (!camera_file || !times) return fail("camera.txt or times.txt cannot be opened");
  pptam::CameraModel lens;
  pptam::RollingShutter shutter;
  int columns = 0;
  float exposure_s = 0;
  if (std::fscanf(camera_file, "%d%d%f%f%f%f%d%f%f", &lens.width, &lens.height, &lens.fx, &lens.fy, &lens.cx, &lens.cy,
                  &columns, &shutter.line_time_s, &exposure_s) != 9)
    return fail("camera.txt: 9 numbers are needed");
  shutter.axis = columns ? pptam::RollingShutter::Axis::kColumns : pptam::RollingShutter::Axis::kRows;

  pptam::Config config = pptam::Config::phone(lens);
  config.camera.shutter = shutter;
  config.exposure_s = exposure_s;
  std::vector<std::byte> memory(pptam::System::required_bytes(config));
  pptam::System* system = nullptr;
  const pptam::Status status = pptam::System::create(config, memory, &system);
  if (!status.ok()) return fail(status.message());
  system->tap();  // the first frame is the first view

  std::vector<uint8_t> image(static_cast<size_t>(lens.width) * static_cast<size_t>(lens.height));
  pptam::WorkClock clock(system->work_meter());
  int64_t s = 0, ns = 0, first_ns = -1;
  while (std::fread(image.data(), 1, image.size(), stdin) == image.size() &&
         std::fscanf(times, "%" SCNd64 ".%9" SCNd64, &s, &ns) == 2) {
    const int64_t now_ns = s * 1000000000 + ns;
    if (first_ns < 0) first_ns = now_ns;
    while (clock.now_ns() < now_ns - first_ns && system->has_work()) system->work_slice();
    clock.idle_until(now_ns - first_ns);
    const pptam::TrackResult result =
        system->track({image.data(), lens.width, lens.height, lens.width, pptam::PixelFormat::kGrey, now_ns});
    if (!result.status.ok()) return fail(result.status.message());
    if (!result.pose_valid) continue;
    const pptam::SE3 T_wc = result.T_cw.inverse();
    Eigen::Quaternionf q(T_wc.R);
    if (q.w() < 0) q.coeffs() = -q.coeffs();
    std::printf("%" PRId64 ".%09" PRId64, s, ns);
    for (const float number : {T_wc.t.x(), T_wc.t.y(), T_wc.t.z(), q.x(), q.y(), q.z(), q.w()})
      std::printf(" %.9g", static_cast<double>(number));
    std::printf("\n");
  }
  std::fprintf(stderr, "map hash %016" PRIx64 "\n", pptam::map_hash(*system));
  return 0;
}
