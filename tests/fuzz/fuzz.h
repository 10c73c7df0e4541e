/* What the fuzz targets share: an input taken apart piece by piece, and what must always hold. */
#ifndef FUZZ_FUZZ_H
#define FUZZ_FUZZ_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Ends the process: the fuzzer keeps the input, tests/unit/run.py reports the target. */
#define MUST(condition)                                                                            \
    ((condition) ? (void)0                                                                         \
                 : (fprintf(stderr, "%s:%d: does not hold: %s\n", __FILE__, __LINE__, #condition), \
                    abort()))

/* Called by libFuzzer (clang) or by replay.c (any compiler); always 0. */
int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t length);

typedef struct {
    const uint8_t *at;
    size_t left;
} input_t;

/* Numbers are little-endian; past the end everything is 0. */
static inline uint8_t take_u8(input_t *in) {
    if (in->left == 0) {
        return 0;
    }
    in->left--;
    return *in->at++;
}

static inline uint16_t take_u16(input_t *in) {
    const unsigned low = take_u8(in);
    return (uint16_t)(low | (unsigned)take_u8(in) << 8);
}

static inline uint32_t take_u32(input_t *in) {
    const uint32_t low = take_u16(in);
    return low | (uint32_t)take_u16(in) << 16;
}

/* Up to |max| bytes that stay in the input; |*got| of them are there. */
static inline const uint8_t *take_bytes(input_t *in, size_t max, size_t *got) {
    const uint8_t *at = in->at;
    *got = in->left < max ? in->left : max;
    in->at += *got;
    in->left -= *got;
    return at;
}

/* The same into |out|, filled up with zeros. */
static inline void take_into(input_t *in, uint8_t *out, size_t length) {
    size_t got = 0;
    const uint8_t *bytes = take_bytes(in, length, &got);
    memset(out, 0, length);
    memcpy(out, bytes, got);
}

#endif
