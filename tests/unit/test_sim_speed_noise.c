/* How good and how honest the estimate is over many synthetic swims, with the noise that was
 * recorded of a real sensor too. A program for the host: it takes much double arithmetic. */
#include "speed_swims.h"

#include <stdio.h>

#define SWIMS 100u

/* Noise of a real VN-100's forward axis at rest, in mg: white, a random walk, and slow drift in
 * lines between independent values. Together they have the Allan deviations measured: 0.20 at 1 s,
 * 0.07 at 10 s, 0.06 at 20 s, 0.16 at 100 s. That was at 40 Hz with averaging over 4 of 20 samples;
 * over all 20 the white part is the root of 5 less. */
#define REAL_HZ 40u
#define RECORDED_WHITE_MG 0.20 /* at 1 s */
#define AVERAGED_WHITE_MG (RECORDED_WHITE_MG / 2.236)
#define REAL_WALK_MG 0.012 /* per root s */
#define REAL_DRIFT_MG 0.35
#define REAL_DRIFT_S 200u
#define MG 9.80665e-3

typedef struct {
    unsigned count;
    double walk, from, to;
} real_noise_t;

static double real_noise_mg(real_noise_t *n, double white_mg) {
    const unsigned apart = REAL_DRIFT_S * REAL_HZ;
    const unsigned first = n->count == 0 ? (unsigned)(uniform() * apart) : n->count;
    if (n->count == 0 || first % apart == 0) {
        n->from = n->count == 0 ? REAL_DRIFT_MG * normal() : n->to;
        n->to = REAL_DRIFT_MG * normal();
    }
    n->count = first + 1u;
    n->walk += REAL_WALK_MG / sqrt(REAL_HZ) * normal();
    return n->from + (n->to - n->from) * (first % apart) / apart + n->walk +
           white_mg * sqrt(REAL_HZ) * normal();
}

/* Pitch at the end of the swim, beyond what the gyroscopes saw: all at once at its begin, or evenly
 * growing. */
static struct {
    double white_mg, pitch_deg;
    bool at_once;
} real;

/* Levelled by the mean over the rest before. */
static void make_real_errors(void) {
    real_noise_t noise = {0};
    double level_mg = 0;
    for (unsigned i = 0; i < (unsigned)REST_S * REAL_HZ; i++) {
        level_mg += real_noise_mg(&noise, real.white_mg) / (REST_S * REAL_HZ);
    }
    for (unsigned i = 0; i <= SLOTS; i++) {
        const double part = real.at_once || 0.1 * i > 40 ? 1 : 0.1 * i / 40;
        double sum_mg = 0;
        for (unsigned j = 0; j < REAL_HZ / SLOTS_PER_BEAT; j++) {
            sum_mg += real_noise_mg(&noise, real.white_mg);
        }
        error_m_s2[i] = (sum_mg / (REAL_HZ / SLOTS_PER_BEAT) - level_mg) * MG +
                        part * sin(real.pitch_deg * 3.14159265 / 180) * 9.80665;
    }
}

void setUp(void) { set_up_swims(); }

void tearDown(void) {}

static void test_vision_with_imu(void) {
    const figures_t f =
        study(SWIMS, make_imu_errors, (senses_t){.imu = true, .camera = true}, 1.0, 0, BEATS);
    TEST_ASSERT_EQUAL_UINT(0, f.unmeasured);
    TEST_ASSERT_TRUE(f.rms_m_s < 0.0010); /* the camera alone has 1.0 mm/s */
    check_honest(&f);
}

static void test_the_imu_carries_over_a_hole(void) {
    const senses_t senses = {.imu = true, .camera = true, .dark_from_s = 20, .dark_to_s = 22};
    const figures_t whole = study(SWIMS, make_imu_errors, senses, 1.0, 5, 19);
    const figures_t hole = study(SWIMS, make_imu_errors, senses, 1.0, 20, 22);
    TEST_ASSERT_EQUAL_UINT(0, hole.unmeasured);
    TEST_ASSERT_TRUE(hole.sigma_m_s > 1.2 * whole.sigma_m_s);
    TEST_ASSERT_TRUE(hole.rms_m_s < 0.002);
    check_honest(&hole);
}

static void test_imu_between_two_rests(void) {
    config.source = SPEED_SOURCE_IMU;
    const figures_t f = study(SWIMS, make_imu_errors, (senses_t){.imu = true}, 1.0, 0, BEATS);
    TEST_ASSERT_EQUAL_UINT(0, f.unmeasured);
    TEST_ASSERT_TRUE(f.mean_rms_m_s < 0.010);
    check_honest(&f);
}

static void test_the_real_noise_is_like_the_recorded(void) {
    const unsigned averaged[] = {1, 10, 20, 100};
    const double recorded_mg[] = {0.20, 0.07, 0.06, 0.16};
    for (unsigned i = 0; i < 4; i++) {
        real_noise_t noise = {0};
        double last_mg = 0, sum = 0;
        const unsigned pairs = 20000 / averaged[i];
        for (unsigned k = 0; k <= pairs; k++) {
            double mean_mg = 0;
            for (unsigned j = 0; j < averaged[i] * REAL_HZ; j++) {
                mean_mg += real_noise_mg(&noise, RECORDED_WHITE_MG) / (averaged[i] * REAL_HZ);
            }
            sum += k > 0 ? square(mean_mg - last_mg) / 2 / pairs : 0;
            last_mg = mean_mg;
        }
        printf("Allan deviation at %u s: %.3f mg\n", averaged[i], sqrt(sum));
        TEST_ASSERT_TRUE(sqrt(sum) > 0.8 * recorded_mg[i] && sqrt(sum) < 1.25 * recorded_mg[i]);
    }
}

static figures_t study_real(const char *name, double white_mg, double pitch_deg, bool at_once) {
    config.source = SPEED_SOURCE_IMU;
    config.sigma_max_m_s = 1.0f;
    real.white_mg = white_mg;
    real.pitch_deg = pitch_deg;
    real.at_once = at_once;
    const figures_t f = study(SWIMS, make_real_errors, (senses_t){.imu = true}, 1.0, 0, BEATS);
    printf("%-40s swim means rms %6.1f mm/s, beats rms %6.1f mm/s, mean sigma %5.1f mm/s, "
           "refused %u of %u\n",
           name, 1e3 * f.mean_rms_m_s, 1e3 * f.rms_m_s, 1e3 * f.sigma_m_s, f.unmeasured / BEATS,
           SWIMS);
    return f;
}

/* On a resting sensor with this noise, rests and a straight line were found to leave 3.5 to 7.6
 * mm/s. */
static void test_real_noise_between_two_rests(void) {
    const figures_t recorded = study_real("noise as recorded", RECORDED_WHITE_MG, 0, false);
    TEST_ASSERT_TRUE(recorded.mean_rms_m_s <= 0.0076);
    TEST_ASSERT_TRUE(recorded.within_2_sigma >= 0.9);
    const figures_t averaged =
        study_real("averaged as the driver asks", AVERAGED_WHITE_MG, 0, false);
    TEST_ASSERT_TRUE(averaged.mean_rms_m_s <= 0.0050);
    TEST_ASSERT_TRUE(averaged.within_2_sigma >= 0.9);
}

/* The rest at the end tells it: sigma knows nothing of it. */
static void test_pitch_that_was_not_followed_is_refused(void) {
    const figures_t growing =
        study_real("0.5 deg of pitch, growing", AVERAGED_WHITE_MG, 0.5, false);
    const figures_t sudden = study_real("0.5 deg of pitch at once", AVERAGED_WHITE_MG, 0.5, true);
    TEST_ASSERT_TRUE(growing.unmeasured >= 0.95 * SWIMS * BEATS);
    TEST_ASSERT_EQUAL_UINT(SWIMS * BEATS, sudden.unmeasured);
    const figures_t little =
        study_real("0.05 deg of pitch, growing", AVERAGED_WHITE_MG, 0.05, false);
    TEST_ASSERT_EQUAL_UINT(0, little.unmeasured);
    TEST_ASSERT_TRUE(little.within_2_sigma >= 0.9);
}

static void test_model_learns_its_error_from_the_imu(void) {
    config.source = SPEED_SOURCE_MODEL;
    const figures_t f = study(SWIMS, make_imu_errors, (senses_t){.imu = true}, 0.8, 0, BEATS);
    TEST_ASSERT_EQUAL_UINT(0, f.unmeasured);
    TEST_ASSERT_TRUE(f.rms_m_s < 0.010);
    TEST_ASSERT_TRUE(f.within_2_sigma >= 0.9);
}

static void test_model_without_rests_or_imu(void) {
    config.source = SPEED_SOURCE_MODEL;
    config.sigma_max_m_s = 0.1f;
    before = none;
    for (unsigned imu = 0; imu < 2; imu++) {
        const figures_t f =
            study(SWIMS, make_imu_errors, (senses_t){.imu = imu != 0}, 0.9, 0, BEATS);
        TEST_ASSERT_EQUAL_UINT(0, f.unmeasured);
        TEST_ASSERT_TRUE(f.within_2_sigma >= 0.9);
        TEST_ASSERT_TRUE(f.rms_m_s < 0.010);
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_vision_with_imu);
    RUN_TEST(test_the_imu_carries_over_a_hole);
    RUN_TEST(test_imu_between_two_rests);
    RUN_TEST(test_the_real_noise_is_like_the_recorded);
    RUN_TEST(test_real_noise_between_two_rests);
    RUN_TEST(test_pitch_that_was_not_followed_is_refused);
    RUN_TEST(test_model_learns_its_error_from_the_imu);
    RUN_TEST(test_model_without_rests_or_imu);
    return UNITY_END();
}
