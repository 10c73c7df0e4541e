#include "ticks.h"

#include "hal/clock.h"
#include "hal/system.h"

void ticks_begin(ticks_t *ticks, hal_t *hal) {
    hal_irq_lock(hal);
    ticks->times = (tick_times_t){.shortest_us = UINT32_MAX};
    hal_irq_unlock(hal);
}

tick_times_t ticks_read(const ticks_t *ticks, hal_t *hal) {
    hal_irq_lock(hal);
    const tick_times_t times = ticks->times;
    hal_irq_unlock(hal);
    return times;
}

uint32_t ticks_count(const ticks_t *ticks) {
    return *(const volatile uint32_t *)&ticks->times.count;
}

static void note_interval(tick_times_t *times, uint32_t interval_us) {
    if (interval_us < times->shortest_us) {
        times->shortest_us = interval_us;
    }
    if (interval_us > times->longest_us) {
        times->longest_us = interval_us;
    }
}

void ticks_isr(ticks_t *ticks, hal_t *hal) {
    tick_times_t *times = &ticks->times;
    const uint64_t now_us = hal_time_us(hal);
    if (times->count == 0) {
        times->first_us = now_us;
    } else {
        note_interval(times, (uint32_t)(now_us - times->last_us));
    }
    times->last_us = now_us;
    times->count++;
    for (unsigned servo = 0; servo < HAL_SERVO_COUNT; servo++) {
        hal_servo_pulse_isr(hal, (hal_servo_t)servo, ticks->pulse_ticks[servo]);
    }
}
