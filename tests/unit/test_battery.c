#include "supervisor/battery.h"

#include "unity.h"

#define LOW_MV 6600u
#define SECOND_US 1000000ull

static battery_t battery;

void setUp(void) { battery = (battery_t){0}; }
void tearDown(void) {}

static void allowed_from_the_limit_on(void) {
    TEST_ASSERT_TRUE(battery_allows(&battery, LOW_MV, LOW_MV));
    TEST_ASSERT_FALSE(battery_allows(&battery, LOW_MV - 1u, LOW_MV));
}

static void once_too_low_it_has_to_rise(void) {
    TEST_ASSERT_FALSE(battery_allows(&battery, 0, LOW_MV));
    TEST_ASSERT_FALSE(battery_allows(&battery, LOW_MV, LOW_MV));
    TEST_ASSERT_FALSE(battery_allows(&battery, LOW_MV + BATTERY_RISE_MV - 1u, LOW_MV));
    TEST_ASSERT_TRUE(battery_allows(&battery, LOW_MV + BATTERY_RISE_MV, LOW_MV));
    TEST_ASSERT_TRUE(battery_allows(&battery, LOW_MV, LOW_MV));
}

static void one_that_ended_a_swim_has_to_rise_too(void) {
    TEST_ASSERT_TRUE(battery_allows(&battery, LOW_MV, LOW_MV));
    battery_exhausted(&battery);
    TEST_ASSERT_FALSE(battery_allows(&battery, LOW_MV + BATTERY_RISE_MV - 1u, LOW_MV));
    TEST_ASSERT_TRUE(battery_allows(&battery, LOW_MV + BATTERY_RISE_MV, LOW_MV));
}

static void without_a_limit_all_is_allowed(void) {
    battery_exhausted(&battery);
    TEST_ASSERT_TRUE(battery_allows(&battery, 0, 0));
    TEST_ASSERT_TRUE(battery_allows(&battery, LOW_MV, LOW_MV));
}

static void the_highest_limit_does_not_wrap(void) {
    battery_exhausted(&battery);
    TEST_ASSERT_FALSE(battery_allows(&battery, UINT16_MAX, UINT16_MAX));
}

static void a_reading_becomes_the_voltage_of_the_pack(void) {
    TEST_ASSERT_EQUAL_UINT16(0, battery_voltage(0, 3.3f, 3.0f).mv);
    TEST_ASSERT_EQUAL_UINT16(4950, battery_voltage(32768, 3.3f, 3.0f).mv);
    TEST_ASSERT_EQUAL_UINT16(9861, battery_voltage(BATTERY_LIMIT_READING, 3.3f, 3.0f).mv);
    TEST_ASSERT_EQUAL_UINT16(UINT16_MAX, battery_voltage(UINT16_MAX, 3.6f, 20.0f).mv);
}

static void full_scale_is_no_voltage(void) {
    battery_voltage_t voltage = battery_voltage(BATTERY_LIMIT_READING - 1u, 3.3f, 3.0f);
    TEST_ASSERT_FALSE(voltage.at_limit);
    TEST_ASSERT_EQUAL(FAULT_NONE, battery_judge(&battery, &voltage, LOW_MV));
    TEST_ASSERT_FALSE(battery_tells_limit(&battery, &voltage, LOW_MV));
    voltage = battery_voltage(4095u * 16u, 3.3f, 3.0f); /* each sample at its highest count */
    TEST_ASSERT_TRUE(voltage.at_limit);
    TEST_ASSERT_EQUAL(FAULT_BATTERY_SENSE, battery_judge(&battery, &voltage, LOW_MV));
    TEST_ASSERT_EQUAL(FAULT_NONE, battery_judge(&battery, &voltage, 0));
    TEST_ASSERT_FALSE(battery_tells_limit(&battery, &voltage, 0));
    TEST_ASSERT_TRUE(battery_tells_limit(&battery, &voltage, LOW_MV));
    TEST_ASSERT_FALSE(battery_tells_limit(&battery, &voltage, LOW_MV));
    voltage.mv = LOW_MV - 1u;
    voltage.at_limit = false;
    TEST_ASSERT_EQUAL(FAULT_BATTERY_LOW, battery_judge(&battery, &voltage, LOW_MV));
}

static uint32_t warnings(uint64_t from_us, uint64_t to_us, uint16_t battery_mv) {
    uint32_t count = 0;
    for (uint64_t us = from_us; us < to_us; us += 10000u) {
        count += battery_warns(&battery, us, battery_mv, LOW_MV) ? 1u : 0u;
    }
    return count;
}

static void warns_once_per_swim_after_five_seconds(void) {
    for (uint64_t swim = 1; swim < 4; swim++) {
        const uint64_t begin_us = swim * 100u * SECOND_US;
        battery_begin_swim(&battery, begin_us);
        TEST_ASSERT_EQUAL_UINT32(0, warnings(begin_us, begin_us + 5u * SECOND_US, LOW_MV - 1u));
        TEST_ASSERT_EQUAL_UINT32(
            1, warnings(begin_us + 5u * SECOND_US, begin_us + 60u * SECOND_US, LOW_MV - 1u));
    }
}

static void moments_below_the_limit_are_no_warning(void) {
    battery_begin_swim(&battery, 0);
    for (uint64_t second = 0; second < 60; second += 5) {
        const uint64_t us = second * SECOND_US;
        TEST_ASSERT_EQUAL_UINT32(0, warnings(us, us + 4u * SECOND_US, 5000));
        TEST_ASSERT_EQUAL_UINT32(0, warnings(us + 4u * SECOND_US, us + 5u * SECOND_US, LOW_MV));
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(a_reading_becomes_the_voltage_of_the_pack);
    RUN_TEST(full_scale_is_no_voltage);
    RUN_TEST(allowed_from_the_limit_on);
    RUN_TEST(once_too_low_it_has_to_rise);
    RUN_TEST(one_that_ended_a_swim_has_to_rise_too);
    RUN_TEST(without_a_limit_all_is_allowed);
    RUN_TEST(the_highest_limit_does_not_wrap);
    RUN_TEST(warns_once_per_swim_after_five_seconds);
    RUN_TEST(moments_below_the_limit_are_no_warning);
    return UNITY_END();
}
