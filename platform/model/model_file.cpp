#include "platform/model/model_file.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "platform/input_error.h"
#include "platform/text.h"
#include "platform/text_file.h"

namespace pptam::platform {
namespace {

constexpr size_t kMaxFiles = 64;                       // that a model loads, itself included
constexpr size_t kMaxDepth = 8;                        // of files that load files
constexpr size_t kMaxEntries = 4096;                   // points, and lines and sides of faces, of all files together
constexpr size_t kMaxFacets = 2048, kMaxRound = 1024;  // faces; cylinders, circles and spheres each
constexpr int kMaxObjVertices = 100000;
constexpr size_t kMaxModelBytes = size_t{8} << 20;  // of all files together

// The lines of a text that hold something, without comments, and errors that name them. What it gives out are views of
// the text that it keeps: a hostile file costs no more memory than its bytes.
class Lines {
 public:
  explicit Lines(const std::filesystem::path& file) : Lines(read_text(file, kMaxModelBytes), file) {}
  Lines(std::string text, const std::filesystem::path& file) : name_(file.string()), text_(std::move(text)) {
    find_next();
  }
  Lines(const Lines&) = delete;
  Lines& operator=(const Lines&) = delete;
  size_t bytes() const { return text_.size(); }
  bool at_end() const { return next_.empty(); }
  std::string_view peek() const { return next_; }
  // The next line, which holds `what`.
  std::string_view take(const std::string& what) {
    if (at_end()) fail_at_end("the file ends where there should be " + what);
    const std::string_view line = next_;
    taken_ = number_;
    find_next();
    return line;
  }
  // Of the whole text.
  [[noreturn]] void fail_at_end(const std::string& what) const {
    throw InputError(format("%s:%d: %s", name_.c_str(), std::max(1, number_), what.c_str()));
  }
  // Of the line that was taken last.
  [[noreturn]] void fail(const std::string& what) const {
    throw InputError(format("%s:%d: %s", name_.c_str(), std::max(1, taken_), what.c_str()));
  }

 private:
  void find_next() {
    next_ = {};
    while (next_.empty() && begin_ < text_.size()) {
      const size_t end = std::min(text_.find('\n', begin_), text_.size());
      const std::string_view line = std::string_view(text_).substr(begin_, end - begin_);
      ++number_;
      if (line.size() > kMaxLineBytes)
        throw InputError(format("%s:%d: a line of more than 64 kB", name_.c_str(), number_));
      next_ = trimmed(line.substr(0, line.find('#')));
      begin_ = end + 1;
    }
  }

  std::string name_, text_;
  size_t begin_ = 0;            // of what has not been looked at
  std::string_view next_;       // empty: there is none
  int number_ = 0, taken_ = 0;  // of the line looked at last, and of the one taken last, counted from 1
};

std::vector<std::string_view> words_of(std::string_view line) {
  std::vector<std::string_view> words;
  for (size_t i = 0; i < line.size();) {
    const size_t begin = line.find_first_not_of(" \t", i);
    if (begin == std::string_view::npos) break;
    i = std::min(line.find_first_of(" \t", begin), line.size());
    words.push_back(line.substr(begin, i - begin));
  }
  return words;
}

std::string in_quotes(std::string_view text, size_t most = 40) {
  std::string plain;
  for (const char c : text.substr(0, most)) plain += c >= 0x20 && c < 0x7f ? c : '?';
  return "'" + plain + (text.size() > most ? "...'" : "'");
}

std::optional<float> number_of(std::string_view word) {
  if (!word.empty() && word[0] == '+') word.remove_prefix(1);
  double value = 0;
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
  if (error != std::errc() || end != word.data() + word.size() || !(std::abs(value) <= 1e6)) return std::nullopt;
  return static_cast<float>(value);
}

float number(const Lines& lines, std::string_view word, const std::string& what) {
  const std::optional<float> value = number_of(word);
  if (!value) lines.fail(what + " is not a number within 1e6: " + in_quotes(word));
  return *value;
}

int index(const Lines& lines, std::string_view word, const std::string& what, size_t size) {
  int64_t value = 0;
  if (!parse_integer(word, &value)) lines.fail(what + " is not a whole number: " + in_quotes(word));
  if (value < 0 || value >= static_cast<int64_t>(size))
    lines.fail(format("%s %lld does not exist: there are %zu, counted from 0", what.c_str(),
                      static_cast<long long>(value), size));
  return static_cast<int>(value);
}

struct Thresholds {
  float min_length_px = 0;
  float min_area_px2 = 0;
};

// What follows an entry's numbers: words[from] on.
Thresholds attributes(const Lines& lines, const std::vector<std::string_view>& words, size_t from) {
  float length = 50, area = 2500;
  bool use = false;
  for (size_t i = from; i < words.size(); ++i) {
    const size_t equals = words[i].find('=');
    if (equals == std::string_view::npos) lines.fail("neither expected here nor an attribute: " + in_quotes(words[i]));
    const std::string_view key = words[i].substr(0, equals), value = words[i].substr(equals + 1);
    const auto threshold = [&] {
      const float v = number(lines, value, std::string(key));
      if (v < 0) lines.fail(std::string(key) + " is negative: " + in_quotes(value));
      return v;
    };
    if (key == "useLod") {
      if (value != "true" && value != "false") lines.fail("useLod is neither true nor false: " + in_quotes(value));
      use = value == "true";
    } else if (key == "minLineLengthThreshold") {
      length = threshold();
    } else if (key == "minPolygonAreaThreshold") {
      area = threshold();
    } else if (key != "name") {
      lines.fail("no such attribute: " + in_quotes(key) +
                 "; there are name, useLod, minLineLengthThreshold, minPolygonAreaThreshold");
    }
  }
  return use ? Thresholds{length, area} : Thresholds{};
}

class CaoReader {
 public:
  explicit CaoReader(ModelFile* model) : model_(*model) {}

  void read(Lines& lines, const std::filesystem::path& file, const SE3& T) {
    model_.files.push_back(file);
    open_.push_back(resolved(file));
    const size_t files = model_.files.size();
    if (lines.at_end() || lines.take("V1") != "V1") lines.fail("a .cao model begins with a line V1");
    while (!lines.at_end() && lines.peek().starts_with("load")) load(lines, file, T);
    if (lines.at_end()) {
      if (model_.files.size() == files) lines.take("the number of points");  // neither loads nor points: throws
    } else {
      read_sections(lines, T);
    }
    open_.pop_back();
  }

 private:
  struct Part {  // of the file that is being read
    size_t first_point = 0, points = 0;
    std::vector<std::pair<int, int>> lines;  // by indices of the whole model
  };

  static std::filesystem::path resolved(const std::filesystem::path& file) {
    std::error_code ignored;
    return std::filesystem::weakly_canonical(file, ignored);
  }
  // At most `most`, of which other files have used some.
  int count(Lines& lines, const std::string& what, size_t most, size_t used) const {
    const std::string_view text = lines.take("the number of " + what);
    int64_t value = 0;
    if (!parse_integer(text, &value))
      lines.fail("the number of " + what + " is not a whole number: " + in_quotes(text));
    const int64_t room = static_cast<int64_t>(most) - static_cast<int64_t>(std::min(most, used));
    if (value < 0 || value > room)
      lines.fail(format("the number of %s is not within 0 to %zu%s", what.c_str(), most,
                        used > 0 ? ", with those of the files before" : ""));
    return static_cast<int>(value);
  }
  std::vector<std::string_view> entry(Lines& lines, const std::string& what, size_t least) const {
    std::vector<std::string_view> words = words_of(lines.take("a " + what));
    if (words.size() < least) lines.fail(format("a %s needs %zu numbers", what.c_str(), least));
    return words;
  }
  int point(const Lines& lines, std::string_view word, const Part& part) const {
    return static_cast<int>(part.first_point) + index(lines, word, "point", part.points);
  }
  void need_apart(const Lines& lines, int a, int b) const {
    const auto at = [&](int i) { return model_.points[static_cast<size_t>(i)]; };
    if (a == b || (at(a) - at(b)).norm() < 1e-5f) lines.fail("two points are needed that are not at the same place");
  }
  float radius(const Lines& lines, std::string_view word) const {
    const float r = number(lines, word, "the radius");
    if (!(r >= 1e-6f)) lines.fail("the radius is not positive: " + in_quotes(word));
    return r;
  }

  void read_sections(Lines& lines, const SE3& T) {
    Part part;
    part.first_point = model_.points.size();
    const int points = count(lines, "points", kMaxEntries, part.first_point);
    for (int i = 0; i < points; ++i) {
      const auto words = entry(lines, "point", 3);
      if (words.size() > 3) lines.fail("a point has three numbers");
      const Vector3f p =
          T * Vector3f(number(lines, words[0], "X"), number(lines, words[1], "Y"), number(lines, words[2], "Z"));
      if (!(p.cwiseAbs().maxCoeff() <= 1e6f)) lines.fail("the point is not within 1e6 where it is moved to");
      model_.points.push_back(p);
    }
    part.points = static_cast<size_t>(points);
    const int segments = count(lines, "lines", kMaxEntries, 0);
    std::vector<float> lengths;
    for (int i = 0; i < segments; ++i) {
      const auto words = entry(lines, "line", 2);
      const int a = point(lines, words[0], part), b = point(lines, words[1], part);
      need_apart(lines, a, b);
      part.lines.emplace_back(a, b);
      lengths.push_back(attributes(lines, words, 2).min_length_px);
    }
    std::vector<bool> in_face(part.lines.size());
    const int from_lines = count(lines, "faces from lines", kMaxFacets, model_.faces.size());
    for (int i = 0; i < from_lines; ++i) face_from_lines(lines, part, &in_face);
    for (size_t i = 0; i < part.lines.size(); ++i)
      if (!in_face[i]) model_.lines.push_back({part.lines[i].first, part.lines[i].second, lengths[i]});
    check_sides(lines);
    const int from_points = count(lines, "faces from points", kMaxFacets, model_.faces.size());
    for (int i = 0; i < from_points; ++i) face_from_points(lines, part);
    const int cylinders = count(lines, "cylinders", kMaxRound, model_.cylinders.size());
    for (int i = 0; i < cylinders; ++i) {
      const auto words = entry(lines, "cylinder", 3);
      ModelCylinder cylinder;
      cylinder.a = point(lines, words[0], part);
      cylinder.b = point(lines, words[1], part);
      need_apart(lines, cylinder.a, cylinder.b);
      cylinder.radius = radius(lines, words[2]);
      cylinder.min_length_px = attributes(lines, words, 3).min_length_px;
      model_.cylinders.push_back(cylinder);
    }
    if (lines.at_end()) return;
    const int circles = count(lines, "circles", kMaxRound, model_.circles.size());
    for (int i = 0; i < circles; ++i) circle(lines, part);
    if (lines.at_end()) return;
    const int spheres = count(lines, "spheres", kMaxRound, model_.spheres.size());
    for (int i = 0; i < spheres; ++i) {
      const auto words = entry(lines, "sphere", 2);
      model_.spheres.push_back({model_.points[static_cast<size_t>(point(lines, words[1], part))],
                                radius(lines, words[0]), attributes(lines, words, 2).min_area_px2});
    }
    if (!lines.at_end()) {
      lines.take("");
      lines.fail("there is more after the last section");
    }
  }

  void add_face(const Lines& lines, const std::vector<int>& corners, bool open, const Thresholds& thresholds) {
    ModelFace face;
    face.first = static_cast<int>(model_.corners.size());
    face.count = static_cast<int>(corners.size());
    face.open = open;
    face.min_area_px2 = thresholds.min_area_px2;
    face.min_length_px = thresholds.min_length_px;
    for (size_t i = 0; i < corners.size(); ++i) need_apart(lines, corners[i], corners[(i + 1) % corners.size()]);
    model_.corners.insert(model_.corners.end(), corners.begin(), corners.end());
    model_.faces.push_back(face);
    check_sides(lines);
  }
  void check_sides(const Lines& lines) const {
    if (model_.lines.size() + model_.corners.size() > kMaxEntries)
      lines.fail("more than 4096 lines and sides of faces, of all files together");
  }

  size_t corner_count(const Lines& lines, const std::vector<std::string_view>& words, const char* what,
                      int least) const {
    int64_t count = 0;
    if (!parse_integer(words[0], &count) || count < least || count > static_cast<int64_t>(kMaxEntries))
      lines.fail(format("a face needs %d or more %s: %s", least, what, in_quotes(words[0]).c_str()));
    if (words.size() < static_cast<size_t>(count) + 1)
      lines.fail(
          format("the face has %zu %s, not the %lld it says", words.size() - 1, what, static_cast<long long>(count)));
    return static_cast<size_t>(count);
  }

  // Its lines must join end to end; the first one's direction is that in which the second follows.
  void face_from_lines(Lines& lines, const Part& part, std::vector<bool>* in_face) {
    const auto words = entry(lines, "face from lines", 2);
    const size_t count = corner_count(lines, words, "lines", 1);
    std::vector<std::pair<int, int>> ends;
    for (size_t i = 0; i < count; ++i) {
      const size_t line = static_cast<size_t>(index(lines, words[i + 1], "line", part.lines.size()));
      (*in_face)[line] = true;
      ends.push_back(part.lines[line]);
    }
    if (count > 1) {
      const auto touches = [](const std::pair<int, int>& line, int p) { return line.first == p || line.second == p; };
      // Of two lines with the same ends either direction will do.
      if (!touches(ends[1], ends[0].second)) std::swap(ends[0].first, ends[0].second);
    }
    std::vector<int> corners = {ends[0].first, ends[0].second};
    for (size_t i = 1; i < count; ++i) {
      if (ends[i].second == corners.back()) std::swap(ends[i].first, ends[i].second);
      if (ends[i].first != corners.back())
        lines.fail(format("the face's lines do not join: %s does not begin where the one before it ends",
                          in_quotes(words[i + 1]).c_str()));
      corners.push_back(ends[i].second);
    }
    bool open = true;
    if (corners.size() > 3 && corners.front() == corners.back()) {
      corners.pop_back();
      open = false;
    }
    add_face(lines, corners, open, attributes(lines, words, count + 1));
  }

  void face_from_points(Lines& lines, const Part& part) {
    const auto words = entry(lines, "face from points", 3);
    const size_t count = corner_count(lines, words, "points", 2);
    std::vector<int> corners;
    for (size_t i = 0; i < count; ++i) corners.push_back(point(lines, words[i + 1], part));
    add_face(lines, corners, false, attributes(lines, words, count + 1));
  }

  // Seen from the visible side, the two points of its plane follow each other counter-clockwise round the centre.
  void circle(Lines& lines, const Part& part) {
    const auto words = entry(lines, "circle", 4);
    ModelCircle made;
    made.radius = radius(lines, words[0]);
    Vector3f p[3];
    for (size_t i = 0; i < 3; ++i) p[i] = model_.points[static_cast<size_t>(point(lines, words[i + 1], part))];
    made.centre = p[0];
    made.normal = (p[1] - p[0]).cross(p[2] - p[0]);
    const float sides = (p[1] - p[0]).norm() * (p[2] - p[0]).norm();
    if (!(made.normal.norm() > 1e-4f * sides)) lines.fail("the circle's three points are in a line");
    made.normal.normalize();
    made.min_area_px2 = attributes(lines, words, 4).min_area_px2;
    model_.circles.push_back(made);
  }

  // load("path" [, t=[x; y; z]] [, tu=[rx; ry; rz [deg|rad]]] [, R=[9 values]])
  void load(Lines& lines, const std::filesystem::path& file, const SE3& T) {
    const std::string_view line = lines.take("load");
    const size_t open = line.find('"'), quote = open == std::string::npos ? open : line.find('"', open + 1);
    std::string before;  // between load and the path
    for (size_t i = 4; i < std::min(open, line.size()); ++i)
      if (line[i] != ' ' && line[i] != '\t') before += line[i];
    if (quote == std::string::npos || before != "(" || line.back() != ')')
      lines.fail("not load(\"file\") with t=[x; y; z], tu=[rx; ry; rz deg] or R=[9 values] after commas: " +
                 in_quotes(line));
    const std::string_view name = line.substr(open + 1, quote - open - 1);
    const std::filesystem::path other = file.parent_path() / name;
    SE3 T_here;
    bool turned = false;
    std::string_view rest = line.substr(quote + 1, line.size() - quote - 2);
    while (!trimmed(rest).empty()) {
      rest = trimmed(rest);
      if (rest[0] != ',') lines.fail("a comma is missing before " + in_quotes(rest));
      rest = trimmed(rest.substr(1));
      const size_t begin = rest.find("=["), end = rest.find(']');
      if (begin == std::string_view::npos || end == std::string_view::npos || end < begin)
        lines.fail("neither t=[...], tu=[...] nor R=[...]: " + in_quotes(rest));
      transform(lines, trimmed(rest.substr(0, begin)), rest.substr(begin + 2, end - begin - 2), &T_here, &turned);
      rest = rest.substr(end + 1);
    }
    if (std::find(open_.begin(), open_.end(), resolved(other)) != open_.end())
      lines.fail("it is being read already, files load themselves: " + in_quotes(name, 200));
    if (open_.size() >= kMaxDepth) lines.fail("more than 8 files load each other");
    if (model_.files.size() >= kMaxFiles) lines.fail("more than 64 files are loaded");
    std::error_code ignored;
    if (!std::filesystem::is_regular_file(other, ignored)) lines.fail("there is no file " + in_quotes(name, 200));
    Lines others(other);
    bytes_ += others.bytes();
    if (bytes_ > kMaxModelBytes) lines.fail("the files that are loaded have more than 8 MB");
    read(others, other, T * T_here);
  }

  void transform(const Lines& lines, std::string_view key, std::string_view list, SE3* T, bool* turned) const {
    std::string blanks(list);
    std::replace_if(
        blanks.begin(), blanks.end(), [](char c) { return c == ';' || c == ','; }, ' ');
    std::vector<std::string_view> words = words_of(blanks);
    float unit = 1;
    if (key == "tu" && !words.empty() && (words.back() == "deg" || words.back() == "rad")) {
      if (words.back() == "deg") unit = 3.14159265f / 180;
      words.pop_back();
    }
    const size_t needed = key == "R" ? 9 : 3;
    if (key != "t" && key != "tu" && key != "R") lines.fail("neither t, tu nor R: " + in_quotes(key));
    if (words.size() != needed) lines.fail(format("%s needs %zu numbers", std::string(key).c_str(), needed));
    std::array<float, 9> v = {};
    for (size_t i = 0; i < needed; ++i) v[i] = number(lines, words[i], std::string(key));
    if (key == "t") {
      T->t = Vector3f(v[0], v[1], v[2]);
      return;
    }
    if (*turned) lines.fail("tu and R, or one of them twice");
    *turned = true;
    if (key == "tu") {
      const Vector3f turn = unit * Vector3f(v[0], v[1], v[2]);
      if (turn.norm() > 100) lines.fail("tu is a turn of more than 100 radians");
      T->R = so3_exp(turn);
      return;
    }
    for (int i = 0; i < 9; ++i) T->R(i / 3, i % 3) = v[static_cast<size_t>(i)];
    if ((T->R * T->R.transpose() - Matrix3f::Identity()).norm() > 1e-2f || T->R.determinant() < 0)
      lines.fail("R is not a rotation");
    T->R = orthonormalised(T->R);
  }

  ModelFile& model_;
  std::vector<std::filesystem::path> open_;  // being read, each loaded by the one before
  size_t bytes_ = 0;                         // of files that were loaded
};

// Vertex indices count from 1; negative ones from the last vertex so far.
int obj_index(const Lines& lines, std::string_view word, size_t vertices) {
  word = word.substr(0, word.find('/'));
  int64_t value = 0;
  if (!parse_integer(word, &value)) lines.fail("not the number of a vertex: " + in_quotes(word));
  if (value < 0) value += static_cast<int64_t>(vertices) + 1;
  if (value < 1 || value > static_cast<int64_t>(vertices))
    lines.fail(format("vertex %s does not exist: there are %zu, counted from 1", in_quotes(word).c_str(), vertices));
  return static_cast<int>(value - 1);
}

// Whether a piece has no area to speak of: its corners are in a line, within a millionth of its longest diagonal.
bool flat(const std::vector<Vector3f>& points, const std::vector<int>& corners) {
  const auto at = [&](size_t i) { return points[static_cast<size_t>(corners[i])]; };
  Vector3f normal = Vector3f::Zero();
  float longest_sq = 0;
  for (size_t i = 1; i + 1 < corners.size(); ++i) normal += (at(i) - at(0)).cross(at(i + 1) - at(0));
  for (size_t i = 0; i < corners.size(); ++i)
    for (const size_t j : {size_t{0}, (i + 1) % corners.size()})
      longest_sq = std::max(longest_sq, (at(i) - at(j)).squaredNorm());
  return !(normal.norm() > 1e-6f * longest_sq);
}

// Vertices at the same place are one; pieces without an area are left out.
void read_obj(Lines& lines, ModelFile* model) {
  model->outlines_of_smooth = true;
  std::vector<int> vertex;  // index of its point
  std::map<std::array<float, 3>, int> places;
  while (!lines.at_end()) {
    const auto words = words_of(lines.take("a line"));
    if (words[0] == "v") {
      if (words.size() < 4) lines.fail("a vertex needs three numbers");
      if (vertex.size() >= kMaxObjVertices) lines.fail("more than 100000 vertices");
      const std::array<float, 3> at = {number(lines, words[1], "x"), number(lines, words[2], "y"),
                                       number(lines, words[3], "z")};
      const auto [place, fresh] = places.emplace(at, static_cast<int>(model->points.size()));
      if (fresh) model->points.emplace_back(at[0], at[1], at[2]);
      vertex.push_back(place->second);
      if (model->points.size() > kMaxEntries)
        lines.fail("more than 4096 vertices at different places: simplify the model");
    } else if (words[0] == "f" || words[0] == "l") {
      std::vector<int> corners;
      for (size_t i = 1; i < words.size(); ++i) {
        const int corner = vertex[static_cast<size_t>(obj_index(lines, words[i], vertex.size()))];
        const auto at = [&](int p) { return model->points[static_cast<size_t>(p)]; };
        if (corners.empty() || (at(corners.back()) - at(corner)).norm() > 1e-5f) corners.push_back(corner);
        // The last corner is beside the first one, too.
        if (i + 1 == words.size() && words[0] == "f")
          while (corners.size() > 1 && (at(corners.front()) - at(corners.back())).norm() <= 1e-5f) corners.pop_back();
      }
      if (words[0] == "l") {
        for (size_t i = 1; i < corners.size(); ++i) model->lines.push_back({corners[i - 1], corners[i], 0});
      } else {
        if (corners.size() < 3 || flat(model->points, corners)) continue;
        ModelFace face;
        face.first = static_cast<int>(model->corners.size());
        face.count = static_cast<int>(corners.size());
        model->corners.insert(model->corners.end(), corners.begin(), corners.end());
        model->faces.push_back(face);
      }
      if (model->corners.size() + model->lines.size() > kMaxEntries || model->faces.size() > kMaxFacets)
        lines.fail("more than 2048 faces or 4096 sides: simplify the model");
    }
  }
}

std::vector<float> numbers_of(const std::filesystem::path& file, size_t most) {
  Lines lines(file);
  std::vector<float> values;
  while (!lines.at_end()) {
    for (const std::string_view word : words_of(lines.take("numbers"))) {
      values.push_back(number(lines, word, "this"));
      if (values.size() > most) lines.fail(format("more than %zu numbers", most));
    }
  }
  return values;
}

}  // namespace

ObjectModel ModelFile::view() const {
  ObjectModel model;
  model.points = points;
  model.corners = corners;
  model.lines = lines;
  model.faces = faces;
  model.cylinders = cylinders;
  model.circles = circles;
  model.spheres = spheres;
  model.outlines_of_smooth = outlines_of_smooth;
  return model;
}

ModelFile read_model(const std::filesystem::path& file) {
  return model_of(read_text(file, kMaxModelBytes), file);
}

ModelFile model_of(const std::string& text, const std::filesystem::path& file) {
  ModelFile model;
  Lines lines(text, file);
  if (lines.at_end()) lines.fail_at_end("is empty; a model is a .cao file, V1, or a Wavefront OBJ");
  const std::string first(words_of(lines.peek()).front());
  const bool obj = first == "v" || first == "o" || first == "g" || first == "mtllib" || first == "vn" ||
                   first == "vt" || first == "s" || first == "usemtl";
  if (obj) {
    model.files.push_back(file);
    read_obj(lines, &model);
  } else {
    CaoReader(&model).read(lines, file, SE3());
  }
  const Status status = model.view().validate();
  if (!status.ok()) lines.fail_at_end(status.message());
  return model;
}

SE3 read_object_pose(const std::filesystem::path& file) {
  const std::vector<float> v = numbers_of(file, 16);
  SE3 T;
  if (v.size() == 6) {
    const Vector3f turn(v[3], v[4], v[5]);
    if (turn.norm() > 100) throw InputError(file.string() + ": the rotation is of more than 100 radians");
    T = {so3_exp(turn), Vector3f(v[0], v[1], v[2])};
  } else if (v.size() == 16) {
    for (size_t row = 0; row < 3; ++row) {
      for (size_t column = 0; column < 3; ++column)
        T.R(static_cast<int>(row), static_cast<int>(column)) = v[4 * row + column];
      T.t(static_cast<int>(row)) = v[4 * row + 3];
    }
    const bool affine = v[12] == 0 && v[13] == 0 && v[14] == 0 && v[15] == 1;
    if (!affine || (T.R * T.R.transpose() - Matrix3f::Identity()).norm() > 1e-2f || T.R.determinant() < 0)
      throw InputError(file.string() + ": the 4x4 matrix is not a rotation and a translation");
    T.R = orthonormalised(T.R);
  } else {
    throw InputError(file.string() +
                     format(": has %zu numbers; a pose is tx ty tz and a rotation vector, or a 4x4 matrix", v.size()));
  }
  return T;
}

SeenPoints read_seen_points(const std::filesystem::path& file) {
  Lines lines(file);
  const std::string_view text = lines.take("the number of points");
  int64_t count = 0;
  if (!parse_integer(text, &count) || count < 4 || count > 100)
    lines.fail("the number of points is not a whole number from 4 to 100: " + in_quotes(text));
  SeenPoints seen;
  for (int64_t i = 0; i < count; ++i) {
    const auto words = words_of(lines.take("a point"));
    if (words.size() != 5)
      lines.fail("a point needs X Y Z of the object and u v of the image, in pixels: five numbers in a line");
    float v[5];
    for (size_t k = 0; k < 5; ++k) v[k] = number(lines, words[k], "this");
    seen.points_o.emplace_back(v[0], v[1], v[2]);
    seen.px.emplace_back(v[3], v[4]);
  }
  if (!lines.at_end()) {
    lines.take("");
    lines.fail("there is more after the last point");
  }
  return seen;
}

}  // namespace pptam::platform
