#include "platform/run/html.h"

#include <stdlib.h>
#include <unistd.h>

#include <cstdint>
#include <filesystem>

#include "platform/child_process.h"
#include "platform/input_error.h"
#include "platform/run/console.h"
#include "platform/text.h"

namespace pptam::platform {
namespace {

std::string base64(const std::string& bytes) {
  static constexpr char kDigits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  text.reserve((bytes.size() + 2) / 3 * 4);
  for (size_t i = 0; i < bytes.size(); i += 3) {
    uint32_t group = 0;
    for (size_t k = 0; k < 3; ++k)
      group = group << 8 | (i + k < bytes.size() ? static_cast<uint8_t>(bytes[i + k]) : 0u);
    for (size_t k = 0; k < 4; ++k) text += i + k <= bytes.size() ? kDigits[group >> (18 - 6 * k) & 63] : '=';
  }
  return text;
}

// A script file that goes away with the object.
class TemporaryFile {
 public:
  explicit TemporaryFile(const std::string& content) {
    std::error_code error;
    std::filesystem::path folder = std::filesystem::temp_directory_path(error);
    if (error) folder = "/tmp";
    std::string name = (folder / "pocket-ptam-XXXXXX").string();
    const int fd = mkstemp(name.data());
    if (fd < 0) throw InputError(name + ": cannot make a temporary file");
    path_ = name;
    const ssize_t written = ::write(fd, content.data(), content.size());
    close(fd);
    if (written != static_cast<ssize_t>(content.size())) {
      unlink(name.c_str());
      throw InputError(name + ": cannot write a temporary file");
    }
  }
  ~TemporaryFile() {
    std::error_code ignored;
    std::filesystem::remove(path_, ignored);
  }
  TemporaryFile(const TemporaryFile&) = delete;
  TemporaryFile& operator=(const TemporaryFile&) = delete;
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

std::string run_gnuplot(const std::string& script) {
  const TemporaryFile file(script);
  ChildProcess gnuplot({"gnuplot", file.path().string()}, ChildProcess::Pipe::kReadStdout);
  std::string svg;
  char buffer[65536];
  while (const size_t bytes = gnuplot.read(buffer, sizeof buffer)) svg.append(buffer, bytes);
  if (gnuplot.finish() != 0) throw InputError("gnuplot failed: " + gnuplot.errors());
  return svg;
}

std::string plot_head(int width, int height) {
  return format(
      "set terminal svg size %d,%d dynamic enhanced font 'sans,13' background '#ffffff'\n"
      "set border 3 lc rgb '#777777'\nset tics nomirror textcolor rgb '#444444'\nset grid lc rgb '#e4e6ea' lt 1\n"
      "set key top left reverse Left opaque box lc rgb '#dddddd' samplen 1.5 font ',12'\n"
      "set style fill solid 0.85 noborder\n",
      width, height);
}

}  // namespace

std::string plot_svg(int width, int height, const std::string& script) {
  return run_gnuplot(plot_head(width, height) + script);
}

std::string svg_tag(const std::string& svg, const std::string& alt) {
  return image_tag("image/svg+xml", svg, alt);
}

std::string image_tag(const std::string& type, const std::string& content, const std::string& alt) {
  return "<img alt=\"" + html_escaped(alt) + "\" src=\"data:" + type + ";base64," + base64(content) + "\">";
}

std::string html_escaped(const std::string& text) {
  std::string escaped;
  for (const char c : printable(text)) {
    switch (c) {
      case '&':
        escaped += "&amp;";
        break;
      case '<':
        escaped += "&lt;";
        break;
      case '>':
        escaped += "&gt;";
        break;
      case '"':
        escaped += "&quot;";
        break;
      case '\'':
        escaped += "&#39;";
        break;
      default:
        escaped += c;
    }
  }
  return escaped;
}

std::string html_head(const std::string& title) {
  return "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\n"
         "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>" +
         html_escaped(title) +
         "</title>\n<style>\n"
         "body{font:16px/1.5 system-ui,sans-serif;color:#1d2026;background:#f5f6f8;margin:0;padding:2rem 1rem}\n"
         "main{max-width:1160px;margin:auto}\nh1{font-size:1.6rem;margin:0 0 1rem}\nh2{font-size:1.1rem;margin:0 0 "
         ".6rem}\n"
         "section{background:#fff;border:1px solid #e1e4e8;border-radius:10px;padding:1.1rem "
         "1.3rem;margin-bottom:1.2rem}\n"
         "table{border-collapse:collapse}\nth,td{text-align:left;padding:.28rem 1.1rem .28rem 0;vertical-align:top}\n"
         "th{font-weight:500;color:#5b6370}\n.wide td,.wide th{text-align:right;border-bottom:1px solid #eceef1}\n"
         ".wide td:first-child,.wide th:first-child{text-align:left}\n.total td{font-weight:600;background:#f5f6f8}\n"
         "img{max-width:100%;height:auto;display:block}\n.side{display:flex;flex-wrap:wrap;gap:2rem}\n"
         ".side img{max-height:460px;width:auto;border-radius:6px}\n"
         "code{background:#eef0f3;padding:.5rem .7rem;border-radius:6px;display:block;overflow-x:auto}\n"
         "p{margin:.5rem 0 0;color:#5b6370;font-size:.93rem}\n</style></head>\n<body><main>\n";
}

}  // namespace pptam::platform
