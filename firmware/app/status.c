#include "app/status.h"

#include "hal/clock.h"

#include <math.h>

#define SPEED_FRESH_US 1000000u

static float live_speed(const trial_t *trial, uint64_t now_us) {
    const bool fresh =
        trial->live_speed_us != 0 && now_us - trial->live_speed_us < SPEED_FRESH_US;
    return fresh ? trial->live_speed_m_s : NAN;
}

void status_refresh(app_t *app) {
    trial_t *trial = &app->trial;
    const trial_run_t *run = &trial->run;
    const reference_t *reference = &app->learner.reference;
    const control_report_t report = control_report(&trial->control, app->hal);
    const bool swimming =
        app->supervisor.state == STATE_RUNNING && trial->executed < reference->beats;
    app->loop.status = (link_status_t){
        .state = app->supervisor.state,
        .fault = app->supervisor.reason,
        .trial = trial->next - 1u,
        .next_trial = trial->next,
        .open_trial = run->open ? run->trial.number : 0,
        .pending_trial = run->pending ? run->trial.number : 0,
        .reference_crc = reference->crc,
        .beats = reference->beats,
        .beat = swimming ? (uint16_t)report.gait.beat : trial->executed,
        .battery = trial_battery(trial),
        .memory = &app->learner.memory,
        .angle_rad = report.gait.angle_rad,
        .amplitude_rad = swimming ? run->trial.amplitude_rad[trial->executed] : 0.0f,
        .speed_m_s = live_speed(trial, hal_time_us(app->hal)),
        .pulse_ticks = report.gait.pulse_ticks,
        .imu = &app->sensor.imu,
        .still_s = trial_still_s(trial),
        .speed_counters = run->speed.counters,
        .late_ticks = report.late_ticks,
        .longest_pause_us = app->loop.longest_pause_us,
    };
}
