/* Compared with the division that the compiler makes. */
#include "base/units.h"

#include "unity.h"

void setUp(void) {}
void tearDown(void) {}

static void milliseconds_are_those_of_the_division(void) {
    TEST_ASSERT_EQUAL_UINT64(0, units_thousandth(0));
    for (uint64_t time_us = 1; time_us < UINT64_MAX / 3u; time_us = time_us * 3u + 1u) {
        TEST_ASSERT_EQUAL_UINT64(time_us / 1000u, units_thousandth(time_us));
    }
    for (uint64_t ms = 1; ms < UINT64_MAX / 7000u; ms = ms * 7u) {
        TEST_ASSERT_EQUAL_UINT64(ms, units_thousandth(ms * 1000u));
        TEST_ASSERT_EQUAL_UINT64(ms - 1u, units_thousandth(ms * 1000u - 1u));
    }
    TEST_ASSERT_EQUAL_UINT64(UINT64_MAX / 1000u, units_thousandth(UINT64_MAX));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(milliseconds_are_those_of_the_division);
    return UNITY_END();
}
