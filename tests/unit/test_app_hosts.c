/* Two hosts that talk to one board at once, and its battery: who may start what, and when. */
#include "app_fixture.h"

#define BEATS 12u
#define SPEED 0.03f

typedef struct {
    hal_port_t port;
    uint8_t system;
} host_t;

static const host_t LAPTOP = {HAL_PORT_RADIO, 255}, TABLET = {HAL_PORT_CONSOLE, 254};
/* Half of one and half of the other is a third host. */
static const host_t STRANGER[] = {
    {HAL_PORT_CONSOLE, 254}, {HAL_PORT_CONSOLE, 255}, {HAL_PORT_RADIO, 254}};
#define STRANGERS 3u

void setUp(void) {
    fixture_reset();
    host_alive = false;
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
}

void tearDown(void) {}

static fault_t ask(host_t host, link_command_id_t id) {
    const link_command_t request = {.id = id,
                                    .trial = app.trial.next,
                                    .issued_s = (float)hal.now_us * 1e-6f,
                                    .port = host.port,
                                    .system = host.system};
    return app.link.handlers.command(app.link.handlers.context, &request);
}

static void heartbeat(host_t host) {
    app.link.handlers.heartbeat(app.link.handlers.context, host.port, host.system, 190);
}

/* |who| talks every half second. */
static void run_with(host_t who, uint32_t seconds) {
    for (uint32_t i = 0; i < 2u * seconds; i++) {
        heartbeat(who);
        run_ms(500);
    }
}

static void swim_for(host_t host) {
    TEST_ASSERT_EQUAL(FAULT_NONE, ask(host, LINK_COMMAND_ARM));
    TEST_ASSERT_EQUAL(FAULT_NONE, ask(host, LINK_COMMAND_START));
}

/* Whether |text| is among what the board has sent on |port|. */
static bool said(hal_port_t port, const char *text) {
    const size_t length = strlen(text);
    for (size_t i = 0; i + length <= hal.tx[port].tail; i++) {
        if (memcmp(hal.tx[port].bytes + i, text, length) == 0) {
            return true;
        }
    }
    return false;
}

static void test_only_the_host_that_armed_starts(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, ask(LAPTOP, LINK_COMMAND_ARM));
    for (uint32_t i = 0; i < STRANGERS; i++) {
        TEST_ASSERT_EQUAL(FAULT_OTHER_HOST, ask(STRANGER[i], LINK_COMMAND_START));
        TEST_ASSERT_EQUAL(STATE_ARMED, app.supervisor.state);
    }
    TEST_ASSERT_EQUAL(FAULT_NONE, ask(LAPTOP, LINK_COMMAND_START));
    TEST_ASSERT_EQUAL(STATE_RUNNING, app.supervisor.state);
}

static void test_only_the_host_that_armed_keeps_it_armed(void) {
    for (uint32_t i = 0; i < STRANGERS; i++) {
        TEST_ASSERT_EQUAL(FAULT_NONE, ask(LAPTOP, LINK_COMMAND_ARM));
        run_with(STRANGER[i], 6);
        TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
    }
    TEST_ASSERT_EQUAL(FAULT_NONE, ask(LAPTOP, LINK_COMMAND_ARM));
    run_with(LAPTOP, 6);
    TEST_ASSERT_EQUAL(STATE_ARMED, app.supervisor.state);
}

static void test_only_the_host_that_armed_keeps_it_swimming(void) {
    for (uint32_t i = 0; i < STRANGERS; i++) {
        setUp();
        swim_for(LAPTOP);
        run_with(STRANGER[i], 6);
        TEST_ASSERT_EQUAL(STATE_ABORTED, app.supervisor.state);
        TEST_ASSERT_EQUAL(FAULT_LINK_LOST, app.supervisor.reason);
    }
}

static void test_anybody_stops_the_tail(void) {
    const link_command_id_t stop[] = {LINK_COMMAND_ABORT, LINK_COMMAND_DISARM};
    for (uint32_t i = 0; i < 2u * STRANGERS; i++) {
        setUp();
        swim_for(LAPTOP);
        run_with(LAPTOP, 1);
        TEST_ASSERT_EQUAL(FAULT_NONE, ask(STRANGER[i / 2], stop[i % 2]));
        TEST_ASSERT_EQUAL(STATE_ABORTED, app.supervisor.state);
        TEST_ASSERT_EQUAL(FAULT_ABORT_COMMAND, app.supervisor.reason);
    }
}

static void test_arming_again_takes_the_fish_over_and_is_told_to_both(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, ask(LAPTOP, LINK_COMMAND_ARM));
    TEST_ASSERT_EQUAL(FAULT_NONE, ask(LAPTOP, LINK_COMMAND_ARM));
    TEST_ASSERT_FALSE(said(HAL_PORT_RADIO, "another host"));
    TEST_ASSERT_EQUAL(FAULT_NONE, ask(TABLET, LINK_COMMAND_ARM));
    TEST_ASSERT_TRUE(said(HAL_PORT_RADIO, "another host has taken the fish over"));
    TEST_ASSERT_TRUE(said(HAL_PORT_CONSOLE, "another host has taken the fish over"));
    TEST_ASSERT_EQUAL(FAULT_OTHER_HOST, ask(LAPTOP, LINK_COMMAND_START));
    TEST_ASSERT_EQUAL(FAULT_NONE, ask(TABLET, LINK_COMMAND_START));
    run_with(TABLET, 6);
    TEST_ASSERT_EQUAL(STATE_RUNNING, app.supervisor.state);
    run_with(LAPTOP, 6);
    TEST_ASSERT_EQUAL(FAULT_LINK_LOST, app.supervisor.reason);
}

static void test_a_swimming_fish_is_not_taken_over(void) {
    swim_for(LAPTOP);
    for (uint32_t i = 0; i < 12; i++) {
        TEST_ASSERT_EQUAL(FAULT_WRONG_STATE, ask(TABLET, LINK_COMMAND_ARM));
        TEST_ASSERT_EQUAL(FAULT_WRONG_STATE, ask(TABLET, LINK_COMMAND_START));
        run_with(TABLET, 1);
    }
    TEST_ASSERT_EQUAL(FAULT_LINK_LOST, app.supervisor.reason);
}

static void test_a_battery_that_went_low_while_armed_does_not_start(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, ask(LAPTOP, LINK_COMMAND_ARM));
    hal.battery_mv = 6599;
    TEST_ASSERT_EQUAL(FAULT_BATTERY_LOW, ask(LAPTOP, LINK_COMMAND_START));
    hal.battery_mv = 6799;
    TEST_ASSERT_EQUAL(FAULT_BATTERY_LOW, ask(LAPTOP, LINK_COMMAND_START));
    TEST_ASSERT_EQUAL(1, app.trial.next);
    hal.battery_mv = 6800;
    TEST_ASSERT_EQUAL(FAULT_NONE, ask(LAPTOP, LINK_COMMAND_START));
}

static void test_servo_spikes_do_not_stop_a_healthy_battery(void) {
    swim_for(LAPTOP);
    for (uint32_t i = 0; i < 5; i++) {
        hal.battery_mv = 5000;
        heartbeat(LAPTOP);
        run_ms(900);
        hal.battery_mv = 7400;
        run_ms(100);
    }
    TEST_ASSERT_EQUAL(STATE_RUNNING, app.supervisor.state);
}

static void test_an_exhausted_battery_has_to_be_charged(void) {
    swim_for(LAPTOP);
    run_ms(2000);
    hal.battery_mv = 5999;
    run_ms(1100);
    TEST_ASSERT_EQUAL(FAULT_BATTERY_CRITICAL, app.supervisor.reason);
    TEST_ASSERT_EQUAL(FAULT_NONE, ask(LAPTOP, LINK_COMMAND_CLEAR));
    (void)command(LINK_COMMAND_DISCARD, app.trial.run.trial.number);
    hal.battery_mv = 6799; /* what it recovers to with the tail off */
    TEST_ASSERT_EQUAL(FAULT_BATTERY_LOW, ask(LAPTOP, LINK_COMMAND_ARM));
    hal.battery_mv = 6800;
    TEST_ASSERT_EQUAL(FAULT_NONE, ask(LAPTOP, LINK_COMMAND_ARM));
}

static void test_a_battery_low_in_the_swim_is_told_once(void) {
    uint32_t told = 0;
    swim_for(LAPTOP);
    hal.battery_mv = 6500;
    for (uint32_t ms = 0; ms < BEATS * 1000u; ms += 10u) {
        heartbeat(LAPTOP);
        hal.now_us += 10000u;
        hal.now_us % 20000u == 0 ? app_tick_isr(&app) : (void)0;
        app_poll(&app);
        const bool now = said(HAL_PORT_RADIO, "battery low");
        TEST_ASSERT_TRUE(!now || ms >= 5000u);
        told += now;
        hal.tx[HAL_PORT_RADIO].head = hal.tx[HAL_PORT_RADIO].tail = 0;
    }
    TEST_ASSERT_EQUAL(1, told);
    TEST_ASSERT_EQUAL(FAULT_NONE, app.supervisor.reason);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_only_the_host_that_armed_starts);
    RUN_TEST(test_only_the_host_that_armed_keeps_it_armed);
    RUN_TEST(test_only_the_host_that_armed_keeps_it_swimming);
    RUN_TEST(test_anybody_stops_the_tail);
    RUN_TEST(test_arming_again_takes_the_fish_over_and_is_told_to_both);
    RUN_TEST(test_a_swimming_fish_is_not_taken_over);
    RUN_TEST(test_a_battery_that_went_low_while_armed_does_not_start);
    RUN_TEST(test_servo_spikes_do_not_stop_a_healthy_battery);
    RUN_TEST(test_an_exhausted_battery_has_to_be_charged);
    RUN_TEST(test_a_battery_low_in_the_swim_is_told_once);
    return UNITY_END();
}
