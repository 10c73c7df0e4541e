#include "params/params.h"
#include "speed/source.h"
#include "unity.h"

#include <string.h>

void setUp(void) {}
void tearDown(void) {}

/* Stored parameters and trial files know these for ever. A new source gets a new row here. */
static void numbers_and_names_stay(void) {
    static const char *const known[] = {"vision", "upload", "imu", "model"};
    TEST_ASSERT_EQUAL_UINT(sizeof known / sizeof known[0], SPEED_SOURCE_COUNT);
    for (unsigned i = 0; i < SPEED_SOURCE_COUNT; i++) {
        TEST_ASSERT_EQUAL_STRING(known[i], speed_source_name((speed_source_t)i));
    }
}

static void the_parameter_reaches_every_source(void) {
    const param_info_t *info = param_info(PARAM_SPD_SOURCE);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, info->low);
    TEST_ASSERT_EQUAL_FLOAT((float)(SPEED_SOURCE_COUNT - 1), info->high);
}

static void what_is_not_estimated_is_nothing_else(void) {
    for (unsigned i = 0; i < SPEED_SOURCE_COUNT; i++) {
        const speed_source_t source = (speed_source_t)i;
        if (!speed_source_is(source, SPEED_ESTIMATED)) {
            TEST_ASSERT_FALSE(speed_source_is(source, SPEED_SAMPLED));
            TEST_ASSERT_FALSE(speed_source_is(source, SPEED_MODELLED));
            TEST_ASSERT_FALSE(speed_source_is(source, SPEED_LIVE));
        }
    }
}

static void each_trait_is_of_the_sources_that_have_it(void) {
    static const struct {
        speed_trait_t trait;
        bool has[SPEED_SOURCE_COUNT]; /* vision, upload, imu, model */
    } rows[] = {
        {SPEED_ESTIMATED, {true, false, true, true}},
        {SPEED_SAMPLED, {true}},
        {SPEED_MODELLED, {false, false, false, true}},
        {SPEED_NEEDS_IMU, {false, false, true, true}},
        {SPEED_NEEDS_RESTS, {false, false, true}},
        {SPEED_LIVE, {true, false, false, true}},
    };
    for (size_t row = 0; row < sizeof rows / sizeof rows[0]; row++) {
        for (unsigned i = 0; i < SPEED_SOURCE_COUNT; i++) {
            TEST_ASSERT_EQUAL_INT(rows[row].has[i],
                                  speed_source_is((speed_source_t)i, rows[row].trait));
        }
    }
}

static void a_number_beyond_the_table_has_no_trait(void) {
    TEST_ASSERT_FALSE(speed_source_is(SPEED_SOURCE_COUNT, (speed_trait_t)0xff));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(numbers_and_names_stay);
    RUN_TEST(the_parameter_reaches_every_source);
    RUN_TEST(what_is_not_estimated_is_nothing_else);
    RUN_TEST(each_trait_is_of_the_sources_that_have_it);
    RUN_TEST(a_number_beyond_the_table_has_no_trait);
    return UNITY_END();
}
