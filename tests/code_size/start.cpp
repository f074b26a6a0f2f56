// A program that does nothing: what is linked into it is what the linker is told to keep of the library.
extern "C" void start();
extern "C" void start() {}
