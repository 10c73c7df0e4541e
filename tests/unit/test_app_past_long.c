/* Averages of references so long that the storage has no room for all trials. */
#include "past_fixture.h"
#include "target.h"

#define SPEED 0.05f

void setUp(void) {
    fixture_reset();
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_ROLLBACK_RATIO, 0.0f));
}
void tearDown(void) {}

static void swim_long(uint16_t beats) {
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_START, app.trial.next));
    run_in_steps_ms(20, beats * 1000u);
    run_ms(5000);
    TEST_ASSERT_TRUE(app.trial.run.pending);
}

/* Beside a log of that length there is room for |least| trials of the average at least, less than
 * |window| or all: it goes on with those, and says so whenever it could be longer. */
static void check_long(uint16_t beats, uint16_t window, uint32_t least, uint32_t trials_most) {
    set(PARAM_ILC_KIND, PAST_WINDOW);
    set(PARAM_ILC_WINDOW, (float)window);
    set(PARAM_TANK_LEN_M, 0.0f);
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(beats, SPEED));
    uint32_t before = 0, trials = 0, told = 0;
    for (uint32_t number = 1; number <= trials_most; number++, before = trials) {
        swim_speed_m_s = 0.03f + 0.001f * (float)number;
        swim_long(beats);
        learn();
        trials = trials_in_average();
        told += told_missing();
        TEST_ASSERT_GREATER_OR_EQUAL(number < least ? number : least, trials);
        TEST_ASSERT_EQUAL(trials < window && trials <= before, told_missing());
    }
    TEST_ASSERT_EQUAL(least < window, trials < window);
    TEST_ASSERT_EQUAL(least<window, told> 0);
}

static void test_the_longest_reference_goes_on_with_what_there_is_room_for(void) {
    check_long(BEATS_MAX, 3, 1, 5);
}

static void test_a_long_reference_goes_on_with_what_there_is_room_for(void) {
    check_long(480, PAST_WINDOW_MAX, 4, 8);
}

static void test_what_there_is_room_for_is_all_averaged(void) {
    check_long(384, PAST_WINDOW_MAX, PAST_WINDOW_MAX, PAST_WINDOW_MAX + 1u);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_the_longest_reference_goes_on_with_what_there_is_room_for);
    RUN_ON_HOST(test_a_long_reference_goes_on_with_what_there_is_room_for);
    RUN_ON_HOST(test_what_there_is_room_for_is_all_averaged);
    return UNITY_END();
}
