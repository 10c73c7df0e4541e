#include "gait/servo.h"

#include "base/real.h"
#include "base/units.h"

#define TICKS_PER_US 3.0f

bool servo_config_valid(const servo_config_t *config) {
    const bool finite = real_is_finite(config->centre_us) && real_is_finite(config->us_per_rad) &&
                        real_is_finite(config->min_us) && real_is_finite(config->max_us) &&
                        real_is_finite(config->slew_rad_s);
    return finite && config->us_per_rad > 0.0f && config->min_us >= 1.0f &&
           config->min_us < config->centre_us && config->centre_us < config->max_us &&
           config->max_us < (float)FRAME_US && config->slew_rad_s >= 0.0f &&
           (config->direction == 1.0f || config->direction == -1.0f);
}

static float slewed(const servo_t *servo, const servo_config_t *config, float angle_rad) {
    if (config->slew_rad_s <= 0.0f) {
        return angle_rad;
    }
    const float step_rad = config->slew_rad_s * FRAME_S;
    return real_clip(angle_rad, servo->angle_rad - step_rad, servo->angle_rad + step_rad);
}

/* Rounding must not carry a pulse past a limit that lies between two ticks. */
static uint16_t ticks_of(const servo_config_t *config, float pulse_us) {
    const uint16_t ticks = (uint16_t)(pulse_us * TICKS_PER_US + 0.5f);
    if ((float)ticks > config->max_us * TICKS_PER_US) {
        return (uint16_t)(ticks - 1u);
    }
    if ((float)ticks < config->min_us * TICKS_PER_US) {
        return (uint16_t)(ticks + 1u);
    }
    return ticks;
}

uint16_t servo_move_isr(servo_t *servo, const servo_config_t *config, float angle_rad) {
    const bool finite = real_is_finite(angle_rad);
    float sent_rad = finite ? slewed(servo, config, angle_rad) : servo->angle_rad;
    const float us_per_rad = config->direction * config->us_per_rad;
    const float wanted_us = config->centre_us + us_per_rad * sent_rad;
    const float pulse_us = real_clip(wanted_us, config->min_us, config->max_us);
    if (pulse_us != wanted_us) {
        sent_rad = (pulse_us - config->centre_us) / us_per_rad;
    }
    if (!finite || sent_rad != angle_rad) {
        servo->clipped_frames++;
    }
    servo->angle_rad = sent_rad;
    servo->moving = true;
    return ticks_of(config, pulse_us);
}

void servo_rest_isr(servo_t *servo) {
    servo->angle_rad = 0.0f;
    servo->moving = false;
}
