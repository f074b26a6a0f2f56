// EGL's part of a display without a window system: a context, current in the thread that made it.
#pragma once

#include <EGL/egl.h>

#include <cstdint>
#include <string>
#include <vector>

namespace pptam::platform {

// Of OpenGL ES 2.0, on a platform of EGL's: EGL_PLATFORM_SURFACELESS_MESA or EGL_PLATFORM_GBM_KHR.
class EglContext {
 public:
  // native: the platform's display, such as a gbm_device. visual: the configuration's EGL_NATIVE_VISUAL_ID, 0: any.
  // Throws InputError.
  EglContext(EGLenum platform, void* native, EGLint visual);
  ~EglContext();
  EglContext(const EglContext&) = delete;
  EglContext& operator=(const EglContext&) = delete;

  void make_current(EGLSurface surface) const;  // EGL_NO_SURFACE: none. Throws InputError
  EGLDisplay display() const { return display_; }
  EGLConfig config() const { return config_; }

 private:
  void choose_config(EGLint visual, EGLint surface_type);

  // EGL has one display for each native one: without any it is the whole process', and others draw with it.
  bool owned_;
  EGLDisplay display_ = EGL_NO_DISPLAY;
  EGLConfig config_ = nullptr;
  EGLContext context_ = EGL_NO_CONTEXT;
};

// "EGL_BAD_ALLOC", of the last call.
std::string egl_error();

// The bound target's pixels, width times height times 4 bytes; its first row first, or, flipped, its last one.
void read_pixels(int width, int height, bool flipped, std::vector<uint8_t>* rgba);

}  // namespace pptam::platform
