/* From a tail angle to a pulse width, with the limits of the servo and of its linkage. */
#ifndef GAIT_SERVO_H
#define GAIT_SERVO_H

#include <stdbool.h>
#include <stdint.h>

typedef struct {
    float centre_us;
    float us_per_rad;     /* > 0 */
    float min_us, max_us; /* 1 <= min < centre < max < a frame */
    float direction;      /* +1 or -1 */
    float slew_rad_s;     /* fastest commanded motion; 0 = no limit */
} servo_config_t;

typedef struct {
    float angle_rad;         /* last angle sent; 0 at rest */
    bool moving;             /* pulses are on, angle_rad is where the servo is heading */
    uint32_t clipped_frames; /* frames in which a limit changed the angle */
} servo_t;

bool servo_config_valid(const servo_config_t *config);

/* Limits |angle_rad| (slew against the last frame, then pulse range) and returns the pulse width in
 * thirds of a microsecond, rounded to nearest but never past a pulse limit. servo->angle_rad is the
 * limited angle. A non-finite angle holds the last one and counts as clipped. Interrupt-safe. */
uint16_t servo_move_isr(servo_t *servo, const servo_config_t *config, float angle_rad);

/* Pulses off; the next move's slew counts from the centre. */
void servo_rest_isr(servo_t *servo);

#endif
