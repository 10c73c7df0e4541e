/*
 * What is remembered between trials: the next amplitudes, and the best ones so far.
 *
 * The visits of a beat are how often noise has been averaged into its amplitude, so that they only
 * grow: neither the best amplitudes brought back nor uploaded ones make them fewer. A gain that
 * came back with every roll-back would let noise roll back for ever. Only another reference begins
 * anew.
 *
 * Life of it: memory_begin() when a reference with another CRC arrives; memory_first() when the
 * first trial is armed; memory_learn() after each trial; memory_restore_best() on request or when a
 * trial was worse than ratio x best twice in a row. Pure; the caller owns and stores the struct.
 */
#ifndef ILC_MEMORY_H
#define ILC_MEMORY_H

#include "base/units.h"
#include "ilc/beyond.h"
#include "ilc/judge.h"
#include "ilc/law.h"

/* The largest iteration is followed by the one this many before its successor, so that counting
 * goes on modulo this, which names the places of past trials (learn/past_trials.c). */
#define MEMORY_ROUND 8u

/* What made the amplitudes; TAILBEAT_INPUT on the wire. */
typedef enum {
    MEMORY_INPUT_LAW = 0,      /* learned from a trial */
    MEMORY_INPUT_FIRST = 1,    /* memory_first: nothing has been learned yet */
    MEMORY_INPUT_UPLOADED = 2, /* the host computed them */
    MEMORY_INPUT_RESTORED = 3, /* the best so far, brought back */
    MEMORY_INPUT_COUNT
} memory_input_t;

typedef struct {
    uint32_t reference_crc; /* the reference these amplitudes belong to */
    uint32_t last_trial;    /* number of the last trial learned from; 0 = none */
    uint16_t beats;
    uint16_t iteration;      /* of the amplitudes: iteration i swims u_i; 0 = none computed yet.
                                Counts trials learned from, rolled back or not; after
                                65535 comes 65528 (MEMORY_ROUND) */
    uint16_t best_iteration; /* 0 = no best yet */
    uint16_t input;          /* memory_input_t */
    uint16_t worse_streak;   /* trials in a row beyond ratio x best */
    float best_max_abs_error_m_s;   /* over the beats that trial measured */
    judge_peaks_t peaks;            /* its largest errors */
    float amplitude_rad[BEATS_MAX]; /* unsaturated, next to swim */
    float best_rad[BEATS_MAX];      /* as swum (saturated) */
    uint8_t visits[BEATS_MAX];      /* trials that have corrected each beat; stops at 255 */
} memory_t;

/* How a memory learns, beside the law. */
typedef struct {
    float rollback_ratio; /* 0 = never roll back */
    beyond_t beyond;      /* for beats that no trial has reached yet */
    bool has_past;        /* the scratch comes with the sum of the weighted earlier trials
                             (law_add); else the law looks at the last trial only */
    law_weights_t now;    /* of the trial that is learned from, when there is a past */
} memory_rules_t;

typedef struct {
    law_report_t law;
    bool improved;    /* this trial is the new best */
    bool rolled_back; /* the next amplitudes are the best ones, not an update */
} memory_report_t;

/* Empties the memory for a reference of |beats| beats; last_trial stays (so zero-initialise a new
 * memory first). */
void memory_begin(memory_t *memory, uint32_t reference_crc, uint16_t beats);

/* The law applied to iteration 0: zero input, whose error is the reference. No step limit. Sets
 * iteration 1; may be repeated with other gains as long as that has not been learned from.
 * |reference_m_s| and |scratch|: memory->beats floats. Refusals as law_update, and then nothing
 * changes. */
law_result_t memory_first(memory_t *memory, const law_t *law, const float *reference_m_s,
                          float *scratch);

/* Learns from |trial| (its amplitudes are the memory's own). |complete| = it was executed to its
 * end. It becomes the best when it is judged and better than the best (judge.h). A trial that is
 * worse by more than the ratio lengthens the streak, judged or not; a judged trial that is not ends
 * it; other trials prove nothing and leave it. The second in a row brings the best back and ends
 * the streak; such a trial corrects nothing and visits nothing.
 * |trial->visits| is not looked at: the memory has its own. LAW_BAD_CONFIG when trial->beats is not
 * the memory's, LAW_BAD_INPUT at iteration 0 (nothing was swum); otherwise refusals as law_update.
 * On refusal nothing changes. */
law_result_t memory_learn(memory_t *memory, const law_t *law, const law_trial_t *trial,
                          uint32_t trial_number, bool complete, const memory_rules_t *rules,
                          float *scratch, memory_report_t *report);

/* Makes the best amplitudes the next ones and ends the streak; the iteration stays. False when
 * there is no best yet. Not between a trial and learning from it: the amplitudes must be those it
 * swam. */
bool memory_restore_best(memory_t *memory);

#endif
