# The 2009 camera phone: ARM1176JZF-S, ARMv6 with VFP2, no NEON. Debian: g++-arm-linux-gnueabi, qemu-user.
set(CMAKE_SYSTEM_NAME Linux)
set(CMAKE_SYSTEM_PROCESSOR armv6)
set(CMAKE_CXX_COMPILER arm-linux-gnueabi-g++)
# softfp: floats are computed in VFP registers and passed in integer ones, as Debian's libraries for this target expect.
set(CMAKE_CXX_FLAGS_INIT "-marm -mcpu=arm1176jzf-s -mfpu=vfp -mfloat-abi=softfp -Wno-psabi")
set(CMAKE_EXE_LINKER_FLAGS_INIT -static)
set(CMAKE_CROSSCOMPILING_EMULATOR qemu-arm -cpu arm1176)
