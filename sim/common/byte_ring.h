/* A ring of bytes whose positions count on for ever: bytes in and out, around its end. */
#ifndef SIM_BYTE_RING_H
#define SIM_BYTE_RING_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

/* The part of a ring of |size| bytes, a power of two, from position |at| on into |out|. */
static inline void byte_ring_take(const uint8_t *ring, size_t size, uint64_t at, uint8_t *out,
                                  size_t length) {
    const size_t begin = (size_t)(at % size);
    const size_t first = length < size - begin ? length : size - begin;
    memcpy(out, ring + begin, first);
    if (first < length) {
        memcpy(out + first, ring, length - first);
    }
}

/* The other way round. */
static inline void byte_ring_put(uint8_t *ring, size_t size, uint64_t at, const uint8_t *bytes,
                                 size_t length) {
    const size_t begin = (size_t)(at % size);
    const size_t first = length < size - begin ? length : size - begin;
    memcpy(ring + begin, bytes, first);
    if (first < length) {
        memcpy(ring, bytes + first, length - first);
    }
}

#endif
