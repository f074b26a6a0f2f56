# Microcontrollers without an operating system: Cortex-M7 with a double-precision floating point unit, newlib. Debian:
# gcc-arm-none-eabi, libstdc++-arm-none-eabi-newlib, qemu-system-arm. The program that is emulated speaks through
# semihosting; its start-up code and linker script are in tests/bare_metal.
set(CMAKE_SYSTEM_NAME Generic)
set(CMAKE_SYSTEM_PROCESSOR cortex-m7)
set(CMAKE_TRY_COMPILE_TARGET_TYPE STATIC_LIBRARY)
set(CMAKE_CXX_COMPILER arm-none-eabi-g++)
set(CMAKE_CXX_FLAGS_INIT "-mcpu=cortex-m7 -mthumb -mfloat-abi=hard -mfpu=fpv5-d16 -Wno-psabi")
string(APPEND CMAKE_CXX_FLAGS_INIT " -ffunction-sections -fdata-sections")  # what is not used is not linked
set(CMAKE_CROSSCOMPILING_EMULATOR qemu-system-arm -M mps2-an500 -nographic
    -semihosting-config enable=on,target=native -kernel)
