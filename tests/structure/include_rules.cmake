# Who may include whom: checks every #include "..." of the sources.
#
#   cmake -DROOT=<source folder> -P include_rules.cmake
#
# base <- {image, geometry, scheduler}, {image, geometry} <- camera <- map <- {tracking, mapping} <- system. platform and sim_phone see the core's
# public API and image/image.h; platform/app is the program and sees all of platform and sim_phone. A file may always
# include its own folder. The core's headers are named without "core/".
cmake_minimum_required(VERSION 3.25)

set(API "pocket_ptam\\.h|pocket_ptam_c\\.h|image/image\\.h")
# What pocket_ptam.h itself includes is part of the public API.
set(API "${API}|base/status\\.h|base/work_meter\\.h|camera/camera\\.h|camera/camera_model\\.h|geometry/se3\\.h")
set(API "${API}|scheduler/clock\\.h")

set(ALLOWED_core/base "base/")
set(ALLOWED_core/image "base/|image/")
set(ALLOWED_core/geometry "base/|geometry/")
set(ALLOWED_core/scheduler "base/|scheduler/")
set(ALLOWED_core/camera "base/|image/|geometry/|camera/")
set(ALLOWED_core/map "base/|image/|geometry/|scheduler/|camera/|map/|pocket_ptam\\.h")
set(ALLOWED_core/tracking "${ALLOWED_core/map}|tracking/")
set(ALLOWED_core/mapping "${ALLOWED_core/map}|mapping/")
set(ALLOWED_core "${ALLOWED_core/map}|tracking/|mapping/|pocket_ptam_c\\.h")
# Image files and overlays are turned to grey by the very conversion that frames go through.
set(API "${API}|image/grey\\.h")

set(ALLOWED_platform/app "${API}|platform/|sim_phone/")
set(ALLOWED_platform "${API}|platform/[^/]*$|platform/camera/|platform/display/")
set(ALLOWED_sim_phone "${API}|platform/camera\\.h|platform/trajectory\\.h|platform/camera/image_files\\.h|sim_phone/")
set(FOLDERS core/base core/image core/geometry core/scheduler core/camera core/map core/tracking core/mapping core
    platform/app platform sim_phone)

# Violations in the files below root, as a list of "file includes header".
function(find_violations root result)
  set(violations "")
  set(checked 0)
  file(GLOB_RECURSE files RELATIVE ${root} ${root}/core/*.h ${root}/core/*.cpp ${root}/core/*.c ${root}/platform/*.h
       ${root}/platform/*.cpp ${root}/sim_phone/*.h ${root}/sim_phone/*.cpp)
  list(SORT files)
  foreach(file IN LISTS files)
    set(allowed "none")
    foreach(folder IN LISTS FOLDERS)
      if(file MATCHES "^${folder}/")
        set(allowed "${ALLOWED_${folder}}")
        break()
      endif()
    endforeach()
    file(STRINGS ${root}/${file} lines REGEX "^[ \t]*#[ \t]*include[ \t]*\"")
    foreach(line IN LISTS lines)
      string(REGEX REPLACE "^[^\"]*\"([^\"]*)\".*$" "\\1" header "${line}")
      math(EXPR checked "${checked} + 1")
      if(NOT header MATCHES "^(${allowed})" OR header MATCHES "\\.\\.")
        list(APPEND violations "${file} includes ${header}")
      endif()
    endforeach()
  endforeach()
  set(${result} "${violations}" PARENT_SCOPE)
  set(CHECKED ${checked} PARENT_SCOPE)
endfunction()

# The check can fail: a bad sample is found out, line by line.
set(sample ${CMAKE_CURRENT_BINARY_DIR}/include_rules_sample)
file(REMOVE_RECURSE ${sample})
file(WRITE ${sample}/core/base/a.h "#include \"base/b.h\"\n#include \"image/image.h\"\n")
file(WRITE ${sample}/core/tracking/a.cpp "#include \"map/map.h\"\n  # include \"mapping/mapper.h\"\n#include <cmath>\n")
file(WRITE ${sample}/core/mapping/a.cpp "#include \"tracking/tracker.h\"\n#include \"mapping/a.h\"\n")
file(WRITE ${sample}/core/system.cpp "#include \"tracking/tracker.h\"\n#include \"platform/camera.h\"\n")
file(WRITE ${sample}/core/camera/a.h "#include \"camera/b.h\"\n#include \"map/map.h\"\n")
file(WRITE ${sample}/core/geometry/a.h "#include \"camera/camera.h\"\n")
file(WRITE ${sample}/core/image/a.cpp "#include \"image/../map/map.h\"\n")
file(WRITE ${sample}/platform/a.cpp "#include \"pocket_ptam.h\"\n#include \"map/map.h\"\n")
file(WRITE ${sample}/platform/app/a.cpp "#include \"sim_phone/scene.h\"\n#include \"platform/app/run.h\"\n")
file(WRITE ${sample}/sim_phone/a.cpp "#include \"platform/camera.h\"\n#include \"platform/app/run.h\"\n")
set(expected
    "core/base/a.h includes image/image.h"
    "core/camera/a.h includes map/map.h"
    "core/geometry/a.h includes camera/camera.h"
    "core/image/a.cpp includes image/../map/map.h"
    "core/mapping/a.cpp includes tracking/tracker.h"
    "core/system.cpp includes platform/camera.h"
    "core/tracking/a.cpp includes mapping/mapper.h"
    "platform/a.cpp includes map/map.h"
    "sim_phone/a.cpp includes platform/app/run.h")
find_violations(${sample} found)
file(REMOVE_RECURSE ${sample})
if(NOT "${found}" STREQUAL "${expected}")
  list(JOIN found "\n  " found)
  message(FATAL_ERROR "the bad sample was judged wrongly; found:\n  ${found}")
endif()

find_violations(${ROOT} found)
if(CHECKED LESS 50)
  message(FATAL_ERROR "only ${CHECKED} includes seen under '${ROOT}': is it the source folder?")
endif()
if(found)
  list(JOIN found "\n  " found)
  message(FATAL_ERROR "forbidden includes:\n  ${found}")
endif()
message(STATUS "${CHECKED} includes, all allowed")
