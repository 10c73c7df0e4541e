/* Against the C library in double precision, which the firmware itself never uses. */
#include "base/real.h"

#include "base/crc.h"
#include "mock_hal.h"
#include "unity.h"

#include <math.h>
#include <string.h>

#define PI 3.14159265358979323846

void setUp(void) {}
void tearDown(void) {}

static float of_bits(uint32_t bits) {
    float x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

static uint32_t bits_of(float x) {
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}

static void test_finite(void) {
    TEST_ASSERT_TRUE(real_is_finite(0.0f));
    TEST_ASSERT_TRUE(real_is_finite(-3.4e38f));
    TEST_ASSERT_TRUE(real_is_finite(1e-45f));
    TEST_ASSERT_FALSE(real_is_finite(of_bits(0x7F800000u)));
    TEST_ASSERT_FALSE(real_is_finite(of_bits(0xFF800000u)));
    TEST_ASSERT_FALSE(real_is_finite(of_bits(0x7FC00000u)));
    TEST_ASSERT_FALSE(real_is_finite(of_bits(0xFF800001u)));
}

static void test_clip_and_abs(void) {
    TEST_ASSERT_EQUAL_FLOAT(1.0f, real_clip(0.5f, 1.0f, 2.0f));
    TEST_ASSERT_EQUAL_FLOAT(2.0f, real_clip(2.5f, 1.0f, 2.0f));
    TEST_ASSERT_EQUAL_FLOAT(1.5f, real_clip(1.5f, 1.0f, 2.0f));
    TEST_ASSERT_TRUE(isnan(real_clip((float)NAN, 1.0f, 2.0f)));
    TEST_ASSERT_EQUAL_FLOAT(2.5f, real_abs(-2.5f));
    TEST_ASSERT_EQUAL_HEX32(0, bits_of(real_abs(-0.0f)));
}

/* Double has more than twice float's digits, so rounding its root once more is exact. */
static void test_whole_numbers_are_those_of_the_cast(void) {
    for (uint32_t bits = 0; bits < 0x5F800000u; bits += 4099u) {
        TEST_ASSERT_EQUAL_UINT64((uint64_t)of_bits(bits), real_whole_u64(of_bits(bits)));
    }
    TEST_ASSERT_EQUAL_UINT64(UINT64_C(0xFFFFFF0000000000), real_whole_u64(of_bits(0x5F7FFFFFu)));
    const float outside[] = {0x1p64f, INFINITY, NAN, -0.0f, -1.0f, -INFINITY};
    for (uint32_t i = 0; i < sizeof outside / sizeof outside[0]; i++) {
        TEST_ASSERT_EQUAL_UINT64(0, real_whole_u64(outside[i]));
    }
}

static void check_sqrt(uint32_t bits) {
    const float x = of_bits(bits);
    TEST_ASSERT_EQUAL_HEX32(bits_of((float)sqrt((double)x)), bits_of(real_sqrt(x)));
}

static void test_sqrt_is_correctly_rounded(void) {
    for (uint32_t bits = 1; bits < 0x7F800000u; bits += 40009u) {
        check_sqrt(bits);
    }
    for (uint32_t i = 0; i < 64u; i++) {
        check_sqrt(1u + i);                /* subnormal */
        check_sqrt(0x00800000u - 32u + i); /* around the smallest normal */
        check_sqrt(0x3F800000u - 32u + i); /* around 1: results just below a power of two */
        check_sqrt(0x40800000u - 32u + i); /* around 4 */
        check_sqrt(0x7F800000u - 1u - i);  /* largest */
    }
}

static void test_sqrt_of_what_has_none(void) {
    TEST_ASSERT_EQUAL_HEX32(0, bits_of(real_sqrt(0.0f)));
    TEST_ASSERT_EQUAL_HEX32(0, bits_of(real_sqrt(-0.0f)));
    TEST_ASSERT_EQUAL_HEX32(0, bits_of(real_sqrt(-4.0f)));
    TEST_ASSERT_EQUAL_HEX32(0, bits_of(real_sqrt(of_bits(0xFF800000u))));
    TEST_ASSERT_TRUE(isnan(real_sqrt((float)NAN)));
    TEST_ASSERT_TRUE(isinf(real_sqrt(of_bits(0x7F800000u))));
}

static const uint32_t denominators[] = {1u, 2u, 3u, 4u, 7u, 50u, 100u, 997u, 1000u};
#define DENOMINATORS (sizeof denominators / sizeof denominators[0])

static void test_sine_is_near_the_true_one(void) {
    for (size_t i = 0; i < DENOMINATORS; i++) {
        const uint32_t n = denominators[i];
        for (uint32_t k = 0; k <= n; k++) {
            const double sine = (double)real_sin_turn(k, n);
            TEST_ASSERT_TRUE(fabs(sine - sin(2.0 * PI * k / n)) < 3e-7);
            TEST_ASSERT_TRUE(fabs(sine) <= 1.0);
        }
    }
}

static void test_sine_of_huge_fractions(void) {
    for (uint32_t i = 0; i < 2000u; i++) {
        const uint32_t k = i * 2147483u;
        const double sine = (double)real_sin_turn(k, 0xFFFFFFFFu);
        TEST_ASSERT_TRUE(fabs(sine - sin(2.0 * PI * k / 4294967295.0)) < 3e-7);
    }
}

static void test_sine_symmetries_are_exact(void) {
    for (size_t i = 0; i < DENOMINATORS; i++) {
        const uint32_t n = 4u * denominators[i];
        TEST_ASSERT_EQUAL_HEX32(0, bits_of(real_sin_turn(0, n)));
        TEST_ASSERT_EQUAL_HEX32(0, bits_of(real_sin_turn(n / 2u, n)));
        TEST_ASSERT_EQUAL_HEX32(bits_of(1.0f), bits_of(real_sin_turn(n / 4u, n)));
        TEST_ASSERT_EQUAL_HEX32(bits_of(-1.0f), bits_of(real_sin_turn(3u * n / 4u, n)));
        for (uint32_t k = 1; k < n / 2u; k++) {
            const uint32_t sine = bits_of(real_sin_turn(k, n));
            TEST_ASSERT_EQUAL_HEX32(sine ^ 0x80000000u, bits_of(real_sin_turn(n - k, n)));
            TEST_ASSERT_EQUAL_HEX32(sine, bits_of(real_sin_turn(n / 2u - k, n)));
            TEST_ASSERT_EQUAL_HEX32(sine, bits_of(real_sin_turn(k + 5u * n, n)));
        }
    }
}

/* One number for all targets: it was computed on x86-64 and must come out on the Cortex-M3 too. */
static void test_bits_are_the_same_on_every_target(void) {
    uint32_t crc = 0;
    for (uint32_t k = 0; k < 1000u; k++) {
        const float values[2] = {real_sin_turn(k, 1000u), real_sqrt((float)k * 0.001f)};
        crc = crc32_update(crc, values, sizeof values);
    }
    TEST_ASSERT_EQUAL_HEX32(0x8FE5BD99u, crc);
}

static void test_no_turn_at_all_is_our_mistake(void) {
    static bool panicked;
    MOCK_EXPECT_PANIC(panicked, (void)real_sin_turn(1, 0));
    TEST_ASSERT_TRUE(panicked);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_finite);
    RUN_TEST(test_clip_and_abs);
    RUN_TEST(test_whole_numbers_are_those_of_the_cast);
    RUN_TEST(test_sqrt_is_correctly_rounded);
    RUN_TEST(test_sqrt_of_what_has_none);
    RUN_TEST(test_sine_is_near_the_true_one);
    RUN_TEST(test_sine_of_huge_fractions);
    RUN_TEST(test_sine_symmetries_are_exact);
    RUN_TEST(test_bits_are_the_same_on_every_target);
    RUN_TEST(test_no_turn_at_all_is_our_mistake);
    return UNITY_END();
}
