#include "app/app_internal.h"
#include "app/settings.h"
#include "hal/clock.h"
#include "hal/system.h"

/* Stopping is always allowed: it cuts a trial, disarms, or does nothing. */
static fault_t stop_by_command(app_t *app, fault_t reason) {
    if (app->supervisor.state == STATE_RUNNING) {
        swim_stop(app, reason);
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
    if (!swim_finish(app, hal_time_us(app->hal))) {
        return FAULT_WRITE_FAILED;
    }
    if (critical_set_alarm(&app->store, false) == STORE_IO) {
        return FAULT_WRITE_FAILED;
    }
    (void)supervisor_event(&app->supervisor, EVENT_CLEAR, FAULT_NONE);
    return FAULT_NONE;
}

static fault_t change_params(app_t *app, link_command_id_t id) {
    if (app->supervisor.state != STATE_IDLE) {
        return FAULT_WRONG_STATE;
    }
    if (id == LINK_COMMAND_PARAMS_LOAD) {
        boot_load_params(app);
        return FAULT_NONE;
    }
    if (id == LINK_COMMAND_PARAMS_RESET) {
        params_reset(&app->params);
        (void)boot_apply_params(app);
        return FAULT_NONE;
    }
    const size_t length = record_encode_params(&app->params, app->record);
    return critical_replace(&app->store, CRITICAL_PARAMS, app->record, length) == STORE_OK
               ? FAULT_NONE
               : FAULT_WRITE_FAILED;
}

static fault_t reboot(app_t *app) {
    const state_t state = app->supervisor.state;
    if (state != STATE_IDLE && state != STATE_ABORTED && state != STATE_FAULT) {
        return FAULT_WRONG_STATE;
    }
    (void)swim_finish(app, hal_time_us(app->hal));
    app->reboot_at_us = hal_time_us(app->hal) + APP_REBOOT_DELAY_US;
    return FAULT_NONE;
}

static fault_t change_imu(app_t *app, const link_command_t *command) {
    if (app->supervisor.state != STATE_IDLE) {
        return FAULT_WRONG_STATE;
    }
    if (app->imu.driver.state != IMU_STREAMING) {
        return FAULT_NO_IMU;
    }
    if (command->id == LINK_COMMAND_IMU_SAVE) {
        imu_driver_save(&app->imu.driver);
        return FAULT_NONE;
    }
    return imu_driver_give_row(&app->imu.driver, command->row, command->element) ? FAULT_NONE
                                                                                 : FAULT_BAD_DATA;
}

static fault_t run(app_t *app, const link_command_t *command) {
    switch (command->id) {
    case LINK_COMMAND_ARM:
        return swim_arm(app, command);
    case LINK_COMMAND_DISARM:
        return disarm(app);
    case LINK_COMMAND_START:
        return swim_start(app, command);
    case LINK_COMMAND_ABORT:
        return stop_by_command(app, command->wall ? FAULT_WALL : FAULT_ABORT_COMMAND);
    case LINK_COMMAND_LEARN:
        return learn_trial(app, command->trial);
    case LINK_COMMAND_DISCARD:
        return learn_discard(app, command->trial);
    case LINK_COMMAND_RESTORE_BEST:
        return learn_restore_best(app);
    case LINK_COMMAND_CLEAR:
        return clear(app);
    case LINK_COMMAND_COMMIT:
        return uploads_commit(app, command);
    case LINK_COMMAND_PARAMS_LOAD:
    case LINK_COMMAND_PARAMS_SAVE:
    case LINK_COMMAND_PARAMS_RESET:
        return change_params(app, command->id);
    case LINK_COMMAND_REBOOT:
        return reboot(app);
    case LINK_COMMAND_IMU_SAVE:
    case LINK_COMMAND_IMU_ROW:
        return change_imu(app, command);
    }
    return FAULT_UNKNOWN_COMMAND;
}

/* What is told with the acknowledgement is already so. */
fault_t commands_run(void *context, const link_command_t *command) {
    app_t *app = context;
    const fault_t fault = app_judge_write(app, run(app, command));
    app_refresh_status(app);
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
    if (of_imu && value != before && !boot_apply_params(app)) {
        app->params.value[param] = before;
        return FAULT_BAD_PARAM;
    }
    return FAULT_NONE;
}
