#!/usr/bin/env python3
"""What example.c does, from Python by ctypes: see there.

  ffmpeg ... | ./example.py LIBRARY camera.txt times.txt > trajectory.txt

LIBRARY: libpocket-ptam.so.0, or its path.
"""
import ctypes
import sys
from ctypes import POINTER, Structure, byref, c_bool, c_char_p, c_float, c_int32, c_int64, c_size_t, c_uint32, c_void_p


class Status(Structure):
    _fields_ = [("code", c_int32), ("message", c_char_p)]


class Pose(Structure):
    _fields_ = [("R", c_float * 9), ("t", c_float * 3)]


class Camera(Structure):
    _fields_ = [("width", c_int32), ("height", c_int32), ("fx", c_float), ("fy", c_float), ("cx", c_float),
                ("cy", c_float), ("distortion", c_int32), ("coeffs", c_float * 5), ("shutter_axis", c_int32),
                ("line_time_s", c_float)]


class Config(Structure):
    _fields_ = ([("camera", Camera), ("exposure_s", c_float)] +
                [(name, c_int32) for name in (
                    "max_keyframes max_erased_keyframes max_maps max_map_points max_measurements "
                    "max_measurements_per_point max_partial_points max_measured_points max_partial_searches "
                    "max_new_partial_points max_initial_points cells_x cells_y search_level "
                    "coarse_search_level").split()] +
                [("initial_baseline", c_float), ("initial_plane_distance", c_float), ("auto_start", c_bool),
                 ("min_keyframe_interval_s", c_float), ("steady_damping", c_bool), ("clock_mhz", c_float),
                 ("cycles_per_instruction", c_float), ("instructions", c_float * 20)])


class Frame(Structure):
    _fields_ = [("data", c_char_p), ("width", c_int32), ("height", c_int32), ("stride_bytes", c_int32),
                ("format", c_int32), ("timestamp_ns", c_int64)]


class Result(Structure):
    _fields_ = ([("timestamp_ns", c_int64), ("state", c_int32), ("quality", c_int32), ("hint", c_int32),
                 ("progress", c_float), ("limits_hit", c_uint32)] +
                [(name, c_bool) for name in "pose_valid blurred misfit keyframe_added repeated".split()] +
                [("T_cw", Pose), ("velocity", c_float * 6), ("covariance", c_float * 36)] +
                [(name, c_int32) for name in "points_attempted points_found points_inliers".split()] +
                [("reprojection_px", c_float)] +
                [(name, c_int32) for name in (
                    "partial_attempted partial_found map world_changes maps keyframes erased_keyframes map_points "
                    "observed_points").split()] +
                [("stage_ns", c_int64 * 7)])


def load(path):
    library = ctypes.CDLL(path)
    pointers = {"config_phone": 2, "config_validate": 1, "tap": 1, "work_slice": 1, "track": 3,
                "inverse_as_quaternion": 3}
    for name, count in pointers.items():
        function = getattr(library, "pptam_" + name)
        function.restype, function.argtypes = Status, [c_void_p] * count
    library.pptam_create.restype = Status
    library.pptam_create.argtypes = [c_void_p, c_void_p, c_size_t, POINTER(c_void_p)]
    for name, result in {"required_bytes": c_size_t, "has_work": c_bool, "work_ns": c_int64,
                         "map_hash": ctypes.c_uint64}.items():
        function = getattr(library, "pptam_" + name)
        function.restype, function.argtypes = result, [c_void_p]
    return library


def check(status):
    if status.code != 0:
        sys.exit("example: " + status.message.decode())


def main():
    if len(sys.argv) != 4:
        sys.exit("usage: example.py LIBRARY camera.txt times.txt < frames")
    ptam = load(sys.argv[1])
    with open(sys.argv[2]) as file:
        numbers = file.read().split()
    width, height, axis = (int(numbers[i]) for i in (0, 1, 6))
    fx, fy, cx, cy = (float(number) for number in numbers[2:6])
    camera = Camera(width, height, fx, fy, cx, cy, 0, (c_float * 5)(), axis, float(numbers[7]))
    config = Config()
    check(ptam.pptam_config_phone(byref(camera), byref(config)))
    config.exposure_s = float(numbers[8])
    check(ptam.pptam_config_validate(byref(config)))
    size = ptam.pptam_required_bytes(byref(config))
    block = ctypes.create_string_buffer(size + 16)
    aligned = (ctypes.addressof(block) + 15) // 16 * 16
    system = c_void_p()
    check(ptam.pptam_create(byref(config), aligned, size, byref(system)))
    check(ptam.pptam_tap(system))

    first_ns, waited_ns = None, 0
    with open(sys.argv[3]) as file:
        times = file.read().split()
    for time in times:
        image = sys.stdin.buffer.read(width * height)
        if len(image) < width * height:
            break
        seconds, decimals = time.split(".")
        now_ns = int(seconds) * 1000000000 + int(decimals)
        first_ns = now_ns if first_ns is None else first_ns
        while ptam.pptam_work_ns(system) + waited_ns < now_ns - first_ns and ptam.pptam_has_work(system):
            ptam.pptam_work_slice(system)
        waited_ns = max(waited_ns, now_ns - first_ns - ptam.pptam_work_ns(system))
        frame = Frame(image, width, height, width, 0, now_ns)
        result = Result()
        check(ptam.pptam_track(system, byref(frame), byref(result)))
        if result.pose_valid:
            position, quaternion = (c_float * 3)(), (c_float * 4)()
            check(ptam.pptam_inverse_as_quaternion(byref(result.T_cw), position, quaternion))
            print(time, *("%.9g" % number for number in (*position, *quaternion)))
    print("map hash %016x" % ptam.pptam_map_hash(system), file=sys.stderr)


main()
