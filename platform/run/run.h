// Runs one sequence: frames from a Camera, in time, into a System; everything that happened goes into a RunLog.
//
// A frame arrives at its timestamp on the chosen clock. The time before it belongs to mapping, in slices. When tracking
// was so slow that the next frame has arrived already, the older one is dropped, as a camera does.
#pragma once

#include <functional>

#include <pocket_ptam/pocket_ptam.h>
#include "platform/camera.h"
#include "platform/run/run_log.h"
#include "platform/run/session.h"
#include "platform/run/spectator.h"

namespace pptam::platform {

// Called after each tracked frame, while its pixels and the result's points are valid.
using FrameObserver = std::function<void(const Frame&, const TrackResult&, const RunLog&)>;
// Called once, after the first frame was read and the system was built: everything that can be wrong with the input has
// been checked, outputs may be created now.
using StartObserver = std::function<void(const CameraInfo&)>;

// Throws InputError when nothing could be tracked (no first frame, a calibration that the system refuses); a
// source that breaks later ends the run and leaves its reason in RunLog::broken, and so does a signal
// (platform/run/interruption.h) after the frame that it meets. A key that quits is no breaking.
RunLog run_sequence(Camera& camera, const RunOptions& options, const StartObserver& on_start,
                    const FrameObserver& on_frame, const Spectator& spectator = {});

}  // namespace pptam::platform
