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

#include "supervisor/faults.h"

#include <stdbool.h>
#include <stdint.h>

#define BATTERY_RISE_MV 200u
#define BATTERY_WARN_US 5000000u

/* A reading from here on (99.6 % of full scale) is at the limit of the converter: the divider's
 * lower resistor is open, or the battery is above what the divider is made for. Fractions of 65536.
 */
#define BATTERY_LIMIT_READING 65280u

/* |mv| is what the battery has at least when |at_limit|. */
typedef struct {
    uint16_t mv;
    bool at_limit;
} battery_voltage_t;

/* From the reading of the HAL (65536 = full scale), the voltage at the pin that reads full scale,
 * and the divider's ratio. Beyond 65.535 V it stays there. */
battery_voltage_t battery_voltage(uint16_t reading, float full_scale_v, float divider);

typedef struct {
    bool low;         /* found too low, and not risen since */
    bool limit_told;  /* since boot */
    bool warned;      /* in this swim */
    uint64_t fine_us; /* when it was last not low in this swim */
} battery_t;

/* Whether it may be armed and started with: not below |low_mv|, and once it was, not below |low_mv|
 * + BATTERY_RISE_MV. |low_mv| 0 = always. */
bool battery_allows(battery_t *battery, uint16_t battery_mv, uint16_t low_mv);

/* The same as a fault: FAULT_BATTERY_LOW, or FAULT_BATTERY_SENSE when the voltage is not known.
 * |low_mv| 0 = FAULT_NONE. */
fault_t battery_judge(battery_t *battery, const battery_voltage_t *voltage, uint16_t low_mv);

/* True once: when the voltage is not known. |low_mv| 0, a board without a battery: never. */
bool battery_tells_limit(battery_t *battery, const battery_voltage_t *voltage, uint16_t low_mv);

/* It ended a swim: that is too low. */
void battery_exhausted(battery_t *battery);

/* A swim begins. */
void battery_begin_swim(battery_t *battery, uint64_t now_us);

/* In every pass of a swim. True once per swim: when it has been below |low_mv| for BATTERY_WARN_US,
 * as far as the passes saw. */
bool battery_warns(battery_t *battery, uint64_t now_us, uint16_t battery_mv, uint16_t low_mv);

#endif
