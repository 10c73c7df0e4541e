/*
 * The learner: which reference the fish is to follow, the amplitudes that it swims next, and how a
 * trial changes them.
 *
 * What is in RAM is what is stored, but for a first guess that has not been saved yet; a save that
 * fails goes back to what is stored. When the tail may not move, and which trial is pending, is the
 * business of others: no call but learner_applied() while a trial is open. Main loop only.
 */
#ifndef LEARN_LEARNER_H
#define LEARN_LEARNER_H

#include "ilc/memory.h"
#include "params/params.h"
#include "store/vault.h"

typedef struct {
    vault_t *vault;
    const params_t *params;
    reference_t reference;
    memory_t memory;
    float error_m_s[BEATS_MAX]; /* of the trial that is being learned from, as |measured| */
    uint8_t measured[BEATS_MAX];
    float scratch[BEATS_MAX];
} learner_t;

typedef struct {
    memory_report_t report;
    bool shortened; /* earlier trials are missing in the average */
} learner_outcome_t;

/* A zeroed |learner|; |vault| and |params| outlive it. */
void learner_init(learner_t *learner, vault_t *vault, const params_t *params);

/* Reference and memory as they were last stored; an empty memory when it belongs to another
 * reference. Without a reference it is kept: the reference it belongs to may come back. */
void learner_load(learner_t *learner);

/* FAULT_WRITE_FAILED, and what is stored in RAM again. */
fault_t learner_save(learner_t *learner);

/* Refused as reference_judge() says. Another reference than now begins a memory of its own. */
fault_t learner_set_reference(learner_t *learner, const reference_t *next);
/* FAULT_WRONG_BEATS when they belong to another reference. */
fault_t learner_set_amplitudes(learner_t *learner, const amplitudes_upload_t *next);
/* All that was learned, from a backup. The file of a trial that was learned from goes: perhaps not
 * by what is learned from now on. */
fault_t learner_set_memory(learner_t *learner, const memory_t *next);

/* u_1 follows the gain of the moment until something has been learned. Not saved. */
fault_t learner_guess_first(learner_t *learner);
bool learner_has_guess(const learner_t *learner);

/* The next amplitudes as the servo gets them: saturated, one per beat, until the next call. */
const float *learner_applied(learner_t *learner);

/* Learns from |trial| and saves; on refusal nothing changes. */
fault_t learner_learn(learner_t *learner, const trial_record_t *trial, learner_outcome_t *outcome);

/* FAULT_NO_BEST when there is none yet. */
fault_t learner_restore_best(learner_t *learner);

/* Removes the oldest past trial but for the |keep| newest; false when there was none. */
bool learner_drop_past(learner_t *learner, uint16_t keep);

#endif
