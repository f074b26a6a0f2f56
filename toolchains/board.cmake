# Boards and phones with Debian: the whole program, against the sysroot of toolchains/make_sysroot.sh. PPTAM_BOARD says
# which: arm64, armhf or armel, as Debian calls them. Debian: g++-12-aarch64-linux-gnu and so on, qemu-user.
if(PPTAM_BOARD STREQUAL "arm64")
  set(CMAKE_SYSTEM_PROCESSOR aarch64)
  set(triplet aarch64-linux-gnu)
  set(CMAKE_CROSSCOMPILING_EMULATOR qemu-aarch64 -cpu cortex-a53)
elseif(PPTAM_BOARD STREQUAL "armhf")  # with NEON, which only the first ARMv7 boards lack
  set(CMAKE_SYSTEM_PROCESSOR armv7)
  set(triplet arm-linux-gnueabihf)
  set(cpu "-march=armv7-a -mtune=cortex-a7 -mfpu=neon -mfloat-abi=hard -Wno-psabi")
  set(CMAKE_CROSSCOMPILING_EMULATOR qemu-arm -cpu cortex-a8)  # of those with NEON the oldest
elseif(PPTAM_BOARD STREQUAL "armel")  # ARMv6 with VFP2: see armv6-linux-gnueabi.cmake
  set(CMAKE_SYSTEM_PROCESSOR armv6)
  set(triplet arm-linux-gnueabi)
  set(cpu "-marm -mcpu=arm1176jzf-s -mfpu=vfp -mfloat-abi=softfp -Wno-psabi")
  set(CMAKE_CROSSCOMPILING_EMULATOR qemu-arm -cpu arm1176)
else()
  message(FATAL_ERROR "PPTAM_BOARD is \"${PPTAM_BOARD}\": it must be arm64, armhf or armel")
endif()
set(PPTAM_SYSROOT "${CMAKE_CURRENT_LIST_DIR}/../build/sysroots/${PPTAM_BOARD}" CACHE PATH "The board's libraries")
get_filename_component(PPTAM_SYSROOT "${PPTAM_SYSROOT}" ABSOLUTE)
if(PPTAM_SYSROOT MATCHES " ")  # CMake does not recognise libraries there
  message(FATAL_ERROR "The sysroot's path holds a space: ${PPTAM_SYSROOT}. Make it elsewhere, by "
                      "toolchains/make_sysroot.sh --folder DIR, and give -D PPTAM_SYSROOT=DIR")
endif()
if(NOT EXISTS ${PPTAM_SYSROOT}/usr/lib/${triplet}/libc.so)
  message(FATAL_ERROR "No sysroot for ${PPTAM_BOARD} in ${PPTAM_SYSROOT}: toolchains/make_sysroot.sh makes it")
endif()
set(CMAKE_TRY_COMPILE_PLATFORM_VARIABLES PPTAM_BOARD PPTAM_SYSROOT)
list(APPEND CMAKE_CROSSCOMPILING_EMULATOR -L ${PPTAM_SYSROOT})

set(CMAKE_SYSTEM_NAME Linux)
set(CMAKE_SYSROOT ${PPTAM_SYSROOT})
set(CMAKE_FIND_ROOT_PATH_MODE_PROGRAM NEVER)
set(CMAKE_FIND_ROOT_PATH_MODE_LIBRARY ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_INCLUDE ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_PACKAGE ONLY)
set(ENV{PKG_CONFIG_SYSROOT_DIR} ${PPTAM_SYSROOT})
set(ENV{PKG_CONFIG_LIBDIR} ${PPTAM_SYSROOT}/usr/lib/${triplet}/pkgconfig:${PPTAM_SYSROOT}/usr/share/pkgconfig)

# Debian 12's compiler, which 13 has too: what it makes runs on both.
set(CMAKE_CXX_COMPILER ${triplet}-g++-12)
# It comes with libraries of its own, C's and C++'s, and would look there first. When those are newer than the board's,
# the program would not start.
execute_process(COMMAND ${CMAKE_CXX_COMPILER} -print-file-name=include
                OUTPUT_VARIABLE own OUTPUT_STRIP_TRAILING_WHITESPACE)
set(standard /usr/${triplet}/include/c++/12)
set(usr ${PPTAM_SYSROOT}/usr)
set(flags -nostdinc)
foreach(directory ${standard} ${standard}/${triplet} ${own} ${usr}/include/${triplet} ${usr}/include)
  string(APPEND flags " -isystem ${directory}")
endforeach()
set(CMAKE_CXX_FLAGS_INIT "${flags} ${cpu}")
foreach(kind EXE MODULE SHARED)
  set(CMAKE_${kind}_LINKER_FLAGS_INIT "-B${usr}/lib/${triplet} -L${usr}/lib/${triplet}")
endforeach()
set(ENV{CCACHE_DISABLE} 1)  # while configuring: it can rewrite these paths, and CMake would not know them again
