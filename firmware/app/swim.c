#include "app/app_internal.h"
#include "app/settings.h"
#include "base/real.h"
#include "base/units.h"
#include "hal/clock.h"
#include "hal/system.h"

#include <math.h>
#include <string.h>

#define START_STALE_S 2.0f
#define ROOM_LINK_US 500000u
#define ROOM_STEPS_MAX (2u * STORE_BLOCKS) /* no more files than that fit */
#define REST_WAIT_S 30.0f /* for the fish to come to rest after the swim, when that is needed */
#define RESULTS_PER_PASS 4u

/* Asked with the tail off, when nothing pulls the voltage down. */
static fault_t judge_battery(app_t *app) {
    const battery_voltage_t voltage = app_battery(app);
    return battery_judge(&app->battery, &voltage, settings_battery_low_mv(&app->params));
}

static fault_t ready_to_arm(const app_t *app) {
    const law_t law = settings_law(&app->params, app->reference.beat_s);
    const gait_config_t gait = settings_gait(&app->params, app->reference.beat_s);
    if (!supervisor_allows(&app->supervisor, EVENT_ARM) || app->reboot_at_us != 0) {
        return FAULT_WRONG_STATE;
    }
    if (!hal_clock_exact(app->hal)) {
        return FAULT_CLOCK;
    }
    if (app->run.pending) {
        return FAULT_TRIAL_PENDING;
    }
    if (app->reference.beats == 0) {
        return FAULT_NO_REFERENCE;
    }
    if (!gait_config_valid(&gait)) {
        return FAULT_SERVO_CONFIG;
    }
    if (!settings_law_fits(&app->params, &law, app->reference.beats)) {
        return FAULT_BAD_LAW;
    }
    return uploads_judge_reference(app, &app->reference);
}

/* u_1 follows the gain of the moment until something has been learned. */
static fault_t guess_first(app_t *app) {
    if (app->memory.iteration != 0 && app->memory.input != MEMORY_INPUT_FIRST) {
        return FAULT_NONE;
    }
    const law_t law = settings_law(&app->params, app->reference.beat_s);
    return memory_first(&app->memory, &law, app->reference.speed_m_s, app->scratch) == LAW_OK
               ? FAULT_NONE
               : FAULT_BAD_LAW;
}

static bool needs_rest(const app_t *app) {
    return speed_source_is(settings_source(&app->params), SPEED_NEEDS_RESTS);
}

static float trial_s(const app_t *app) {
    const float swim_s = (float)app->reference.beats * app->reference.beat_s;
    const float settle_s =
        app->params.value[PARAM_SETTLE_S] + (needs_rest(app) ? REST_WAIT_S : 0.0f);
    return swim_s + settle_s;
}

/* Hosts are told apart by port and system. */
static bool is_by_armer(const app_t *app, const link_command_t *command) {
    return command->port == app->armed_port && command->system == app->armed_system;
}

fault_t swim_arm(app_t *app, const link_command_t *command) {
    if (app->supervisor.state != STATE_ARMED) {
        fault_t fault = ready_to_arm(app);
        if (fault == FAULT_NONE) {
            fault = judge_battery(app);
        }
        if (fault == FAULT_NONE) {
            fault = key_reserve(app, trial_s(app));
        }
        if (fault == FAULT_NONE) {
            fault = guess_first(app);
        }
        if (fault != FAULT_NONE) {
            return fault;
        }
        app->room_made = false;
        app->guess_tried = app->guess_stored = app->memory.input != MEMORY_INPUT_FIRST;
        (void)supervisor_event(&app->supervisor, EVENT_ARM, FAULT_NONE);
    } else if (!is_by_armer(app, command)) {
        link_text(&app->link, MAV_SEVERITY_NOTICE, "another host has taken the fish over");
    }
    app->armed_port = command->port;
    app->armed_system = command->system;
    app->last_heartbeat_us = hal_time_us(app->hal);
    app->blink_until_us = app->last_heartbeat_us + real_whole_u64(command->blink_s * 1e6f);
    return FAULT_NONE;
}

static bool is_stale(const app_t *app, float issued_s) {
    const float now_s = (float)units_thousandth(hal_time_us(app->hal)) * 1e-3f;
    /* A time to come is one of an earlier boot. Written so that NaN (no time given) is stale. */
    return !(real_abs(now_s - issued_s) <= START_STALE_S);
}

static fault_t save_counter(app_t *app) {
    return critical_count(&app->store, app->next_trial) == STORE_OK ? FAULT_NONE
                                                                    : FAULT_WRITE_FAILED;
}

static uint32_t log_bytes(const app_t *app) {
    return trial_log_size_bound(app->reference.beats, (uint32_t)trial_s(app) + 1u);
}

/* The file of a trial that was learned from, if it takes more than a block. The next trial replaces
 * it at less cost, but needs room beside it. */
static bool drop_learned_trial(app_t *app) {
    uint32_t length = 0;
    return !app->run.pending && store_size(&app->store, PENDING_PATH, &length) == STORE_OK &&
           length > STORE_BLOCK_BYTES && trial_run_forget(&app->run, &app->store) == STORE_OK;
}

/* Past trials that no law reads go ahead of any log, the others after all of them, oldest first: a
 * fish that cannot swim learns nothing, and a short average is better than none. */
static store_result_t make_space_step(app_t *app, bool *done) {
    if (past_drop(app, past_reach(app)) || drop_learned_trial(app)) {
        return STORE_OK;
    }
    const uint32_t bytes = log_bytes(app) + past_room_bytes(app);
    const store_result_t result = store_make_space_step(&app->store, bytes, 0, done);
    return result == STORE_NO_SPACE && past_drop(app, 0) ? STORE_OK : result;
}

/* What fails here fails at the start too, and is told then. */
static void make_room_step(app_t *app) {
    const store_result_t result = make_space_step(app, &app->room_made);
    app->room_made = app->room_made || result != STORE_OK;
}

/* A failed save went back to what is stored; the board stays armed and needs its guess. */
static fault_t save_first_guess(app_t *app) {
    if (app->guess_stored) {
        return FAULT_NONE;
    }
    const fault_t saved = learn_save(app);
    app->guess_tried = true;
    app->guess_stored = saved == FAULT_NONE;
    return saved == FAULT_NONE || guess_first(app) == FAULT_NONE ? saved : FAULT_BAD_LAW;
}

/* A step per pass while armed, so that the start has little to write. The hosts wait meanwhile, but
 * not so long that they seem lost. */
static void make_ready(app_t *app, uint64_t now_us) {
    if (now_us - app->last_link_us >= ROOM_LINK_US) {
        return;
    }
    if (!app->room_made) {
        make_room_step(app);
    } else if (!app->guess_tried) {
        (void)save_first_guess(app);
    }
}

/* Once more: uploads may have taken the room that was made. */
static bool has_room(app_t *app) {
    bool made = false;
    store_result_t result = STORE_OK;
    for (uint32_t i = 0; i < ROOM_STEPS_MAX && result == STORE_OK && !made; i++) {
        result = make_space_step(app, &made);
        app_feed_watchdog(app);
    }
    return result == STORE_OK && made;
}

/* Everything that writes flash and can be done before the tail moves. */
static fault_t prepare_store(app_t *app) {
    if (!has_room(app)) {
        return FAULT_WRITE_FAILED;
    }
    /* Armed long ago, perhaps. */
    const fault_t reserved = key_reserve(app, trial_s(app));
    if (reserved != FAULT_NONE) {
        return reserved;
    }
    app->next_trial++;
    const fault_t counted = save_counter(app);
    if (counted != FAULT_NONE) {
        app->next_trial--;
        return counted;
    }
    return save_first_guess(app);
}

float swim_still_s(const app_t *app) { return app->rest.still_s; }

/* What the speed source asks of the IMU and of the hand that holds the fish. */
static fault_t ready_to_measure(const app_t *app) {
    if (settings_need_imu(&app->params) && app->imu.driver.state != IMU_STREAMING) {
        return FAULT_NO_IMU;
    }
    if (needs_rest(app) && swim_still_s(app) < app->params.value[PARAM_REST_MIN_S]) {
        return FAULT_NOT_STILL;
    }
    return FAULT_NONE;
}

fault_t swim_start(app_t *app, const link_command_t *command) {
    if (app->supervisor.state == STATE_RUNNING && command->trial == app->run.trial.number) {
        return FAULT_NONE;
    }
    if (!supervisor_allows(&app->supervisor, EVENT_START)) {
        return FAULT_WRONG_STATE;
    }
    if (!is_by_armer(app, command)) {
        return FAULT_OTHER_HOST;
    }
    if (command->trial != app->next_trial) {
        return FAULT_TRIAL_NUMBER;
    }
    if (is_stale(app, command->issued_s)) {
        return FAULT_STALE_COMMAND;
    }
    const fault_t measurable = ready_to_measure(app);
    if (measurable != FAULT_NONE) {
        return measurable;
    }
    const fault_t powered = judge_battery(app);
    if (powered != FAULT_NONE) {
        return powered;
    }
    const fault_t prepared = prepare_store(app);
    if (prepared != FAULT_NONE) {
        return prepared;
    }
    const law_t law = settings_law(&app->params, app->reference.beat_s);
    for (uint16_t k = 0; k < app->reference.beats; k++) {
        app->scratch[k] = law_saturate(&law, app->memory.amplitude_rad[k]);
    }
    const trial_run_plan_t plan = {
        .number = command->trial,
        .applied_rad = app->scratch,
        .estimate = settings_estimate(&app->params, app->reference.beat_s, app->reference.beats),
        .guard_beats = (uint16_t)params_whole(&app->params, PARAM_GUARD_BEATS),
        .late_s = app->params.value[PARAM_SPD_LATE_S],
        .rate_scale_sigma = app->params.value[PARAM_IMU_SCALE_SD],
    };
    trial_run_begin(&app->run, &plan);
    app->executed = 0;
    /* Making space may have taken longer than the host may be silent. */
    app->last_heartbeat_us = hal_time_us(app->hal);
    battery_begin_swim(&app->battery, app->last_heartbeat_us);
    (void)supervisor_event(&app->supervisor, EVENT_START, FAULT_NONE);
    return FAULT_NONE;
}

static void settle_from(app_t *app, uint64_t now_us) {
    const float settle_s = app->params.value[PARAM_SETTLE_S];
    app->settle_until_us = now_us + real_whole_u64(settle_s * 1e6f);
}

void swim_stop(app_t *app, fault_t asked) {
    const bool cut = app->supervisor.state == STATE_RUNNING;
    const control_report_t report = control_report(&app->control, app->hal);
    /* What stopped the tail came first, though the main loop had not seen it yet. */
    const fault_t reason = cut && report.stop != FAULT_NONE ? report.stop : asked;
    if (!supervisor_event(&app->supervisor, EVENT_STOP, reason)) {
        return;
    }
    const uint64_t now_us = hal_time_us(app->hal);
    if (cut) {
        app->executed = report.beats_done;
        control_stop(&app->control, app->hal);
        settle_from(app, now_us);
    }
    if (reason == FAULT_BATTERY_CRITICAL) {
        battery_exhausted(&app->battery);
    }
    if (app->run.open && app->run.start_us != 0 && app->run.stage != TRIAL_RUN_ENDED) {
        trial_log_text(&app->run.log, now_us, fault_info(reason)->name);
    }
    link_text(&app->link, MAV_SEVERITY_WARNING, fault_info(reason)->meaning);
}

static void tell_beat(app_t *app, const trial_run_beat_t *beat) {
    const link_beat_t message = {
        .trial = app->run.trial.number,
        .beat = beat->beat,
        .amplitude_rad = beat->applied_rad,
        .reference_m_s = beat->reference_m_s,
        .speed = beat->speed,
        .saturated = beat->amplitude_rad > beat->applied_rad,
        .provisional = beat->provisional,
    };
    link_beat(&app->link, &message);
}

/* Not what the IMU alone says: that is worth nothing until the rest after the swim. */
static bool tells_while_swimming(const app_t *app) {
    return speed_source_is(settings_source(&app->params), SPEED_LIVE);
}

static bool is_too_far_off(const app_t *app, const trial_run_beat_t *beat) {
    const float limit_m_s = app->params.value[PARAM_ERR_MAX_M_S];
    return limit_m_s > 0.0f && beat->speed.measured && tells_while_swimming(app) &&
           real_abs(beat->reference_m_s - beat->speed.speed_m_s) > limit_m_s;
}

/* The beat that is too far off stays measured: a law that did not see it would never change what
 * stopped the tail, and the series would end at this beat for ever. A swim that is over takes no
 * stop. */
static void settle_beats(app_t *app) {
    const bool stopped = app->supervisor.state != STATE_RUNNING;
    trial_run_beat_t beat;
    while (trial_run_settle(&app->run, app->executed, stopped, &beat)) {
        tell_beat(app, &beat);
        if (is_too_far_off(app, &beat)) {
            swim_stop(app, FAULT_ERROR_LIMIT);
        }
    }
}

/* The estimate believes only the second half of the rest after the swim: the first may have been a
 * coast. */
static float rest_after_min_s(const app_t *app) {
    const float beat_s = app->reference.beat_s;
    const float twice_s = 2.0f * app->params.value[PARAM_REST_MIN_S];
    const float least_s = 4.0f * beat_s; /* a whole beat in its second half, wherever they begin */
    const float most_s = (float)(SMOOTHER_AFTER - 4u) * beat_s;
    return real_clip(twice_s, least_s, most_s);
}

static estimate_rest_t rest_after(const app_t *app, uint64_t now_us) {
    return needs_rest(app)
               ? trial_run_rest_after(&app->run, app->executed, now_us, swim_still_s(app))
               : (estimate_rest_t){0};
}

/* A trial may end complete and yet have told no speed at all. */
static void tell_refusal(app_t *app, uint64_t now_us) {
    const float rested_s = rest_after(app, now_us).still_s;
    const bool rested = rested_s >= app->params.value[PARAM_REST_MIN_S];
    const uint16_t trusted =
        stop_rules_trusted_beats((fault_t)app->run.trial.end, app->run.told, app->run.guard_beats);
    if (needs_rest(app) && trusted > 0 && app->run.measured == 0) {
        const fault_t why = rested ? FAULT_RESTS_DIFFER : FAULT_NOT_STILL;
        link_text(&app->link, MAV_SEVERITY_WARNING, fault_info(why)->meaning);
    }
}

static bool end_run(app_t *app, uint64_t now_us) {
    const estimate_rest_t after = rest_after(app, now_us);
    for (uint32_t i = 0; i < RESULTS_PER_PASS; i++) {
        trial_run_beat_t beat;
        bool got = false;
        if (trial_run_end(&app->run, now_us, app->supervisor.reason, app->executed, &after, &beat,
                          &got)) {
            return true;
        }
        if (!got) {
            return false;
        }
        tell_beat(app, &beat);
    }
    return false;
}

bool swim_finish(app_t *app, uint64_t now_us) {
    if (!app->run.open) {
        return true;
    }
    bool ended = false;
    for (uint32_t step = 0; step < TRIAL_RUN_END_STEPS && !ended; step++) {
        ended = end_run(app, now_us);
        app_feed_watchdog(app);
    }
    tell_refusal(app, now_us);
    const bool stored = trial_run_finish(&app->run, &app->store, app->record) == STORE_OK;
    if (!stored) {
        swim_stop(app, FAULT_STORAGE);
    }
    (void)supervisor_event(&app->supervisor, EVENT_SETTLED, FAULT_NONE);
    return stored;
}

static void begin_log(app_t *app, uint64_t start_us) {
    trial_log_header_t header = {
        .build_id = link_build_id(),
        .board = hal_board_name(app->hal),
    };
    trial_run_imu_t imu = {
        .alive = app->imu.driver.state == IMU_STREAMING,
        .last = app->imu.last,
    };
    if (!rest_get(&app->rest, &imu.rest)) {
        imu.rest.still_s = 0.0f;
    }
    hal_unique_id(app->hal, header.unique_id);
    trial_run_started(&app->run, start_us, &imu, &app->store, &app->params, &header);
}

static void follow_tail(app_t *app, const control_report_t *report, uint64_t now_us) {
    app->executed = report->beats_done;
    if (report->stop != FAULT_NONE) {
        swim_stop(app, report->stop);
    } else if (report->finished) {
        (void)supervisor_event(&app->supervisor, EVENT_SWUM, FAULT_NONE);
        settle_from(app, now_us);
    }
}

static void warn_of_battery(app_t *app, uint64_t now_us) {
    const uint16_t low_mv = settings_battery_low_mv(&app->params);
    if (battery_warns(&app->battery, now_us, app->status.battery.mv, low_mv)) {
        link_text(&app->link, MAV_SEVERITY_WARNING, "battery low: charge it after this trial");
    }
}

static void watch_host(app_t *app, uint64_t now_us) {
    const stop_limits_t limits = {.link_timeout_us =
                                      settings_stop_limits(&app->params).link_timeout_us};
    const stop_inputs_t inputs = {.now_us = now_us, .last_heartbeat_us = app->last_heartbeat_us};
    const fault_t fault = stop_rules_check(&limits, &inputs);
    if (fault != FAULT_NONE) {
        swim_stop(app, fault);
    }
}

/* A trial that needs a rest behind it waits for one, but not for ever: without it the beats stay
 * unmeasured. */
static bool has_settled(app_t *app, uint64_t now_us) {
    if (app->supervisor.state == STATE_RUNNING || now_us < app->settle_until_us) {
        return false;
    }
    const bool collects = app->run.stage == TRIAL_RUN_COLLECTING && app->run.start_us != 0;
    if (!collects || !needs_rest(app) || app->executed == 0) {
        return true;
    }
    const imu_driver_t *imu = &app->imu.driver;
    const bool imu_gone = imu->state != IMU_STREAMING && imu->problem != IMU_PROBLEM_STARTING;
    if (rest_after(app, now_us).still_s >= rest_after_min_s(app) || imu_gone) {
        return true; /* what is wrong with the IMU has been told */
    }
    const float steps_s = (float)(SMOOTHER_AFTER - 2u) * app->reference.beat_s;
    const float wait_s = steps_s < REST_WAIT_S ? steps_s : REST_WAIT_S;
    if (now_us < app->settle_until_us + real_whole_u64(wait_s * 1e6f)) {
        return false;
    }
    trial_log_text(&app->run.log, now_us, fault_info(FAULT_NOT_STILL)->name);
    return true;
}

void swim_poll(app_t *app, uint64_t now_us) {
    if (app->supervisor.state == STATE_ARMED) {
        make_ready(app, now_us);
        watch_host(app, now_us);
    }
    bool begun = false;
    if (app->supervisor.state == STATE_RUNNING) {
        const control_report_t report = control_report(&app->control, app->hal);
        begun = app->run.start_us == 0 && report.swim_start_us != 0;
        if (begun) {
            begin_log(app, report.swim_start_us);
        }
        follow_tail(app, &report, now_us);
        warn_of_battery(app, now_us);
    }
    if (!app->run.open || begun) { /* the rest of the log's beginning is for the next pass */
        return;
    }
    trial_run_collect(&app->run, now_us, app->status.battery.mv);
    settle_beats(app);
    if (has_settled(app, now_us) && end_run(app, now_us)) {
        (void)swim_finish(app, now_us);
    }
}
