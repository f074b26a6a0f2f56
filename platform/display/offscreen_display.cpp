#include "platform/display/offscreen_display.h"

#include <EGL/egl.h>
#include <EGL/eglext.h>
#include <GLES2/gl2.h>
#include <GLES2/gl2ext.h>

#include "platform/display/egl.h"
#include "platform/display/renderer.h"
#include "platform/input_error.h"

namespace pptam::platform {
namespace {

class OffscreenDisplay : public Display {
 public:
  OffscreenDisplay(int width, int height)
      : width_(width), height_(height), context_(EGL_PLATFORM_SURFACELESS_MESA, nullptr, 0) {
    context_.make_current(EGL_NO_SURFACE);
    glGenFramebuffers(1, &target_);
    glBindFramebuffer(GL_FRAMEBUFFER, target_);
    glGenRenderbuffers(2, buffers_);
    attach(buffers_[0], GL_RGBA8_OES, GL_COLOR_ATTACHMENT0);
    attach(buffers_[1], GL_DEPTH_COMPONENT16, GL_DEPTH_ATTACHMENT);
    if (glCheckFramebufferStatus(GL_FRAMEBUFFER) != GL_FRAMEBUFFER_COMPLETE)
      throw InputError("EGL: " + Renderer::driver() + " does not draw pictures of this size" + kOrSoftware);
    renderer_ = std::make_unique<Renderer>();
  }
  ~OffscreenDisplay() override {
    try {
      context_.make_current(EGL_NO_SURFACE);  // another display's may be: what it has is not to go
    } catch (const InputError&) {
      static_cast<void>(renderer_.release());  // nothing of it can be asked to go
    }
  }
  OffscreenDisplay(const OffscreenDisplay&) = delete;
  OffscreenDisplay& operator=(const OffscreenDisplay&) = delete;

  std::string describe() const override { return "off-screen, " + Renderer::driver(); }
  int width() const override { return width_; }
  int height() const override { return height_; }
  bool ready() override { return true; }
  bool poll(DisplayEvent*) override { return false; }
  void draw(const Scene& scene, std::vector<uint8_t>* rgba) override {
    context_.make_current(EGL_NO_SURFACE);
    glBindFramebuffer(GL_FRAMEBUFFER, target_);
    renderer_->draw(scene, true);
    if (rgba != nullptr) read_pixels(width_, height_, false, rgba);
    Renderer::check();
  }

 private:
  void attach(GLuint buffer, GLenum format, GLenum where) const {
    glBindRenderbuffer(GL_RENDERBUFFER, buffer);
    glRenderbufferStorage(GL_RENDERBUFFER, format, width_, height_);
    glFramebufferRenderbuffer(GL_FRAMEBUFFER, where, GL_RENDERBUFFER, buffer);
  }

  int width_, height_;
  EglContext context_;
  GLuint target_ = 0;       // gone with the context, as what follows
  GLuint buffers_[2] = {};  // colours, depth
  std::unique_ptr<Renderer> renderer_;
};

}  // namespace

std::unique_ptr<Display> make_offscreen_display(int width, int height) {
  return std::make_unique<OffscreenDisplay>(width, height);
}

}  // namespace pptam::platform
