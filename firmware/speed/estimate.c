#include "speed/estimate.h"

#include "base/panic.h"
#include "base/real.h"

#include <math.h>
#include <string.h>

#define G_M_S2 9.80665f

/* White noise of a VN-100's accelerometers: specified 0.14 mg per root Hz of a one-sided spectrum,
 * 0.10 mg root s, and measured so (0.2 mg at 1 s with a window that leaves four samples of five
 * out); a tenth more for what the averaging over a whole frame aliases. */
#define ACCEL_NOISE_M_S15 (0.11e-3f * G_M_S2)
/* Random walk of the acceleration's error: gyroscopes 0.0035 deg/s per root Hz, one-sided, times g
 * = 4.2e-4; random walk of the accelerometers' bias, measured 0.16 mg at 100 s = 2.7e-4. */
#define TILT_WALK_M_S25 5.0e-4f
/* A drift that comes with the tail beats, as the walk that strays as far within the swim. */
#define SCALE_LASTS_S 16.0f
/* After a rest of 5 s: what averaging leaves of this noise, and bias instability, measured 0.06 mg
 * and 5 deg/h. A longer rest is little better. */
#define ERROR_AFTER_REST_M_S2 7.6e-4f
#define DRIFT_AFTER_REST_M_S3 3.3e-4f
/* Without a rest before: the tilt of a swimming fish is known to 0.5 deg, its gyroscopes' bias to
 * 0.02 deg/s; its speed is anything a fish swims. */
#define TILT_UNKNOWN_M_S2 0.1f
#define DRIFT_UNKNOWN_M_S3 3.5e-3f
#define START_UNKNOWN_M_S 0.1f
/* Change of speed within a beat that nothing is known of. So wide that a hole in the samples gets
 * no speed by guessing. */
#define JUMP_M_S 0.1f
/* Times are rounded. */
#define WHOLE_BEAT 0.99f
/* 5 sigma: with that at its end, the IMU has felt something else than this swim. */
#define SURPRISE_MAX 25.0f
/* The IMU is believed as long as it contradicts less than one camera beat in so many. */
#define CONTRADICTED_PART 3u
/* Mean speed of a beat in which the fish is held still. */
#define HELD_M_S 0.001f
/* The model about its scaled self: what it gets wrong is wrong for several beats on end. */
#define MODEL_SCATTER_M_S 0.004f
#define MODEL_SCATTER_PART 0.07f

static bool is(const estimate_t *estimate, speed_trait_t trait) {
    return speed_source_is(estimate->config.source, trait);
}

static bool counts(const estimate_t *estimate, const estimate_rest_t *rest) {
    return rest->still_s > 0.0f && rest->still_s >= estimate->config.rest_min_s;
}

/* What the IMU alone cannot do without; otherwise no sigma is good enough. */
static void imu_needs(estimate_t *estimate, bool fulfilled) {
    if (is(estimate, SPEED_NEEDS_RESTS) && !fulfilled) {
        estimate->config.sigma_max_m_s = -1.0f;
    }
}

static float error_after(const estimate_rest_t *before) {
    const float tilt_m_s2 = G_M_S2 * before->tilt_sigma_rad;
    if (!(tilt_m_s2 > 0.0f)) {
        return ERROR_AFTER_REST_M_S2;
    }
    return real_sqrt(ERROR_AFTER_REST_M_S2 * ERROR_AFTER_REST_M_S2 + tilt_m_s2 * tilt_m_s2);
}

/* A camera sees for itself how fast the fish was when it started, and needs no rest for that; nor
 * does a trial that no camera saw get speeds from its rest. */
static smoother_config_t smoother_config(const estimate_t *estimate,
                                         const estimate_rest_t *before) {
    const bool rested = counts(estimate, before);
    const bool sees = is(estimate, SPEED_SAMPLED);
    return (smoother_config_t){
        .beat_s = estimate->config.beat_s,
        .start_sigma_m_s = rested && !sees ? estimate->config.rest_sigma_m_s : START_UNKNOWN_M_S,
        .error_sigma_m_s2 = rested ? error_after(before) : TILT_UNKNOWN_M_S2,
        .drift_sigma_m_s3 = rested ? DRIFT_AFTER_REST_M_S3 : DRIFT_UNKNOWN_M_S3,
        .model_sigma = estimate->config.model_sigma,
        .accel_noise_m_s15 = ACCEL_NOISE_M_S15,
        .tilt_walk_m_s25 = TILT_WALK_M_S25,
        .jump_m_s = JUMP_M_S,
        .gate = sees ? SURPRISE_MAX : 0.0f,
    };
}

void estimate_begin(estimate_t *estimate, const estimate_config_t *config,
                    const estimate_rest_t *before, float *speed_m_s, float *sigma_m_s) {
    REQUIRE(config->beats <= BEATS_MAX);
    memset(estimate, 0, sizeof *estimate);
    estimate->config = *config;
    estimate->speed_m_s = speed_m_s;
    estimate->sigma_m_s = sigma_m_s;
    estimate->swum = config->beats;
    thrust_init(&estimate->thrust, &config->thrust, config->beat_s);
    const bool rested = counts(estimate, before);
    const smoother_config_t smoother = smoother_config(estimate, before);
    imu_needs(estimate, rested);
    smoother_init(&estimate->smoother, &smoother);
    for (uint16_t k = 0; k < BEATS_MAX && is(estimate, SPEED_ESTIMATED); k++) {
        speed_m_s[k] = NAN;
        sigma_m_s[k] = NAN;
    }
}

float estimate_needs_s(const estimate_t *estimate) {
    const float later_s = is(estimate, SPEED_SAMPLED) ? estimate->config.vision.gap_max_s : 0.0f;
    return (float)(estimate->next + 1u) * estimate->config.beat_s + later_s;
}

/* The first half of the rest does not count: a fish that coasts until it is caught feels still,
 * too. How it lost the rest of its speed is in the rises. */
static bool rests(const estimate_t *estimate, uint16_t step) {
    const estimate_rest_t *after = &estimate->after;
    const float beat_s = estimate->config.beat_s;
    const float since_s = (float)step * beat_s - after->begin_s;
    return counts(estimate, after) && since_s >= 0.5f * after->still_s &&
           since_s + WHOLE_BEAT * beat_s <= after->still_s;
}

static bool is_doubted(const estimate_t *estimate, uint16_t beat) {
    return (estimate->doubted[beat / 8u] & 1u << beat % 8u) != 0;
}

static smoother_evidence_t evidence_of(const void *context, uint16_t step) {
    const estimate_t *estimate = context;
    smoother_evidence_t evidence = {.rise_m_s = estimate->rise_m_s[step], .speed_m_s = NAN};
    if (step < estimate->swum && !is_doubted(estimate, step)) {
        evidence.speed_m_s = estimate->speed_m_s[step];
        evidence.sigma_m_s = estimate->sigma_m_s[step];
        evidence.scaled = is(estimate, SPEED_MODELLED);
    } else if (step >= estimate->swum && rests(estimate, step)) {
        evidence.speed_m_s = 0.0f;
        evidence.sigma_m_s = HELD_M_S;
    }
    return evidence;
}

/* Beats whose mean takes anything from between the two times. */
static void doubt_beats(estimate_t *estimate, float from_s, float to_s) {
    const float beat_s = estimate->config.beat_s;
    const float half_s = 0.5f * real_clip(estimate->config.vision.window_s, 0.0f, beat_s);
    const float last = (float)(BEATS_MAX - 1u);
    const float first_s = from_s + half_s - beat_s;
    const uint16_t end = (uint16_t)real_clip((to_s - half_s) / beat_s + 1.0f, 0.0f, last + 1.0f);
    for (uint16_t k = (uint16_t)real_clip(first_s / beat_s, 0.0f, last); k < end; k++) {
        if ((float)k * beat_s >= first_s) {
            estimate->doubted[k / 8u] |= (uint8_t)(1u << k % 8u);
        }
    }
}

/* As far as the beat's slots reach, whatever else is closed already. */
static void doubt_slots(estimate_t *estimate, const speed_t *speed, float until_s) {
    while ((float)(estimate->next_slot + 1u) * SPEED_SLOT_S <= until_s &&
           estimate->next_slot < speed->next_close) {
        const speed_slot_t *slot = speed_slot_at(speed, estimate->next_slot++);
        float from_s, to_s;
        if (slot != NULL && slot->samples != 0 &&
            doubt_slot(&estimate->doubt, &estimate->config.vision, slot, &from_s, &to_s)) {
            doubt_beats(estimate, from_s, to_s);
        }
    }
}

/* What the source says of the beat by itself. */
static void look(estimate_t *estimate, const speed_t *speed, float begin_s, float applied_rad) {
    const estimate_config_t *config = &estimate->config;
    const uint16_t k = estimate->next;
    const bool moved = real_is_finite(estimate->rise_m_s[k]);
    estimate->samples[k] = moved ? (uint16_t)(config->beat_s / SPEED_SLOT_S) : 1u;
    if (is(estimate, SPEED_SAMPLED)) {
        const speed_beat_t beat = speed_beat(speed, &config->vision, begin_s, config->beat_s);
        estimate->speed_m_s[k] = beat.speed_m_s;
        estimate->sigma_m_s[k] = beat.sigma_m_s;
        if (beat.measured) {
            estimate->samples[k] = beat.samples;
        }
    } else if (is(estimate, SPEED_MODELLED)) {
        const float model_m_s = thrust_beat(&estimate->thrust, applied_rad);
        estimate->speed_m_s[k] = model_m_s;
        estimate->sigma_m_s[k] = MODEL_SCATTER_M_S + MODEL_SCATTER_PART * model_m_s;
    }
}

/* NaN where it is not good enough. */
static speed_beat_t judged(const estimate_t *estimate, uint16_t beat, float speed_m_s,
                           float sigma_m_s) {
    if (beat >= estimate->swum || !(sigma_m_s <= estimate->config.sigma_max_m_s) ||
        !real_is_finite(speed_m_s)) {
        return (speed_beat_t){.speed_m_s = NAN, .sigma_m_s = NAN};
    }
    return (speed_beat_t){speed_m_s, sigma_m_s, estimate->samples[beat], true};
}

speed_beat_t estimate_beat(estimate_t *estimate, const speed_t *speed, float applied_rad) {
    const estimate_config_t *config = &estimate->config;
    const uint16_t step = estimate->next;
    REQUIRE(step < config->beats + SMOOTHER_AFTER);
    const float begin_s = (float)step * config->beat_s;
    float speed_m_s = NAN;
    float sigma_m_s = NAN;
    if (is(estimate, SPEED_ESTIMATED)) {
        if (is(estimate, SPEED_SAMPLED)) {
            doubt_slots(estimate, speed, estimate_needs_s(estimate));
        }
        estimate->rise_m_s[step] = speed_rise(speed, begin_s, config->beat_s);
        if (step < config->beats) {
            look(estimate, speed, begin_s, applied_rad);
            const smoother_evidence_t evidence = evidence_of(estimate, step);
            smoother_forward(&estimate->smoother, &evidence, &speed_m_s, &sigma_m_s);
        }
    }
    estimate->next++;
    return judged(estimate, step, speed_m_s, sigma_m_s);
}

/* The IMU alone: what scale errors may have done goes on for beats on end. Whether the smoother has
 * to start again. */
static bool widen(estimate_t *estimate) {
    const float swum_s = (float)estimate->swum * estimate->config.beat_s;
    if (!is(estimate, SPEED_NEEDS_RESTS) || estimate->swum == 0 ||
        !(estimate->after.tilt_sigma_rad > 0.0f)) {
        return false;
    }
    const float walk = G_M_S2 * estimate->after.tilt_sigma_rad / swum_s;
    estimate->smoother.config.tilt_walk_m_s25 =
        real_sqrt(TILT_WALK_M_S25 * TILT_WALK_M_S25 + walk * walk * SCALE_LASTS_S);
    return true;
}

void estimate_after(estimate_t *estimate, uint16_t swum, const estimate_rest_t *after) {
    estimate->swum = swum < estimate->next ? swum : estimate->next;
    if (estimate->swum > estimate->config.beats) {
        estimate->swum = estimate->config.beats;
    }
    estimate->after = *after;
    imu_needs(estimate, estimate->next > 0 && rests(estimate, (uint16_t)(estimate->next - 1u)));
    const bool again = is(estimate, SPEED_SAMPLED) || widen(estimate);
    smoother_rewind(&estimate->smoother, again ? 0 : estimate->swum);
}

static void keep_result(void *context, uint16_t step, float speed_m_s, float sigma_m_s) {
    estimate_t *estimate = context;
    if (step < estimate->config.beats) {
        const speed_beat_t beat = judged(estimate, step, speed_m_s, sigma_m_s);
        estimate->speed_m_s[step] = beat.speed_m_s;
        estimate->sigma_m_s[step] = beat.sigma_m_s;
    }
}

static bool forward(estimate_t *estimate) {
    smoother_t *smoother = &estimate->smoother;
    if (smoother->steps >= estimate->next) {
        return false;
    }
    for (uint16_t i = 0; i < SMOOTHER_BLOCK && smoother->steps < estimate->next; i++) {
        float speed_m_s, sigma_m_s;
        const smoother_evidence_t evidence = evidence_of(estimate, smoother->steps);
        smoother_forward(smoother, &evidence, &speed_m_s, &sigma_m_s);
    }
    return true;
}

/* Whether the IMU had a part up to now and has lost it: all is to be done again. */
static bool drop_imu(estimate_t *estimate) {
    const smoother_t *smoother = &estimate->smoother;
    const uint32_t beats = (uint32_t)smoother->refused + smoother->believed;
    if (smoother->turned || smoother->refused == 0 ||
        CONTRADICTED_PART * smoother->refused < beats) {
        return false;
    }
    for (uint16_t k = 0; k < estimate->next; k++) {
        estimate->rise_m_s[k] = NAN;
    }
    smoother_rewind(&estimate->smoother, 0);
    return true;
}

bool estimate_finish(estimate_t *estimate) {
    if (!is(estimate, SPEED_ESTIMATED)) {
        return true;
    }
    if (forward(estimate) || drop_imu(estimate)) {
        return false;
    }
    imu_needs(estimate, estimate->smoother.surprise <= SURPRISE_MAX);
    return !smoother_back(&estimate->smoother, evidence_of, keep_result, estimate);
}

speed_beat_t estimate_result(const estimate_t *estimate, uint16_t beat) {
    return judged(estimate, beat, estimate->speed_m_s[beat], estimate->sigma_m_s[beat]);
}
