#include "app/app_internal.h"
#include "app/settings.h"
#include "hal/clock.h"
#include "hal/serial.h"
#include "hal/system.h"

#include <string.h>

size_t boot_load_record(app_t *app, const char *path) {
    uint32_t length = 0;
    if (store_size(&app->store, path, &length) != STORE_OK || length > sizeof app->record ||
        store_load(&app->store, path, app->record, length) != STORE_OK) {
        return 0;
    }
    return length;
}

bool boot_keep_crash(app_t *app) {
    crash_report_t report = {0};
    if (!hal_crash_read(app->hal, &report.crash)) {
        return false;
    }
    key_hide(app, (uint8_t *)&report.crash, sizeof report.crash);
    (void)strncpy(report.build_id, link_build_id(), BUILD_ID_BYTES - 1u);
    for (uint32_t i = 0; i < HAL_CRASH_REGISTERS; i++) {
        (void)strncpy(report.register_names[i], hal_crash_register(app->hal, i),
                      HAL_CRASH_NAME_BYTES - 1u);
    }
    const size_t length = record_encode_crash(&report, app->record);
    if (store_replace(&app->store, CRASH_PATH, app->record, length) == STORE_OK) {
        hal_crash_forget(app->hal);
    }
    return true;
}

bool boot_apply_params(app_t *app) {
    const imu_driver_config_t config = settings_imu(&app->params);
    if (!imu_driver_config_valid(&config) ||
        !hal_serial_set_baud(app->hal, HAL_PORT_IMU, config.baud)) {
        return false;
    }
    imu_configure(&app->imu, &config, hal_time_us(app->hal));
    return true;
}

/* Stored values that contradict each other: the IMU runs as if they had never been set. */
static void reset_imu_params(app_t *app) {
    for (param_t param = PARAM_IMU_BAUD; param <= PARAM_IMU_MOUNT; param++) {
        app->params.value[param] = param_info(param)->fallback;
    }
    (void)boot_apply_params(app);
}

/* A file of another firmware may hold what this one refuses. */
static void reset_refused_params(app_t *app) {
    for (uint32_t i = 0; i < PARAM_COUNT; i++) {
        if (settings_refusal((param_t)i, app->params.value[i]) != FAULT_NONE) {
            app->params.value[i] = param_info((param_t)i)->fallback;
        }
    }
}

void boot_load_params(app_t *app) {
    params_reset(&app->params);
    const size_t length = boot_load_record(app, PARAMS_PATH);
    uint16_t ignored = 0;
    if (length != 0) {
        (void)record_decode_params(app->record, length, &app->params, &ignored);
    }
    reset_refused_params(app);
    if (!boot_apply_params(app)) {
        reset_imu_params(app);
    }
}

static void load_reference(app_t *app) {
    const size_t length = boot_load_record(app, REFERENCE_PATH);
    if (length == 0 ||
        record_decode_reference(app->record, length, &app->reference) != FAULT_NONE) {
        app->reference.beats = 0;
        app->reference.crc = 0;
    }
}

void boot_load_memory(app_t *app) {
    const size_t length = boot_load_record(app, LEARNED_PATH);
    const bool loaded =
        length != 0 && record_decode_memory(app->record, length, &app->memory) == FAULT_NONE;
    if (!loaded) {
        memset(&app->memory, 0, sizeof app->memory);
    }
    const bool of_reference = app->memory.reference_crc == app->reference.crc &&
                              app->memory.beats == app->reference.beats;
    if (!of_reference && app->reference.beats != 0) {
        memory_begin(&app->memory, app->reference.crc, app->reference.beats);
    }
}

/* The file of a trial that was learned from stays until the next one replaces it. Without its
 * reference a trial cannot be learned from, but nobody has dropped it either. */
static void load_pending(app_t *app) {
    trial_run_load(&app->run, &app->store, app->record);
    const trial_t *trial = &app->run.trial;
    app->run.pending = app->run.pending && trial->number > app->memory.last_trial &&
                       trial->reference_crc == app->reference.crc;
}

static uint32_t at_least(uint32_t a, uint32_t b) { return a > b ? a : b; }

static uint32_t counted(app_t *app, size_t length) {
    uint32_t next = 1;
    return length != 0 && record_decode_counter(app->record, length, &next) == FAULT_NONE ? next
                                                                                          : 1u;
}

/* The counter is the rule; the others save the number if it is lost. */
static void load_next_trial(app_t *app) {
    witness_t witness;
    uint32_t next = counted(app, boot_load_record(app, COUNTER_PATH));
    if (witness_read(&app->store, &witness)) {
        next = at_least(next, counted(app, critical_copy(&witness, CRITICAL_COUNTER, app->record)));
    }
    next = at_least(next, app->memory.last_trial + 1u);
    next = at_least(next, app->run.trial.number + 1u);
    app->next_trial = at_least(next, store_newest_trial(&app->store) + 1u);
}

void boot_load(app_t *app) {
    boot_load_params(app);
    load_reference(app);
    boot_load_memory(app);
    load_pending(app);
    load_next_trial(app);
    app->executed = app->run.trial.executed;
}
