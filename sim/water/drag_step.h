/* One time step of dv/dt = K*(h - v*|v|) with h = thrust*over/under held: exact, hence stable for
 * any step; while it drifts backwards (v < 0) exact without thrust and stable with it. */
#ifndef SIM_DRAG_STEP_H
#define SIM_DRAG_STEP_H

#include <math.h>

/* Where the fraction below holds; |z2| = h*kt*kt, |kt| = k_per_m*dt_s. */
#define DRAG_FRACTION_Z2 0.0025
#define DRAG_FRACTION_VKT 0.05

/* For v >= 0. tanh(z)/z as (15 + z2)/(15 + 6 z2) (relative error 1e-11), all in one quotient; the
 * distance by Hermite's rule from the exact accelerations at both ends (2e-7 at the limit of the
 * branch, 1e-9 at 0.08 m/s and 5 ms): a third of the time of the libm branch. */
static inline double drag_fraction(double *v_m_s, double thrust, double over, double under,
                                   double kt, double dt_s) {
    const double v = *v_m_s;
    const double push = thrust * (over * kt);
    const double fifteenth = push * (kt * (1.0 / 15.0));
    const double a = under + fifteenth;
    const double under_b = under * (a + 5.0 * fifteenth);
    const double next = (v * under_b + push * a) / (under_b + v * (under * kt * a));
    *v_m_s = next;
    return (v + next) * (0.5 * dt_s + dt_s * kt * (1.0 / 12.0) * (next - v));
}

/* Advances |v_m_s| by |dt_s| and returns the distance. h, which is not negative, is the square of
 * the speed it would settle at; |under| > 0; |k_per_m| is the drag over the mass. */
static inline double drag_step(double *v_m_s, double thrust, double over, double under,
                               double k_per_m, double dt_s) {
    const double v = *v_m_s;
    const double kt = k_per_m * dt_s;
    if (v >= 0 && thrust * over * kt * kt < DRAG_FRACTION_Z2 * under &&
        v * kt < DRAG_FRACTION_VKT) {
        return drag_fraction(v_m_s, thrust, over, under, kt, dt_s);
    }
    const double h = thrust * over / under;
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

#endif
