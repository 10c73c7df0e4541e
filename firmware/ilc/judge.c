#include "ilc/judge.h"

#include <stddef.h>

/* At least SHARE_PART of SHARE_WHOLE beats are measured. */
#define SHARE_PART 4u
#define SHARE_WHOLE 5u

static bool is_measured(const law_trial_t *trial, uint32_t beat) {
    return trial->measured == NULL || trial->measured[beat] != 0;
}

bool judge_counts(const law_trial_t *trial, bool complete) {
    uint32_t measured = 0, gap = 0, longest = 0;
    for (uint32_t k = 0; k < trial->beats; k++) {
        const bool known = is_measured(trial, k);
        measured += known;
        gap = known ? 0 : gap + 1u;
        longest = gap > longest ? gap : longest;
    }
    return complete && SHARE_WHOLE * measured >= SHARE_PART * trial->beats &&
           longest <= JUDGE_GAP_MAX;
}

float judge_best_there(const judge_peaks_t *best, const law_trial_t *trial, float otherwise) {
    for (uint32_t i = 0; i < best->count; i++) {
        if (is_measured(trial, best->beat[i])) {
            return best->error_m_s[i];
        }
    }
    return best->count != 0 ? best->error_m_s[best->count - 1u] : otherwise;
}

static bool is_ahead(const judge_peaks_t *peaks, uint32_t i, uint16_t beat, float error_m_s) {
    return peaks->error_m_s[i] > error_m_s ||
           (!(error_m_s > peaks->error_m_s[i]) && peaks->beat[i] < beat);
}

/* Into its place, unless all are larger. */
static void add(judge_peaks_t *peaks, uint16_t beat, float error_m_s) {
    if (!(error_m_s > 0.0f)) {
        return;
    }
    uint32_t at = peaks->count;
    while (at > 0 && !is_ahead(peaks, at - 1u, beat, error_m_s)) {
        at--;
    }
    if (at == JUDGE_PEAKS) {
        return;
    }
    if (peaks->count < JUDGE_PEAKS) {
        peaks->count++;
    }
    for (uint32_t i = peaks->count - 1u; i > at; i--) {
        peaks->beat[i] = peaks->beat[i - 1u];
        peaks->error_m_s[i] = peaks->error_m_s[i - 1u];
    }
    peaks->beat[at] = beat;
    peaks->error_m_s[at] = error_m_s;
}

void judge_keep(judge_peaks_t *best, const law_trial_t *trial) {
    const judge_peaks_t before = *best;
    *best = (judge_peaks_t){0};
    for (uint32_t i = 0; i < before.count; i++) {
        if (!is_measured(trial, before.beat[i])) {
            add(best, before.beat[i], before.error_m_s[i]);
        }
    }
    for (uint32_t k = 0; k < trial->beats; k++) {
        if (is_measured(trial, k)) {
            add(best, (uint16_t)k, (float)number_abs(trial->error_m_s[k]));
        }
    }
}
