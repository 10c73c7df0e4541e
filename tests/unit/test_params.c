/* The table itself, and what is refused. */
#include "params/params.h"

#include "mock_hal.h"
#include "unity.h"

#include <math.h>
#include <string.h>

static params_t params;

void setUp(void) { params_reset(&params); }
void tearDown(void) {}

static void test_every_row_is_sound(void) {
    for (uint32_t i = 0; i < PARAM_COUNT; i++) {
        const param_info_t *info = param_info((param_t)i);
        const size_t length = strlen(info->name);
        TEST_ASSERT_TRUE_MESSAGE(length >= 1 && length <= PARAM_NAME_BYTES, info->name);
        TEST_ASSERT_TRUE_MESSAGE(info->low < info->high, info->name);
        TEST_ASSERT_TRUE_MESSAGE(strlen(param_text((param_t)i)) > 0, info->name);
        TEST_ASSERT_EQUAL_MESSAGE(PARAM_OK, params_set(&params, (param_t)i, info->fallback),
                                  info->name);
        TEST_ASSERT_EQUAL_MESSAGE(i, param_find(info->name), info->name);
    }
}

static void test_defaults_are_safe_on_an_unknown_fish(void) {
    TEST_ASSERT_EQUAL_FLOAT(0.5f, params.value[PARAM_AMP_MAX_RAD]);
    TEST_ASSERT_EQUAL_FLOAT(0.15f, params.value[PARAM_DU_MAX_RAD]);
    TEST_ASSERT_EQUAL_FLOAT(5.0f, params.value[PARAM_LINK_TIMEOUT_S]);
    TEST_ASSERT_EQUAL_FLOAT(1.3f, params.value[PARAM_ROLLBACK_RATIO]);
    TEST_ASSERT_EQUAL_FLOAT(1.0f, params.value[PARAM_ILC_LEAD]);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, params.value[PARAM_ILC_DECR_RATE]);
}

static void test_sixteen_characters_need_no_terminator(void) {
    const char wire[PARAM_NAME_BYTES + 4] = "SERVO_SLEW_RAD_SXYZ";
    TEST_ASSERT_EQUAL(PARAM_SERVO_SLEW_RAD_S, param_find(wire));
}

static void test_names_must_match_wholly(void) {
    const char shorter[PARAM_NAME_BYTES] = "ILC_GAI";
    const char longer[PARAM_NAME_BYTES] = "ILC_GAINS";
    const char lower[PARAM_NAME_BYTES] = "ilc_gain";
    const char empty[PARAM_NAME_BYTES] = "";
    TEST_ASSERT_EQUAL(PARAM_COUNT, param_find(shorter));
    TEST_ASSERT_EQUAL(PARAM_COUNT, param_find(longer));
    TEST_ASSERT_EQUAL(PARAM_COUNT, param_find(lower));
    TEST_ASSERT_EQUAL(PARAM_COUNT, param_find(empty));
}

static void test_renamed_parameters_are_found_by_their_old_names_apart(void) {
    static const char *const old_names[] = {"LAW_GAIN",   "LAW_KD",     "LAW_LEAD",      "LAW_TAIL",
                                            "LAW_Q_LEN",  "LAW_FADE",   "LAW_FADE_FROM", "LAW_KIND",
                                            "LAW_WINDOW", "LAW_BEYOND", "GLIDE_S"};
    static const param_t now[] = {PARAM_ILC_GAIN,      PARAM_ILC_KD,    PARAM_ILC_LEAD,
                                  PARAM_ILC_END_EXT,   PARAM_ILC_Q_LEN, PARAM_ILC_DECR_RATE,
                                  PARAM_ILC_DECR_FROM, PARAM_ILC_KIND,  PARAM_ILC_WINDOW,
                                  PARAM_ILC_EXTRAP,    PARAM_COAST_S};
    TEST_ASSERT_EQUAL(sizeof now / sizeof now[0], PARAM_RENAMED_COUNT);
    for (uint32_t i = 0; i < PARAM_RENAMED_COUNT; i++) {
        char name[PARAM_NAME_BYTES] = "";
        memcpy(name, old_names[i], strlen(old_names[i]));
        TEST_ASSERT_EQUAL_MESSAGE(now[i], param_find_renamed(name), old_names[i]);
        TEST_ASSERT_EQUAL_MESSAGE(PARAM_COUNT, param_find(name), old_names[i]);
        TEST_ASSERT_EQUAL_MEMORY(name, param_renamed(i)->old_name, sizeof name);
        TEST_ASSERT_EQUAL_MESSAGE(now[i], param_renamed(i)->param, old_names[i]);
    }
    const char current[PARAM_NAME_BYTES] = "ILC_GAIN";
    const char shorter[PARAM_NAME_BYTES] = "LAW_FAD";
    TEST_ASSERT_EQUAL(PARAM_COUNT, param_find_renamed(current));
    TEST_ASSERT_EQUAL(PARAM_COUNT, param_find_renamed(shorter));
}

static void test_limits_are_inclusive(void) {
    TEST_ASSERT_EQUAL(PARAM_OK, params_set(&params, PARAM_ILC_Q_LEN, 64.0f));
    TEST_ASSERT_EQUAL(PARAM_OUT_OF_RANGE, params_set(&params, PARAM_ILC_Q_LEN, 65.0f));
    TEST_ASSERT_EQUAL(PARAM_OK, params_set(&params, PARAM_ILC_Q_LEN, 1.0f));
    TEST_ASSERT_EQUAL(PARAM_OUT_OF_RANGE, params_set(&params, PARAM_ILC_Q_LEN, 0.0f));
    TEST_ASSERT_EQUAL(1, params_whole(&params, PARAM_ILC_Q_LEN));
}

static void test_refusals_change_nothing(void) {
    const params_t before = params;
    TEST_ASSERT_EQUAL(PARAM_NOT_FINITE, params_set(&params, PARAM_ILC_GAIN, (float)NAN));
    TEST_ASSERT_EQUAL(PARAM_NOT_FINITE, params_set(&params, PARAM_ILC_GAIN, (float)INFINITY));
    TEST_ASSERT_EQUAL(PARAM_OUT_OF_RANGE, params_set(&params, PARAM_ILC_GAIN, -1.0f));
    TEST_ASSERT_EQUAL(PARAM_OUT_OF_RANGE, params_set(&params, PARAM_ILC_LEAD, 3e38f));
    TEST_ASSERT_EQUAL(PARAM_NOT_WHOLE, params_set(&params, PARAM_ILC_Q_LEN, 1.5f));
    TEST_ASSERT_EQUAL(PARAM_NOT_WHOLE, params_set(&params, PARAM_ILC_LEAD, 1.25f));
    TEST_ASSERT_EQUAL(PARAM_NOT_WHOLE, params_set(&params, PARAM_ILC_LEAD, 0.5000001f));
    TEST_ASSERT_EQUAL(PARAM_UNKNOWN, params_set(&params, PARAM_COUNT, 1.0f));
    TEST_ASSERT_EQUAL(PARAM_UNKNOWN, params_set(&params, (param_t)60000, 1.0f));
    TEST_ASSERT_EQUAL_MEMORY(&before, &params, sizeof params);
}

static void test_the_lead_comes_in_half_beats(void) {
    for (uint32_t halves = 0; halves <= 32u; halves++) {
        const float lead = (float)halves / 2.0f;
        TEST_ASSERT_EQUAL(PARAM_OK, params_set(&params, PARAM_ILC_LEAD, lead));
        TEST_ASSERT_EQUAL_FLOAT(lead, params.value[PARAM_ILC_LEAD]);
    }
    TEST_ASSERT_EQUAL(PARAM_OUT_OF_RANGE, params_set(&params, PARAM_ILC_LEAD, 16.5f));
    TEST_ASSERT_EQUAL(PARAM_OUT_OF_RANGE, params_set(&params, PARAM_ILC_LEAD, -0.5f));
}

static void test_a_value_goes_where_it_belongs(void) {
    params_t expected = params;
    expected.value[PARAM_SERVO_DIR] = -1.0f;
    TEST_ASSERT_EQUAL(PARAM_OK, params_set(&params, PARAM_SERVO_DIR, -1.0f));
    TEST_ASSERT_EQUAL_MEMORY(&expected, &params, sizeof params);
    TEST_ASSERT_EQUAL(-1, params_whole(&params, PARAM_SERVO_DIR));
}

static void test_misuse_is_our_mistake(void) {
    static bool panicked;
    MOCK_EXPECT_PANIC(panicked, (void)params_whole(&params, PARAM_ILC_GAIN));
    TEST_ASSERT_TRUE(panicked);
    MOCK_EXPECT_PANIC(panicked, (void)params_whole(&params, PARAM_ILC_LEAD));
    TEST_ASSERT_TRUE(panicked);
    MOCK_EXPECT_PANIC(panicked, (void)param_info(PARAM_COUNT));
    TEST_ASSERT_TRUE(panicked);
    MOCK_EXPECT_PANIC(panicked, (void)param_renamed(PARAM_RENAMED_COUNT));
    TEST_ASSERT_TRUE(panicked);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_every_row_is_sound);
    RUN_TEST(test_defaults_are_safe_on_an_unknown_fish);
    RUN_TEST(test_sixteen_characters_need_no_terminator);
    RUN_TEST(test_names_must_match_wholly);
    RUN_TEST(test_renamed_parameters_are_found_by_their_old_names_apart);
    RUN_TEST(test_limits_are_inclusive);
    RUN_TEST(test_refusals_change_nothing);
    RUN_TEST(test_the_lead_comes_in_half_beats);
    RUN_TEST(test_a_value_goes_where_it_belongs);
    RUN_TEST(test_misuse_is_our_mistake);
    return UNITY_END();
}
