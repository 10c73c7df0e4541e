#include "disturbance.h"

#include "common/noise.h"

#include <math.h>

#define TWO_PI 6.28318530717958647692
#define PI 3.14159265358979323846
/* The moving flow: periods from 5 to 100 s, long waves as strong as short ones. */
#define SLOWEST_HZ 0.01
#define FASTEST_HZ 0.2
/* The lowest mode of a tank of 3 m that is half a metre deep: 2 L / sqrt(g h). */
#define TANK_M 3.0
#define STANDING_S 2.71
/* An outlier: thrust off by this much, either way, or a flow. */
#define OUTLIER_GAIN_LEAST 0.08
#define OUTLIER_GAIN_MORE 0.17
#define OUTLIER_FLOW_LEAST_M_S 0.005
#define OUTLIER_FLOW_MORE_M_S 0.010

static double normal(const sim_config_t *c, noise_stream_t stream, uint32_t trial, double sigma) {
    return sigma * noise_normal(noise_key(c->seed, stream, trial), 0);
}

/* The product of all steps from trial 1 on, and of the trend. */
static double drift(const sim_config_t *c, uint32_t trial) {
    double walked = c->drift_trend * trial;
    for (uint32_t i = 1; i <= trial && c->drift_sigma > 0; i++) {
        walked += normal(c, NOISE_DRIFT, i, c->drift_sigma);
    }
    return exp(walked);
}

static void spoil(disturbance_t *drawn, const sim_config_t *c, uint32_t trial) {
    const uint64_t key = noise_key(c->seed, NOISE_OUTLIER, trial);
    if (noise_uniform(key, 0) >= c->outliers) {
        return;
    }
    const double side = noise_uniform(key, 1) < 0.5 ? -1 : 1;
    const double size = noise_uniform(key, 2);
    if (noise_uniform(key, 3) < 0.5) {
        drawn->gain *= 1 + side * (OUTLIER_GAIN_LEAST + OUTLIER_GAIN_MORE * size);
    } else {
        drawn->flow_m_s += side * (OUTLIER_FLOW_LEAST_M_S + OUTLIER_FLOW_MORE_M_S * size);
    }
}

static void draw_waves(disturbance_t *drawn, const sim_config_t *c, uint32_t trial) {
    drawn->moves = c->flow_moves_m_s > 0 || c->standing_wave_m_s > 0;
    if (!drawn->moves) {
        return;
    }
    const uint64_t key = noise_key(c->seed, NOISE_FLOW_WAVES, trial);
    for (unsigned i = 0; i < DISTURBANCE_WAVES; i++) {
        const double octave = noise_uniform(key, 2 * i);
        drawn->wave[i] = (disturbance_wave_t){
            .m_s = c->flow_moves_m_s * sqrt(2.0 / DISTURBANCE_WAVES),
            .rad_s = TWO_PI * SLOWEST_HZ * pow(FASTEST_HZ / SLOWEST_HZ, octave),
            .phase_rad = TWO_PI * noise_uniform(key, 2 * i + 1),
        };
    }
    drawn->standing = (disturbance_wave_t){
        .m_s = c->standing_wave_m_s,
        .rad_s = TWO_PI / STANDING_S,
        .phase_rad = TWO_PI * noise_uniform(key, 2 * DISTURBANCE_WAVES),
    };
}

void disturbance_draw(disturbance_t *drawn, const sim_config_t *c, uint32_t trial) {
    drawn->gain = fmax(0, 1 + normal(c, NOISE_GAIN, trial, c->gain_sigma)) * drift(c, trial);
    drawn->flow_m_s = normal(c, NOISE_FLOW, trial, c->flow_sigma_m_s);
    drawn->start_m_s = fabs(normal(c, NOISE_START, trial, c->start_sigma_m_s));
    const uint64_t hand = noise_key(c->seed, NOISE_PLACE, trial);
    drawn->place_x_m = c->place_sigma_m * noise_normal(hand, 0);
    drawn->place_y_m = c->place_sigma_m * noise_normal(hand, 1);
    drawn->place_rad = c->place_sigma_rad * noise_normal(hand, 2);
    drawn->lost_key = noise_key(c->seed, NOISE_LOST_BEAT, trial);
    drawn->lost_beats = c->lost_beats;
    draw_waves(drawn, c, trial);
    spoil(drawn, c, trial);
}

double disturbance_flow_m_s(const disturbance_t *drawn, double time_s, double x_m) {
    if (!drawn->moves) {
        return 0;
    }
    double flow_m_s = drawn->standing.m_s * sin(PI * x_m / TANK_M) *
                      cos(drawn->standing.rad_s * time_s + drawn->standing.phase_rad);
    for (unsigned i = 0; i < DISTURBANCE_WAVES; i++) {
        const disturbance_wave_t *wave = &drawn->wave[i];
        flow_m_s += wave->m_s * cos(wave->rad_s * time_s + wave->phase_rad);
    }
    return flow_m_s;
}

bool disturbance_hides(const disturbance_t *drawn, uint64_t beat) {
    return drawn->lost_beats > 0 && noise_uniform(drawn->lost_key, beat) < drawn->lost_beats;
}
