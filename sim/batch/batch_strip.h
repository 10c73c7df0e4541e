/*
 * The frames and pictures of batch_lanes.c for one set of instructions: STRIP_TARGET, with vectors
 * of STRIP_WIDTH doubles and STRIP_SQRT, STRIP_MIN, STRIP_MAX of them. A strip of lanes goes
 * through a whole frame within registers. Every value is computed by the same operations in the
 * same order as for one fish: only what no lane needs is left out.
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
#define STRIPS 2
#define EACH_STRIP(l) for (unsigned l = 0; l < BATCH_LANES; l += STRIP_WIDTH)

/* Where |first|, |a|, elsewhere |b|. */
STRIP_INLINE VEC OF(choice)(BITS first, VEC a, VEC b) {
    return (VEC)(((BITS)a & first) | ((BITS)b & ~first));
}

/* What a frame of a strip is computed with, and from substep to substep. */
typedef struct {
    VEC begin, moves, lags, most, settle; /* servo */
    VEC dead_zone, slope, bend;
    VEC servo, ripple, thrust, square;
} OF(tail_t);

typedef struct {
    VEC kt, delay_fraction;
    VEC v, vv, way, late, z2_most, vkt_most;
} OF(water_t);

STRIP_INLINE VEC OF(thrust)(const OF(tail_t) * tail, VEC amplitude) {
    const VEC none = {0};
    const VEC beyond = STRIP_MAX(amplitude - tail->dead_zone, none);
    const VEC vss = STRIP_MAX(tail->slope * beyond + tail->bend * beyond * beyond, none);
    return vss * vss;
}

/* servo_frame of tail.c, a substep of it, in two halves: a root takes long. */
STRIP_INLINE void OF(servo_moves)(OF(tail_t) * tail, double to_amplitude, double steps) {
    const VEC behind = tail->begin + tail->moves * steps - tail->lags;
    VEC moved = tail->settle * (behind - tail->servo) + tail->moves;
    moved = STRIP_MIN(tail->most, moved);
    moved = STRIP_MAX(-tail->most, moved);
    const VEC middle = tail->servo + 0.5 * moved;
    const VEC cosine = moved * to_amplitude;
    tail->square = middle * middle + cosine * cosine;
    tail->ripple = 2 * cosine * cosine / tail->square;
    tail->thrust = STRIP_SQRT(tail->square);
    tail->servo += moved;
}

STRIP_INLINE void OF(servo_pushes)(OF(tail_t) * tail) {
    const BITS swings = (BITS)(tail->square > STILL_RAD * STILL_RAD);
    tail->ripple = OF(choice)(swings, tail->ripple, 1.0 - (VEC){0});
    tail->thrust = OF(thrust)(tail, tail->thrust);
}

STRIP_INLINE void OF(begin_servo)(OF(tail_t) * tail, const batch_block_t *b, unsigned l,
                                  double sine, double next_sine) {
    const double h = b->frame_s / SUBSTEPS;
    const VEC begin = LOOK(b->amplitude_rad) * sine;
    const VEC slope = (LOOK(b->amplitude_rad) * next_sine - begin) / b->frame_s;
    tail->begin = begin;
    tail->moves = slope * h;
    tail->lags = slope * LOOK(b->lag_s);
    tail->most = LOOK(b->most_rad);
    tail->settle = 1 - LOOK(b->keep);
    tail->servo = LOOK(b->servo_rad);
}

/* The thrust that a substep gets, of |rows| or, when every lane has a delay of its own, of the
 * ring. */
STRIP_INLINE VEC OF(delayed)(const batch_block_t *b, const strip_rows_t *rows, unsigned i,
                             unsigned l) {
    if (b->same_delay) {
        return LOOK(rows->late[i]);
    }
    VEC late = {0};
    for (unsigned lane = 0; lane < STRIP_WIDTH; lane++) {
        const uint64_t step = b->step + i - b->delay_steps[l + lane];
        late[lane] = b->thrust[step & b->ring_mask][l + lane];
    }
    return late;
}

/* tank_step with drag_series; the thrust one substep earlier still is the one read before. */
STRIP_INLINE void OF(water_step)(OF(water_t) * water, VEC late, bool whole, VEC ripple, double dt) {
    VEC mixed = late;
    if (!whole) {
        mixed += water->delay_fraction * (water->late - late);
    }
    const VEC h = mixed * ripple;
    const VEC kt = water->kt;
    const VEC z2 = h * kt * kt;
    const VEC v = water->v;
    water->late = late;
    water->z2_most = STRIP_MAX(z2, water->z2_most);
    water->vkt_most = STRIP_MAX(v * kt, water->vkt_most);
    const VEC tau = kt * (1.0 - z2 * (1.0 / 3.0 - z2 * (2.0 / 15.0)));
    const VEC next = (v + h * tau) / (1.0 + v * tau);
    const VEC vv = next * next;
    water->way += dt * (0.5 * (v + next) + kt * (vv - water->vv) * (1.0 / 12.0));
    water->v = next;
    water->vv = vv;
}

STRIP_INLINE void OF(begin_water)(OF(water_t) * water, const batch_block_t *b, unsigned l,
                                  double dt) {
    water->kt = LOOK(b->kappa_per_m) * dt;
    water->delay_fraction = LOOK(b->delay_fraction);
    water->v = LOOK(b->v_m_s);
    water->vv = water->v * water->v;
    water->way = LOOK(b->way_m);
    water->late = LOOK(b->late);
    water->z2_most = LOOK(b->z2_most);
    water->vkt_most = LOOK(b->vkt_most);
}

STRIP_INLINE void OF(keep_water)(const OF(water_t) * water, batch_block_t *b, unsigned l) {
    AT(b->v_m_s) = water->v;
    AT(b->way_m) = water->way;
    AT(b->late) = water->late;
    AT(b->z2_most) = water->z2_most;
    AT(b->vkt_most) = water->vkt_most;
}

/* How far the head has swayed along the tank with its tail, by the end of the frame. */
STRIP_INLINE void OF(sway)(batch_block_t *b, unsigned l, double next_sine) {
    VEC tail_rad = LOOK(b->amplitude_rad) * next_sine;
    if (b->has_servo) {
        tail_rad = LOOK(b->servo_rad);
    }
    AT(b->swayed_m[0]) = LOOK(b->swayed_m[1]);
    AT(b->swayed_m[1]) = LOOK(b->sway_m_per_rad) * tail_rad;
}

STRIP_INLINE void OF(begin_tail)(OF(tail_t) * tail, const batch_block_t *b, unsigned l, double sine,
                                 double next_sine, bool has_servo) {
    tail->dead_zone = LOOK(b->dead_zone_rad);
    tail->slope = LOOK(b->slope);
    tail->bend = LOOK(b->bend);
    if (has_servo) {
        OF(begin_servo)(tail, b, l, sine, next_sine);
    } else {
        tail->thrust = OF(thrust)(tail, LOOK(b->amplitude_rad));
    }
}

/* |i|: of the points of the frame. */
STRIP_INLINE void OF(trace)(batch_block_t *b, const OF(water_t) * water, unsigned l, unsigned i) {
    AT(b->trace_v_m_s[i]) = water->v;
    AT(b->trace_way_m[i]) = water->way;
}

#define EACH_BESIDE(l) for (unsigned p = 0, l = first; p < STRIPS; p++, l += STRIP_WIDTH)

/* STRIPS strips beside each other, so that none waits for its own roots and quotients. */
STRIP_INLINE void OF(strips_frame)(batch_block_t *b, const strip_rows_t *rows, unsigned first,
                                   double sine, double next_sine, const double *ripple,
                                   bool has_servo, bool traced) {
    const double dt = b->frame_s / SUBSTEPS;
    const double to_amplitude = 1 / (dt * b->omega_rad_s);
    OF(tail_t) tail[STRIPS];
    OF(water_t) water[STRIPS];
    EACH_BESIDE(l) {
        OF(begin_tail)(&tail[p], b, l, sine, next_sine, has_servo);
        OF(begin_water)(&water[p], b, l, dt);
        if (traced) {
            OF(trace)(b, &water[p], l, 0);
        }
    }
    for (unsigned i = 0; i < SUBSTEPS; i++) {
        if (has_servo) {
            EACH_BESIDE(l) { OF(servo_moves)(&tail[p], to_amplitude, (double)i); }
            EACH_BESIDE(l) { OF(servo_pushes)(&tail[p]); }
        } else {
            EACH_BESIDE(l) { tail[p].ripple = ripple[i] - (VEC){0}; }
        }
        EACH_BESIDE(l) {
            AT(rows->now[i]) = tail[p].thrust;
            const VEC late = OF(delayed)(b, rows, i, l);
            OF(water_step)(&water[p], late, b->whole_delay, tail[p].ripple, dt);
            if (traced) {
                OF(trace)(b, &water[p], l, i + 1);
            }
        }
    }
    EACH_BESIDE(l) {
        if (has_servo) {
            AT(b->servo_rad) = tail[p].servo;
        }
        OF(keep_water)(&water[p], b, l);
        if (b->sways) {
            OF(sway)(b, l, next_sine);
        }
    }
}

STRIP_TARGET static void OF(frame)(batch_block_t *b, double sine, double next_sine,
                                   const double ripple[SUBSTEPS]) {
    const strip_rows_t rows = strip_rows(b);
    for (unsigned l = 0; l < BATCH_LANES; l += STRIPS * STRIP_WIDTH) {
        if (!b->has_servo) {
            OF(strips_frame)(b, &rows, l, sine, next_sine, ripple, false, true);
        } else if (b->traced) {
            OF(strips_frame)(b, &rows, l, sine, next_sine, ripple, true, true);
        } else {
            OF(strips_frame)(b, &rows, l, sine, next_sine, ripple, true, false);
        }
    }
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

/* noise_normal_of. */
STRIP_INLINE VEC OF(normal)(BITS coins) {
    const BITS dither = OF(mix)(coins + NOISE_GOLDEN);
    const VEC triangle =
        OF(real)(dither & UINT32_MAX) * 0x1p-32 + OF(real)(dither >> 32) * 0x1p-32 - 1.0;
    return ((OF(real)(OF(ones)(coins)) - 32.0) + triangle) * NOISE_INVERSE_SIGMA;
}

/* Cubic through position and speed at both ends of a substep, as fish_at; then the noise. */
STRIP_INLINE VEC OF(position)(const batch_block_t *b, const batch_picture_t *p, unsigned l) {
    const VEC x0 = LOOK(b->trace_way_m[p->substep]), x1 = LOOK(b->trace_way_m[p->substep + 1]);
    const VEC v0 = LOOK(b->trace_v_m_s[p->substep]), v1 = LOOK(b->trace_v_m_s[p->substep + 1]);
    const double u = p->part, w = 1 - u;
    const double dt = b->frame_s / SUBSTEPS, part = (p->substep + p->part) / SUBSTEPS;
    const VEC way =
        x0 * w * w * (1 + 2 * u) + x1 * u * u * (3 - 2 * u) + u * w * (w * v0 * dt - u * v1 * dt);
    const uint64_t draw = (2 * p->sample + 1u) * NOISE_GOLDEN;
    const VEC noise = OF(normal)(OF(mix)(LOOK_BITS(b->noise_key) + draw));
    const VEC from = LOOK(b->swayed_m[0]);
    const VEC swayed = from + part * (LOOK(b->swayed_m[1]) - from);
    const VEC along = LOOK(b->base_m) + way + LOOK(b->flow_m_s) * p->in_beat_s;
    return LOOK(b->ahead) * along - swayed + LOOK(b->noise_m) * noise;
}

STRIP_INLINE void OF(add_all)(batch_window_t *w, unsigned l, double t, VEC x) {
    const VEC dx = x - LOOK(w->offset_m);
    AT(w->sx) += dx;
    AT(w->stx) += t * dx;
    AT(w->sxx) += dx * dx;
    AT(w->n) += 1;
    AT(w->st) += t;
    AT(w->stt) += t * t;
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
    double t[2];
    for (unsigned i = 0; i < 2; i++) {
        t[i] = p->time_s - b->window[i].begin_s - b->half_window_s;
    }
    EACH_STRIP(l) {
        const VEC x = OF(position)(b, p, l);
        const BITS lost = b->lossy ? OF(lost)(b, p->sample, l) : (BITS){0};
        for (unsigned i = 0; i < 2; i++) {
            if (b->window[i].open && b->lossy) {
                OF(add_seen)(&b->window[i], l, t[i], x, lost);
            } else if (b->window[i].open) {
                OF(add_all)(&b->window[i], l, t[i], x);
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
#undef STRIP_SQRT
#undef STRIP_MIN
#undef STRIP_MAX
