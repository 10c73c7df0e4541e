#include "ilc/beyond.h"

/* One past the last beat with visits; 0 = none has any. */
static uint32_t corrected(uint16_t beats, const uint8_t *visits) {
    uint32_t end = beats;
    while (end > 0u && visits[end - 1u] == 0u) {
        end--;
    }
    return end;
}

void beyond_fill(beyond_t policy, uint16_t beats, uint16_t until, const uint8_t *visits,
                 number_t *amplitude_rad) {
    const uint32_t end = corrected(beats, visits);
    if (end == 0u || (policy != BEYOND_HOLD && policy != BEYOND_TAPER)) {
        return;
    }
    const number_t last = amplitude_rad[end - 1u];
    const number_t span = (number_t)(beats - (end - 1u));
    for (uint32_t k = end; k < until; k++) {
        amplitude_rad[k] = policy == BEYOND_HOLD ? last : last * (number_t)(beats - k) / span;
    }
}
