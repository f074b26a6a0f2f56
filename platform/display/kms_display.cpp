#include "platform/display/kms_display.h"

#include <EGL/egl.h>
#include <EGL/eglext.h>
#include <fcntl.h>
#include <gbm.h>
#include <poll.h>
#include <unistd.h>
#include <xf86drm.h>
#include <xf86drmMode.h>

#include <cerrno>
#include <cstring>
#include <ctime>
#include <deque>
#include <memory>
#include <string>
#include <utility>

#include "platform/display/egl.h"
#include "platform/display/pointer_input.h"
#include "platform/display/renderer.h"
#include "platform/display/text_console.h"
#include "platform/input_error.h"
#include "platform/text.h"

namespace pptam::platform {
namespace {

constexpr int64_t kLookEvery_ns = 500'000'000;   // at connectors, and at a screen that another program has
constexpr int64_t kTryEvery_ns = 2'000'000'000;  // to find a screen that was plugged in, and to draw on it
constexpr int64_t kLostFlip_ns = 1'000'000'000;  // a picture that was not shown by then never will be

int64_t now_ns() {
  timespec now = {};
  ::clock_gettime(CLOCK_MONOTONIC, &now);
  return int64_t{now.tv_sec} * 1'000'000'000 + now.tv_nsec;
}

struct ConnectorDeleter {
  void operator()(drmModeConnector* connector) const { drmModeFreeConnector(connector); }
};
using Connector = std::unique_ptr<drmModeConnector, ConnectorDeleter>;
struct ResourcesDeleter {
  void operator()(drmModeRes* resources) const { drmModeFreeResources(resources); }
};
using Resources = std::unique_ptr<drmModeRes, ResourcesDeleter>;
struct EncoderDeleter {
  void operator()(drmModeEncoder* encoder) const { drmModeFreeEncoder(encoder); }
};
using Encoder = std::unique_ptr<drmModeEncoder, EncoderDeleter>;

bool is_connected(const Connector& connector) {
  return connector && connector->connection == DRM_MODE_CONNECTED && connector->count_modes > 0;
}

std::string name_of(const Connector& connector) {
  const char* type = drmModeGetConnectorTypeName(connector->connector_type);
  return format("%s-%u", type == nullptr ? "screen" : type, connector->connector_type_id);
}

drmModeModeInfo preferred_mode(const Connector& connector) {
  for (int i = 0; i < connector->count_modes; ++i) {
    if ((connector->modes[i].type & DRM_MODE_TYPE_PREFERRED) != 0) return connector->modes[i];
  }
  return connector->modes[0];
}

// A graphics device with a connected screen.
class Card {
 public:
  Card() {
    std::string trouble = "there is no graphics device with a screen (/dev/dri/card*)";
    for (int number = 0; number < 8; ++number) {
      const std::string path = format("/dev/dri/card%d", number);
      fd_ = ::open(path.c_str(), O_RDWR | O_CLOEXEC);
      if (fd_ < 0) {
        if (errno == EACCES)
          trouble =
              path + ": permission denied: add yourself to the group video (adduser $USER video) and log in again";
        continue;
      }
      if (find_screen()) return;
      if (has_connectors_) trouble = path + ": no screen is connected: plug one in, and switch it on";
      ::close(fd_);
    }
    throw InputError("a screen: " + trouble);
  }
  ~Card() { ::close(fd_); }
  Card(const Card&) = delete;
  Card& operator=(const Card&) = delete;

  int fd() const { return fd_; }
  uint32_t connector() const { return connector_; }
  uint32_t crtc() const { return crtc_; }
  const drmModeModeInfo& mode() const { return mode_; }
  const std::string& name() const { return name_; }

  // As the kernel has noticed: asking the screen itself takes a tenth of a second and more.
  bool connected() const { return said_connected(connector_); }
  bool any_connected() const {
    const Resources resources(drmModeGetResources(fd_));
    for (int i = 0; resources && i < resources->count_connectors; ++i) {
      if (said_connected(resources->connectors[i])) return true;
    }
    return false;
  }
  // The first connected screen, with its mode: asks all of them.
  bool find_screen() {
    const Resources resources(drmModeGetResources(fd_));
    if (!resources) return false;
    has_connectors_ = resources->count_connectors > 0;
    for (int i = 0; i < resources->count_connectors; ++i) {
      const Connector connector(drmModeGetConnector(fd_, resources->connectors[i]));
      if (!is_connected(connector) || !find_crtc(*resources, *connector)) continue;
      connector_ = connector->connector_id;
      mode_ = preferred_mode(connector);
      name_ = name_of(connector);
      return true;
    }
    return false;
  }

 private:
  bool said_connected(uint32_t id) const {
    const Connector connector(drmModeGetConnectorCurrent(fd_, id));
    return connector && connector->connection == DRM_MODE_CONNECTED;
  }
  // What feeds the connector: the one that does already, else one that can.
  bool find_crtc(const drmModeRes& resources, const drmModeConnector& connector) {
    const Encoder present(drmModeGetEncoder(fd_, connector.encoder_id));
    if (present && present->crtc_id != 0) {
      crtc_ = present->crtc_id;
      return true;
    }
    for (int i = 0; i < connector.count_encoders; ++i) {
      const Encoder encoder(drmModeGetEncoder(fd_, connector.encoders[i]));
      for (int k = 0; encoder && k < resources.count_crtcs; ++k) {
        if ((encoder->possible_crtcs >> k & 1) == 0) continue;
        crtc_ = resources.crtcs[k];
        return true;
      }
    }
    return false;
  }

  int fd_ = -1;
  bool has_connectors_ = false;
  uint32_t connector_ = 0, crtc_ = 0;
  drmModeModeInfo mode_ = {};
  std::string name_;
};

class KmsDisplay : public Display {
 public:
  KmsDisplay() : input_(::isatty(STDIN_FILENO) == 0) {
    drmSetMaster(card_.fd());
    if (drmIsMaster(card_.fd()) == 0)
      throw InputError("screen " + card_.name() +
                       ": another program has it, a desktop perhaps: use --show=window there, or "
                       "a text console");
    gbm_ = gbm_create_device(card_.fd());
    if (gbm_ == nullptr)
      throw InputError("screen " + card_.name() + ": GBM has no driver for it (Debian: libgl1-mesa-dri)");
    try {
      crtc_before_ = drmModeGetCrtc(card_.fd(), card_.crtc());
      connector_before_ = card_.connector();
      egl_ = std::make_unique<EglContext>(EGL_PLATFORM_GBM_KHR, gbm_, static_cast<EGLint>(GBM_FORMAT_XRGB8888));
      make_surface();
      renderer_ = std::make_unique<Renderer>();
      driver_ = Renderer::driver();
    } catch (...) {
      close();
      throw;
    }
  }
  ~KmsDisplay() override { close(); }
  KmsDisplay(const KmsDisplay&) = delete;
  KmsDisplay& operator=(const KmsDisplay&) = delete;

  std::string describe() const override {
    return format("screen %s, %dx%d, %s", card_.name().c_str(), width(), height(), driver_.c_str());
  }
  int width() const override { return card_.mode().hdisplay; }
  int height() const override { return card_.mode().vdisplay; }

  bool ready() override {
    take_flips();
    if (away_ || unplugged_) return false;
    if (pending_ != nullptr && now_ns() - flipped_ns_ > kLostFlip_ns) {
      show(std::exchange(pending_, nullptr));
      mode_set_ = false;
    }
    return pending_ == nullptr && (!lost_ || now_ns() >= try_again_ns_);
  }

  void draw(const Scene& scene, std::vector<uint8_t>* rgba) override {
    egl_->make_current(surface_);
    renderer_->draw(scene, false);
    if (rgba != nullptr) read_pixels(width(), height(), true, rgba);
    Renderer::check();
    if (eglSwapBuffers(egl_->display(), surface_) == EGL_FALSE)
      throw InputError("screen " + card_.name() + ": " + egl_error());
    gbm_bo* buffer = gbm_surface_lock_front_buffer(gbm_surface_);
    if (buffer == nullptr) throw InputError("screen " + card_.name() + ": no buffer is free");
    const uint32_t framebuffer = framebuffer_of(buffer);
    int failed = 0;
    if (mode_set_) {
      failed = drmModePageFlip(card_.fd(), card_.crtc(), framebuffer, DRM_MODE_PAGE_FLIP_EVENT, this);
      if (failed == 0) {
        pending_ = buffer;
        flipped_ns_ = now_ns();
      }
    }
    if (!mode_set_ || failed != 0) {  // the first picture, or the screen is not as it was left
      uint32_t connector = card_.connector();
      drmModeModeInfo mode = card_.mode();
      failed = drmModeSetCrtc(card_.fd(), card_.crtc(), framebuffer, 0, 0, &connector, 1, &mode);
      mode_set_ = failed == 0;
      if (mode_set_) show(buffer);
    }
    if (failed == 0) {
      if (std::exchange(lost_, false)) tell("is back");
      return;
    }
    gbm_surface_release_buffer(gbm_surface_, buffer);
    try_again_ns_ = now_ns() + kLookEvery_ns;
    drmSetMaster(card_.fd());
    if (!std::exchange(lost_, true))
      tell(std::string("cannot be drawn on: ") + std::strerror(-failed) + "; waiting for it");
  }

  bool poll(DisplayEvent* event) override {
    take_flips();
    look_at_console();
    look_at_connector();
    char key = 0;
    switch (input_.next(&key)) {
      case PointerInput::What::kTap:
        if (!away_) events_.push_back({DisplayEvent::Kind::kTap, 0, ""});
        break;
      case PointerInput::What::kKey:
        events_.push_back({DisplayEvent::Kind::kKey, key, ""});
        break;
      case PointerInput::What::kNothing:
        break;
    }
    if (events_.empty()) return false;
    *event = events_.front();
    events_.pop_front();
    return true;
  }

 private:
  void tell(const std::string& what) {
    events_.push_back({DisplayEvent::Kind::kNotice, 0, "screen " + card_.name() + ": " + what});
  }

  void make_surface() {
    gbm_surface_ = gbm_surface_create(gbm_, card_.mode().hdisplay, card_.mode().vdisplay, GBM_FORMAT_XRGB8888,
                                      GBM_BO_USE_SCANOUT | GBM_BO_USE_RENDERING);
    if (gbm_surface_ == nullptr) throw InputError("screen " + card_.name() + ": no buffers for " + card_.mode().name);
    surface_ = eglCreateWindowSurface(egl_->display(), egl_->config(),
                                      reinterpret_cast<EGLNativeWindowType>(gbm_surface_), nullptr);
    if (surface_ == EGL_NO_SURFACE) throw InputError("screen " + card_.name() + ": " + egl_error());
    egl_->make_current(surface_);
    mode_set_ = false;
  }

  void drop_surface() {
    for (gbm_bo** buffer : {&pending_, &shown_}) {
      if (*buffer != nullptr) gbm_surface_release_buffer(gbm_surface_, std::exchange(*buffer, nullptr));
    }
    if (surface_ != EGL_NO_SURFACE) {
      eglMakeCurrent(egl_->display(), EGL_NO_SURFACE, EGL_NO_SURFACE, EGL_NO_CONTEXT);
      eglDestroySurface(egl_->display(), std::exchange(surface_, EGL_NO_SURFACE));
    }
    if (gbm_surface_ != nullptr) gbm_surface_destroy(std::exchange(gbm_surface_, nullptr));
  }

  void close() {
    for (int i = 0; i < 10 && pending_ != nullptr; ++i) {
      pollfd flip = {card_.fd(), POLLIN, 0};
      ::poll(&flip, 1, 20);
      take_flips();
    }
    if (crtc_before_ != nullptr) {  // the console's picture
      if (!away_ && !unplugged_)
        drmModeSetCrtc(card_.fd(), crtc_before_->crtc_id, crtc_before_->buffer_id, crtc_before_->x, crtc_before_->y,
                       &connector_before_, 1, &crtc_before_->mode);
      drmModeFreeCrtc(crtc_before_);
    }
    try {
      if (renderer_) egl_->make_current(surface_);  // an overlay's may be: what it has is not to go
      renderer_.reset();
    } catch (const InputError&) {
      static_cast<void>(renderer_.release());  // nothing of it can be asked to go
    }
    drop_surface();
    egl_.reset();
    if (gbm_ != nullptr) gbm_device_destroy(gbm_);
  }

  uint32_t framebuffer_of(gbm_bo* buffer) const {
    struct Framebuffer {
      int fd;
      uint32_t id;
    };
    if (const auto* known = static_cast<const Framebuffer*>(gbm_bo_get_user_data(buffer))) return known->id;
    auto made = std::make_unique<Framebuffer>(Framebuffer{card_.fd(), 0});
    const uint32_t handles[4] = {gbm_bo_get_handle(buffer).u32, 0, 0, 0};
    const uint32_t strides[4] = {gbm_bo_get_stride(buffer), 0, 0, 0};
    const uint32_t offsets[4] = {};
    const int failed = drmModeAddFB2(card_.fd(), gbm_bo_get_width(buffer), gbm_bo_get_height(buffer),
                                     GBM_FORMAT_XRGB8888, handles, strides, offsets, &made->id, 0);
    if (failed != 0) throw InputError("screen " + card_.name() + ": " + std::strerror(-failed));
    const uint32_t id = made->id;
    gbm_bo_set_user_data(buffer, made.release(), [](gbm_bo*, void* data) {
      const std::unique_ptr<Framebuffer> of_buffer(static_cast<Framebuffer*>(data));
      drmModeRmFB(of_buffer->fd, of_buffer->id);
    });
    return id;
  }

  // The buffer is on the screen now: the one before is free.
  void show(gbm_bo* buffer) {
    if (shown_ != nullptr) gbm_surface_release_buffer(gbm_surface_, shown_);
    shown_ = buffer;
  }

  void take_flips() {
    drmEventContext context = {};
    context.version = 2;
    context.page_flip_handler = [](int, unsigned, unsigned, unsigned, void* data) {
      auto* display = static_cast<KmsDisplay*>(data);
      if (display->pending_ != nullptr) display->show(std::exchange(display->pending_, nullptr));
    };
    pollfd flip = {card_.fd(), POLLIN, 0};
    while (::poll(&flip, 1, 0) == 1 && (flip.revents & POLLIN) != 0 && drmHandleEvent(card_.fd(), &context) == 0) {
    }
  }

  void look_at_console() {
    switch (console_.change()) {
      case TextConsole::Change::kNone:
        return;
      case TextConsole::Change::kAsked:
        away_ = true;
        drmDropMaster(card_.fd());
        console_.give();
        return tell("given to another console; drawing goes on when it is back");
      case TextConsole::Change::kBack:
        away_ = false;
        mode_set_ = false;
        drmSetMaster(card_.fd());
        return tell("is back");
    }
  }

  void look_at_connector() {
    const int64_t time_ns = now_ns();
    if (away_ || time_ns < look_at_connector_ns_) return;
    look_at_connector_ns_ = time_ns + kLookEvery_ns;
    if (!unplugged_) {
      if (card_.connected()) return;
      unplugged_ = true;
      return tell("was unplugged; waiting for it");
    }
    if (!card_.any_connected()) return;
    look_at_connector_ns_ = time_ns + kTryEvery_ns;
    if (!card_.find_screen()) return;
    drop_surface();  // another screen may have another mode
    try {
      make_surface();
    } catch (const InputError& error) {
      if (!std::exchange(refused_, true)) events_.push_back({DisplayEvent::Kind::kNotice, 0, error.what()});
      return;
    }
    look_at_connector_ns_ = time_ns + kLookEvery_ns;
    unplugged_ = refused_ = false;
    tell("is plugged in");
  }

  Card card_;
  TextConsole console_;
  PointerInput input_;
  gbm_device* gbm_ = nullptr;
  drmModeCrtc* crtc_before_ = nullptr;
  uint32_t connector_before_ = 0;
  std::unique_ptr<EglContext> egl_;
  gbm_surface* gbm_surface_ = nullptr;
  EGLSurface surface_ = EGL_NO_SURFACE;
  std::unique_ptr<Renderer> renderer_;
  std::string driver_;
  gbm_bo* shown_ = nullptr;    // on the screen
  gbm_bo* pending_ = nullptr;  // from the next vertical blank on
  int64_t flipped_ns_ = 0, try_again_ns_ = 0, look_at_connector_ns_ = 0;
  bool mode_set_ = false;
  bool away_ = false;  // on another console
  bool unplugged_ = false;
  bool refused_ = false;  // a screen was plugged in that cannot be drawn on
  bool lost_ = false;     // the kernel refuses our pictures
  std::deque<DisplayEvent> events_;
};

}  // namespace

std::unique_ptr<Display> make_kms_display() {
  return std::make_unique<KmsDisplay>();
}

}  // namespace pptam::platform
