/*
 * Which trials are judged, and which of two is better.
 *
 * A trial is judged on its measured beats when it was executed to its end, at least 80 % of its
 * beats are measured, and no more than JUDGE_GAP_MAX beats in a row are not. Its score is its max
 * |e| over these beats.
 *
 * A trial is compared with the best on the beats that both measured. A board has no room for all
 * errors of the best; it keeps the JUDGE_PEAKS largest with their beats. The best counts with the
 * largest of them at a beat that the other trial measured, or with the smallest one when that trial
 * measured none of them. A peak at a beat that the new best did not measure is carried over: at
 * this beat a later trial is compared with it alone.
 *
 * Why, with figures: docs/explanation/convergence.md. Pure; host and board agree bit for bit.
 */
#ifndef ILC_JUDGE_H
#define ILC_JUDGE_H

#include "ilc/law.h"

#define JUDGE_GAP_MAX 3u
#define JUDGE_PEAKS 8u

/* The largest errors of the best trial, largest first; of equal ones the earlier beat first. */
typedef struct {
    uint16_t count; /* 0 = not known: a best that an older firmware stored */
    uint16_t beat[JUDGE_PEAKS];
    float error_m_s[JUDGE_PEAKS]; /* |e|; -|e| where it is carried over from an earlier best */
} judge_peaks_t;

/* Whether enough of |trial| is measured; |complete| = it was executed to its end. */
bool judge_counts(const law_trial_t *trial, bool complete);

/* Whether |trial| is better than the best, whose score is |best_m_s|: each of its errors is smaller
 * than the best's score on the beats that |trial| measured, or no larger than the peak carried over
 * at its beat. */
bool judge_is_better(const judge_peaks_t *best, float best_m_s, const law_trial_t *trial);

/* Whether an error of |trial| exceeds |ratio| x the best's score, and |ratio| x the peak carried
 * over at its beat. */
bool judge_is_worse(const judge_peaks_t *best, float best_m_s, const law_trial_t *trial,
                    float ratio);

/* |trial| is the new best. |best| holds the peaks of the one before; all zero = there was none. */
void judge_keep(judge_peaks_t *best, const law_trial_t *trial);

#endif
