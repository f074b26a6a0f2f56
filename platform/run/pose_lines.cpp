#include "platform/run/pose_lines.h"

#include <arpa/inet.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <Eigen/Geometry>
#include <cerrno>
#include <cinttypes>
#include <cstring>
#include <filesystem>
#include <utility>

#include "platform/camera/dump_sequence.h"
#include "platform/input_error.h"
#include "platform/run/clocks.h"
#include "platform/run/names.h"
#include "platform/run/run_log.h"
#include "platform/text.h"

namespace pptam::platform {

std::string tum_line(const TrackResult& result) {
  if (!result.pose_valid) return "";
  return tum_text({{result.timestamp_ns, camera_to_world(result.T_cw)}}, "");
}

std::string json_line(const TrackResult& result, int64_t age_ns) {
  std::string line = "{\"t\":" + timestamp_name(result.timestamp_ns) + ",\"state\":\"" + name_of(result.state) +
                     "\",\"quality\":\"" + name_of(result.quality) + "\"";
  if (result.hint != Hint::kNone) line += std::string(",\"hint\":\"") + name_of(result.hint) + "\"";
  if (result.pose_valid) {
    const Eigen::Isometry3d T_wc = camera_to_world(result.T_cw);
    Eigen::Quaterniond q(T_wc.linear());
    q.normalize();
    if (q.w() < 0) q.coeffs() = -q.coeffs();
    const Eigen::Vector3d p = T_wc.translation();
    line +=
        format(",\"p\":[%.9g,%.9g,%.9g],\"q\":[%.9g,%.9g,%.9g,%.9g]", p.x(), p.y(), p.z(), q.x(), q.y(), q.z(), q.w());
  }
  if (result.map > 0) line += format(",\"map\":%d", result.map);
  line += format(",\"points\":%d,\"keyframes\":%d", result.points_inliers, result.keyframes);
  if (age_ns >= 0) line += format(",\"age_ms\":%.2f", 1e-6 * static_cast<double>(age_ns));
  return line + "}\n";
}

PoseLines::PoseLines(PoseFormat format, Kind kind, int fd, const std::string& path)
    : format_(format), kind_(kind), fd_(fd), path_(path) {}

PoseLines::~PoseLines() {
  if (fd_ >= 0) ::close(fd_);
}

std::unique_ptr<PoseLines> PoseLines::to_descriptor(PoseFormat format, int fd) {
  return std::unique_ptr<PoseLines>(new PoseLines(format, Kind::kDescriptor, fd, "standard output"));
}

void PoseLines::check_file(const std::string& path) {
  struct stat info = {};
  if (::stat(path.c_str(), &info) == 0 && !S_ISFIFO(info.st_mode))
    throw InputError("--to " + path + ": exists; name a new file, or a named pipe (mkfifo)");
  const std::filesystem::path folder = std::filesystem::path(path).parent_path();
  std::error_code ignored;
  if (!folder.empty() && !std::filesystem::is_directory(folder, ignored))
    throw InputError("--to " + path + ": there is no folder " + folder.string() + ", make it first");
}

std::unique_ptr<PoseLines> PoseLines::to_file(PoseFormat format, const std::string& path) {
  check_file(path);
  struct stat info = {};
  if (::stat(path.c_str(), &info) == 0)  // opened once somebody reads
    return std::unique_ptr<PoseLines>(new PoseLines(format, Kind::kPipe, -1, path));
  const int fd = ::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
  if (fd < 0) throw InputError("--to " + path + ": " + std::strerror(errno));
  return std::unique_ptr<PoseLines>(new PoseLines(format, Kind::kDescriptor, fd, path));
}

std::unique_ptr<PoseLines> PoseLines::to_udp(PoseFormat format, int port) {
  sockaddr_in address = {};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<uint16_t>(port));
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  const int fd = ::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
  if (fd < 0 || ::connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) {
    const int error = errno;
    if (fd >= 0) ::close(fd);
    throw InputError(platform::format("--udp %d: ", port) + std::strerror(error));
  }
  return std::unique_ptr<PoseLines>(new PoseLines(format, Kind::kUdp, fd, "udp"));
}

bool PoseLines::add(const TrackResult& result, int64_t arrived_ns) {
  std::string line;
  if (format_ == PoseFormat::kTum) {
    line = tum_line(result);
    if (result.pose_valid && map_ != 0 && result.map != map_) line = platform::format("# map %d\n", result.map) + line;
    if (result.pose_valid) map_ = result.map;
  } else {
    line = json_line(result, arrived_ns == 0 ? -1 : saturated_difference(SteadyClock().now_ns(), arrived_ns));
  }
  return line.empty() || write(line);
}

// A line is shorter than what a pipe takes at once (PIPE_BUF): it is written whole or not at all.
bool PoseLines::write(const std::string& line) {
  if (kind_ == Kind::kUdp) {  // nobody may listen yet: that is no error
    if (::send(fd_, line.data(), line.size(), MSG_DONTWAIT | MSG_NOSIGNAL) < 0) ++left_out_;
    return true;
  }
  if (kind_ == Kind::kPipe && fd_ < 0) {
    fd_ = ::open(path_.c_str(), O_WRONLY | O_NONBLOCK | O_CLOEXEC);
    struct stat info = {};
    if (fd_ >= 0 && (::fstat(fd_, &info) != 0 || !S_ISFIFO(info.st_mode))) {  // somebody's file is there now
      ::close(std::exchange(fd_, -1));
      trouble_ = "--to " + path_ + ": is no named pipe any more";
      return false;
    }
  }
  pollfd writable = {fd_, POLLOUT, 0};
  if (fd_ < 0 || ::poll(&writable, 1, 0) < 1) {
    ++left_out_;
    return true;
  }
  size_t done = 0;
  while (done < line.size()) {
    const ssize_t written = ::write(fd_, line.data() + done, line.size() - done);
    if (written > 0) {
      done += static_cast<size_t>(written);
    } else if (written == 0 || errno != EINTR) {
      break;
    }
  }
  if (done == line.size()) return true;
  ++left_out_;
  if (kind_ == Kind::kPipe) {  // the reader has gone, another may come
    ::close(std::exchange(fd_, -1));
    return true;
  }
  if (errno == EAGAIN) return true;
  trouble_ = path_ + ": " + (errno == EPIPE ? "nobody reads the poses any more" : std::strerror(errno));
  return false;
}

}  // namespace pptam::platform
