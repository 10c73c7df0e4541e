/*
 * Runs the code that counts in float32 over many made-up cases and prints a CRC over the bits of
 * all results, function by function, and the results of a few cases in full. Compiled for the host
 * and for the Cortex-M3; the two outputs must be the same text.
 */
#include "base/crc.h"
#include "base/panic.h"
#include "base/real.h"
#include "gait/gait.h"
#include "ilc/law.h"
#include "ilc/memory.h"
#include "speed/estimate.h"
#include "speed/motion.h"
#include "speed/rest.h"
#include "speed/speed.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define LAW_CASES 1500u
#define MEMORY_CASES 300u
#define SERIES_TRIALS 8u
#define GAIT_CASES 200u
#define GAIT_FRAMES 400u
#define SPEED_CASES 300u
#define MOTION_CASES 60u
#define ESTIMATE_CASES 30u
#define ESTIMATE_BEATS 40u
#define MOTION_FRAMES 500u
#define REAL_CASES 60000u
#define SHOWN 4u

/* No expression here draws two random numbers: which comes first is left to the compiler. */
static uint32_t random_state = 2016u;
static uint32_t crc;
static uint32_t results;

_Noreturn void panic(const char *where) {
    printf("panic at %s\n", where);
    exit(1);
}

static uint32_t random_bits(void) {
    random_state = random_state * 1664525u + 1013904223u;
    return random_state;
}

static uint32_t below(uint32_t limit) {
    return (uint32_t)(((uint64_t)random_bits() * limit) >> 32);
}

/* Exact on every machine: a whole number of 24 bits times a power of two, then one multiplication.
 */
static float between(float low, float high) {
    return low + (high - low) * ((float)(random_bits() >> 8) * 0x1p-24f);
}

static float of_bits(uint32_t bits) {
    float x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

/* Any float: denormals, infinities and NaN with the rest. */
static float any_float(void) {
    const uint32_t bits = random_bits();
    return of_bits(bits ^ random_bits() << 13);
}

/* One NaN is as good as another: which bits an invalid operation gives is left to the machine. */
static uint32_t bits_of(float x) {
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    return (bits & 0x7FFFFFFFu) > 0x7F800000u ? 0x7FC00000u : bits;
}

static void note_word(uint32_t word) {
    crc = crc32_update(crc, &word, sizeof word);
    results++;
}

static void note(float x) { note_word(bits_of(x)); }

static void note_all(const float *values, uint32_t count) {
    for (uint32_t i = 0; i < count; i++) {
        note(values[i]);
    }
}

static void begin(void) {
    crc = 0xFFFFFFFFu;
    results = 0;
}

static void end(const char *what) {
    printf("%-12s %08lx over %lu results\n", what, (unsigned long)crc, (unsigned long)results);
}

static void show(const char *what, const float *values, uint32_t count) {
    printf("  %s", what);
    for (uint32_t i = 0; i < count && i < SHOWN; i++) {
        printf(" %08lx", (unsigned long)bits_of(values[i]));
    }
    printf("\n");
}

static law_t random_law(uint16_t beats) {
    law_t law = {0};
    law.kp_rad_s_m = between(-1.0f, 20.0f);
    law.amplitude_max_rad = between(0.1f, 1.0f);
    law.beat_s = between(0.1f, 3.0f);
    law.lead_beats = 0.5f * (float)below(2u * (beats < 5u ? beats : 5u));
    law.fade = below(2) != 0 ? between(0.0f, 2.0f) : 0.0f;
    law.fade_from = (uint16_t)below(8u);
    law.q_len = (uint16_t)(1u + below((beats + 1u) / 2u));
    law.tail = (law_tail_t)below(LAW_TAIL_COUNT);
    if (below(4) == 0) {
        law.amplitude_min_rad = between(-0.5f, 0.09f);
    }
    if (below(2) != 0) {
        law.kd_rad_s2_m = between(-5.0f, 5.0f);
    }
    if (below(2) != 0) {
        law.step_max_rad = between(0.0f, 0.3f);
    }
    return law;
}

static float error_m_s[BEATS_MAX];
static float amplitude_rad[BEATS_MAX];
static float scratch[BEATS_MAX];
static uint8_t measured[BEATS_MAX];
static uint8_t visits[BEATS_MAX];

static void random_trial(uint16_t beats, law_trial_t *trial) {
    for (uint32_t k = 0; k < beats; k++) {
        error_m_s[k] = below(200) != 0 ? between(-0.3f, 0.3f) : any_float();
        measured[k] = below(8) != 0;
        visits[k] = (uint8_t)below(30);
    }
    *trial = (law_trial_t){.beats = beats,
                           .error_m_s = error_m_s,
                           .measured = below(3) != 0 ? measured : NULL,
                           .visits = below(3) != 0 ? visits : NULL};
}

static void note_report(const law_report_t *report) {
    note(report->max_abs_error_m_s);
    note(report->rms_error_m_s);
    note_word((uint32_t)report->measured_beats << 16 | report->saturated_beats);
}

static void law_cases(void) {
    begin();
    for (uint32_t i = 0; i < LAW_CASES; i++) {
        const uint16_t beats = (uint16_t)(1u + below(i % 100u == 0 ? BEATS_MAX : 60u));
        const law_t law = random_law(beats);
        law_trial_t trial;
        law_report_t report = {0};
        random_trial(beats, &trial);
        for (uint32_t k = 0; k < beats; k++) {
            amplitude_rad[k] = between(-0.2f, 1.2f);
        }
        note_word((uint32_t)law_judge(&law, &trial, amplitude_rad, &report));
        note_report(&report);
        note_word((uint32_t)law_update(&law, &trial, amplitude_rad, scratch, &report));
        note_report(&report);
        note_all(amplitude_rad, beats);
        if (i % 500u == 0) {
            show("law_update", amplitude_rad, beats);
        }
    }
    end("law");
}

static law_weights_t random_weights(void) {
    law_weights_t weights;
    weights.input = between(-0.5f, 1.5f);
    weights.kp = between(-0.5f, 3.0f);
    weights.kd = between(-0.5f, 3.0f);
    return weights;
}

static void weighted_cases(void) {
    static float sum[BEATS_MAX];
    begin();
    for (uint32_t i = 0; i < LAW_CASES; i++) {
        const uint16_t beats = (uint16_t)(1u + below(60));
        const law_t law = random_law(beats);
        memset(sum, 0, sizeof sum);
        for (uint32_t added = 0; added < 3u; added++) {
            law_trial_t trial;
            random_trial(beats, &trial);
            for (uint32_t k = 0; k < beats; k++) {
                amplitude_rad[k] = between(-0.2f, 1.2f);
            }
            const law_weights_t weights = random_weights();
            note_word((uint32_t)law_add(&law, &weights, &trial, amplitude_rad, sum));
            note_word(law_corrects(&law, &trial, below(beats)));
        }
        law_finish(&law, beats, sum, amplitude_rad);
        note_all(amplitude_rad, beats);
        if (i % 500u == 0) {
            show("law_finish", amplitude_rad, beats);
        }
    }
    end("weighted");
}

static void memory_cases(void) {
    static memory_t memory;
    begin();
    for (uint32_t i = 0; i < MEMORY_CASES; i++) {
        const uint16_t beats = (uint16_t)(1u + below(60));
        const law_t law = random_law(beats);
        memset(&memory, 0, sizeof memory);
        memory_begin(&memory, i, beats);
        for (uint32_t k = 0; k < beats; k++) {
            error_m_s[k] = between(0.0f, 0.3f);
        }
        note_word((uint32_t)memory_first(&memory, &law, error_m_s, scratch));
        for (uint32_t number = 1; number <= SERIES_TRIALS; number++) {
            law_trial_t trial;
            memory_report_t report = {0};
            random_trial(beats, &trial);
            const memory_rules_t rules = {.rollback_ratio = 1.3f};
            note_word((uint32_t)memory_learn(&memory, &law, &trial, number, below(4) != 0, &rules,
                                             scratch, &report));
            note_report(&report.law);
            note_word(report.improved * 2u + report.rolled_back);
        }
        note_all(memory.amplitude_rad, beats);
        note_all(memory.best_rad, beats);
        note(memory.best_max_abs_error_m_s);
        if (i % 100u == 0) {
            show("memory_learn", memory.amplitude_rad, beats);
        }
    }
    end("memory");
}

static gait_config_t random_gait(void) {
    gait_config_t config = {0};
    config.servo.centre_us = between(1400.0f, 1600.0f);
    config.servo.us_per_rad = between(50.0f, 1500.0f);
    config.servo.min_us = between(600.0f, 1200.0f);
    config.servo.max_us = between(1800.0f, 2400.0f);
    config.servo.direction = below(2) != 0 ? 1.0f : -1.0f;
    config.frames_per_beat = (uint16_t)(GAIT_FRAMES_PER_BEAT_MIN + below(200));
    config.coast_frames = (uint16_t)below(50);
    if (below(2) != 0) {
        config.servo.slew_rad_s = between(0.5f, 20.0f);
    }
    return config;
}

static void gait_cases(void) {
    begin();
    for (uint32_t i = 0; i < GAIT_CASES; i++) {
        const gait_config_t config = random_gait();
        const uint32_t stop_at = below(GAIT_FRAMES);
        float angle_rad[SHOWN] = {0};
        gait_t gait;
        gait_init(&gait);
        note_word(gait_config_valid(&config));
        for (uint32_t frame = 0; frame < GAIT_FRAMES; frame++) {
            const gait_command_t command = {.swim = frame < stop_at,
                                            .amplitude_rad = between(0.0f, 1.0f)};
            const gait_output_t output = gait_frame_isr(&gait, &config, command);
            note(output.angle_rad);
            note_word((uint32_t)output.pulse_ticks << 16 | (uint32_t)output.mode);
            if (frame >= 20u && frame < 20u + SHOWN) {
                angle_rad[frame - 20u] = output.angle_rad;
            }
        }
        note_word(gait.servo.clipped_frames);
        if (i % 50u == 0) {
            show("gait_frame_isr", angle_rad, SHOWN);
        }
    }
    end("gait");
}

static void note_slot(const speed_slot_t *slot) {
    note(slot->speed_m_s);
    note_word((uint32_t)slot->index << 16 | slot->sigma_10um_s);
    note_word((uint32_t)(uint16_t)slot->gain_10um_s << 16 | (uint16_t)slot->way_um);
    note_word((uint32_t)slot->samples << 8 | slot->at_ms);
}

static void speed_case(const speed_config_t *config, uint32_t number) {
    static speed_t speed;
    uint16_t index;
    const float beat_s = FRAME_S * (float)(15u + below(85u));
    float time_s = 0.0f;
    speed_init(&speed);
    for (uint32_t i = 0; i < 200u; i++) {
        const float longest_s = below(40) != 0 ? 0.06f : 0.9f;
        time_s += between(0.0f, longest_s);
        const float value = below(50) != 0 ? between(-0.1f, 0.4f) : any_float();
        const speed_sample_t sample = {time_s, value, between(-0.001f, 0.01f)};
        note_word(speed_add(&speed, config, sample));
        while (speed_slot_due(&speed, time_s - 1.0f, &index)) {
            speed_motion_t motion;
            motion.gain_m_s = between(-0.03f, 0.03f);
            motion.way_m = below(300) != 0 ? between(-0.002f, 0.002f) : any_float();
            const speed_slot_t slot = speed_close_slot(&speed, &motion);
            note_slot(&slot);
        }
    }
    for (float begin_s = 0.0f; begin_s < time_s; begin_s += beat_s) {
        const speed_beat_t beat = speed_beat(&speed, config, begin_s, beat_s);
        const float rise_m_s = speed_rise(&speed, begin_s, beat_s);
        note(beat.speed_m_s);
        note(beat.sigma_m_s);
        note_word(beat.samples);
        note(rise_m_s);
        if (number % 100u == 0) {
            show("speed_beat", &beat.speed_m_s, 1);
            show("speed_rise", &rise_m_s, 1);
        }
    }
}

static void speed_cases(void) {
    begin();
    for (uint32_t i = 0; i < SPEED_CASES; i++) {
        speed_config_t config = {0};
        config.gap_max_s = between(0.1f, 1.0f);
        config.plausible_m_s = between(0.2f, 1.0f);
        if (below(2) != 0) {
            config.window_s = between(0.0f, 0.3f);
        }
        speed_case(&config, i);
    }
    end("speed");
}

/* Noise about a fish that is held or, with |swing|, swims. */
static imu_frame_t random_frame(uint32_t number, float swing) {
    imu_frame_t frame = {0};
    for (uint32_t axis = 0; axis < 3u; axis++) {
        const float swung = swing * real_sin_turn(number + 17u * axis, 100u);
        frame.rate_rad_s[axis] = swung + between(-0.02f, 0.02f);
        frame.accel_m_s2[axis] = 0.4f * swung + between(-0.05f, 0.05f);
    }
    frame.accel_m_s2[2] -= 9.81f;
    return frame;
}

static float random_step(float nominal_s) {
    if (below(100) != 0) {
        return nominal_s;
    }
    return below(10) != 0 ? nominal_s * (float)below(12u) : any_float();
}

static void note_rest(const rest_t *rest) {
    rest_mean_t mean = {0};
    note_word(rest_get(rest, &mean));
    note(mean.still_s);
    note_all(mean.accel_m_s2, 3);
    note_all(mean.rate_rad_s, 3);
}

static void motion_case(uint32_t number) {
    static rest_t rest;
    static motion_t motion;
    rest_mean_t mean = {0};
    const float nominal_s = between(0.0025f, 0.02f);
    float time_s = between(0.0f, 100.0f);
    rest_init(&rest);
    for (uint32_t i = 0; i < 600u; i++) {
        const imu_frame_t frame = random_frame(i, below(300) != 0 ? 0.0f : 5.0f);
        rest_push(&rest, &frame, nominal_s);
        if (i % 50u == 0) {
            note_rest(&rest);
        }
    }
    const imu_frame_t last = random_frame(0, any_float());
    const bool rested = rest_get(&rest, &mean);
    motion_begin(&motion, rested ? &mean : NULL, &last);
    for (uint32_t i = 0; i < MOTION_FRAMES; i++) {
        const imu_frame_t frame = random_frame(i, 1.0f);
        const float dt_s = random_step(nominal_s);
        time_s += dt_s > 0.0f && dt_s < 1.0f ? dt_s : nominal_s;
        motion_push(&motion, &frame, time_s, dt_s);
    }
    for (uint32_t i = 0; i < 4u; i++) {
        note_word((uint32_t)motion.attitude.q[i]);
        note_word((uint32_t)((uint64_t)motion.attitude.q[i] >> 32));
    }
    for (uint32_t back = 0; back < 30u; back++) {
        float moved[2] = {0};
        const uint16_t index = (uint16_t)(motion.index - back);
        note_word(motion_forward(&motion, index, between(0.1f, 4.0f), &moved[0], &moved[1]));
        note_all(moved, 2);
        if (number % 20u == 0 && back == 10u) {
            show("motion", moved, 2);
        }
    }
}

static void motion_cases(void) {
    begin();
    for (uint32_t i = 0; i < MOTION_CASES; i++) {
        motion_case(i);
    }
    end("motion");
}

static estimate_config_t random_estimate(void) {
    static const speed_source_t sources[] = {SPEED_SOURCE_VISION, SPEED_SOURCE_IMU,
                                             SPEED_SOURCE_MODEL};
    estimate_config_t config = {.beats = ESTIMATE_BEATS, .rest_min_s = 5.0f, .sigma_max_m_s = 1.0f};
    config.source = sources[below(3)];
    config.beat_s = 0.02f * (float)(30u + below(50));
    config.vision = (speed_config_t){.window_s = config.beat_s, .gap_max_s = 0.5f};
    config.vision.plausible_m_s = 1.0f;
    config.thrust.kappa_per_m = between(1.0f, 100.0f);
    config.thrust.slope_m_s_rad = between(0.1f, 0.4f);
    config.thrust.dead_zone_rad = between(0.0f, 0.3f);
    config.thrust.delay_s = between(0.0f, 1.5f);
    config.model_sigma = between(0.05f, 0.5f);
    config.rest_sigma_m_s = between(0.001f, 0.01f);
    return config;
}

static void random_slot(speed_t *speed, const estimate_config_t *config) {
    const float begin_s = SPEED_SLOT_S * (float)speed->next_close;
    speed_sample_t sample = {.time_s = begin_s + 0.05f, .sigma_m_s = 0.0007f};
    sample.speed_m_s = between(0.02f, 0.1f);
    if (below(5) != 0) {
        (void)speed_add(speed, &config->vision, sample);
    }
    speed_motion_t motion;
    motion.gain_m_s = between(-0.02f, 0.02f);
    motion.way_m = between(-0.001f, 0.001f);
    (void)speed_close_slot(speed, below(100) != 0 ? &motion : NULL);
}

static void estimate_case(void) {
    static speed_t speed;
    static estimate_t estimate;
    static float speed_m_s[BEATS_MAX], sigma_m_s[BEATS_MAX];
    const estimate_config_t config = random_estimate();
    const estimate_rest_t before = {.begin_s = -10.0f, .still_s = 10.0f};
    speed_init(&speed);
    estimate_begin(&estimate, &config, &before, speed_m_s, sigma_m_s);
    while (estimate.next < ESTIMATE_BEATS + 10u) {
        while ((float)speed.next_close * SPEED_SLOT_S < estimate_needs_s(&estimate)) {
            random_slot(&speed, &config);
        }
        const speed_beat_t beat = estimate_beat(&estimate, &speed, between(0.0f, 0.8f));
        note(beat.speed_m_s);
        note(beat.sigma_m_s);
    }
    const estimate_rest_t after = {.begin_s = (float)ESTIMATE_BEATS * config.beat_s,
                                   .still_s = 10.0f * config.beat_s};
    estimate_after(&estimate, ESTIMATE_BEATS, &after);
    while (!estimate_finish(&estimate)) {
    }
    note_all(speed_m_s, ESTIMATE_BEATS);
    note_all(sigma_m_s, ESTIMATE_BEATS);
}

static void estimate_cases(void) {
    begin();
    for (uint32_t i = 0; i < ESTIMATE_CASES; i++) {
        estimate_case();
    }
    end("estimate");
}

static void real_cases(void) {
    begin();
    for (uint32_t i = 0; i < REAL_CASES; i++) {
        const float x = any_float();
        const uint64_t whole = real_whole_u64(x);
        const uint32_t numerator = random_bits();
        note(real_sqrt(x));
        note(real_sin_turn(numerator, 1u + below(2000)));
        note_word((uint32_t)whole ^ (uint32_t)(whole >> 32));
    }
    end("real");
}

/* The operations themselves, on all kinds of numbers. */
static void arithmetic_cases(void) {
    begin();
    for (uint32_t i = 0; i < REAL_CASES; i++) {
        const volatile float a = any_float();
        const volatile float b = below(4) != 0 ? any_float() : a * between(0.5f, 2.0f);
        note(a + b);
        note(a - b);
        note(a * b);
        note(a / b);
        note_word((a < b) * 4u + (a <= b) * 2u + (a == b));
    }
    end("arithmetic");
}

int main(void) {
    law_cases();
    weighted_cases();
    memory_cases();
    gait_cases();
    speed_cases();
    motion_cases();
    estimate_cases();
    real_cases();
    arithmetic_cases();
    return 0;
}
