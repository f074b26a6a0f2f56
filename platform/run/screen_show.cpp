#include "platform/run/screen_show.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <ctime>
#include <exception>
#include <system_error>
#include <utility>

#include <pocket_ptam/clock.h>
#include "platform/input_error.h"
#include "platform/run/clocks.h"
#include "platform/run/interruption.h"
#include "platform/run/picture.h"
#include "platform/text.h"

namespace pptam::platform {
namespace {

constexpr int64_t kNotice_ns = 3'000'000'000;  // how long a line stays on the display
constexpr int64_t kLongestWait_ns = 5'000'000'000;
constexpr int64_t kLongestRest_ns = 500'000'000;  // the first picture's, whose drawing compiles shaders
constexpr int64_t kStanding_ns = 500'000'000;     // without a new frame: drawn again
constexpr int kLargestColoured = 2048;            // pixels a side: what any graphics processor takes
constexpr const char* kHelp = "t tap  r reset  l lock  m mark  g ground  s save  p picture  v view  h help  q quit";

int64_t steady_now_ns() {
  return SteadyClock().now_ns();
}

// Under the first name that is free, in the present folder. What became of it.
std::string stored_picture(const std::vector<uint8_t>& rgba, int width, int height) {
  std::string png;
  try {
    png = png_of_rgba(rgba, width, height);
  } catch (const std::exception& error) {
    return std::string("the picture is not stored: ") + error.what();
  }
  for (int number = 1; number < 10000; ++number) {
    const std::string name = format("pocket-ptam-%04d.png", number);
    const int fd = ::open(name.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    if (fd < 0 && errno == EEXIST) continue;
    bool stored = fd >= 0;
    for (size_t done = 0; stored && done < png.size();) {
      const ssize_t written = ::write(fd, png.data() + done, png.size() - done);
      stored = written >= 0 || errno == EINTR;
      done += static_cast<size_t>(std::max<ssize_t>(0, written));
    }
    const std::string why = stored ? "" : std::strerror(errno);
    if (fd >= 0) ::close(fd);
    if (fd >= 0 && !stored) ::unlink(name.c_str());
    return stored ? "picture saved to " + name : format("%s: cannot be written: %s", name.c_str(), why.c_str());
  }
  return "the picture is not stored: there are 9999 of them here, move them away";
}

}  // namespace

RunKey run_key_of(char character) {
  switch (character) {
    case 't':
      return RunKey::kTap;
    case 'r':
      return RunKey::kReset;
    case 'l':
      return RunKey::kLock;
    case 'm':
      return RunKey::kMark;
    case 'g':
      return RunKey::kGround;
    case 's':
      return RunKey::kSave;
    case 'q':
      return RunKey::kQuit;
    default:
      return RunKey::kNothing;
  }
}

ScreenShow::ScreenShow(const ShowOptions& options, const CameraInfo& camera,
                       std::function<void(const std::string&)> say, const Camera* source)
    : options_(options), say_(std::move(say)), source_(source), composer_(camera) {
  const Canvas usual = composer_.usual_canvas();
  const bool lying = options.turn_degrees % 180 != 0;
  display_ = open_display(options.where, lying ? usual.height : usual.width, lying ? usual.width : usual.height);
  say_("shown on: " + display_->describe());
  notice_ = kHelp;
  notice_until_ns_ = steady_now_ns() + 2 * kNotice_ns;
}

ScreenShow::~ScreenShow() {
  if (storing()) say_(wait_until_stored());
}

void ScreenShow::say(const std::string& text) {
  notice_ = text;
  notice_until_ns_ = steady_now_ns() + kNotice_ns;
  say_(text);
}

void ScreenShow::leave(const std::string& why) {
  display_.reset();
  say_(why + "; the run goes on without it");
}

void ScreenShow::answer_all() {
  if (typed_ != nullptr) press(typed_->next());
  try {
    DisplayEvent event;
    while (display_ && display_->poll(&event)) answer(event);
  } catch (const InputError& error) {
    leave(error.what());
  }
  if (storing() && stored_) say(wait_until_stored());
  if (steady_now_ns() - drawn_ns_ > kStanding_ns && due()) draw();
}

RunKey ScreenShow::key() {
  answer_all();
  if (keys_.empty()) return RunKey::kNothing;
  const RunKey key = keys_.front();
  keys_.erase(keys_.begin());
  return key;
}

void ScreenShow::answer(const DisplayEvent& event) {
  switch (event.kind) {
    case DisplayEvent::Kind::kKey:
      return press(event.key);
    case DisplayEvent::Kind::kTap:
      if (has_map_) return say("there is a map already: r forgets it, t begins a new one at once");
      return keys_.push_back(RunKey::kTap);
    case DisplayEvent::Kind::kNotice:
      return say(event.text);
    case DisplayEvent::Kind::kClosed:
      return leave(event.text);
  }
}

void ScreenShow::press(char character) {
  if (character == 0) return;
  notice_until_ns_ = 0;  // it has been read
  if (character == 'p') {
    picture_wanted_ = true;
  } else if (character == 'v') {
    from_above_ = !from_above_;
  } else if (const RunKey key = run_key_of(character); key != RunKey::kNothing) {
    keys_.push_back(key);
  } else if (character == 'h' || character == '?') {
    say(kHelp);
  }
}

bool ScreenShow::quit_waits() const {
  return std::find(keys_.begin(), keys_.end(), RunKey::kQuit) != keys_.end();
}

void ScreenShow::wait_until_due(int64_t timestamp_ns) {
  const int64_t now_ns = steady_now_ns();
  if (!origin_ns_) origin_ns_ = saturated_difference(now_ns, timestamp_ns);
  int64_t due_ns = saturated_sum(*origin_ns_, timestamp_ns);
  if (saturated_difference(due_ns, now_ns) > kLongestWait_ns || due_ns < now_ns) {  // a gap; or the run cannot keep up
    origin_ns_ = saturated_difference(now_ns, timestamp_ns);
    due_ns = now_ns;
  }
  while (display_ && !interrupted() && !quit_waits() && steady_now_ns() < due_ns) {
    constexpr timespec kMoment = {0, 2'000'000};
    ::nanosleep(&kMoment, nullptr);
    answer_all();
  }
}

Canvas ScreenShow::canvas() const {
  const bool lying = options_.turn_degrees % 180 != 0;
  const int width = display_->width();
  const int height = display_->height();
  return {lying ? height : width, lying ? width : height, options_.turn_degrees};
}

const Scene& ScreenShow::compose() {
  if (!last_) return composer_.map_view({}, {}, {}, {}, canvas());  // an empty map
  if (from_above_) {
    points_.resize(static_cast<size_t>(last_->system->map_points({})));
    last_->system->map_points(points_);
    keyframes_.resize(static_cast<size_t>(last_->system->keyframes({})));
    last_->system->keyframes(keyframes_);
    return composer_.map_view(last_->result, last_->log, points_, keyframes_, canvas());
  }
  double ahead_s = 0;
  if (options_.predict) {
    constexpr int64_t kScanOut_ns = 16'666'667;  // the picture is seen with the display's next one, of 60 a second
    constexpr int64_t kFarthest_ns = 200'000'000;
    const int64_t age_ns = saturated_difference(steady_now_ns(), last_->result.timestamp_ns);
    ahead_s = 1e-9 * static_cast<double>(std::clamp<int64_t>(age_ns + kScanOut_ns, 0, kFarthest_ns));
  }
  return composer_.camera_view(last_->picture, last_->result, last_->log, canvas(), ahead_s);
}

void ScreenShow::show(const Frame& frame, const TrackResult& result, const FrameLog& log, const System& system) {
  has_map_ = result.state == TrackingState::kTracking || result.state == TrackingState::kLost;
  if (options_.paced) wait_until_due(frame.timestamp_ns);
  composer_.follow(result);
  if (!due()) return;
  Picture picture;
  const bool coloured = source_ != nullptr && source_->picture(&picture) &&
                        std::max(picture.frame.width, picture.frame.height) <= kLargestColoured;
  if (!coloured) picture = {frame};
  last_.emplace(Shown{picture, result, {result.points.begin(), result.points.end()}, log, &system});
  last_->result.points = last_->points;
  draw();
  last_->picture.frame.data = nullptr;
}

// Whether a picture would be seen, and it is not too early for one.
bool ScreenShow::due() {
  return display_ && display_->ready() && (steady_now_ns() >= rest_until_ns_ || (picture_wanted_ && !storing()));
}

void ScreenShow::draw() {
  const int64_t from_ns = steady_now_ns();
  const bool wanted = picture_wanted_ && !storing();
  try {
    const Scene& scene = compose();
    if (from_ns < notice_until_ns_) composer_.add_notice(notice_);
    const int width = display_->width();
    const int height = display_->height();
    display_->draw(scene, wanted ? &pixels_ : nullptr);
    drawn_ns_ = steady_now_ns();
    rest_until_ns_ = drawn_ns_ + std::min(drawn_ns_ - from_ns, kLongestRest_ns);
    if (!wanted) return;
    picture_wanted_ = false;
    store_picture(width, height);
  } catch (const InputError& error) {
    leave(error.what());
  }
}

// Beside tracking: to encode it takes as long as several frames.
void ScreenShow::store_picture(int width, int height) {
  try {
    stored_ = false;
    storing_ = std::thread([this, width, height, pixels = pixels_] {
      stored_text_ = stored_picture(pixels, width, height);
      stored_ = true;
    });
  } catch (const std::system_error& error) {
    say(std::string("the picture is not stored: ") + error.what());
  }
}

std::string ScreenShow::wait_until_stored() {
  storing_.join();
  return std::move(stored_text_);
}

Spectator spectator_of(ScreenShow* show, Keys* keys) {
  Spectator spectator;
  show->listen_to(keys);
  spectator.key = [show] { return show->key(); };
  spectator.say = [show](const std::string& text) { show->say(text); };
  spectator.show = [show](const Frame& frame, const TrackResult& result, const FrameLog& log, const System& system) {
    show->show(frame, result, log, system);
  };
  return spectator;
}

}  // namespace pptam::platform
