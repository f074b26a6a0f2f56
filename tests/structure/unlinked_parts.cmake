# What a profile does not name is not linked: no symbol of PARTS, classes of the core, is in EXECUTABLE. All of them are
# in CONTROL, whose profile names them: otherwise they are misspelt, or nm does not show what is there.
#
#   cmake -DNM=<nm> -DEXECUTABLE=<file> -DCONTROL=<file> -DPARTS="<class>,<class>..." -P unlinked_parts.cmake
cmake_minimum_required(VERSION 3.25)

# Those of the classes that have a symbol in the executable.
function(find_linked executable classes result)
  execute_process(COMMAND ${NM} -C ${executable} OUTPUT_VARIABLE symbols ERROR_VARIABLE error RESULT_VARIABLE failed)
  if(failed)
    message(FATAL_ERROR "${NM} cannot read ${executable}: ${error}")
  endif()
  set(linked "")
  foreach(class IN LISTS classes)
    if(symbols MATCHES "pptam::${class}[^A-Za-z0-9_]")
      list(APPEND linked ${class})
    endif()
  endforeach()
  set(${result} "${linked}" PARENT_SCOPE)
endfunction()

string(REPLACE "," ";" parts "${PARTS}")
find_linked(${CONTROL} "${parts}" found)
if(parts STREQUAL "" OR NOT found STREQUAL parts)
  message(FATAL_ERROR "of ${PARTS} the control ${CONTROL} has only: ${found}")
endif()
find_linked(${EXECUTABLE} "Tracker;Mapper" found)
if(NOT found STREQUAL "Tracker;Mapper")
  message(FATAL_ERROR "${EXECUTABLE} shows no symbols of the core")
endif()
find_linked(${EXECUTABLE} "${parts}" found)
if(found)
  message(FATAL_ERROR "linked without being named: ${found}")
endif()
message(STATUS "not linked: ${PARTS}")
