/* Which camera samples cannot be a fish's. */
#include "speed/doubt.h"

#include "unity.h"

static doubt_t doubt;
static speed_config_t config;
static float from_s, to_s;
static uint16_t next;

void setUp(void) {
    doubt_init(&doubt);
    config = (speed_config_t){.window_s = 1.0f, .gap_max_s = 0.5f, .plausible_m_s = 0.5f};
    next = 0;
}

void tearDown(void) {}

static bool see_with(float speed_m_s, uint16_t sigma_10um_s, int16_t gain_10um_s) {
    const speed_slot_t slot = {.index = next++,
                               .samples = 2,
                               .at_ms = 50,
                               .speed_m_s = speed_m_s,
                               .sigma_10um_s = sigma_10um_s,
                               .gain_10um_s = gain_10um_s};
    return doubt_slot(&doubt, &config, &slot, &from_s, &to_s);
}

static bool see(float speed_m_s) { return see_with(speed_m_s, 70, SPEED_NO_MOTION); }

static void fish_swims(void) {
    TEST_ASSERT_FALSE(see(0.080f));
    TEST_ASSERT_FALSE(see(0.081f));
    TEST_ASSERT_FALSE(see(0.079f));
}

static void test_a_repeated_speed_is_in_doubt_from_its_first(void) {
    fish_swims();
    for (int i = 0; i < 4; i++) {
        TEST_ASSERT_FALSE(see(0.078f));
    }
    TEST_ASSERT_TRUE(see(0.078f));
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.35f - 1.0f, from_s);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.75f + 1.0f, to_s);
    TEST_ASSERT_TRUE(see(0.078f));
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.35f - 1.0f, from_s);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.85f + 1.0f, to_s);
    TEST_ASSERT_FALSE(see(0.0781f));
}

static void test_a_fish_that_moved_never_stands_quite_still(void) {
    fish_swims();
    TEST_ASSERT_FALSE(see_with(0.04f, 300, SPEED_NO_MOTION));
    for (int i = 0; i < 4; i++) {
        TEST_ASSERT_FALSE(see_with(0.0f, 1, SPEED_NO_MOTION));
    }
    TEST_ASSERT_TRUE(see_with(0.0f, 1, SPEED_NO_MOTION));
}

static void test_a_fish_at_rest_may_stand_still(void) {
    for (int i = 0; i < 30; i++) {
        TEST_ASSERT_FALSE(see_with(i % 10 == 0 ? 0.005f : 0.0f, 1, SPEED_NO_MOTION));
    }
    TEST_ASSERT_TRUE(see_with(0.0f, 1, 12)); /* the IMU knows better */
}

static void test_a_camera_without_noise_may_repeat_itself(void) {
    fish_swims();
    for (int i = 0; i < 30; i++) {
        TEST_ASSERT_FALSE(see_with(0.078f, 1, 5));
    }
    setUp();
    for (int i = 0; i < 30; i++) {
        TEST_ASSERT_FALSE(see(0.04f)); /* never another */
    }
}

static void test_a_mean_over_a_beat_cannot_jump(void) {
    const float most = 0.05f + 5.0f * 2.0f * 70e-5f;
    fish_swims();
    TEST_ASSERT_FALSE(see(0.079f + 0.99f * most));
    TEST_ASSERT_TRUE(see(0.079f - 0.02f * most));
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.35f - 0.5f, from_s);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.45f + 0.5f, to_s);
    TEST_ASSERT_FALSE(see(0.078f));
    next = (uint16_t)(next + 4u); /* after a hole it may have changed as much more */
    TEST_ASSERT_FALSE(see(0.078f + 0.24f));
    config.window_s = 0.0f;
    TEST_ASSERT_FALSE(see(-0.4f));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_a_repeated_speed_is_in_doubt_from_its_first);
    RUN_TEST(test_a_fish_that_moved_never_stands_quite_still);
    RUN_TEST(test_a_fish_at_rest_may_stand_still);
    RUN_TEST(test_a_camera_without_noise_may_repeat_itself);
    RUN_TEST(test_a_mean_over_a_beat_cannot_jump);
    return UNITY_END();
}
