#include "trial/control.h"

#include "base/panic.h"
#include "base/real.h"
#include "base/units.h"
#include "blink/blink.h"
#include "hal/clock.h"
#include "hal/servo.h"
#include "hal/system.h"

#include <stddef.h>

#define BLINK_HALF_US 200000u /* twice a symbol of blink.h: nobody takes it for a swim */

void control_init(control_t *control) {
    *control = (control_t){0};
    gait_init(&control->gait);
}

/* The frame that is out fills its beat. */
static bool beat_is_over(const control_t *control) {
    const gait_t *gait = &control->gait;
    return gait->mode == GAIT_SWIM && gait->frame + 1u >= control->config.frames_per_beat;
}

static void forget_swim(control_report_t *report) {
    report->swim_start_us = 0;
    report->beats_done = 0;
    report->finished = false;
    report->stop = FAULT_NONE;
}

/* Before the swim the gap to the last tick does not matter. */
static uint64_t last_swum_us(const control_t *control, uint64_t now_us) {
    return control->gait.mode == GAIT_SWIM ? control->report.tick_us : now_us;
}

static fault_t check_rules(const control_t *control, uint64_t now_us) {
    const control_orders_t *orders = &control->orders;
    const stop_inputs_t inputs = {
        .now_us = now_us,
        .last_tick_us = last_swum_us(control, now_us),
        .last_heartbeat_us = orders->last_heartbeat_us,
        .last_imu_us = orders->last_imu_us,
        .battery_ok_us = control->battery_ok_us,
        .battery_mv = orders->battery.mv,
        .battery_at_limit = orders->battery.at_limit,
        .pitch_rad = orders->pitch_rad,
        .roll_rad = orders->roll_rad,
    };
    return stop_rules_check(&orders->limits, &inputs);
}

static void watch_battery(control_t *control, uint64_t now_us) {
    const control_orders_t *orders = &control->orders;
    const stop_inputs_t inputs = {.battery_mv = orders->battery.mv,
                                  .battery_at_limit = orders->battery.at_limit};
    if (stop_rules_battery_ok(&orders->limits, &inputs)) {
        control->battery_ok_us = now_us;
    }
}

static void count_late_tick(control_t *control, uint64_t now_us) {
    const uint32_t late_us = control->orders.limits.tick_late_us;
    if (late_us != 0 && now_us - last_swum_us(control, now_us) > late_us) {
        control->report.late_ticks++;
    }
}

/* Whether the tail swims in this frame. */
static bool decide(control_t *control, uint64_t now_us) {
    control_report_t *report = &control->report;
    const bool swim = control->orders.swim && !control->stop_ordered;
    control->stop_ordered = false;
    if (!swim) {
        forget_swim(report);
        return false;
    }
    count_late_tick(control, now_us);
    if (report->finished || report->stop != FAULT_NONE) {
        return false;
    }
    if (beat_is_over(control)) {
        report->beats_done++;
    }
    report->finished = report->beats_done >= control->orders.beats;
    if (!report->finished) {
        report->stop = check_rules(control, now_us);
    }
    return !report->finished && report->stop == FAULT_NONE;
}

static float next_amplitude(const control_t *control) {
    if (control->gait.mode != GAIT_OFF && !beat_is_over(control)) {
        return control->gait.amplitude_rad;
    }
    const float amplitude_rad = control->orders.amplitude_rad[control->report.beats_done];
    return real_is_finite(amplitude_rad) && amplitude_rad > 0.0f ? amplitude_rad : 0.0f;
}

/* In halves that end with |blink_until_us|, the last one lit. A swim that is due lights it for the
 * frame before, so that the code begins with an edge whenever the start comes. */
static bool is_lit(const control_orders_t *orders, uint64_t now_us) {
    if (orders->swim || now_us >= orders->blink_until_us) {
        return orders->armed;
    }
    const uint32_t left_us = (uint32_t)(orders->blink_until_us - now_us);
    return orders->armed && left_us / BLINK_HALF_US % 2u == 0;
}

/* Before the gait goes on: what it ordered last comes out in the frame that begins now. */
static void show(const control_t *control, hal_t *hal, uint64_t now_us) {
    const gait_t *gait = &control->gait;
    const control_report_t *report = &control->report;
    const bool over = report->finished || report->stop != FAULT_NONE;
    bool on = is_lit(&control->orders, now_us) && !over;
    if (gait->mode == GAIT_SWIM) {
        const uint32_t frame = gait->beat * control->config.frames_per_beat + gait->frame;
        on = blink_on(frame, control->trial);
    }
    hal_led_isr(hal, on);
}

void control_tick_isr(control_t *control, hal_t *hal) {
    const uint64_t now_us = hal_time_us(hal);
    control_report_t *report = &control->report;
    show(control, hal, now_us);
    watch_battery(control, now_us);
    const bool swim = decide(control, now_us);
    if (control->gait.mode == GAIT_OFF) {
        control->config = control->orders.gait;
        control->trial = control->orders.trial;
    }
    const gait_command_t command = {
        .swim = swim,
        .amplitude_rad = swim ? next_amplitude(control) : 0.0f,
    };
    report->gait = gait_frame_isr(&control->gait, &control->config, command);
    hal_servo_pulse_isr(hal, HAL_SERVO_TAIL, report->gait.pulse_ticks);
    if (report->gait.beat_start && report->gait.beat == 0) {
        report->swim_start_us = now_us + FRAME_US;
    }
    report->tick_us = now_us;
    report->clipped_frames = control->gait.servo.clipped_frames;
}

void control_order(control_t *control, hal_t *hal, const control_orders_t *orders) {
    REQUIRE(!orders->swim || gait_config_valid(&orders->gait));
    REQUIRE(!orders->swim || orders->beats == 0 || orders->amplitude_rad != NULL);
    hal_irq_lock(hal);
    control->orders = *orders;
    control->stop_ordered = control->stop_ordered || !orders->swim;
    hal_irq_unlock(hal);
}

void control_stop(control_t *control, hal_t *hal) {
    hal_irq_lock(hal);
    control->orders.swim = false;
    control->orders.armed = false;
    control->stop_ordered = true;
    forget_swim(&control->report);
    hal_irq_unlock(hal);
}

control_report_t control_report(control_t *control, hal_t *hal) {
    hal_irq_lock(hal);
    const control_report_t report = control->report;
    hal_irq_unlock(hal);
    return report;
}
