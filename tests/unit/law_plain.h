/*
 * The law as law.h writes it down, operation by operation: every sum, product and quotient is made,
 * whatever its factors are. law.c leaves out those whose result is known and must give the same
 * bits.
 */
#ifndef LAW_PLAIN_H
#define LAW_PLAIN_H

#include "ilc/law.h"

#include <stddef.h>

static number_t plain_clip(number_t x, number_t low, number_t high) {
    if (x < low) {
        return low;
    }
    return x > high ? high : x;
}

static number_t plain_saturate(const law_t *law, number_t amplitude_rad) {
    return plain_clip(amplitude_rad, law->amplitude_min_rad, law->amplitude_max_rad);
}

static uint32_t lead_halves(const law_t *law) { return (uint32_t)(NUMBER(2) * law->lead_beats); }

static bool is_measured(const law_trial_t *trial, uint32_t beat) {
    return trial->measured == NULL || trial->measured[beat] != 0;
}

static number_t error_at(const law_trial_t *trial, uint32_t beat) {
    return is_measured(trial, beat) ? trial->error_m_s[beat] : NUMBER(0);
}

static bool inputs_finite(const law_trial_t *trial, const number_t *amplitude_rad) {
    bool finite = true;
    for (uint32_t k = 0; k < trial->beats; k++) {
        finite =
            finite && number_is_finite(amplitude_rad[k]) && number_is_finite(error_at(trial, k));
    }
    return finite;
}

static law_report_t judged(const law_t *law, const law_trial_t *trial,
                           const number_t *amplitude_rad) {
    law_report_t report = {0};
    number_t sum = NUMBER(0);
    for (uint32_t k = 0; k < trial->beats; k++) {
        const number_t error = number_abs(error_at(trial, k));
        sum += error * error;
        if (error > report.max_abs_error_m_s) {
            report.max_abs_error_m_s = error;
        }
        if (is_measured(trial, k)) {
            report.measured_beats++;
        }
        if (amplitude_rad[k] > law->amplitude_max_rad) {
            report.saturated_beats++;
        }
    }
    if (report.measured_beats > 0) {
        report.rms_error_m_s = number_sqrt(sum / (number_t)report.measured_beats);
    }
    return report;
}

/* e[beat+1] - e[beat] begins at the beat itself; the last one repeats the difference before it. */
static uint32_t difference_from(const law_trial_t *trial, uint32_t beat) {
    return beat + 1u < trial->beats ? beat : beat - 1u;
}

static number_t difference_at(const law_trial_t *trial, uint32_t beat) {
    if (trial->beats == 1u) {
        return NUMBER(0);
    }
    const uint32_t from = difference_from(trial, beat);
    const bool known = is_measured(trial, from) && is_measured(trial, from + 1u);
    return known ? trial->error_m_s[from + 1u] - trial->error_m_s[from] : NUMBER(0);
}

/* The two beats whose mean corrects a beat; one and the same where no half is involved. */
typedef struct {
    uint32_t first, second;
} pair_t;

/* False when |beat| is the tail's, and that does not look at errors. */
static bool pair_ahead(const law_t *law, uint32_t beats, uint32_t beat, pair_t *pair) {
    const uint32_t last = 2u * (beats - 1u);
    const uint32_t ahead = 2u * beat + lead_halves(law);
    const uint32_t at = ahead > last ? last : ahead;
    *pair = (pair_t){at / 2u, (at + 1u) / 2u};
    return ahead <= last || law->tail == LAW_TAIL_HOLD;
}

/* Beats at the end that a tail other than LAW_TAIL_HOLD fills. */
static uint32_t tail_beats(const law_t *law) { return (lead_halves(law) + 1u) / 2u; }

static number_t error_of(const law_trial_t *trial, pair_t pair) {
    if (pair.first == pair.second) {
        return error_at(trial, pair.first);
    }
    const bool both = is_measured(trial, pair.first) && is_measured(trial, pair.second);
    const number_t sum = error_at(trial, pair.first) + error_at(trial, pair.second);
    return both ? NUMBER(0.5) * sum : sum;
}

static number_t difference_of(const law_trial_t *trial, pair_t pair) {
    const number_t first = difference_at(trial, pair.first);
    return pair.first == pair.second ? first
                                     : NUMBER(0.5) * (first + difference_at(trial, pair.second));
}

/* What the gain of |beat| is divided by. */
static number_t fade_of(const law_t *law, const law_trial_t *trial, uint32_t beat) {
    const uint32_t visits = trial->visits != NULL ? trial->visits[beat] : 0u;
    const uint32_t beyond = visits > law->fade_from ? visits - law->fade_from : 0u;
    return NUMBER(1) + law->fade * (number_t)beyond;
}

static void accumulate(const law_t *law, const law_weights_t *weights, const law_trial_t *trial,
                       const number_t *amplitude_rad, number_t *sum) {
    const number_t kp = weights->kp * law->kp_rad_s_m;
    const number_t kd_per_beat = weights->kd * (law->kd_rad_s2_m / law->beat_s);
    for (uint32_t k = 0; k < trial->beats; k++) {
        const number_t old = weights->input * plain_saturate(law, amplitude_rad[k]);
        pair_t pair;
        if (!pair_ahead(law, trial->beats, k, &pair)) {
            sum[k] += old;
            continue;
        }
        const number_t fade = fade_of(law, trial, k);
        const number_t proportional = kp / fade * error_of(trial, pair);
        const number_t derivative = kd_per_beat / fade * difference_of(trial, pair);
        sum[k] += old + (proportional + derivative);
    }
}

/* Neighbours are added in pairs, so that a mirrored record gives the mirrored bits. */
static number_t zero_phase_at(const number_t *in, uint32_t beats, uint32_t k, uint32_t q_len) {
    if (q_len == 1u) {
        return in[k];
    }
    number_t sum = (number_t)q_len * in[k];
    uint32_t weights = q_len;
    for (uint32_t j = 1; j < q_len; j++) {
        const uint32_t weight = q_len - j;
        const bool before = k >= j;
        const bool after = k + j < beats;
        if (before && after) {
            sum += (number_t)weight * (in[k - j] + in[k + j]);
            weights += 2u * weight;
        } else if (before || after) {
            sum += (number_t)weight * (before ? in[k - j] : in[k + j]);
            weights += weight;
        }
    }
    return sum / (number_t)weights;
}

static void hold_tail(const law_t *law, uint32_t beats, const number_t *amplitude_rad,
                      number_t *sum) {
    const uint32_t tail = tail_beats(law);
    const bool hold_new = law->tail == LAW_TAIL_HOLD_NEW;
    const bool hold_old = law->tail == LAW_TAIL_HOLD_OLD;
    if (tail >= beats || !(hold_new || hold_old)) {
        return;
    }
    const uint32_t last = beats - 1u - tail;
    const number_t held = hold_new ? sum[last] : plain_saturate(law, amplitude_rad[last]);
    for (uint32_t k = last + 1u; k < beats; k++) {
        sum[k] = held;
    }
}

static number_t step_limited(const law_t *law, number_t old_rad, number_t next_rad) {
    if (law->step_max_rad <= NUMBER(0)) {
        return next_rad;
    }
    const number_t swum_rad = plain_saturate(law, old_rad);
    return plain_clip(next_rad, swum_rad - law->step_max_rad, swum_rad + law->step_max_rad);
}

static void plain_add(const law_t *law, const law_weights_t *weights, const law_trial_t *trial,
                      const number_t *amplitude_rad, number_t *sum) {
    accumulate(law, weights, trial, amplitude_rad, sum);
}

static void plain_finish(const law_t *law, uint32_t beats, number_t *sum, number_t *amplitude_rad) {
    hold_tail(law, beats, amplitude_rad, sum);
    for (uint32_t k = 0; k < beats; k++) {
        const number_t filtered = zero_phase_at(sum, beats, k, law->q_len);
        amplitude_rad[k] = step_limited(law, amplitude_rad[k], filtered);
    }
}

/* Of a law and a trial that law_update accepts. */
static void plain_update(const law_t *law, const law_trial_t *trial, number_t *amplitude_rad,
                         number_t *scratch, law_report_t *report) {
    const law_weights_t whole = {NUMBER(1), NUMBER(1), NUMBER(1)};
    *report =
        inputs_finite(trial, amplitude_rad) ? judged(law, trial, amplitude_rad) : (law_report_t){0};
    for (uint32_t k = 0; k < trial->beats; k++) {
        scratch[k] = NUMBER(0);
    }
    plain_add(law, &whole, trial, amplitude_rad, scratch);
    plain_finish(law, trial->beats, scratch, amplitude_rad);
}

#endif
