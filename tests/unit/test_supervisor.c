#include "supervisor/supervisor.h"

#include "mock_hal.h"
#include "unity.h"

void setUp(void) {}
void tearDown(void) {}

typedef struct {
    state_t from;
    event_t event;
    fault_t fault;
    state_t to;
} step_t;

/* All that may happen, written from the state diagram; what is not here is refused. */
static const step_t ALLOWED[] = {
    {STATE_BOOT, EVENT_BOOTED, FAULT_NONE, STATE_IDLE},
    {STATE_IDLE, EVENT_ARM, FAULT_NONE, STATE_ARMED},
    {STATE_IDLE, EVENT_LEARN, FAULT_NONE, STATE_LEARNING},
    {STATE_ARMED, EVENT_DISARM, FAULT_NONE, STATE_IDLE},
    {STATE_ARMED, EVENT_START, FAULT_NONE, STATE_RUNNING},
    {STATE_RUNNING, EVENT_SWUM, FAULT_NONE, STATE_SETTLING},
    {STATE_SETTLING, EVENT_SETTLED, FAULT_NONE, STATE_IDLE},
    {STATE_LEARNING, EVENT_LEARNED, FAULT_NONE, STATE_IDLE},
    {STATE_ABORTED, EVENT_CLEAR, FAULT_NONE, STATE_IDLE},
    {STATE_FAULT, EVENT_CLEAR, FAULT_NONE, STATE_IDLE},

    {STATE_ARMED, EVENT_STOP, FAULT_ABORT_COMMAND, STATE_IDLE},
    {STATE_ARMED, EVENT_STOP, FAULT_LINK_LOST, STATE_IDLE},
    {STATE_ARMED, EVENT_STOP, FAULT_WALL, STATE_IDLE},
    {STATE_RUNNING, EVENT_STOP, FAULT_ABORT_COMMAND, STATE_ABORTED},
    {STATE_RUNNING, EVENT_STOP, FAULT_LINK_LOST, STATE_ABORTED},
    {STATE_RUNNING, EVENT_STOP, FAULT_IMU_STALE, STATE_ABORTED},
    {STATE_RUNNING, EVENT_STOP, FAULT_TILT, STATE_ABORTED},
    {STATE_RUNNING, EVENT_STOP, FAULT_REBOOT, STATE_ABORTED},
    {STATE_RUNNING, EVENT_STOP, FAULT_WALL, STATE_ABORTED},
    {STATE_RUNNING, EVENT_STOP, FAULT_ERROR_LIMIT, STATE_ABORTED},
};

static const fault_t STOPPING_FAULTS[] = {
    FAULT_BATTERY_CRITICAL, FAULT_LATE_TICK,    FAULT_STORAGE,     FAULT_SERVO_CONFIG,
    FAULT_WATCHDOG,         FAULT_CRASH,        FAULT_CLOCK,       FAULT_STORE_RENEWED,
    FAULT_KEY_UNREADABLE,   FAULT_FILE_DAMAGED, FAULT_STORE_OLDER, FAULT_BATTERY_SENSE,
    FAULT_MONITOR,          FAULT_STORE_UNFIT};

/* Refusals, nothing, and a number that no table has. */
static const fault_t NO_STOPS[] = {FAULT_NONE, FAULT_WRONG_STATE, FAULT_WRONG_BEATS, (fault_t)99};

#define COUNT_OF(array) (sizeof(array) / sizeof(array)[0])

static bool is_stopped(state_t state) { return state == STATE_ABORTED || state == STATE_FAULT; }

static state_t expected_state(state_t from, event_t event, fault_t fault, bool *taken) {
    *taken = true;
    for (size_t i = 0; i < COUNT_OF(STOPPING_FAULTS); i++) {
        if (event == EVENT_STOP && fault == STOPPING_FAULTS[i] && from != STATE_BOOT) {
            return STATE_FAULT;
        }
    }
    for (size_t i = 0; i < COUNT_OF(ALLOWED); i++) {
        const step_t *step = &ALLOWED[i];
        const bool fits = step->from == from && step->event == event;
        if (fits && (event != EVENT_STOP || step->fault == fault)) {
            return step->to;
        }
    }
    *taken = false;
    return from;
}

static void check_step(state_t from, event_t event, fault_t fault) {
    supervisor_t supervisor = {from, is_stopped(from) ? FAULT_TILT : FAULT_NONE};
    const fault_t reason_before = supervisor.reason;
    bool expect_taken;
    const state_t expected = expected_state(from, event, fault, &expect_taken);
    TEST_ASSERT_EQUAL_INT(expect_taken, supervisor_event(&supervisor, event, fault));
    TEST_ASSERT_EQUAL_INT_MESSAGE(expected, supervisor.state, state_name(from));
    if (!is_stopped(expected)) {
        TEST_ASSERT_EQUAL_INT(FAULT_NONE, supervisor.reason);
    } else {
        TEST_ASSERT_EQUAL_INT(is_stopped(from) ? reason_before : fault, supervisor.reason);
    }
}

static void every_pair_does_what_the_diagram_says(void) {
    for (int from = 0; from < STATE_COUNT; from++) {
        for (int event = 0; event < EVENT_COUNT; event++) {
            for (uint16_t row = 0; row < fault_count(); row++) {
                check_step((state_t)from, (event_t)event, (fault_t)fault_row(row)->number);
            }
            for (size_t i = 0; i < COUNT_OF(NO_STOPS); i++) {
                check_step((state_t)from, (event_t)event, NO_STOPS[i]);
            }
        }
    }
}

static void all_stopping_faults_are_known_here(void) {
    size_t kinds[4] = {0};
    for (uint16_t row = 0; row < fault_count(); row++) {
        kinds[fault_row(row)->kind]++;
    }
    TEST_ASSERT_EQUAL_size_t(COUNT_OF(STOPPING_FAULTS), kinds[FAULT_KIND_FAULT]);
    TEST_ASSERT_EQUAL_size_t(7, kinds[FAULT_KIND_ABORT]);
}

static void allows_foretells_the_event(void) {
    for (int state = 0; state < STATE_COUNT; state++) {
        for (int event = 0; event < EVENT_COUNT; event++) {
            supervisor_t supervisor = {(state_t)state, FAULT_NONE};
            const bool allowed = supervisor_allows(&supervisor, (event_t)event);
            TEST_ASSERT_EQUAL_INT(state, supervisor.state);
            TEST_ASSERT_EQUAL_INT(
                supervisor_event(&supervisor, (event_t)event, FAULT_ABORT_COMMAND), allowed);
        }
    }
}

static void a_trial_goes_round(void) {
    const event_t way[] = {EVENT_BOOTED,  EVENT_ARM,   EVENT_START,  EVENT_SWUM,
                           EVENT_SETTLED, EVENT_LEARN, EVENT_LEARNED};
    supervisor_t supervisor;
    supervisor_init(&supervisor);
    TEST_ASSERT_EQUAL_INT(STATE_BOOT, supervisor.state);
    for (size_t i = 0; i < COUNT_OF(way); i++) {
        TEST_ASSERT_TRUE(supervisor_event(&supervisor, way[i], FAULT_NONE));
        TEST_ASSERT_EQUAL_INT(way[i] == EVENT_START, supervisor.state == STATE_RUNNING);
        TEST_ASSERT_EQUAL_INT(way[i] == EVENT_ARM || way[i] == EVENT_START,
                              state_is_armed(supervisor.state));
    }
    TEST_ASSERT_EQUAL_INT(STATE_IDLE, supervisor.state);
}

static void only_clear_leads_out_of_a_stop(void) {
    supervisor_t supervisor = {STATE_RUNNING, FAULT_NONE};
    TEST_ASSERT_TRUE(supervisor_event(&supervisor, EVENT_STOP, FAULT_LINK_LOST));
    TEST_ASSERT_FALSE(supervisor_event(&supervisor, EVENT_DISARM, FAULT_NONE));
    TEST_ASSERT_FALSE(supervisor_event(&supervisor, EVENT_ARM, FAULT_NONE));
    TEST_ASSERT_FALSE(supervisor_event(&supervisor, EVENT_STOP, FAULT_TILT));
    TEST_ASSERT_TRUE(supervisor_event(&supervisor, EVENT_STOP, FAULT_STORAGE));
    TEST_ASSERT_EQUAL_INT(STATE_FAULT, supervisor.state);
    TEST_ASSERT_EQUAL_INT(FAULT_LINK_LOST, supervisor.reason);
    TEST_ASSERT_TRUE(supervisor_event(&supervisor, EVENT_CLEAR, FAULT_NONE));
    TEST_ASSERT_EQUAL_INT(STATE_IDLE, supervisor.state);
    TEST_ASSERT_EQUAL_INT(FAULT_NONE, supervisor.reason);
}

static void a_random_walk_keeps_the_rules(void) {
    uint32_t random_state = 7u;
    uint32_t visits[STATE_COUNT] = {0};
    supervisor_t supervisor;
    supervisor_init(&supervisor);
    for (int i = 0; i < 100000; i++) {
        random_state = random_state * 1664525u + 1013904223u;
        const event_t event = (event_t)((random_state >> 8) % EVENT_COUNT);
        const uint16_t row = (uint16_t)((random_state >> 20) % fault_count());
        const supervisor_t before = supervisor;
        const bool taken = supervisor_event(&supervisor, event, (fault_t)fault_row(row)->number);
        visits[supervisor.state]++;
        TEST_ASSERT_EQUAL_INT(is_stopped(supervisor.state), supervisor.reason != FAULT_NONE);
        TEST_ASSERT_TRUE(taken ||
                         (supervisor.state == before.state && supervisor.reason == before.reason));
        if (is_stopped(before.state) && event != EVENT_CLEAR) {
            TEST_ASSERT_TRUE(is_stopped(supervisor.state));
            TEST_ASSERT_EQUAL_INT(before.reason, supervisor.reason);
        }
    }
    for (int state = 1; state < STATE_COUNT; state++) {
        TEST_ASSERT_TRUE_MESSAGE(visits[state] > 100, state_name((state_t)state));
    }
}

static void states_have_names(void) {
    TEST_ASSERT_EQUAL_STRING("BOOT", state_name(STATE_BOOT));
    TEST_ASSERT_EQUAL_STRING("SETTLING", state_name(STATE_SETTLING));
    TEST_ASSERT_EQUAL_STRING("FAULT", state_name(STATE_FAULT));
}

static void what_is_no_event_or_state_is_our_mistake(void) {
    supervisor_t supervisor = {STATE_IDLE, FAULT_NONE};
    volatile bool panicked;
    MOCK_EXPECT_PANIC(panicked, (void)supervisor_event(&supervisor, EVENT_COUNT, FAULT_NONE));
    TEST_ASSERT_TRUE(panicked);
    MOCK_EXPECT_PANIC(panicked, (void)state_name(STATE_COUNT));
    TEST_ASSERT_TRUE(panicked);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(every_pair_does_what_the_diagram_says);
    RUN_TEST(all_stopping_faults_are_known_here);
    RUN_TEST(allows_foretells_the_event);
    RUN_TEST(a_trial_goes_round);
    RUN_TEST(only_clear_leads_out_of_a_stop);
    RUN_TEST(a_random_walk_keeps_the_rules);
    RUN_TEST(states_have_names);
    RUN_TEST(what_is_no_event_or_state_is_our_mistake);
    return UNITY_END();
}
