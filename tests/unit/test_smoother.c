#include "speed/smoother.h"

#include "target.h"
#include "unity.h"

#include <math.h>
#include <string.h>

#define STEPS_MAX SMOOTHER_STEPS
#define REFERENCE_STEPS 90u
#define SWIMS 250u
#define REST_SIGMA_M_S 0.001
#define SOURCES (4u + 2u * REFERENCE_STEPS)

static smoother_t smoother;
static smoother_config_t config;
static smoother_evidence_t evidence[STEPS_MAX];
static float filtered[STEPS_MAX], filtered_sigma[STEPS_MAX];
static float smoothed[STEPS_MAX], smoothed_sigma[STEPS_MAX];
static uint16_t results;
static double true_speed[STEPS_MAX];
static uint64_t random_state;

void setUp(void) {
    random_state = 4711u;
    config = (smoother_config_t){
        .beat_s = 1.0f,
        .start_sigma_m_s = 0.003f,
        .error_sigma_m_s2 = 1e-3f,
        .drift_sigma_m_s3 = 3e-4f,
        .model_sigma = 0.25f,
        .accel_noise_m_s15 = 1.4e-3f,
        .tilt_walk_m_s25 = 6e-4f,
        .jump_m_s = 0.1f,
    };
}

void tearDown(void) {}

static double uniform(void) {
    uint64_t x = random_state += 0x9E3779B97F4A7C15u;
    x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9u;
    x = (x ^ (x >> 27)) * 0x94D049BB133111EBu;
    return ((double)((x ^ (x >> 31)) >> 11) + 0.5) / 9007199254740992.0;
}

static double normal(void) {
    return sqrt(-2 * log(uniform())) * cos(6.283185307179586 * uniform());
}

static double between(double low, double high) { return low + (high - low) * uniform(); }

static smoother_evidence_t recall(const void *context, uint16_t step) {
    TEST_ASSERT_TRUE(context == &smoother);
    return evidence[step];
}

static void result(void *context, uint16_t step, float speed_m_s, float sigma_m_s) {
    TEST_ASSERT_TRUE(context == &smoother);
    smoothed[step] = speed_m_s;
    smoothed_sigma[step] = sigma_m_s;
    results++;
}

static void run_forward(uint16_t from, uint16_t steps) {
    for (uint16_t k = from; k < steps; k++) {
        TEST_ASSERT_EQUAL_UINT16(k, smoother.steps);
        smoother_forward(&smoother, &evidence[k], &filtered[k], &filtered_sigma[k]);
    }
}

static void run_back(uint16_t steps) {
    results = 0;
    for (uint16_t done = 0; smoother_back(&smoother, recall, result, &smoother); done++) {
        TEST_ASSERT_TRUE(done <= steps / SMOOTHER_BLOCK);
        TEST_ASSERT_EQUAL_UINT16(0, (steps - results) % SMOOTHER_BLOCK);
    }
    TEST_ASSERT_EQUAL_UINT16(steps, results);
}

static void run(uint16_t steps) {
    smoother_init(&smoother, &config);
    run_forward(0, steps);
    run_back(steps);
}

static void nothing_known(uint16_t steps) {
    for (uint16_t k = 0; k < steps; k++) {
        evidence[k] = (smoother_evidence_t){.rise_m_s = NAN, .speed_m_s = NAN, .sigma_m_s = NAN};
    }
}

/* ---- The same estimate the slow way. Every quantity is a number plus a sum of independent sources
 * (start, a, r, s, and two noises per step); evidence conditions the sources' joint distribution.
 * --
 */

static double mean_of[SOURCES], covariance[SOURCES][SOURCES];
static unsigned sources;

typedef struct {
    double offset, part[SOURCES];
} linear_t;

static linear_t speed_at[REFERENCE_STEPS], error_now;

static void condition(const linear_t *what, double z, double variance) {
    static double column[SOURCES];
    double expected = what->offset, sum = variance;
    for (unsigned i = 0; i < sources; i++) {
        expected += what->part[i] * mean_of[i];
        column[i] = 0;
        for (unsigned j = 0; j < sources; j++) {
            column[i] += covariance[i][j] * what->part[j];
        }
        sum += what->part[i] * column[i];
    }
    for (unsigned i = 0; i < sources; i++) {
        mean_of[i] += column[i] * (z - expected) / sum;
        for (unsigned j = 0; j < sources; j++) {
            covariance[i][j] -= column[i] * column[j] / sum;
        }
    }
}

static void expect(const linear_t *what, double *mean, double *sigma) {
    *mean = what->offset;
    double variance = 0;
    for (unsigned i = 0; i < sources; i++) {
        *mean += what->part[i] * mean_of[i];
        for (unsigned j = 0; j < sources; j++) {
            variance += what->part[i] * covariance[i][j] * what->part[j];
        }
    }
    *sigma = sqrt(variance);
}

static void add_scaled(linear_t *to, const linear_t *from, double factor) {
    to->offset += factor * from->offset;
    for (unsigned i = 0; i < sources; i++) {
        to->part[i] += factor * from->part[i];
    }
}

static double square(double x) { return x * x; }

static void reference_begin(uint16_t steps) {
    sources = 4u + 2u * steps;
    memset(mean_of, 0, sizeof mean_of);
    memset(covariance, 0, sizeof covariance);
    memset(&error_now, 0, sizeof error_now);
    covariance[0][0] = square((double)config.start_sigma_m_s);
    covariance[1][1] = square((double)config.error_sigma_m_s2);
    covariance[2][2] = square((double)config.drift_sigma_m_s3);
    covariance[3][3] = square((double)config.model_sigma);
    error_now.part[1] = 1;
}

static void reference_step(uint16_t k) {
    const smoother_evidence_t *e = &evidence[k];
    const unsigned walk = 4u + 2u * k, noise = walk + 1u;
    const double tau = (k == 0 ? 0.5 : 1.0) * (double)config.beat_s;
    const double walk_variance = square((double)config.tilt_walk_m_s25) * tau;
    const bool known = !isnan(e->rise_m_s);
    covariance[walk][walk] = walk_variance;
    linear_t *u = &speed_at[k];
    memset(u, 0, sizeof *u);
    if (k == 0) {
        u->part[0] = 1;
    } else {
        *u = speed_at[k - 1];
    }
    u->part[noise] += 1;
    covariance[noise][noise] = square((double)config.jump_m_s);
    if (known) {
        covariance[noise][noise] = square((double)config.accel_noise_m_s15) * tau;
        u->offset += (double)e->rise_m_s;
        add_scaled(u, &error_now, -tau);
        u->part[2] -= tau * tau / 2;
    }
    error_now.part[2] += tau;
    error_now.part[walk] += 1;
    if (!isnan(e->speed_m_s)) {
        linear_t seen = *u;
        seen.part[3] -= e->scaled ? (double)e->speed_m_s : 0;
        condition(&seen, (double)e->speed_m_s, square((double)e->sigma_m_s));
    }
}

/* Also checks the filter on the way. */
static void compare(uint16_t steps, double in_sigma) {
    double mean, sigma;
    run(steps);
    reference_begin(steps);
    for (uint16_t k = 0; k < steps; k++) {
        reference_step(k);
        expect(&speed_at[k], &mean, &sigma);
        TEST_ASSERT_DOUBLE_WITHIN(in_sigma * sigma, mean, (double)filtered[k]);
        TEST_ASSERT_DOUBLE_WITHIN(in_sigma * sigma, sigma, (double)filtered_sigma[k]);
    }
    for (uint16_t k = 0; k < steps; k++) {
        expect(&speed_at[k], &mean, &sigma);
        TEST_ASSERT_DOUBLE_WITHIN(in_sigma * sigma, mean, (double)smoothed[k]);
        TEST_ASSERT_DOUBLE_WITHIN(in_sigma * sigma, sigma, (double)smoothed_sigma[k]);
    }
}

/* ---- Problems ---- */

typedef struct {
    double known;  /* share of beats with a rise */
    double seen;   /* share of beats with a speed */
    bool scaled;   /* that of the model */
    uint16_t rest; /* beats at the end */
} problem_t;

/* Draws a swim from the smoother's own model. */
static void draw(uint16_t steps, problem_t problem) {
    const double s = (double)config.model_sigma * normal();
    const double r = (double)config.drift_sigma_m_s3 * normal();
    double a = (double)config.error_sigma_m_s2 * normal();
    double u = (double)config.start_sigma_m_s * normal();
    for (uint16_t k = 0; k < steps; k++) {
        smoother_evidence_t *e = &evidence[k];
        const bool known = uniform() < problem.known;
        const double tau = (k == 0 ? 0.5 : 1.0) * (double)config.beat_s;
        const double walk = (double)config.tilt_walk_m_s25 * sqrt(tau) * normal();
        const double noise = (double)config.accel_noise_m_s15 * sqrt(tau) * normal();
        const bool rest = k + problem.rest >= steps;
        const double change = rest    ? REST_SIGMA_M_S * normal() - u
                              : known ? 0.03 * normal()
                                      : (double)config.jump_m_s * normal();
        const double error = tau * a + tau * tau / 2 * r;
        a += tau * r + walk;
        u += change;
        *e = (smoother_evidence_t){.rise_m_s = known ? (float)(change + error - noise) : NAN,
                                   .speed_m_s = NAN,
                                   .sigma_m_s = NAN,
                                   .scaled = problem.scaled && !rest};
        if (rest) {
            e->speed_m_s = 0.0f;
            e->sigma_m_s = (float)REST_SIGMA_M_S;
        } else if (uniform() < problem.seen) {
            const double sigma = problem.scaled ? 0.01 : between(0.0005, 0.002);
            e->sigma_m_s = (float)sigma;
            e->speed_m_s = (float)((u + sigma * normal()) / (problem.scaled ? 1 + s : 1));
        }
        true_speed[k] = u;
    }
}

static void test_one_vision_beat_by_hand(void) {
    nothing_known(1);
    config.start_sigma_m_s = 0.003f;
    config.jump_m_s = 0.004f; /* 0.005 before the measurement */
    evidence[0].speed_m_s = 0.1f;
    evidence[0].sigma_m_s = 0.005f;
    run(1);
    TEST_ASSERT_FLOAT_WITHIN(1e-7f, 0.05f, smoothed[0]);
    TEST_ASSERT_FLOAT_WITHIN(1e-7f, 0.005f * 0.70710678f, smoothed_sigma[0]);
    TEST_ASSERT_EQUAL_FLOAT(filtered[0], smoothed[0]);
}

static void test_two_vision_beats_by_hand(void) {
    nothing_known(2);
    config.start_sigma_m_s = 100.0f; /* nothing */
    config.jump_m_s = 0.003f;
    evidence[0].speed_m_s = 0.1f;
    evidence[1].speed_m_s = 0.2f;
    evidence[0].sigma_m_s = evidence[1].sigma_m_s = 0.004f;
    run(2);
    /* 0.1 with 4^2 and 0.2 with 3^2 + 4^2 mm/s. */
    TEST_ASSERT_FLOAT_WITHIN(1e-5f, 0.1f + 0.1f * 16.0f / 41.0f, smoothed[0]);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.004f * 5.0f / sqrtf(41.0f), smoothed_sigma[0]);
    TEST_ASSERT_FLOAT_WITHIN(1e-5f, 0.2f - 0.1f * 16.0f / 41.0f, smoothed[1]);
}

static void test_rest_at_both_ends_takes_a_constant_error_out(void) {
    const uint16_t steps = 50;
    nothing_known(steps);
    config.start_sigma_m_s = 1e-5f;
    config.accel_noise_m_s15 = 1e-5f;
    config.tilt_walk_m_s25 = 1e-7f;
    config.error_sigma_m_s2 = 0.1f;
    config.drift_sigma_m_s3 = 1e-5f;
    float u = 0.0f;
    for (uint16_t k = 0; k < steps; k++) {
        const float next = k < 40 ? 0.08f : 0.0f;
        evidence[k].rise_m_s = next - u + 0.05f * (k == 0 ? 0.5f : 1.0f);
        if (k >= 42) {
            evidence[k].speed_m_s = 0.0f;
            evidence[k].sigma_m_s = 1e-5f;
        }
        u = next;
    }
    run(steps);
    TEST_ASSERT_TRUE(filtered[39] > 1.9f);
    for (uint16_t k = 0; k < 40; k++) {
        TEST_ASSERT_FLOAT_WITHIN(2e-4f, 0.08f, smoothed[k]);
    }
}

static void test_equals_the_slow_way(void) {
    const problem_t problems[] = {
        {1.0, 0.0, false, 10}, {1.0, 0.9, false, 0}, {0.0, 0.9, false, 0}, {0.8, 0.5, false, 4},
        {1.0, 1.0, true, 0},   {1.0, 1.0, true, 6},  {0.0, 1.0, true, 0},  {0.7, 0.6, true, 3},
    };
    for (unsigned i = 0; i < TIMES(24u, 8u); i++) {
        config.beat_s = (float)between(0.5, 2.0);
        draw(20, problems[i % 8u]);
        compare(20, 1e-3);
    }
}

static void test_lengths_around_the_block(void) {
    const uint16_t lengths[] = {1, 2, 15, 16, 17, 31, 32, 33, 48, 49};
    for (unsigned i = 0; i < 10; i++) {
        draw(lengths[i], (problem_t){0.9, 0.3, false, lengths[i] / 4});
        compare(lengths[i], 1e-3);
    }
}

static void test_a_long_swim_equals_the_slow_way(void) {
    draw(REFERENCE_STEPS, (problem_t){1.0, 0.15, false, 10});
    compare(REFERENCE_STEPS, 2e-3);
}

/* Nothing is known of speed or tilt at first, and for long; then everything is. */
static void test_wide_priors(void) {
    config.start_sigma_m_s = 0.1f;
    config.error_sigma_m_s2 = 0.1f;
    config.drift_sigma_m_s3 = 3.5e-3f;
    draw(40, (problem_t){1.0, 1.0, false, 0});
    for (uint16_t k = 0; k < 10; k++) {
        evidence[k].speed_m_s = NAN;
    }
    compare(40, 5e-3);
    for (uint16_t k = 15; k < 40; k++) {
        TEST_ASSERT_TRUE(smoothed_sigma[k] < 0.002f);
    }
}

static void test_rewinding_equals_never_having_taken_it(void) {
    draw(60, (problem_t){0.9, 0.5, false, 12});
    static float first[STEPS_MAX], first_sigma[STEPS_MAX];
    run(60);
    memcpy(first, smoothed, sizeof first);
    memcpy(first_sigma, smoothed_sigma, sizeof first_sigma);
    const uint16_t places[] = {0, 1, 15, 16, 17, 40, 50, 59, 60};
    for (unsigned i = 0; i < 9; i++) {
        static smoother_evidence_t right[STEPS_MAX];
        memcpy(right, evidence, sizeof right);
        for (uint16_t k = places[i]; k < 60; k++) {
            evidence[k].speed_m_s = 0.3f;
            evidence[k].sigma_m_s = 0.001f;
            evidence[k].rise_m_s = 0.1f;
        }
        smoother_init(&smoother, &config);
        run_forward(0, 60);
        memcpy(evidence, right, sizeof right);
        smoother_rewind(&smoother, places[i]);
        TEST_ASSERT_EQUAL_UINT16(places[i] == 60 ? 60 : places[i] / 16u * 16u, smoother.steps);
        run_forward(smoother.steps, 60);
        run_back(60);
        TEST_ASSERT_EQUAL_MEMORY(first, smoothed, 60 * sizeof(float));
        TEST_ASSERT_EQUAL_MEMORY(first_sigma, smoothed_sigma, 60 * sizeof(float));
    }
}

static void test_nothing_known_at_all(void) {
    nothing_known(SMOOTHER_STEPS);
    run(SMOOTHER_STEPS);
    for (uint16_t k = 0; k < SMOOTHER_STEPS; k++) {
        TEST_ASSERT_EQUAL_FLOAT(0.0f, smoothed[k]);
        TEST_ASSERT_FLOAT_WITHIN(1e-3f * smoothed_sigma[k], 0.1f * sqrtf((float)k + 1.0f),
                                 smoothed_sigma[k]);
    }
}

static void test_no_steps(void) {
    smoother_init(&smoother, &config);
    run_back(0);
}

/* Sigmas from nothing to anything: never negative, never NaN, never better than the way back can
 * tell. */
static void test_variances_stay_positive(void) {
    for (unsigned i = 0; i < TIMES(40u, 10u); i++) {
        config.start_sigma_m_s = (float)pow(10, between(-6, 1));
        config.error_sigma_m_s2 = i % 5u == 0 ? 0.0f : (float)pow(10, between(-6, 0));
        config.drift_sigma_m_s3 = i % 7u == 0 ? 0.0f : (float)pow(10, between(-8, -1));
        config.accel_noise_m_s15 = (float)pow(10, between(-6, -1));
        config.tilt_walk_m_s25 = (float)pow(10, between(-8, -2));
        config.model_sigma = i % 6u == 0 ? 0.0f : (float)pow(10, between(-3, 1));
        const uint16_t steps = (uint16_t)between(1, SMOOTHER_STEPS);
        draw(steps, (problem_t){uniform(), uniform(), i % 2u == 0, (uint16_t)(steps / 8u)});
        run(steps);
        for (uint16_t k = 0; k < steps; k++) {
            TEST_ASSERT_TRUE(isfinite(filtered[k]) && isfinite(smoothed[k]));
            TEST_ASSERT_TRUE(filtered_sigma[k] > 0.0f && isfinite(filtered_sigma[k]));
            TEST_ASSERT_TRUE(smoothed_sigma[k] > 0.0f && isfinite(smoothed_sigma[k]));
            TEST_ASSERT_TRUE(smoothed_sigma[k] <= filtered_sigma[k] * 1.01f);
        }
    }
}

/* Mean of ((estimate - truth) / sigma)^2 over many swims drawn from the model itself. */
static double inconsistency(problem_t problem) {
    double sum = 0;
    for (unsigned i = 0; i < SWIMS; i++) {
        draw(60, problem);
        run(60);
        for (uint16_t k = 4; k < 48; k = (uint16_t)(k + 11u)) {
            sum += square(((double)smoothed[k] - true_speed[k]) / (double)smoothed_sigma[k]) / 4;
        }
    }
    return sum / SWIMS;
}

static void test_sigma_is_what_it_says(void) {
    TEST_ASSERT_DOUBLE_WITHIN(0.1, 1.0, inconsistency((problem_t){1.0, 0.3, false, 8}));
    TEST_ASSERT_DOUBLE_WITHIN(0.1, 1.0, inconsistency((problem_t){0.5, 0.9, false, 0}));
    TEST_ASSERT_DOUBLE_WITHIN(0.2, 1.0, inconsistency((problem_t){1.0, 0.0, false, 8}));
}

/* One of the two is wrong: the evidence is left out, nobody's speed is told, all else is as if it
 * had not been there. */
static void test_evidence_that_contradicts_a_rise_is_refused(void) {
    config.gate = 25.0f;
    for (uint16_t k = 0; k < 40; k++) {
        evidence[k] = (smoother_evidence_t){.rise_m_s = 0, .speed_m_s = 0, .sigma_m_s = 0.001f};
    }
    evidence[20].speed_m_s = 0.004f; /* 4 sigma */
    evidence[25].speed_m_s = 0.08f;
    smoother_init(&smoother, &config);
    run_forward(0, 40);
    TEST_ASSERT_EQUAL_UINT16(1, smoother.refused);
    TEST_ASSERT_EQUAL_UINT16(39, smoother.believed);
    run_back(40);
    float with[40];
    memcpy(with, smoothed, sizeof with);
    for (uint16_t k = 0; k < 40; k++) {
        TEST_ASSERT_EQUAL(k == 25, isinf(smoothed_sigma[k]));
    }
    evidence[25].speed_m_s = NAN;
    smoother_init(&smoother, &config);
    run_forward(0, 40);
    run_back(40);
    TEST_ASSERT_EQUAL_MEMORY(with, smoothed, sizeof with);
    TEST_ASSERT_FALSE(isinf(smoothed_sigma[25]));
}

static void test_without_a_rise_nothing_is_contradicted(void) {
    config.gate = 25.0f;
    for (uint16_t k = 0; k < 40; k++) {
        evidence[k] = (smoother_evidence_t){NAN, k % 2u ? 0.1f : -0.1f, 0.001f, false};
    }
    smoother_init(&smoother, &config);
    run_forward(0, 40);
    TEST_ASSERT_EQUAL_UINT16(0, smoother.refused);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_one_vision_beat_by_hand);
    RUN_TEST(test_two_vision_beats_by_hand);
    RUN_TEST(test_rest_at_both_ends_takes_a_constant_error_out);
    RUN_TEST(test_equals_the_slow_way);
    RUN_TEST(test_lengths_around_the_block);
    RUN_ON_HOST(test_a_long_swim_equals_the_slow_way);
    RUN_TEST(test_wide_priors);
    RUN_TEST(test_rewinding_equals_never_having_taken_it);
    RUN_TEST(test_nothing_known_at_all);
    RUN_TEST(test_no_steps);
    RUN_TEST(test_variances_stay_positive);
    RUN_TEST(test_evidence_that_contradicts_a_rise_is_refused);
    RUN_TEST(test_without_a_rise_nothing_is_contradicted);
    RUN_ON_HOST(test_sigma_is_what_it_says);
    return UNITY_END();
}
