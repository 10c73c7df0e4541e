/*
 * What a VN-100 in the fish measures: means over the windows of register 85 with the noise that
 * such a mean has, and the attitude that its own filter makes of them.
 *
 * Means are computed by differences of the motion (felt.h), so that integrating the stream gives
 * the motion back. The filter takes what lasts longer than some 10 s for gravity, as the real one
 * does: linear acceleration is high-passed, pitch and roll lean accordingly.
 *
 * Noise is a function of (seed, start of the sensor, 800 Hz sample).
 */
#ifndef SIM_VN100_SENSE_H
#define SIM_VN100_SENSE_H

#include "fish/felt.h"
#include "vn100_settings.h"

#define VN100_TICK_US 1250u

typedef struct {
    uint64_t tick;    /* of 800 Hz since the start */
    uint64_t time_ns; /* without jitter */
    double ypr_deg[3];
    double accel_m_s2[3], rate_rad_s[3], linear_m_s2[3], linear_ned_m_s2[3];
    double body[9]; /* body to level, before register 26 */
} vn100_sample_t;

/* What the fish's own frame does not hold. */
typedef struct {
    double mag_gauss[3], temperature_c, pressure_kpa;
    uint16_t vpe_status;
} vn100_surroundings_t;

/* Of a unit that was not calibrated, as standard deviations. */
typedef struct {
    double accel_bias_mg;           /* constant of the unit */
    double accel_scale, rate_scale; /* relative, each axis its own */
    double misaligned_rad;          /* each axis against the others, and all of them in the fish */
} vn100_flaws_t;

typedef struct {
    const felt_t *felt;
    uint64_t seed, starts;
    double noise;
    vn100_flaws_t flaws;
    bool flawed;                            /* either matrix is not the identity */
    double accel_matrix[9], rate_matrix[9]; /* of this unit: what is there to what is told */
    uint64_t power_us;                      /* when its clock began */
    uint64_t key;
    bool known_accel; /* $VNKAD: the accelerometer is left out of the attitude */
    double tare_deg[3];
    double mounting[9];                                   /* register 26 as it was at the start */
    double accel_compensation[12], rate_compensation[12]; /* registers 25, 84, likewise */
    bool compensated;
    bool mounted; /* ... and is not the identity */
    /* Offsets: [0...2] acceleration m/s^2, [3...5] rate rad/s, constant since the start; and the
     * drift's line from |drift_tick| on. */
    double bias[6], attitude_bias_deg[3];
    uint64_t drift_tick;
    double drift[6], drift_per_tick[6];
    /* The filter: what it takes for gravity's lean, level frame. */
    double lean_m_s2[2];
    double ypr_deg[3]; /* before register 26 */
    vn100_sample_t last;
    bool any;
    uint64_t from_us; /* the motion at the end of the last mean */
    felt_moment_t from;
} vn100_sense_t;

void vn100_sense_init(vn100_sense_t *sense, uint64_t seed, double noise, vn100_flaws_t flaws,
                      const felt_t *felt);
/* The sensor starts with its clock at 0. */
void vn100_sense_start(vn100_sense_t *sense, uint64_t now_us, const vn100_settings_t *settings);

/* Simulated time of a sample. */
uint64_t vn100_tick_us(const vn100_sense_t *sense, uint64_t tick);
/* The last sample at or before |now_us|. */
uint64_t vn100_tick_at(const vn100_sense_t *sense, uint64_t now_us);

/* The newest sample, at |tick|: not before the one asked for last. */
const vn100_sample_t *vn100_sense(vn100_sense_t *sense, const vn100_settings_t *settings,
                                  uint64_t tick);

/* The same, at |now_us|. */
const vn100_sample_t *vn100_sense_now(vn100_sense_t *sense, const vn100_settings_t *settings,
                                      uint64_t now_us);

/* At the newest sample. */
void vn100_surroundings(const vn100_sense_t *sense, vn100_surroundings_t *out);

/* The time stamp of an output that comes every |divisor| samples: whole microseconds with jitter.
 */
uint64_t vn100_stamp_ns(const vn100_sense_t *sense, uint32_t divisor);

#endif
