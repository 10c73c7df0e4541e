#include "supervisor/battery.h"

#define READING_FULL_SCALE 65536.0f
#define MV_PER_V 1000.0f

battery_voltage_t battery_voltage(uint16_t reading, float full_scale_v, float divider) {
    const float mv = (float)reading * (full_scale_v * divider * (MV_PER_V / READING_FULL_SCALE));
    return (battery_voltage_t){
        .mv = mv < (float)UINT16_MAX ? (uint16_t)(mv + 0.5f) : UINT16_MAX,
        .at_limit = reading >= BATTERY_LIMIT_READING,
    };
}

bool battery_allows(battery_t *battery, uint16_t battery_mv, uint16_t low_mv) {
    const uint32_t least_mv = (uint32_t)low_mv + (battery->low ? BATTERY_RISE_MV : 0u);
    battery->low = low_mv != 0 && battery_mv < least_mv;
    return !battery->low;
}

fault_t battery_judge(battery_t *battery, const battery_voltage_t *voltage, uint16_t low_mv) {
    if (voltage->at_limit && low_mv != 0) {
        return FAULT_BATTERY_SENSE;
    }
    return battery_allows(battery, voltage->mv, low_mv) ? FAULT_NONE : FAULT_BATTERY_LOW;
}

bool battery_tells_limit(battery_t *battery, const battery_voltage_t *voltage, uint16_t low_mv) {
    const bool news = voltage->at_limit && low_mv != 0 && !battery->limit_told;
    battery->limit_told = battery->limit_told || news;
    return news;
}

void battery_exhausted(battery_t *battery) { battery->low = true; }

void battery_begin_swim(battery_t *battery, uint64_t now_us) {
    battery->warned = false;
    battery->fine_us = now_us;
}

bool battery_warns(battery_t *battery, uint64_t now_us, uint16_t battery_mv, uint16_t low_mv) {
    if (battery_mv >= low_mv) {
        battery->fine_us = now_us;
    }
    if (battery->warned || now_us - battery->fine_us <= BATTERY_WARN_US) {
        return false;
    }
    battery->warned = true;
    return true;
}
