/*
 * Many fish learn at once, each with the board's own memory and law (ilc/memory.h): what
 * memory_first and memory_learn would do for one fish after the other, without a call from Python
 * for each. Row i of every array belongs to fish i.
 */
#ifndef NATIVE_LEARN_BATCH_H
#define NATIVE_LEARN_BATCH_H

#include "learn_past.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Empties |memories| and computes the first amplitudes for |reference_m_s| (beats values).
 * |applied_rad| (fish x beats): as the tail will do them. False when a law does not fit. */
bool learn_batch_first(memory_t *memories, const law_t *laws, size_t fish, uint16_t beats,
                       const float *reference_m_s, double *applied_rad);

/* Learns from one trial of each fish. |speed_m_s| (fish x beats): NaN = not measured, as all beats
 * after a trial's end; one without a speed in its last beat counts as cut short. |reports|: one per
 * fish. |pasts|: one per fish, begun (learn_past_begin); NULL = the last trial only. A fish without
 * any speed keeps its amplitudes, its report is empty. False when a law refuses for another reason;
 * some fish have learned then. */
bool learn_batch_learn(memory_t *memories, learn_past_t *pasts, const law_t *laws, size_t fish,
                       const float *reference_m_s, const double *speed_m_s, uint32_t trial,
                       float rollback_ratio, memory_report_t *reports, double *applied_rad);

#endif
