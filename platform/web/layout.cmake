# What JavaScript must know of pocket_ptam_c.h, as a source file that a compiler for WebAssembly turns into a table
# inside the library: structures with their fields, enumerators with their values. Nothing of it is written by hand,
# here or in pocket_ptam.js, so nothing can disagree.
#
#   pptam_write_layout(HEADER FILE)
#
# The header's own style is relied upon: one declaration a line, structures as "typedef struct NAME {" to "} NAME;".
# What does not look so is an error.
function(pptam_write_layout header file)
  file(STRINGS ${header} lines)
  set(structure "")
  set(text "")
  set(numbers "")
  foreach(line IN LISTS lines)
    string(REGEX REPLACE "//.*$" "" line "${line}")
    string(STRIP "${line}" line)
    if(structure STREQUAL "")
      if(line MATCHES "^typedef struct (pptam_[a-z_]+) {$")
        set(structure ${CMAKE_MATCH_1})
        string(APPEND text "struct ${structure}\\n")
        string(APPEND numbers "    static_cast<uint16_t>(sizeof(${structure})),\n")
      endif()
    elseif(line STREQUAL "} ${structure};")
      set(structure "")
    elseif(line MATCHES "^[a-z0-9_]+ \\(\\*([a-z]+)\\)\\(.*\\);$")
      string(APPEND text "pointer ${CMAKE_MATCH_1}\\n")
      string(APPEND numbers "    FIELD(${structure}, ${CMAKE_MATCH_1}, void*)\n")
    elseif(line MATCHES "^(const )?([a-z0-9_]+)(\\*?) ([A-Za-z0-9_, ]+|[A-Za-z0-9_]+\\[[A-Z0-9_]+\\]);$")
      set(type ${CMAKE_MATCH_2})
      set(element ${type})
      set(fields "${CMAKE_MATCH_4}")
      if(CMAKE_MATCH_3)
        set(type pointer)
        set(element void*)
      endif()
      string(REGEX REPLACE "\\[.*$" "" fields "${fields}")
      string(REPLACE ", " ";" fields "${fields}")
      foreach(field IN LISTS fields)
        string(APPEND text "${type} ${field}\\n")
        string(APPEND numbers "    FIELD(${structure}, ${field}, ${element})\n")
      endforeach()
    elseif(NOT line STREQUAL "")
      message(FATAL_ERROR "${header}: '${line}' of ${structure} is not read: see layout.cmake")
    endif()
  endforeach()
  file(READ ${header} all)
  string(REGEX REPLACE "//[^\n]*" "" all "${all}")
  string(REGEX MATCHALL "PPTAM_[A-Z0-9_]+" enumerators "${all}")
  list(REMOVE_DUPLICATES enumerators)
  list(REMOVE_ITEM enumerators PPTAM_API)
  foreach(name IN LISTS enumerators)
    string(APPEND text "enumerator ${name}\\n")
    string(APPEND numbers "    static_cast<uint16_t>(${name}),\n")
  endforeach()
  file(CONFIGURE OUTPUT ${file} @ONLY CONTENT [[
// Written by platform/web/layout.cmake.
#include <stddef.h>

#include <pocket_ptam/pocket_ptam_c.h>

#define FIELD(structure, field, element) \
  static_cast<uint16_t>(offsetof(structure, field)), \
      static_cast<uint16_t>(sizeof(structure::field) / sizeof(element)),

namespace {
constexpr char kText[] = "@text@";
constexpr uint16_t kNumbers[] = {
@numbers@};
}  // namespace

// Lines "struct NAME", "TYPE FIELD" and "enumerator NAME"; for each in turn its size, its offset and number of
// elements, or its value.
extern "C" {
const char* pptam_layout_text() { return kText; }
const uint16_t* pptam_layout_numbers() { return kNumbers; }
}
]])
endfunction()
