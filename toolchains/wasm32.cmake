# WebAssembly, for browsers and Node.js: a library without imports, so nothing of an operating system. Debian: clang-19,
# lld-19, libclang-rt-19-dev-wasm32, libc++-19-dev-wasm32, wasi-libc (Debian 12's clang 14 comes without C++'s headers
# for it), nodejs. What it may use of WebAssembly every browser since 2021 has.
set(CMAKE_SYSTEM_NAME Generic)
set(CMAKE_SYSTEM_PROCESSOR wasm32)
set(CMAKE_TRY_COMPILE_TARGET_TYPE STATIC_LIBRARY)
set(CMAKE_CXX_COMPILER clang++-19)
set(CMAKE_CXX_COMPILER_TARGET wasm32-wasi)
set(CMAKE_CXX_FLAGS_INIT "-mcpu=mvp -mbulk-memory -mmutable-globals -mnontrapping-fptoint -msign-ext")
string(APPEND CMAKE_CXX_FLAGS_INIT " -ffunction-sections -fdata-sections")  # what is not used is not linked
set(CMAKE_CROSSCOMPILING_EMULATOR node)
