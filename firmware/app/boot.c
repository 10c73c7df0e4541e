#include "app/boot.h"

#include "hal/clock.h"
#include "hal/system.h"
#include "settings/settings.h"
#include "store/salvage.h"

#include <string.h>

/* Stored values that contradict each other: the IMU runs as if they had never been set. */
static void reset_imu_params(app_t *app) {
    for (param_t param = PARAM_IMU_BAUD; param <= PARAM_IMU_MOUNT; param++) {
        app->params.value[param] = param_info(param)->fallback;
    }
    (void)sensor_configure(&app->sensor, &app->params);
}

/* A file of another firmware may hold what this one refuses. */
static void reset_refused_params(params_t *params) {
    for (uint32_t i = 0; i < PARAM_COUNT; i++) {
        if (settings_refusal((param_t)i, params->value[i]) != FAULT_NONE) {
            params->value[i] = param_info((param_t)i)->fallback;
        }
    }
}

void boot_load_params(app_t *app) {
    params_reset(&app->params);
    (void)vault_load_params(&app->vault, &app->params);
    reset_refused_params(&app->params);
    if (!sensor_configure(&app->sensor, &app->params)) {
        reset_imu_params(app);
    }
}

static void report_fates(outbox_t *outbox, const salvage_report_t *report) {
    static const char words[][8] = {
        [SALVAGE_SAVED] = "saved ",
        [SALVAGE_OLDER] = "older ",
        [SALVAGE_LOST] = "lost ",
    };
    for (uint32_t kind = 0; kind < CRITICAL_COUNT; kind++) {
        char text[sizeof words[0] + STORE_PATH_BYTES];
        if (report->fate[kind] != SALVAGE_UNTOUCHED) {
            strcpy(text, words[report->fate[kind]]);
            strcat(text, critical_path((critical_t)kind));
            outbox_text(outbox, MAV_SEVERITY_WARNING, text);
        }
    }
}

/* Whether the run before this one crashed. Its record goes to the store, and is kept in RAM as long
 * as it cannot be stored. */
static bool keep_crash(app_t *app) {
    crash_report_t report = {0};
    if (!hal_crash_read(app->hal, &report.crash)) {
        return false;
    }
    keyring_hide(&app->keyring, (uint8_t *)&report.crash, sizeof report.crash);
    (void)strncpy(report.build_id, link_build_id(), BUILD_ID_BYTES - 1u);
    for (uint32_t i = 0; i < HAL_CRASH_REGISTERS; i++) {
        (void)strncpy(report.register_names[i], hal_crash_register(app->hal, i),
                      HAL_CRASH_NAME_BYTES - 1u);
    }
    if (vault_save_crash(&app->vault, &report) == STORE_OK) {
        hal_crash_forget(app->hal);
    }
    return true;
}

static fault_t judge(const app_t *app, store_result_t mounted, bool key_readable, bool crashed) {
    if (mounted == STORE_TOO_SMALL || mounted == STORE_BAD_GEOMETRY) {
        return FAULT_STORE_UNFIT;
    }
    if (mounted != STORE_OK) {
        return FAULT_STORAGE;
    }
    if (!key_readable) {
        return FAULT_KEY_UNREADABLE;
    }
    if (crashed) {
        return FAULT_CRASH;
    }
    if (hal_reset_cause(app->hal) == HAL_RESET_WATCHDOG) {
        return FAULT_WATCHDOG;
    }
    return hal_clock_exact(app->hal) ? FAULT_NONE : FAULT_CLOCK;
}

fault_t boot_load(app_t *app) {
    salvage_report_t lost;
    const store_result_t mounted = salvage_mount(&app->vault, app->hal, &lost);
    report_fates(&app->link.outbox, &lost);
    if (lost.lock_key) {
        signing_lock(&app->link.outbox.signing);
    }
    const bool key_readable = keyring_load(&app->keyring); /* first: the crash must not tell it */
    const bool crashed = keep_crash(app);
    boot_load_params(app);
    learner_load(&app->learner);
    trial_load(&app->trial);
    return lost.fault != FAULT_NONE ? lost.fault : judge(app, mounted, key_readable, crashed);
}
