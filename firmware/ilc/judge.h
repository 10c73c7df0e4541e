/*
 * Which trials are judged, and which of two is better.
 *
 * A trial is judged on its measured beats when it was executed to its end, at least 80 % of its
 * beats are measured, and no more than JUDGE_GAP_MAX beats in a row are not. Its score is its max
 * |e| over these beats.
 *
 * A trial is compared with the best on the beats that it measured. A board has no room for all
 * errors of the best; it keeps the JUDGE_PEAKS largest with their beats. The best counts with the
 * largest of them at a beat that the other trial measured, or with the smallest one when that trial
 * measured none of them. The other trial counts with its score. A peak at a beat that the new best
 * did not measure stays as it was: a trial does not lose an error because its beat has no speed.
 *
 * Why, with figures: docs/progress.md. Pure; host and board agree bit for bit.
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
    float error_m_s[JUDGE_PEAKS]; /* |e| > 0 */
} judge_peaks_t;

/* Whether enough of |trial| is measured; |complete| = it was executed to its end. */
bool judge_counts(const law_trial_t *trial, bool complete);

/* The best's max |e| on the beats that |trial| measured; |otherwise| where no peak is known. */
float judge_best_there(const judge_peaks_t *best, const law_trial_t *trial, float otherwise);

/* |trial| is the new best. |best| holds the peaks of the one before; all zero = there was none. */
void judge_keep(judge_peaks_t *best, const law_trial_t *trial);

#endif
