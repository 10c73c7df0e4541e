/*
 * Keyed noise: each number is a function of (seed, stream, trial, sample), so that no draw depends
 * on how many were drawn before it. Pure.
 */
#ifndef SIM_NOISE_H
#define SIM_NOISE_H

#include <stdint.h>

typedef enum {
    NOISE_GAIN = 1,
    NOISE_FLOW,
    NOISE_START,
    NOISE_CAMERA,
    NOISE_LOST,
    NOISE_HEADING,
    NOISE_IMU_BIAS,
    NOISE_IMU,
    NOISE_IMU_DRIFT,
    NOISE_IMU_WIRE_IN,
    NOISE_IMU_WIRE_OUT,
    NOISE_DRIFT,
    NOISE_OUTLIER,
    NOISE_FLOW_WAVES,
    NOISE_PLACE,
    NOISE_LOST_BEAT,
    NOISE_IMU_UNIT,
    NOISE_TREMOR
} noise_stream_t;

/* Names one sequence of samples. */
uint64_t noise_key(uint64_t seed, noise_stream_t stream, uint64_t trial);

/* [0, 1) */
double noise_uniform(uint64_t key, uint64_t sample);

/* Mean 0, variance 1, excess kurtosis -0.03, within +-8.2. */
double noise_normal(uint64_t key, uint64_t sample);

#endif
