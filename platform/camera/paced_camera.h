// A source of files in real time, as a live camera: a frame comes when it is due, and late ones are dropped.
#pragma once

#include <memory>

#include "platform/camera.h"

namespace pptam::platform {

std::unique_ptr<Camera> make_paced_camera(std::unique_ptr<Camera> source);

}  // namespace pptam::platform
