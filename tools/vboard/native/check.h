/* Assertions that are always on. */
#ifndef VBOARD_CHECK_H
#define VBOARD_CHECK_H

#include <stdio.h>
#include <stdlib.h>

#define VB_CHECK(condition)                                                                        \
    do {                                                                                           \
        if (!(condition)) {                                                                        \
            (void)fprintf(stderr, "vboard: %s:%d: %s\n", __FILE__, __LINE__, #condition);          \
            abort();                                                                               \
        }                                                                                          \
    } while (0)

#endif
