#include "trial/start.h"

#include "base/real.h"
#include "base/units.h"
#include "hal/clock.h"
#include "learn/reference.h"
#include "monitor/monitor.h"
#include "settings/settings.h"
#include "store/erase_ahead.h"
#include "trial/settle.h"

#define START_STALE_S 2.0f

/* Asked with the tail off, when nothing pulls the voltage down. */
static fault_t judge_battery(trial_t *trial) {
    const battery_voltage_t voltage = trial_battery(trial);
    return battery_judge(&trial->battery, &voltage, settings_battery_low_mv(trial->with.params));
}

static fault_t judge_reference(const params_t *params, const reference_t *reference) {
    const law_t law = settings_law(params, reference->beat_s);
    const gait_config_t gait = settings_gait(params, reference->beat_s);
    if (reference->beats == 0) {
        return FAULT_NO_REFERENCE;
    }
    if (!gait_config_valid(&gait)) {
        return FAULT_SERVO_CONFIG;
    }
    if (!settings_law_fits(params, &law, reference->beats)) {
        return FAULT_BAD_LAW;
    }
    return reference_judge(params, reference);
}

static fault_t judge_board(const trial_t *trial) {
    if (!supervisor_allows(trial->with.supervisor, EVENT_ARM)) {
        return FAULT_WRONG_STATE;
    }
    if (!hal_clock_exact(trial->with.hal)) {
        return FAULT_CLOCK;
    }
    return trial->run.pending ? FAULT_TRIAL_PENDING : FAULT_NONE;
}

static bool read_limits(vault_record_t record, monitor_limits_t *limits) {
    return monitor_read(record.bytes, record.length, limits);
}

/* The monitor holds a swim to what is stored: it must not ask for more. */
static fault_t judge_limits(const trial_t *trial) {
    vault_t *vault = trial->with.learner->vault;
    monitor_limits_t now, stored;
    const bool kept = read_limits(vault_params_record(vault, trial->with.params), &now) &&
                      read_limits(vault_stored_params(vault), &stored) &&
                      monitor_within(&now, &stored);
    return kept ? FAULT_NONE : FAULT_SERVO_UNSAVED;
}

static fault_t reserve_key(const trial_t *trial) {
    const float ahead_s = settle_trial_s(trial->with.params, &trial->with.learner->reference);
    return keyring_reserve(trial->with.keyring, ahead_s);
}

static fault_t become_ready(trial_t *trial) {
    fault_t fault = judge_board(trial);
    if (fault == FAULT_NONE) {
        fault = judge_reference(trial->with.params, &trial->with.learner->reference);
    }
    if (fault == FAULT_NONE) {
        fault = judge_battery(trial);
    }
    if (fault == FAULT_NONE) {
        fault = judge_limits(trial);
    }
    if (fault == FAULT_NONE) {
        fault = reserve_key(trial);
    }
    return fault == FAULT_NONE ? learner_guess_first(trial->with.learner) : fault;
}

static bool is_by_armer(const trial_t *trial, const link_command_t *command) {
    return host_is(&trial->host, command->port, command->system);
}

fault_t start_arm(trial_t *trial, const link_command_t *command) {
    if (trial->with.supervisor->state != STATE_ARMED) {
        const fault_t fault = become_ready(trial);
        if (fault != FAULT_NONE) {
            return fault;
        }
        preparation_begin(&trial->preparation);
        (void)supervisor_event(trial->with.supervisor, EVENT_ARM, FAULT_NONE);
    } else if (!is_by_armer(trial, command)) {
        outbox_text(trial->with.outbox, MAV_SEVERITY_NOTICE,
                    "another host has taken the fish over");
    }
    const uint64_t now_us = hal_time_us(trial->with.hal);
    trial->host = (trial_host_t){command->port, command->system, now_us};
    trial->blink_until_us = now_us + real_whole_u64(command->blink_s * 1e6f);
    return FAULT_NONE;
}

static bool is_stale(const trial_t *trial, float issued_s) {
    const float now_s = (float)units_thousandth(hal_time_us(trial->with.hal)) * 1e-3f;
    /* A time to come is one of an earlier boot. Written so that NaN (no time given) is stale. */
    return !(real_abs(now_s - issued_s) <= START_STALE_S);
}

static fault_t judge_command(const trial_t *trial, const link_command_t *command) {
    if (!supervisor_allows(trial->with.supervisor, EVENT_START)) {
        return FAULT_WRONG_STATE;
    }
    if (!is_by_armer(trial, command)) {
        return FAULT_OTHER_HOST;
    }
    if (command->trial != trial->next) {
        return FAULT_TRIAL_NUMBER;
    }
    return is_stale(trial, command->issued_s) ? FAULT_STALE_COMMAND : FAULT_NONE;
}

/* What the speed source asks of the IMU and of the hand that holds the fish. */
static fault_t ready_to_measure(const trial_t *trial) {
    const params_t *params = trial->with.params;
    if (settings_need_imu(params) && trial->with.imu->driver.state != IMU_STREAMING) {
        return FAULT_NO_IMU;
    }
    if (settle_needs_rest(params) && trial_still_s(trial) < params->value[PARAM_REST_MIN_S]) {
        return FAULT_NOT_STILL;
    }
    return FAULT_NONE;
}

static fault_t count(trial_t *trial) {
    if (vault_save_counter(trial->with.learner->vault, trial->next + 1u) != STORE_OK) {
        return FAULT_WRITE_FAILED;
    }
    trial->next++;
    return FAULT_NONE;
}

/* Everything that writes flash and can be done before the tail moves. */
static fault_t prepare_store(trial_t *trial) {
    fault_t fault = preparation_make_room(&trial->preparation);
    if (fault == FAULT_NONE) { /* armed long ago, perhaps */
        fault = reserve_key(trial);
    }
    if (fault == FAULT_NONE) {
        fault = count(trial);
    }
    if (fault == FAULT_NONE) {
        fault = preparation_save_guess(&trial->preparation);
    }
    return fault == FAULT_NONE ? preparation_erase(&trial->preparation) : fault;
}

static void begin(trial_t *trial, uint32_t number) {
    const params_t *params = trial->with.params;
    learner_t *learner = trial->with.learner;
    const reference_t *reference = &learner->reference;
    const trial_run_plan_t plan = {
        .number = number,
        .applied_rad = learner_applied(learner),
        .estimate = settings_estimate(params, reference->beat_s, reference->beats),
        .guard_beats = (uint16_t)params_whole(params, PARAM_GUARD_BEATS),
        .late_s = params->value[PARAM_SPD_LATE_S],
        .rate_scale_sigma = params->value[PARAM_IMU_SCALE_SD],
    };
    workspace_t *workspace = &learner->vault->workspace;
    erase_ahead_forbid(&learner->vault->store, true);
    trial_run_begin(&trial->run, &plan, &workspace_take(workspace, WORKSPACE_ESTIMATE)->estimate);
    const vault_record_t params_record = vault_stored_params(learner->vault);
    control_offer(&trial->control, params_record.bytes, params_record.length);
    trial->executed = 0;
    trial_follow_params(trial);
    /* Making space may have taken longer than the host may be silent. */
    trial->host.last_heartbeat_us = hal_time_us(trial->with.hal);
    battery_begin_swim(&trial->battery, trial->host.last_heartbeat_us);
    (void)supervisor_event(trial->with.supervisor, EVENT_START, FAULT_NONE);
}

fault_t start_swim(trial_t *trial, const link_command_t *command) {
    if (trial->with.supervisor->state == STATE_RUNNING &&
        command->trial == trial->run.trial.number) {
        return FAULT_NONE;
    }
    fault_t fault = judge_command(trial, command);
    if (fault == FAULT_NONE) {
        fault = ready_to_measure(trial);
    }
    if (fault == FAULT_NONE) {
        fault = judge_battery(trial);
    }
    if (fault == FAULT_NONE) {
        fault = prepare_store(trial);
    }
    if (fault == FAULT_NONE) {
        begin(trial, command->trial);
    }
    return fault;
}
