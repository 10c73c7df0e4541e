/*
 * An abort at every pass of the main loop from arming to the stored trial: before the first frame,
 * in every beat, in the coast, while the trial settles. The board is copied before each, so that
 * all of them strike the same trial.
 */
#include "app_fixture.h"
#include "target.h"

#include <stdio.h>
#include <stdlib.h>

#define BEATS 6u
#define SPEED 0.05f
#define FRAMES_PER_BEAT 50u
#define COAST_FRAMES 25u
#define CENTRE_TICKS 4500
#define PASS_MS 10u
#define STRIDE (ON_TARGET ? 37u : 3u) /* passes between two aborts */

static struct {
    hal_t hal;
    app_t app;
} copy;

static uint32_t frames; /* swum so far, by the pulses */

void setUp(void) {
    fixture_reset();
    frames = 0;
}

void tearDown(void) {}

static void keep(void) {
    copy.hal = hal;
    copy.app = app;
}

static void go_back(void) {
    hal = copy.hal;
    app = copy.app;
}

/* The pulses of the next |ms| begin at hal.pulses[0]. */
static void run_and_record(uint32_t ms) {
    hal.pulse_count = 0;
    run_ms(ms);
    TEST_ASSERT_TRUE(hal.pulse_count <= MOCK_PULSES);
}

static int deviation(size_t at) { return abs((int)hal.pulses[at] - CENTRE_TICKS); }

/* From hal.pulses[0] on the tail comes to the centre within the coast, and goes off. Returns the
 * number of pulses. */
static size_t assert_comes_to_rest(int from) {
    size_t at = 0;
    for (; at < hal.pulse_count && hal.pulses[at] != 0; at++) {
        TEST_ASSERT_TRUE(at < COAST_FRAMES);
        TEST_ASSERT_TRUE(deviation(at) <= from);
        from = deviation(at);
    }
    TEST_ASSERT_TRUE(at == 0 || deviation(at - 1u) == 0);
    return at;
}

static void assert_no_pulse_from(size_t at) {
    for (; at < hal.pulse_count; at++) {
        TEST_ASSERT_EQUAL_UINT16(0, hal.pulses[at]);
    }
}

/* The trial is the one that was cut: every beat that is in it was swum to its end and has its
 * speed. The frame that is out may be the last of its beat. */
static void assert_beats_kept(uint32_t number, bool all_in) {
    const trial_record_t *trial = &app.trial.run.trial;
    TEST_ASSERT_EQUAL_UINT32(number, trial->number);
    TEST_ASSERT_EQUAL(FAULT_ABORT_COMMAND, trial->end);
    TEST_ASSERT_TRUE(trial->executed <= frames / FRAMES_PER_BEAT);
    TEST_ASSERT_TRUE(frames == 0 || trial->executed >= (frames - 1u) / FRAMES_PER_BEAT);
    TEST_ASSERT_EQUAL(trial->executed > 0, app.trial.run.pending);
    for (uint16_t k = 0; k < trial->executed && all_in; k++) {
        TEST_ASSERT_FLOAT_WITHIN(1e-5f, swim_speed_m_s, trial->speed_m_s[k]);
    }
}

/* Learned from or dropped, and the next number starts. */
static void start_next(uint32_t number) {
    if (app.trial.run.pending && command(LINK_COMMAND_LEARN, number) != FAULT_NONE) {
        TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_DISCARD, number));
    }
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_START, number + 1u));
    TEST_ASSERT_EQUAL(STATE_RUNNING, app.supervisor.state);
}

/* From |at| on: off until the orders are given, then from the centre. */
static void assert_swims_from(size_t at) {
    while (at < hal.pulse_count && hal.pulses[at] == 0) {
        at++;
    }
    TEST_ASSERT_EQUAL_UINT16(CENTRE_TICKS, hal.pulses[at]);
    TEST_ASSERT_TRUE(at + 5u < hal.pulse_count && deviation(at + 5u) > 0);
}

/* The operator looks first: the tail is off long before the board is cleared. */
static void abort_then_clear(link_command_id_t id, uint32_t number, int from) {
    TEST_ASSERT_EQUAL(FAULT_NONE, command(id, 0));
    TEST_ASSERT_EQUAL(STATE_ABORTED, app.supervisor.state);
    run_and_record(1600);
    assert_no_pulse_from(assert_comes_to_rest(from));
    TEST_ASSERT_EQUAL(STATE_ABORTED, app.supervisor.state);
    TEST_ASSERT_EQUAL(FAULT_ABORT_COMMAND, app.supervisor.reason);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_CLEAR, 0));
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
    assert_beats_kept(number, true);
    start_next(number);
    run_and_record(200);
    assert_swims_from(0);
}

/* All at once: the next swim waits until the tail is off. */
static void abort_and_go_on(link_command_id_t id, uint32_t number, int from) {
    TEST_ASSERT_EQUAL(FAULT_NONE, command(id, 0));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_CLEAR, 0));
    assert_beats_kept(number, false);
    start_next(number);
    run_and_record(800);
    const size_t off = assert_comes_to_rest(from);
    TEST_ASSERT_EQUAL_UINT16(0, hal.pulses[off]);
    assert_swims_from(off + 1u);
}

static int last_deviation(void) {
    return hal.pulse_count == 0 || hal.pulses[hal.pulse_count - 1u] == 0
               ? 0
               : deviation(hal.pulse_count - 1u);
}

static void test_an_abort_at_any_time_of_a_swim(void) {
    start_trial(BEATS, SPEED);
    const uint32_t number = app.trial.run.trial.number;
    uint32_t aborts = 0, pass = 0;
    hal.pulse_count = 0;
    while (app.supervisor.state == STATE_RUNNING) {
        if (pass % STRIDE == 0) {
            const link_command_id_t id = pass % 2u == 0 ? LINK_COMMAND_ABORT : LINK_COMMAND_DISARM;
            const int from = last_deviation();
            keep();
            abort_then_clear(id, number, from);
            go_back();
            abort_and_go_on(id, number, from);
            go_back();
            aborts += 2u;
        }
        const size_t before = hal.pulse_count;
        run_ms(PASS_MS);
        frames += hal.pulse_count != before && hal.pulses[before] != 0;
        pass++;
    }
    TEST_ASSERT_EQUAL_UINT32(BEATS * FRAMES_PER_BEAT, frames - 1u); /* and one of the coast */
    TEST_ASSERT_TRUE(aborts >= 2u * BEATS);
    printf("%u aborts in a swim of %u beats\n", (unsigned)aborts, BEATS);
}

/* The swim is over: there is nothing left to cut, and the trial is whole. */
static void test_an_abort_in_the_coast_and_while_settling_changes_nothing(void) {
    start_trial(BEATS, SPEED);
    const uint32_t number = app.trial.run.trial.number;
    run_ms(BEATS * 1000u + 20u);
    TEST_ASSERT_EQUAL(STATE_SETTLING, app.supervisor.state);
    for (uint32_t pass = 0; app.supervisor.state == STATE_SETTLING; pass++) {
        const int from = last_deviation();
        hal.pulse_count = 0;
        if (pass % (4u * STRIDE) == 0) {
            keep();
            TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ABORT, 0));
            TEST_ASSERT_EQUAL(STATE_SETTLING, app.supervisor.state);
            run_and_record(4000);
            assert_no_pulse_from(assert_comes_to_rest(pass == 0 ? CENTRE_TICKS : from));
            TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
            TEST_ASSERT_EQUAL(BEATS, app.trial.run.trial.executed);
            TEST_ASSERT_EQUAL(FAULT_NONE, app.trial.run.trial.end);
            start_next(number);
            go_back();
        }
        run_ms(PASS_MS);
    }
    TEST_ASSERT_TRUE(app.trial.run.pending);
}

static void fill_store(void) {
    char path[STORE_PATH_BYTES];
    memset(upload_bytes, 7, sizeof upload_bytes);
    for (uint32_t i = 1; store_free_bytes(&app.vault.store) > RESERVE_BYTES / 2u; i++) {
        (void)snprintf(path, sizeof path, "/trials/%05u.ulg", (unsigned)i);
        TEST_ASSERT_EQUAL(STORE_OK,
                          store_replace(&app.vault.store, path, upload_bytes, sizeof upload_bytes));
    }
}

/* Room for the log is made in many passes; none of them may be in the way of an abort. */
static void test_an_abort_while_armed_disarms_and_nothing_has_moved(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
    fill_store();
    reboot();
    const uint32_t next = app.trial.next;
    uint32_t passes_with_room_to_make = 0;
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
    for (uint32_t pass = 0; pass < 60; pass++) {
        passes_with_room_to_make += app.trial.preparation.room_made ? 0u : 1u;
        hal.pulse_count = 0;
        keep();
        TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ABORT, 0));
        TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
        TEST_ASSERT_EQUAL(FAULT_NONE, app.supervisor.reason);
        run_ms(60);
        assert_no_pulse_from(0);
        TEST_ASSERT_EQUAL_UINT32(next, app.trial.next);
        start_next(next - 1u);
        go_back();
        run_ms(PASS_MS);
    }
    TEST_ASSERT_TRUE(passes_with_room_to_make > 1);
}

/* The tick has seen it, the main loop has not: the tail is stopped for that, not by the abort. */
static void test_an_abort_does_not_hide_what_came_before_it(void) {
    start_trial(BEATS, SPEED);
    run_ms(1500);
    host_alive = false;
    app.trial.host.last_heartbeat_us = 1u;
    app_poll(&app);
    hal.now_us += 5000000u;
    for (int i = 0; i < 2; i++) {
        hal.now_us += 20000u;
        app_tick_isr(&app);
    }
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ABORT, 0));
    TEST_ASSERT_EQUAL(STATE_ABORTED, app.supervisor.state);
    TEST_ASSERT_EQUAL(FAULT_LINK_LOST, app.supervisor.reason);
}

static void test_an_abort_of_a_stopped_board_changes_nothing(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ABORT, 0));
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
    hal.reset_cause = HAL_RESET_WATCHDOG;
    reboot();
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ABORT, 0));
    TEST_ASSERT_EQUAL(STATE_FAULT, app.supervisor.state);
    TEST_ASSERT_EQUAL(FAULT_WATCHDOG, app.supervisor.reason);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_an_abort_at_any_time_of_a_swim);
    RUN_TEST(test_an_abort_in_the_coast_and_while_settling_changes_nothing);
    RUN_TEST(test_an_abort_while_armed_disarms_and_nothing_has_moved);
    RUN_TEST(test_an_abort_does_not_hide_what_came_before_it);
    RUN_TEST(test_an_abort_of_a_stopped_board_changes_nothing);
    return UNITY_END();
}
