/* One time step of dv/dt = K*(h - v*|v|) with h = thrust*over/under held: exact, hence stable for
 * any step; while it drifts backwards (v < 0) exact without thrust and stable with it. */
#ifndef SIM_DRAG_STEP_H
#define SIM_DRAG_STEP_H

#include <math.h>
#include <stdbool.h>

/* Where the fraction below holds: z = sqrt(h)*kt and v*kt are less; |kt| = k_per_m*dt_s. */
#define DRAG_FRACTION_MOST 0.05

/* What a step is computed from: h = thrust*over/under, which is not negative, is the square of the
 * speed it would settle at; |under| > 0. */
typedef struct {
    double thrust, over, under;
} drag_push_t;

static inline bool drag_is_fraction(double v_m_s, drag_push_t push, double kt) {
    const double most = DRAG_FRACTION_MOST;
    return v_m_s >= 0 && push.thrust * push.over * kt * kt < most * most * push.under &&
           v_m_s * kt < most;
}

/* The speed a step later: tanh(z)/z as (15 + z2)/(15 + 6 z2) (relative error 1e-11), all in one
 * quotient. A third of the time of the libm branch. */
static inline double drag_fraction(double v_m_s, drag_push_t push, double kt) {
    const double along = push.thrust * (push.over * kt);
    const double fifteenth = along * (kt * (1.0 / 15.0));
    const double a = push.under + fifteenth;
    const double under_b = push.under * (a + 5.0 * fifteenth);
    return (v_m_s * under_b + along * a) / (under_b + v_m_s * (push.under * kt * a));
}

/* For what is no fraction: advances |v_m_s| and returns the distance. */
static inline double drag_curve(double *v_m_s, double h, double k_per_m, double dt_s) {
    const double v = *v_m_s;
    const double kt = k_per_m * dt_s;
    if (v < 0) {
        const double next = (v + h * kt) / (1.0 - v * kt);
        *v_m_s = next;
        return dt_s * 0.5 * (v + next);
    }
    const double ve = sqrt(h);
    const double z = ve * kt;
    if (z < 1e-9) {
        *v_m_s = v / (1.0 + v * kt);
        return log1p(v * kt) / k_per_m;
    }
    const double d = expm1(-2.0 * z);
    const double t = -d / (2.0 + d);
    *v_m_s = ve * (v + ve * t) / (ve + v * t);
    return (z + log1p(0.5 * (1.0 - v / ve) * d)) / k_per_m;
}

static inline double drag_twelfth(double kt, double dt_s) { return dt_s * kt * (1.0 / 12.0); }

/* The way since somewhere, but for a constant, after steps in a row: Hermite's rule from the exact
 * accelerations at both ends of each (2e-7 at the limit of the fraction, 1e-9 at 0.08 m/s and 5
 * ms), summed up. |sum_m_s|: of the speeds at the ends of the steps, of which |v_m_s| is the last
 * one; |twelfth|: drag_twelfth. */
static inline double drag_way(double sum_m_s, double v_m_s, double dt_s, double twelfth) {
    return dt_s * sum_m_s + v_m_s * (twelfth * v_m_s - 0.5 * dt_s);
}

/* Advances |v_m_s| by |dt_s| and returns by how much the sum of drag_way grows. |k_per_m| is the
 * drag over the mass. */
static inline double drag_sum_step(double *v_m_s, drag_push_t push, double k_per_m, double dt_s) {
    const double v = *v_m_s;
    const double kt = k_per_m * dt_s, twelfth = drag_twelfth(kt, dt_s);
    if (drag_is_fraction(v, push, kt)) {
        return *v_m_s = drag_fraction(v, push, kt);
    }
    const double way_m = drag_curve(v_m_s, push.thrust * push.over / push.under, k_per_m, dt_s);
    return (way_m + drag_way(0, v, dt_s, twelfth) - drag_way(0, *v_m_s, dt_s, twelfth)) / dt_s;
}

/* The same, and returns the distance. */
static inline double drag_step(double *v_m_s, drag_push_t push, double k_per_m, double dt_s) {
    const double twelfth = drag_twelfth(k_per_m * dt_s, dt_s);
    const double begin_m = drag_way(0, *v_m_s, dt_s, twelfth);
    const double sum_m_s = drag_sum_step(v_m_s, push, k_per_m, dt_s);
    return drag_way(sum_m_s, *v_m_s, dt_s, twelfth) - begin_m;
}

#endif
