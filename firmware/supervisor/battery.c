#include "supervisor/battery.h"

bool battery_allows(battery_t *battery, uint16_t battery_mv, uint16_t low_mv) {
    const uint32_t least_mv = (uint32_t)low_mv + (battery->low ? BATTERY_RISE_MV : 0u);
    battery->low = low_mv != 0 && battery_mv < least_mv;
    return !battery->low;
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
