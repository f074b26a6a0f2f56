// How long pptam_track() takes on this computer: time_tracking RECORDING, one of tests/bare_metal. Prints the mean of
// the tracked frames in microseconds, mapping left out; the same run as track_time.mjs.
#define _POSIX_C_SOURCE 199309L
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include <pocket_ptam/pocket_ptam_c.h>

static double now_us(void) {
  struct timespec t;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return 1e6 * (double)t.tv_sec + 1e-3 * (double)t.tv_nsec;
}

int main(int argc, char** argv) {
  struct {
    pptam_camera camera;
    float exposure_s;
    int32_t frames;
  } head;
  FILE* file = argc == 2 ? fopen(argv[1], "rb") : NULL;
  if (!file || fread(&head, sizeof head, 1, file) != 1) return fprintf(stderr, "usage: time_tracking RECORDING\n"), 2;
  pptam_config config;
  pptam_config_phone(&head.camera, &config);
  config.exposure_s = head.exposure_s;
  const size_t bytes = pptam_required_bytes(&config);
  pptam_system* system = NULL;
  if (pptam_create(&config, malloc(bytes), bytes, &system).code != PPTAM_OK) return 1;
  pptam_tap(system);
  const size_t pixels = (size_t)head.camera.width * (size_t)head.camera.height;
  uint8_t* image = malloc(pixels);
  double tracking_us = 0, mapping_us = 0;
  int tracked = 0;
  int64_t timestamp_ns;
  while (fread(&timestamp_ns, sizeof timestamp_ns, 1, file) == 1 && fread(image, 1, pixels, file) == pixels) {
    const pptam_frame frame = {image, head.camera.width, head.camera.height, head.camera.width, PPTAM_PIXEL_GREY,
                               timestamp_ns};
    pptam_track_result result;
    const double begun_us = now_us();
    if (pptam_track(system, &frame, &result).code != PPTAM_OK) return 1;
    const double tracked_us = now_us();
    for (int slice = 0; slice < 40 && pptam_has_work(system); ++slice) pptam_work_slice(system);
    if (result.state != PPTAM_TRACKING_TRACKING) continue;
    ++tracked;
    tracking_us += tracked_us - begun_us;
    mapping_us += now_us() - tracked_us;
  }
  printf("%.2f %.2f %d %016llx\n", tracking_us / tracked, mapping_us / tracked, tracked,
         (unsigned long long)pptam_map_hash(system));
  return 0;
}
