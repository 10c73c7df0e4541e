#include "speed/thrust.h"

#include "base/real.h"

#include <string.h>

void thrust_init(thrust_t *thrust, const thrust_config_t *config, float beat_s) {
    memset(thrust, 0, sizeof *thrust);
    thrust->config = *config;
    thrust->beat_s = beat_s;
}

/* Square of the speed that thrust settles at, by the amplitude of |late_s| after this beat began.
 */
static float thrust_at(const thrust_t *thrust, float late_s) {
    uint32_t back = 0;
    while (late_s < 0.0f && back < THRUST_DELAY_BEATS) {
        late_s += thrust->beat_s;
        back++;
    }
    const float beyond = thrust->amplitude_rad[back] - thrust->config.dead_zone_rad;
    const float steady_m_s = beyond > 0.0f ? thrust->config.slope_m_s_rad * beyond : 0.0f;
    return steady_m_s * steady_m_s;
}

float thrust_beat(thrust_t *thrust, float amplitude_rad) {
    memmove(thrust->amplitude_rad + 1, thrust->amplitude_rad,
            THRUST_DELAY_BEATS * sizeof thrust->amplitude_rad[0]);
    thrust->amplitude_rad[0] = amplitude_rad;
    const float step_s = thrust->beat_s / (float)THRUST_STEPS;
    const float k = thrust->config.kappa_per_m * step_s;
    float v = thrust->speed_m_s;
    float sum = 0.0f;
    for (uint32_t i = 0; i < THRUST_STEPS; i++) {
        const float square = thrust_at(thrust, ((float)i + 0.5f) * step_s - thrust->config.delay_s);
        /* The exact step for constant thrust has tanh(z)/z for the quotient, z^2 = k^2 square. */
        const float tau = k / (1.0f + k * k * square * (1.0f / 3.0f));
        const float next = (v + square * tau) / (1.0f + v * tau);
        sum += 0.5f * (v + next);
        v = next;
    }
    thrust->speed_m_s = v;
    return sum * (1.0f / (float)THRUST_STEPS);
}
