#include "ilc/law.h"

#include "ilc/number_order.h"

#include <stddef.h>

number_t law_saturate(const law_t *law, number_t amplitude_rad) {
    return number_clip(amplitude_rad, law->amplitude_min_rad, law->amplitude_max_rad);
}

static bool limits_valid(const law_t *law) {
    return law->amplitude_min_rad >= -LAW_LIMIT && law->amplitude_max_rad <= LAW_LIMIT &&
           law->amplitude_min_rad < law->amplitude_max_rad && number_is_finite(law->step_max_rad) &&
           law->step_max_rad >= NUMBER(0) && number_is_finite(law->beat_s) &&
           law->beat_s > NUMBER(0);
}

static uint32_t lead_halves(const law_t *law) { return (uint32_t)(NUMBER(2) * law->lead_beats); }

/* Written so that NaN fails it, before anything is converted. */
static bool lead_valid(const law_t *law, uint16_t beats) {
    return law->lead_beats >= NUMBER(0) && law->lead_beats < (number_t)beats &&
           (number_t)lead_halves(law) == NUMBER(2) * law->lead_beats;
}

law_result_t law_check(const law_t *law, uint16_t beats) {
    const bool gains = number_is_finite(law->kp_rad_s_m) && number_is_finite(law->kd_rad_s2_m) &&
                       number_is_finite(law->fade) && law->fade >= NUMBER(0);
    const bool lengths = beats >= 1u && lead_valid(law, beats) && law->q_len >= 1u &&
                         law->q_len <= LAW_Q_LEN_MAX && 2u * law->q_len - 1u <= beats;
    const bool tail = (unsigned)law->tail < LAW_TAIL_COUNT;
    return gains && lengths && tail && limits_valid(law) ? LAW_OK : LAW_BAD_CONFIG;
}

static bool is_measured(const law_trial_t *trial, uint32_t beat) {
    return trial->measured == NULL || trial->measured[beat] != 0;
}

static number_t error_at(const law_trial_t *trial, uint32_t beat) {
    return is_measured(trial, beat) ? trial->error_m_s[beat] : NUMBER(0);
}

/* False when an amplitude or a measured error is not finite. */
static bool look(const law_t *law, const law_trial_t *trial, const number_t *amplitude_rad,
                 law_report_t *report) {
    bool finite = true;
    number_t sum = NUMBER(0);
    *report = (law_report_t){0};
    for (uint32_t k = 0; k < trial->beats; k++) {
        finite = finite && number_is_finite(amplitude_rad[k]);
        report->saturated_beats =
            (uint16_t)(report->saturated_beats +
                       (number_order(amplitude_rad[k]) > number_order(law->amplitude_max_rad)));
        if (is_measured(trial, k)) {
            const number_t error = number_abs(trial->error_m_s[k]);
            finite = finite && number_is_finite(error);
            sum += error * error;
            report->measured_beats++;
            if (number_order(error) > number_order(report->max_abs_error_m_s)) {
                report->max_abs_error_m_s = error;
            }
        }
    }
    if (report->measured_beats > 0) {
        report->rms_error_m_s = number_sqrt(sum / (number_t)report->measured_beats);
    }
    return finite;
}

static const law_weights_t WHOLE = {NUMBER(1), NUMBER(1), NUMBER(1)};

/* Written so that a NaN from an overflowing gain fails it. */
static bool correction_bounded(const law_t *law, const law_weights_t *weights,
                               number_t max_abs_error_m_s) {
    const number_t kp = number_abs(weights->kp * law->kp_rad_s_m);
    const number_t kd = number_abs(weights->kd * (law->kd_rad_s2_m / law->beat_s));
    return (kp + NUMBER(2) * kd) * max_abs_error_m_s <= LAW_LIMIT;
}

law_result_t law_judge(const law_t *law, const law_trial_t *trial, const number_t *amplitude_rad,
                       law_report_t *report) {
    const law_result_t config = law_check(law, trial->beats);
    if (config != LAW_OK) {
        return config;
    }
    law_report_t found;
    if (!look(law, trial, amplitude_rad, &found)) {
        return LAW_BAD_INPUT;
    }
    if (found.measured_beats == 0) {
        return LAW_NOTHING_MEASURED;
    }
    if (!number_is_finite(found.rms_error_m_s) ||
        !correction_bounded(law, &WHOLE, found.max_abs_error_m_s)) {
        return LAW_BAD_INPUT;
    }
    *report = found;
    return LAW_OK;
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

/* Where the error is that corrects |beat|, in half beats: the mean of two neighbours where it lies
 * between them. NOWHERE when the beat is the tail's, and that does not look at errors. |halves|:
 * the lead's. */
#define NOWHERE UINT32_MAX
static uint32_t place_ahead(const law_t *law, uint32_t halves, uint32_t beats, uint32_t beat) {
    const uint32_t last = 2u * (beats - 1u);
    const uint32_t ahead = 2u * beat + halves;
    if (ahead <= last) {
        return ahead;
    }
    return law->tail == LAW_TAIL_HOLD ? last : NOWHERE;
}

static bool is_between(uint32_t place) { return place % 2u != 0; }

/* Beats at the end that a tail other than LAW_TAIL_HOLD fills. */
static uint32_t tail_beats(const law_t *law) { return (lead_halves(law) + 1u) / 2u; }

/* The beat whose input |beat| will have, ahead of Q: the last one before the tail where that is
 * held. */
static uint32_t held_from(const law_t *law, uint32_t beats, uint32_t beat) {
    const uint32_t tail = tail_beats(law);
    const bool holds = law->tail == LAW_TAIL_HOLD_NEW && tail < beats && beat >= beats - tail;
    return holds ? beats - 1u - tail : beat;
}

bool law_corrects(const law_t *law, const law_trial_t *trial, uint32_t beat) {
    const uint32_t from = held_from(law, trial->beats, beat);
    const uint32_t place = place_ahead(law, lead_halves(law), trial->beats, from);
    return place != NOWHERE &&
           (is_measured(trial, place / 2u) || is_measured(trial, (place + 1u) / 2u));
}

uint16_t law_kept_from(const law_t *law, uint16_t beats) {
    const uint32_t tail = tail_beats(law);
    const bool keeps = law->tail == LAW_TAIL_KEEP || law->tail == LAW_TAIL_HOLD_OLD;
    return keeps ? (uint16_t)(beats - (tail < beats ? tail : beats)) : beats;
}

static number_t error_of(const law_trial_t *trial, uint32_t place) {
    const uint32_t beat = place / 2u;
    const number_t first = error_at(trial, beat);
    if (!is_between(place)) {
        return first;
    }
    const number_t sum = first + error_at(trial, beat + 1u);
    const bool both = is_measured(trial, beat) && is_measured(trial, beat + 1u);
    return both ? NUMBER(0.5) * sum : sum;
}

static number_t difference_of(const law_trial_t *trial, uint32_t place) {
    const number_t first = difference_at(trial, place / 2u);
    return is_between(place) ? NUMBER(0.5) * (first + difference_at(trial, place / 2u + 1u))
                             : first;
}

/* Visits of |beat| that its gain fades with. */
static uint32_t visits_beyond(const law_t *law, const law_trial_t *trial, uint32_t beat) {
    const uint32_t visits = trial->visits != NULL ? trial->visits[beat] : 0u;
    return visits > law->fade_from ? visits - law->fade_from : 0u;
}

/* What a trial's errors and differences count, and what remains of it after some |visits|: divided
 * anew only where these change from beat to beat. */
typedef struct {
    number_t kp, kd_per_beat;
    number_t faded_kp, faded_kd_per_beat;
    uint32_t visits;
} gains_t;

static gains_t gains_of(const law_t *law, const law_weights_t *weights) {
    const number_t kp = weights->kp * law->kp_rad_s_m;
    const number_t kd_per_beat = weights->kd * (law->kd_rad_s2_m / law->beat_s);
    return (gains_t){kp, kd_per_beat, kp, kd_per_beat, 0u};
}

static void fade(gains_t *gains, const law_t *law, uint32_t visits) {
    if (gains->visits != visits) {
        const number_t by = NUMBER(1) + law->fade * (number_t)visits;
        gains->faded_kp = gains->kp / by;
        gains->faded_kd_per_beat = gains->kd_per_beat / by;
        gains->visits = visits;
    }
}

/* Leaves out what changes no bit: a factor of 1, an addition of 0 (a sum that begins with zeros is
 * never -0). |first|: |sum| is to begin with zeros. */
static void accumulate(const law_t *law, const law_weights_t *weights, const law_trial_t *trial,
                       const number_t *amplitude_rad, bool first, number_t *sum) {
    const uint32_t halves = lead_halves(law);
    const bool whole = number_is_one(weights->input);
    gains_t gains = gains_of(law, weights);
    const bool derivative = !number_is_zero(gains.kd_per_beat);
    for (uint32_t k = 0; k < trial->beats; k++) {
        const number_t saturated = law_saturate(law, amplitude_rad[k]);
        number_t next = whole ? saturated : weights->input * saturated;
        const uint32_t place = place_ahead(law, halves, trial->beats, k);
        if (place != NOWHERE) {
            fade(&gains, law, visits_beyond(law, trial, k));
            const number_t proportional = gains.faded_kp * error_of(trial, place);
            next += derivative
                        ? proportional + gains.faded_kd_per_beat * difference_of(trial, place)
                        : proportional;
        }
        if (!first) {
            sum[k] += next;
        } else {
            sum[k] = number_is_zero(next) ? NUMBER(0) : next;
        }
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

void law_zero_phase(const number_t *in, number_t *out, uint16_t beats, uint16_t q_len) {
    for (uint32_t k = 0; k < beats; k++) {
        out[k] = zero_phase_at(in, beats, k, q_len);
    }
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
    const number_t held = hold_new ? sum[last] : law_saturate(law, amplitude_rad[last]);
    for (uint32_t k = last + 1u; k < beats; k++) {
        sum[k] = held;
    }
}

static number_t step_limited(const law_t *law, number_t old_rad, number_t next_rad) {
    const number_t swum_rad = law_saturate(law, old_rad);
    return number_clip(next_rad, swum_rad - law->step_max_rad, swum_rad + law->step_max_rad);
}

/* Written so that NaN fails it. Of amplitudes that are finite. */
static bool input_bounded(const law_t *law, const law_weights_t *weights, uint32_t beats,
                          const number_t *amplitude_rad) {
    bool bounded = number_is_finite(weights->input);
    for (uint32_t k = 0; k < beats; k++) {
        const number_t old = weights->input * law_saturate(law, amplitude_rad[k]);
        bounded = bounded && number_abs(old) <= LAW_LIMIT;
    }
    return bounded;
}

law_result_t law_add(const law_t *law, const law_weights_t *weights, const law_trial_t *trial,
                     const number_t *amplitude_rad, number_t *sum) {
    if (law_check(law, trial->beats) != LAW_OK) {
        return LAW_BAD_CONFIG;
    }
    law_report_t found;
    if (!look(law, trial, amplitude_rad, &found) ||
        !input_bounded(law, weights, trial->beats, amplitude_rad) ||
        !number_is_finite(found.rms_error_m_s) ||
        !correction_bounded(law, weights, found.max_abs_error_m_s)) {
        return LAW_BAD_INPUT;
    }
    accumulate(law, weights, trial, amplitude_rad, false, sum);
    return LAW_OK;
}

void law_finish(const law_t *law, uint16_t beats, number_t *sum, number_t *amplitude_rad) {
    const bool filtered = law->q_len != 1u, limited = law->step_max_rad > NUMBER(0);
    hold_tail(law, beats, amplitude_rad, sum);
    for (uint32_t k = 0; k < beats; k++) {
        const number_t next = filtered ? zero_phase_at(sum, beats, k, law->q_len) : sum[k];
        amplitude_rad[k] = limited ? step_limited(law, amplitude_rad[k], next) : next;
    }
}

law_result_t law_update(const law_t *law, const law_trial_t *trial, number_t *amplitude_rad,
                        number_t *scratch, law_report_t *report) {
    const law_result_t result = law_judge(law, trial, amplitude_rad, report);
    if (result != LAW_OK) {
        return result;
    }
    accumulate(law, &WHOLE, trial, amplitude_rad, true, scratch);
    law_finish(law, trial->beats, scratch, amplitude_rad);
    return LAW_OK;
}
