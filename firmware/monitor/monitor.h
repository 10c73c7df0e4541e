/*
 * The supervisor of last resort: decides in each tick whether the pulse that the control code wants
 * may go out. It does not rely on anything else in RAM being right.
 *
 * OFF: no pulse, the servo pin is not handed over. A start needs the board's parameter record,
 * whose CRC the monitor checks itself, a trial number above that of the last swim, and a first
 * pulse within the record's limits. SWIM: one pulse per tick, as many as the start announced.
 * COAST: pulses that bring the tail to the centre, again as many as announced; swimming on is
 * refused. Whatever breaks a rule leads to OFF at once, and a swim that is over leads there, too.
 *
 * The rules of a pulse: within the limits, no further from the last one than the limits allow, and
 * while swimming no later after it than a frame and a half.
 *
 * The state lies in memory that only the tick may change (hal/guard.h). It is small, and the rules
 * are, so that a test visits every state (tests/unit/test_monitor.c). Pure functions;
 * interrupt-safe and bounded: a tick costs about 60 instructions, monitor_read() about 13 per byte
 * of the record.
 */
#ifndef MONITOR_MONITOR_H
#define MONITOR_MONITOR_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define MONITOR_LATE_US 30000u
#define MONITOR_COAST_TICKS_MAX 250u /* the longest COAST_S */

typedef enum { MONITOR_OFF = 0, MONITOR_SWIM, MONITOR_COAST } monitor_state_t;

/* Pulses in thirds of a microsecond (hal/servo.h). */
typedef struct {
    uint16_t min_ticks, max_ticks;
    uint16_t step_ticks; /* from one frame to the next; UINT16_MAX = no limit */
} monitor_limits_t;

/* Zero-initialised = off. Written by monitor_tick_isr() only. */
typedef struct {
    monitor_limits_t limits; /* of the swim that is on */
    uint8_t state;           /* monitor_state_t */
    uint16_t pulse_ticks;    /* the last one; 0 = none */
    uint16_t coast_left;     /* pulses that may still come after the swim */
    uint32_t swim_left;      /* pulses of the swim that may still come */
    uint32_t trial;          /* number of the last swim that began */
    uint32_t tick_us;        /* time of the last tick that asked */
} monitor_t;

/* What the control code wants in this tick. */
typedef struct {
    uint32_t now_us;
    uint16_t pulse_ticks; /* 0 = none */
    bool swim;            /* the pulse is one of a swim, not of the coast after it */
    /* The rest matters for a start alone. */
    uint16_t coast_ticks;
    uint32_t swim_ticks;
    uint32_t trial;
    monitor_limits_t limits; /* as monitor_read() gave them; all 0 = none, and no pulse fits */
} monitor_request_t;

/* The limits of a parameter record. False when |bytes| are no such record or the CRC differs.
 * Parameters that it lacks, or out of range, count as their defaults. */
bool monitor_read(const uint8_t *bytes, size_t length, monitor_limits_t *limits);

/* Whether whatever |limits| allow |wider| allow, too. */
bool monitor_within(const monitor_limits_t *limits, const monitor_limits_t *wider);

/* Whether monitor_tick_isr() would answer 0 and change nothing that counts. */
static inline bool monitor_rests(const monitor_t *monitor, uint16_t pulse_ticks) {
    return monitor->state == MONITOR_OFF && pulse_ticks == 0;
}

/* The pulse that goes out: the wanted one or 0. */
uint16_t monitor_tick_isr(monitor_t *monitor, const monitor_request_t *request);

#endif
