// Xlib ends the program when the window was destroyed by another, or the server has gone. With this it does not.
#pragma once

struct SDL_Window;

namespace pptam::platform {

// Nothing where the window is not X11's.
void survive_x11(SDL_Window* window);
// Whether that has happened: the window is no more, and nothing of it can be asked to go.
bool x11_failed();

}  // namespace pptam::platform
