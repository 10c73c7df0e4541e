/* Whether the test runs as Cortex-M3 code in QEMU. What proves arithmetic over many cases runs on
 * the host only: double is slow there, and float_bits shows that the results are the same bits. */
#ifndef TARGET_H
#define TARGET_H

#include <stdbool.h>

#ifdef __arm__
#define ON_TARGET true
#else
#define ON_TARGET false
#endif

/* How often a test of the same C on both repeats itself: |target| times in QEMU, where it takes
 * long, for alignment, byte order and stack; as often as on the host in `make soak`. */
#if defined __arm__ && !defined QEMU_ALL
#define TIMES(host, target) (target)
#else
#define TIMES(host, target) (host)
#endif

#define RUN_ON_HOST(test)                                                                          \
    do {                                                                                           \
        if (!ON_TARGET) {                                                                          \
            RUN_TEST(test);                                                                        \
        }                                                                                          \
    } while (0)

#endif
