#include "ilc/law.h"

#include "base/real.h"

#include <stddef.h>

/* Corrections beyond this are refused. Any bound will do that keeps the filter's sums finite: its
 * integer weights add up to at most 2^16. */
#define CORRECTION_LIMIT_RAD 1e30f

float law_saturate(const law_t *law, float amplitude_rad) {
    return real_clip(amplitude_rad, 0.0f, law->amplitude_max_rad);
}

static bool limits_valid(const law_t *law) {
    return real_is_finite(law->amplitude_max_rad) && law->amplitude_max_rad > 0.0f &&
           law->amplitude_max_rad <= CORRECTION_LIMIT_RAD && real_is_finite(law->step_max_rad) &&
           law->step_max_rad >= 0.0f && real_is_finite(law->beat_s) && law->beat_s > 0.0f;
}

static uint32_t lead_halves(const law_t *law) { return (uint32_t)(2.0f * law->lead_beats); }

/* Written so that NaN fails it, before anything is converted. */
static bool lead_valid(const law_t *law, uint16_t beats) {
    return law->lead_beats >= 0.0f && law->lead_beats < (float)beats &&
           (float)lead_halves(law) == 2.0f * law->lead_beats;
}

law_result_t law_check(const law_t *law, uint16_t beats) {
    const bool gains = real_is_finite(law->kp_rad_s_m) && real_is_finite(law->kd_rad_s2_m) &&
                       real_is_finite(law->fade) && law->fade >= 0.0f;
    const bool lengths = beats >= 1u && beats <= BEATS_MAX && lead_valid(law, beats) &&
                         law->q_len >= 1u && 2u * law->q_len - 1u <= beats;
    const bool tail = law->tail == LAW_TAIL_HOLD || law->tail == LAW_TAIL_KEEP;
    return gains && lengths && tail && limits_valid(law) ? LAW_OK : LAW_BAD_CONFIG;
}

static bool is_measured(const law_trial_t *trial, uint32_t beat) {
    return trial->measured == NULL || trial->measured[beat] != 0;
}

static float error_at(const law_trial_t *trial, uint32_t beat) {
    return is_measured(trial, beat) ? trial->error_m_s[beat] : 0.0f;
}

static bool inputs_finite(const law_trial_t *trial, const float *amplitude_rad) {
    bool finite = true;
    for (uint32_t k = 0; k < trial->beats; k++) {
        finite = finite && real_is_finite(amplitude_rad[k]) && real_is_finite(error_at(trial, k));
    }
    return finite;
}

static law_report_t judged(const law_t *law, const law_trial_t *trial, const float *amplitude_rad) {
    law_report_t report = {0};
    float sum = 0.0f;
    for (uint32_t k = 0; k < trial->beats; k++) {
        const float error = real_abs(error_at(trial, k));
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
        report.rms_error_m_s = real_sqrt(sum / (float)report.measured_beats);
    }
    return report;
}

/* Written so that a NaN from an overflowing gain fails it. */
static bool correction_bounded(const law_t *law, float max_abs_error_m_s) {
    const float gain = real_abs(law->kp_rad_s_m) + 2.0f * real_abs(law->kd_rad_s2_m / law->beat_s);
    return gain * max_abs_error_m_s <= CORRECTION_LIMIT_RAD;
}

law_result_t law_judge(const law_t *law, const law_trial_t *trial, const float *amplitude_rad,
                       law_report_t *report) {
    const law_result_t config = law_check(law, trial->beats);
    if (config != LAW_OK) {
        return config;
    }
    if (!inputs_finite(trial, amplitude_rad)) {
        return LAW_BAD_INPUT;
    }
    const law_report_t found = judged(law, trial, amplitude_rad);
    if (found.measured_beats == 0) {
        return LAW_NOTHING_MEASURED;
    }
    if (!real_is_finite(found.rms_error_m_s) || !correction_bounded(law, found.max_abs_error_m_s)) {
        return LAW_BAD_INPUT;
    }
    *report = found;
    return LAW_OK;
}

/* e[beat+1] - e[beat] begins at the beat itself; the last one repeats the difference before it. */
static uint32_t difference_from(const law_trial_t *trial, uint32_t beat) {
    return beat + 1u < trial->beats ? beat : beat - 1u;
}

static float difference_at(const law_trial_t *trial, uint32_t beat) {
    if (trial->beats == 1u) {
        return 0.0f;
    }
    const uint32_t from = difference_from(trial, beat);
    return error_at(trial, from + 1u) - error_at(trial, from);
}

/* The two beats whose mean corrects a beat; one and the same where no half is involved. */
typedef struct {
    uint32_t first, second;
} pair_t;

/* False when the tail leaves |beat| as it is. */
static bool pair_ahead(const law_t *law, uint32_t beats, uint32_t beat, pair_t *pair) {
    const uint32_t last = 2u * (beats - 1u);
    const uint32_t ahead = 2u * beat + lead_halves(law);
    const uint32_t at = ahead > last ? last : ahead;
    *pair = (pair_t){at / 2u, (at + 1u) / 2u};
    return ahead <= last || law->tail == LAW_TAIL_HOLD;
}

/* The same with the beats that the derivative reads. */
static pair_t with_differences(const law_t *law, const law_trial_t *trial, pair_t pair) {
    if (law->kd_rad_s2_m == 0.0f || trial->beats == 1u) {
        return pair;
    }
    return (pair_t){difference_from(trial, pair.first), difference_from(trial, pair.second) + 1u};
}

bool law_corrects(const law_t *law, const law_trial_t *trial, uint32_t beat) {
    pair_t pair;
    bool measured = false;
    if (pair_ahead(law, trial->beats, beat, &pair)) {
        const pair_t read = with_differences(law, trial, pair);
        for (uint32_t k = read.first; k <= read.second; k++) {
            measured = measured || is_measured(trial, k);
        }
    }
    return measured;
}

static float error_of(const law_trial_t *trial, pair_t pair) {
    if (pair.first == pair.second) {
        return error_at(trial, pair.first);
    }
    const bool both = is_measured(trial, pair.first) && is_measured(trial, pair.second);
    const float sum = error_at(trial, pair.first) + error_at(trial, pair.second);
    return both ? 0.5f * sum : sum;
}

static float difference_of(const law_trial_t *trial, pair_t pair) {
    const float first = difference_at(trial, pair.first);
    return pair.first == pair.second ? first : 0.5f * (first + difference_at(trial, pair.second));
}

/* What the gain of |beat| is divided by. */
static float fade_of(const law_t *law, const law_trial_t *trial, uint32_t beat) {
    const uint32_t visits = trial->visits != NULL ? trial->visits[beat] : 0u;
    const uint32_t beyond = visits > law->fade_from ? visits - law->fade_from : 0u;
    return 1.0f + law->fade * (float)beyond;
}

static void correct(const law_t *law, const law_trial_t *trial, const float *amplitude_rad,
                    float *out) {
    const float kd_per_beat = law->kd_rad_s2_m / law->beat_s;
    for (uint32_t k = 0; k < trial->beats; k++) {
        const float old = law_saturate(law, amplitude_rad[k]);
        pair_t pair;
        if (!pair_ahead(law, trial->beats, k, &pair)) {
            out[k] = old;
            continue;
        }
        const float fade = fade_of(law, trial, k);
        const float proportional = law->kp_rad_s_m / fade * error_of(trial, pair);
        const float derivative = kd_per_beat / fade * difference_of(trial, pair);
        out[k] = old + (proportional + derivative);
    }
}

/* Neighbours are added in pairs, so that a mirrored record gives the mirrored bits. */
static float zero_phase_at(const float *in, uint32_t beats, uint32_t k, uint32_t q_len) {
    if (q_len == 1u) {
        return in[k];
    }
    float sum = (float)q_len * in[k];
    uint32_t weights = q_len;
    for (uint32_t j = 1; j < q_len; j++) {
        const uint32_t weight = q_len - j;
        const bool before = k >= j;
        const bool after = k + j < beats;
        if (before && after) {
            sum += (float)weight * (in[k - j] + in[k + j]);
            weights += 2u * weight;
        } else if (before || after) {
            sum += (float)weight * (before ? in[k - j] : in[k + j]);
            weights += weight;
        }
    }
    return sum / (float)weights;
}

void law_zero_phase(const float *in, float *out, uint16_t beats, uint16_t q_len) {
    for (uint32_t k = 0; k < beats; k++) {
        out[k] = zero_phase_at(in, beats, k, q_len);
    }
}

static float step_limited(const law_t *law, float old_rad, float next_rad) {
    if (law->step_max_rad <= 0.0f) {
        return next_rad;
    }
    const float swum_rad = law_saturate(law, old_rad);
    return real_clip(next_rad, swum_rad - law->step_max_rad, swum_rad + law->step_max_rad);
}

law_result_t law_update(const law_t *law, const law_trial_t *trial, float *amplitude_rad,
                        float *scratch, law_report_t *report) {
    const law_result_t result = law_judge(law, trial, amplitude_rad, report);
    if (result != LAW_OK) {
        return result;
    }
    correct(law, trial, amplitude_rad, scratch);
    for (uint32_t k = 0; k < trial->beats; k++) {
        const float filtered = zero_phase_at(scratch, trial->beats, k, law->q_len);
        amplitude_rad[k] = step_limited(law, amplitude_rad[k], filtered);
    }
    return LAW_OK;
}
