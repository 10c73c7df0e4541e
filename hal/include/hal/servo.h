/* Servo pulse outputs, one pulse per 20 ms frame each; the frames of all servos are the same. */
#ifndef HAL_SERVO_H
#define HAL_SERVO_H

#include "hal/hal.h"

#include <stdint.h>

/* Pulse widths are counted in thirds of a microsecond: the 3 MHz PWM clock of the SAM3X8E. Every
 * board uses the same grid, so that the same firmware moves the same tail. */
#define HAL_SERVO_TICKS_PER_US 3u

typedef enum {
    HAL_SERVO_TAIL = 0, /* its frames are the ticks */
    HAL_SERVO_COUNT
} hal_servo_t;

/* Width of |servo|'s pulses from the next frame on; 0 = no pulses (servo limp), and the pin is not
 * the PWM's. The board calls app_tick_isr() once per frame and the tick calls this at most once per
 * servo. Interrupt context. The tail's belongs to the monitor: nothing but what it answers goes
 * here.
 */
void hal_servo_pulse_isr(hal_t *hal, hal_servo_t servo, uint16_t width_ticks);

#endif
