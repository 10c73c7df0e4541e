#include "line_fit.h"

#include <math.h>

static size_t place(const line_fit_t *fit, size_t number) {
    return (fit->first + number) % LINE_FIT_POSITIONS_MAX;
}

static void drop_first(line_fit_t *fit) {
    fit->first = place(fit, 1u);
    fit->count--;
}

/* Sums of about 26 terms are cheaper than keeping them, and never drift. */
static bool line(const line_fit_t *fit, line_fit_speed_t *speed) {
    double begin_s = fit->t_s[fit->first];
    double begin_m = fit->x_m[fit->first];
    double st = 0.0, sx = 0.0, stt = 0.0, stx = 0.0, sxx = 0.0, last = 0.0;
    for (size_t k = 0; k < fit->count; k++) {
        double t = fit->t_s[place(fit, k)] - begin_s;
        double x = fit->x_m[place(fit, k)] - begin_m;
        if (t - last > fit->gap_max_s) {
            return false;
        }
        last = t;
        st += t;
        sx += x;
        stt += t * t;
        stx += t * x;
        sxx += x * x;
    }
    double count = (double)fit->count;
    double vtt = stt - st * st / count;
    double vtx = stx - st * sx / count;
    speed->speed_m_s = vtx / vtt;
    double scatter = sxx - sx * sx / count - speed->speed_m_s * vtx;
    double variance = (scatter > 0.0 ? scatter : 0.0) / (count - 2.0);
    double sigma = sqrt(variance / vtt);
    speed->sigma_m_s = sigma > fit->sigma_min_m_s ? sigma : fit->sigma_min_m_s;
    speed->t_s = begin_s + last / 2.0;
    return true;
}

bool line_fit_add(line_fit_t *fit, double t_s, double x_m, line_fit_speed_t *speed) {
    if (!isfinite(t_s) || !isfinite(x_m)) {
        return false;
    }
    if (fit->count > 0u) {
        size_t last = place(fit, fit->count - 1u);
        double step_s = t_s - fit->t_s[last];
        if (step_s <= 0.0) {
            return false;
        }
        if (fabs(x_m - fit->x_m[last]) > fit->speed_max_m_s * step_s + fit->jump_m) {
            fit->count = 0u;
        }
    }
    if (fit->count == LINE_FIT_POSITIONS_MAX) {
        drop_first(fit); /* more pictures than were promised: the window stays too short */
    }
    size_t here = place(fit, fit->count);
    fit->t_s[here] = t_s;
    fit->x_m[here] = x_m;
    fit->count++;
    while (t_s - fit->t_s[fit->first] > fit->beat_s + fit->slack_s) {
        drop_first(fit);
    }
    bool whole = t_s - fit->t_s[fit->first] >= fit->beat_s - fit->slack_s;
    return fit->count >= fit->positions_min && whole && line(fit, speed);
}
