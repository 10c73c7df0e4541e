/*
 * Whether the battery is good enough to begin a swim, and when to warn of it during one. That it
 * stops a swim is one of the stop rules (stop_rules.h).
 *
 * A pack that was too low recovers by some tenths of a volt as soon as nothing pulls at it. So once
 * it was found too low it has to rise well above the limit, which takes a charger or another pack;
 * after a restart of the board nobody remembers. Pure; main loop only. Zero-initialise it.
 */
#ifndef SUPERVISOR_BATTERY_H
#define SUPERVISOR_BATTERY_H

#include <stdbool.h>
#include <stdint.h>

#define BATTERY_RISE_MV 200u
#define BATTERY_WARN_US 5000000u

typedef struct {
    bool low;         /* found too low, and not risen since */
    bool warned;      /* in this swim */
    uint64_t fine_us; /* when it was last not low in this swim */
} battery_t;

/* Whether it may be armed and started with: not below |low_mv|, and once it was, not below |low_mv|
 * + BATTERY_RISE_MV. |low_mv| 0 = always. */
bool battery_allows(battery_t *battery, uint16_t battery_mv, uint16_t low_mv);

/* It ended a swim: that is too low. */
void battery_exhausted(battery_t *battery);

/* A swim begins. */
void battery_begin_swim(battery_t *battery, uint64_t now_us);

/* In every pass of a swim. True once per swim: when it has been below |low_mv| for BATTERY_WARN_US,
 * as far as the passes saw. */
bool battery_warns(battery_t *battery, uint64_t now_us, uint16_t battery_mv, uint16_t low_mv);

#endif
