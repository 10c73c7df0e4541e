# The fish's core in QEMU, for the unit tests. Same compiler and flags as the image.
include(${CMAKE_CURRENT_LIST_DIR}/cortex-m3.cmake)
set(CMAKE_CROSSCOMPILING_EMULATOR qemu-system-arm -M mps2-an385 -display none -monitor none
  -serial none -semihosting-config enable=on,target=native -kernel)
