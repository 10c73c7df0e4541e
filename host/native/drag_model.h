/*
 * The model of a fish that the host thinks with: dv/dt = kappa*(f(t) - v*|v| - linear*v), where the
 * thrust f follows w, which is held for a beat and acts |delay_s| after it was commanded: a share
 * of it at once, the rest with a time constant, as a wake builds up. Solved exactly piece by piece,
 * with exact derivatives; a beat is cut into pieces, over which the wake's share is its mean, where
 * there is one. Thrust within the beat is left out, as beat means do not feel it. Pure; the caller
 * owns all buffers.
 */
#ifndef DRAG_MODEL_H
#define DRAG_MODEL_H

#include <stdbool.h>
#include <stddef.h>

#define DRAG_MODEL_BEATS_MAX 512u

typedef struct {
    double kappa_per_m; /* drag over mass; > 0 */
    double delay_s;     /* from a beat's begin to the change of its thrust; >= 0 */
    double start_m_s;   /* speed over water at t = 0; >= 0 */
    double beat_s;      /* > 0 */
    double linear_m_s;  /* linear drag over the quadratic one, as the speed where both are equal */
    double wake_share;  /* of the thrust that follows; 0 to 1 */
    double wake_s;      /* its time constant; > 0 where there is a share */
} drag_model_t;

#define DRAG_MODEL_NUMBERS 6u /* kappa, delay, start, linear, wake share, wake time constant */

/* Distance over water at the |beats| * |parts| + 1 instants that cut every beat into |parts| equal
 * ones (1 = at its ends), from rest thrust before t = 0.
 *
 * |w|: beats values >= 0, m^2/s^2. |distance_m|: beats*parts + 1 values, the first is 0. Where not
 * NULL: |by_w|, (beats*parts + 1) x beats, row-major: d distance / d w; |by_model|, (beats*parts +
 * 1) x DRAG_MODEL_NUMBERS: d distance / d (its numbers). Derivatives to the delay are one-sided at
 * whole parts of a beat. Cost: about 0.1 us per part, with |by_w| beats times a few ns more; with a
 * wake 8 times that.
 * False, and nothing written, when a value makes no sense or there are more beats than
 * DRAG_MODEL_BEATS_MAX. */
bool drag_model_distance(const drag_model_t *model, const double *w, size_t beats, size_t parts,
                         double *distance_m, double *by_w, double *by_model);

#endif
