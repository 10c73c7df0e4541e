/*
 * The 50 Hz tick: gait, pulse, stop rules, late-tick check. Everything here runs in interrupt
 * context on data that the main loop hands over with the interrupt locked.
 */
#ifndef APP_CONTROL_H
#define APP_CONTROL_H

#include "gait/gait.h"
#include "hal/hal.h"
#include "supervisor/stop_rules.h"

#include <stdbool.h>
#include <stdint.h>

/* What the main loop wants. Zero-initialised = stopped. */
typedef struct {
    bool swim;
    uint16_t beats;             /* of the trial; the tail stops after the last one */
    const float *amplitude_rad; /* saturated, |beats| values; not changed while |swim| */
    gait_config_t gait;
    stop_limits_t limits;
    uint64_t last_heartbeat_us;
    uint64_t last_imu_us;
    uint16_t battery_mv;
    float pitch_rad, roll_rad;
} control_orders_t;

/* What the tick found. */
typedef struct {
    gait_output_t gait;
    uint64_t tick_us;      /* time of this tick */
    uint64_t swim_start_us; /* tick of frame 0, 0 = not begun */
    uint16_t beats_done;   /* whole beats swum */
    bool finished;         /* the last beat is over, the tail is off */
    fault_t stop;          /* first stop rule broken; the tail was stopped */
    uint32_t late_ticks;
    uint32_t clipped_frames;
} control_report_t;

typedef struct {
    gait_t gait;
    control_orders_t orders;
    control_report_t report;
} control_t;

void control_init(control_t *control);

/* One tick; writes the pulse. */
void control_tick_isr(control_t *control, hal_t *hal);

/* Main loop side; lock and unlock the interrupt around a copy. */
void control_order(control_t *control, hal_t *hal, const control_orders_t *orders);
control_report_t control_report(control_t *control, hal_t *hal);

#endif
