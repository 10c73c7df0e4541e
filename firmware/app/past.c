/*
 * The trials that an average looks back on, one file each, for RAM holds the last one alone.
 *
 * Each record names the learned input that came of it, and the record before it, by their CRCs. So
 * the chain begins with the learned input of now and nothing else: amplitudes uploaded, restored or
 * learned in another way have no past, nor has what a cut left behind. A record is written before
 * the learned input that it leads to, into the place of one that is no longer looked at: a cut
 * between the two leaves the old learned input and its whole past.
 */
#include "app/app_internal.h"
#include "app/settings.h"

#include <math.h>
#include <string.h>

#define NUMBER_AT 5u /* in the path */

_Static_assert(PAST_FILES >= PAST_WINDOW_MAX, "earlier trials and the one to come");
_Static_assert(MEMORY_ROUND % PAST_FILES == 0, "places go on when the iteration goes round");

/* The place of the trial of |iteration|. */
static void path_of(uint32_t iteration, char path[sizeof PAST_PATH]) {
    strcpy(path, PAST_PATH);
    path[NUMBER_AT] = (char)('0' + iteration % PAST_FILES);
}

static void forget(app_t *app) { memset(&app->shared.past, 0, sizeof app->shared.past); }

/* How far back a walk has come, and the CRC that leads on. */
typedef struct {
    past_kind_t kind;
    uint16_t back;
    uint32_t crc;
} walk_t;

static walk_t begin_walk(app_t *app, past_kind_t kind) {
    (void)record_encode_memory(&app->memory, app->record);
    return (walk_t){.kind = kind, .crc = record_crc(app->record)};
}

/* One trial further back, into app->shared.past; false when there is none. */
static bool step_back(app_t *app, walk_t *walk) {
    past_t *past = &app->shared.past;
    char path[sizeof PAST_PATH];
    app_feed_watchdog(app); /* eight long trials take a while */
    path_of(app->memory.iteration - 1u - walk->back, path);
    const size_t length = boot_load_record(app, path);
    if (length == 0 || record_decode_past(app->record, length, past) != FAULT_NONE) {
        return false;
    }
    const uint32_t crc = walk->back == 0 ? past->learned_crc : past->crc;
    if (crc != walk->crc || past->kind != walk->kind || past->beats != app->memory.beats) {
        return false;
    }
    walk->back++;
    walk->crc = past->previous_crc;
    return true;
}

static uint16_t count_back(app_t *app, past_kind_t kind, uint16_t most) {
    walk_t walk = begin_walk(app, kind);
    while (walk.back < most && (walk.back == 0 || walk.crc != 0) && step_back(app, &walk)) {
    }
    return walk.back;
}

/* The mask of what was measured is the pending trial's afterwards. */
static law_result_t add_shared(app_t *app, const law_t *law, const law_weights_t *weights) {
    const past_t *past = &app->shared.past;
    for (uint32_t k = 0; k < past->beats; k++) {
        app->measured[k] = past->error_m_s[k] == past->error_m_s[k];
    }
    const law_trial_t trial = {.beats = past->beats,
                               .error_m_s = past->error_m_s,
                               .measured = app->measured,
                               .visits = app->memory.visits};
    return law_add(law, weights, &trial, past->amplitude_rad, app->scratch);
}

static law_result_t add_mean(app_t *app, const law_t *law, past_view_t *view) {
    walk_t walk = begin_walk(app, PAST_MEAN);
    view->now = past_mean_now(1);
    if (!step_back(app, &walk)) {
        return LAW_OK;
    }
    view->newest_crc = app->shared.past.crc;
    view->trials = app->shared.past.trials;
    const uint32_t ended = view->trials + 1u;
    const law_weights_t before = past_mean_before(ended);
    view->now = past_mean_now(ended);
    return add_shared(app, law, &before);
}

static law_result_t add_window(app_t *app, const law_t *law, past_view_t *view) {
    const uint16_t most = past_reach(app);
    const uint16_t earlier = count_back(app, PAST_WINDOW, most);
    view->now = past_average_weight(most + 1u, earlier + 1u);
    view->trials = earlier;
    walk_t walk = begin_walk(app, PAST_WINDOW);
    law_result_t result = LAW_OK;
    while (walk.back < earlier && result == LAW_OK) {
        result = step_back(app, &walk) ? add_shared(app, law, &view->now) : LAW_BAD_INPUT;
        if (walk.back == 1u) {
            view->newest_crc = app->shared.past.crc;
            view->shortened = earlier < most && earlier < app->shared.past.trials;
        }
    }
    return result;
}

static law_result_t add_past(app_t *app, const law_t *law, past_view_t *view) {
    switch (view->kind) {
    case PAST_MEAN:
        return add_mean(app, law, view);
    case PAST_WINDOW:
        return add_window(app, law, view);
    case PAST_LAST:
    case PAST_KIND_COUNT:
        break;
    }
    return LAW_OK;
}

law_result_t past_look_back(app_t *app, const law_t *law, past_view_t *view) {
    const bool learned = app->memory.iteration > 1u && app->memory.input == MEMORY_INPUT_LAW;
    *view = (past_view_t){.kind = settings_past_kind(&app->params)};
    memset(app->scratch, 0, sizeof app->scratch);
    const law_result_t result = add_past(app, law, view);
    if (view->kind != PAST_LAST && view->newest_crc == 0) {
        view->shortened = learned;
    }
    return result;
}

/* Into app->shared.past, where the means of the trials before still are. */
static void take_in(app_t *app, const law_t *law, const law_trial_t *errors,
                    const past_view_t *view) {
    past_t *past = &app->shared.past;
    const trial_t *trial = &app->run.trial;
    if (view->kind == PAST_MEAN) {
        if (view->trials == 0) {
            forget(app);
        }
        past_mean_add(law, view->trials + 1u, errors, trial->amplitude_rad, past->amplitude_rad,
                      past->error_m_s);
        return;
    }
    for (uint32_t k = 0; k < trial->beats; k++) {
        past->amplitude_rad[k] = trial->amplitude_rad[k];
        past->error_m_s[k] = errors->measured[k] ? errors->error_m_s[k] : NAN;
    }
}

fault_t past_keep(app_t *app, const law_t *law, const law_trial_t *errors,
                  const past_view_t *view) {
    if (view->kind == PAST_LAST) {
        return FAULT_NONE;
    }
    past_t *past = &app->shared.past;
    const trial_t *trial = &app->run.trial;
    take_in(app, law, errors, view);
    past->previous_crc = view->newest_crc;
    past->kind = (uint16_t)view->kind;
    past->trials = (uint16_t)(view->trials + (view->trials < UINT16_MAX));
    past->beats = trial->beats;
    (void)record_encode_memory(&app->memory, app->record);
    past->learned_crc = record_crc(app->record);
    char path[sizeof PAST_PATH];
    path_of(app->memory.iteration - 1u, path);
    const size_t length = record_encode_past(past, app->record);
    return store_replace(&app->store, path, app->record, length) == STORE_OK ? FAULT_NONE
                                                                             : FAULT_WRITE_FAILED;
}

uint32_t past_room_bytes(const app_t *app) {
    return settings_past_kind(&app->params) == PAST_LAST ? 0u : PAST_ROOM_BYTES;
}

uint16_t past_reach(const app_t *app) {
    switch (settings_past_kind(&app->params)) {
    case PAST_MEAN:
        return 1;
    case PAST_WINDOW:
        return (uint16_t)(settings_past_window(&app->params) - 1u);
    case PAST_LAST:
    case PAST_KIND_COUNT:
        break;
    }
    return 0;
}

bool past_drop(app_t *app, uint16_t keep) {
    app_feed_watchdog(app);
    for (uint32_t back = PAST_FILES; back > keep; back--) {
        char path[sizeof PAST_PATH];
        path_of(app->memory.iteration - back, path);
        if (store_remove(&app->store, path) == STORE_OK) {
            return true;
        }
    }
    return false;
}
