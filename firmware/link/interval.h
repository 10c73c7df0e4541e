/* The interval of MAV_CMD_SET_MESSAGE_INTERVAL. Pure. */
#ifndef LINK_INTERVAL_H
#define LINK_INTERVAL_H

#include <stdbool.h>
#include <stdint.h>

typedef struct {
    bool off;    /* never */
    uint32_t us; /* 0 = as usual */
} interval_t;

/* |value_us| as it came over the wire: -1 = off, 0 = as usual, or |min_us| to 10 s; false = none of
 * them, |interval| is left alone. */
bool interval_read(float value_us, float min_us, interval_t *interval);

#endif
