#include "base/real.h"
#include "speed_swims.h"

void setUp(void) { set_up_swims(); }

void tearDown(void) {}

static void test_vision_alone_gives_what_the_camera_says(void) {
    swim(3, 1.0);
    make_imu_errors();
    before = none;
    live_through((senses_t){.camera = true});
    float seen[BEATS], seen_sigma[BEATS];
    memcpy(seen, speed_m_s, sizeof seen);
    memcpy(seen_sigma, sigma_m_s, sizeof seen_sigma);
    (void)finish(BEATS, &none);
    for (uint16_t k = 0; k < BEATS; k++) {
        const speed_beat_t beat = estimate_result(&estimate, k);
        TEST_ASSERT_TRUE(beat.measured && beat.samples >= 1);
        TEST_ASSERT_FLOAT_WITHIN(2e-5f, seen[k], beat.speed_m_s);
        TEST_ASSERT_FLOAT_WITHIN(1e-6f, seen_sigma[k], beat.sigma_m_s);
    }
}

static void test_a_hole_in_vision_alone_is_unmeasured(void) {
    swim(4, 1.0);
    make_imu_errors();
    live_through((senses_t){.camera = true, .dark_from_s = 20.0, .dark_to_s = 22.0});
    (void)finish(BEATS, &none);
    for (uint16_t k = 0; k < BEATS; k++) {
        TEST_ASSERT_EQUAL(k < 20 || k > 21, estimate_result(&estimate, k).measured);
        TEST_ASSERT_EQUAL(k < 20 || k > 21, !isnan(speed_m_s[k]));
    }
}

/* The same from the recorded slots, as a host does it. */
static void replay(uint16_t steps) {
    speed_init(&speed);
    estimate_begin(&estimate, &config, &before, speed_m_s, sigma_m_s);
    for (unsigned i = 0; 0.1 * (i + 1) <= caught_s + REST_S; i++) {
        TEST_ASSERT_TRUE(speed_restore_slot(&speed, &recorded[i]));
        while (estimate.next < steps &&
               (float)speed.next_close * SPEED_SLOT_S >= estimate_needs_s(&estimate)) {
            const uint16_t k = estimate.next;
            (void)estimate_beat(&estimate, &speed, k < BEATS ? applied_rad[k] : 0.0f);
        }
    }
}

static void expect_nothing(void) {
    for (uint16_t k = 0; k < BEATS; k++) {
        TEST_ASSERT_FALSE(estimate_result(&estimate, k).measured);
        TEST_ASSERT_TRUE(isnan(speed_m_s[k]) && isnan(sigma_m_s[k]));
    }
}

static void test_imu_refuses_without_rests(void) {
    config.source = SPEED_SOURCE_IMU;
    swim(5, 1.0);
    make_imu_errors();
    live_through((senses_t){.imu = true});
    (void)finish(BEATS, &none);
    expect_nothing();
    live_through((senses_t){.imu = true});
    (void)finish(BEATS, &(estimate_rest_t){.begin_s = 43.0f, .still_s = 4.9f});
    expect_nothing();
    before.still_s = 4.9f;
    live_through((senses_t){.imu = true});
    (void)finish(BEATS, &after);
    expect_nothing();
    before = none;
    live_through((senses_t){.imu = true});
    (void)finish(BEATS, &after);
    expect_nothing();
}

/* Whenever it begins: the last beat of the rest is not lost to rounding. */
static void test_rest_that_ends_with_a_beat(void) {
    config.source = SPEED_SOURCE_IMU;
    swim(5, 1.0);
    make_imu_errors();
    live_through((senses_t){.imu = true});
    const uint16_t steps = estimate.next;
    for (unsigned i = 0; i < 100; i++) {
        const float begin_s = 42.0f + 0.02f * (float)i;
        replay(steps);
        (void)finish(BEATS,
                     &(estimate_rest_t){.begin_s = begin_s, .still_s = (float)steps - begin_s});
        TEST_ASSERT_FALSE(isnan(speed_m_s[0]));
    }
}

/* Either rest's tilt widens sigma, by as much whenever it is computed; without any it is as it was.
 */
static void test_unknown_tilt_widens_sigma(void) {
    const float tilt_rad[][2] = {{0, 0}, {0.002f, 0}, {0, 0.002f}, {0, 0.004f}, {0, 0}};
    const float wider[] = {1.0f, 1.02f, 1.05f, 1.2f, 1.0f};
    config.source = SPEED_SOURCE_IMU;
    config.sigma_max_m_s = 1.0f;
    swim(5, 1.0);
    make_imu_errors();
    float plain = 0.0f;
    for (unsigned i = 0; i < 5; i++) {
        before.tilt_sigma_rad = tilt_rad[i][0];
        estimate_rest_t rest = after;
        rest.tilt_sigma_rad = tilt_rad[i][1];
        live_through((senses_t){.imu = true});
        (void)finish(BEATS, &rest);
        plain = i == 0 ? sigma_m_s[20] : plain;
        printf("tilt %g, %g rad: sigma %.4f mm/s\n", (double)tilt_rad[i][0], (double)tilt_rad[i][1],
               1e3 * (double)sigma_m_s[20]);
        TEST_ASSERT_TRUE(wider[i] > 1.0f ? sigma_m_s[20] > wider[i] * plain
                                         : real_abs(sigma_m_s[20] - plain) <= 0.0f);
    }
}

static void test_imu_that_was_silent_for_a_while_gives_nothing(void) {
    config.source = SPEED_SOURCE_IMU;
    swim(6, 1.0);
    make_imu_errors();
    live_through((senses_t){0});
    (void)finish(BEATS, &after);
    expect_nothing();
}

static void test_beats_known_too_badly_are_unmeasured(void) {
    config.source = SPEED_SOURCE_MODEL;
    swim(8, 1.0);
    make_imu_errors();
    live_through((senses_t){.imu = true});
    (void)finish(BEATS, &after);
    const float worst = sigma_m_s[30];
    config.sigma_max_m_s = worst * 0.99f;
    live_through((senses_t){.imu = true});
    (void)finish(BEATS, &after);
    for (uint16_t k = 0; k < BEATS; k++) {
        TEST_ASSERT_EQUAL(!(sigma_m_s[k] <= config.sigma_max_m_s), isnan(speed_m_s[k]));
    }
}

/* Without an IMU a beat of the model rests on one number; with it on all slots of the beat. */
static void test_samples_of_the_model(void) {
    config.source = SPEED_SOURCE_MODEL;
    config.sigma_max_m_s = 1.0f;
    swim(9, 1.0);
    make_imu_errors();
    for (unsigned imu = 0; imu < 2; imu++) {
        live_through((senses_t){.imu = imu != 0});
        (void)finish(BEATS, &none);
        for (uint16_t k = 0; k < BEATS; k++) {
            TEST_ASSERT_EQUAL(imu != 0 ? SLOTS_PER_BEAT : 1u,
                              estimate_result(&estimate, k).samples);
        }
    }
}

static const speed_source_t sources[] = {SPEED_SOURCE_VISION, SPEED_SOURCE_IMU, SPEED_SOURCE_MODEL};
static float first_m_s[BEATS_MAX], first_sigma[BEATS_MAX];

static void keep_results(void) {
    memcpy(first_m_s, speed_m_s, sizeof first_m_s);
    memcpy(first_sigma, sigma_m_s, sizeof first_sigma);
}

static void expect_the_same(void) {
    TEST_ASSERT_EQUAL_MEMORY(first_m_s, speed_m_s, sizeof first_m_s);
    TEST_ASSERT_EQUAL_MEMORY(first_sigma, sigma_m_s, sizeof first_sigma);
}

static void test_recorded_slots_give_the_same_bits(void) {
    for (unsigned i = 0; i < 3; i++) {
        config.source = sources[i];
        swim(10 + i, 1.0);
        make_imu_errors();
        live_through((senses_t){.imu = true, .camera = true, .dark_from_s = 7, .dark_to_s = 9});
        const uint16_t steps = estimate.next;
        TEST_ASSERT_TRUE(steps > BEATS + 5u);
        const unsigned calls = finish(BEATS, &after);
        /* Forward over the rest (with vision over all 47 steps again), 4 blocks back, done. */
        TEST_ASSERT_EQUAL_UINT(config.source == SPEED_SOURCE_VISION ? 9 : 6, calls);
        keep_results();
        TEST_ASSERT_FALSE(isnan(first_m_s[0]));
        replay(steps);
        (void)finish(BEATS, &after);
        expect_the_same();
    }
}

/* What came after the abort is time after the swim: as if it had been planned that short. */
static void test_aborted_swim(void) {
    const uint16_t lengths[] = {0, 1, 16, 17, 25};
    swim(9, 1.0);
    make_imu_errors();
    live_through((senses_t){.imu = true, .camera = true});
    after.begin_s = 34.5f;
    for (unsigned i = 0; i < 15; i++) {
        const uint16_t swum = lengths[i / 3u];
        config.source = sources[i % 3u];
        config.beats = BEATS;
        replay(41);
        (void)finish(swum, &after);
        keep_results();
        TEST_ASSERT_EQUAL(swum > 0, !isnan(first_m_s[0]));
        TEST_ASSERT_EQUAL(swum > 0, !isnan(first_m_s[swum > 0 ? swum - 1 : 0]));
        for (uint16_t k = swum; k < BEATS; k++) {
            TEST_ASSERT_TRUE(isnan(first_m_s[k]));
        }
        config.beats = swum > 0 ? swum : 1;
        replay(41);
        (void)finish(swum, &after);
        expect_the_same();
    }
}

static void test_provisional_beats(void) {
    swim(11, 1.0);
    make_imu_errors();
    live_through((senses_t){.imu = true, .camera = true});
    replay(0);
    const speed_beat_t seen = estimate_beat(&estimate, &speed, 0.0f);
    TEST_ASSERT_FALSE(seen.measured); /* its slots have left the ring */
    replay(5);
    TEST_ASSERT_EQUAL_UINT16(5, estimate.next);
    config.source = SPEED_SOURCE_IMU;
    before = none;
    estimate_begin(&estimate, &config, &before, speed_m_s, sigma_m_s);
    TEST_ASSERT_FALSE(estimate_beat(&estimate, &speed, 0.3f).measured);
}

static void test_upload_is_left_alone(void) {
    config.source = SPEED_SOURCE_UPLOAD;
    for (uint16_t k = 0; k < BEATS_MAX; k++) {
        speed_m_s[k] = (float)k;
        sigma_m_s[k] = 0.5f;
    }
    swim(12, 1.0);
    make_imu_errors();
    live_through((senses_t){.imu = true, .camera = true});
    TEST_ASSERT_EQUAL_UINT(1, finish(BEATS, &after));
    for (uint16_t k = 0; k < BEATS_MAX; k++) {
        TEST_ASSERT_EQUAL_FLOAT((float)k, speed_m_s[k]);
    }
}

static void test_needs_what_the_camera_may_still_say(void) {
    estimate_begin(&estimate, &config, &before, speed_m_s, sigma_m_s);
    TEST_ASSERT_EQUAL_FLOAT(1.5f, estimate_needs_s(&estimate));
    config.source = SPEED_SOURCE_IMU;
    estimate_begin(&estimate, &config, &before, speed_m_s, sigma_m_s);
    TEST_ASSERT_EQUAL_FLOAT(1.0f, estimate_needs_s(&estimate));
}

static double worst_error_m_s(void) {
    double worst = 0;
    for (uint16_t k = 0; k < BEATS; k++) {
        const double error = fabs((double)speed_m_s[k] - beat_m_s[k]);
        worst = error > worst ? error : worst; /* an unmeasured beat has none */
    }
    return worst;
}

static unsigned measured_beats(void) {
    unsigned measured = 0;
    for (uint16_t k = 0; k < BEATS; k++) {
        measured += isnan(speed_m_s[k]) ? 0u : 1u;
    }
    return measured;
}

/* Changes what the slots say and goes through them again. */
static void spoil(unsigned from, unsigned to, void (*change)(speed_slot_t *slot)) {
    const uint16_t steps = estimate.next;
    for (unsigned i = from; i < to; i++) {
        change(&recorded[i]);
    }
    replay(steps);
    (void)finish(BEATS, &none);
}

static void repeat_itself(speed_slot_t *slot) { slot->speed_m_s = 0.0421f; }
static void lose_the_imu(speed_slot_t *slot) { slot->gain_10um_s = SPEED_NO_MOTION; }
static void take_another_fish(speed_slot_t *slot) { slot->speed_m_s += 0.02f; }
static void jump(speed_slot_t *slot) { slot->speed_m_s += 0.2f; }
static void tilt(speed_slot_t *slot) {
    slot->gain_10um_s = (int16_t)(slot->gain_10um_s + 1000);
    slot->way_um = (int16_t)(slot->way_um + 500);
}

static void live(bool imu) {
    swim(14, 1.0);
    make_imu_errors();
    live_through((senses_t){.imu = imu, .camera = true});
}

static void test_a_camera_that_repeats_itself_is_a_hole(void) {
    live(false);
    spoil(100, 130, repeat_itself);
    TEST_ASSERT_TRUE(worst_error_m_s() < 0.004);
    TEST_ASSERT_EQUAL_UINT(BEATS - 5u, measured_beats());
    live(true);
    spoil(100, 130, repeat_itself);
    TEST_ASSERT_TRUE(worst_error_m_s() < 0.004);
    TEST_ASSERT_EQUAL_UINT(BEATS, measured_beats());
}

static void test_a_jump_of_the_camera_is_a_hole(void) {
    for (unsigned at = 100; at < 110; at++) {
        live(false);
        spoil(at, at + 3u, jump);
        TEST_ASSERT_TRUE(worst_error_m_s() < 0.004);
        TEST_ASSERT_TRUE(measured_beats() >= BEATS - 2u);
    }
}

/* Nobody knows which of the two is wrong. After some seconds more the IMU would not know better
 * than that by itself. */
static void test_a_camera_that_contradicts_the_imu_for_a_while(void) {
    live(true);
    spoil(160, 190, take_another_fish);
    TEST_ASSERT_TRUE(worst_error_m_s() < 0.006);
    TEST_ASSERT_EQUAL_UINT(BEATS - 3u, measured_beats());
}

static void test_an_imu_that_contradicts_the_camera_all_along_drops_out(void) {
    live(true);
    spoil(0, SLOTS, lose_the_imu);
    keep_results();
    live(true);
    for (unsigned i = 0; i < 400; i++) {
        recorded[i].gain_10um_s = (int16_t)(i % 20u < 10u ? 500 : -500);
        recorded[i].way_um = 0;
    }
    spoil(0, 0, tilt);
    TEST_ASSERT_EQUAL_UINT(BEATS, measured_beats());
    expect_the_same();
}

static void test_an_imu_that_is_tilted_in_mid_swim(void) {
    live(true);
    spoil(200, 201, tilt);
    TEST_ASSERT_TRUE(worst_error_m_s() < 0.006);
    for (unsigned from = 100; from < 400; from += 100u) {
        live(true);
        spoil(from, 400, tilt);
        TEST_ASSERT_TRUE(worst_error_m_s() < 0.006);
        TEST_ASSERT_TRUE(measured_beats() >= BEATS * 2u / 3u);
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_vision_alone_gives_what_the_camera_says);
    RUN_TEST(test_a_hole_in_vision_alone_is_unmeasured);
    RUN_TEST(test_imu_refuses_without_rests);
    RUN_TEST(test_rest_that_ends_with_a_beat);
    RUN_TEST(test_unknown_tilt_widens_sigma);
    RUN_TEST(test_imu_that_was_silent_for_a_while_gives_nothing);
    RUN_TEST(test_beats_known_too_badly_are_unmeasured);
    RUN_TEST(test_samples_of_the_model);
    RUN_TEST(test_recorded_slots_give_the_same_bits);
    RUN_TEST(test_aborted_swim);
    RUN_TEST(test_provisional_beats);
    RUN_TEST(test_upload_is_left_alone);
    RUN_TEST(test_a_camera_that_repeats_itself_is_a_hole);
    RUN_TEST(test_a_jump_of_the_camera_is_a_hole);
    RUN_TEST(test_a_camera_that_contradicts_the_imu_for_a_while);
    RUN_TEST(test_an_imu_that_contradicts_the_camera_all_along_drops_out);
    RUN_TEST(test_an_imu_that_is_tilted_in_mid_swim);
    RUN_TEST(test_needs_what_the_camera_may_still_say);
    return UNITY_END();
}
