#include "base/fixed.h"

#include "unity.h"

#include <math.h>

void setUp(void) {}
void tearDown(void) {}

static uint32_t random_state = 1u;

static uint32_t random_word(void) {
    random_state = random_state * 1664525u + 1013904223u;
    const uint32_t high = random_state >> 16;
    random_state = random_state * 1664525u + 1013904223u;
    return high << 16 | random_state >> 16;
}

static void numbers_are_rounded_to_the_nearest(void) {
    TEST_ASSERT_EQUAL_INT64(0, fixed_from(0.0f, 30));
    TEST_ASSERT_EQUAL_INT64(0, fixed_from(-0.0f, 30));
    TEST_ASSERT_EQUAL_INT64(1, fixed_from(0.5f, 0));
    TEST_ASSERT_EQUAL_INT64(-1, fixed_from(-0.5f, 0));
    TEST_ASSERT_EQUAL_INT64(0, fixed_from(0.49999997f, 0));
    TEST_ASSERT_EQUAL_INT64(3, fixed_from(2.5f, 0));
    TEST_ASSERT_EQUAL_INT64(-40, fixed_from(-2.5f, 4));
    TEST_ASSERT_EQUAL_INT64(0, fixed_from(1e-45f, 60));
    TEST_ASSERT_EQUAL_INT64((int64_t)0xFFFFFF << 37, fixed_from(16777215.0f, 37));
}

static void what_does_not_fit_is_clipped(void) {
    TEST_ASSERT_EQUAL_INT64(FIXED_WIDE_MAX, fixed_from(0x1p31f, 30));
    TEST_ASSERT_EQUAL_INT64(FIXED_WIDE_MAX / 2, fixed_from(0x1p30f, 30));
    TEST_ASSERT_EQUAL_INT64(-FIXED_WIDE_MAX, fixed_from(-0x1p32f, 30));
    TEST_ASSERT_EQUAL_INT64(-FIXED_WIDE_MAX, fixed_from(-INFINITY, 0));
    TEST_ASSERT_EQUAL_INT64(FIXED_WIDE_MAX, fixed_from(NAN, -100));
    TEST_ASSERT_EQUAL_INT32(INT32_MAX, fixed_clipped((int64_t)1 << 40, 9));
    TEST_ASSERT_EQUAL_INT32(INT32_MIN, fixed_clipped(-((int64_t)1 << 40), 8));
    TEST_ASSERT_EQUAL_INT32(INT32_MIN, fixed_clipped(-((int64_t)1 << 40), 9));
    TEST_ASSERT_EQUAL_INT32(INT32_MIN, fixed_clipped(INT64_MIN, 1));
}

/* Halves up, also of what is below zero: a shift to the right keeps the sign. */
static void products_are_rounded_to_the_nearest(void) {
    const int64_t halves[] = {-7, -6, -5, -4, -3, -2, -1, 0, 1, 2, 3, 5};
    for (unsigned i = 0; i < sizeof halves / sizeof halves[0]; i++) {
        const int32_t expected = (int32_t)floor((double)halves[i] / 4.0 + 0.5);
        TEST_ASSERT_EQUAL_INT32(expected, fixed_down(halves[i], 2));
        TEST_ASSERT_EQUAL_INT32(expected, fixed_clipped(halves[i], 2));
    }
    for (int i = 0; i < 10000; i++) {
        const uint32_t bits = 1u + random_word() % 62u;
        const int64_t x = (int64_t)((uint64_t)random_word() << 32 | random_word()) / 4;
        const int64_t half = (int64_t)1 << (bits - 1u);
        const int64_t expected = (x + half) >> bits;
        TEST_ASSERT_EQUAL_INT32(expected > INT32_MAX   ? INT32_MAX
                                : expected < INT32_MIN ? INT32_MIN
                                                       : expected,
                                fixed_clipped(x, bits));
    }
}

static void rounding_is_carried_on(void) {
    int32_t left = 0;
    int64_t exact = 0, rounded = 0;
    for (int i = 0; i < 10000; i++) {
        const int64_t x = (int64_t)random_word() * 3 - 5000000000;
        exact += x;
        rounded += fixed_carried(x, 20, &left);
        TEST_ASSERT_EQUAL_INT64(exact, rounded * (1 << 20) + left);
        TEST_ASSERT_TRUE(left <= 1 << 19 && left >= -(1 << 19));
    }
}

static void vectors_are_multiplied(void) {
    const int32_t a[3] = {INT32_MAX, -3, 5}, b[3] = {-2, 7, INT32_MIN};
    int64_t crossed[3];
    fixed_cross(a, b, crossed);
    TEST_ASSERT_EQUAL_INT64(-3 * (int64_t)INT32_MIN - 35, crossed[0]);
    TEST_ASSERT_EQUAL_INT64(-10 - (int64_t)INT32_MAX * INT32_MIN, crossed[1]);
    TEST_ASSERT_EQUAL_INT64(7 * (int64_t)INT32_MAX - 6, crossed[2]);
    TEST_ASSERT_EQUAL_INT64(-2 * (int64_t)INT32_MAX - 21 + 5 * (int64_t)INT32_MIN, fixed_dot(a, b));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(numbers_are_rounded_to_the_nearest);
    RUN_TEST(what_does_not_fit_is_clipped);
    RUN_TEST(products_are_rounded_to_the_nearest);
    RUN_TEST(rounding_is_carried_on);
    RUN_TEST(vectors_are_multiplied);
    return UNITY_END();
}
