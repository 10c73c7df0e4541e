#include "config_valid.h"
#include "test_sim_app.h"
#include "unity.h"
#include "world.h"

#include <stddef.h>
#include <stdlib.h>

#define BEATS 6u
#define FRAMES (BEATS * 50u)

static const double cruise[BEATS] = {0.5, 0.7, 0.3, 0.78, 0.6, 0.5};

void setUp(void) {}
void tearDown(void) {}

static sim_config_t tank(void) {
    sim_config_t c;
    sim_config_default(&c, SIM_PLANT_TANK);
    return c;
}

static uint16_t pulse(unsigned frame) {
    const double angle = cruise[frame / 50] * sin(TEST_TWO_PI * (frame % 50) / 50);
    return (uint16_t)lround(3 * (1500 + 572.9578 * angle));
}

/* Frames without pulses up to |until_us|. */
static void rest(world_t *world, uint64_t until_us) {
    while (world_time_us(world) + WORLD_FRAME_US <= until_us) {
        world_frame(world, world_time_us(world) + WORLD_FRAME_US, 0);
    }
}

static void swim(world_t *world, unsigned frames) {
    for (unsigned frame = 0; frame <= frames; frame++) {
        const uint16_t next = frame < frames ? pulse(frame) : 0;
        world_frame(world, world_time_us(world) + WORLD_FRAME_US, next);
    }
}

static void sim_swim(const sim_config_t *c, double beats[BEATS], double speeds[FRAMES / 2]) {
    script_reset(cruise, BEATS, 25);
    sim_t *sim = sim_new(c);
    sim_run(sim, 12000000, -1, false);
    TEST_ASSERT_EQUAL(BEATS, sim_true_beats(sim, beats, BEATS));
    TEST_ASSERT_EQUAL(FRAMES / 2, sim_true_speeds_25hz(sim, speeds, FRAMES / 2));
    sim_free(sim);
}

/* Another board that gives the same pulses at another time moves the fish by the same bits. */
static void test_pulses_alone_decide_how_the_fish_swims(void) {
    const sim_config_t c = tank();
    double expected[BEATS], beats[BEATS], expected_speed[FRAMES / 2], speed[FRAMES / 2];
    sim_swim(&c, expected, expected_speed);
    world_t *world = world_new(&c);
    rest(world, 3000000);
    world_frame(world, 3001234, 0);
    swim(world, FRAMES);
    TEST_ASSERT_EQUAL(BEATS, world_true_beats(world, beats, BEATS));
    TEST_ASSERT_EQUAL(FRAMES / 2, world_true_speeds_25hz(world, speed, FRAMES / 2));
    TEST_ASSERT_EQUAL_MEMORY(expected, beats, sizeof beats);
    TEST_ASSERT_EQUAL_MEMORY(expected_speed, speed, sizeof speed);
    TEST_ASSERT_EQUAL(1, world_truth(world).swims);
    TEST_ASSERT_FALSE(world_truth(world).swimming);
    world_free(world);
}

static void test_a_pulse_lasts_for_the_frame_it_begins(void) {
    const sim_config_t c = tank();
    world_t *world = world_new(&c);
    rest(world, 1000000);
    world_frame(world, 1020000, 4500);
    TEST_ASSERT_TRUE(world_truth(world).swimming);
    TEST_ASSERT_EQUAL(4500, world_truth(world).pulse_ticks);
    TEST_ASSERT_EQUAL(0, world_true_speeds_25hz(world, NULL, 0));
    world_frame(world, 1040000, 0);
    TEST_ASSERT_FALSE(world_truth(world).swimming);
    TEST_ASSERT_EQUAL(1, world_true_speeds_25hz(world, NULL, 0));
    world_free(world);
}

static void test_swim_number_keys_the_noise(void) {
    const sim_config_t c = tank();
    double first[BEATS], second[BEATS], again[BEATS];
    world_t *world = world_new(&c);
    rest(world, 1000000);
    swim(world, FRAMES);
    world_true_beats(world, first, BEATS);
    rest(world, world_time_us(world) + 1000000);
    swim(world, FRAMES);
    world_true_beats(world, second, BEATS);
    world_set_swim(world, 1);
    rest(world, world_time_us(world) + 1000000);
    swim(world, FRAMES);
    world_true_beats(world, again, BEATS);
    TEST_ASSERT_TRUE(first[3] != second[3]);
    TEST_ASSERT_EQUAL_MEMORY(first, again, sizeof first);
    world_free(world);
}

/* By its own clock, which is 12 ppm fast, it starts 0.2 s after its supply is up. */
static void test_imu_has_the_power_of_the_board(void) {
    const sim_config_t c = tank();
    uint8_t message[WORLD_IMU_MESSAGE_MAX];
    world_t *world = world_new(&c);
    TEST_ASSERT_TRUE(world_imu_due_us(world) == UINT64_MAX);
    rest(world, 1000000);
    world_imu_power_on(world, 1000000);
    TEST_ASSERT_EQUAL_UINT64(1260998, world_imu_due_us(world));
    rest(world, 1260000);
    TEST_ASSERT_EQUAL(122, world_imu_read(world, message));
    TEST_ASSERT_EQUAL_STRING_LEN("$VNYMR,", message, 7);
    TEST_ASSERT_EQUAL_UINT64(1285998, world_imu_due_us(world));
    world_imu_power_off(world);
    TEST_ASSERT_TRUE(world_imu_due_us(world) == UINT64_MAX);
    world_set_imu(world, 1260000, false);
    world_set_imu(world, 1260000, true);
    TEST_ASSERT_TRUE(world_imu_due_us(world) == UINT64_MAX);
    world_imu_power_on(world, 2000000);
    world_set_imu(world, 2100000, false);
    TEST_ASSERT_TRUE(world_imu_due_us(world) == UINT64_MAX);
    world_set_imu(world, 2500000, true);
    TEST_ASSERT_EQUAL_UINT64(2699998, world_imu_due_us(world));
    world_free(world);
}

/* 1 s after the last pulse the fish stands still within 0.3 s, where it is, until the next swim. */
static void test_somebody_catches_the_fish(void) {
    sim_config_t c = tank();
    world_t *world = world_new(&c);
    rest(world, 1000000);
    swim(world, FRAMES);
    const double end_s = world_truth(world).time_s;
    sim_truth_t before = world_truth(world);
    double fastest_change = 0;
    while (world_truth(world).time_s < end_s + 3) {
        rest(world, world_time_us(world) + WORLD_FRAME_US);
        const sim_truth_t now = world_truth(world);
        const double since = now.time_s - end_s;
        TEST_ASSERT_TRUE(now.x_m >= before.x_m && now.x_m - before.x_m < 0.003);
        TEST_ASSERT_TRUE(since > 0.999 || now.v_m_s > 0.03);
        TEST_ASSERT_TRUE(since < 1.301 || now.v_m_s == 0);
        fastest_change = fmax(fastest_change, before.v_m_s - now.v_m_s);
        before = now;
    }
    TEST_ASSERT_TRUE(fastest_change < 0.2 * 0.08);
    sim_camera_frame_t picture[64];
    size_t pictures = 0;
    for (size_t n; (n = world_camera_read(world, world_time_us(world), picture, 64)) > 0;) {
        pictures = n;
    }
    TEST_ASSERT_FLOAT_WITHIN(0.005, before.x_m, picture[pictures - 1].x_m);
    swim(world, 100);
    TEST_ASSERT_TRUE(world_truth(world).v_m_s > 0.02);
    world_free(world);
    c.caught_after_s = 0;
    world = world_new(&c);
    rest(world, 1000000);
    swim(world, FRAMES);
    rest(world, world_time_us(world) + 3000000);
    TEST_ASSERT_TRUE(world_truth(world).v_m_s > 0.01);
    world_free(world);
}

static void test_pictures_come_when_their_latency_is_over(void) {
    const sim_config_t c = tank();
    sim_camera_frame_t picture[4];
    world_t *world = world_new(&c);
    rest(world, 20000);
    TEST_ASSERT_EQUAL_UINT64(13200 + 80000, world_camera_due_us(world));
    TEST_ASSERT_EQUAL(0, world_camera_read(world, 93199, picture, 4));
    rest(world, 100000);
    TEST_ASSERT_EQUAL(1, world_camera_read(world, 93200, picture, 4));
    TEST_ASSERT_EQUAL_DOUBLE(0.0132, picture[0].time_s);
    world_set_camera(world, false);
    rest(world, 1000000);
    TEST_ASSERT_EQUAL(2, world_camera_read(world, 1000000, picture, 4));
    world_free(world);
}

static void test_battery_sags_with_every_swim(void) {
    sim_config_t c = tank();
    c.battery_sag_v_per_trial = 0.25;
    world_t *world = world_new(&c);
    TEST_ASSERT_EQUAL_DOUBLE(8.2, world_battery_v(world));
    rest(world, 1000000);
    swim(world, 100);
    TEST_ASSERT_EQUAL_DOUBLE(7.95, world_battery_v(world));
    world_set_battery_v(world, 0.1);
    TEST_ASSERT_EQUAL_DOUBLE(0, world_battery_v(world));
    world_free(world);
}

static void test_values_that_make_no_sense(void) {
    sim_config_t c = tank();
    c.kappa_per_m = -1;
    TEST_ASSERT_FALSE(sim_config_valid(&c));
    TEST_ASSERT_NULL(world_new(&c));
    static const struct {
        size_t place;
        double value;
    } senseless[] = {
        {offsetof(sim_config_t, imu_firmware), 1},    {offsetof(sim_config_t, imu_port), 0},
        {offsetof(sim_config_t, imu_port), 3},        {offsetof(sim_config_t, imu_baud), 100000},
        {offsetof(sim_config_t, imu_baud), NAN},      {offsetof(sim_config_t, imu_baud), 0},
        {offsetof(sim_config_t, imu_bit_errors), 2},  {offsetof(sim_config_t, imu_lost_bytes), -1},
        {offsetof(sim_config_t, caught_after_s), -1}, {offsetof(sim_config_t, caught_after_s), 0.1},
    };
    for (size_t i = 0; i < sizeof senseless / sizeof senseless[0]; i++) {
        c = tank();
        TEST_ASSERT_TRUE(sim_config_valid(&c));
        memcpy((char *)&c + senseless[i].place, &senseless[i].value, sizeof(double));
        TEST_ASSERT_FALSE(sim_config_valid(&c));
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_pulses_alone_decide_how_the_fish_swims);
    RUN_TEST(test_a_pulse_lasts_for_the_frame_it_begins);
    RUN_TEST(test_swim_number_keys_the_noise);
    RUN_TEST(test_imu_has_the_power_of_the_board);
    RUN_TEST(test_somebody_catches_the_fish);
    RUN_TEST(test_pictures_come_when_their_latency_is_over);
    RUN_TEST(test_battery_sags_with_every_swim);
    RUN_TEST(test_values_that_make_no_sense);
    return UNITY_END();
}
