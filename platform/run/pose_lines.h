// Poses as lines, one for each frame, as soon as it is tracked: to standard output, a file, a named pipe, or a UDP port
// of this computer. Tracking never waits for who reads: what a reader does not take in time is left out and counted.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include <pocket_ptam/pocket_ptam.h>

namespace pptam::platform {

enum class PoseFormat { kTum, kJson };

class PoseLines {
 public:
  // All throw InputError.
  static std::unique_ptr<PoseLines> to_descriptor(PoseFormat format, int fd);  // owned from now on
  // A new file, or a named pipe, whose readers may come and go. check_file() changes nothing.
  static void check_file(const std::string& path);
  static std::unique_ptr<PoseLines> to_file(PoseFormat format, const std::string& path);
  static std::unique_ptr<PoseLines> to_udp(PoseFormat format, int port);  // 127.0.0.1, a datagram for each line
  ~PoseLines();
  PoseLines(const PoseLines&) = delete;
  PoseLines& operator=(const PoseLines&) = delete;

  // TUM: frames with a pose only, and a comment "# map 2" before the first one in another map. JSON: every frame.
  // arrived_ns: when the frame's last line was there, by CLOCK_MONOTONIC; 0: unknown. False: the reader has gone, or
  // the disk is full (trouble()).
  bool add(const TrackResult& result, int64_t arrived_ns);
  int64_t left_out() const { return left_out_; }
  const std::string& trouble() const { return trouble_; }

 private:
  enum class Kind { kDescriptor, kPipe, kUdp };
  PoseLines(PoseFormat format, Kind kind, int fd, const std::string& path);
  bool write(const std::string& line);

  PoseFormat format_;
  Kind kind_;
  int fd_;
  std::string path_;
  int map_ = 0;  // of the last pose
  int64_t left_out_ = 0;
  std::string trouble_;
};

// With their line ends; the TUM line of a frame without a pose is empty. age_ns below 0: unknown.
std::string tum_line(const TrackResult& result);
std::string json_line(const TrackResult& result, int64_t age_ns);

}  // namespace pptam::platform
