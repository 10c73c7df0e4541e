#include "trial/trial.h"

#include "base/real.h"
#include "hal/clock.h"
#include "hal/system.h"
#include "link/build_id.h"
#include "link/trial_reports.h"
#include "settings/settings.h"
#include "store/erase_ahead.h"
#include "trial/settle.h"

#include <math.h>

#define IMU_FRESH_US 500000u
#define TICK_ALIVE_US 100000u
#define RESULTS_PER_PASS 4u

void trial_init(trial_t *trial, const trial_parts_t *parts) {
    trial->with = *parts;
    trial->live_speed_m_s = NAN;
    control_init(&trial->control);
    trial_run_init(&trial->run, &parts->learner->reference, &parts->learner->memory);
    preparation_init(&trial->preparation, parts->learner, &trial->run);
}

static vault_t *vault_of(const trial_t *trial) { return trial->with.learner->vault; }

void trial_count_from(trial_t *trial, uint32_t number) {
    if (trial->next <= number) {
        trial->next = number + 1u;
    }
}

/* The file of a trial that was learned from stays until the next one replaces it. Without its
 * reference a trial cannot be learned from, but nobody has dropped it either. */
static void load_pending(trial_t *trial) {
    const learner_t *learner = trial->with.learner;
    trial_run_load(&trial->run, learner->vault);
    const trial_record_t *record = &trial->run.trial;
    trial->run.pending = trial->run.pending && record->number > learner->memory.last_trial &&
                         record->reference_crc == learner->reference.crc;
    trial->executed = record->executed;
}

/* The counter is the rule; the others save the number if it is lost. */
void trial_load(trial_t *trial) {
    load_pending(trial);
    trial->next = vault_load_counter(vault_of(trial));
    trial_count_from(trial, trial->with.learner->memory.last_trial);
    trial_count_from(trial, trial->run.trial.number);
    trial_count_from(trial, store_newest_trial(&vault_of(trial)->store));
}

battery_voltage_t trial_battery(const trial_t *trial) {
    return settings_battery(trial->with.params, hal_battery_reading(trial->with.hal));
}

float trial_still_s(const trial_t *trial) { return trial->with.rest->still_s; }

bool trial_is_open(const trial_t *trial) {
    const state_t state = trial->with.supervisor->state;
    return trial->run.open || state == STATE_RUNNING || state == STATE_SETTLING;
}

static fault_t judge_speeds(const trial_t *trial, const speed_upload_t *speeds) {
    if (!trial->run.pending || speeds->trial != trial->run.trial.number) {
        return FAULT_NO_TRIAL;
    }
    if (speeds->beats != trial->run.trial.beats) {
        return FAULT_WRONG_BEATS;
    }
    for (uint16_t k = 0; k < speeds->beats; k++) {
        if (real_abs(speeds->speed_m_s[k]) > trial->with.params->value[PARAM_SPD_PLAUS_M_S]) {
            return FAULT_BAD_DATA;
        }
    }
    return FAULT_NONE;
}

fault_t trial_set_speeds(trial_t *trial, const speed_upload_t *speeds) {
    const uint16_t guard_beats = (uint16_t)params_whole(trial->with.params, PARAM_GUARD_BEATS);
    const fault_t refused = judge_speeds(trial, speeds);
    if (refused != FAULT_NONE) {
        return refused;
    }
    return vault_fault(trial_run_upload(&trial->run, vault_of(trial), speeds, guard_beats,
                                        hal_time_us(trial->with.hal)));
}

fault_t trial_discard(trial_t *trial, uint32_t number) {
    if (!trial->run.pending || number != trial->run.trial.number) {
        return FAULT_NO_TRIAL;
    }
    return vault_fault(trial_run_forget(&trial->run, vault_of(trial)));
}

void trial_stop(trial_t *trial, fault_t asked) {
    const bool cut = trial->with.supervisor->state == STATE_RUNNING;
    const control_report_t report = control_report(&trial->control, trial->with.hal);
    const fault_t reason = cut && report.stop != FAULT_NONE ? report.stop : asked;
    if (!supervisor_event(trial->with.supervisor, EVENT_STOP, reason)) {
        return;
    }
    const uint64_t now_us = hal_time_us(trial->with.hal);
    if (cut) {
        trial->executed = report.beats_done;
        control_stop(&trial->control, trial->with.hal);
        trial->settle_until_us = settle_until_us(trial->with.params, now_us);
    }
    if (reason == FAULT_BATTERY_CRITICAL) {
        battery_exhausted(&trial->battery);
    }
    const trial_run_t *run = &trial->run;
    if (run->open && run->start_us != 0 && run->stage != TRIAL_RUN_ENDED) {
        trial_log_text(&trial->run.log, now_us, fault_info(reason)->name);
    }
    outbox_text(trial->with.outbox, MAV_SEVERITY_WARNING, fault_info(reason)->meaning);
}

static void tell_beat(const trial_t *trial, const trial_run_beat_t *beat) {
    const link_beat_t message = {
        .trial = trial->run.trial.number,
        .beat = beat->beat,
        .amplitude_rad = beat->applied_rad,
        .reference_m_s = beat->reference_m_s,
        .speed = beat->speed,
        .saturated = beat->amplitude_rad > beat->applied_rad,
        .provisional = beat->provisional,
    };
    link_beat(trial->with.outbox, &message);
}

/* Not what the IMU alone says: that is worth nothing until the rest after the swim. */
static bool tells_while_swimming(const trial_t *trial) {
    return speed_source_is(settings_source(trial->with.params), SPEED_LIVE);
}

static bool is_too_far_off(const trial_t *trial, const trial_run_beat_t *beat) {
    const float limit_m_s = trial->with.params->value[PARAM_ERR_MAX_M_S];
    return limit_m_s > 0.0f && beat->speed.measured && tells_while_swimming(trial) &&
           real_abs(beat->reference_m_s - beat->speed.speed_m_s) > limit_m_s;
}

/* The beat that is too far off stays measured: a law that did not see it would never change what
 * stopped the tail, and the series would end at this beat for ever. A swim that is over takes no
 * stop. */
static void settle_beats(trial_t *trial) {
    const bool stopped = trial->with.supervisor->state != STATE_RUNNING;
    trial_run_beat_t beat;
    while (trial_run_settle(&trial->run, trial->executed, stopped, &beat)) {
        tell_beat(trial, &beat);
        if (is_too_far_off(trial, &beat)) {
            trial_stop(trial, FAULT_ERROR_LIMIT);
        }
    }
}

static estimate_rest_t rest_after(const trial_t *trial, uint64_t now_us) {
    return settle_rest_after(trial->with.params, &trial->run, trial->executed, now_us,
                             trial_still_s(trial));
}

/* A trial may end complete and yet have told no speed at all. */
static void tell_refusal(const trial_t *trial, uint64_t now_us) {
    const trial_run_t *run = &trial->run;
    const float rested_s = rest_after(trial, now_us).still_s;
    const bool rested = rested_s >= trial->with.params->value[PARAM_REST_MIN_S];
    const uint16_t trusted =
        stop_rules_trusted_beats((fault_t)run->trial.end, run->told, run->guard_beats);
    if (settle_needs_rest(trial->with.params) && trusted > 0 && run->measured == 0) {
        const fault_t why = rested ? FAULT_RESTS_DIFFER : FAULT_NOT_STILL;
        outbox_text(trial->with.outbox, MAV_SEVERITY_WARNING, fault_info(why)->meaning);
    }
}

static bool end_run(trial_t *trial, uint64_t now_us) {
    const estimate_rest_t after = rest_after(trial, now_us);
    for (uint32_t i = 0; i < RESULTS_PER_PASS; i++) {
        trial_run_beat_t beat;
        bool got = false;
        if (trial_run_end(&trial->run, now_us, trial->with.supervisor->reason, trial->executed,
                          &after, &beat, &got)) {
            return true;
        }
        if (!got) {
            return false;
        }
        tell_beat(trial, &beat);
    }
    return false;
}

bool trial_finish(trial_t *trial, uint64_t now_us) {
    if (!trial->run.open) {
        return true;
    }
    bool ended = false;
    for (uint32_t step = 0; step < TRIAL_RUN_END_STEPS && !ended; step++) {
        ended = end_run(trial, now_us);
        trial_feed_watchdog(trial);
    }
    tell_refusal(trial, now_us);
    erase_ahead_forbid(&vault_of(trial)->store, false);
    const bool stored = trial_run_finish(&trial->run, vault_of(trial)) == STORE_OK;
    workspace_give_back(&vault_of(trial)->workspace, WORKSPACE_ESTIMATE);
    if (!stored) {
        trial_stop(trial, FAULT_STORAGE);
    }
    (void)supervisor_event(trial->with.supervisor, EVENT_SETTLED, FAULT_NONE);
    return stored;
}

static void begin_log(trial_t *trial, uint64_t start_us) {
    trial_log_header_t header = {
        .build_id = link_build_id(),
        .board = hal_board_name(trial->with.hal),
    };
    trial_run_imu_t imu = {
        .alive = trial->with.imu->driver.state == IMU_STREAMING,
        .last = trial->with.imu->last,
    };
    if (!rest_get(trial->with.rest, &imu.rest)) {
        imu.rest.still_s = 0.0f;
    }
    hal_unique_id(trial->with.hal, header.unique_id);
    trial_run_started(&trial->run, start_us, &imu, &vault_of(trial)->store, trial->with.params,
                      &header);
}

static void follow_tail(trial_t *trial, const control_report_t *report, uint64_t now_us) {
    trial->executed = report->beats_done;
    if (report->stop != FAULT_NONE) {
        trial_stop(trial, report->stop);
    } else if (report->finished) {
        (void)supervisor_event(trial->with.supervisor, EVENT_SWUM, FAULT_NONE);
        trial->settle_until_us = settle_until_us(trial->with.params, now_us);
    }
}

static void warn_of_battery(trial_t *trial, uint64_t now_us, uint16_t battery_mv) {
    const uint16_t low_mv = settings_battery_low_mv(trial->with.params);
    if (battery_warns(&trial->battery, now_us, battery_mv, low_mv)) {
        outbox_text(trial->with.outbox, MAV_SEVERITY_WARNING,
                    "battery low: charge it after this trial");
    }
}

static void watch_host(trial_t *trial, uint64_t now_us) {
    const stop_limits_t limits = {.link_timeout_us =
                                      settings_stop_limits(trial->with.params).link_timeout_us};
    const stop_inputs_t inputs = {.now_us = now_us,
                                  .last_heartbeat_us = trial->host.last_heartbeat_us};
    const fault_t fault = stop_rules_check(&limits, &inputs);
    if (fault != FAULT_NONE) {
        trial_stop(trial, fault);
    }
}

/* What is wrong with the IMU has been told. */
static bool imu_is_gone(const trial_t *trial) {
    const imu_driver_t *imu = &trial->with.imu->driver;
    return imu->state != IMU_STREAMING && imu->problem != IMU_PROBLEM_STARTING;
}

static bool has_settled(trial_t *trial, uint64_t now_us) {
    if (trial->with.supervisor->state == STATE_RUNNING) {
        return false;
    }
    const settle_result_t result =
        settle_judge(trial->with.params, &trial->run, trial->executed, trial->settle_until_us,
                     now_us, trial_still_s(trial), imu_is_gone(trial));
    if (result == SETTLE_NO_REST) {
        trial_log_text(&trial->run.log, now_us, fault_info(FAULT_NOT_STILL)->name);
    }
    return result != SETTLE_WAITS;
}

/* Whether the log has begun in this pass. */
static bool follow_swim(trial_t *trial, uint64_t now_us, uint16_t battery_mv) {
    const control_report_t report = control_report(&trial->control, trial->with.hal);
    const bool begun = trial->run.start_us == 0 && report.swim_start_us != 0;
    if (begun) {
        begin_log(trial, report.swim_start_us);
    }
    follow_tail(trial, &report, now_us);
    warn_of_battery(trial, now_us, battery_mv);
    return begun;
}

void trial_poll(trial_t *trial, uint64_t now_us, const battery_voltage_t *battery) {
    bool begun = false;
    if (trial->with.supervisor->state == STATE_RUNNING) {
        begun = follow_swim(trial, now_us, battery->mv);
    }
    if (!trial->run.open || begun) { /* the rest of the log's beginning is for the next pass */
        return;
    }
    trial_run_collect(&trial->run, now_us, battery->mv);
    settle_beats(trial);
    if (has_settled(trial, now_us) && end_run(trial, now_us)) {
        (void)trial_finish(trial, now_us);
    }
}

void trial_prepare(trial_t *trial, uint64_t now_us, bool may_write) {
    if (trial->with.supervisor->state != STATE_ARMED) {
        return;
    }
    if (may_write) {
        preparation_step(&trial->preparation);
    }
    watch_host(trial, now_us);
}

void trial_heartbeat(trial_t *trial, hal_port_t port, uint8_t system) {
    if (host_is(&trial->host, port, system)) {
        trial->host.last_heartbeat_us = hal_time_us(trial->with.hal);
    }
}

void trial_vision(trial_t *trial, const link_vision_t *sample) {
    trial_run_sample(&trial->run, sample->time_us, sample->speed_m_s, sample->sigma_m_s);
    if (real_is_finite(sample->speed_m_s)) {
        trial->live_speed_m_s = sample->speed_m_s;
        trial->live_speed_us = hal_time_us(trial->with.hal);
    }
}

void trial_report_battery(trial_t *trial, const battery_voltage_t *battery) {
    const uint16_t low_mv = settings_battery_low_mv(trial->with.params);
    if (battery->at_limit && battery_tells_limit(&trial->battery, battery, low_mv)) {
        outbox_text(trial->with.outbox, MAV_SEVERITY_WARNING,
                    fault_info(FAULT_BATTERY_SENSE)->meaning);
    }
}

void trial_follow_params(trial_t *trial) {
    trial->gait = settings_gait(trial->with.params, trial->with.learner->reference.beat_s);
    trial->limits = settings_stop_limits(trial->with.params);
}

void trial_give_orders(trial_t *trial, uint64_t now_us, const battery_voltage_t *battery) {
    const imu_t *imu = trial->with.imu;
    const reference_t *reference = &trial->with.learner->reference;
    const bool level_known = imu->last_us != 0 && now_us - imu->last_us < IMU_FRESH_US;
    if (trial->with.supervisor->state != STATE_RUNNING) {
        trial_follow_params(trial);
    }
    const control_orders_t orders = {
        .swim = trial->with.supervisor->state == STATE_RUNNING,
        .armed = state_is_armed(trial->with.supervisor->state),
        .blink_until_us = trial->blink_until_us,
        .trial = trial->run.trial.number,
        .beats = reference->beats,
        .amplitude_rad = trial->run.trial.amplitude_rad,
        .gait = trial->gait,
        .limits = trial->limits,
        .last_heartbeat_us = trial->host.last_heartbeat_us,
        .last_imu_us = imu->last_us,
        .battery = *battery,
        .pitch_rad = level_known ? imu->last.ypr_deg[1] * REAL_RAD_PER_DEG : 0.0f,
        .roll_rad = level_known ? imu->last.ypr_deg[2] * REAL_RAD_PER_DEG : 0.0f,
    };
    control_order(&trial->control, trial->with.hal, &orders);
}

/* A long pass saw ticks come that are later than its beginning. */
void trial_feed_watchdog(trial_t *trial) {
    const uint64_t tick_us = control_report(&trial->control, trial->with.hal).tick_us;
    if (hal_time_us(trial->with.hal) - tick_us < TICK_ALIVE_US) {
        hal_watchdog_feed(trial->with.hal);
    }
}

void trial_tick_isr(trial_t *trial) { control_tick_isr(&trial->control, trial->with.hal); }
