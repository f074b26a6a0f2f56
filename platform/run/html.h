// The parts of our HTML pages: head, pictures inside the page, plots drawn by gnuplot.
#pragma once

#include <string>
#include <vector>

namespace pptam::platform {

std::string html_escaped(const std::string& text);
// The common head of our HTML pages, up to and including <body>.
std::string html_head(const std::string& title);

// A gnuplot script's picture in the house style, as SVG, and its HTML tag. Throws InputError without gnuplot.
std::string plot_svg(int width, int height, const std::string& script);
// A picture inside the page; type: image/png.
std::string image_tag(const std::string& type, const std::string& content, const std::string& alt);
std::string svg_tag(const std::string& svg, const std::string& alt);

}  // namespace pptam::platform
