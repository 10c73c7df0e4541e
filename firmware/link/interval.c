#include "link/interval.h"

#define MAX_US 1e7f

bool interval_read(float value_us, float min_us, interval_t *interval) {
    const bool off = value_us == -1.0f;
    if (!off && value_us != 0.0f && !(value_us >= min_us && value_us <= MAX_US)) {
        return false;
    }
    *interval = (interval_t){.off = off, .us = off ? 0 : (uint32_t)value_us};
    return true;
}
