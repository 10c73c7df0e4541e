/*
 * The plant and the reference of chapter 5 with its robust laws: exact input gain and no
 * disturbance (case 1), or both uncertain (case 2). The plant is dx/dt = f + w + B((I + H)u + d),
 * with w the reference's slope.
 */
#ifndef CHAPTER5_H
#define CHAPTER5_H

#include "closed_loop.h"

typedef struct {
    bool uncertain; /* case 2, (5.13)-(5.19); else case 1 */
    bool smooth;    /* tanh for sign: (5.8), (5.19); else (5.5), (5.13) */
    double epsilon;
    double bound;        /* rho or alpha = bound * |f|; the thesis gives 2 for case 2, none for 1 */
    double gain_theta;   /* gamma, gamma_1 */
    double gain_eta;     /* gamma_2 */
    double leak;         /* mu */
    uint32_t beta_power; /* of sin x2 in beta: 4 as printed, 2 as fits d */
    bool inverse_norm;   /* |B^-1| for 1/|B| in the reserve, as the proof needs it */
    double softness;     /* of the direction; 0 as printed */
    double dead_zone, theta_max; /* not the thesis's: 0 and 1e30 are as printed */
    double input_max; /* of the actuator, both channels; not the thesis's: 1e30 = no limit */
    loop_grid_t grid;
} chapter5_t;

/* Numbers per row of the bank: theta and, in case 2, eta. */
uint16_t chapter5_estimates(const chapter5_t *example);

/* The next trial; it goes on from |state| (alignment). The rest as loop_trial. */
feedback_result_t chapter5_trial(const chapter5_t *example, double *state, number_t *bank,
                                 double *trace, loop_report_t *report);

#endif
