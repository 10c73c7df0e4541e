/*
 * What a fish learns with on the host as its board does: what the board remembers, and the earlier
 * trials for laws that learn from more than the last one. The caller owns all buffers.
 */
#ifndef NATIVE_LAW_MEMORY_H
#define NATIVE_LAW_MEMORY_H

#include "learn_past.h"

#include <stddef.h>

typedef struct {
    memory_t memory;
    learn_past_t past;
} law_memory_t;

/* Learns from a trial that swam the memory's amplitudes, by all trials that |past| says, and keeps
 * it there; amplitudes that were brought back have no past. |error_m_s|, |measured|: of each beat,
 * as in law_trial_t. The rest, and refusals, after which nothing has changed: as memory_learn. */
law_result_t law_memory_learn(law_memory_t *whole, const law_t *law, const float *error_m_s,
                              const uint8_t *measured, bool complete, float rollback_ratio,
                              beyond_t beyond, memory_report_t *report);

/* |count| memories of as many beats, each by its own law from its own trial. Rows of beats:
 * |error_m_s|, and |measured|, 1 where there is a speed, else 0; whose row has none learns nothing.
 * |complete|, |rolled_back|: one for each. Ends at the first refusal. */
law_result_t law_memory_learn_all(law_memory_t *memories, const law_t *laws, size_t count,
                                  const float *error_m_s, const uint8_t *measured,
                                  const uint8_t *complete, float rollback_ratio,
                                  uint8_t *rolled_back);

#endif
