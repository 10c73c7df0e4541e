#include "learn_past.h"

#include <string.h>

bool learn_past_begin(learn_past_t *past, uint16_t kind, uint16_t window) {
    memset(past, 0, sizeof *past);
    past->kind = kind;
    past->window = window;
    return kind < PAST_KIND_COUNT && window >= 2u && window <= PAST_WINDOW_MAX;
}

static law_trial_t trial_of(const learn_trial_t *kept, const memory_t *memory) {
    return (law_trial_t){.beats = memory->beats,
                         .error_m_s = kept->error_m_s,
                         .measured = kept->measured,
                         .visits = memory->visits};
}

static law_result_t add_mean(const learn_past_t *past, const law_t *law, const memory_t *memory,
                             memory_rules_t *rules, float *scratch) {
    const uint32_t ended = past->trials + 1u;
    const law_weights_t before = past_mean_before(ended);
    law_trial_t mean = trial_of(&past->trial[0], memory);
    mean.measured = NULL;
    rules->now = past_mean_now(ended);
    return law_add(law, &before, &mean, past->trial[0].amplitude_rad, scratch);
}

static law_result_t add_window(const learn_past_t *past, const law_t *law, const memory_t *memory,
                               memory_rules_t *rules, float *scratch) {
    const uint32_t kept = past->window - 1u;
    const uint32_t earlier = past->trials < kept ? past->trials : kept;
    law_result_t result = LAW_OK;
    rules->now = past_average_weight(past->window, earlier + 1u);
    for (uint32_t back = 1; back <= earlier && result == LAW_OK; back++) {
        const learn_trial_t *one = &past->trial[(past->trials - back) % kept];
        const law_trial_t trial = trial_of(one, memory);
        result = law_add(law, &rules->now, &trial, one->amplitude_rad, scratch);
    }
    return result;
}

law_result_t learn_past_add(const learn_past_t *past, const law_t *law, const memory_t *memory,
                            memory_rules_t *rules, float *scratch) {
    rules->has_past = past->kind != PAST_LAST;
    if (!rules->has_past) {
        return LAW_OK;
    }
    if (!past_fits((past_kind_t)past->kind, law)) {
        return LAW_BAD_CONFIG;
    }
    memset(scratch, 0, memory->beats * sizeof scratch[0]);
    return past->kind == PAST_MEAN ? add_mean(past, law, memory, rules, scratch)
                                   : add_window(past, law, memory, rules, scratch);
}

static void keep_in_window(learn_past_t *past, const law_t *law, const law_trial_t *trial,
                           const float *amplitude_rad) {
    learn_trial_t *one = &past->trial[past->trials % (past->window - 1u)];
    for (uint32_t k = 0; k < trial->beats; k++) {
        one->amplitude_rad[k] = law_saturate(law, amplitude_rad[k]);
        one->error_m_s[k] = trial->error_m_s[k];
        one->measured[k] = trial->measured[k];
    }
}

void learn_past_keep(learn_past_t *past, const law_t *law, const law_trial_t *trial,
                     const float *amplitude_rad) {
    if (past->kind == PAST_MEAN) {
        learn_trial_t *mean = &past->trial[0];
        past_mean_add(law, past->trials + 1u, trial, amplitude_rad, mean->amplitude_rad,
                      mean->error_m_s);
    } else if (past->kind == PAST_WINDOW) {
        keep_in_window(past, law, trial, amplitude_rad);
    }
    past->trials++;
}
