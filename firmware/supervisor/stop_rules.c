#include "supervisor/stop_rules.h"

#include "base/real.h"

/* An event that the clock has not reached yet (the main loop stamps between two ticks) is not
 * silence. */
static bool silent(uint64_t now_us, uint64_t last_us, uint32_t timeout_us) {
    return timeout_us != 0 && now_us > last_us && now_us - last_us > timeout_us;
}

bool stop_rules_battery_ok(const stop_limits_t *limits, const stop_inputs_t *inputs) {
    return limits->battery_critical_mv == 0 ||
           (!inputs->battery_at_limit && inputs->battery_mv >= limits->battery_critical_mv);
}

/* A servo's current pulls a healthy pack down for moments, and may lift its reading as well. */
static fault_t judge_battery(const stop_limits_t *limits, const stop_inputs_t *inputs) {
    if (stop_rules_battery_ok(limits, inputs) ||
        inputs->now_us - inputs->battery_ok_us < limits->battery_sag_us) {
        return FAULT_NONE;
    }
    return inputs->battery_at_limit ? FAULT_BATTERY_SENSE : FAULT_BATTERY_CRITICAL;
}

/* An angle that is not a number counts as tilted. */
static bool tilted(const stop_limits_t *limits, const stop_inputs_t *inputs) {
    const float max_rad = limits->tilt_max_rad;
    return max_rad > 0.0f &&
           !(real_abs(inputs->pitch_rad) <= max_rad && real_abs(inputs->roll_rad) <= max_rad);
}

fault_t stop_rules_check(const stop_limits_t *limits, const stop_inputs_t *inputs) {
    const fault_t battery = judge_battery(limits, inputs);
    if (battery != FAULT_NONE) {
        return battery;
    }
    if (tilted(limits, inputs)) {
        return FAULT_TILT;
    }
    if (silent(inputs->now_us, inputs->last_imu_us, limits->imu_timeout_us)) {
        return FAULT_IMU_STALE;
    }
    if (silent(inputs->now_us, inputs->last_heartbeat_us, limits->link_timeout_us)) {
        return FAULT_LINK_LOST;
    }
    if (silent(inputs->now_us, inputs->last_tick_us, limits->tick_late_us)) {
        return FAULT_LATE_TICK;
    }
    return FAULT_NONE;
}

uint16_t stop_rules_trusted_beats(fault_t end, uint16_t executed, uint16_t guard_beats) {
    const uint16_t guarded = end == FAULT_WALL ? guard_beats : 0u;
    return executed > guarded ? (uint16_t)(executed - guarded) : 0u;
}
