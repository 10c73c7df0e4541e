# Toolchain of the fish's microcontroller core (ATSAM3X8E: Cortex-M3, no FPU).
set(CMAKE_SYSTEM_NAME Generic)
set(CMAKE_SYSTEM_PROCESSOR cortex-m3)
set(CMAKE_C_COMPILER arm-none-eabi-gcc)
set(CMAKE_TRY_COMPILE_TARGET_TYPE STATIC_LIBRARY)
set(CMAKE_BUILD_TYPE MinSizeRel CACHE STRING "Optimise for size")

# A function inlined into its only caller would lend it its buffers on every path: not inlining saves
# stack and 0.7 KB of code. What each function needs goes into .su files (tools/size_report.py).
# Without scheduling, loop invariants kept in registers, values kept across calls, split functions,
# clones for constant arguments, threaded jumps and jumps to equal ends the code is 1.4 KB smaller: a
# Cortex-M3 has neither a pipeline to fill nor registers to spare.
# What the optimiser knows of the whole program must not tell it that a function leaves a variable
# alone that an interrupt writes meanwhile: neither -fipa-reference nor -fipa-pta.
set(CMAKE_C_FLAGS_INIT "-mcpu=cortex-m3 -mthumb -ffunction-sections -fdata-sections \
-fno-inline-functions-called-once -fno-schedule-insns2 -fno-move-loop-invariants \
-fno-caller-saves -fno-partial-inlining -fno-tree-tail-merge -fno-thread-jumps -fno-ipa-cp -fno-ipa-reference \
-fstack-usage")
