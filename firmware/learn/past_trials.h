/*
 * The trials that an average looks back on, one file each, for RAM holds the last one alone.
 *
 * Each record names the learned input that came of it, and the record before it, by their CRCs. So
 * the chain begins with the learned input of now and nothing else: amplitudes uploaded, restored or
 * learned in another way have no past, nor has what a cut left behind. A record is written before
 * the learned input that it leads to, into the place of one that is no longer looked at: a cut
 * between the two leaves the old learned input and its whole past. Main loop only.
 */
#ifndef LEARN_PAST_TRIALS_H
#define LEARN_PAST_TRIALS_H

#include "ilc/past.h"
#include "params/params.h"
#include "store/vault.h"

/* What the functions work with, all of it the caller's. */
typedef struct {
    vault_t *vault;
    const params_t *params;
    const memory_t *memory; /* of the trial; of past_trials_keep the next one */
    past_t *past;           /* taken from the workspace, from look_back to keep */
    float *sum_rad;         /* BEATS_MAX: the weighted earlier trials */
    uint8_t *measured;      /* BEATS_MAX, for look_back alone */
} past_trials_t;

/* What an average has to look back on. */
typedef struct {
    past_kind_t kind;
    law_weights_t now;   /* of the trial that is learned from; not of PAST_LAST */
    uint32_t newest_crc; /* of the newest record; 0 = the average begins */
    uint16_t trials;     /* in the average so far */
    bool shortened;      /* earlier trials are missing: lost, damaged, dropped, or learned from
                            with another law */
} past_view_t;

/* Adds the weighted earlier trials to zeros in |sum_rad|. LAW_BAD_INPUT as law_add, or when a file
 * was read well only once. */
law_result_t past_trials_look_back(const past_trials_t *trials, const law_t *law,
                                   past_view_t *view);

/* Stores what the next one needs of |trial|, which has been learned from, ahead of the memory.
 * |errors| are those it was learned with. */
store_result_t past_trials_keep(const past_trials_t *trials, const law_t *law,
                                const trial_record_t *trial, const law_trial_t *errors,
                                const past_view_t *view);

/* What past_trials_keep asks of the store beyond its reserve, blocks. */
uint32_t past_trials_room_blocks(const params_t *params);

/* How many earlier trials the law of the moment reads: files that are worth keeping. */
uint16_t past_trials_reach(const params_t *params);

/* Removes the oldest file but for the places of the |keep| newest before |iteration|; false when
 * there was none. The chain is the newest part of what there is, so that this shortens an average
 * and never cuts it in the middle. */
bool past_trials_drop(vault_t *vault, uint16_t iteration, uint16_t keep);

#endif
