#include "learn_batch.h"

#include <math.h>
#include <string.h>

static void applied(const memory_t *memory, const law_t *law, double *applied_rad) {
    for (uint32_t k = 0; k < memory->beats; k++) {
        applied_rad[k] = (double)law_saturate(law, memory->amplitude_rad[k]);
    }
}

bool learn_batch_first(memory_t *memories, const law_t *laws, size_t fish, uint16_t beats,
                       const float *reference_m_s, double *applied_rad) {
    float scratch[BEATS_MAX];
    if (beats < 1u || beats > BEATS_MAX) {
        return false;
    }
    for (size_t i = 0; i < fish; i++) {
        memories[i].last_trial = 0;
        memory_begin(&memories[i], 1, beats);
        if (memory_first(&memories[i], &laws[i], reference_m_s, scratch) != LAW_OK) {
            return false;
        }
        applied(&memories[i], &laws[i], applied_rad + i * beats);
    }
    return true;
}

/* In the single precision of the board, as the speeds of a trial are. */
static void errors_of(const float *reference_m_s, const double *speed_m_s, uint32_t beats,
                      float *error_m_s, uint8_t *measured) {
    for (uint32_t k = 0; k < beats; k++) {
        const float speed = (float)speed_m_s[k];
        measured[k] = (uint8_t)(isfinite(speed) ? 1 : 0);
        error_m_s[k] = measured[k] ? reference_m_s[k] - speed : 0.0f;
    }
}

/* One fish: what the board does with its store. A refused trial is not kept, and amplitudes brought
 * back have no past. */
static law_result_t learn_one(memory_t *memory, learn_past_t *past, const law_t *law,
                              const law_trial_t *swum, uint32_t trial, float rollback_ratio,
                              memory_report_t *report) {
    const bool complete = swum->measured[swum->beats - 1u] != 0;
    float scratch[BEATS_MAX], swum_rad[BEATS_MAX];
    memory_rules_t rules = {.rollback_ratio = rollback_ratio};
    if (past == NULL) {
        return memory_learn(memory, law, swum, trial, complete, &rules, scratch, report);
    }
    law_result_t result = learn_past_add(past, law, memory, &rules, scratch);
    memcpy(swum_rad, memory->amplitude_rad, memory->beats * sizeof swum_rad[0]);
    if (result == LAW_OK) {
        result = memory_learn(memory, law, swum, trial, complete, &rules, scratch, report);
    }
    if (result == LAW_OK && report->rolled_back) {
        (void)learn_past_begin(past, past->kind, past->window);
    } else if (result == LAW_OK) {
        learn_past_keep(past, law, swum, swum_rad);
    }
    return result;
}

bool learn_batch_learn(memory_t *memories, learn_past_t *pasts, const law_t *laws, size_t fish,
                       const float *reference_m_s, const double *speed_m_s, uint32_t trial,
                       float rollback_ratio, memory_report_t *reports, double *applied_rad) {
    float error[BEATS_MAX];
    uint8_t measured[BEATS_MAX];
    for (size_t i = 0; i < fish; i++) {
        memory_t *memory = &memories[i];
        const size_t row = i * memory->beats;
        errors_of(reference_m_s, speed_m_s + row, memory->beats, error, measured);
        const law_trial_t swum = {.beats = memory->beats, .error_m_s = error, .measured = measured};
        memset(&reports[i], 0, sizeof reports[i]);
        const law_result_t result = learn_one(memory, pasts == NULL ? NULL : &pasts[i], &laws[i],
                                              &swum, trial, rollback_ratio, &reports[i]);
        if (result != LAW_OK && result != LAW_NOTHING_MEASURED) {
            return false;
        }
        applied(memory, &laws[i], applied_rad + row);
    }
    return true;
}
