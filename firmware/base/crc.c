#include "base/crc.h"

#if defined(__ARM_ARCH_PROFILE) && __ARM_ARCH_PROFILE == 'M'

/* Four bits per step: 64 bytes of flash. Files are small, and the flash is slower than the sum. */
static const uint32_t crc32_nibble[16] = {
    0x00000000u, 0x1DB71064u, 0x3B6E20C8u, 0x26D930ACu, 0x76DC4190u, 0x6B6B51F4u,
    0x4DB26158u, 0x5005713Cu, 0xEDB88320u, 0xF00F9344u, 0xD6D6A3E8u, 0xCB61B38Cu,
    0x9B64C2B0u, 0x86D3D2D4u, 0xA00AE278u, 0xBDBDF21Cu,
};

uint32_t crc32_update(uint32_t crc, const void *bytes, size_t length) {
    const uint8_t *next = bytes;
    for (size_t i = 0; i < length; i++) {
        crc ^= next[i];
        crc = (crc >> 4) ^ crc32_nibble[crc & 15u];
        crc = (crc >> 4) ^ crc32_nibble[crc & 15u];
    }
    return crc;
}

#else

/* Where memory is plenty: four bytes per step. The sum of a byte is the sum of those of its bits,
 * so a table follows from eight entries. The simulated board needs it for every status it sends:
 * counted by callgrind for 63 bytes (x86-64, gcc -O2), 304 instructions instead of 833. */
#define XOR1(x, a) (x), (x) ^ (a)
#define XOR2(x, a, b) XOR1(x, a), XOR1((x) ^ (b), a)
#define XOR3(x, a, b, c) XOR2(x, a, b), XOR2((x) ^ (c), a, b)
#define XOR4(x, a, b, c, d) XOR3(x, a, b, c), XOR3((x) ^ (d), a, b, c)
#define XOR5(x, a, b, c, d, e) XOR4(x, a, b, c, d), XOR4((x) ^ (e), a, b, c, d)
#define XOR6(x, a, b, c, d, e, f) XOR5(x, a, b, c, d, e), XOR5((x) ^ (f), a, b, c, d, e)
#define XOR7(x, a, b, c, d, e, f, g) XOR6(x, a, b, c, d, e, f), XOR6((x) ^ (g), a, b, c, d, e, f)
#define XOR8(x, a, b, c, d, e, f, g, h)                                                            \
    XOR7(x, a, b, c, d, e, f, g), XOR7((x) ^ (h), a, b, c, d, e, f, g)

/* [k]: a byte with k bytes behind it. */
static const uint32_t crc32_byte[4][256] = {
    {XOR8(0, 0x77073096u, 0xEE0E612Cu, 0x076DC419u, 0x0EDB8832u, 0x1DB71064u, 0x3B6E20C8u,
          0x76DC4190u, 0xEDB88320u)},
    {XOR8(0, 0x191B3141u, 0x32366282u, 0x646CC504u, 0xC8D98A08u, 0x4AC21251u, 0x958424A2u,
          0xF0794F05u, 0x3B83984Bu)},
    {XOR8(0, 0x01C26A37u, 0x0384D46Eu, 0x0709A8DCu, 0x0E1351B8u, 0x1C26A370u, 0x384D46E0u,
          0x709A8DC0u, 0xE1351B80u)},
    {XOR8(0, 0xB8BC6765u, 0xAA09C88Bu, 0x8F629757u, 0xC5B428EFu, 0x5019579Fu, 0xA032AF3Eu,
          0x9B14583Du, 0xED59B63Bu)},
};

const uint16_t crc_mcrf4xx_byte[256] = {
    XOR8(0, 0x1189, 0x2312, 0x4624, 0x8C48, 0x1081, 0x2102, 0x4204, 0x8408)};

uint16_t crc_mcrf4xx_update(uint16_t crc, const void *bytes, size_t length) {
    const uint8_t *next = bytes;
    unsigned sum = crc;
    for (; length > 0; length--, next++) {
        sum = sum >> 8 ^ crc_mcrf4xx_byte[(sum ^ *next) & 0xFFu];
    }
    return (uint16_t)sum;
}

uint32_t crc32_update(uint32_t crc, const void *bytes, size_t length) {
    const uint8_t *next = bytes;
    for (; length >= 4; length -= 4, next += 4) {
        crc ^= (uint32_t)next[3] << 24 | (uint32_t)next[2] << 16 | (uint32_t)next[1] << 8 | next[0];
        crc = crc32_byte[3][crc & 0xFFu] ^ crc32_byte[2][crc >> 8 & 0xFFu] ^
              crc32_byte[1][crc >> 16 & 0xFFu] ^ crc32_byte[0][crc >> 24];
    }
    for (; length > 0; length--, next++) {
        crc = crc >> 8 ^ crc32_byte[0][(crc ^ *next) & 0xFFu];
    }
    return crc;
}

#endif

/*
 * CRC-16 without a table. Modulo its polynomial x^16 = x^12 + x^5 + 1, and squaring keeps a sum of
 * powers short: x^32 = x^24 + x^10 + 1, x^64 = x^48 + x^20 + 1. So 16, 32 or 64 bits at once are
 * moved up by their own width with a few shifts: first what the shifts to the left will push out at
 * the top is added to the bottom (it comes down by 64 - 48 and 64 - 20 places, and what that pushes
 * out again by twice and thrice as many), then the shifts follow. Counted by callgrind for
 * 64 bytes (x86-64, gcc -O2): 227 instructions; with a table of bytes they are 565.
 */
static uint32_t fold16(uint32_t x) {
    const uint32_t y = x ^ x >> 8;
    const uint32_t z = y ^ y >> 4 ^ y >> 11;
    return (z ^ z << 5 ^ z << 12) & 0xFFFFu;
}

static uint32_t fold32(uint32_t x) {
    const uint32_t y = x ^ x >> 16;
    const uint32_t z = y ^ y >> 8 ^ y >> 22;
    return z ^ z << 10 ^ z << 24;
}

static uint64_t fold64(uint64_t x) {
    const uint64_t y = x ^ x >> 32;
    const uint64_t z = y ^ y >> 16 ^ y >> 44;
    return z ^ z << 20 ^ z << 48;
}

static inline uint32_t load_be32(const uint8_t *bytes) {
    return (uint32_t)bytes[0] << 24 | (uint32_t)bytes[1] << 16 | (uint32_t)bytes[2] << 8 | bytes[3];
}

static uint64_t load_be64(const uint8_t *bytes) {
    return (uint64_t)load_be32(bytes) << 32 | load_be32(bytes + 4);
}

static uint32_t crc16_append(uint32_t crc, uint32_t word) {
    const uint32_t x = crc << 16 ^ word;
    return fold16(fold16(x >> 16) ^ (x & 0xFFFFu));
}

/* |bytes| up to |end|: at least 8, and a multiple of it. */
static uint32_t crc16_words(uint32_t crc, const uint8_t *bytes, const uint8_t *end) {
    uint64_t sum = (uint64_t)crc << 48;
    for (;;) {
        sum ^= load_be64(bytes);
        bytes += 8;
        if (bytes == end) {
            break;
        }
        sum = fold64(sum);
    }
    return crc16_append(0, fold32((uint32_t)(sum >> 32)) ^ (uint32_t)sum);
}

uint16_t crc16_update(uint16_t crc, const void *bytes, size_t length) {
    const uint8_t *next = bytes;
    const uint8_t *const end = next + length;
    const uint8_t *const words_end = next + (length & ~(size_t)7);
    uint32_t sum = crc;
    if (next != words_end) {
        sum = crc16_words(sum, next, words_end);
        next = words_end;
    }
    if (end - next >= 4) {
        sum = crc16_append(sum, load_be32(next));
        next += 4;
    }
    for (; next != end; next++) {
        const uint32_t out = sum >> 8 ^ *next;
        sum = (sum << 8 & 0xFFFFu) ^ fold16(out);
    }
    return (uint16_t)sum;
}
