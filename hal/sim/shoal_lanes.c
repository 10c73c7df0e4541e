#include "shoal_lanes.h"

#include "drag_step.h"
#include "noise_inline.h"

#include <math.h>

#define STILL_RAD 1e-6
#define MISSING_MAX 5.0
#define SIGMA_MIN_M_S 1e-5

#define EACH_LANE(l) for (unsigned l = 0; l < SHOAL_LANES; l++)
#define INLINE static inline __attribute__((always_inline))

/* servo_frame of tail.c; fills ripple and this frame's thrust. */
INLINE void servo_frame(shoal_block_t *b, double sine, double next_sine) {
    const double h = b->frame_s / SUBSTEPS;
    const double to_amplitude = 1 / (h * b->omega_rad_s);
    shoal_row_t moves, lags, from;
    EACH_LANE(l) {
        const double begin = b->amplitude_rad[l] * sine;
        const double slope = (b->amplitude_rad[l] * next_sine - begin) / b->frame_s;
        from[l] = begin;
        moves[l] = slope * h;
        lags[l] = slope * b->lag_s[l];
    }
    for (unsigned i = 0; i < SUBSTEPS; i++) {
        double *restrict thrust = b->thrust[(b->step + i) & b->ring_mask];
        const double steps = i;
        EACH_LANE(l) {
            const double behind = from[l] + moves[l] * steps - lags[l];
            const double most = b->most_rad[l];
            double moved = (1 - b->keep[l]) * (behind - b->servo_rad[l]) + moves[l];
            moved = moved > most ? most : moved;
            moved = moved < -most ? -most : moved;
            const double middle = b->servo_rad[l] + 0.5 * moved;
            const double cosine = moved * to_amplitude;
            const double square = middle * middle + cosine * cosine;
            const double ripple = 2 * cosine * cosine / square;
            b->ripple[i][l] = square > STILL_RAD * STILL_RAD ? ripple : 1.0;
            thrust[l] = tank_thrust(sqrt(square), b->dead_zone_rad[l], b->slope[l], b->bend[l]);
            b->servo_rad[l] += moved;
        }
    }
}

INLINE void table_frame(shoal_block_t *b, const double ripple[SUBSTEPS]) {
    for (unsigned i = 0; i < SUBSTEPS; i++) {
        double *restrict thrust = b->thrust[(b->step + i) & b->ring_mask];
        EACH_LANE(l) {
            b->ripple[i][l] = ripple[i];
            thrust[l] =
                tank_thrust(b->amplitude_rad[l], b->dead_zone_rad[l], b->slope[l], b->bend[l]);
        }
    }
}

INLINE void delayed(const shoal_block_t *b, uint64_t step, double *restrict late) {
    if (b->same_delay) {
        const double *thrust = b->thrust[(step - b->delay_steps[0]) & b->ring_mask];
        EACH_LANE(l) { late[l] = thrust[l]; }
    } else {
        const double *thrust = b->thrust[0];
        EACH_LANE(l) {
            late[l] = thrust[((step - b->delay_steps[l]) & b->ring_mask) * SHOAL_LANES + l];
        }
    }
}

/* tank_step; the thrust one substep earlier still is the one read before. */
INLINE void water_step(shoal_block_t *b, unsigned i) {
    const double dt = b->frame_s / SUBSTEPS;
    shoal_row_t late;
    delayed(b, b->step + i, late);
    EACH_LANE(l) {
        const double mixed = late[l] + b->delay_fraction[l] * (b->late[l] - late[l]);
        const double h = mixed * b->ripple[i][l];
        const double kt = b->kappa_per_m[l] * dt;
        const double z2 = h * kt * kt;
        double v = b->v_m_s[l];
        const double vkt = v * kt;
        b->late[l] = late[l];
        b->z2_most[l] = z2 > b->z2_most[l] ? z2 : b->z2_most[l];
        b->vkt_most[l] = vkt > b->vkt_most[l] ? vkt : b->vkt_most[l];
        b->way_m[l] += drag_series(&v, h, kt, z2, dt);
        b->v_m_s[l] = v;
        b->trace_v_m_s[i + 1][l] = v;
        b->trace_way_m[i + 1][l] = b->way_m[l];
    }
}

INLINE void frame_on(shoal_block_t *b, double sine, double next_sine,
                     const double ripple[SUBSTEPS]) {
    EACH_LANE(l) {
        b->trace_v_m_s[0][l] = b->v_m_s[l];
        b->trace_way_m[0][l] = b->way_m[l];
    }
    if (b->has_servo) {
        servo_frame(b, sine, next_sine);
    } else {
        table_frame(b, ripple);
    }
    for (unsigned i = 0; i < SUBSTEPS; i++) {
        water_step(b, i);
    }
    b->step += SUBSTEPS;
}

/* Cubic through position and speed at both ends of a substep, as fish_at; then the noise. */
INLINE void positions(const shoal_block_t *b, const shoal_picture_t *p, double *restrict x) {
    const double *x0 = b->trace_way_m[p->substep], *x1 = b->trace_way_m[p->substep + 1];
    const double *v0 = b->trace_v_m_s[p->substep], *v1 = b->trace_v_m_s[p->substep + 1];
    const double u = p->part, w = 1 - u;
    const double dt = b->frame_s / SUBSTEPS, part = (p->substep + p->part) / SUBSTEPS;
    EACH_LANE(l) {
        const double way = x0[l] * w * w * (1 + 2 * u) + x1[l] * u * u * (3 - 2 * u) +
                           u * w * (w * v0[l] * dt - u * v1[l] * dt);
        const double noise = noise_normal_of(noise_bits(b->noise_key[l], 2 * p->sample));
        const double swayed = b->swayed_m[0][l] + part * (b->swayed_m[1][l] - b->swayed_m[0][l]);
        const double along = b->base_m[l] + way + b->flow_m_s[l] * p->in_beat_s;
        x[l] = b->ahead[l] * along - swayed + b->noise_m[l] * noise;
    }
}

/* noise_uniform(...) < camera_lost, in whole numbers. */
INLINE void seen(const shoal_block_t *b, uint64_t sample, double *restrict there) {
    EACH_LANE(l) {
        const int64_t draw = (int64_t)(noise_bits(b->lost_key[l], sample) >> 11);
        there[l] = draw < (int64_t)b->lost_below[l] ? 0.0 : 1.0;
    }
}

INLINE void add_all(shoal_window_t *restrict w, double t, const double *restrict x) {
    EACH_LANE(l) {
        const double dx = x[l] - w->offset_m[l];
        w->sx[l] += dx;
        w->stx[l] += t * dx;
        w->sxx[l] += dx * dx;
        w->n[l] += 1;
        w->st[l] += t;
        w->stt[l] += t * t;
    }
}

INLINE void add_seen(shoal_window_t *restrict w, double t, const double *restrict x,
                     const double *restrict there) {
    EACH_LANE(l) {
        const double one = there[l];
        const double dx = one * (x[l] - w->offset_m[l]);
        const double missing = one > 0 ? 0.0 : w->missing[l] + 1;
        w->sx[l] += dx;
        w->stx[l] += t * dx;
        w->sxx[l] += dx * dx;
        w->n[l] += one;
        w->st[l] += one * t;
        w->stt[l] += one * t * t;
        w->missing[l] = missing;
        w->missing_max[l] = missing > w->missing_max[l] ? missing : w->missing_max[l];
    }
}

INLINE void picture_on(shoal_block_t *b, const shoal_picture_t *p) {
    shoal_row_t x, there;
    positions(b, p, x);
    if (b->lossy) {
        seen(b, p->sample, there);
    }
    for (unsigned i = 0; i < 2; i++) {
        shoal_window_t *w = &b->window[i];
        if (!w->open) {
            continue;
        }
        const double t = p->time_s - w->begin_s - b->half_window_s;
        if (b->lossy) {
            add_seen(w, t, x, there);
        } else {
            add_all(w, t, x);
        }
    }
}

INLINE void fit_on(shoal_block_t *b, const shoal_window_t *w) {
    const double least = b->pictures_min;
    EACH_LANE(l) {
        const double n = w->n[l];
        const double vtt = w->stt[l] - w->st[l] * w->st[l] / n;
        const double vtx = w->stx[l] - w->st[l] * w->sx[l] / n;
        const double speed = vtx / vtt;
        const double rest = w->sxx[l] - w->sx[l] * w->sx[l] / n - speed * vtx;
        const double sigma = sqrt((rest > 0 ? rest : 0) / (n - 2) / vtt);
        const double least_sigma = sigma > SIGMA_MIN_M_S ? sigma : SIGMA_MIN_M_S;
        const bool enough = (n >= least) & (w->missing_max[l] <= MISSING_MAX);
        b->speed_m_s[l] = enough ? speed : (double)NAN;
        b->sigma_m_s[l] = enough ? least_sigma : (double)NAN;
    }
}

#define LANES_ON(label, set)                                                                       \
    set static void frame_##label(shoal_block_t *b, double s, double n, const double *r) {         \
        frame_on(b, s, n, r);                                                                      \
    }                                                                                              \
    set static void picture_##label(shoal_block_t *b, const shoal_picture_t *p) {                  \
        picture_on(b, p);                                                                          \
    }                                                                                              \
    set static void fit_##label(shoal_block_t *b, const shoal_window_t *w) { fit_on(b, w); }       \
    static const shoal_lanes_t label = {#label, frame_##label, picture_##label, fit_##label};

LANES_ON(plain, )

#if defined(__x86_64__)

LANES_ON(avx2, __attribute__((target("avx2"))))
LANES_ON(avx512, __attribute__((target("avx512f,avx512dq,avx512vl"))))

static bool has_avx512(void) {
    return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
           __builtin_cpu_supports("avx512vl");
}

const shoal_lanes_t *shoal_lanes(size_t index) {
    __builtin_cpu_init();
    const bool avx2_there = __builtin_cpu_supports("avx2") != 0;
    const shoal_lanes_t *const has[] = {&plain, avx2_there ? &avx2 : NULL,
                                        avx2_there && has_avx512() ? &avx512 : NULL};
    return index < sizeof has / sizeof *has ? has[index] : NULL;
}

#else

const shoal_lanes_t *shoal_lanes(size_t index) { return index == 0 ? &plain : NULL; }

#endif
