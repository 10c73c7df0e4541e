#include "way_filter.h"

#include <math.h>
#include <string.h>

#define N WAY_FILTER_STATES

/* |out| = |move| * |in|, N x |columns|. Three of four elements of a transition are 0. */
static void multiply(const double *move, const double *in, size_t columns, double *out) {
    memset(out, 0, N * columns * sizeof *out);
    for (size_t i = 0; i < N; i++) {
        for (size_t k = 0; k < N; k++) {
            const double factor = move[i * N + k];
            if (factor == 0.0) {
                continue;
            }
            for (size_t j = 0; j < columns; j++) {
                out[i * columns + j] += factor * in[k * columns + j];
            }
        }
    }
}

static void transpose(const double *in, double *out) {
    for (size_t i = 0; i < N; i++) {
        for (size_t j = 0; j < N; j++) {
            out[j * N + i] = in[i * N + j];
        }
    }
}

/* To the next node. */
static void predict(way_filter_t *filter, const double *move, const double *noise) {
    double mean[N], half[N * N], turned[N * N];
    multiply(move, filter->mean, 1, mean);
    memcpy(filter->mean, mean, sizeof mean);
    multiply(move, filter->cov, N, half);
    transpose(half, turned);
    multiply(move, turned, N, filter->cov);
    for (size_t i = 0; i < N * N; i++) {
        filter->cov[i] += noise[i];
    }
}

static double dot(const double *a, const double *b) {
    double sum = 0.0;
    for (size_t i = 0; i < N; i++) {
        sum += a[i] * b[i];
    }
    return sum;
}

/* Takes what was seen at this node. */
static void correct(way_filter_t *filter, double way, const double *seen_as) {
    double across[N];
    for (size_t i = 0; i < N; i++) {
        across[i] = dot(filter->cov + i * N, seen_as);
    }
    const double variance = dot(across, seen_as) + 1.0;
    const double missed = way - dot(filter->mean, seen_as);
    for (size_t i = 0; i < N; i++) {
        const double gain = across[i] / variance;
        filter->mean[i] += gain * missed;
        for (size_t j = 0; j < N; j++) {
            filter->cov[i * N + j] -= gain * across[j];
        }
    }
    if (filter->seen > 0) {
        filter->chi2 += missed * missed / variance;
        filter->log_variance += log(variance);
    }
    filter->seen++;
}

static void keep(const way_filter_t *filter, double *kept) {
    memcpy(kept, filter->mean, sizeof filter->mean);
    memcpy(kept + N, filter->cov, sizeof filter->cov);
}

void way_filter_run(way_filter_t *filter, const double *way, size_t nodes, const double *seen_as,
                    const double *moves, const double *noises, const int64_t *which, double *kept) {
    for (size_t k = 0; k < nodes; k++) {
        if (k > 0) {
            const size_t at = (size_t)which[k - 1] * WAY_FILTER_COVARIANCES;
            predict(filter, moves + at, noises + at);
        }
        double *const row = kept == NULL ? NULL : kept + k * WAY_FILTER_KEPT;
        if (row != NULL) {
            keep(filter, row);
        }
        if (isfinite(way[k])) {
            correct(filter, way[k], seen_as);
        }
        if (row != NULL) {
            keep(filter, row + WAY_FILTER_KEPT / 2);
        }
    }
}
