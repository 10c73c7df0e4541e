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

static float peak_size(const judge_peaks_t *peaks, uint32_t i) {
    return (float)number_abs((number_t)peaks->error_m_s[i]);
}

/* The best's score on the beats that |trial| measured. */
static float best_there(const judge_peaks_t *best, float best_m_s, const law_trial_t *trial) {
    float there = best_m_s;
    for (uint32_t i = 0; i < best->count; i++) {
        if (best->error_m_s[i] > 0.0f) {
            there = best->error_m_s[i];
            if (is_measured(trial, best->beat[i])) {
                break;
            }
        }
    }
    return there;
}

/* 0 = nothing is carried over there. */
static float carried_at(const judge_peaks_t *best, uint32_t beat) {
    for (uint32_t i = 0; i < best->count; i++) {
        if (best->beat[i] == beat && best->error_m_s[i] < 0.0f) {
            return -best->error_m_s[i];
        }
    }
    return 0.0f;
}

static float size_at(const law_trial_t *trial, uint32_t beat) {
    return is_measured(trial, beat) ? (float)number_abs(trial->error_m_s[beat]) : 0.0f;
}

bool judge_is_better(const judge_peaks_t *best, float best_m_s, const law_trial_t *trial) {
    const float there = best_there(best, best_m_s, trial);
    for (uint32_t k = 0; k < trial->beats; k++) {
        const float carried = carried_at(best, k), error = size_at(trial, k);
        const bool excused = carried > 0.0f && error <= carried;
        if (error >= there && !excused) {
            return false;
        }
    }
    return true;
}

bool judge_is_worse(const judge_peaks_t *best, float best_m_s, const law_trial_t *trial,
                    float ratio) {
    for (uint32_t k = 0; k < trial->beats; k++) {
        const float carried = carried_at(best, k);
        if (size_at(trial, k) > ratio * (carried > best_m_s ? carried : best_m_s)) {
            return true;
        }
    }
    return false;
}

static bool is_ahead(const judge_peaks_t *peaks, uint32_t i, uint16_t beat, float size_m_s) {
    return peak_size(peaks, i) > size_m_s ||
           (!(size_m_s > peak_size(peaks, i)) && peaks->beat[i] < beat);
}

/* Into its place, unless all are larger. */
static void add(judge_peaks_t *peaks, uint16_t beat, float error_m_s, bool carried) {
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
    peaks->error_m_s[at] = carried ? -error_m_s : error_m_s;
}

void judge_keep(judge_peaks_t *best, const law_trial_t *trial) {
    const judge_peaks_t before = *best;
    *best = (judge_peaks_t){0};
    for (uint32_t i = 0; i < before.count; i++) {
        if (!is_measured(trial, before.beat[i])) {
            add(best, before.beat[i], peak_size(&before, i), true);
        }
    }
    for (uint32_t k = 0; k < trial->beats; k++) {
        if (is_measured(trial, k)) {
            add(best, (uint16_t)k, size_at(trial, k), false);
        }
    }
}
