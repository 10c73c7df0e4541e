#include "blink/blink.h"
#include "trial/control.h"

#include "mock_hal.h"
#include "store/records.h"
#include "target.h"
#include "unity.h"

#include <math.h>
#include <string.h>

#define BEATS 40u
#define FRAMES_PER_BEAT 50u
#define SWIM_FRAMES (BEATS * FRAMES_PER_BEAT)
#define COAST_FRAMES 25u
#define FRAME_US 20000u
#define CENTRE_TICKS 4500u
#define TRIAL 217u

static hal_t hal;
static control_t control;
static control_orders_t orders;
static float amplitude_rad[BEATS];

void setUp(void) {
    mock_hal_init(&hal);
    hal.now_us = 1000000;
    control_init(&control);
    for (uint32_t k = 0; k < BEATS; k++) {
        amplitude_rad[k] = 0.1f + 0.01f * (float)k;
    }
    orders = (control_orders_t){
        .swim = true,
        .armed = true,
        .trial = TRIAL,
        .beats = BEATS,
        .amplitude_rad = amplitude_rad,
        .gait = {.servo = {.centre_us = 1500.0f,
                           .us_per_rad = 573.0f,
                           .min_us = 900.0f,
                           .max_us = 2100.0f,
                           .direction = 1.0f},
                 .frames_per_beat = FRAMES_PER_BEAT,
                 .coast_frames = COAST_FRAMES},
        .limits = {.tick_late_us = 30000, .battery_critical_mv = 6000},
        .battery = {.mv = 8000},
    };
}

void tearDown(void) {}

static control_report_t tick_after(uint32_t gap_us) {
    hal.now_us += gap_us;
    control_tick_isr(&control, &hal);
    return control_report(&control, &hal);
}

static control_report_t tick(void) { return tick_after(FRAME_US); }

static control_report_t ticks(uint32_t count) {
    control_report_t report = control_report(&control, &hal);
    for (uint32_t i = 0; i < count; i++) {
        report = tick();
    }
    return report;
}

/* Each order to swim comes with a record for the monitor. */
static void order(void) {
    static uint8_t record[RECORD_MAX_BYTES];
    params_t params;
    params_reset(&params);
    if (orders.swim) {
        control_offer(&control, record, record_encode_params(&params, record));
    }
    control_order(&control, &hal, &orders);
}

static uint16_t last_pulse(void) { return hal.pulses[hal.pulse_count - 1]; }

/* From here the tail comes to the centre and goes off, within the coast. */
static void assert_coasts_off(void) {
    for (uint32_t i = 0; i < COAST_FRAMES; i++) {
        const control_report_t report = tick();
        if (report.gait.mode == GAIT_OFF) {
            break;
        }
        TEST_ASSERT_EQUAL_INT(GAIT_COAST, report.gait.mode);
        TEST_ASSERT_NOT_EQUAL(0, last_pulse());
    }
    for (uint32_t i = 0; i < 3; i++) {
        TEST_ASSERT_EQUAL_INT(GAIT_OFF, tick().gait.mode);
        TEST_ASSERT_EQUAL_UINT16(0, last_pulse());
    }
}

static uint32_t count_from(uint32_t frame) {
    uint32_t on = 0;
    for (size_t i = frame; i < hal.pulse_count; i++) {
        on += hal.pulses[i] != 0 ? 1u : 0u;
    }
    return on;
}

static void no_orders_no_pulses(void) {
    ticks(200);
    TEST_ASSERT_EQUAL_size_t(200, hal.pulse_count);
    TEST_ASSERT_EQUAL_UINT32(0, count_from(0));
    orders.swim = false;
    order();
    ticks(200);
    TEST_ASSERT_EQUAL_UINT32(0, count_from(0));
    TEST_ASSERT_TRUE(control_report(&control, &hal).swim_start_us == 0);
}

static void the_trial_has_exactly_its_frames(void) {
    order();
    uint32_t swum = 0;
    for (uint32_t i = 0; i < SWIM_FRAMES; i++) {
        const control_report_t report = tick();
        TEST_ASSERT_FALSE(report.finished);
        TEST_ASSERT_EQUAL_UINT16(i / FRAMES_PER_BEAT, report.beats_done);
        TEST_ASSERT_TRUE(report.swim_start_us == 1000000 + 2 * FRAME_US);
        TEST_ASSERT_TRUE(report.tick_us == hal.now_us);
        swum += report.gait.mode == GAIT_SWIM ? 1u : 0u;
    }
    TEST_ASSERT_EQUAL_UINT32(SWIM_FRAMES, swum);
    const control_report_t report = tick();
    TEST_ASSERT_TRUE(report.finished);
    TEST_ASSERT_EQUAL_UINT16(BEATS, report.beats_done);
    TEST_ASSERT_EQUAL_INT(FAULT_NONE, report.stop);
    TEST_ASSERT_EQUAL_INT(GAIT_COAST, report.gait.mode);
    ticks(COAST_FRAMES - 2);
    TEST_ASSERT_EQUAL_INT(GAIT_COAST, tick().gait.mode);
    TEST_ASSERT_EQUAL_UINT16(CENTRE_TICKS, last_pulse());
    ticks(500);
    TEST_ASSERT_EQUAL_UINT32(SWIM_FRAMES + COAST_FRAMES, count_from(0));
    TEST_ASSERT_EQUAL_UINT32(0, control_report(&control, &hal).late_ticks);
}

static void amplitude_changes_only_between_beats(void) {
    order();
    for (uint32_t i = 0; i < SWIM_FRAMES; i++) {
        const control_report_t report = tick();
        const uint32_t frame = i % FRAMES_PER_BEAT;
        const float amplitude = amplitude_rad[i / FRAMES_PER_BEAT];
        const double angle =
            (double)amplitude * sin(2.0 * 3.14159265358979 * frame / FRAMES_PER_BEAT);
        TEST_ASSERT_FLOAT_WITHIN(1e-6f, (float)angle, report.gait.angle_rad);
        TEST_ASSERT_EQUAL_INT(frame == 0, report.gait.beat_start);
        const double pulse = (1500.0 + 573.0 * angle) * 3.0;
        TEST_ASSERT_TRUE(fabs((double)last_pulse() - pulse) < 0.51);
    }
}

static void an_amplitude_is_read_when_its_beat_begins(void) {
    order();
    ticks(FRAMES_PER_BEAT + 10);
    amplitude_rad[1] = 0.9f;
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.11f, control.gait.amplitude_rad);
    tick();
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.11f, control.gait.amplitude_rad);
}

static void bad_amplitudes_are_zero(void) {
    const float bad[] = {-0.5f, NAN, INFINITY, -INFINITY, -0.0f};
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        setUp();
        amplitude_rad[1] = bad[i];
        order();
        ticks(FRAMES_PER_BEAT);
        for (uint32_t frame = 0; frame < FRAMES_PER_BEAT; frame++) {
            tick();
            TEST_ASSERT_EQUAL_UINT16(CENTRE_TICKS, last_pulse());
        }
    }
}

static void a_stop_at_any_frame_coasts_to_rest(void) {
    for (uint32_t at = 1; at <= 3 * FRAMES_PER_BEAT; at++) {
        setUp();
        order();
        ticks(at);
        orders.battery.mv = 5000;
        order();
        assert_coasts_off();
        const control_report_t report = control_report(&control, &hal);
        TEST_ASSERT_EQUAL_INT(FAULT_BATTERY_CRITICAL, report.stop);
        TEST_ASSERT_EQUAL_UINT16(at / FRAMES_PER_BEAT, report.beats_done);
        TEST_ASSERT_FALSE(report.finished);
    }
}

static void a_zeroed_order_at_any_frame_coasts_to_rest(void) {
    const control_orders_t zeroed = {0};
    for (uint32_t at = 1; at <= 2 * FRAMES_PER_BEAT; at++) {
        setUp();
        order();
        ticks(at);
        control_order(&control, &hal, &zeroed);
        TEST_ASSERT_EQUAL_INT(GAIT_COAST, tick().gait.mode);
        assert_coasts_off();
        ticks(2 * FRAMES_PER_BEAT);
        TEST_ASSERT_EQUAL_UINT32(at + COAST_FRAMES, count_from(0));
    }
}

static void a_stop_stays_until_swim_is_taken_back(void) {
    order();
    ticks(60);
    orders.pitch_rad = 2.0f;
    orders.limits.tilt_max_rad = 1.0f;
    order();
    TEST_ASSERT_EQUAL_INT(FAULT_TILT, tick().stop);
    orders.pitch_rad = 0.0f;
    orders.battery.mv = 1;
    order();
    const size_t before = hal.pulse_count + COAST_FRAMES;
    TEST_ASSERT_EQUAL_INT(FAULT_TILT, ticks(500).stop);
    TEST_ASSERT_EQUAL_UINT32(0, count_from((uint32_t)before));

    orders.battery.mv = 8000;
    orders.swim = false;
    order();
    const control_report_t cleared = tick();
    TEST_ASSERT_EQUAL_INT(FAULT_NONE, cleared.stop);
    TEST_ASSERT_EQUAL_UINT16(0, cleared.beats_done);
    TEST_ASSERT_TRUE(cleared.swim_start_us == 0);
    orders.swim = true;
    order();
    const control_report_t again = tick();
    TEST_ASSERT_EQUAL_INT(GAIT_SWIM, again.gait.mode);
    TEST_ASSERT_TRUE(again.swim_start_us == hal.now_us + FRAME_US);
}

static void a_finished_trial_does_not_begin_again(void) {
    orders.beats = 2;
    order();
    ticks(2 * FRAMES_PER_BEAT + COAST_FRAMES);
    const uint32_t frame = (uint32_t)hal.pulse_count;
    ticks(300);
    orders.beats = 5;
    order();
    const control_report_t report = ticks(300);
    TEST_ASSERT_TRUE(report.finished);
    TEST_ASSERT_EQUAL_UINT16(2, report.beats_done);
    TEST_ASSERT_EQUAL_UINT32(0, count_from(frame));
}

/* The main loop may take swim back and give it again between two ticks. */
static void a_stop_shorter_than_a_tick_is_seen(void) {
    order();
    ticks(75);
    orders.swim = false;
    order();
    orders.swim = true;
    orders.trial++;
    order();
    TEST_ASSERT_EQUAL_INT(GAIT_COAST, tick().gait.mode);
    const control_report_t report = ticks(COAST_FRAMES + 1);
    TEST_ASSERT_EQUAL_INT(GAIT_SWIM, report.gait.mode);
    TEST_ASSERT_EQUAL_UINT32(0, report.gait.beat);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, amplitude_rad[0], control.gait.amplitude_rad);
    TEST_ASSERT_EQUAL_UINT16(BEATS, ticks(SWIM_FRAMES).beats_done);
}

static void a_broken_rule_at_the_start_gives_no_pulse(void) {
    orders.battery.mv = 5999;
    order();
    const control_report_t report = ticks(10);
    TEST_ASSERT_EQUAL_INT(FAULT_BATTERY_CRITICAL, report.stop);
    TEST_ASSERT_TRUE(report.swim_start_us == 0);
    TEST_ASSERT_EQUAL_UINT32(0, count_from(0));
}

static void see_battery(uint16_t battery_mv) {
    orders.battery.mv = battery_mv;
    order();
}

/* Ten frames of sag in every eleven never last a second; 50 in a row do. */
static void sags_stop_the_tail_only_when_they_last(void) {
    orders.limits.battery_sag_us = 1000000;
    order();
    tick();
    for (uint32_t i = 0; i < 100; i++) {
        see_battery(5000);
        TEST_ASSERT_EQUAL_INT(FAULT_NONE, ticks(10).stop);
        see_battery(6000);
        TEST_ASSERT_EQUAL_INT(FAULT_NONE, tick().stop);
    }
    see_battery(5999);
    TEST_ASSERT_EQUAL_INT(FAULT_NONE, ticks(49).stop);
    TEST_ASSERT_EQUAL_INT(FAULT_BATTERY_CRITICAL, tick().stop);
    assert_coasts_off();
}

/* With the tail off nothing pulls at the pack: then it is no sag. */
static void a_battery_that_was_critical_before_the_swim_gives_no_pulse(void) {
    orders.limits.battery_sag_us = 1000000;
    orders.swim = false;
    see_battery(5999);
    ticks(60);
    orders.swim = true;
    order();
    const uint32_t frame = (uint32_t)hal.pulse_count;
    TEST_ASSERT_EQUAL_INT(FAULT_BATTERY_CRITICAL, ticks(10).stop);
    TEST_ASSERT_EQUAL_UINT32(0, count_from(frame));
}

static void no_beats_are_no_swim(void) {
    orders.beats = 0;
    orders.amplitude_rad = NULL;
    order();
    TEST_ASSERT_TRUE(ticks(5).finished);
    TEST_ASSERT_EQUAL_UINT32(0, count_from(0));
}

static void a_late_tick_stops_the_swim(void) {
    order();
    ticks(70);
    TEST_ASSERT_EQUAL_INT(FAULT_NONE, tick_after(30000).stop);
    const control_report_t report = tick_after(30001);
    TEST_ASSERT_EQUAL_INT(FAULT_LATE_TICK, report.stop);
    TEST_ASSERT_EQUAL_UINT32(1, report.late_ticks);
    TEST_ASSERT_EQUAL_UINT32(1, tick_after(100000).late_ticks);
}

/* Swims again, the tail off since long; what the monitor makes of it. */
static void expect_no_pulse_again(void) {
    const uint32_t frame = (uint32_t)hal.pulse_count;
    orders.swim = true;
    order();
    TEST_ASSERT_EQUAL_INT(FAULT_MONITOR, tick().stop);
    ticks(SWIM_FRAMES);
    TEST_ASSERT_EQUAL_UINT32(0, count_from(frame));
    orders.swim = false;
    order();
    TEST_ASSERT_EQUAL_INT(FAULT_NONE, tick().stop);
}

static void the_monitor_lets_nobody_swim_a_trial_twice(void) {
    order();
    ticks(70);
    orders.swim = false;
    order();
    ticks(COAST_FRAMES + 1);
    expect_no_pulse_again();
    orders.trial--;
    expect_no_pulse_again();
    orders.trial += 2;
    orders.swim = true;
    order();
    TEST_ASSERT_EQUAL_INT(FAULT_NONE, ticks(70).stop);
    TEST_ASSERT_NOT_EQUAL(0, last_pulse());
}

static void without_a_record_there_is_no_pulse(void) {
    control_order(&control, &hal, &orders);
    const control_report_t report = tick();
    TEST_ASSERT_EQUAL_INT(FAULT_MONITOR, report.stop);
    TEST_ASSERT_EQUAL_UINT16(0, report.gait.pulse_ticks);
    ticks(SWIM_FRAMES);
    TEST_ASSERT_EQUAL_UINT32(0, count_from(0));
    control_stop(&control, &hal);
    order();
    control_stop(&control, &hal); /* which forgets the record as well */
    control_order(&control, &hal, &orders);
    TEST_ASSERT_EQUAL_INT(FAULT_MONITOR, ticks(2).stop);
}

/* As if RAM had changed after the start. */
static void a_pulse_beyond_the_stored_limits_is_the_last(void) {
    order();
    ticks(70);
    control.config.servo.centre_us = 2090.0f;
    control.config.servo.max_us = 2400.0f;
    const uint32_t frame = (uint32_t)hal.pulse_count;
    const control_report_t report = ticks(50);
    TEST_ASSERT_EQUAL_INT(FAULT_MONITOR, report.stop);
    TEST_ASSERT_EQUAL_UINT16(0, report.gait.pulse_ticks);
    for (size_t i = frame; i < hal.pulse_count; i++) {
        TEST_ASSERT_LESS_OR_EQUAL_UINT16(6300, hal.pulses[i]);
    }
    TEST_ASSERT_EQUAL_UINT16(0, last_pulse());
    ticks(SWIM_FRAMES);
    TEST_ASSERT_EQUAL_UINT16(0, last_pulse());
}

static void before_and_after_the_swim_no_tick_is_late(void) {
    tick_after(5000000);
    tick_after(5000000);
    order();
    TEST_ASSERT_EQUAL_INT(FAULT_NONE, tick_after(5000000).stop);
    orders.swim = false;
    order();
    tick();
    TEST_ASSERT_EQUAL_UINT32(0, tick_after(5000000).late_ticks);
}

static void silence_is_judged_by_the_orders_times(void) {
    orders.limits.link_timeout_us = 5000000;
    orders.last_heartbeat_us = 1000000;
    order();
    TEST_ASSERT_EQUAL_INT(FAULT_NONE, ticks(250).stop);
    TEST_ASSERT_EQUAL_INT(FAULT_LINK_LOST, tick().stop);
    setUp();
    orders.limits.imu_timeout_us = 1000000;
    orders.last_imu_us = 1000000;
    order();
    TEST_ASSERT_EQUAL_INT(FAULT_NONE, ticks(50).stop);
    TEST_ASSERT_EQUAL_INT(FAULT_IMU_STALE, tick().stop);
}

static void the_gait_stays_as_it_began(void) {
    order();
    ticks(10);
    orders.gait.frames_per_beat = 20;
    orders.gait.servo.centre_us = 1200.0f;
    order();
    ticks(FRAMES_PER_BEAT - 10);
    TEST_ASSERT_EQUAL_UINT16(0, control_report(&control, &hal).beats_done);
    TEST_ASSERT_TRUE(tick().gait.beat_start);
    TEST_ASSERT_EQUAL_UINT16(CENTRE_TICKS, last_pulse());
}

static void the_led_tells_whether_the_board_is_armed(void) {
    tick();
    TEST_ASSERT_FALSE(hal.led);
    orders.swim = false;
    order();
    TEST_ASSERT_FALSE(hal.led);
    tick();
    TEST_ASSERT_TRUE(hal.led);
    orders.armed = false;
    order();
    tick();
    TEST_ASSERT_FALSE(hal.led);
}

/* Armed now, to blink for a second. Bit i of |on|: lit at tick i. */
static void blink_for_a_second(uint64_t *on, uint32_t count) {
    orders.swim = false;
    orders.blink_until_us = hal.now_us + 1000000u;
    order();
    *on = 0;
    for (uint32_t i = 0; i < count; i++) {
        tick();
        *on |= (uint64_t)hal.led << i;
    }
}

static void the_led_blinks_after_arming_for_as_long_as_asked_then_stays_on(void) {
    uint64_t on;
    blink_for_a_second(&on, 60);
    for (uint32_t i = 0; i < 60; i++) {
        const bool expected = i >= 50 || i / 10 % 2 == 0; /* 0.2 s on, 0.2 s off */
        TEST_ASSERT_EQUAL(expected, on >> i & 1u);
    }
}

static void disarming_ends_the_blinking_in_the_dark(void) {
    uint64_t on;
    blink_for_a_second(&on, 5);
    orders.armed = false;
    order();
    for (uint32_t i = 0; i < 100; i++) {
        tick();
        TEST_ASSERT_FALSE(hal.led);
    }
}

/* Lit before, and exactly as long as pulses of the swim come out: from |start_us| on, a frame after
 * the tick that ordered the first, |frames| of them. */
static void expect_led(uint64_t start_us, uint64_t frames) {
    const bool begun = start_us != 0 && hal.now_us >= start_us;
    const uint64_t n = begun ? (hal.now_us - start_us) / FRAME_US : 0;
    TEST_ASSERT_TRUE(!begun || (hal.now_us - start_us) % FRAME_US == 0);
    TEST_ASSERT_EQUAL(begun ? n < frames && blink_on((uint32_t)n, TRIAL) : true, hal.led);
}

static void the_led_shows_the_code_while_the_swims_pulses_come_out(void) {
    order();
    const uint64_t start_us = tick().swim_start_us;
    TEST_ASSERT_TRUE(start_us == hal.now_us + FRAME_US);
    expect_led(start_us, SWIM_FRAMES);
    TEST_ASSERT_TRUE(hal.led);
    tick();
    TEST_ASSERT_FALSE(hal.led); /* the edge is the begin */
    for (uint32_t i = 0; i < SWIM_FRAMES + 2u * COAST_FRAMES; i++) {
        expect_led(start_us, SWIM_FRAMES);
        tick();
    }
}

/* At whatever time the start comes: lit, then off with the first pulse, then the code. */
static void a_swim_that_begins_while_the_led_blinks_begins_with_the_edge(void) {
    uint64_t on;
    for (uint32_t before = 1; before <= 45; before++) {
        setUp();
        blink_for_a_second(&on, before);
        orders.swim = true;
        order();
        const uint64_t start_us = tick().swim_start_us;
        TEST_ASSERT_TRUE(hal.led);
        for (uint32_t i = 0; i < 2u * BLINK_BLOCK_FRAMES; i++) {
            tick();
            expect_led(start_us, SWIM_FRAMES);
        }
    }
}

static void the_led_stays_dark_after_a_swim_that_ends_while_it_would_blink(void) {
    orders.blink_until_us = hal.now_us + 60000000u;
    orders.beats = 1;
    order();
    ticks(FRAMES_PER_BEAT + 2u);
    for (uint32_t i = 0; i < 200; i++) {
        TEST_ASSERT_FALSE(hal.led);
        tick();
    }
}

typedef enum { BY_RULE, BY_ORDER, BY_ZEROED_ORDER, BY_CALL, STOP_COUNT } stop_t;

static void stop(stop_t how) {
    const control_orders_t zeroed = {0};
    if (how == BY_CALL) {
        control_stop(&control, &hal);
        return;
    }
    orders.swim = orders.armed = how == BY_RULE;
    orders.battery.mv = 5000;
    control_order(&control, &hal, how == BY_ZEROED_ORDER ? &zeroed : &orders);
}

/* The pulse that is ordered still comes out, and its frame is shown; then the LED is dark. */
static void a_stop_ends_the_code_with_the_last_pulse_of_the_swim(void) {
    for (uint32_t at = 1; at <= 3 * FRAMES_PER_BEAT; at += TIMES(1u, 7u)) {
        for (stop_t how = BY_RULE; how < STOP_COUNT; how++) {
            setUp();
            order();
            const uint64_t start_us = tick().swim_start_us;
            ticks(at - 1u);
            expect_led(start_us, at);
            stop(how);
            for (uint32_t i = 0; i < COAST_FRAMES + 5u; i++) {
                tick();
                expect_led(start_us, at);
            }
        }
    }
}

static void the_next_swims_number_does_not_show_in_this_one(void) {
    order();
    const uint64_t start_us = tick().swim_start_us;
    orders.trial = TRIAL + 1u;
    order();
    for (uint32_t i = 0; i < BLINK_BLOCK_FRAMES; i++) {
        tick();
        expect_led(start_us, SWIM_FRAMES);
    }
}

static void clipped_frames_are_reported(void) {
    amplitude_rad[0] = 1.5f;
    order();
    TEST_ASSERT_TRUE(ticks(FRAMES_PER_BEAT).clipped_frames > 10);
}

static void bad_orders_are_our_mistake(void) {
    volatile bool panicked;
    orders.gait.frames_per_beat = 0;
    MOCK_EXPECT_PANIC(panicked, order());
    TEST_ASSERT_TRUE(panicked);
    setUp();
    orders.amplitude_rad = NULL;
    MOCK_EXPECT_PANIC(panicked, order());
    TEST_ASSERT_TRUE(panicked);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(no_orders_no_pulses);
    RUN_TEST(the_trial_has_exactly_its_frames);
    RUN_TEST(amplitude_changes_only_between_beats);
    RUN_TEST(an_amplitude_is_read_when_its_beat_begins);
    RUN_TEST(bad_amplitudes_are_zero);
    RUN_TEST(a_stop_at_any_frame_coasts_to_rest);
    RUN_TEST(a_zeroed_order_at_any_frame_coasts_to_rest);
    RUN_TEST(a_stop_stays_until_swim_is_taken_back);
    RUN_TEST(a_finished_trial_does_not_begin_again);
    RUN_TEST(a_stop_shorter_than_a_tick_is_seen);
    RUN_TEST(a_broken_rule_at_the_start_gives_no_pulse);
    RUN_TEST(sags_stop_the_tail_only_when_they_last);
    RUN_TEST(a_battery_that_was_critical_before_the_swim_gives_no_pulse);
    RUN_TEST(no_beats_are_no_swim);
    RUN_TEST(a_late_tick_stops_the_swim);
    RUN_TEST(the_monitor_lets_nobody_swim_a_trial_twice);
    RUN_TEST(without_a_record_there_is_no_pulse);
    RUN_TEST(a_pulse_beyond_the_stored_limits_is_the_last);
    RUN_TEST(before_and_after_the_swim_no_tick_is_late);
    RUN_TEST(silence_is_judged_by_the_orders_times);
    RUN_TEST(the_gait_stays_as_it_began);
    RUN_TEST(the_led_tells_whether_the_board_is_armed);
    RUN_TEST(the_led_blinks_after_arming_for_as_long_as_asked_then_stays_on);
    RUN_TEST(disarming_ends_the_blinking_in_the_dark);
    RUN_TEST(a_swim_that_begins_while_the_led_blinks_begins_with_the_edge);
    RUN_TEST(the_led_stays_dark_after_a_swim_that_ends_while_it_would_blink);
    RUN_TEST(the_led_shows_the_code_while_the_swims_pulses_come_out);
    RUN_TEST(a_stop_ends_the_code_with_the_last_pulse_of_the_swim);
    RUN_TEST(the_next_swims_number_does_not_show_in_this_one);
    RUN_TEST(clipped_frames_are_reported);
    RUN_TEST(bad_orders_are_our_mistake);
    return UNITY_END();
}
