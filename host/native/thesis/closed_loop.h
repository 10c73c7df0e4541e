/*
 * A plant of two states under a feedback law of feedback.h, integrated over one trial. The
 * plant computes in double, the law in number_t, to which its errors and regressors are rounded.
 *
 * The time t runs over the common axis 0..duration of all trials; estimates are kept at its nodes,
 * t = k * duration / steps.
 */
#ifndef CLOSED_LOOP_H
#define CLOSED_LOOP_H

#include "feedback.h"

#define LOOP_STATES 2u
#define LOOP_ESTIMATES_MAX 21u

/* How the continuous loop is computed. */
typedef enum {
    LOOP_RK4 =
        0, /* the law in every stage of Runge-Kutta, with old estimates linear between nodes */
    LOOP_HELD = 1, /* the law at the nodes; the plant goes on by Runge-Kutta under the held input */
    LOOP_EULER = 2 /* the law at the nodes; the plant by Euler's rule */
} loop_scheme_t;

typedef struct {
    double max_abs_error[LOOP_STATES];   /* over all nodes */
    double input_variation[LOOP_STATES]; /* sum of |u[k+1] - u[k]| over the nodes */
    double max_abs_input[LOOP_STATES];
    double max_estimate[LOOP_ESTIMATES_MAX]; /* largest |estimate| over the nodes */
} loop_report_t;

/* What the law is told of a moment; rows of |phi| as in feedback_moment_t. */
typedef struct {
    number_t error[LOOP_STATES], feed_forward[LOOP_STATES], input_gain[LOOP_STATES];
    number_t phi[LOOP_ESTIMATES_MAX * LOOP_STATES];
} loop_view_t;

/* A task with its plant. |task| is passed to each function. */
typedef struct {
    const void *task;
    double duration; /* of the common axis */
    void (*wanted)(const void *task, double t, double *wanted);
    /* |view| is zeroed. */
    void (*look)(const void *task, double t, const double *state, loop_view_t *view);
    /* d(state)/dt on the common axis. */
    void (*slope)(const void *task, double t, const double *state, const double *input,
                  double *slope);
    /* What the law adds to its input when the estimates are known; NULL = nothing. */
    void (*add)(const void *task, double t, const double *state, const number_t *estimates,
                number_t *input);
} loop_plant_t;

typedef struct {
    loop_scheme_t scheme;
    uint32_t steps; /* >= 1 */
} loop_grid_t;

#define LOOP_TRACE_COLUMNS 7u /* t, state 1, 2, wanted 1, 2, input 1, 2 */

/* One trial from |state|, which ends as the state at the trial's end. |bank|: steps + 1 rows of
 * estimates, those of the last trial, overwritten. |trace|: steps + 1 rows, or NULL. Not
 * FEEDBACK_OK: the loop could not be computed to its end (it diverged); bank and state are then
 * those of a trial cut there. */
feedback_result_t loop_trial(const loop_plant_t *plant, const feedback_t *law, loop_grid_t grid,
                             double *state, number_t *bank, double *trace, loop_report_t *report);

#endif
