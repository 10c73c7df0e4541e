/*
 * The frames and pictures of batch_lanes.c for one set of instructions: STRIP_TARGET, with vectors
 * of STRIP_WIDTH doubles and STRIP_SQRT, STRIP_MIN, STRIP_MAX, STRIP_ABOVE, STRIP_ONES of them. The
 * tails of some strips of lanes, and then their water, go through a frame within registers. Every
 * value has the bits that it has for one fish: only what no lane needs is left out, and scales by
 * powers of two.
 *
 * Included once for each set, hence no guard.
 */
#define STRIP_GLUED(name, label) name##_##label
#define STRIP_NAMED(name, label) STRIP_GLUED(name, label)
#define OF(name) STRIP_NAMED(name, STRIP_LABEL)
#define STRIP_INLINE STRIP_TARGET static inline __attribute__((always_inline))

typedef double OF(vec_t)
    __attribute__((vector_size(8 * STRIP_WIDTH), aligned(8 * STRIP_WIDTH), may_alias));
typedef uint64_t OF(bits_t)
    __attribute__((vector_size(8 * STRIP_WIDTH), aligned(8 * STRIP_WIDTH), may_alias));
#define VEC OF(vec_t)
#define BITS OF(bits_t)
/* |row| from lane |l| on. */
#define AT(row) (*(VEC *)&(row)[l])
#define LOOK(row) (*(const VEC *)&(row)[l])
#define LOOK_BITS(row) (*(const BITS *)&(row)[l])
/* So many beside each other that none waits for its own roots and quotients. */
#define STRIPS 2
#define EACH_BESIDE(l) for (unsigned p = 0, l = first; p < STRIPS; p++, l += STRIP_WIDTH)
#define EACH_STRIP(l) for (unsigned l = 0; l < BATCH_LANES; l += STRIP_WIDTH)

/* Where |first|, |a|, elsewhere |b|. */
STRIP_INLINE VEC OF(choice)(BITS first, VEC a, VEC b) {
    return (VEC)(((BITS)a & first) | ((BITS)b & ~first));
}

/* From substep to substep. */
typedef struct {
    VEC move, most, settle;
    VEC target, servo;
} OF(tail_t);

typedef struct {
    VEC kt, kt_fifteenth, delay_fraction;
    VEC v, sum, late, late_most;
} OF(water_t);

/* tank_thrust of |twice| the amplitude; without a bend, it is never negative. */
STRIP_INLINE VEC OF(thrust)(const batch_block_t *b, unsigned l, VEC twice, bool bends) {
    const VEC none = {0};
    const VEC beyond = STRIP_MAX(twice - LOOK(b->twice_dead_zone_rad), none);
    VEC vss = LOOK(b->half_slope) * beyond;
    if (bends) {
        vss = STRIP_MAX((LOOK(b->half_slope) + LOOK(b->quarter_bend) * beyond) * beyond, none);
    }
    return vss * vss;
}

/* servo_frame of tail.c: the begin, and one substep. */
STRIP_INLINE void OF(begin_tail)(OF(tail_t) * tail, const batch_block_t *b, unsigned l, double sine,
                                 double next_sine) {
    const VEC begin = LOOK(b->amplitude_rad) * sine;
    const VEC rise = LOOK(b->amplitude_rad) * next_sine - begin;
    tail->move = rise * (1.0 / SUBSTEPS);
    tail->most = LOOK(b->most_rad);
    tail->settle = LOOK(b->settle);
    tail->servo = LOOK(b->servo_rad);
    tail->target = begin + rise * LOOK(b->ahead_frames);
}

/* Returns twice the amplitude. */
STRIP_INLINE VEC OF(tail_step)(OF(tail_t) * tail, double to_amplitude, batch_block_t *b, unsigned i,
                               unsigned l) {
    VEC moved = tail->settle * (tail->target - tail->servo);
    moved = STRIP_MIN(tail->most, moved);
    moved = STRIP_MAX(-tail->most, moved);
    const VEC next = tail->servo + moved;
    const VEC middle = tail->servo + next;
    const VEC cosine = moved * to_amplitude;
    const VEC square = middle * middle + cosine * cosine;
    const VEC one = 1.0 - (VEC){0}, still = TWICE_STILL_2 - (VEC){0};
    AT(b->over_kt[i]) = STRIP_ABOVE(square, still, cosine * cosine, 0.5 * one) * LOOK(b->twice_kt);
    AT(b->under[i]) = STRIP_ABOVE(square, still, square, one);
    tail->target += tail->move;
    tail->servo = next;
    return STRIP_ABOVE(square, still, STRIP_SQRT(square), (VEC){0});
}

/* |bends|, and the other flags of the frames below, are constants where the code is compiled. */
STRIP_INLINE void OF(servo_frame)(batch_block_t *b, double sine, double next_sine, bool bends) {
    const double to_amplitude = 2 / (b->frame_s / SUBSTEPS * b->omega_rad_s);
    for (unsigned first = 0; first < BATCH_LANES; first += STRIPS * STRIP_WIDTH) {
        OF(tail_t) tail[STRIPS];
        EACH_BESIDE(l) { OF(begin_tail)(&tail[p], b, l, sine, next_sine); }
#pragma GCC unroll 4 /* SUBSTEPS */
        for (unsigned i = 0; i < SUBSTEPS; i++) {
            double *now = b->thrust[(b->step + i) & b->ring_mask];
            EACH_BESIDE(l) {
                const VEC twice = OF(tail_step)(&tail[p], to_amplitude, b, i, l);
                AT(now) = OF(thrust)(b, l, twice, bends);
            }
        }
        EACH_BESIDE(l) { AT(b->servo_rad) = tail[p].servo; }
    }
}

/* Without a servo. */
STRIP_INLINE void OF(table_frame)(batch_block_t *b, const double ripple[SUBSTEPS]) {
    EACH_STRIP(l) {
        const VEC thrust = OF(thrust)(b, l, 2 * LOOK(b->amplitude_rad), true);
        for (unsigned i = 0; i < SUBSTEPS; i++) {
            AT(b->thrust[(b->step + i) & b->ring_mask]) = thrust;
            AT(b->over_kt[i]) = ripple[i] * LOOK(b->kt);
            AT(b->under[i]) = 1.0 - (VEC){0};
        }
    }
}

/* tank_sum_step with drag_fraction; the thrust one substep earlier still is the one read before. */
STRIP_INLINE void OF(water_step)(OF(water_t) * water, const batch_block_t *b, unsigned i,
                                 unsigned l, VEC late, bool whole) {
    const VEC under = LOOK(b->under[i]);
    VEC mixed = late;
    if (!whole) {
        mixed += water->delay_fraction * (water->late - late);
        water->late = late;
    }
    water->late_most = STRIP_MAX(late, water->late_most);
    const VEC v = water->v;
    const VEC push = mixed * LOOK(b->over_kt[i]);
    const VEC fifteenth = push * water->kt_fifteenth;
    const VEC a = under + fifteenth;
    const VEC under_b = under * (a + 5.0 * fifteenth);
    water->v = (v * under_b + push * a) / (under_b + v * (under * water->kt * a));
    water->sum += water->v;
}

STRIP_INLINE void OF(begin_water)(OF(water_t) * water, const batch_block_t *b, unsigned l) {
    water->kt = LOOK(b->kt);
    water->kt_fifteenth = LOOK(b->kt_fifteenth);
    water->delay_fraction = LOOK(b->delay_fraction);
    water->v = LOOK(b->v_m_s);
    water->sum = LOOK(b->sum_m_s);
    water->late = LOOK(b->late);
    water->late_most = LOOK(b->late_most);
}

STRIP_INLINE void OF(keep_water)(const OF(water_t) * water, batch_block_t *b, unsigned l,
                                 bool whole) {
    AT(b->v_m_s) = water->v;
    AT(b->sum_m_s) = water->sum;
    AT(b->late_most) = water->late_most;
    if (!whole) {
        AT(b->late) = water->late;
    }
}

/* |i|: of the points of the frame. */
STRIP_INLINE void OF(trace)(batch_block_t *b, const OF(water_t) * water, unsigned l, unsigned i) {
    const double dt = b->frame_s / SUBSTEPS;
    if ((b->traced >> i & 1u) != 0) {
        const VEC v = water->v;
        const VEC way = dt * (water->sum - 0.5 * v) + LOOK(b->twelfth) * (v * v);
        AT(b->trace_v_m_s[i]) = v;
        AT(b->trace_way_m[i]) = way - LOOK(b->begin_m);
    }
}

STRIP_INLINE void OF(water_frame)(batch_block_t *b, bool whole, bool traced) {
    late_rows_t late;
    find_late(b, &late);
    for (unsigned first = 0; first < BATCH_LANES; first += STRIPS * STRIP_WIDTH) {
        OF(water_t) water[STRIPS];
        EACH_BESIDE(l) {
            OF(begin_water)(&water[p], b, l);
            if (traced) {
                OF(trace)(b, &water[p], l, 0);
            }
        }
#pragma GCC unroll 4 /* SUBSTEPS */
        for (unsigned i = 0; i < SUBSTEPS; i++) {
            EACH_BESIDE(l) {
                OF(water_step)(&water[p], b, i, l, LOOK(late.row[i]), whole);
                if (traced) {
                    OF(trace)(b, &water[p], l, i + 1);
                }
            }
        }
        EACH_BESIDE(l) { OF(keep_water)(&water[p], b, l, whole); }
    }
}

/* How far the heads have swayed along the tank with their tails, at one end of the frame. */
STRIP_INLINE void OF(sway)(batch_block_t *b, unsigned end, double sine) {
    if (b->sways && b->traced != 0) {
        EACH_STRIP(l) {
            VEC tail_rad = LOOK(b->amplitude_rad) * sine;
            if (b->has_servo) {
                tail_rad = LOOK(b->servo_rad);
            }
            AT(b->swayed_m[end]) = LOOK(b->sway_m_per_rad) * tail_rad;
        }
    }
}

/* First all tails, then all the water: in one loop over both, roots and quotients wait for each
 * other, which takes a tenth longer (AVX-512, Zen 4). */
STRIP_TARGET static void OF(frame)(batch_block_t *b, double sine, double next_sine,
                                   const double ripple[SUBSTEPS]) {
    OF(sway)(b, 0, sine);
    if (!b->has_servo) {
        OF(table_frame)(b, ripple);
    } else if (b->bends) {
        OF(servo_frame)(b, sine, next_sine, true);
    } else {
        OF(servo_frame)(b, sine, next_sine, false);
    }
    if (!b->whole_delay) {
        OF(water_frame)(b, false, true);
    } else if (b->traced != 0) {
        OF(water_frame)(b, true, true);
    } else {
        OF(water_frame)(b, true, false);
    }
    OF(sway)(b, 1, next_sine);
    b->step += SUBSTEPS;
}

/* A whole number below 2^52, exactly. */
STRIP_INLINE VEC OF(real)(BITS whole) { return (VEC)(whole | 0x4330000000000000u) - 0x1p52; }

STRIP_INLINE BITS OF(mix)(BITS z) {
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    return z ^ (z >> 31);
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
STRIP_INLINE VEC OF(normal)(BITS coins) {
    const BITS dither = OF(mix)(coins + NOISE_GOLDEN);
    const BITS parts = (dither & UINT32_MAX) + (dither >> 32) + (STRIP_ONES(coins) << 32);
    return (OF(real)(parts) * 0x1p-32 - 33.0) * NOISE_INVERSE_SIGMA;
}

/* What a picture is computed with in every lane. */
typedef struct {
    unsigned before, after; /* points of the frame */
    double x0, x1, v0, v1;  /* weights of place and speed there */
    double in_beat_s, part; /* |part|: of the frame */
    uint64_t draw;
    double t[2]; /* in the windows */
} OF(view_t);

/* Cubic through position and speed at both ends of a substep, as fish_at. */
STRIP_INLINE OF(view_t) OF(view)(const batch_block_t *b, const batch_picture_t *p) {
    const double u = p->part, w = 1 - u;
    const double uw_dt = u * w * b->frame_s / SUBSTEPS;
    return (OF(view_t)){
        .before = p->substep,
        .after = p->substep + 1,
        .x0 = w * w * (1 + 2 * u),
        .x1 = u * u * (3 - 2 * u),
        .v0 = uw_dt * w,
        .v1 = uw_dt * u,
        .in_beat_s = p->in_beat_s,
        .part = (p->substep + p->part) / SUBSTEPS,
        .draw = (2 * p->sample + 1u) * NOISE_GOLDEN,
        .t = {p->time_s - b->window[0].begin_s - b->half_window_s,
              p->time_s - b->window[1].begin_s - b->half_window_s},
    };
}

STRIP_INLINE VEC OF(position)(const batch_block_t *b, const OF(view_t) * see, unsigned l) {
    const VEC way =
        LOOK(b->trace_way_m[see->before]) * see->x0 + LOOK(b->trace_way_m[see->after]) * see->x1 +
        LOOK(b->trace_v_m_s[see->before]) * see->v0 - LOOK(b->trace_v_m_s[see->after]) * see->v1;
    const VEC noise = OF(normal)(OF(mix)(LOOK_BITS(b->noise_key) + see->draw));
    const VEC from = LOOK(b->swayed_m[0]);
    const VEC swayed = from + see->part * (LOOK(b->swayed_m[1]) - from);
    const VEC along = LOOK(b->base_m) + way + LOOK(b->flow_m_s) * see->in_beat_s;
    return LOOK(b->ahead) * along - swayed + LOOK(b->noise_m) * noise;
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
STRIP_INLINE BITS OF(lost)(const batch_block_t *b, uint64_t sample, unsigned l) {
    const BITS draw = OF(mix)(LOOK_BITS(b->lost_key) + (sample + 1u) * NOISE_GOLDEN) >> 11;
    return (BITS)(draw < LOOK_BITS(b->lost_below));
}

STRIP_TARGET static void OF(picture)(batch_block_t *b, const batch_picture_t *p) {
    const OF(view_t) see = OF(view)(b, p);
    for (unsigned i = 0; i < 2 && !b->lossy; i++) {
        count_picture(&b->window[i], see.t[i]);
    }
    EACH_STRIP(l) {
        const VEC x = OF(position)(b, &see, l);
        const BITS lost = b->lossy ? OF(lost)(b, p->sample, l) : (BITS){0};
        for (unsigned i = 0; i < 2; i++) {
            if (b->window[i].open && b->lossy) {
                OF(add_seen)(&b->window[i], l, see.t[i], x, lost);
            } else if (b->window[i].open) {
                OF(add_all)(&b->window[i], l, see.t[i], x);
            }
        }
    }
}

STRIP_TARGET static void OF(fit)(batch_block_t *b, const batch_window_t *w) { fit_on(b, w); }

static const batch_lanes_t STRIP_LABEL = {STRIP_TEXT, OF(frame), OF(picture), OF(fit)};

#undef EACH_STRIP
#undef EACH_BESIDE
#undef STRIPS
#undef LOOK_BITS
#undef LOOK
#undef AT
#undef BITS
#undef VEC
#undef STRIP_INLINE
#undef OF
#undef STRIP_NAMED
#undef STRIP_GLUED
#undef STRIP_LABEL
#undef STRIP_TEXT
#undef STRIP_TARGET
#undef STRIP_WIDTH
#undef STRIP_ABOVE
#undef STRIP_ONES
#undef STRIP_SQRT
#undef STRIP_MIN
#undef STRIP_MAX
