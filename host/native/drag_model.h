/*
 * The model of a fish that the host thinks with: dv/dt = kappa*(w(t) - v*|v|), where w, the square
 * of the steady speed, is held for a beat and acts |delay_s| after it was commanded. Solved exactly
 * piece by piece, with exact derivatives; thrust within the beat is left out, as beat means do not
 * feel it. Pure; the caller owns all buffers.
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
} drag_model_t;

/* Distance over water at the |beats| * |parts| + 1 instants that cut every beat into |parts| equal
 * ones (1 = at its ends), from rest thrust before t = 0.
 *
 * |w|: beats values >= 0, m^2/s^2. |distance_m|: beats*parts + 1 values, the first is 0. Where not
 * NULL: |by_w|, (beats*parts + 1) x beats, row-major: d distance / d w; |by_model|, (beats*parts +
 * 1) x 3: d distance / d (kappa, delay, start). Derivatives to the delay are one-sided at whole
 * parts of a beat. Cost: about 0.1 us per part, with |by_w| beats times a few ns more.
 * False, and nothing written, when a value makes no sense or there are more beats than
 * DRAG_MODEL_BEATS_MAX. */
bool drag_model_distance(const drag_model_t *model, const double *w, size_t beats, size_t parts,
                         double *distance_m, double *by_w, double *by_model);

#endif
