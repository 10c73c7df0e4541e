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

#define RUN_ON_HOST(test)                                                                          \
    do {                                                                                           \
        if (!ON_TARGET) {                                                                          \
            RUN_TEST(test);                                                                        \
        }                                                                                          \
    } while (0)

#endif
