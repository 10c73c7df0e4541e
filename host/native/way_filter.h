/*
 * One pass of a Kalman filter over positions along the swim direction; fitting the model of a
 * film's positions takes some hundred of them. The states and their model are the caller's
 * (tailbeat/sensors/camera/smoother.py); positions are in units of their white noise. Pure; the
 * caller owns all buffers. Not for interrupts.
 */
#ifndef WAY_FILTER_H
#define WAY_FILTER_H

#include <stddef.h>
#include <stdint.h>

#define WAY_FILTER_STATES 8u
#define WAY_FILTER_COVARIANCES 64u
#define WAY_FILTER_KEPT 144u /* a mean and a covariance, twice */

typedef struct {
    double mean[WAY_FILTER_STATES];
    double cov[WAY_FILTER_COVARIANCES];
    double chi2;         /* sum of innovation^2 / variance */
    double log_variance; /* sum of logarithms */
    size_t seen;         /* positions taken; the first only says where the way begins */
} way_filter_t;

/* Over |nodes| of |way|, NaN where nothing was seen. |filter|: mean and covariance at the first
 * node, sums 0; those at the last one come out.
 *
 * |seen_as|: what of the states is in a position. |moves|, |noises|: transitions and process noise,
 * row-major, WAY_FILTER_COVARIANCES each; between nodes k and k + 1 those of number |which|[k],
 * nodes - 1 of them. |kept|: NULL, or WAY_FILTER_KEPT for each node: mean and covariance as
 * predicted, and as filtered. Cost: 0.3 us per node. */
void way_filter_run(way_filter_t *filter, const double *way, size_t nodes, const double *seen_as,
                    const double *moves, const double *noises, const int64_t *which, double *kept);

#endif
