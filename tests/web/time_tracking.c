// How long pptam_track() takes on this computer: time_tracking RECORDING, one of tests/bits. The recording is
// tracked again and again; of each tracked frame the shortest time counts, so that what else the computer does matters
// little. Prints the mean of these in microseconds, that of mapping after each frame, how many frames there are, and
// the hash of the map: the same run as track_time.mjs.
#define _POSIX_C_SOURCE 199309L
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include <pocket_ptam/pocket_ptam_c.h>

enum { RUNS = 15, MOST_FRAMES = 1000 };
static double track_us[MOST_FRAMES], map_us[MOST_FRAMES];

static double now_us(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return 1e6 * (double)t.tv_sec + 1e-3 * (double)t.tv_nsec;
}

int main(int argc, char** argv) {
  struct {
    pptam_camera camera;
    float exposure_s;
    int32_t frames, tracked, tells_stages;
    pptam_pose start;
  } head;
  FILE* file = argc == 2 ? fopen(argv[1], "rb") : NULL;
  if (!file || fread(&head, sizeof head, 1, file) != 1) return fprintf(stderr, "usage: time_tracking RECORDING\n"), 2;
  pptam_config config;
  pptam_config_phone(&head.camera, &config);
  config.exposure_s = head.exposure_s;
  const size_t bytes = pptam_required_bytes(&config);
  const size_t pixels = (size_t)head.camera.width * (size_t)head.camera.height;
  void* memory = malloc(bytes);
  uint8_t* image = malloc(pixels);
  int tracked = 0;
  uint64_t hash = 0;
  for (int run = 0; run < RUNS; ++run) {
    pptam_system* system = NULL;
    if (pptam_create(&config, memory, bytes, &system).code != PPTAM_OK) return 1;
    pptam_tap(system);
    if (fseek(file, sizeof head, SEEK_SET) != 0) return 1;
    int64_t timestamp_ns;
    tracked = 0;
    while (tracked < MOST_FRAMES && fread(&timestamp_ns, sizeof timestamp_ns, 1, file) == 1 &&
           fread(image, 1, pixels, file) == pixels) {
      const pptam_frame frame = {image, head.camera.width, head.camera.height, head.camera.width, PPTAM_PIXEL_GREY,
                                 timestamp_ns};
      pptam_track_result result;
      const double begun_us = now_us();
      if (pptam_track(system, &frame, &result).code != PPTAM_OK) return 1;
      const double tracked_us = now_us();
      for (int slice = 0; slice < 40 && pptam_has_work(system); ++slice) pptam_work_slice(system);
      if (result.state != PPTAM_TRACKING_TRACKING) continue;
      const double mapped_us = now_us();
      if (run == 0 || tracked_us - begun_us < track_us[tracked]) track_us[tracked] = tracked_us - begun_us;
      if (run == 0 || mapped_us - tracked_us < map_us[tracked]) map_us[tracked] = mapped_us - tracked_us;
      ++tracked;
    }
    hash = pptam_map_hash(system);
  }
  double tracking_us = 0, mapping_us = 0;
  for (int i = 0; i < tracked; ++i) tracking_us += track_us[i], mapping_us += map_us[i];
  printf("%.2f %.2f %d %016llx\n", tracking_us / tracked, mapping_us / tracked, tracked, (unsigned long long)hash);
  return 0;
}
