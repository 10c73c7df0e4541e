#include "app/app_internal.h"
#include "app/settings.h"
#include "base/real.h"

#include <math.h>

fault_t learn_save(app_t *app) {
    const size_t length = record_encode_memory(&app->memory, app->record);
    if (store_replace(&app->store, LEARNED_PATH, app->record, length) == STORE_OK) {
        return FAULT_NONE;
    }
    boot_load_memory(app);
    return FAULT_WRITE_FAILED;
}

static law_trial_t pending_errors(app_t *app) {
    const trial_t *trial = &app->run.trial;
    for (uint16_t k = 0; k < trial->beats; k++) {
        const bool measured = k < trial->executed && real_is_finite(trial->speed_m_s[k]);
        app->measured[k] = measured;
        app->error_m_s[k] = measured ? app->reference.speed_m_s[k] - trial->speed_m_s[k] : 0.0f;
    }
    return (law_trial_t){
        .beats = trial->beats, .error_m_s = app->error_m_s, .measured = app->measured};
}

static fault_t refusal(law_result_t result) {
    switch (result) {
    case LAW_OK:
        return FAULT_NONE;
    case LAW_BAD_CONFIG:
        return FAULT_BAD_LAW;
    case LAW_NOTHING_MEASURED:
        return FAULT_NOTHING_MEASURED;
    case LAW_BAD_INPUT:
        break;
    }
    return FAULT_BAD_DATA;
}

static void report_learned(app_t *app, uint32_t trial, uint16_t iteration,
                           const memory_report_t *report) {
    const bool has_best = app->memory.best_iteration != 0;
    const link_learn_report_t message = {
        .trial = trial,
        .iteration = iteration,
        .report = *report,
        .best_max_abs_error_m_s = has_best ? app->memory.best_max_abs_error_m_s : NAN,
    };
    link_learned(&app->link, &message);
}

static fault_t learn_pending(app_t *app) {
    const trial_t *trial = &app->run.trial;
    const law_t law = settings_law(&app->params, app->reference.beat_s);
    const law_trial_t errors = pending_errors(app);
    const bool complete = trial->end == FAULT_NONE && trial->executed == trial->beats;
    memory_report_t report;
    const law_result_t result =
        memory_learn(&app->memory, &law, &errors, trial->number, complete,
                     app->params.value[PARAM_ROLLBACK_RATIO], app->scratch, &report);
    if (result != LAW_OK) {
        return refusal(result);
    }
    if (learn_save(app) != FAULT_NONE) {
        return FAULT_WRITE_FAILED;
    }
    (void)trial_run_forget(&app->run, &app->store);
    report_learned(app, trial->number, trial->iteration, &report);
    return FAULT_NONE;
}

fault_t learn_trial(app_t *app, uint32_t trial) {
    if (!supervisor_allows(&app->supervisor, EVENT_LEARN)) {
        return FAULT_WRONG_STATE;
    }
    const bool waiting = app->run.pending && trial == app->run.trial.number;
    if (trial != 0 && trial == app->memory.last_trial) {
        return waiting ? learn_discard(app, trial) : FAULT_NONE;
    }
    if (!waiting) {
        return FAULT_NO_TRIAL;
    }
    (void)supervisor_event(&app->supervisor, EVENT_LEARN, FAULT_NONE);
    const fault_t result = learn_pending(app);
    (void)supervisor_event(&app->supervisor, EVENT_LEARNED, FAULT_NONE);
    return result;
}

fault_t learn_discard(app_t *app, uint32_t trial) {
    if (app->supervisor.state != STATE_IDLE) {
        return FAULT_WRONG_STATE;
    }
    if (!app->run.pending || trial != app->run.trial.number) {
        return FAULT_NO_TRIAL;
    }
    return trial_run_forget(&app->run, &app->store) == STORE_OK ? FAULT_NONE : FAULT_WRITE_FAILED;
}

fault_t learn_restore_best(app_t *app) {
    if (app->supervisor.state != STATE_IDLE) {
        return FAULT_WRONG_STATE;
    }
    if (app->run.pending) {
        return FAULT_TRIAL_PENDING;
    }
    if (!memory_restore_best(&app->memory)) {
        return FAULT_NO_BEST;
    }
    return learn_save(app);
}
