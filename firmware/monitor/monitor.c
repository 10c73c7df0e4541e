#include "monitor/monitor.h"

#include "base/crc.h"
#include "base/units.h"
#include "params/params.h"

#include <stdlib.h>
#include <string.h>

/* The parameter record (docs/reference/protocol.md), read here once more: what guards the tail does
 * not rely on the code that it guards against. */
#define MAGIC 0x41504254u /* "TBPA" */
#define VERSION 1u
#define CRC_AT 8u
#define BODY_AT 12u
#define ENTRY_BYTES (PARAM_NAME_BYTES + 4u)

#define TICKS_PER_US 3.0f

static uint32_t word_at(const uint8_t *bytes) {
    uint32_t word = 0;
    memcpy(&word, bytes, sizeof word);
    return word;
}

/* Version in the lower half, number of entries in the upper. */
static uint32_t version_and_count(const uint8_t *record) { return word_at(record + 4); }

static bool is_record(const uint8_t *bytes, size_t length) {
    if (length < BODY_AT || word_at(bytes) != MAGIC) {
        return false;
    }
    const uint32_t count = version_and_count(bytes) >> 16;
    if (version_and_count(bytes) != (VERSION | count << 16) ||
        length != BODY_AT + ENTRY_BYTES * count) {
        return false;
    }
    const uint32_t front = crc32_update(0, bytes, CRC_AT);
    return crc32_update(front, bytes + BODY_AT, length - BODY_AT) == word_at(bytes + CRC_AT);
}

static float value_of(const uint8_t *record, param_t param) {
    const param_info_t *info = param_info(param);
    const uint8_t *entry = record + BODY_AT;
    for (uint32_t left = version_and_count(record) >> 16; left > 0; left--) {
        float value = 0.0f;
        memcpy(&value, entry + PARAM_NAME_BYTES, sizeof value);
        if (strncmp((const char *)entry, info->name, PARAM_NAME_BYTES) == 0 && value >= info->low &&
            value <= info->high) {
            return value;
        }
        entry += ENTRY_BYTES;
    }
    return info->fallback;
}

/* Rounded inwards; 0.99 makes it the next whole number, but not of one that is whole already. A
 * step may have been rounded at both of its ends. */
bool monitor_read(const uint8_t *bytes, size_t length, monitor_limits_t *limits) {
    if (!is_record(bytes, length)) {
        return false;
    }
    const float step_us =
        value_of(bytes, PARAM_SERVO_SLEW_RAD_S) * value_of(bytes, PARAM_SERVO_US_RAD) * FRAME_S;
    limits->step_ticks = step_us > 0.0f ? (uint16_t)(step_us * TICKS_PER_US + 2.0f) : UINT16_MAX;
    limits->min_ticks = (uint16_t)(value_of(bytes, PARAM_SERVO_MIN_US) * TICKS_PER_US + 0.99f);
    limits->max_ticks = (uint16_t)(value_of(bytes, PARAM_SERVO_MAX_US) * TICKS_PER_US);
    return true;
}

bool monitor_within(const monitor_limits_t *limits, const monitor_limits_t *wider) {
    return limits->min_ticks >= wider->min_ticks && limits->max_ticks <= wider->max_ticks &&
           limits->step_ticks <= wider->step_ticks;
}

static bool fits(const monitor_limits_t *limits, uint16_t pulse_ticks) {
    return pulse_ticks >= limits->min_ticks && pulse_ticks <= limits->max_ticks;
}

static bool is_near(const monitor_t *monitor, uint16_t pulse_ticks) {
    return abs((int)pulse_ticks - (int)monitor->pulse_ticks) <= monitor->limits.step_ticks;
}

static bool starts(monitor_t *monitor, const monitor_request_t *request) {
    if (request->trial <= monitor->trial) {
        return false;
    }
    monitor->state = MONITOR_SWIM;
    monitor->limits = request->limits;
    monitor->trial = request->trial;
    monitor->swim_left = request->swim_ticks;
    monitor->coast_left = request->coast_ticks < MONITOR_COAST_TICKS_MAX ? request->coast_ticks
                                                                         : MONITOR_COAST_TICKS_MAX;
    monitor->pulse_ticks = request->pulse_ticks;
    monitor->tick_us = request->now_us;
    return true;
}

static bool swims_on(monitor_t *monitor, uint32_t now_us) {
    if (monitor->state != MONITOR_SWIM || monitor->swim_left == 0 ||
        now_us - monitor->tick_us > MONITOR_LATE_US) {
        return false;
    }
    monitor->swim_left--;
    return true;
}

static bool coasts_on(monitor_t *monitor) {
    monitor->state = MONITOR_COAST;
    if (monitor->coast_left == 0) {
        return false;
    }
    monitor->coast_left--;
    return true;
}

static bool allows(monitor_t *monitor, const monitor_request_t *request) {
    if (request->pulse_ticks == 0) {
        return false;
    }
    if (monitor->state == MONITOR_OFF && !(request->swim && starts(monitor, request))) {
        return false;
    }
    const bool due = request->swim ? swims_on(monitor, request->now_us) : coasts_on(monitor);
    return due && fits(&monitor->limits, request->pulse_ticks) &&
           is_near(monitor, request->pulse_ticks);
}

uint16_t monitor_tick_isr(monitor_t *monitor, const monitor_request_t *request) {
    const bool allowed = allows(monitor, request);
    monitor->tick_us = request->now_us;
    monitor->pulse_ticks = allowed ? request->pulse_ticks : 0;
    if (!allowed) {
        monitor->state = MONITOR_OFF;
    }
    return monitor->pulse_ticks;
}
