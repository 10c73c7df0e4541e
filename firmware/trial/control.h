/*
 * The 50 Hz tick: gait, pulse, stop rules, late-tick check. Everything here runs in interrupt
 * context on data that the main loop hands over with the interrupt locked.
 *
 * The tick also owns the LED: while the pulses of a swim come out it shows the code of blink.h,
 * otherwise whether the board is armed, slowly blinking as long as it was asked to (hands out of
 * the water). It changes at the begin of a frame.
 */
#ifndef TRIAL_CONTROL_H
#define TRIAL_CONTROL_H

#include "gait/gait.h"
#include "hal/hal.h"
#include "supervisor/battery.h"
#include "supervisor/stop_rules.h"

#include <stdbool.h>
#include <stdint.h>

/*
 * What the main loop wants. Zero-initialised = stopped: the tail coasts to the centre as the gait
 * it began with says. A swim begins with a tick that finds |swim| true and the tail off; after a
 * stop or the last beat the tail stays off until |swim| has been false.
 */
typedef struct {
    bool swim;
    bool armed;                 /* for the LED */
    uint64_t blink_until_us;    /* the LED, while armed; steady from then on, or from |swim| on */
    uint32_t trial;             /* number of the swim, for the LED; taken over as |gait| is */
    uint16_t beats;             /* of the trial; the tail stops after the last one */
    const float *amplitude_rad; /* saturated, |beats| values; not changed while |swim|.
                                 * Read at each beat's start; negative or not finite = 0 */
    gait_config_t gait;         /* taken over while the tail is off, kept until it is off again */
    stop_limits_t limits;
    uint64_t last_heartbeat_us;
    uint64_t last_imu_us;
    battery_voltage_t battery;
    float pitch_rad, roll_rad;
} control_orders_t;

/* What the tick found. Start, beats, finished and stop are of the present swim and go back to zero
 * in the tick that finds |swim| false: read them before ordering that. */
typedef struct {
    gait_output_t gait;
    uint64_t tick_us;       /* time of this tick */
    uint64_t swim_start_us; /* when the pulse of frame 0 comes out: the tick after; 0 = not begun */
    uint16_t beats_done;    /* whole beats swum */
    bool finished;          /* the last beat is over; the tail coasts to the centre and off */
    fault_t stop;           /* first stop rule broken; the tail coasts to the centre and off */
    uint32_t late_ticks;    /* while swimming, since boot */
    uint32_t clipped_frames; /* since boot */
} control_report_t;

typedef struct {
    gait_t gait;
    gait_config_t config; /* of the swim that is on */
    uint32_t trial;       /* its number */
    control_orders_t orders;
    uint64_t battery_ok_us; /* last tick that found it not critical, swimming or not */
    bool stop_ordered;      /* |swim| was false at some time since the last tick */
    control_report_t report;
} control_t;

void control_init(control_t *control);

/* One tick; writes the pulse. */
void control_tick_isr(control_t *control, hal_t *hal);

/* Main loop side. Orders to swim need a valid gait and amplitudes. These lock and unlock the
 * interrupt around a copy. */
void control_order(control_t *control, hal_t *hal, const control_orders_t *orders);
/* Stops the tail at the next tick, whatever is ordered before it, and forgets the swim. */
void control_stop(control_t *control, hal_t *hal);
control_report_t control_report(control_t *control, hal_t *hal);

#endif
