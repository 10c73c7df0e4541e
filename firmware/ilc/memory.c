#include "ilc/memory.h"

#include "base/panic.h"

#include <string.h>

#define WORSE_TRIALS_TO_ROLL_BACK 2u

void memory_begin(memory_t *memory, uint32_t reference_crc, uint16_t beats) {
    REQUIRE(beats >= 1u && beats <= BEATS_MAX);
    const uint32_t last_trial = memory->last_trial;
    memset(memory, 0, sizeof *memory);
    memory->reference_crc = reference_crc;
    memory->last_trial = last_trial;
    memory->beats = beats;
}

static void fill_zero(float *values, uint32_t count) {
    for (uint32_t k = 0; k < count; k++) {
        values[k] = 0.0f;
    }
}

law_result_t memory_first(memory_t *memory, const law_t *law, const float *reference_m_s,
                          float *scratch) {
    REQUIRE(memory->iteration <= 1u);
    law_t first = *law;
    first.step_max_rad = 0.0f;
    const law_trial_t rest = {.beats = memory->beats, .error_m_s = reference_m_s};
    law_report_t report;
    fill_zero(scratch, memory->beats);
    const law_result_t result = law_judge(&first, &rest, scratch, &report);
    if (result != LAW_OK) {
        return result;
    }
    fill_zero(memory->amplitude_rad, memory->beats);
    REQUIRE(law_update(&first, &rest, memory->amplitude_rad, scratch, &report) == LAW_OK);
    memory->iteration = 1;
    memory->input = MEMORY_INPUT_FIRST;
    return LAW_OK;
}

static void keep_best(memory_t *memory, const law_t *law, const law_trial_t *trial,
                      float max_abs_error_m_s) {
    for (uint32_t k = 0; k < memory->beats; k++) {
        memory->best_rad[k] = law_saturate(law, memory->amplitude_rad[k]);
    }
    memory->best_iteration = memory->iteration;
    memory->best_max_abs_error_m_s = max_abs_error_m_s;
    judge_keep(&memory->peaks, trial);
}

static bool is_worse(const memory_t *memory, const law_trial_t *trial, float ratio) {
    return memory->best_iteration != 0 && ratio > 0.0f &&
           judge_is_worse(&memory->peaks, memory->best_max_abs_error_m_s, trial, ratio);
}

static bool is_better(const memory_t *memory, const law_trial_t *trial) {
    return memory->best_iteration == 0 ||
           judge_is_better(&memory->peaks, memory->best_max_abs_error_m_s, trial);
}

/* Notes what a trial's error says about its amplitudes. True when it is the new best. */
static bool rate(memory_t *memory, const law_t *law, const law_trial_t *trial,
                 float max_abs_error_m_s, bool complete, float ratio) {
    const bool judged = judge_counts(trial, complete);
    if (judged && is_better(memory, trial)) {
        keep_best(memory, law, trial, max_abs_error_m_s);
        memory->worse_streak = 0;
        return true;
    }
    if (is_worse(memory, trial, ratio)) {
        memory->worse_streak++;
    } else if (judged) {
        memory->worse_streak = 0;
    }
    return false;
}

static void count_trial(memory_t *memory, uint32_t trial_number) {
    memory->last_trial = trial_number;
    memory->iteration = memory->iteration < UINT16_MAX ? (uint16_t)(memory->iteration + 1u)
                                                       : (uint16_t)(UINT16_MAX + 1u - MEMORY_ROUND);
}

static void count_visits(memory_t *memory, const law_t *law, const law_trial_t *trial) {
    for (uint32_t k = 0; k < memory->beats; k++) {
        if (memory->visits[k] < UINT8_MAX && law_corrects(law, trial, k)) {
            memory->visits[k]++;
        }
    }
}

/* Into |scratch|; nothing is changed yet. */
static law_result_t add_trial(const memory_t *memory, const law_t *law, const law_trial_t *trial,
                              const memory_rules_t *rules, float *scratch) {
    static const law_weights_t alone = {1.0f, 1.0f, 1.0f};
    law_trial_t visited = *trial;
    visited.visits = memory->visits;
    if (!rules->has_past) {
        fill_zero(scratch, memory->beats);
    }
    return law_add(law, rules->has_past ? &rules->now : &alone, &visited, memory->amplitude_rad,
                   scratch);
}

static void correct(memory_t *memory, const law_t *law, const law_trial_t *trial,
                    const memory_rules_t *rules, float *scratch) {
    count_visits(memory, law, trial);
    /* Ahead of filter and step limit, which hold for these beats, too. */
    const uint16_t until = law_kept_from(law, memory->beats);
    beyond_fill(rules->beyond, memory->beats, until, memory->visits, scratch);
    law_finish(law, memory->beats, scratch, memory->amplitude_rad);
    memory->input = MEMORY_INPUT_LAW;
}

law_result_t memory_learn(memory_t *memory, const law_t *law, const law_trial_t *trial,
                          uint32_t trial_number, bool complete, const memory_rules_t *rules,
                          float *scratch, memory_report_t *report) {
    if (trial->beats != memory->beats) {
        return LAW_BAD_CONFIG;
    }
    if (memory->iteration == 0) {
        return LAW_BAD_INPUT;
    }
    memory_report_t found = {0};
    law_result_t result = law_judge(law, trial, memory->amplitude_rad, &found.law);
    if (result == LAW_OK) {
        result = add_trial(memory, law, trial, rules, scratch);
    }
    if (result != LAW_OK) {
        return result;
    }
    found.improved =
        rate(memory, law, trial, found.law.max_abs_error_m_s, complete, rules->rollback_ratio);
    found.rolled_back =
        memory->worse_streak >= WORSE_TRIALS_TO_ROLL_BACK && memory_restore_best(memory);
    if (!found.rolled_back) {
        correct(memory, law, trial, rules, scratch);
    }
    count_trial(memory, trial_number);
    *report = found;
    return LAW_OK;
}

bool memory_restore_best(memory_t *memory) {
    if (memory->best_iteration == 0) {
        return false;
    }
    memcpy(memory->amplitude_rad, memory->best_rad, memory->beats * sizeof memory->best_rad[0]);
    memory->worse_streak = 0;
    memory->input = MEMORY_INPUT_RESTORED;
    return true;
}
