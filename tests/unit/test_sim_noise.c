#include "common/noise.h"
#include "unity.h"

#include <math.h>

#define SAMPLES 400000

void setUp(void) {}
void tearDown(void) {}

typedef struct {
    double mean, variance, skewness, kurtosis;
} moments_t;

static moments_t moments(uint64_t key) {
    double s[4] = {0};
    for (uint64_t i = 0; i < SAMPLES; i++) {
        const double x = noise_normal(key, i);
        s[0] += x;
        s[1] += x * x;
        s[2] += x * x * x;
        s[3] += x * x * x * x;
    }
    return (moments_t){s[0] / SAMPLES, s[1] / SAMPLES, s[2] / SAMPLES, s[3] / SAMPLES};
}

/* Bounds are about 4.5 sigma of the estimates. */
static void test_normal_moments(void) {
    for (uint64_t seed = 0; seed < 3; seed++) {
        const moments_t m = moments(noise_key(seed, NOISE_CAMERA, seed * 7));
        TEST_ASSERT_FLOAT_WITHIN(0.0072, 0, m.mean);
        TEST_ASSERT_FLOAT_WITHIN(0.0105, 1, m.variance);
        TEST_ASSERT_FLOAT_WITHIN(0.03, 0, m.skewness);
        TEST_ASSERT_FLOAT_WITHIN(0.075, 2.97, m.kurtosis);
    }
}

/* Share within k sigma, against the error function. */
static void test_normal_shape(void) {
    const uint64_t key = noise_key(5, NOISE_IMU, 1);
    static const double edge[6] = {0.25, 0.5, 1, 2, 3, 4};
    double inside[6] = {0};
    for (uint64_t i = 0; i < SAMPLES; i++) {
        const double x = fabs(noise_normal(key, i));
        for (int k = 0; k < 6; k++) {
            inside[k] += x < edge[k];
        }
    }
    for (int k = 0; k < 6; k++) {
        TEST_ASSERT_FLOAT_WITHIN(0.0045, erf(edge[k] / sqrt(2)), inside[k] / SAMPLES);
    }
    TEST_ASSERT_TRUE(inside[5] < SAMPLES);
}

/* Neighbours in every coordinate of the key. */
static void test_independence(void) {
    double along = 0, seeds = 0, streams = 0, trials = 0, squares = 0;
    for (uint64_t i = 0; i < SAMPLES; i++) {
        const uint64_t key = noise_key(1, NOISE_CAMERA, 1);
        const double x = noise_normal(key, i);
        const double y = noise_normal(key, i + 1);
        along += x * y;
        squares += (x * x - 1) * (y * y - 1);
        seeds += x * noise_normal(noise_key(2, NOISE_CAMERA, 1), i);
        streams += x * noise_normal(noise_key(1, NOISE_LOST, 1), i);
        trials += x * noise_normal(noise_key(1, NOISE_CAMERA, 2), i);
    }
    TEST_ASSERT_FLOAT_WITHIN(0.0072, 0, along / SAMPLES);
    TEST_ASSERT_FLOAT_WITHIN(0.0145, 0, squares / SAMPLES);
    TEST_ASSERT_FLOAT_WITHIN(0.0072, 0, seeds / SAMPLES);
    TEST_ASSERT_FLOAT_WITHIN(0.0072, 0, streams / SAMPLES);
    TEST_ASSERT_FLOAT_WITHIN(0.0072, 0, trials / SAMPLES);
}

/* Sample 0 of consecutive trials is what the per-trial disturbances are made of. */
static void test_first_samples_of_trials(void) {
    double sum = 0, square = 0, product = 0, last = 0;
    for (uint64_t trial = 0; trial < 100000; trial++) {
        const double x = noise_normal(noise_key(1, NOISE_GAIN, trial), 0);
        sum += x;
        square += x * x;
        product += x * last;
        last = x;
    }
    TEST_ASSERT_FLOAT_WITHIN(0.0145, 0, sum / 1e5);
    TEST_ASSERT_FLOAT_WITHIN(0.0205, 1, square / 1e5);
    TEST_ASSERT_FLOAT_WITHIN(0.0145, 0, product / 1e5);
}

static void test_uniform(void) {
    const uint64_t key = noise_key(9, NOISE_LOST, 4);
    unsigned bins[16] = {0};
    for (uint64_t i = 0; i < SAMPLES; i++) {
        const double x = noise_uniform(key, i);
        TEST_ASSERT_TRUE(x >= 0 && x < 1);
        bins[(unsigned)(x * 16)]++;
    }
    double chi2 = 0;
    for (int k = 0; k < 16; k++) {
        const double d = bins[k] - SAMPLES / 16.0;
        chi2 += d * d / (SAMPLES / 16.0);
    }
    TEST_ASSERT_TRUE(chi2 < 45); /* 15 degrees of freedom: p = 1e-4 */
}

static void test_order_does_not_matter(void) {
    const uint64_t key = noise_key(3, NOISE_CAMERA, 8);
    const double x = noise_normal(key, 1000);
    noise_normal(key, 1);
    TEST_ASSERT_TRUE(x == noise_normal(noise_key(3, NOISE_CAMERA, 8), 1000));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_normal_moments);
    RUN_TEST(test_normal_shape);
    RUN_TEST(test_independence);
    RUN_TEST(test_first_samples_of_trials);
    RUN_TEST(test_uniform);
    RUN_TEST(test_order_does_not_matter);
    return UNITY_END();
}
