# How C is compiled. tailbeat_common holds for everything, other people's sources included.
add_library(tailbeat_common INTERFACE)
# Assertions name their file: without the folder on this machine the image is smaller and the same
# wherever it is built.
target_compile_options(tailbeat_common INTERFACE -ffp-contract=off -fno-semantic-interposition
  -fmacro-prefix-map=${PROJECT_SOURCE_DIR}/= -fmacro-prefix-map=${PROJECT_SOURCE_DIR}/firmware/=)
if(TAILBEAT_SANITIZE)
  target_compile_options(tailbeat_common INTERFACE
    -g1 -O1 -fno-omit-frame-pointer -fsanitize=address,undefined -fno-sanitize-recover=all)
  target_link_options(tailbeat_common INTERFACE -fsanitize=address,undefined)
  # A hundred programs are linked, by the quicker linker that binutils may bring in half of the time.
  include(CheckLinkerFlag)
  check_linker_flag(C -fuse-ld=gold TAILBEAT_HAS_GOLD)
  if(TAILBEAT_HAS_GOLD AND CMAKE_C_COMPILER_ID STREQUAL GNU)
    target_link_options(tailbeat_common INTERFACE -fuse-ld=gold)
  endif()
endif()

add_library(tailbeat_warnings INTERFACE)
target_compile_options(tailbeat_warnings INTERFACE -Wall -Wextra -Wconversion
  $<$<BOOL:${TAILBEAT_WERROR}>:-Werror>)
target_link_libraries(tailbeat_warnings INTERFACE tailbeat_common)

# Code that also runs on the board, which has no double in hardware.
add_library(tailbeat_strict INTERFACE)
target_compile_options(tailbeat_strict INTERFACE -Wdouble-promotion)
target_link_libraries(tailbeat_strict INTERFACE tailbeat_warnings)

add_library(tailbeat_measured INTERFACE)
if(TAILBEAT_COVERAGE)
  target_compile_options(tailbeat_measured INTERFACE --coverage)
  target_link_options(tailbeat_measured INTERFACE --coverage)
endif()

# The host's library and the benchmarks are optimised for speed, over all files: the simulated board
# takes a quarter fewer instructions. Not for tests, which are many small programs and have sanitizers.
if(NOT (TAILBEAT_BARE_METAL OR TAILBEAT_TESTS OR TAILBEAT_SANITIZE OR TAILBEAT_COVERAGE))
  set(CMAKE_C_FLAGS_RELEASE "-O3 -fno-math-errno") # nobody reads errno: a square root is one instruction
  include(CheckIPOSupported)
  check_ipo_supported(RESULT CMAKE_INTERPROCEDURAL_OPTIMIZATION_RELEASE OUTPUT ipo_missing LANGUAGES C)
  # Calls that are inlined across files let gcc think of paths that no caller takes.
  add_link_options($<$<C_COMPILER_ID:GNU>:-Wno-stringop-overread>)
endif()

# The image is optimised for size over all files: 2.8 KB less. In one piece, so that it is the same on
# every machine.
if(TAILBEAT_BARE_METAL AND NOT TAILBEAT_TESTS)
  set(CMAKE_INTERPROCEDURAL_OPTIMIZATION ON)
  add_link_options(-flto-partition=one)
endif()
