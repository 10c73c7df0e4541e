/*
 * The learning law: from the amplitudes a trial swam and the errors they gave to the next
 * amplitudes.
 *
 * One pipeline for all memory laws, on the grid of beats (thesis (8.16), (7.10), (6.31)):
 *   validate -> u := sat(u) -> u[k] += (kp*e[k+lead] + kd*de[k+lead]) / fade[k] -> tail -> Q ->
 *   step limit
 * The stored old input is saturated before the correction is added; otherwise it winds up. The
 * result is stored unsaturated: the servo gets law_saturate(u[k]).
 *
 * A beat without a speed counts as e = 0, in differences too; so does the rest of an aborted trial.
 * de[k] = (e[k+1] - e[k]) / beat_s; the last beat repeats the difference before it (one beat: 0).
 *
 * The lead is in steps of half a beat. With j = floor(k+lead), half a beat on means the mean of two
 * neighbours: e = (e[j] + e[j+1]) / 2, de = (de[j] + de[j+1]) / 2. Where one of the two beats has
 * no speed e is that of the other: its error is the best guess there is, and half of it would be
 * half the gain. k+lead beyond the last beat, be it by half a beat, is the tail's.
 *
 * The gain of a beat fades with the trials that have corrected it (Saab's gain ~ 1/k against
 * noise): fade[k] = 1 + fade * max(0, visits[k] - fade_from). Counted per beat, it leaves the full
 * gain to the late beats of a series whose trials are often cut short.
 *
 * Pure, float32, no libm: host and board agree bit for bit. The order of evaluation is part of the
 * contract: beats in rising order, sat(u) + ((kp/f)*e + ((kd/beat_s)/f)*(e' - e)) with
 * f = 1 + fade*n and n a whole number, 0.5f*(a + b) for a mean of neighbours, earlier one first,
 * the filter from the middle outwards with both neighbours of a pair added first and one division
 * per beat, the sum of squares from beat 0 on. Not for interrupts. Cost per beat: about 30
 * soft-float operations, and with a filter 5 more per unit of q_len.
 */
#ifndef ILC_LAW_H
#define ILC_LAW_H

#include "base/units.h"

#include <stdbool.h>
#include <stdint.h>

/* What beats get whose e[k+lead] lies beyond the last beat. */
typedef enum {
    LAW_TAIL_HOLD = 0, /* the last error, e[n-1], and the last difference */
    LAW_TAIL_KEEP = 1  /* no correction: the old input, saturated */
} law_tail_t;

typedef struct {
    float kp_rad_s_m;        /* gamma, rad per m/s; > 0 for the fish, any finite value here */
    float kd_rad_s2_m;       /* rad per m/s^2, on the forward difference of e */
    float amplitude_max_rad; /* sat() is [0, this]; > 0 */
    float step_max_rad;      /* |new - sat(old)| per beat at most, after Q; 0 = no limit */
    float beat_s;            /* > 0 */
    float lead_beats;        /* L, a multiple of 0.5; >= 0, < beats */
    float fade;              /* >= 0; 0 = the gain stays */
    uint16_t fade_from;      /* visits that leave the full gain */
    uint16_t q_len;          /* N0 of the zero-phase triangle; 1 = off; 2*q_len-1 <= beats */
    law_tail_t tail;
} law_t;

/* One trial as the law sees it. The caller owns the arrays. */
typedef struct {
    uint16_t beats;          /* 1..BEATS_MAX */
    const float *error_m_s;  /* reference - measured mean speed, per beat */
    const uint8_t *measured; /* 0 = this beat has no speed, its error is not looked at; NULL = all
                                have one */
    const uint8_t *visits;   /* earlier trials that corrected each beat; NULL = none did */
} law_trial_t;

typedef struct {
    float max_abs_error_m_s; /* over measured beats */
    float rms_error_m_s;     /* over measured beats */
    uint16_t measured_beats;
    uint16_t saturated_beats; /* beats whose old input was above amplitude_max: the tail could not
                                 do what was asked. Below 0 a beat just rests. */
} law_report_t;

typedef enum {
    LAW_OK = 0,
    LAW_BAD_CONFIG = 1, /* non-finite gain, fade < 0, limit <= 0, no beats, a lead that is no
                           multiple of 0.5, lead or q_len too long */
    LAW_BAD_INPUT = 2,  /* a non-finite amplitude or measured error, or one so large that the
                           result could overflow */
    LAW_NOTHING_MEASURED = 3
} law_result_t;

/* The amplitude the servo gets. NaN stays NaN (and is refused earlier). */
float law_saturate(const law_t *law, float amplitude_rad);

law_result_t law_check(const law_t *law, uint16_t beats);

/* Writes the next amplitudes over |amplitude_rad| (beats values) and fills |report|.
 * |scratch| holds beats floats. On any result but LAW_OK amplitude_rad and report are untouched;
 * scratch is indeterminate. */
law_result_t law_update(const law_t *law, const law_trial_t *trial, float *amplitude_rad,
                        float *scratch, law_report_t *report);

/* Whether this trial's errors move the amplitude of |beat|: e[beat+lead], or a neighbour of it
 * where that lies between two beats, or with a derivative gain a beat of their differences, is
 * measured. Of a law and a trial that law_judge accepts. */
bool law_corrects(const law_t *law, const law_trial_t *trial, uint32_t beat);

/* max |e| and RMS without learning; refuses exactly what law_update refuses. */
law_result_t law_judge(const law_t *law, const law_trial_t *trial, const float *amplitude_rad,
                       law_report_t *report);

/* Zero-phase low-pass: the triangle w_j = (q_len-|j|)/q_len^2 inside the record, divided by the sum
 * of the weights that lie inside ((6.42), renormalised ends). |out| and |in| must not overlap. */
void law_zero_phase(const float *in, float *out, uint16_t beats, uint16_t q_len);

#endif
