/*
 * The plants and tasks of chapter 4 with their adaptive laws: the reference (4.22), whose length
 * and shape change from trial to trial, on a plant with constant (example 1) or time-varying
 * parameters (example 2).
 */
#ifndef CHAPTER4_H
#define CHAPTER4_H

#include "closed_loop.h"

typedef struct {
    bool varying; /* example 2, (4.15)-(4.20); else example 1, (4.5)-(4.6) */
    bool smooth;  /* of example 2: tanh and leakage (4.18)-(4.20) */
    bool block; /* only the diagonal of Theta is learned, as the plant has it; else all of (4.6) */
    double epsilon, leak_eta, leak_lambda; /* of the smooth law */
    double dead_zone, lambda_max;          /* not the thesis's: 0 and 1e30 are as printed */
    loop_grid_t grid;
} chapter4_t;

/* Numbers per row of the bank. */
uint16_t chapter4_estimates(const chapter4_t *example);

/* Trial |iteration| >= 1 from the state 0; the rest as loop_trial. */
feedback_result_t chapter4_trial(const chapter4_t *example, uint32_t iteration, number_t *bank,
                                 double *trace, loop_report_t *report);

#endif
