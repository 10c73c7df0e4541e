/* How many flash pages one pass of the main loop writes: at 10 ms each, the slowest the hardware is
 * expected to be, ten would be a longer pause than the 100 ms that a swim allows. */
#include "app_fixture.h"

#define PASS_MS 10u /* of run_ms() */
#define PAGES_MAX 9u
#define BEATS 20u
#define TRIALS 25u

void setUp(void) { fixture_reset(); }
void tearDown(void) {}

/* The most pages of one pass from the start to the end of the trial. */
static uint32_t swim_and_count(void) {
    uint32_t most = 0;
    for (uint32_t ms = 0; ms < BEATS * 1000u + 5000u; ms += PASS_MS) {
        const uint32_t before = hal.flash_writes;
        run_ms(PASS_MS);
        const uint32_t pages = hal.flash_writes - before;
        most = pages > most ? pages : most;
    }
    return most;
}

/* |most| of all trials. Old trials are removed, folders compacted and split on the way. */
static uint32_t most_pages_of_many_trials(void) {
    uint32_t most = 0;
    for (uint32_t n = 1; n <= TRIALS; n++) {
        start_trial(BEATS, 0.04f);
        const uint32_t pages = swim_and_count();
        most = pages > most ? pages : most;
        TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
        TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_DISCARD, n));
        hal.pulse_count = 0;
    }
    TEST_ASSERT_EQUAL_UINT32(0, app.vault.store.failures);
    return most;
}

static void test_with_a_camera(void) {
    TEST_ASSERT_LESS_OR_EQUAL_UINT32(PAGES_MAX, most_pages_of_many_trials());
}

/* Hardly anything to log: what a sync leaves half full is moved again and again. */
static void test_without_a_camera(void) {
    camera_on = false;
    TEST_ASSERT_LESS_OR_EQUAL_UINT32(PAGES_MAX, most_pages_of_many_trials());
}

static void test_while_armed(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, 0.04f));
    for (uint32_t n = 1; n <= 2u * TRIALS; n++) {
        char path[STORE_PATH_BYTES];
        trial_log_path(n, path);
        TEST_ASSERT_EQUAL(STORE_OK, store_replace(&app.vault.store, path, hal.flash, 4000));
    }
    const uint32_t before = hal.flash_writes;
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
    TEST_ASSERT_EQUAL_UINT32(before, hal.flash_writes);
    run_ms(5000);
    TEST_ASSERT_TRUE(app.trial.preparation.room_made);
    const uint32_t armed = hal.flash_writes;
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_START, app.trial.next));
    TEST_ASSERT_LESS_OR_EQUAL_UINT32(PAGES_MAX, hal.flash_writes - armed);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_with_a_camera);
    RUN_TEST(test_without_a_camera);
    RUN_TEST(test_while_armed);
    return UNITY_END();
}
