#include "app/app_internal.h"
#include "app/settings.h"
#include "base/real.h"

#include <math.h>

fault_t learn_save(app_t *app) {
    const size_t length = record_encode_memory(&app->memory, app->record);
    if (critical_replace(&app->store, CRITICAL_LEARNED, app->record, length) == STORE_OK) {
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
    link_learn_report_t *learned = &app->learned;
    learned->trial = trial;
    learned->iteration = iteration;
    learned->report = *report;
    learned->best_max_abs_error_m_s = has_best ? app->memory.best_max_abs_error_m_s : NAN;
    link_learned(&app->link.outbox, learned);
}

static law_result_t learn_from(app_t *app, const law_t *law, past_view_t *view, law_trial_t *errors,
                               memory_report_t *report) {
    const trial_t *trial = &app->run.trial;
    const bool complete = trial->end == FAULT_NONE && trial->executed == trial->beats;
    if (!past_fits(settings_past_kind(&app->params), law)) {
        return LAW_BAD_CONFIG;
    }
    const law_result_t looked = past_look_back(app, law, view);
    if (looked != LAW_OK) {
        return looked;
    }
    memory_rules_t rules = settings_memory_rules(&app->params);
    rules.has_past = view->kind != PAST_LAST;
    rules.now = view->now;
    *errors = pending_errors(app);
    return memory_learn(&app->memory, law, errors, trial->number, complete, &rules, app->scratch,
                        report);
}

/* What was learned, ahead of it what it came from. */
static fault_t save(app_t *app, const law_t *law, const law_trial_t *errors,
                    const past_view_t *view, bool rolled_back) {
    if (!rolled_back && past_keep(app, law, errors, view) != FAULT_NONE) {
        boot_load_memory(app);
        return FAULT_WRITE_FAILED;
    }
    app_feed_watchdog(app);
    return learn_save(app);
}

static fault_t learn_pending(app_t *app) {
    const trial_t *trial = &app->run.trial;
    const law_t law = settings_law(&app->params, app->reference.beat_s);
    past_view_t view;
    law_trial_t errors;
    memory_report_t report;
    const law_result_t result = learn_from(app, &law, &view, &errors, &report);
    if (result != LAW_OK) {
        return refusal(result);
    }
    if (save(app, &law, &errors, &view, report.rolled_back) != FAULT_NONE) {
        return FAULT_WRITE_FAILED;
    }
    app->run.pending =
        false; /* its file stays, for the next trial to replace: /learned.bin tells */
    if (view.shortened && !report.rolled_back) {
        outbox_text(&app->link.outbox, MAV_SEVERITY_NOTICE,
                    "earlier trials are missing in the average");
    }
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
