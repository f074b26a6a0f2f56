# Who may include whom: checks every #include "..." and #include <pocket_ptam/...> of the sources, and that no files
# include each other in a circle.
#
#   cmake -DROOT=<source folder> -P include_rules.cmake
#
# base <- {image, geometry, scheduler} <- camera <- map <- {tracking, mapping} <- system; camera <- edges. Public
# headers, pocket_ptam/, need nothing of all that; what they declare is made of it. Everybody in core sees their values
# (status, images, poses, cameras, Config, ...), system and the C interface alone the System. platform and sim_phone see
# them all and nothing else of core. platform (cameras, files) <- platform/run <- platform/calibrate <-
# sim_phone/laboratory <- platform/app, the program; the phone itself, sim_phone, sees of platform what a camera is made
# of. A file may always include its own folder. The core's headers are named without "core/".
#
# In circles a header and its source count as one, and so do a kernel's variants for several processors: what a file
# needs is what its source includes.
cmake_minimum_required(VERSION 3.25)

set(API "pocket_ptam/")
set(VALUES "status|image|se3|camera_model|camera|clock|work_meter|config|track_result|tracer|map_info|model_tracker")
set(VALUES "pocket_ptam/(${VALUES})\\.h")

set(ALLOWED_core/pocket_ptam "pocket_ptam/")
set(ALLOWED_core/c_interface "${API}|c_interface/")
set(ALLOWED_core/base "${VALUES}|base/")
set(ALLOWED_core/image "${VALUES}|base/|image/")
set(ALLOWED_core/geometry "${VALUES}|base/|geometry/")
set(ALLOWED_core/scheduler "${VALUES}|base/|scheduler/")
set(ALLOWED_core/camera "${VALUES}|base/|image/|geometry/|camera/")
set(ALLOWED_core/edges "${VALUES}|base/|image/|geometry/|camera/|edges/")
set(ALLOWED_core/map "${VALUES}|base/|image/|geometry/|scheduler/|camera/|map/")
set(ALLOWED_core/tracking "${ALLOWED_core/map}|tracking/")
set(ALLOWED_core/mapping "${ALLOWED_core/map}|mapping/")
set(ALLOWED_core "${API}|${ALLOWED_core/map}|tracking/|mapping/")

set(BELOW_RUN "${API}|platform/[^/]*$|platform/camera/|platform/display/|platform/model/")
set(ALLOWED_platform/app "${API}|platform/|sim_phone/")
set(ALLOWED_platform/run "${BELOW_RUN}|platform/run/")
set(ALLOWED_platform/calibrate "${ALLOWED_platform/run}|platform/calibrate/")
set(ALLOWED_platform "${BELOW_RUN}")
set(ALLOWED_sim_phone/laboratory "${API}|platform/[^/]*$|platform/run/|platform/calibrate/|platform/model/|sim_phone/")
set(ALLOWED_sim_phone "${API}|platform/(camera|trajectory|input_error|text)\\.h|platform/camera/image_files\\.h")
set(ALLOWED_sim_phone "${ALLOWED_sim_phone}|sim_phone/[^/]*$")
set(FOLDERS core/pocket_ptam core/c_interface core/base core/image core/geometry core/scheduler core/camera core/edges
    core/map core/tracking core/mapping core platform/app platform/calibrate platform/run platform
    sim_phone/laboratory sim_phone)

# The name that a file counts under in circles.
function(unit_of file result)
  string(REGEX REPLACE "(_armv6|_neon|_sse2|_words)?\\.[a-z]+$" "" unit "${file}")
  set(${result} "${unit}" PARENT_SCOPE)
endfunction()

# Takes away what includes nothing that is left, and what nothing that is left includes, until that changes nothing:
# circles remain, and ways from one to another.
function(only_circles edges result)
  set(before -1)
  list(LENGTH edges count)
  while(NOT count EQUAL before)
    set(from_units "")
    set(to_units "")
    foreach(edge IN LISTS edges)
      string(REPLACE " includes " ";" pair "${edge}")
      list(GET pair 0 from)
      list(GET pair 1 to)
      list(APPEND from_units "${from}")
      list(APPEND to_units "${to}")
    endforeach()
    set(kept "")
    foreach(edge from to IN ZIP_LISTS edges from_units to_units)
      if(to IN_LIST from_units AND from IN_LIST to_units)
        list(APPEND kept "${edge}")
      endif()
    endforeach()
    set(before ${count})
    set(edges "${kept}")
    list(LENGTH edges count)
  endwhile()
  set(${result} "${edges}" PARENT_SCOPE)
endfunction()

# Violations in the files below root, as a list of "file includes header", and in CIRCLE the includes that go round, as
# a list of "unit includes unit".
function(find_violations root result)
  set(violations "")
  set(checked 0)
  set(edges "")
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
    file(STRINGS ${root}/${file} lines REGEX "^[ \t]*#[ \t]*include[ \t]*(\"|<pocket_ptam/)")
    foreach(line IN LISTS lines)
      string(REGEX REPLACE "^[^\"<]*[\"<]([^\">]*)[\">].*$" "\\1" header "${line}")
      math(EXPR checked "${checked} + 1")
      if(NOT header MATCHES "^(${allowed})" OR header MATCHES "\\.\\.")
        list(APPEND violations "${file} includes ${header}")
      endif()
      if(NOT header MATCHES "^(platform|sim_phone)/")
        set(header "core/${header}")
      endif()
      unit_of(${file} from)
      unit_of(${header} to)
      if(NOT from STREQUAL to)
        list(APPEND edges "${from} includes ${to}")
      endif()
    endforeach()
  endforeach()
  list(REMOVE_DUPLICATES edges)
  only_circles("${edges}" circle)
  set(CIRCLE "${circle}" PARENT_SCOPE)
  set(${result} "${violations}" PARENT_SCOPE)
  set(CHECKED ${checked} PARENT_SCOPE)
endfunction()

# The check can fail: a bad sample is found out, line by line.
set(sample ${CMAKE_CURRENT_BINARY_DIR}/include_rules_sample)
file(REMOVE_RECURSE ${sample})
file(WRITE ${sample}/core/base/a.h "#include \"base/b.h\"\n#include \"image/pyramid.h\"\n")
file(WRITE ${sample}/core/pocket_ptam/a.h "#include <pocket_ptam/status.h>\n#include \"base/b.h\"\n")
file(WRITE ${sample}/core/tracking/b.cpp "#include <pocket_ptam/config.h>\n#include <pocket_ptam/pocket_ptam.h>\n")
file(WRITE ${sample}/core/tracking/a.cpp "#include \"map/map.h\"\n  # include \"mapping/mapper.h\"\n#include <cmath>\n")
file(WRITE ${sample}/core/mapping/a.cpp "#include \"tracking/tracker.h\"\n#include \"mapping/a.h\"\n")
file(WRITE ${sample}/core/system.cpp "#include \"tracking/tracker.h\"\n#include \"platform/camera.h\"\n")
file(WRITE ${sample}/core/edges/a.cpp "#include \"camera/small_image.h\"\n#include \"map/map.h\"\n")
file(WRITE ${sample}/core/image/a.cpp "#include \"image/../map/map.h\"\n")
file(WRITE ${sample}/platform/a.cpp "#include <pocket_ptam/pocket_ptam.h>\n#include \"map/map.h\"\n")
file(WRITE ${sample}/platform/app/a.cpp "#include \"sim_phone/scene.h\"\n#include \"platform/app/options.h\"\n")
file(WRITE ${sample}/platform/run/a.cpp "#include \"platform/files.h\"\n#include \"sim_phone/scene.h\"\n")
file(WRITE ${sample}/sim_phone/a.cpp "#include \"platform/camera.h\"\n#include \"platform/run/run.h\"\n")
file(WRITE ${sample}/sim_phone/b.cpp "#include \"sim_phone/a.h\"\n#include \"sim_phone/laboratory/a.h\"\n")
file(WRITE ${sample}/sim_phone/laboratory/a.cpp "#include \"platform/run/run.h\"\n#include \"platform/app/a.h\"\n")
# A circle that only the sources close, with ways into it and out of it; a kernel and its variant are none.
file(WRITE ${sample}/core/map/a.cpp "#include \"map/b.h\"\n#include \"map/a.h\"\n")
file(WRITE ${sample}/core/map/b.h "#include \"map/c.h\"\n#include <pocket_ptam/status.h>\n")
file(WRITE ${sample}/core/map/c.cpp "#include \"map/a.h\"\n")
file(WRITE ${sample}/core/map/d.h "#include \"map/a.h\"\n")
file(WRITE ${sample}/core/image/b.cpp "#include \"image/b_sse2.h\"\n")
file(WRITE ${sample}/core/image/b_sse2.h "#include \"image/b.h\"\n")
set(expected
    "core/base/a.h includes image/pyramid.h"
    "core/edges/a.cpp includes map/map.h"
    "core/image/a.cpp includes image/../map/map.h"
    "core/mapping/a.cpp includes tracking/tracker.h"
    "core/pocket_ptam/a.h includes base/b.h"
    "core/system.cpp includes platform/camera.h"
    "core/tracking/a.cpp includes mapping/mapper.h"
    "core/tracking/b.cpp includes pocket_ptam/pocket_ptam.h"
    "platform/a.cpp includes map/map.h"
    "platform/run/a.cpp includes sim_phone/scene.h"
    "sim_phone/a.cpp includes platform/run/run.h"
    "sim_phone/b.cpp includes sim_phone/laboratory/a.h"
    "sim_phone/laboratory/a.cpp includes platform/app/a.h")
set(expected_circle
    "core/map/a includes core/map/b"
    "core/map/b includes core/map/c"
    "core/map/c includes core/map/a")
find_violations(${sample} found)
file(REMOVE_RECURSE ${sample})
if(NOT "${found}" STREQUAL "${expected}" OR NOT "${CIRCLE}" STREQUAL "${expected_circle}")
  list(JOIN found "\n  " found)
  list(APPEND found "in a circle:" ${CIRCLE})
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
if(CIRCLE)
  list(JOIN CIRCLE "\n  " circle)
  message(FATAL_ERROR "files that include each other in a circle:\n  ${circle}")
endif()
message(STATUS "${CHECKED} includes, all allowed, no circle")
