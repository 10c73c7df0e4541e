/*
 * A whole learner in a buffer of the caller's: all memory laws of the thesis behind one small
 * interface, for another robot or another plant.
 *
 *   law                                        past, weights, law_t
 *   P (2.3), (8.16)                            LAST; kp
 *   D, anticipatory (7.10)                     LAST; kd, lead, tail
 *   zero-phase Q (6.31), (6.42)                LAST; kd, q_len
 *   iteration average (2.10)                   MEAN; kp = L, lead 1
 *   m-th order (2.35)                          WINDOW m; weight j = {alpha_j, beta_j, 0}, kp 1
 *   moving average D (3.12)                    WINDOW m+1; each {1/(m+1), 0, beta_j}, kd 1
 *   moving average PD (3.43)                   the same, the newest with {.., 1, ..}, kp = -L > 0
 *
 * One sign everywhere: e = wanted - measured. Saturation is in all of them: what is remembered is
 * what the plant got.
 *
 *   buffer_learner_init(...);
 *   for each trial:  for each sample k:  u = buffer_learner_output(k); ...;
 * buffer_learner_measure(k, e); buffer_learner_end(valid);
 *
 * Numbers of memory per sample (buffer_learner_bytes; and a byte or so each for what was measured):
 * LAST 3, MEAN 5, WINDOW of w trials 3 + 2*(w-1).
 * buffer_learner_output and buffer_learner_measure cost a few operations and may be called from an
 * interrupt that nothing else interrupts; buffer_learner_end costs law.h's 30 operations per sample
 * and trial remembered.
 *
 * The board learns with law.h directly: it keeps past trials in its store, not in RAM (past.h).
 * The laws that correct while the plant moves are in feedback.h.
 */
#ifndef ILC_LEARNER_H
#define ILC_LEARNER_H

#include "ilc/past.h"

#include <stddef.h>

#define LEARNER_WINDOW_MAX 16u
/* A window's input weights, added up without their signs, times the larger amplitude limit. */
#define LEARNER_INPUT_LIMIT (NUMBER(4) * LAW_LIMIT)

/* What a window holds before there were that many trials. */
typedef enum {
    LEARNER_HISTORY_ZERO = 0,  /* trials of zero input and zero error, as printed in chapter 3; it
                                  changes inputs from which nothing was learned */
    LEARNER_HISTORY_FIRST = 1, /* trials with the first input and zero error */
    LEARNER_HISTORY_NONE = 2   /* nothing: the window grows. Its input weights are divided by their
                                  sum; kp and kd weights by the part of their sum that is there */
} buffer_learner_history_t;

typedef struct {
    law_t law;
    uint16_t samples; /* 1..65535: law.beats */
    past_kind_t past;
    buffer_learner_history_t history;         /* of PAST_WINDOW */
    uint16_t window;                          /* 1..LEARNER_WINDOW_MAX; of PAST_WINDOW */
    law_weights_t weight[LEARNER_WINDOW_MAX]; /* newest first; of PAST_WINDOW */
} buffer_learner_config_t;

/* Everything in here is the module's; it points into the caller's buffer. */
typedef struct {
    buffer_learner_config_t config;
    number_t *amplitude; /* next to be used */
    number_t *error;     /* of the running trial */
    number_t *sum;       /* working space */
    number_t *past_amplitude, *past_error;
    uint8_t *measured; /* of the running trial */
    uint8_t *past_measured;
    uint32_t trials; /* ended so far */
} buffer_learner_t;

/* Size of the buffer for buffer_learner_init; 0 when the config does not hold together. */
size_t buffer_learner_bytes(const buffer_learner_config_t *config);

/* |first|: the first input, samples values; NULL = zeros. |memory|: buffer_learner_bytes() at
 * least, aligned for number_t, and the learner's from now on. LAW_BAD_CONFIG, LAW_BAD_INPUT
 * (|first| not finite). */
law_result_t buffer_learner_init(buffer_learner_t *learner, const buffer_learner_config_t *config,
                                 const number_t *first, void *memory, size_t memory_bytes);

/* What the plant gets at sample k < samples. */
number_t buffer_learner_output(const buffer_learner_t *learner, uint16_t k);

/* The error of sample k < samples. A non-finite one counts as not measured and is LAW_BAD_INPUT. */
law_result_t buffer_learner_measure(buffer_learner_t *learner, uint16_t k, number_t error);

/* Ends the trial and learns from it. Samples from |valid| on count as not measured, whatever was
 * told about them: a trial cut by an empty battery is valid to its end, one that hit a wall only up
 * to some samples before, and one that was stopped because its error grew too large must include
 * the sample that was too large, or it will stop there for ever. valid 0 is a trial that taught
 * nothing and still counts. LAW_BAD_INPUT: errors so large that the result could overflow; nothing
 * is learned then, and the trial does not count. */
law_result_t buffer_learner_end(buffer_learner_t *learner, uint16_t valid, law_report_t *report);

#endif
