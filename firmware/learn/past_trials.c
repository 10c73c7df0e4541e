#include "learn/past_trials.h"

#include "settings/settings.h"

#include <math.h>
#include <string.h>

_Static_assert(VAULT_PAST_PLACES >= PAST_WINDOW_MAX, "earlier trials and the one to come");
_Static_assert(MEMORY_ROUND % VAULT_PAST_PLACES == 0, "places go on when the iteration goes round");

/* How far back a walk has come, and the CRC that leads on. */
typedef struct {
    past_kind_t kind;
    uint16_t back;
    uint32_t crc;
} walk_t;

static walk_t begin_walk(const past_trials_t *trials, past_kind_t kind) {
    return (walk_t){.kind = kind, .crc = vault_memory_crc(trials->vault, trials->memory)};
}

/* One trial further back, into trials->past; false when there is none. */
static bool step_back(const past_trials_t *trials, walk_t *walk) {
    past_t *past = trials->past;
    const uint32_t place = trials->memory->iteration - 1u - walk->back;
    if (!vault_load_past(trials->vault, place, past)) {
        return false;
    }
    const uint32_t crc = walk->back == 0 ? past->learned_crc : past->crc;
    if (crc != walk->crc || past->kind != walk->kind || past->beats != trials->memory->beats) {
        return false;
    }
    walk->back++;
    walk->crc = past->previous_crc;
    return true;
}

static uint16_t count_back(const past_trials_t *trials, past_kind_t kind, uint16_t most) {
    walk_t walk = begin_walk(trials, kind);
    while (walk.back < most && (walk.back == 0 || walk.crc != 0) && step_back(trials, &walk)) {
    }
    return walk.back;
}

static law_result_t add(const past_trials_t *trials, const law_t *law,
                        const law_weights_t *weights) {
    const past_t *past = trials->past;
    for (uint32_t k = 0; k < past->beats; k++) {
        trials->measured[k] = past->error_m_s[k] == past->error_m_s[k];
    }
    const law_trial_t trial = {.beats = past->beats,
                               .error_m_s = past->error_m_s,
                               .measured = trials->measured,
                               .visits = trials->memory->visits};
    return law_add(law, weights, &trial, past->amplitude_rad, trials->sum_rad);
}

static law_result_t add_mean(const past_trials_t *trials, const law_t *law, past_view_t *view) {
    walk_t walk = begin_walk(trials, PAST_MEAN);
    view->now = past_mean_now(1);
    if (!step_back(trials, &walk)) {
        return LAW_OK;
    }
    view->newest_crc = trials->past->crc;
    view->trials = trials->past->trials;
    const uint32_t ended = view->trials + 1u;
    const law_weights_t before = past_mean_before(ended);
    view->now = past_mean_now(ended);
    return add(trials, law, &before);
}

static law_result_t add_window(const past_trials_t *trials, const law_t *law, past_view_t *view) {
    const uint16_t most = past_trials_reach(trials->params);
    const uint16_t earlier = count_back(trials, PAST_WINDOW, most);
    view->now = past_average_weight(most + 1u, earlier + 1u);
    view->trials = earlier;
    walk_t walk = begin_walk(trials, PAST_WINDOW);
    law_result_t result = LAW_OK;
    while (walk.back < earlier && result == LAW_OK) {
        result = step_back(trials, &walk) ? add(trials, law, &view->now) : LAW_BAD_INPUT;
        if (walk.back == 1u) {
            view->newest_crc = trials->past->crc;
            view->shortened = earlier < most && earlier < trials->past->trials;
        }
    }
    return result;
}

static law_result_t add_past(const past_trials_t *trials, const law_t *law, past_view_t *view) {
    switch (view->kind) {
    case PAST_MEAN:
        return add_mean(trials, law, view);
    case PAST_WINDOW:
        return add_window(trials, law, view);
    case PAST_LAST:
    case PAST_KIND_COUNT:
        break;
    }
    return LAW_OK;
}

law_result_t past_trials_look_back(const past_trials_t *trials, const law_t *law,
                                   past_view_t *view) {
    const memory_t *memory = trials->memory;
    const bool learned = memory->iteration > 1u && memory->input == MEMORY_INPUT_LAW;
    *view = (past_view_t){.kind = settings_past_kind(trials->params)};
    memset(trials->sum_rad, 0, BEATS_MAX * sizeof *trials->sum_rad);
    const law_result_t result = add_past(trials, law, view);
    if (view->kind != PAST_LAST && view->newest_crc == 0) {
        view->shortened = learned;
    }
    return result;
}

/* Into trials->past, where the means of the trials before still are. */
static void take_in(const past_trials_t *trials, const law_t *law, const trial_record_t *trial,
                    const law_trial_t *errors, const past_view_t *view) {
    past_t *past = trials->past;
    if (view->kind == PAST_MEAN) {
        if (view->trials == 0) {
            memset(past, 0, sizeof *past);
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

store_result_t past_trials_keep(const past_trials_t *trials, const law_t *law,
                                const trial_record_t *trial, const law_trial_t *errors,
                                const past_view_t *view) {
    if (view->kind == PAST_LAST) {
        return STORE_OK;
    }
    past_t *past = trials->past;
    take_in(trials, law, trial, errors, view);
    past->previous_crc = view->newest_crc;
    past->kind = (uint16_t)view->kind;
    past->trials = (uint16_t)(view->trials + (view->trials < UINT16_MAX));
    past->beats = trial->beats;
    past->learned_crc = vault_memory_crc(trials->vault, trials->memory);
    return vault_save_past(trials->vault, trials->memory->iteration - 1u, past);
}

uint32_t past_trials_room_blocks(const params_t *params) {
    return settings_past_kind(params) == PAST_LAST ? 0u : VAULT_PAST_ROOM_BLOCKS;
}

uint16_t past_trials_reach(const params_t *params) {
    switch (settings_past_kind(params)) {
    case PAST_MEAN:
        return 1;
    case PAST_WINDOW:
        return (uint16_t)(settings_past_window(params) - 1u);
    case PAST_LAST:
    case PAST_KIND_COUNT:
        break;
    }
    return 0;
}

bool past_trials_drop(vault_t *vault, uint16_t iteration, uint16_t keep) {
    vault_still_alive(vault);
    for (uint32_t back = VAULT_PAST_PLACES; back > keep; back--) {
        if (vault_drop_past(vault, iteration - back)) {
            return true;
        }
    }
    return false;
}
