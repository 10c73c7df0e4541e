#include "law_memory.h"

#include <string.h>

law_result_t law_memory_learn(law_memory_t *whole, const law_t *law, const float *error_m_s,
                              const uint8_t *measured, bool complete, float rollback_ratio,
                              beyond_t beyond, memory_report_t *report) {
    memory_t *memory = &whole->memory;
    learn_past_t *past = &whole->past;
    const law_trial_t trial = {
        .beats = memory->beats, .error_m_s = error_m_s, .measured = measured};
    memory_rules_t rules = {.rollback_ratio = rollback_ratio, .beyond = beyond};
    float executed[BEATS_MAX], scratch[BEATS_MAX];
    memcpy(executed, memory->amplitude_rad, memory->beats * sizeof executed[0]);
    law_result_t result = learn_past_add(past, law, memory, &rules, scratch);
    if (result == LAW_OK) {
        result = memory_learn(memory, law, &trial, 1, complete, &rules, scratch, report);
    }
    if (result != LAW_OK) {
        return result;
    }
    if (report->rolled_back) {
        (void)learn_past_begin(past, past->kind, past->window);
    } else {
        learn_past_keep(past, law, &trial, executed);
    }
    return LAW_OK;
}

law_result_t law_memory_learn_all(law_memory_t *memories, const law_t *laws, size_t count,
                                  const float *error_m_s, const uint8_t *measured,
                                  const uint8_t *complete, float rollback_ratio,
                                  uint8_t *rolled_back) {
    law_result_t result = LAW_OK;
    for (size_t i = 0; i < count && result == LAW_OK; i++) {
        const size_t beats = memories[i].memory.beats, row = i * beats;
        memory_report_t report = {0};
        if (memchr(measured + row, 1, beats) != NULL) {
            result = law_memory_learn(&memories[i], &laws[i], error_m_s + row, measured + row,
                                      complete[i] != 0, rollback_ratio, BEYOND_KEEP, &report);
        }
        rolled_back[i] = report.rolled_back;
    }
    return result;
}
