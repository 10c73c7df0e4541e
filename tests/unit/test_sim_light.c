/* How much of the LED's light falls into an exposure. */
#include "camera/light.h"
#include "test_sim_led.h"
#include "unity.h"

#include <stdio.h>

void setUp(void) {}
void tearDown(void) {}

static void test_part_of_an_exposure_against_counting(void) {
    for (uint64_t seed = 1; seed <= 200; seed++) {
        use_seed(seed);
        char where[32];
        snprintf(where, sizeof where, "seed %u", (unsigned)seed);
        light_t light = {0};
        uint64_t now_us = 0;
        for (edges = 0; edges < 20; edges++) {
            now_us += whole(0, 60);
            edge_us[edges] = now_us;
            light_set(&light, now_us, led_after(edges + 1));
            light_set(&light, now_us, led_after(edges + 1));
        }
        for (unsigned i = 0; i < 50; i++) {
            const uint64_t from_us = whole(0, now_us + 100);
            const uint64_t to_us = from_us + (i % 4 == 0 ? 0 : whole(0, 300));
            const double expected = part_on(from_us, to_us);
            TEST_ASSERT_EQUAL_DOUBLE_MESSAGE(expected, light_part(&light, from_us, to_us), where);
            TEST_ASSERT_EQUAL_DOUBLE(expected, part_on_by_edges(from_us, to_us));
        }
    }
}

static void test_an_edge_belongs_to_what_follows(void) {
    light_t light = {0};
    TEST_ASSERT_EQUAL_DOUBLE(0, light_part(&light, 0, 1000000));
    light_set(&light, 100, true);
    TEST_ASSERT_EQUAL_DOUBLE(0, light_part(&light, 99, 99));
    TEST_ASSERT_EQUAL_DOUBLE(1, light_part(&light, 100, 100));
    TEST_ASSERT_EQUAL_DOUBLE(0, light_part(&light, 50, 100));
    TEST_ASSERT_EQUAL_DOUBLE(0.25, light_part(&light, 70, 110));
    TEST_ASSERT_EQUAL_DOUBLE(1, light_part(&light, 100, 1000000));
    light_set(&light, 200, false);
    TEST_ASSERT_EQUAL_DOUBLE(1, light_part(&light, 199, 199));
    TEST_ASSERT_EQUAL_DOUBLE(0, light_part(&light, 200, 200));
    TEST_ASSERT_EQUAL_DOUBLE(0.5, light_part(&light, 0, 200));
    TEST_ASSERT_EQUAL_DOUBLE(1, light_part(&light, 100, 200));
}

/* Long after it has begun to forget, the last second is known, at a change each 10 ms. */
static void test_the_last_second_is_remembered(void) {
    light_t light = {0};
    for (edges = 0; edges < 1001; edges++) {
        edge_us[edges] = 10000u * (edges + 1);
        light_set(&light, edge_us[edges], led_after(edges + 1));
        const uint64_t to_us = edge_us[edges] + 5000;
        const uint64_t from_us = to_us > 1020000 ? to_us - 1020000 : 0;
        edges++;
        TEST_ASSERT_EQUAL_DOUBLE(part_on_by_edges(from_us, to_us),
                                 light_part(&light, from_us, to_us));
        edges--;
    }
    TEST_ASSERT_EQUAL_DOUBLE(1, light_part(&light, 10015000, 10020000));
    const double all = light_part(&light, 0, 10020000);
    TEST_ASSERT_TRUE(all >= 0 && all <= 1);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_part_of_an_exposure_against_counting);
    RUN_TEST(test_an_edge_belongs_to_what_follows);
    RUN_TEST(test_the_last_second_is_remembered);
    return UNITY_END();
}
