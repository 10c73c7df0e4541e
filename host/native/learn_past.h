/*
 * The earlier trials of one fish in memory, for laws that learn from more than the last one: what
 * the board keeps in its store. The arithmetic is the board's (ilc/past.h).
 */
#ifndef NATIVE_LEARN_PAST_H
#define NATIVE_LEARN_PAST_H

#include "ilc/memory.h"
#include "ilc/past.h"

typedef struct {
    float amplitude_rad[BEATS_MAX];
    float error_m_s[BEATS_MAX];
    uint8_t measured[BEATS_MAX];
} learn_trial_t;

typedef struct {
    uint16_t kind;   /* past_kind_t: ILC_KIND */
    uint16_t window; /* ILC_WINDOW: 2..PAST_WINDOW_MAX, the newest among them */
    uint32_t trials; /* kept so far */
    learn_trial_t trial[PAST_WINDOW_MAX - 1u]; /* a ring; of the mean the first alone */
} learn_past_t;

/* Empties it, as bringing the best back does on the board: that has no past. False when there is no
 * such kind or window. */
bool learn_past_begin(learn_past_t *past, uint16_t kind, uint16_t window);

/* Adds the earlier trials to |scratch| and sets what |rules| say of the past. */
law_result_t learn_past_add(const learn_past_t *past, const law_t *law, const memory_t *memory,
                            memory_rules_t *rules, float *scratch);

/* Keeps a trial that swam |amplitude_rad|, unsaturated. */
void learn_past_keep(learn_past_t *past, const law_t *law, const law_trial_t *trial,
                     const float *amplitude_rad);

#endif
