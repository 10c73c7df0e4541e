#include "drag_model.h"

#include <math.h>
#include <string.h>

enum { BY_KAPPA, BY_DELAY, BY_START, BY_LINEAR, BY_SHARE, BY_WAKE_S, BY_MODEL };
_Static_assert(BY_MODEL == DRAG_MODEL_NUMBERS, "a derivative for each number");

#define WAKE_PIECES 8u /* of a beat; over each the wake's share is its mean */

/* Over a piece of time with w held: way and speed at its end, and what they owe to what. */
typedef struct {
    double way_m, v_m_s;
    double way_by_v, v_by_v;
    double way_by_w, v_by_w;
    double way_by_kappa, v_by_kappa;
} piece_t;

/* What the wake does in a piece of time: it keeps |kept| of what it was, and its mean |mean| of
 * what it differs from the thrust at the begin. */
typedef struct {
    double kept, mean;
    double kept_by_s, mean_by_s; /* by the time constant */
    double time_s;               /* of the piece; 0 = none yet */
} fading_t;

/* The whole state: distance, speed and wake, with their derivatives. */
typedef struct {
    const drag_model_t *model;
    double x_m, v_m_s, wake;
    double *x_by_w, *v_by_w, *wake_by_w; /* the row that is being filled; NULL = not asked for */
    double x_by[BY_MODEL], v_by[BY_MODEL], wake_by[BY_MODEL];
    fading_t fading; /* of the last piece: most are as long as the one before */
} swim_t;

/* With c = cosh z, s = kt*sinh(z)/z, z = kt*sqrt(w), all scaled by exp(-z) so that nothing
 * overflows: D = c + v*s, way = ln(D)/kappa, v' = (v*c + w*s)/D. c and s are smooth in w at 0. */
static piece_t piece(double kappa, double w, double v, double time_s) {
    const double kt = kappa * time_s;
    const double root = sqrt(w);
    const double z = kt * root;
    const double decay = exp(-2 * z);
    const double c = 0.5 * (1 + decay);
    const double s = z > 1e-4 ? 0.5 * (1 - decay) / root : kt * exp(-z) * (1 + z * z / 6);
    /* the derivative of s*exp(z) by w, times exp(-z); the series where the difference of
     * nearly equal numbers would lose all digits */
    const double ds = z > 0.02
                          ? (kt * c - s) / (2 * w)
                          : kt * kt * kt * exp(-z) * (1.0 / 6 + z * z / 60 + z * z * z * z / 1680);
    const double dc = 0.5 * kt * s;
    const double d = c + v * s;
    const double next = (v * c + w * s) / d;
    const double way = (z + log(d)) / kappa;
    const double d_by_w = dc + v * ds;
    return (piece_t){
        .way_m = way,
        .v_m_s = next,
        .way_by_v = s / (kappa * d),
        .v_by_v = decay / (d * d),
        .way_by_w = d_by_w / (kappa * d),
        .v_by_w = (v * dc + s + w * ds - next * d_by_w) / d,
        .way_by_kappa = (time_s * next - way) / kappa,
        .v_by_kappa = time_s * (w - next * next),
    };
}

static fading_t fading(double wake_s, double time_s) {
    const double ratio = time_s / wake_s;
    const double kept = exp(-ratio);
    const double gone = -expm1(-ratio);
    return (fading_t){
        .kept = kept,
        .mean = gone / ratio,
        .kept_by_s = kept * ratio / wake_s,
        .mean_by_s = gone / time_s - kept / wake_s,
        .time_s = time_s,
    };
}

/* One piece with |thrust| held: u = v + linear/2 obeys du/dt = kappa*(f + linear^2/4 - u^2).
 * |f_by|: derivatives of the force f to the model's numbers. */
static piece_t move(swim_t *swim, double force, const double f_by[BY_MODEL], double time_s) {
    const double half = 0.5 * swim->model->linear_m_s;
    const piece_t p =
        piece(swim->model->kappa_per_m, force + half * half, swim->v_m_s + half, time_s);
    swim->x_m += p.way_m - half * time_s;
    swim->v_m_s = p.v_m_s - half > 0 ? p.v_m_s - half : 0;
    for (size_t i = 0; i < BY_MODEL; i++) {
        const double h = f_by[i] + (i == BY_LINEAR ? half : 0);
        const double u = swim->v_by[i] + (i == BY_LINEAR ? 0.5 : 0);
        swim->x_by[i] += p.way_by_v * u + p.way_by_w * h - (i == BY_LINEAR ? 0.5 * time_s : 0);
        swim->v_by[i] = p.v_by_v * u + p.v_by_w * h - (i == BY_LINEAR ? 0.5 : 0);
    }
    swim->x_by[BY_KAPPA] += p.way_by_kappa;
    swim->v_by[BY_KAPPA] += p.v_by_kappa;
    return p;
}

static void add_to_beat(swim_t *swim, const piece_t *p, size_t beat, double force_by_w) {
    swim->x_by_w[beat] += p->way_by_w * force_by_w;
    swim->v_by_w[beat] += p->v_by_w * force_by_w;
}

static void carry_beats(swim_t *swim, const piece_t *p, ptrdiff_t beat) {
    double *restrict x_by_w = swim->x_by_w;
    double *restrict v_by_w = swim->v_by_w;
    const double way_by_v = p->way_by_v, v_by_v = p->v_by_v;
    for (ptrdiff_t j = 0; j <= beat; j++) {
        x_by_w[j] += way_by_v * v_by_w[j];
        v_by_w[j] *= v_by_v;
    }
}

/* As carry_beats(), and what the wake of each beat does. */
static void carry_wakes(swim_t *swim, const piece_t *p, const fading_t *f, ptrdiff_t beat) {
    double *restrict x_by_w = swim->x_by_w;
    double *restrict v_by_w = swim->v_by_w;
    double *restrict wake_by_w = swim->wake_by_w;
    const double acting = swim->model->wake_share * f->mean, kept = f->kept;
    const piece_t own = *p;
    for (ptrdiff_t j = 0; j <= beat; j++) {
        const double force_by_w = acting * wake_by_w[j];
        x_by_w[j] += own.way_by_v * v_by_w[j];
        v_by_w[j] *= own.v_by_v;
        x_by_w[j] += own.way_by_w * force_by_w;
        v_by_w[j] += own.v_by_w * force_by_w;
        wake_by_w[j] *= kept;
    }
}

/* Without a wake. */
static void advance_at_once(swim_t *swim, double thrust, ptrdiff_t beat, double time_s) {
    static const double nothing[BY_MODEL] = {0};
    const piece_t p = move(swim, thrust, nothing, time_s);
    if (swim->x_by_w != NULL) {
        carry_beats(swim, &p, beat);
        if (beat >= 0) {
            add_to_beat(swim, &p, (size_t)beat, 1);
        }
    }
}

/* With one, over a piece that is short beside its time constant. */
static void advance_late(swim_t *swim, double thrust, ptrdiff_t beat, double time_s) {
    const double share = swim->model->wake_share;
    if (swim->fading.time_s != time_s) {
        swim->fading = fading(swim->model->wake_s, time_s);
    }
    const fading_t f = swim->fading;
    const double off = swim->wake - thrust;
    double f_by[BY_MODEL];
    for (size_t i = 0; i < BY_MODEL; i++) {
        f_by[i] = share * f.mean * swim->wake_by[i];
        swim->wake_by[i] *= f.kept;
    }
    f_by[BY_SHARE] += f.mean * off;
    f_by[BY_WAKE_S] += share * f.mean_by_s * off;
    swim->wake_by[BY_WAKE_S] += f.kept_by_s * off;
    const piece_t p = move(swim, thrust + share * f.mean * off, f_by, time_s);
    swim->wake = thrust + f.kept * off;
    if (swim->x_by_w == NULL) {
        return;
    }
    carry_wakes(swim, &p, &f, beat);
    if (beat >= 0) {
        add_to_beat(swim, &p, (size_t)beat, 1 - share * f.mean);
        swim->wake_by_w[beat] += 1 - f.kept;
    }
}

/* Lets |beat|'s thrust act for |time_s|; one before the first is none. */
static void advance(swim_t *swim, const double *w, ptrdiff_t beat, double time_s) {
    const double thrust = beat >= 0 ? w[beat] : 0;
    if (time_s <= 0) {
        return;
    }
    if (swim->model->wake_share <= 0) {
        advance_at_once(swim, thrust, beat, time_s);
        return;
    }
    const double pieces = ceil(time_s / swim->model->beat_s * WAKE_PIECES - 1e-9);
    for (unsigned i = 0; i < (unsigned)pieces; i++) {
        advance_late(swim, thrust, beat, time_s / pieces);
    }
}

/* A later switch prolongs the old thrust: the speed has gained kappa*(old - new) more by then, of
 * what acts at once, and the wake is behind. */
static void switched_later(swim_t *swim, double old_w, double new_w) {
    const double share = swim->model->wake_share;
    swim->v_by[BY_DELAY] += swim->model->kappa_per_m * (1 - share) * (old_w - new_w);
    if (share > 0) {
        swim->wake_by[BY_DELAY] += (old_w - new_w) / swim->model->wake_s;
    }
}

static bool valid(const drag_model_t *model, const double *w, size_t beats, size_t parts) {
    bool fine = model->kappa_per_m > 0 && isfinite(model->kappa_per_m) && model->delay_s >= 0 &&
                isfinite(model->delay_s) && model->start_m_s >= 0 && isfinite(model->start_m_s) &&
                model->beat_s > 0 && isfinite(model->beat_s) && parts > 0 &&
                model->linear_m_s >= 0 && isfinite(model->linear_m_s) && model->wake_share >= 0 &&
                model->wake_share <= 1 &&
                (model->wake_share <= 0 || (model->wake_s > 0 && isfinite(model->wake_s)));
    for (size_t k = 0; k < beats; k++) {
        fine = fine && w[k] >= 0 && isfinite(w[k]);
    }
    return fine;
}

static void note(const swim_t *swim, size_t row, double *distance_m, double *by_model) {
    distance_m[row] = swim->x_m;
    if (by_model != NULL) {
        memcpy(by_model + row * BY_MODEL, swim->x_by, sizeof swim->x_by);
    }
}

bool drag_model_distance(const drag_model_t *model, const double *w, size_t beats, size_t parts,
                         double *distance_m, double *by_w, double *by_model) {
    if (!valid(model, w, beats, parts) || beats > DRAG_MODEL_BEATS_MAX) {
        return false;
    }
    double v_by_w[DRAG_MODEL_BEATS_MAX] = {0}, wake_by_w[DRAG_MODEL_BEATS_MAX] = {0};
    swim_t swim = {.model = model, .v_m_s = model->start_m_s};
    swim.v_by[BY_START] = 1;
    if (by_w != NULL) {
        memset(by_w, 0, (beats * parts + 1) * beats * sizeof *by_w);
        swim.x_by_w = by_w;
        swim.v_by_w = v_by_w;
        swim.wake_by_w = wake_by_w;
    }
    note(&swim, 0, distance_m, by_model);
    const double part_s = model->beat_s / (double)parts;
    const double whole = floor(model->delay_s / model->beat_s);
    const double switch_s = model->delay_s - whole * model->beat_s;
    const ptrdiff_t late = whole < (double)beats ? (ptrdiff_t)whole : (ptrdiff_t)beats;
    for (size_t row = 1; row <= beats * parts; row++) {
        const size_t part = (row - 1) % parts;
        const ptrdiff_t now = (ptrdiff_t)((row - 1) / parts) - late;
        const double begin_s = (double)part * part_s;
        if (by_w != NULL) {
            memcpy(by_w + row * beats, by_w + (row - 1) * beats, beats * sizeof *by_w);
            swim.x_by_w = by_w + row * beats;
        }
        if (switch_s >= begin_s && switch_s < begin_s + part_s) {
            advance(&swim, w, now - 1, switch_s - begin_s);
            switched_later(&swim, now >= 1 ? w[now - 1] : 0, now >= 0 ? w[now] : 0);
            advance(&swim, w, now, begin_s + part_s - switch_s);
        } else {
            advance(&swim, w, switch_s < begin_s ? now : now - 1, part_s);
        }
        note(&swim, row, distance_m, by_model);
    }
    return true;
}
