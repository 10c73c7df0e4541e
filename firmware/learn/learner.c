#include "learn/learner.h"

#include "base/real.h"
#include "learn/past_trials.h"
#include "learn/reference.h"
#include "settings/settings.h"

#include <string.h>

void learner_init(learner_t *learner, vault_t *vault, const params_t *params) {
    learner->vault = vault;
    learner->params = params;
}

static void load_memory(learner_t *learner) {
    const reference_t *reference = &learner->reference;
    memory_t *memory = &learner->memory;
    if (!vault_load_memory(learner->vault, memory)) {
        memset(memory, 0, sizeof *memory);
    }
    const bool of_reference =
        memory->reference_crc == reference->crc && memory->beats == reference->beats;
    if (!of_reference && reference->beats != 0) {
        memory_begin(memory, reference->crc, reference->beats);
    }
}

void learner_load(learner_t *learner) {
    if (!vault_load_reference(learner->vault, &learner->reference)) {
        learner->reference.beats = 0;
        learner->reference.crc = 0;
    }
    load_memory(learner);
}

fault_t learner_save(learner_t *learner) {
    if (vault_save_memory(learner->vault, &learner->memory) == STORE_OK) {
        return FAULT_NONE;
    }
    load_memory(learner);
    return FAULT_WRITE_FAILED;
}

fault_t learner_set_reference(learner_t *learner, const reference_t *next) {
    const fault_t refused = reference_judge(learner->params, next);
    if (refused != FAULT_NONE || next->crc == learner->reference.crc) {
        return refused;
    }
    if (vault_save_reference(learner->vault, next) != STORE_OK) {
        return FAULT_WRITE_FAILED;
    }
    learner->reference = *next;
    load_memory(learner);
    const fault_t fault = learner_save(learner);
    while (learner_drop_past(learner, 0)) {
    }
    return fault;
}

static bool belongs(const learner_t *learner, uint16_t beats, uint32_t reference_crc) {
    return beats == learner->reference.beats && reference_crc == learner->reference.crc;
}

fault_t learner_set_amplitudes(learner_t *learner, const amplitudes_upload_t *next) {
    memory_t *memory = &learner->memory;
    if (!belongs(learner, next->beats, next->reference_crc)) {
        return FAULT_WRONG_BEATS;
    }
    memcpy(memory->amplitude_rad, next->amplitude_rad, next->beats * sizeof(float));
    memory->iteration = memory->iteration == 0 ? 1 : memory->iteration;
    memory->input = MEMORY_INPUT_UPLOADED;
    return learner_save(learner);
}

fault_t learner_set_memory(learner_t *learner, const memory_t *next) {
    if (!belongs(learner, next->beats, next->reference_crc)) {
        return FAULT_WRONG_BEATS;
    }
    if (vault_drop_trial(learner->vault) != STORE_OK) {
        return FAULT_WRITE_FAILED;
    }
    learner->memory = *next;
    return learner_save(learner);
}

bool learner_has_guess(const learner_t *learner) {
    return learner->memory.input == MEMORY_INPUT_FIRST;
}

fault_t learner_guess_first(learner_t *learner) {
    if (learner->memory.iteration != 0 && !learner_has_guess(learner)) {
        return FAULT_NONE;
    }
    const law_t law = settings_law(learner->params, learner->reference.beat_s);
    return memory_first(&learner->memory, &law, learner->reference.speed_m_s, learner->scratch) ==
                   LAW_OK
               ? FAULT_NONE
               : FAULT_BAD_LAW;
}

const float *learner_applied(learner_t *learner) {
    const law_t law = settings_law(learner->params, learner->reference.beat_s);
    for (uint16_t k = 0; k < learner->reference.beats; k++) {
        learner->scratch[k] = law_saturate(&law, learner->memory.amplitude_rad[k]);
    }
    return learner->scratch;
}

static law_trial_t errors_of(learner_t *learner, const trial_record_t *trial) {
    for (uint16_t k = 0; k < trial->beats; k++) {
        const bool measured = k < trial->executed && real_is_finite(trial->speed_m_s[k]);
        learner->measured[k] = measured;
        learner->error_m_s[k] =
            measured ? learner->reference.speed_m_s[k] - trial->speed_m_s[k] : 0.0f;
    }
    return (law_trial_t){
        .beats = trial->beats, .error_m_s = learner->error_m_s, .measured = learner->measured};
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

static law_result_t update(learner_t *learner, const past_trials_t *past, const law_t *law,
                           const trial_record_t *trial, past_view_t *view, law_trial_t *errors,
                           memory_report_t *report) {
    const bool complete = trial->end == FAULT_NONE && trial->executed == trial->beats;
    if (!past_fits(settings_past_kind(learner->params), law)) {
        return LAW_BAD_CONFIG;
    }
    const law_result_t looked = past_trials_look_back(past, law, view);
    if (looked != LAW_OK) {
        return looked;
    }
    memory_rules_t rules = settings_memory_rules(learner->params);
    rules.has_past = view->kind != PAST_LAST;
    rules.now = view->now;
    *errors = errors_of(learner, trial);
    return memory_learn(&learner->memory, law, errors, trial->number, complete, &rules,
                        learner->scratch, report);
}

/* What was learned, ahead of it what it came from. */
static fault_t learn(learner_t *learner, const past_trials_t *past, const trial_record_t *trial,
                     learner_outcome_t *outcome) {
    const law_t law = settings_law(learner->params, learner->reference.beat_s);
    past_view_t view;
    law_trial_t errors;
    const law_result_t result =
        update(learner, past, &law, trial, &view, &errors, &outcome->report);
    if (result != LAW_OK) {
        return refusal(result);
    }
    const bool rolled_back = outcome->report.rolled_back;
    outcome->shortened = view.shortened && !rolled_back;
    if (!rolled_back && past_trials_keep(past, &law, trial, &errors, &view) != STORE_OK) {
        load_memory(learner);
        return FAULT_WRITE_FAILED;
    }
    return learner_save(learner);
}

fault_t learner_learn(learner_t *learner, const trial_record_t *trial, learner_outcome_t *outcome) {
    const past_trials_t past = {
        .vault = learner->vault,
        .params = learner->params,
        .memory = &learner->memory,
        .past = &workspace_take(&learner->vault->workspace, WORKSPACE_PAST)->past,
        .sum_rad = learner->scratch,
        .measured = learner->measured,
    };
    *outcome = (learner_outcome_t){.shortened = false};
    const fault_t fault = learn(learner, &past, trial, outcome);
    workspace_give_back(&learner->vault->workspace, WORKSPACE_PAST);
    return fault;
}

fault_t learner_restore_best(learner_t *learner) {
    return memory_restore_best(&learner->memory) ? learner_save(learner) : FAULT_NO_BEST;
}

bool learner_drop_past(learner_t *learner, uint16_t keep) {
    return past_trials_drop(learner->vault, learner->memory.iteration, keep);
}
