/* Speed by the IMU alone with a sensor and hands that are not perfect: whether the sigma of a beat
 * still says how far off it is. bench/imu_coverage.py does it with more and fresh seeds. */
#include "held_swims.h"

#include "unity.h"

#define SWIMS 12u
#define FIRST_SEED 9000u

void setUp(void) {}
void tearDown(void) {}

static void check(const level_t *level) {
    static swim_t swim;
    unsigned within = 0, measured = 0;
    double squares = 0, variance = 0;
    for (uint64_t seed = FIRST_SEED; seed < FIRST_SEED + SWIMS; seed++) {
        /* both plants in turn */
        swim_once(&swim, seed, seed % 2u ? SIM_PLANT_REACTIVE : SIM_PLANT_TANK, level);
        for (unsigned k = 0; k < BEATS; k++) {
            if (!swim.beat[k].measured) {
                continue;
            }
            const double error = (double)swim.beat[k].speed_m_s - swim.true_m_s[k];
            const double sigma = (double)swim.beat[k].sigma_m_s;
            measured++;
            within += fabs(error) <= 2 * sigma;
            squares += error * error;
            variance += sigma * sigma;
        }
    }
    TEST_ASSERT_TRUE(measured > 0);
    const double rms = 1e3 * sqrt(squares / measured);
    const double sigma = 1e3 * sqrt(variance / measured);
    printf("%s: seeds %u to %u, rms %.2f mm/s, sigma %.2f, in 2 sigma %.1f %%, measured %u\n",
           level->name, FIRST_SEED, FIRST_SEED + SWIMS - 1u, rms, sigma, 100.0 * within / measured,
           measured);
    TEST_ASSERT_TRUE(measured >= 0.9 * BEATS * SWIMS);
    TEST_ASSERT_TRUE(within >= 0.85 * measured);
    TEST_ASSERT_TRUE(sigma <= 2 * rms);
}

static void test_data_sheet(void) { check(&levels[0]); }
static void test_mild(void) { check(&levels[1]); }
static void test_stress(void) { check(&levels[2]); }
static void test_stress_with_a_large_bias(void) { check(&levels[3]); }

static void test_stress_with_recorded_noise(void) {
    if (!load_noise()) {
        TEST_IGNORE_MESSAGE("no " RECORDED "; name its folder in TAILBEAT_RECORDINGS");
    }
    check(&recorded_stress);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_data_sheet);
    RUN_TEST(test_mild);
    RUN_TEST(test_stress);
    RUN_TEST(test_stress_with_a_large_bias);
    RUN_TEST(test_stress_with_recorded_noise); /* the last one: the noise stays */
    return UNITY_END();
}
