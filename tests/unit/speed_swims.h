/*
 * Synthetic swims for tests of the estimate: what the thrust model swims, seen by a camera and felt
 * by an IMU, both with noise, in slots.
 */
#ifndef SPEED_SWIMS_H
#define SPEED_SWIMS_H

#include "speed/estimate.h"

#include "unity.h"

#include <math.h>
#include <string.h>

#define BEATS 40u
#define SLOTS_PER_BEAT 10u
#define SECONDS 60u
#define SLOTS (SECONDS * SLOTS_PER_BEAT)
#define REST_S 8.0
#define COAST_S 2.0

static estimate_t estimate;
static estimate_config_t config;
static speed_t speed;
static speed_slot_t recorded[SLOTS];
static float speed_m_s[BEATS_MAX], sigma_m_s[BEATS_MAX];
static float applied_rad[BEATS];
static uint64_t random_state;

/* The synthetic swim. */
static double begin_m_s[SLOTS + 1]; /* speed at the slots' begins */
static double beat_m_s[SECONDS];
static double error_m_s2[SLOTS + 1]; /* of the IMU's acceleration */
static double caught_s;

static const estimate_rest_t none = {0};
static estimate_rest_t before, after;

static inline void set_up_swims(void) {
    config = (estimate_config_t){
        .source = SPEED_SOURCE_VISION,
        .beat_s = 1.0f,
        .beats = BEATS,
        .vision = {.window_s = 1.0f, .gap_max_s = 0.5f, .plausible_m_s = 0.5f},
        .thrust = {.kappa_per_m = 10.0f,
                   .slope_m_s_rad = 0.219f,
                   .dead_zone_rad = 0.197f,
                   .delay_s = 0.3f},
        .model_sigma = 0.25f,
        .rest_sigma_m_s = 0.003f,
        .rest_min_s = 5.0f,
        .sigma_max_m_s = 0.02f,
    };
    before = (estimate_rest_t){.begin_s = -(float)REST_S, .still_s = (float)REST_S};
    random_state = 1;
}

static inline double uniform(void) {
    uint64_t x = random_state += 0x9E3779B97F4A7C15u;
    x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9u;
    x = (x ^ (x >> 27)) * 0x94D049BB133111EBu;
    return ((double)((x ^ (x >> 31)) >> 11) + 0.5) / 9007199254740992.0;
}

static inline double normal(void) {
    return sqrt(-2 * log(uniform())) * cos(6.283185307179586 * uniform());
}

static inline double square(double x) { return x * x; }

/* What the thrust model says it swims, times |scale|; held from caught_s on. */
static inline void swim(uint64_t seed, double scale) {
    random_state = seed;
    caught_s = 42.2 + 1.5 * uniform();
    const double start_m_s = 0.0015 * normal();
    double v = 0;
    for (unsigned k = 0; k < BEATS; k++) {
        const double rise = k < 10 ? k / 10.0 : k >= 30 ? (40 - k) / 10.0 : 1.0;
        applied_rad[k] = (float)(0.2 + 0.36 * rise + 0.02 * normal());
    }
    memset(beat_m_s, 0, sizeof beat_m_s);
    for (unsigned i = 0; i < SLOTS; i++) {
        const double t = 0.1 * i;
        const int k = (int)floor(t - 0.3 + 1e-9);
        const double beyond = k >= 0 && k < (int)BEATS ? (double)applied_rad[k] - 0.197 : 0;
        const double end = beyond > 0 ? 0.219 * beyond : 0;
        begin_m_s[i] = t < caught_s ? scale * v + start_m_s : 0;
        if (i > 0) {
            beat_m_s[(i - 1) / SLOTS_PER_BEAT] +=
                0.5 * (begin_m_s[i - 1] + begin_m_s[i]) / SLOTS_PER_BEAT;
        }
        for (unsigned j = 0; j < 10; j++) {
            v += 0.01 * 10 * (end * end - v * v);
        }
    }
    begin_m_s[SLOTS] = 0;
}

/* Error of a sensor that was levelled and had its bias taken off in the rest before: what is left
 * of white noise, and a random walk since; per second 0.10 mg and 0.0025 deg. */
static inline void make_imu_errors(void) {
    const double white = 0.10e-3 * 9.81, walk = 0.0025 * 3.14159265 / 180 * 9.81;
    const double drift = walk / sqrt(REST_S) * normal();
    double error = white / sqrt(REST_S) * normal() + drift * REST_S / 2;
    for (unsigned i = 0; i <= SLOTS; i++) {
        error_m_s2[i] = error + white / sqrt(0.1) * normal();
        error += 0.1 * drift + walk * sqrt(0.1) * normal();
    }
}

typedef struct {
    bool imu, camera;
    double dark_from_s, dark_to_s; /* of the camera */
} senses_t;

static inline void see(unsigned slot, double noise_m_s) {
    const double t = 0.1 * slot + 0.05;
    const unsigned k = slot / SLOTS_PER_BEAT;
    const unsigned next = slot % SLOTS_PER_BEAT >= SLOTS_PER_BEAT / 2 ? k + 1 : k;
    /* Means over a beat around t: between the means of two beats. */
    const unsigned last = next > 0 ? next - 1 : 0;
    const double part = t - ((double)last + 0.5);
    const double mean = beat_m_s[last] + part * (beat_m_s[last + 1] - beat_m_s[last]);
    TEST_ASSERT_TRUE(speed_add(&speed, &config.vision,
                               (speed_sample_t){(float)t, (float)(mean + noise_m_s), 0.001f}));
}

static inline void fill_slot(unsigned i, senses_t senses, double noise_m_s) {
    const double t = 0.1 * i + 0.05;
    const double gain = begin_m_s[i + 1] - begin_m_s[i] + 0.1 * error_m_s2[i];
    const speed_motion_t motion = {.gain_m_s = (float)gain, .way_m = (float)(0.05 * gain)};
    if (senses.camera && !(t >= senses.dark_from_s && t < senses.dark_to_s)) {
        see(i, noise_m_s);
    }
    recorded[i] = speed_close_slot(&speed, senses.imu ? &motion : NULL);
}

/* Takes the beats as they become known, and the time after them; without the way back. */
static inline void live_through(senses_t senses) {
    const double seconds_max = caught_s + REST_S;
    double noise_m_s = 0;
    speed_init(&speed);
    estimate_begin(&estimate, &config, &before, speed_m_s, sigma_m_s);
    for (unsigned i = 0; 0.1 * (i + 1) <= seconds_max; i++) {
        /* One error per beat, whole where the beat's mean is read. */
        noise_m_s = i % SLOTS_PER_BEAT == 0 ? 0.001 * normal() : noise_m_s;
        fill_slot(i, senses, noise_m_s);
        while ((float)speed.next_close * SPEED_SLOT_S >= estimate_needs_s(&estimate)) {
            const uint16_t k = estimate.next;
            (void)estimate_beat(&estimate, &speed, k < BEATS ? applied_rad[k] : 0.0f);
        }
    }
    /* The coast before looks like rest, too. */
    after = (estimate_rest_t){.begin_s = (float)(caught_s - COAST_S),
                              .still_s = (float)(REST_S + COAST_S)};
}

static inline unsigned finish(uint16_t swum, const estimate_rest_t *rest) {
    unsigned calls = 1;
    estimate_after(&estimate, swum, rest);
    while (!estimate_finish(&estimate)) {
        calls++;
        TEST_ASSERT_TRUE(calls < 100);
    }
    return calls;
}

/* ---- Figures over many swims ---- */

typedef struct {
    double rms_m_s, within_2_sigma, nees, sigma_m_s;
    double mean_rms_m_s; /* of the swim's mean speed */
    unsigned beats, unmeasured;
} figures_t;

static inline figures_t study(unsigned seeds, void (*make_errors)(void), senses_t senses,
                              double scale, unsigned from_beat, unsigned to_beat) {
    figures_t f = {0};
    for (unsigned seed = 1; seed <= seeds; seed++) {
        double off = 0;
        swim(seed, scale);
        make_errors();
        live_through(senses);
        (void)finish(BEATS, &after);
        for (uint16_t k = (uint16_t)from_beat; k < to_beat; k++) {
            const speed_beat_t beat = estimate_result(&estimate, k);
            if (!beat.measured) {
                f.unmeasured++;
                continue;
            }
            const double error = (double)beat.speed_m_s - beat_m_s[k];
            TEST_ASSERT_TRUE(beat.samples > 0);
            f.beats++;
            off += error / (to_beat - from_beat);
            f.rms_m_s += square(error);
            f.nees += square(error / (double)beat.sigma_m_s);
            f.within_2_sigma += fabs(error) <= 2 * (double)beat.sigma_m_s;
            f.sigma_m_s += (double)beat.sigma_m_s;
        }
        f.mean_rms_m_s += square(off) / seeds;
    }
    const double beats = f.beats > 0 ? f.beats : 1;
    f.rms_m_s = sqrt(f.rms_m_s / beats);
    f.nees /= beats;
    f.within_2_sigma /= beats;
    f.sigma_m_s /= beats;
    f.mean_rms_m_s = sqrt(f.mean_rms_m_s);
    return f;
}

static inline void check_honest(const figures_t *f) {
    TEST_ASSERT_TRUE(f->within_2_sigma >= 0.9);
    TEST_ASSERT_TRUE(f->nees >= 0.5 && f->nees <= 1.5);
}

#endif
