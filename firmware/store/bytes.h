/* Little-endian numbers in byte buffers. Each put returns the position behind what it wrote. */
#ifndef STORE_BYTES_H
#define STORE_BYTES_H

#include <stdint.h>
#include <string.h>

static inline uint8_t *bytes_put_u16(uint8_t *at, uint16_t value) {
    at[0] = (uint8_t)(value & 0xFFu);
    at[1] = (uint8_t)(value >> 8);
    return at + 2;
}

static inline uint8_t *bytes_put_u32(uint8_t *at, uint32_t value) {
    return bytes_put_u16(bytes_put_u16(at, (uint16_t)(value & 0xFFFFu)), (uint16_t)(value >> 16));
}

static inline uint8_t *bytes_put_u64(uint8_t *at, uint64_t value) {
    return bytes_put_u32(bytes_put_u32(at, (uint32_t)(value & 0xFFFFFFFFu)),
                         (uint32_t)(value >> 32));
}

static inline uint8_t *bytes_put_f32(uint8_t *at, float value) {
    uint32_t bits = 0;
    memcpy(&bits, &value, sizeof bits);
    return bytes_put_u32(at, bits);
}

static inline uint16_t bytes_get_u16(const uint8_t *at) {
    return (uint16_t)(at[0] | (unsigned)at[1] << 8);
}

static inline uint32_t bytes_get_u32(const uint8_t *at) {
    return bytes_get_u16(at) | (uint32_t)bytes_get_u16(at + 2) << 16;
}

static inline uint64_t bytes_get_u64(const uint8_t *at) {
    return bytes_get_u32(at) | (uint64_t)bytes_get_u32(at + 4) << 32;
}

static inline float bytes_get_f32(const uint8_t *at) {
    const uint32_t bits = bytes_get_u32(at);
    float value = 0.0f;
    memcpy(&value, &bits, sizeof value);
    return value;
}

#endif
