// The emulated phone: a scene, a hand that moves, and a rolling-shutter image sensor, as a platform::Camera.
#pragma once

#include <memory>

#include "platform/camera.h"
#include "sim_phone/phone_options.h"
#include "sim_phone/scene.h"

namespace pptam::sim {

// The scene that the options ask for.
Scene make_scene(const PhoneOptions& options);
// Throws platform::InputError on options that make no sense, naming the option.
void check_phone_options(const PhoneOptions& options);
// Checks likewise. scene: the one that the options ask for, when it has been painted before.
std::unique_ptr<platform::Camera> make_phone_camera(const PhoneOptions& options,
                                                    std::shared_ptr<const Scene> scene = nullptr);

}  // namespace pptam::sim
