/*
 * The plant of chapter 7's example, equation (7.31): on x in [0, 1], t in min,
 *   v_t = v_xx - varsigma*(c*v)_x + phi(v),  c = x*t + x^2/2,  phi(v) = -mu*v/(K + v),
 *   v_x(0, t) = u(t),  v_x(1, t) = g,  v(x, 0) = 0;  what is measured is y = v(1, t).
 *
 * Method of lines on equal cells, the source at their middles (as Matlab's pdepe has it for flat
 * geometry), half a cell of heat at either end; backward Euler with u at the end of the step,
 * Newton until nothing moves by 1e-10 of 1 + max|v|. Pure; the caller owns all buffers.
 */
#ifndef ADVECTION_PLANT_H
#define ADVECTION_PLANT_H

#include <stdint.h>

#define ADVECTION_CELLS_MAX 1000u

/* phi has a pole at v = -K, which inputs that cool reach; beyond v >= 0 it needs a continuation. */
typedef enum {
    ADVECTION_CLIP = 0,  /* phi(max(v, 0)) */
    ADVECTION_ABS = 1,   /* -mu*v/(K + |v|) */
    ADVECTION_MONOD = 2, /* as printed, pole and all */
    ADVECTION_NONE = 3   /* no uptake */
} advection_uptake_t;

typedef struct {
    uint32_t samples;           /* >= 1, the one at t = 0 too */
    uint32_t cells;             /* 1..ADVECTION_CELLS_MAX; nodes are one more */
    double step;                /* min, > 0 */
    double carried;             /* varsigma */
    double uptake_max, half_at; /* mu, K > 0 */
    double inflow;              /* g */
    advection_uptake_t uptake;
} advection_plant_t;

/* Runs a trial of |input| (samples values) from v = 0; |output|: samples values. |field|: NULL, or
 * samples*(cells+1) values of v, row by row. Returns the samples that were computed: fewer than
 * asked for where Newton does not end or a number is not finite, and 0 for a plant that makes no
 * sense. Cost: about 10 us per sample of 100 cells. */
uint32_t advection_plant_run(const advection_plant_t *plant, const double *input, double *output,
                             double *field);

#endif
