#include "platform/display/egl.h"

#include <EGL/egl.h>
#include <EGL/eglext.h>
#include <GLES2/gl2.h>

#include <algorithm>
#include <cstddef>

#include "platform/display/renderer.h"
#include "platform/input_error.h"
#include "platform/text.h"

namespace pptam::platform {
namespace {

bool has(const char* extensions, const char* name) {
  return extensions != nullptr &&
         (" " + std::string(extensions) + " ").find(" " + std::string(name) + " ") != std::string::npos;
}

}  // namespace

std::string egl_error() {
  const EGLint code = eglGetError();
  switch (code) {
    case EGL_NOT_INITIALIZED:
      return "there is no driver (Debian: install libegl-mesa0 libgl1-mesa-dri)";
    case EGL_BAD_ALLOC:
      return "no memory";
    case EGL_BAD_MATCH:
      return "the driver does not offer it";
    default:
      return format("EGL's error 0x%x", static_cast<unsigned>(code));
  }
}

EglContext::EglContext(EGLenum platform, void* native, EGLint visual) : owned_(native != nullptr) {
  const bool surfaceless = platform == EGL_PLATFORM_SURFACELESS_MESA;
  const char* clients = eglQueryString(EGL_NO_DISPLAY, EGL_EXTENSIONS);
  if (!has(clients, "EGL_EXT_platform_base") ||
      !has(clients, surfaceless ? "EGL_MESA_platform_surfaceless" : "EGL_KHR_platform_gbm")) {
    throw InputError(std::string("EGL: its drivers cannot draw ") + (surfaceless ? "off-screen" : "by GBM") +
                     " (Debian: install libegl-mesa0 libgl1-mesa-dri)");
  }
  const auto get_display =
      reinterpret_cast<PFNEGLGETPLATFORMDISPLAYEXTPROC>(eglGetProcAddress("eglGetPlatformDisplayEXT"));
  display_ = get_display == nullptr ? EGL_NO_DISPLAY : get_display(platform, native, nullptr);
  if (display_ == EGL_NO_DISPLAY || eglInitialize(display_, nullptr, nullptr) == EGL_FALSE)
    throw InputError("EGL: " + egl_error());
  try {
    const char* extensions = eglQueryString(display_, EGL_EXTENSIONS);
    if (surfaceless && !has(extensions, "EGL_KHR_surfaceless_context"))
      throw InputError(std::string("EGL: the driver has no contexts without a surface") + kOrSoftware);
    if (eglBindAPI(EGL_OPENGL_ES_API) == EGL_FALSE)
      throw InputError("EGL: there is no OpenGL ES: " + egl_error() + kOrSoftware);
    choose_config(visual, surfaceless ? 0 : EGL_WINDOW_BIT);
    constexpr EGLint kVersion2[] = {EGL_CONTEXT_CLIENT_VERSION, 2, EGL_NONE};
    context_ = eglCreateContext(display_, config_, EGL_NO_CONTEXT, kVersion2);
    if (context_ == EGL_NO_CONTEXT) throw InputError("EGL: no context of OpenGL ES 2.0: " + egl_error() + kOrSoftware);
  } catch (...) {
    if (owned_) eglTerminate(display_);
    throw;
  }
}

EglContext::~EglContext() {
  eglMakeCurrent(display_, EGL_NO_SURFACE, EGL_NO_SURFACE, EGL_NO_CONTEXT);
  eglDestroyContext(display_, context_);
  if (owned_) eglTerminate(display_);
}

void EglContext::choose_config(EGLint visual, EGLint surface_type) {
  const EGLint wanted[] = {EGL_SURFACE_TYPE,
                           surface_type,
                           EGL_RENDERABLE_TYPE,
                           EGL_OPENGL_ES2_BIT,
                           EGL_RED_SIZE,
                           8,
                           EGL_GREEN_SIZE,
                           8,
                           EGL_BLUE_SIZE,
                           8,
                           EGL_DEPTH_SIZE,
                           surface_type == 0 ? 0 : 16,
                           EGL_NONE};
  std::vector<EGLConfig> configs(256);
  EGLint count = 0;
  if (eglChooseConfig(display_, wanted, configs.data(), static_cast<EGLint>(configs.size()), &count) == EGL_FALSE)
    count = 0;
  configs.resize(static_cast<size_t>(count));
  const auto found = std::find_if(configs.begin(), configs.end(), [&](EGLConfig config) {
    EGLint of_config = 0;
    return visual == 0 ||
           (eglGetConfigAttrib(display_, config, EGL_NATIVE_VISUAL_ID, &of_config) == EGL_TRUE && of_config == visual);
  });
  if (found == configs.end())
    throw InputError(std::string("EGL: the driver has no OpenGL ES 2.0 with 8 bits a colour") + kOrSoftware);
  config_ = *found;
}

void EglContext::make_current(EGLSurface surface) const {
  if (eglMakeCurrent(display_, surface, surface, context_) == EGL_FALSE) throw InputError("EGL: " + egl_error());
}

void read_pixels(int width, int height, bool flipped, std::vector<uint8_t>* rgba) {
  const size_t row = static_cast<size_t>(width) * 4;
  rgba->resize(row * static_cast<size_t>(height));
  glReadPixels(0, 0, width, height, GL_RGBA, GL_UNSIGNED_BYTE, rgba->data());
  if (!flipped) return;
  for (int y = 0; y < height / 2; ++y) {
    uint8_t* top = rgba->data() + static_cast<size_t>(y) * row;
    std::swap_ranges(top, top + row, rgba->data() + static_cast<size_t>(height - 1 - y) * row);
  }
}

}  // namespace pptam::platform
