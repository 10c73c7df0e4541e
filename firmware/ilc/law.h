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
 * law_update() does all of it for a law that looks at the last trial only. Laws that look at more,
 * the averages of chapters 2 and 3, add up weighted trials with law_add() and end with
 * law_finish(); host/native/thesis/learner.h keeps the trials for them.
 *
 * A beat without a speed counts as e = 0; so does the rest of an aborted trial.
 * de[k] = (e[k+1] - e[k]) / beat_s, and 0 where one of the two has no speed: what is not known did
 * not change, and a cut trial has no cliff at its end. The last beat repeats the difference before
 * it (one beat: 0).
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
 * Pure, no libm, float32 (number.h): host and board agree bit for bit. The order of evaluation is
 * part of the contract: trials as they are added, beats in rising order, sum + (wi*sat(u) +
 * (((wp*kp)/f)*e + ((wd*(kd/beat_s))/f)*(e' - e))) with f = 1 + fade*n and n a whole number,
 * 0.5*(a + b) for a mean of neighbours, earlier one first, the filter from the middle outwards with
 * both neighbours of a pair added first and one division per beat, the sum of squares from beat 0
 * on. Operations that change no bit are left out (test_law_bits.c). Not for interrupts. Cost per
 * beat on the board: 345 instructions with a proportional part alone (bench/law_cost.py).
 *
 * The fish's units are in the names. Another plant has its own: an "amplitude" is any input, an
 * "error" any wanted minus measured output, a "beat" any sample; only their products have to fit.
 */
#ifndef ILC_LAW_H
#define ILC_LAW_H

#include "ilc/number.h"

#include <stdbool.h>
#include <stdint.h>

/* Amplitudes and corrections beyond this are refused: the filter's sums, whose integer weights add
 * up to 2^24 at most, stay finite in float. */
#define LAW_LIMIT NUMBER(1e30)
#define LAW_Q_LEN_MAX 4096u

/* What beats get whose e[k+lead] lies beyond the last beat. Where all do, at a lead of beats - 0.5,
 * there is nothing to hold, and LAW_TAIL_HOLD_NEW and _OLD are LAW_TAIL_KEEP. */
typedef enum {
    LAW_TAIL_HOLD = 0,     /* the last error, e[n-1], and the last difference */
    LAW_TAIL_KEEP = 1,     /* no correction: the old input, saturated */
    LAW_TAIL_HOLD_NEW = 2, /* the new input of the last beat before them, ahead of Q */
    LAW_TAIL_HOLD_OLD = 3, /* its old input, saturated: (7.10) to the letter, with a jump */
    LAW_TAIL_COUNT
} law_tail_t;

typedef struct {
    number_t kp_rad_s_m;        /* gamma, rad per m/s; > 0 for the fish, any finite value here */
    number_t kd_rad_s2_m;       /* rad per m/s^2, on the forward difference of e */
    number_t amplitude_min_rad; /* sat() is [this, amplitude_max_rad]; 0 for the fish */
    number_t amplitude_max_rad; /* > amplitude_min_rad; both within +-LAW_LIMIT */
    number_t step_max_rad;      /* |new - sat(old)| per beat at most, after Q; 0 = no limit */
    number_t beat_s;            /* > 0 */
    number_t lead_beats;        /* L, a multiple of 0.5; >= 0, < beats */
    number_t fade;              /* >= 0; 0 = the gain stays */
    uint16_t fade_from;         /* visits that leave the full gain */
    uint16_t q_len;             /* N0 of the zero-phase triangle; 1 = off; 2*q_len-1 <= beats,
                                   <= LAW_Q_LEN_MAX */
    law_tail_t tail;
} law_t;

/* One trial as the law sees it. The caller owns the arrays. */
typedef struct {
    uint16_t beats;            /* 1..65535 */
    const number_t *error_m_s; /* reference - measured mean speed, per beat */
    const uint8_t *measured;   /* 0 = this beat has no speed, its error is not looked at; NULL = all
                                have one */
    const uint8_t *visits;     /* earlier trials that corrected each beat; NULL = none did */
} law_trial_t;

typedef struct {
    number_t max_abs_error_m_s; /* over measured beats */
    number_t rms_error_m_s;     /* over measured beats */
    uint16_t measured_beats;
    uint16_t saturated_beats; /* beats whose old input was above amplitude_max: the tail could not
                                 do what was asked. Below 0 a beat just rests. */
} law_report_t;

/* How much of a trial goes into the next amplitudes: wi, wp, wd above. */
typedef struct {
    number_t input; /* of its saturated amplitudes */
    number_t kp;    /* factor on kp for its errors */
    number_t kd;    /* factor on kd for its differences */
} law_weights_t;

typedef enum {
    LAW_OK = 0,
    LAW_BAD_CONFIG = 1, /* non-finite gain, fade < 0, limits not in order or beyond LAW_LIMIT, no
                           beats, a lead that is no multiple of 0.5, lead or q_len too long */
    LAW_BAD_INPUT = 2,  /* a non-finite amplitude or measured error, or one so large that the
                           result could overflow */
    LAW_NOTHING_MEASURED = 3
} law_result_t;

/* The amplitude the servo gets. NaN stays NaN (and is refused earlier). */
number_t law_saturate(const law_t *law, number_t amplitude_rad);

law_result_t law_check(const law_t *law, uint16_t beats);

/* Writes the next amplitudes over |amplitude_rad| (beats values) and fills |report|.
 * |scratch| holds beats floats. On any result but LAW_OK amplitude_rad and report are untouched;
 * scratch is indeterminate. */
law_result_t law_update(const law_t *law, const law_trial_t *trial, number_t *amplitude_rad,
                        number_t *scratch, law_report_t *report);

/* Adds a trial that swam |amplitude_rad| to |sum| (beats values; begin with zeros). A trial without
 * any speed adds its input alone. LAW_BAD_CONFIG as law_update; LAW_BAD_INPUT, too, where what the
 * weights make of input or errors is not finite or beyond LAW_LIMIT; then |sum| is untouched. */
law_result_t law_add(const law_t *law, const law_weights_t *weights, const law_trial_t *trial,
                     const number_t *amplitude_rad, number_t *sum);

/* Tail, filter and step limit: from the sum of all trials to the next amplitudes, written over
 * those last swum. |sum| is used up. Of a law and a |beats| that law_check accepts. */
void law_finish(const law_t *law, uint16_t beats, number_t *sum, number_t *amplitude_rad);

/* Whether this trial's errors move the amplitude of |beat|: e[beat+lead], or a neighbour of it
 * where that lies between two beats, is measured; in a tail that holds the new input, that of the
 * beat it holds. Of a law and a trial that law_judge accepts. */
bool law_corrects(const law_t *law, const law_trial_t *trial, uint32_t beat);

/* The first beat of a tail that takes no correction whatever is measured (LAW_TAIL_KEEP,
 * _HOLD_OLD); |beats| where there is none. Of a law and a |beats| that law_check accepts. */
uint16_t law_kept_from(const law_t *law, uint16_t beats);

/* max |e| and RMS without learning; refuses exactly what law_update refuses. */
law_result_t law_judge(const law_t *law, const law_trial_t *trial, const number_t *amplitude_rad,
                       law_report_t *report);

/* Zero-phase low-pass: the triangle w_j = (q_len-|j|)/q_len^2 inside the record, divided by the sum
 * of the weights that lie inside ((6.42), renormalised ends). |out| and |in| must not overlap. */
void law_zero_phase(const number_t *in, number_t *out, uint16_t beats, uint16_t q_len);

#endif
