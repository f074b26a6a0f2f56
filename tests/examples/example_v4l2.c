// Tracks what a V4L2 camera sees and writes its position: a loop that reads a camera, with mapping in the idle time.
//
//   cc example_v4l2.c $(pkg-config --cflags --libs pocket-ptam) -lm -o example_v4l2
//   ./example_v4l2 /dev/video0 60                                    60: horizontal field of view, degrees
//
// For cameras that give YUYV at 640x480, as nearly all on USB do. Hold it still before something with texture, then
// move it sideways.
#include <errno.h>
#include <fcntl.h>
#include <linux/videodev2.h>
#include <math.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <pocket_ptam/pocket_ptam_c.h>

enum { kWidth = 320, kHeight = 240, kStep = 2, kBuffers = 4 };  // of the images tracked; every second pixel

static void die(const char* what) {
  fprintf(stderr, "example_v4l2: %s%s%s\n", what, errno ? ": " : "", errno ? strerror(errno) : "");
  exit(1);
}

// Opens the camera and starts it; its buffers' memory in *memory.
static int open_camera(const char* device, void* memory[kBuffers], int* stride) {
  const int camera = open(device, O_RDWR);
  if (camera < 0) die(device);
  struct v4l2_format format = {.type = V4L2_BUF_TYPE_VIDEO_CAPTURE};
  format.fmt.pix.width = kStep * kWidth;
  format.fmt.pix.height = kStep * kHeight;
  format.fmt.pix.pixelformat = V4L2_PIX_FMT_YUYV;
  if (ioctl(camera, VIDIOC_S_FMT, &format) < 0) die("no video camera");
  if (format.fmt.pix.pixelformat != V4L2_PIX_FMT_YUYV || format.fmt.pix.width != kStep * kWidth ||
      format.fmt.pix.height != kStep * kHeight)
    die("the camera does not give YUYV at 640x480");
  *stride = (int)format.fmt.pix.bytesperline;
  struct v4l2_requestbuffers request = {.count = kBuffers, .type = format.type, .memory = V4L2_MEMORY_MMAP};
  if (ioctl(camera, VIDIOC_REQBUFS, &request) < 0 || request.count < kBuffers) die("no buffers");
  for (unsigned i = 0; i < kBuffers; ++i) {
    struct v4l2_buffer buffer = {.index = i, .type = format.type, .memory = V4L2_MEMORY_MMAP};
    if (ioctl(camera, VIDIOC_QUERYBUF, &buffer) < 0) die("no buffer");
    memory[i] = mmap(NULL, buffer.length, PROT_READ, MAP_SHARED, camera, buffer.m.offset);
    if (memory[i] == MAP_FAILED || ioctl(camera, VIDIOC_QBUF, &buffer) < 0) die("no memory of a buffer");
  }
  int type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  if (ioctl(camera, VIDIOC_STREAMON, &type) < 0) die("the camera does not start");
  return camera;
}

int main(int argc, char** argv) {
  if (argc != 3) die("usage: example_v4l2 DEVICE FIELD_OF_VIEW");
  pptam_camera lens = {.width = kWidth,
                       .height = kHeight,
                       .cx = (kWidth * kStep - 1) / 2.0f / kStep,
                       .cy = (kHeight * kStep - 1) / 2.0f / kStep};
  lens.fx = lens.fy = (float)(kWidth / (2 * tan(atof(argv[2]) * 3.14159265 / 360)));
  pptam_config config;
  pptam_config_phone(&lens, &config);
  config.auto_start = true;
  const size_t bytes = pptam_required_bytes(&config);
  pptam_system* system = NULL;
  pptam_status status = pptam_create(&config, malloc(bytes), bytes, &system);
  if (status.code != PPTAM_OK) die(status.message);

  static uint8_t grey[kHeight][kWidth];
  void* memory[kBuffers];
  int stride = 0, hint = PPTAM_HINT_NONE;
  const int camera = open_camera(argv[1], memory, &stride);
  for (;;) {
    struct pollfd frame_waiting = {.fd = camera, .events = POLLIN};
    while (poll(&frame_waiting, 1, pptam_has_work(system) ? 0 : -1) == 0) pptam_work_slice(system);
    struct v4l2_buffer buffer = {.type = V4L2_BUF_TYPE_VIDEO_CAPTURE, .memory = V4L2_MEMORY_MMAP};
    if (ioctl(camera, VIDIOC_DQBUF, &buffer) < 0) die("the camera is gone");
    for (int y = 0; y < kHeight; ++y)
      for (int x = 0; x < kWidth; ++x)
        grey[y][x] = ((const uint8_t*)memory[buffer.index])[kStep * y * stride + 2 * kStep * x];
    if (ioctl(camera, VIDIOC_QBUF, &buffer) < 0) die("the camera is gone");
    const pptam_frame frame = {
        grey[0], kWidth,           kHeight,
        kWidth,  PPTAM_PIXEL_GREY, buffer.timestamp.tv_sec * 1000000000LL + buffer.timestamp.tv_usec * 1000LL};
    pptam_track_result result;
    status = pptam_track(system, &frame, &result);
    if (status.code != PPTAM_OK) fprintf(stderr, "%s\n", status.message);
    if (result.hint != hint) fprintf(stderr, "%s\n", pptam_hint_text(hint = result.hint));
    float t[3], q[4];
    if (result.pose_valid && pptam_inverse_as_quaternion(&result.T_cw, t, q).code == PPTAM_OK)
      printf("%.3f %.4f %.4f %.4f\n", 1e-9 * (double)frame.timestamp_ns, (double)t[0], (double)t[1], (double)t[2]);
  }
}
