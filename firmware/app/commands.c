#include "app/commands.h"

#include "app/boot.h"
#include "app/damage.h"
#include "app/status.h"
#include "app/uploads.h"
#include "hal/clock.h"
#include "settings/settings.h"
#include "store/critical.h"
#include "trial/start.h"

#include <math.h>

/* A reboot waits this long, so that its acknowledgement still goes out. */
#define REBOOT_DELAY_US 200000u

/* Stopping is always allowed: it cuts a trial, disarms, or does nothing. */
static fault_t stop_by_command(app_t *app, fault_t reason) {
    if (app->supervisor.state == STATE_RUNNING) {
        trial_stop(&app->trial, reason);
    } else {
        (void)supervisor_event(&app->supervisor, EVENT_DISARM, FAULT_NONE);
    }
    return FAULT_NONE;
}

static fault_t disarm(app_t *app) {
    return app->supervisor.state == STATE_BOOT ? FAULT_WRONG_STATE
                                               : stop_by_command(app, FAULT_ABORT_COMMAND);
}

static fault_t clear(app_t *app) {
    if (app->supervisor.state == STATE_IDLE) {
        return FAULT_NONE;
    }
    if (!supervisor_allows(&app->supervisor, EVENT_CLEAR)) {
        return FAULT_WRONG_STATE;
    }
    if (!trial_finish(&app->trial, hal_time_us(app->hal))) {
        return FAULT_WRITE_FAILED;
    }
    if (critical_set_alarm(&app->vault.store, false) == STORE_IO) {
        return FAULT_WRITE_FAILED;
    }
    (void)supervisor_event(&app->supervisor, EVENT_CLEAR, FAULT_NONE);
    return FAULT_NONE;
}

static fault_t change_params(app_t *app, link_command_id_t id) {
    if (id == LINK_COMMAND_PARAMS_LOAD) {
        boot_load_params(app);
        return FAULT_NONE;
    }
    if (id == LINK_COMMAND_PARAMS_RESET) {
        params_reset(&app->params);
        (void)sensor_configure(&app->sensor, &app->params);
        return FAULT_NONE;
    }
    return vault_fault(vault_save_params(&app->vault, &app->params));
}

static fault_t reboot(app_t *app) {
    if (!state_is_at_rest(app->supervisor.state)) {
        return FAULT_WRONG_STATE;
    }
    (void)trial_finish(&app->trial, hal_time_us(app->hal));
    app->loop.reboot_at_us = hal_time_us(app->hal) + REBOOT_DELAY_US;
    return FAULT_NONE;
}

static fault_t arm(app_t *app, const link_command_t *command) {
    return app->loop.reboot_at_us != 0 ? FAULT_WRONG_STATE : start_arm(&app->trial, command);
}

static void report_learned(app_t *app, const trial_record_t *trial,
                           const learner_outcome_t *outcome) {
    const memory_t *memory = &app->learner.memory;
    link_learn_report_t *learned = &app->loop.learned;
    *learned = (link_learn_report_t){
        .trial = trial->number,
        .iteration = trial->iteration,
        .report = outcome->report,
        .best_max_abs_error_m_s =
            memory->best_iteration != 0 ? memory->best_max_abs_error_m_s : NAN,
    };
    if (outcome->shortened) {
        outbox_text(&app->link.outbox, MAV_SEVERITY_NOTICE,
                    "earlier trials are missing in the average");
    }
    link_learned(&app->link.outbox, learned);
}

static fault_t learn_pending(app_t *app) {
    trial_run_t *run = &app->trial.run;
    learner_outcome_t outcome;
    (void)supervisor_event(&app->supervisor, EVENT_LEARN, FAULT_NONE);
    const fault_t fault = learner_learn(&app->learner, &run->trial, &outcome);
    if (fault == FAULT_NONE) {
        run->pending = false; /* its file stays, for the next trial to replace: the memory tells */
        report_learned(app, &run->trial, &outcome);
    }
    (void)supervisor_event(&app->supervisor, EVENT_LEARNED, FAULT_NONE);
    return fault;
}

static fault_t learn(app_t *app, uint32_t number) {
    if (!supervisor_allows(&app->supervisor, EVENT_LEARN)) {
        return FAULT_WRONG_STATE;
    }
    const bool waiting = app->trial.run.pending && number == app->trial.run.trial.number;
    if (number != 0 && number == app->learner.memory.last_trial) {
        return waiting ? trial_discard(&app->trial, number) : FAULT_NONE;
    }
    return waiting ? learn_pending(app) : FAULT_NO_TRIAL;
}

static fault_t restore_best(app_t *app) {
    return app->trial.run.pending ? FAULT_TRIAL_PENDING : learner_restore_best(&app->learner);
}

/* What changes the board and is possible in IDLE only. */
static fault_t run_in_idle(app_t *app, const link_command_t *command) {
    if (app->supervisor.state != STATE_IDLE) {
        return FAULT_WRONG_STATE;
    }
    switch (command->id) {
    case LINK_COMMAND_DISCARD:
        return trial_discard(&app->trial, command->trial);
    case LINK_COMMAND_RESTORE_BEST:
        return restore_best(app);
    case LINK_COMMAND_COMMIT:
        return uploads_commit(app, command);
    case LINK_COMMAND_IMU_SAVE:
    case LINK_COMMAND_IMU_ROW:
        return sensor_command(&app->sensor, command);
    default:
        return change_params(app, command->id);
    }
}

static fault_t run(app_t *app, const link_command_t *command) {
    switch (command->id) {
    case LINK_COMMAND_ARM:
        return arm(app, command);
    case LINK_COMMAND_DISARM:
        return disarm(app);
    case LINK_COMMAND_START:
        return start_swim(&app->trial, command);
    case LINK_COMMAND_ABORT:
        return stop_by_command(app, command->wall ? FAULT_WALL : FAULT_ABORT_COMMAND);
    case LINK_COMMAND_LEARN:
        return learn(app, command->trial);
    case LINK_COMMAND_CLEAR:
        return clear(app);
    case LINK_COMMAND_REBOOT:
        return reboot(app);
    case LINK_COMMAND_DISCARD:
    case LINK_COMMAND_RESTORE_BEST:
    case LINK_COMMAND_COMMIT:
    case LINK_COMMAND_PARAMS_LOAD:
    case LINK_COMMAND_PARAMS_SAVE:
    case LINK_COMMAND_PARAMS_RESET:
    case LINK_COMMAND_IMU_SAVE:
    case LINK_COMMAND_IMU_ROW:
        return run_in_idle(app, command);
    }
    return FAULT_UNKNOWN_COMMAND;
}

/* What is told with the acknowledgement is already so. */
fault_t commands_run(void *context, const link_command_t *command) {
    app_t *app = context;
    const fault_t fault = damage_judge(app, run(app, command));
    status_refresh(app);
    return fault;
}

fault_t commands_param_set(void *context, param_t param, float value) {
    app_t *app = context;
    if (app->supervisor.state != STATE_IDLE) {
        return FAULT_WRONG_STATE;
    }
    const fault_t refusal = settings_refusal(param, value);
    if (refusal != FAULT_NONE) {
        return refusal;
    }
    const float before = param < PARAM_COUNT ? app->params.value[param] : 0.0f;
    if (params_set(&app->params, param, value) != PARAM_OK) {
        return FAULT_BAD_PARAM;
    }
    const bool of_imu = param >= PARAM_IMU_BAUD && param <= PARAM_IMU_MOUNT;
    if (of_imu && value != before && !sensor_configure(&app->sensor, &app->params)) {
        app->params.value[param] = before;
        return FAULT_BAD_PARAM;
    }
    return FAULT_NONE;
}

fault_t commands_set_key(void *context, const uint8_t *key, uint64_t time) {
    app_t *app = context;
    if (!state_is_at_rest(app->supervisor.state) || trial_is_open(&app->trial)) {
        return FAULT_WRONG_STATE;
    }
    return damage_judge(app, keyring_set(&app->keyring, key, time));
}
