#include "base/units.h"

/* By hand, sixteen bits at a time: the compiler's division of 64 bits is 0.8 KB in the image. */
uint64_t units_thousandth(uint64_t value) {
    uint64_t quotient = 0;
    uint32_t rest = 0;
    for (uint32_t digit = 0; digit < 4u; digit++) {
        const uint32_t part = rest << 16 | (uint32_t)(value >> 48);
        value <<= 16;
        quotient = quotient << 16 | part / 1000u;
        rest = part % 1000u;
    }
    return quotient;
}
