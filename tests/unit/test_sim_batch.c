#include "batch/batch.h"
#include "batch/batch_lanes.h"
#include "common/noise.h"
#include "fish/plant_beats.h"
#include "test_sim_app.h"
#include "unity.h"

#include <pthread.h>

#define FISH 70u
#define BEATS 12u

static sim_config_t configs[FISH];
static uint32_t swims[FISH];
static double amplitude[FISH * BEATS], true_m_s[FISH * BEATS], speed[FISH * BEATS],
    sigma[FISH * BEATS];
static uint64_t draws;

void setUp(void) { draws = 0; }
void tearDown(void) {}

static double between(double low, double high) {
    return low + (high - low) * noise_uniform(4711, draws++);
}

static bool chance(double p) { return between(0, 1) < p; }

static sim_config_t any_fish(void) {
    sim_config_t c;
    sim_config_default(&c, SIM_PLANT_TANK);
    c.seed = draws;
    c.kappa_per_m = between(2, 30);
    c.delay_s = chance(0.1) ? 0 : between(0, 0.7);
    c.slope_m_s_rad = between(0.15, 0.3);
    c.dead_zone_rad = between(0, 0.3);
    c.map_bend_m_s_rad2 = chance(0.5) ? 0 : between(-0.3, 0.3);
    c.servo_lag_s = chance(0.2) ? 0 : between(0.01, 0.1);
    c.servo_rate_rad_s = chance(0.2) ? 0 : between(2, 6);
    c.camera_lost = chance(0.3) ? between(0, 0.4) : 0;
    return c;
}

static void be_quiet(sim_config_t *c) {
    c->gain_sigma = c->flow_sigma_m_s = c->start_sigma_m_s = c->camera_noise_m = 0;
    c->place_sigma_rad = c->flow_moves_m_s = c->standing_wave_m_s = 0;
}

static void any_batch(void) {
    for (size_t i = 0; i < FISH; i++) {
        configs[i] = any_fish();
        configs[i].flow_moves_m_s = configs[i].standing_wave_m_s = i % 3 > 0 ? 0 : 0.01;
        swims[i] = (uint32_t)(1 + i % 3);
    }
    for (size_t i = 0; i < FISH * BEATS; i++) {
        amplitude[i] = chance(0.1) ? 0 : between(0, 0.78);
    }
}

/* Of such fish as most batches are of. */
static void usual_batch(void) {
    any_batch();
    for (size_t i = 0; i < FISH; i++) {
        sim_config_t *c = &configs[i];
        c->delay_s = 0.3;
        c->servo_lag_s = 0.04;
        c->map_bend_m_s_rad2 = c->camera_lost = c->flow_moves_m_s = c->standing_wave_m_s = 0;
    }
}

static void swim_all(double beat_s) {
    TEST_ASSERT_TRUE(
        batch_swim(configs, FISH, swims, amplitude, BEATS, beat_s, true_m_s, speed, sigma));
}

static void compare_quiet(double beat_s) {
    double alone[BEATS];
    swim_all(beat_s);
    for (size_t i = 0; i < FISH; i++) {
        TEST_ASSERT_TRUE(sim_plant_beats(&configs[i], amplitude + i * BEATS, BEATS, beat_s, alone));
        TEST_ASSERT_EQUAL_MEMORY(alone, true_m_s + i * BEATS, sizeof alone);
    }
}

static void test_without_disturbances_the_bits_are_the_plants(void) {
    static const double beats_s[] = {1, 1, 0.5, 1.02};
    for (size_t n = 0; n < 4; n++) {
        n == 0 ? usual_batch() : any_batch();
        for (size_t i = 0; i < FISH; i++) {
            be_quiet(&configs[i]);
        }
        compare_quiet(beats_s[n]);
    }
}

/* A drag for which the step's fraction does not hold, in between fish for which it does. */
static void test_a_step_beyond_the_fraction_has_the_plants_bits_too(void) {
    any_batch();
    for (size_t i = 0; i < FISH; i++) {
        be_quiet(&configs[i]);
        configs[i].kappa_per_m = i % 5 == 2 ? 400 : 10;
    }
    compare_quiet(1);
}

static void test_thesis_plant(void) {
    double alone[BEATS];
    any_batch();
    for (size_t i = 0; i < 3; i++) {
        sim_config_default(&configs[i], i == 1 ? SIM_PLANT_TANK : SIM_PLANT_THESIS);
        be_quiet(&configs[i]);
    }
    swim_all(1);
    for (size_t i = 0; i < 3; i++) {
        TEST_ASSERT_TRUE(sim_plant_beats(&configs[i], amplitude + i * BEATS, BEATS, 1, alone));
        for (size_t k = 0; k < BEATS; k++) {
            TEST_ASSERT_TRUE(fabs(alone[k] - true_m_s[i * BEATS + k]) < 1e-9);
            TEST_ASSERT_TRUE(fabs(speed[i * BEATS + k] - true_m_s[i * BEATS + k]) < 5e-3);
        }
    }
}

static void compare_sets(void) {
    static double t[FISH * BEATS], v[FISH * BEATS], s[FISH * BEATS];
    TEST_ASSERT_TRUE(batch_swim_on(batch_lanes(0), configs, FISH, swims, amplitude, BEATS, 1,
                                   true_m_s, speed, sigma));
    for (size_t i = 1; batch_lanes(i) != NULL; i++) {
        TEST_ASSERT_TRUE(
            batch_swim_on(batch_lanes(i), configs, FISH, swims, amplitude, BEATS, 1, t, v, s));
        TEST_ASSERT_EQUAL_MEMORY(true_m_s, t, sizeof t);
        for (size_t k = 0; k < FISH * BEATS; k++) {
            TEST_ASSERT_EQUAL(isnan(speed[k]), isnan(v[k]));
            TEST_ASSERT_TRUE(isnan(speed[k]) || (speed[k] == v[k] && sigma[k] == s[k]));
        }
    }
}

static void test_all_sets_of_instructions_give_the_same_bits(void) {
    usual_batch();
    compare_sets();
    any_batch();
    compare_sets();
}

static void compare_neighbours(void) {
    static const size_t counts[] = {1, 5, 31, 32, 33, 47, 70};
    double t[FISH * BEATS], v[FISH * BEATS], s[FISH * BEATS];
    configs[40].camera_fps = 30;
    configs[41].kappa_per_m = 500;
    swim_all(1);
    for (size_t n = 0; n < 7; n++) {
        const size_t first = FISH - counts[n], at = first * BEATS;
        TEST_ASSERT_TRUE(batch_swim(configs + first, counts[n], swims + first, amplitude + at,
                                    BEATS, 1, t, v, s));
        for (size_t k = 0; k < counts[n] * BEATS; k++) {
            TEST_ASSERT_TRUE(t[k] == true_m_s[at + k]);
            TEST_ASSERT_TRUE(v[k] == speed[at + k] || (isnan(v[k]) && isnan(speed[at + k])));
            TEST_ASSERT_TRUE(s[k] == sigma[at + k] || (isnan(s[k]) && isnan(sigma[at + k])));
        }
    }
}

static void test_no_fish_feels_its_neighbours(void) {
    usual_batch();
    compare_neighbours();
    any_batch();
    compare_neighbours();
}

/* With these the script's swim begins with a picture period, as the batch's does. */
#define SCRIPT_TICK 30u
#define BOOT_S 0.08
#define BEGIN_S 0.72
#define PICTURES_PER_BEAT 25u
#define PICTURES 512u

/* The slope of the line through a beat's pictures along the tank. */
static double line_m_s(const sim_camera_frame_t *pictures) {
    double st = 0, sx = 0, stt = 0, stx = 0;
    const double n = PICTURES_PER_BEAT + 1;
    for (unsigned i = 0; i <= PICTURES_PER_BEAT; i++) {
        const double t = pictures[i].time_s - pictures[0].time_s;
        st += t;
        stt += t * t;
        sx += pictures[i].x_m;
        stx += t * pictures[i].x_m;
    }
    return (n * stx - st * sx) / (n * stt - st * st);
}

static void compare_pictures(sim_t *sim, const double measured_m_s[BEATS]) {
    static sim_camera_frame_t pictures[PICTURES];
    const size_t taken = sim_camera_read(sim, pictures, PICTURES);
    size_t first = 0;
    while (first < taken && pictures[first].time_s < BEGIN_S) {
        first++;
    }
    TEST_ASSERT_TRUE(taken > first + BEATS * PICTURES_PER_BEAT);
    for (size_t k = 0; k < BEATS; k++) {
        const double whole = line_m_s(pictures + first + k * PICTURES_PER_BEAT);
        TEST_ASSERT_TRUE(fabs(whole - measured_m_s[k]) < 5e-5);
    }
}

/* The whole simulator, whose tail is told pulses of whole ticks of 0.58 mrad. */
static void test_disturbed_beats_are_the_whole_simulators(void) {
    any_batch();
    for (size_t i = 0; i < 4 * BEATS; i++) {
        amplitude[i] = between(0.2, 0.65);
    }
    for (size_t i = 0; i < 4; i++) {
        sim_config_default(&configs[i], SIM_PLANT_TANK);
        configs[i].seed = 77 + i;
        configs[i].imu_firmware = 0;
        configs[i].boot_s = BOOT_S;
        configs[i].flow_moves_m_s = configs[i].standing_wave_m_s = i < 2 ? 0 : 0.01;
        swims[i] = (uint32_t)(1 + 5 * i);
    }
    swim_all(1);
    for (size_t i = 0; i < 4; i++) {
        double whole[BEATS];
        script_reset(amplitude + i * BEATS, BEATS, SCRIPT_TICK);
        sim_t *sim = sim_new(&configs[i]);
        TEST_ASSERT_NOT_NULL(sim);
        world_set_swim(sim_world(sim), swims[i]);
        sim_run(sim, (BEATS + 2) * 1000000ull, -1, false);
        TEST_ASSERT_EQUAL(BEATS, sim_true_beats(sim, whole, BEATS));
        compare_pictures(sim, speed + i * BEATS);
        sim_free(sim);
        for (size_t k = 0; k < BEATS; k++) {
            TEST_ASSERT_TRUE(fabs(whole[k] - true_m_s[i * BEATS + k]) < 5e-5);
        }
    }
}

static uint64_t picture_key(size_t fish, noise_stream_t stream) {
    return noise_key(configs[fish].seed, stream, swims[fish]);
}

/* A line is linear in its points: what the noise adds to a speed follows from the draws alone. */
static void test_camera_noise_moves_the_line_as_its_draws_do(void) {
    static double quiet[FISH * BEATS];
    any_batch();
    for (size_t i = 0; i < FISH; i++) {
        configs[i].camera_noise_m = 0;
        configs[i].camera_lost = 0;
    }
    swim_all(1);
    memcpy(quiet, speed, sizeof quiet);
    for (size_t i = 0; i < FISH; i++) {
        configs[i].camera_noise_m = 0.003;
    }
    swim_all(1);
    for (size_t i = 0; i < FISH * BEATS; i++) {
        const uint64_t key = picture_key(i / BEATS, NOISE_CAMERA);
        double vtt = 0, vtx = 0;
        for (unsigned j = 0; j <= 25; j++) {
            const double t = (j - 12.5) / 25;
            vtt += t * t;
            vtx += t * 0.003 * noise_normal(key, 2 * (i % BEATS * 25 + j));
        }
        TEST_ASSERT_TRUE(fabs(speed[i] - quiet[i] - vtx / vtt) < 1e-7);
    }
}

static bool measurable(size_t fish, size_t beat) {
    const uint64_t key = picture_key(fish, NOISE_LOST);
    unsigned there = 0, gap = 0, longest = 0;
    for (unsigned j = 0; j <= 25; j++) {
        const bool lost = noise_uniform(key, beat * 25 + j) < configs[fish].camera_lost;
        there += lost ? 0 : 1;
        gap = lost ? gap + 1 : 0;
        longest = gap > longest ? gap : longest;
    }
    return there >= 16 && longest <= 5;
}

static void test_lost_pictures(void) {
    unsigned unmeasured = 0;
    any_batch();
    for (size_t i = 0; i < FISH; i++) {
        configs[i].camera_lost = 0.01 * (double)i;
    }
    swim_all(1);
    for (size_t i = 0; i < FISH * BEATS; i++) {
        const bool there = measurable(i / BEATS, i % BEATS);
        TEST_ASSERT_EQUAL(there, !isnan(speed[i]));
        TEST_ASSERT_EQUAL(there, !isnan(sigma[i]));
        TEST_ASSERT_TRUE(!there || fabs(speed[i] - true_m_s[i]) < 8 * sigma[i] + 5e-3);
        unmeasured += there ? 0 : 1;
    }
    TEST_ASSERT_TRUE(unmeasured > 100 && unmeasured < FISH * BEATS - 100);
}

/* Pictures and beats that are no multiples of each other, and too few of them; at cruise, where a
 * line and a mean are the same but for the ripple. */
static void test_other_cameras(void) {
    static const double fps[] = {24, 27.3, 50, 7, 1.4, 0};
    for (size_t n = 0; n < 6; n++) {
        any_batch();
        for (size_t i = 0; i < FISH; i++) {
            be_quiet(&configs[i]);
            configs[i].camera_fps = fps[n];
            configs[i].camera_lost = 0;
        }
        for (size_t i = 0; i < FISH * BEATS; i++) {
            amplitude[i] = 0.5;
        }
        swim_all(1.02);
        for (size_t i = 0; i < FISH * BEATS; i++) {
            TEST_ASSERT_EQUAL(fps[n] < 2, isnan(speed[i]));
            if (fps[n] > 2 && i % BEATS > 8) {
                TEST_ASSERT_TRUE(fabs(speed[i] - true_m_s[i]) < 2e-3);
            }
        }
    }
}

static void test_without_camera(void) {
    static double alone[FISH * BEATS];
    any_batch();
    swim_all(1);
    TEST_ASSERT_TRUE(batch_swim(configs, FISH, swims, amplitude, BEATS, 1, alone, NULL, NULL));
    TEST_ASSERT_EQUAL_MEMORY(true_m_s, alone, sizeof alone);
}

#define THREADS 3u
#define SMALL_STACK_BYTES ((size_t)128 * 1024) /* of a thread with musl */

static double by_thread[THREADS][FISH * BEATS];

static void *swim_in_thread(void *to) {
    const bool done = batch_swim(configs, FISH, swims, amplitude, BEATS, 1, to, speed, sigma);
    return done ? to : NULL;
}

static void *swim_blind_in_thread(void *to) {
    const bool done = batch_swim(configs, FISH, swims, amplitude, BEATS, 1, to, NULL, NULL);
    return done ? to : NULL;
}

/* With the longest delay there can be, and a fish that has to swim alone. */
static void test_threads_with_small_stacks(void) {
    pthread_attr_t small;
    pthread_t thread[THREADS];
    any_batch();
    configs[7].delay_s = 5;
    configs[9].kappa_per_m = 400;
    swim_all(1);
    TEST_ASSERT_EQUAL(0, pthread_attr_init(&small));
    TEST_ASSERT_EQUAL(0, pthread_attr_setstacksize(&small, SMALL_STACK_BYTES));
    for (size_t i = 0; i < THREADS; i++) {
        TEST_ASSERT_EQUAL(0, pthread_create(&thread[i], &small,
                                            i == 0 ? swim_in_thread : swim_blind_in_thread,
                                            by_thread[i]));
    }
    for (size_t i = 0; i < THREADS; i++) {
        void *result = NULL;
        TEST_ASSERT_EQUAL(0, pthread_join(thread[i], &result));
        TEST_ASSERT_EQUAL_PTR(by_thread[i], result);
        TEST_ASSERT_EQUAL_MEMORY(true_m_s, by_thread[i], sizeof true_m_s);
    }
    (void)pthread_attr_destroy(&small);
}

static void test_refuses_nonsense(void) {
    any_batch();
    const sim_config_t c = configs[3];
    TEST_ASSERT_TRUE(batch_swim(configs, 0, swims, amplitude, BEATS, 1, true_m_s, speed, sigma));
    TEST_ASSERT_FALSE(
        batch_swim(configs, 4, swims, amplitude, BEATS, 0.99, true_m_s, speed, sigma));
    TEST_ASSERT_FALSE(batch_swim(configs, 4, swims, amplitude, BEATS, 1, true_m_s, NULL, sigma));
    configs[3].kappa_per_m = -1;
    TEST_ASSERT_FALSE(batch_swim(configs, 4, swims, amplitude, BEATS, 1, true_m_s, speed, sigma));
    configs[3] = c;
    configs[3].map_bend_m_s_rad2 = NAN;
    TEST_ASSERT_FALSE(batch_swim(configs, 4, swims, amplitude, BEATS, 1, true_m_s, speed, sigma));
    configs[3] = c;
    amplitude[3 * BEATS] = NAN;
    TEST_ASSERT_FALSE(batch_swim(configs, 4, swims, amplitude, BEATS, 1, true_m_s, speed, sigma));
    TEST_ASSERT_TRUE(batch_swim(configs, 3, swims, amplitude, BEATS, 1, true_m_s, speed, sigma));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_without_disturbances_the_bits_are_the_plants);
    RUN_TEST(test_a_step_beyond_the_fraction_has_the_plants_bits_too);
    RUN_TEST(test_thesis_plant);
    RUN_TEST(test_all_sets_of_instructions_give_the_same_bits);
    RUN_TEST(test_no_fish_feels_its_neighbours);
    RUN_TEST(test_disturbed_beats_are_the_whole_simulators);
    RUN_TEST(test_camera_noise_moves_the_line_as_its_draws_do);
    RUN_TEST(test_lost_pictures);
    RUN_TEST(test_other_cameras);
    RUN_TEST(test_without_camera);
    RUN_TEST(test_threads_with_small_stacks);
    RUN_TEST(test_refuses_nonsense);
    return UNITY_END();
}
