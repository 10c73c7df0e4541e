/*
 * The identified fish as a speed sensor: the mean speed of each beat that thrust and drag predict
 * for the amplitudes swum. dv/dt = kappa (vss(theta(t - delay))^2 - v |v|), vss = max(0, slope
 * (theta - dead zone)): (8.11)-(8.13) of the thesis with thrust expressed by the steady speed it
 * gives, kappa = alpha/M. Slope and dead zone of the defaults: the line through Table 8.1.
 *
 * Pure, float32, no libm (closed-form steps, stable for any kappa). Not for interrupts.
 */
#ifndef SPEED_THRUST_H
#define SPEED_THRUST_H

#include <stdint.h>

#define THRUST_STEPS 20u      /* per beat */
#define THRUST_DELAY_BEATS 4u /* longest delay */

typedef struct {
    float kappa_per_m;
    float slope_m_s_rad;
    float dead_zone_rad;
    float delay_s; /* 0..THRUST_DELAY_BEATS beats */
} thrust_config_t;

typedef struct {
    thrust_config_t config;
    float beat_s;
    float speed_m_s;
    float amplitude_rad[THRUST_DELAY_BEATS + 1u]; /* of this beat and those before it */
} thrust_t;

/* From rest. */
void thrust_init(thrust_t *thrust, const thrust_config_t *config, float beat_s);

/* Swims one more beat with |amplitude_rad| (0 = tail still); returns its mean speed. */
float thrust_beat(thrust_t *thrust, float amplitude_rad);

#endif
