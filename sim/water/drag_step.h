/* One time step of dv/dt = K*(h - v*|v|) with thrust h held: exact, hence stable for any step;
 * while it drifts backwards (v < 0) exact without thrust and stable with it. */
#ifndef SIM_DRAG_STEP_H
#define SIM_DRAG_STEP_H

#include <math.h>

/* Where the series below holds; |z2| = h*kt*kt, |kt| = k_per_m*dt_s. */
#define DRAG_SERIES_Z2 0.0025
#define DRAG_SERIES_VKT 0.05

/* For v >= 0. tanh(z)/z as a series (relative error 1e-10), the distance by Hermite's rule from the
 * exact accelerations at both ends (2e-7 at the limit of the branch, 1e-9 at 0.08 m/s and 5 ms): a
 * third of the time of the libm branch. */
static inline double drag_series(double *v_m_s, double h, double kt, double z2, double dt_s) {
    const double v = *v_m_s;
    const double tau = kt * (1.0 - z2 * (1.0 / 3.0 - z2 * (2.0 / 15.0)));
    const double next = (v + h * tau) / (1.0 + v * tau);
    *v_m_s = next;
    return dt_s * (0.5 * (v + next) + kt * (next * next - v * v) * (1.0 / 12.0));
}

/* Advances |v_m_s| by |dt_s| and returns the distance. |h| >= 0 is the square of the speed it would
 * settle at, |k_per_m| the drag over the mass. */
static inline double drag_step(double *v_m_s, double h, double k_per_m, double dt_s) {
    const double v = *v_m_s;
    const double kt = k_per_m * dt_s;
    if (v < 0) {
        const double next = (v + h * kt) / (1.0 - v * kt);
        *v_m_s = next;
        return dt_s * 0.5 * (v + next);
    }
    const double z2 = h * kt * kt;
    if (z2 < DRAG_SERIES_Z2 && v * kt < DRAG_SERIES_VKT) {
        return drag_series(v_m_s, h, kt, z2, dt_s);
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
