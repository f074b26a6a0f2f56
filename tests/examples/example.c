// Tracks grey frames from standard input and writes the camera's poses in TUM's form (seconds, position, quaternion).
//
//   cc example.c $(pkg-config --cflags --libs pocket-ptam) -o example
//   ffmpeg -v error -i clip.mp4 -f rawvideo -pix_fmt gray - | ./example camera.txt times.txt > trajectory.txt
//
// camera.txt: width height fx fy cx cy axis line_time_s exposure_s, as in pptam_camera and pptam_config.
// times.txt: a line for each frame, seconds with nine decimals.
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>

#include <pocket_ptam/pocket_ptam_c.h>

static int fail(const char* message) {
  fprintf(stderr, "example: %s\n", message);
  return 1;
}

int main(int argc, char** argv) {
  if (argc != 3) return fail("usage: example camera.txt times.txt < frames");
  FILE* camera_file = fopen(argv[1], "r");
  FILE* times = fopen(argv[2], "r");
  if (!camera_file || !times) return fail("camera.txt or times.txt cannot be opened");
  pptam_camera camera = {0};
  float exposure_s = 0;
  if (fscanf(camera_file, "%" SCNd32 "%" SCNd32 "%f%f%f%f%" SCNd32 "%f%f", &camera.width, &camera.height, &camera.fx,
             &camera.fy, &camera.cx, &camera.cy, &camera.shutter_axis, &camera.line_time_s, &exposure_s) != 9)
    return fail("camera.txt: 9 numbers are needed");

  pptam_config config;
  pptam_config_phone(&camera, &config);
  config.exposure_s = exposure_s;
  pptam_status status = pptam_config_validate(&config);
  if (status.code != PPTAM_OK) return fail(status.message);
  const size_t bytes = pptam_required_bytes(&config);
  pptam_system* system = NULL;
  status = pptam_create(&config, malloc(bytes), bytes, &system);
  if (status.code != PPTAM_OK) return fail(status.message);
  pptam_tap(system);  // the first frame is the first view

  const size_t pixels = (size_t)camera.width * (size_t)camera.height;
  uint8_t* image = malloc(pixels);
  int64_t s, ns, first_ns = -1, waited_ns = 0;
  while (image && fread(image, 1, pixels, stdin) == pixels && fscanf(times, "%" SCNd64 ".%9" SCNd64, &s, &ns) == 2) {
    const int64_t now_ns = s * 1000000000 + ns;
    if (first_ns < 0) first_ns = now_ns;
    // Until the frame arrives the map is worked on. Time is what the work takes on the modelled phone, so that every
    // run is the same; a program with a camera works until the camera has the next frame.
    while (pptam_work_ns(system) + waited_ns < now_ns - first_ns && pptam_has_work(system)) pptam_work_slice(system);
    const int64_t idle_ns = now_ns - first_ns - (pptam_work_ns(system) + waited_ns);
    if (idle_ns > 0) waited_ns += idle_ns;

    const pptam_frame frame = {image, camera.width, camera.height, camera.width, PPTAM_PIXEL_GREY, now_ns};
    pptam_track_result result;
    status = pptam_track(system, &frame, &result);
    if (status.code != PPTAM_OK) return fail(status.message);
    if (!result.pose_valid) continue;
    float t[3], q[4];
    pptam_inverse_as_quaternion(&result.T_cw, t, q);
    printf("%" PRId64 ".%09" PRId64 " %.9g %.9g %.9g %.9g %.9g %.9g %.9g\n", s, ns, (double)t[0], (double)t[1],
           (double)t[2], (double)q[0], (double)q[1], (double)q[2], (double)q[3]);
  }
  fprintf(stderr, "map hash %016" PRIx64 "\n", pptam_map_hash(system));
  return 0;
}
