#include "blink/blink.h"

#define BITS 16u
#define OFF_SYMBOLS 3u
#define PREAMBLE_SYMBOLS 6u
#define CRC_POLYNOMIAL 0x13u /* x^4 + x + 1 */

static uint32_t with_crc(uint32_t twelve) {
    uint32_t rest = twelve << 4;
    for (uint32_t bit = BITS - 1u; bit >= 4u; bit--) {
        if ((rest >> bit & 1u) != 0) {
            rest ^= CRC_POLYNOMIAL << (bit - 4u);
        }
    }
    return twelve << 4 | rest;
}

bool blink_on(uint32_t frame, uint32_t trial) {
    const uint32_t block = frame / BLINK_BLOCK_FRAMES;
    const uint32_t symbol = frame % BLINK_BLOCK_FRAMES / BLINK_SYMBOL_FRAMES;
    if (symbol < PREAMBLE_SYMBOLS) {
        return symbol >= OFF_SYMBOLS;
    }
    const uint32_t half = symbol - PREAMBLE_SYMBOLS;
    if (half >= 2u * BITS) {
        return true;
    }
    const uint32_t word = with_crc((trial & 0xffu) << 4 | (block & 0xfu));
    const bool one = (word >> (BITS - 1u - half / 2u) & 1u) != 0;
    return one == (half % 2u == 0);
}
