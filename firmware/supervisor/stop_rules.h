/*
 * The rules that stop a swimming tail. Evaluated by the 50 Hz tick on a snapshot of the sensors;
 * pure and interrupt-safe.
 */
#ifndef SUPERVISOR_STOP_RULES_H
#define SUPERVISOR_STOP_RULES_H

#include "supervisor/faults.h"

#include <stdbool.h>
#include <stdint.h>

typedef struct {
    uint32_t link_timeout_us; /* 0 = not checked */
    uint32_t imu_timeout_us;  /* 0 = not checked */
    uint32_t tick_late_us;   /* a tick more than this after the last one is late; 0 = not checked */
    uint32_t battery_sag_us; /* below its limit for so long; 0 = at once */
    uint16_t battery_critical_mv; /* 0 = not checked */
    float tilt_max_rad;           /* 0 = not checked */
} stop_limits_t;

typedef struct {
    uint64_t now_us;
    uint64_t last_tick_us;
    uint64_t last_heartbeat_us; /* of the host that armed. Times later than now are not silence */
    uint64_t last_imu_us;
    uint64_t battery_ok_us;    /* when it was last not below its limit; not later than now */
    uint16_t battery_mv;       /* 0, a dead converter, is as critical as any */
    bool battery_at_limit;     /* battery_voltage_t */
    float pitch_rad, roll_rad; /* not a number = tilted */
} stop_inputs_t;

/* Whether the battery is above its limit and its voltage is known, or is not checked. */
bool stop_rules_battery_ok(const stop_limits_t *limits, const stop_inputs_t *inputs);

/* The first rule that is broken, FAULT_NONE when none is. Order: battery, tilt, IMU stale,
 * link lost, late tick. */
fault_t stop_rules_check(const stop_limits_t *limits, const stop_inputs_t *inputs);

/* How many of the |executed| beats of a swim that ended so may have a speed: not the last
 * |guard_beats| before a wall, where the water is another and the fish may have touched it. */
uint16_t stop_rules_trusted_beats(fault_t end, uint16_t executed, uint16_t guard_beats);

#endif
