/*
 * A picture of all fish, for batch_strip.h, included with it for each set: where they are, the
 * camera's noise, and the sums of the lines through the pictures of each beat.
 */

#define EACH_OF_GROUP(p) _Pragma("GCC unroll 4") for (unsigned p = 0; p < GROUP; p++)

/* A whole number below 2^52, exactly. */
STRIP_INLINE VEC OF(real)(BITS whole) { return (VEC)(whole | 0x4330000000000000u) - 0x1p52; }

/* noise_mix. */
STRIP_INLINE void OF(mix)(BITS z[GROUP]) {
    EACH_OF_GROUP(p) { z[p] = (z[p] ^ (z[p] >> 30)) * 0xBF58476D1CE4E5B9u; }
    EACH_OF_GROUP(p) { z[p] = (z[p] ^ (z[p] >> 27)) * 0x94D049BB133111EBu; }
    EACH_OF_GROUP(p) { z[p] ^= z[p] >> 31; }
}

/* noise_ones, its bytes added up without a multiplication. */
STRIP_INLINE BITS OF(ones)(BITS x) {
    x -= (x >> 1) & 0x5555555555555555u;
    x = (x & 0x3333333333333333u) + ((x >> 2) & 0x3333333333333333u);
    x = (x + (x >> 4)) & 0x0F0F0F0F0F0F0F0Fu;
    x += x >> 8;
    x += x >> 16;
    return (x + (x >> 32)) & 0xFFu;
}

/* noise_normal_of: the same sum as a whole number of 2^-32. */
STRIP_INLINE void OF(normal)(const BITS coins[GROUP], VEC normal[GROUP]) {
    BITS dither[GROUP];
    EACH_OF_GROUP(p) { dither[p] = coins[p] + NOISE_GOLDEN; }
    OF(mix)(dither);
    EACH_OF_GROUP(p) {
        const BITS ones = STRIP_ONES(coins[p]) << 32;
        const BITS parts = (dither[p] & UINT32_MAX) + (dither[p] >> 32) + ones;
        normal[p] = (OF(real)(parts) * 0x1p-32 - 33.0) * NOISE_INVERSE_SIGMA;
    }
}

/* What a picture is computed with in every lane. */
typedef struct {
    unsigned before;            /* point of the frame */
    double way0, way1, v0, v1;  /* weights of way and speed there */
    double sum, sum_v0, sum_v1; /* likewise, when the way is drag_way */
    double in_beat_s, in_frame_s;
    double part; /* of the frame */
    uint64_t draw;
    double t[2]; /* in the windows */
} OF(view_t);

/* Cubic through position and speed at both ends of a substep, as fish_at. With drag_way put in for
 * both ways, of which the later sum is the earlier one plus the later speed, few products are left.
 */
STRIP_INLINE OF(view_t) OF(view)(const batch_block_t *b, const batch_picture_t *p) {
    const double dt = b->frame_s / SUBSTEPS;
    const double u = p->part, w = 1 - u;
    const double way0 = w * w * (1 + 2 * u), way1 = u * u * (3 - 2 * u);
    const double v0 = u * w * w * dt, v1 = u * u * w * dt;
    const double part = (p->substep + p->part) / SUBSTEPS;
    return (OF(view_t)){
        .before = p->substep,
        .way0 = way0,
        .way1 = way1,
        .v0 = v0,
        .v1 = v1,
        .sum = dt,
        .sum_v0 = v0 - 0.5 * dt * way0,
        .sum_v1 = 0.5 * dt * way1 - v1,
        .in_beat_s = p->in_beat_s,
        .in_frame_s = part * b->frame_s,
        .part = part,
        .draw = (2 * p->sample + 1u) * NOISE_GOLDEN,
        .t = {p->time_s - b->window[0].begin_s - b->half_window_s,
              p->time_s - b->window[1].begin_s - b->half_window_s},
    };
}

STRIP_INLINE VEC OF(way_seen)(const batch_block_t *b, const OF(view_t) * see, unsigned l,
                              bool summed) {
    const VEC v0 = LOOK(b->v_m_s[see->before]), v1 = LOOK(b->v_m_s[see->before + 1]);
    if (summed) {
        const VEC twelfth = LOOK(b->twelfth);
        return see->sum * LOOK(b->sum_m_s[see->before]) +
               v0 * (see->way0 * twelfth * v0 + see->sum_v0) +
               v1 * (see->way1 * twelfth * v1 + see->sum_v1);
    }
    return see->way0 * LOOK(b->way_m[see->before]) + see->way1 * LOOK(b->way_m[see->before + 1]) +
           see->v0 * v0 - see->v1 * v1;
}

/* Of the fish's mark, along the tank. */
STRIP_INLINE VEC OF(position)(const batch_block_t *b, const OF(view_t) * see, unsigned l,
                              bool summed, bool drifts) {
    const VEC from_rad = LOOK(b->tail_rad[0]);
    const VEC tail_rad = from_rad + see->part * (LOOK(b->tail_rad[1]) - from_rad);
    VEC along =
        LOOK(b->base_m) + OF(way_seen)(b, see, l, summed) + LOOK(b->flow_m_s) * see->in_beat_s;
    if (drifts) {
        along += LOOK(b->drifted_m) + LOOK(b->drift_m_s) * see->in_frame_s;
    }
    return LOOK(b->ahead) * along - LOOK(b->sway_m_per_rad) * tail_rad;
}

/* As the camera measures them. */
STRIP_INLINE void OF(measure)(const batch_block_t *b, const OF(view_t) * see, unsigned first,
                              VEC x_m[GROUP], bool summed, bool drifts) {
    BITS coins[GROUP];
    VEC noise[GROUP];
    EACH_OF_GROUP(p) {
        const unsigned l = first + p * STRIP_WIDTH;
        coins[p] = LOOK_BITS(b->noise_key) + see->draw;
    }
    OF(mix)(coins);
    OF(normal)(coins, noise);
    EACH_OF_GROUP(p) {
        const unsigned l = first + p * STRIP_WIDTH;
        x_m[p] = OF(position)(b, see, l, summed, drifts) + LOOK(b->noise_m) * noise[p];
    }
}

/* What all lanes have in common is in count_picture. */
STRIP_INLINE void OF(add_all)(batch_window_t *w, unsigned l, double t, VEC x) {
    const VEC dx = x - LOOK(w->offset_m);
    AT(w->sx) += dx;
    AT(w->stx) += t * dx;
    AT(w->sxx) += dx * dx;
}

/* |lost|: all bits of a lane whose picture is missing. */
STRIP_INLINE void OF(add_seen)(batch_window_t *w, unsigned l, double t, VEC x, BITS lost) {
    const VEC one = (VEC)((BITS)(1.0 - (VEC){0}) & ~lost);
    const VEC dx = one * (x - LOOK(w->offset_m));
    const VEC missing = (VEC)((BITS)(LOOK(w->missing) + 1) & lost);
    AT(w->sx) += dx;
    AT(w->stx) += t * dx;
    AT(w->sxx) += dx * dx;
    AT(w->n) += one;
    AT(w->st) += one * t;
    AT(w->stt) += one * t * t;
    AT(w->missing) = missing;
    AT(w->missing_max) = STRIP_MAX(missing, LOOK(w->missing_max));
}

/* noise_uniform(...) < camera_lost, in whole numbers. */
STRIP_INLINE void OF(find_lost)(const batch_block_t *b, uint64_t sample, unsigned first,
                                BITS lost[GROUP]) {
    EACH_OF_GROUP(p) {
        const unsigned l = first + p * STRIP_WIDTH;
        lost[p] = LOOK_BITS(b->lost_key) + (sample + 1u) * NOISE_GOLDEN;
    }
    OF(mix)(lost);
    EACH_OF_GROUP(p) {
        const unsigned l = first + p * STRIP_WIDTH;
        lost[p] = (BITS)(lost[p] >> 11 < LOOK_BITS(b->lost_below));
    }
}

/* |lost|: NULL when nothing can be. */
STRIP_INLINE void OF(add)(batch_window_t *w, unsigned first, double t, const VEC x_m[GROUP],
                          const BITS *lost) {
    EACH_OF_GROUP(p) {
        const unsigned l = first + p * STRIP_WIDTH;
        if (lost != NULL) {
            OF(add_seen)(w, l, t, x_m[p], lost[p]);
        } else {
            OF(add_all)(w, l, t, x_m[p]);
        }
    }
}

STRIP_INLINE void OF(picture_so)(batch_block_t *b, const batch_picture_t *p, bool summed,
                                 bool drifts) {
    const OF(view_t) see = OF(view)(b, p);
    for (unsigned i = 0; i < 2 && !b->lossy; i++) {
        count_picture(&b->window[i], see.t[i]);
    }
    for (unsigned first = 0; first < b->lanes; first += GROUP_LANES) {
        VEC x_m[GROUP];
        BITS lost[GROUP] = {{0}};
        OF(measure)(b, &see, first, x_m, summed, drifts);
        if (b->lossy) {
            OF(find_lost)(b, p->sample, first, lost);
        }
        for (unsigned i = 0; i < 2; i++) {
            if (b->window[i].open) {
                OF(add)(&b->window[i], first, see.t[i], x_m, b->lossy ? lost : NULL);
            }
        }
    }
}

STRIP_TARGET static void OF(picture)(batch_block_t *b, const batch_picture_t *p) {
    if (b->summed && !b->drifts) {
        OF(picture_so)(b, p, true, false);
    } else {
        OF(picture_so)(b, p, b->summed, b->drifts);
    }
}

#undef EACH_OF_GROUP
