/*
 * What the averaging laws of chapters 2 and 3 make of earlier trials: how much each one weighs, and
 * the running means. One place for host/native/thesis/learner.h, which keeps its trials in RAM, and
 * for the board, which keeps them in its store.
 *
 * The order in which trials are added (law_add) is part of the contract: earlier ones first, the
 * newest of them before the others, and the one that has just ended last.
 *
 * Pure; the same bits everywhere. Not for interrupts.
 */
#ifndef ILC_PAST_H
#define ILC_PAST_H

#include "ilc/law.h"

/* What the board learns from: the values of its parameter. */
typedef enum {
    PAST_LAST = 0,   /* the last trial */
    PAST_MEAN = 1,   /* the mean of all trials, with i+2 times the gain in iteration i (2.10) */
    PAST_WINDOW = 2, /* a moving average: (2.35), (3.12), (3.43), with equal weights */
    PAST_KIND_COUNT
} past_kind_t;

#define PAST_WINDOW_MAX 8u /* trials in the board's moving average */

/* Whether |law| can learn from that: the mean goes without kd, for an error that is a mean over
 * gaps has no differences. */
bool past_fits(past_kind_t kind, const law_t *law);

/* The mean of the trials before the one that has just ended, and that trial itself. |ended| >= 1:
 * trials there have been, that one among them. */
law_weights_t past_mean_before(uint32_t ended);
law_weights_t past_mean_now(uint32_t ended);

/* Takes the trial that has just ended into the means, |beats| values each (zeros before the first
 * trial). What was not measured counts as an error of 0, as (2.10) has it. The means are updated,
 * not their sums, which would outgrow float. */
void past_mean_add(const law_t *law, uint32_t ended, const law_trial_t *trial,
                   const number_t *amplitude_rad, number_t *mean_rad, number_t *mean_error_m_s);

/* Weight |back| (0 = the newest) of a |window| of which only the newest |present| >= 1 are there:
 * the input weights are divided by their sum, kp and kd by the part of theirs that is there. */
law_weights_t past_window_weight(const law_weights_t *weights, uint32_t window, uint32_t present,
                                 uint32_t back);

/* The same for equal weights: each trial of a moving average over |window| <= PAST_WINDOW_MAX. */
law_weights_t past_average_weight(uint32_t window, uint32_t present);

#endif
