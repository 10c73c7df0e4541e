/*
 * The laws that correct while the plant moves and learn their estimates from trial to trial:
 * adaptive with time scaling (thesis (4.5)-(4.6), (4.15)-(4.20)) and robust (5.5)-(5.19).
 *
 * All of them are one step, with a bank of estimates theta_j per sample and regressors phi_j that
 * the caller knows from its plant (e = wanted - measured, the opposite of chapters 4 and 5):
 *   theta_j := clip((old theta_j + gain_j * <phi_j, dead(e)>) / (1 + leak_j), low_j, high_j)
 *   u_r      = (Gamma_r * e_r + ff_r + sum_j theta_j * phi_j[r]) / b_r
 * The estimate of this moment is updated first and then used (4.6). Rates of time scaling go into
 * the gains.
 *
 *   term                       phi_j                                    gain, leak
 *   Theta entry (r, c) (4.6)   -f_c on channel r                        d rho/dt, 0
 *   lambda (4.17), theta (5.6) g * sign(e), feedback_sign               d rho/dt or gamma, 0
 *   the same, smooth           g * tanh(d rho/dt * g * e / eps)         .., mu
 *   (4.18), (5.8)
 *   eta (5.15)                 B * beta * feedback_direction            gamma_2, 0
 *
 * (5.13) and (5.19) add feedback_reserve() * feedback_direction() to the input. The cap (low, high)
 * and the dead zone are not the thesis's; without one of them or a leak, sampled sign laws drive
 * their estimate away (docs: explanation/thesis).
 *
 * The bank has one row of estimates per node of the common axis. A trial of another duration takes
 * as many steps as there are nodes, each d(rho)/dt times as long; or it reads between the nodes
 * (feedback_between) and must then write every node that it passes.
 *
 * No libm: the same bits on every target. Pure; the caller owns every buffer; callable from
 * interrupts. Memory per sample: one number per estimate. Cost of a step: about
 * 6 * estimates * channels + 8 * estimates operations; feedback_tanh about 40.
 *
 * Not chosen on the fish: these laws need its speed at once, beats long before any source has it,
 * and at one correction a second the robust ones are not worth running (docs: explanation/thesis).
 */
#ifndef ILC_FEEDBACK_H
#define ILC_FEEDBACK_H

#include "ilc/number.h"

#include <stdint.h>

#define FEEDBACK_CHANNELS_MAX 4u

/* How one estimate learns. */
typedef struct {
    number_t gain;      /* > 0; (4.6) has none, which fits only a plant with values around 1 */
    number_t leak;      /* mu >= 0; 0 forgets nothing, and lets chatter drive the estimate away */
    number_t dead_zone; /* >= 0; errors of a channel not beyond this teach nothing */
    number_t low, high; /* low <= high, finite: the estimate never leaves them */
} feedback_rule_t;

typedef struct {
    uint16_t channels;                     /* 1..FEEDBACK_CHANNELS_MAX */
    uint16_t estimates;                    /* 0..; per sample */
    number_t gamma[FEEDBACK_CHANNELS_MAX]; /* Gamma, diagonal; >= 0 */
    number_t input_gain_min;               /* > 0; |b| below this is refused */
    const feedback_rule_t *rules;          /* |estimates| of them; the caller's */
} feedback_t;

/* What the caller measured and knows of this moment. Arrays of |channels| values; phi: |estimates|
 * rows of |channels| values. */
typedef struct {
    const number_t *error;        /* wanted - measured */
    const number_t *feed_forward; /* ff: d(wanted)/dt in real time, and terms of the plant's own */
    const number_t *input_gain;   /* b: diagonal of B */
    const number_t *phi;
    bool frozen; /* do not learn, do not leak: the input is saturated, or the old estimates are not
                    this task's */
} feedback_moment_t;

typedef enum {
    FEEDBACK_OK = 0,
    FEEDBACK_BAD_CONFIG = 1,
    FEEDBACK_BAD_INPUT = 2,   /* a non-finite value, or a result that is not finite */
    FEEDBACK_NO_AUTHORITY = 3 /* |b| below input_gain_min: the input would explode */
} feedback_result_t;

/* FEEDBACK_OK or FEEDBACK_BAD_CONFIG: a value outside its range above, or not finite. */
feedback_result_t feedback_check(const feedback_t *feedback);

/* One step of a |feedback| that feedback_check accepts. |old|: this sample's estimates of the last
 * trial; |now|: those of this one (may be |old|); |input|: channels values. On anything but
 * FEEDBACK_OK nothing is written. */
feedback_result_t feedback_step(const feedback_t *feedback, const feedback_moment_t *moment,
                                const number_t *old, number_t *now, number_t *input);

/* Where the error pulls the inputs: B'e / (|B'e| + softness), B diagonal, |channels| values each;
 * zeros at e = 0. softness >= 0; 0 is the unit vector of (5.13), which jumps when the error passes
 * zero. */
void feedback_direction(uint16_t channels, const number_t *error, const number_t *input_gain,
                        number_t softness, number_t *direction);

/* What (5.13) holds in reserve against an input gain that is known only within B(I + H),
 * |H| <= kappa: its last bracket, to be multiplied with feedback_direction. */
typedef struct {
    number_t kappa, xi;         /* kappa <= xi < 1 */
    number_t gamma_norm;        /* |Gamma| */
    number_t error_norm;        /* |e| */
    number_t inverse_gain_norm; /* 1/|B| as printed; |B^-1| is what the proof needs (A.71) */
    number_t root_channels;     /* sqrt(channels) */
    number_t alpha, theta;      /* bound of f and its estimate, of this moment */
    number_t beta, eta;         /* bound of d and its estimate, of this moment */
    bool smooth;                /* x*tanh(x) for |x| of the estimates (5.19) */
} feedback_reserve_t;

number_t feedback_reserve(const feedback_reserve_t *reserve);

/* The estimates at |position| samples (held before the first and beyond the last; NaN reads the
 * first) of a bank of |samples| >= 1 rows of |estimates|, linear between rows: a trial of another
 * duration looks between the nodes. */
void feedback_between(const number_t *bank, uint32_t samples, uint16_t estimates, number_t position,
                      number_t *out);

/* -1, 0 or 1. Chatters: for recomputing the thesis, not for a plant. */
number_t feedback_sign(number_t x);

/* tanh, |error| below 1e-7 in float, 1e-15 in double; odd; +-1 at infinity. NaN stays NaN. */
number_t feedback_tanh(number_t x);

#endif
