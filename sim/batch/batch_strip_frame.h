/*
 * A frame of the tails and of the water, for batch_strip.h, included with it for each set. A group
 * of strips goes through it within registers, two beside each other and two behind those.
 */

/* The water goes through a substep so many steps after the tail, which hides how long roots and
 * quotients take: 26.5 cycles for both (AVX-512, Zen 4), of which the divider is busy for 25. */
#define WATER_LAG 2u
#define STEPS (GROUP * SUBSTEPS)
#define LANE_OF(step) (((step) / (2 * SUBSTEPS) * 2 + (step) % 2) * STRIP_WIDTH)
#define SUBSTEP_OF(step) ((step) / 2 % SUBSTEPS)

/* From substep to substep. */
typedef struct {
    VEC move, most, settle;
    VEC target, servo;
} OF(tail_t);

typedef struct {
    VEC kt, kt_fifteenth, delay_fraction;
    VEC v, sum, late, late_most;
} OF(water_t);

/* Of the tail in one substep: twice the amplitude, and the ripple, twice as much of both as in
 * tail.c. */
typedef struct {
    VEC twice, over_kt, under;
} OF(swing_t);

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
STRIP_INLINE void OF(begin_tail)(OF(tail_t) * tail, batch_block_t *b, unsigned l,
                                 const batch_frame_t *frame) {
    const VEC begin = LOOK(b->amplitude_rad) * frame->sine;
    const VEC rise = LOOK(b->amplitude_rad) * frame->next_sine - begin;
    tail->move = rise * (1.0 / SUBSTEPS);
    tail->most = LOOK(b->most_rad);
    tail->settle = LOOK(b->settle);
    tail->servo = LOOK(b->tail_rad[1]);
    AT(b->tail_rad[0]) = tail->servo;
    tail->target = begin + rise * LOOK(b->ahead_frames);
}

STRIP_INLINE void OF(tail_step)(OF(tail_t) * tail, OF(swing_t) * swing, const batch_block_t *b,
                                unsigned l, double to_amplitude) {
    const VEC moved = STRIP_CLAMP(tail->settle * (tail->target - tail->servo), tail->most);
    const VEC next = tail->servo + moved;
    const VEC middle = tail->servo + next;
    const VEC cosine = moved * to_amplitude;
    const VEC over = cosine * cosine;
    const VEC square = middle * middle + over;
    swing->twice = STRIP_SQRT(square);
    swing->over_kt = (over + TAIL_REST_RAD2) * LOOK(b->twice_kt);
    swing->under = square + 2 * TAIL_REST_RAD2;
    tail->target += tail->move;
    tail->servo = next;
}

/* Without a servo. */
STRIP_INLINE void OF(table_step)(OF(swing_t) * swing, batch_block_t *b, unsigned l, unsigned i,
                                 const batch_frame_t *frame) {
    if (i == 0) {
        AT(b->tail_rad[0]) = LOOK(b->amplitude_rad) * frame->sine;
        AT(b->tail_rad[1]) = LOOK(b->amplitude_rad) * frame->next_sine;
    }
    swing->twice = 2 * LOOK(b->amplitude_rad);
    swing->over_kt = frame->ripple[i] * LOOK(b->kt);
    swing->under = 1.0 - (VEC){0};
}

/* The thrust that works in substep |i|, of lanes with delays of their own. */
STRIP_INLINE VEC OF(gather_late)(const batch_block_t *b, unsigned i, unsigned l) {
    VEC late = {0};
    for (unsigned j = 0; j < STRIP_WIDTH; j++) {
        late[j] = thrust_row(b, i, b->delay_steps[l + j])[l + j];
    }
    return late;
}

/* tank_sum_step with drag_fraction; the thrust one substep earlier still is the one read before. */
STRIP_INLINE void OF(water_step)(OF(water_t) * water, const OF(swing_t) * swing, VEC late,
                                 bool whole) {
    VEC mixed = late;
    if (!whole) {
        mixed += water->delay_fraction * (water->late - late);
        water->late = late;
    }
    water->late_most = STRIP_MAX(late, water->late_most);
    const VEC v = water->v, under = swing->under;
    const VEC push = mixed * swing->over_kt;
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
    water->v = LOOK(b->v_m_s[SUBSTEPS]);
    water->sum = LOOK(b->sum_m_s[SUBSTEPS]);
    water->late = LOOK(b->late);
    water->late_most = LOOK(b->late_most);
}

STRIP_INLINE void OF(keep_water)(const OF(water_t) * water, batch_block_t *b, unsigned l,
                                 bool whole) {
    AT(b->late_most) = water->late_most;
    if (!whole) {
        AT(b->late) = water->late;
    }
}

/* |i|: of the points of the frame. */
STRIP_INLINE void OF(keep_point)(const OF(water_t) * water, batch_block_t *b, unsigned l,
                                 unsigned i) {
    AT(b->v_m_s[i]) = water->v;
    AT(b->sum_m_s[i]) = water->sum;
}

/* A group of strips, within a frame. */
typedef struct {
    OF(tail_t) tail[GROUP];
    OF(water_t) water[GROUP];
    OF(swing_t) swing[STEPS];
    /* Rows of thrust: of this frame, and what works in it when all delays are the same. */
    double *now[SUBSTEPS], *late[SUBSTEPS];
} OF(group_t);

/* |how|, here and below, is constant where the code is compiled. */
STRIP_INLINE void OF(swing_on)(OF(group_t) * group, batch_block_t *b, const batch_frame_t *frame,
                               unsigned first, unsigned step, how_t how) {
    const unsigned l = first + LANE_OF(step), i = SUBSTEP_OF(step);
    OF(tail_t) *tail = &group->tail[LANE_OF(step) / STRIP_WIDTH];
    OF(swing_t) *swing = &group->swing[step];
    if (!how.servo) {
        OF(table_step)(swing, b, l, i, frame);
        return;
    }
    if (i == 0) {
        OF(begin_tail)(tail, b, l, frame);
    }
    OF(tail_step)(tail, swing, b, l, b->to_amplitude);
    if (i + 1 == SUBSTEPS) {
        AT(b->tail_rad[1]) = tail->servo;
    }
}

STRIP_INLINE void OF(swim_on)(OF(group_t) * group, batch_block_t *b, unsigned first, unsigned step,
                              how_t how) {
    const unsigned l = first + LANE_OF(step), i = SUBSTEP_OF(step);
    OF(water_t) *water = &group->water[LANE_OF(step) / STRIP_WIDTH];
    const OF(swing_t) *swing = &group->swing[step];
    AT(group->now[i]) = OF(thrust)(b, l, swing->twice, how.bends);
    if (i == 0) {
        OF(begin_water)(water, b, l);
        OF(keep_point)(water, b, l, 0);
    }
    const VEC late = how.whole ? LOOK(group->late[i]) : OF(gather_late)(b, i, l);
    OF(water_step)(water, swing, late, how.whole);
    OF(keep_point)(water, b, l, i + 1);
    if (i + 1 == SUBSTEPS) {
        OF(keep_water)(water, b, l, how.whole);
    }
}

/* |strips| is constant, too. */
STRIP_INLINE void OF(group_frame)(batch_block_t *b, const batch_frame_t *frame, unsigned first,
                                  unsigned strips, how_t how) {
    const unsigned steps = strips * SUBSTEPS;
    OF(group_t) group;
    for (unsigned i = 0; i < SUBSTEPS; i++) {
        group.now[i] = thrust_row(b, i, 0);
        group.late[i] = thrust_row(b, i, b->delay_steps[0]);
    }
#pragma GCC unroll 32 /* STEPS + WATER_LAG */
    for (unsigned n = 0; n < steps + WATER_LAG; n++) {
        if (n < steps) {
            OF(swing_on)(&group, b, frame, first, n, how);
        }
        if (n >= WATER_LAG) {
            OF(swim_on)(&group, b, first, n - WATER_LAG, how);
        }
    }
}

STRIP_INLINE void OF(frame_so)(batch_block_t *b, const batch_frame_t *frame, how_t how) {
    unsigned first = 0;
    for (; first + GROUP_LANES <= b->lanes; first += GROUP_LANES) {
        OF(group_frame)(b, frame, first, GROUP, how);
    }
    /* The lanes go by half a group at least, in all sets. */
    if (BATCH_STEP % GROUP_LANES != 0 && first < b->lanes) {
        OF(group_frame)(b, frame, first, GROUP / 2, how);
    }
}

STRIP_TARGET static void OF(frame)(batch_block_t *b, const batch_frame_t *frame) {
    if (!b->has_servo) {
        OF(frame_so)(b, frame, (how_t){.bends = true});
    } else if (b->bends || !b->whole_delay || !b->same_delay) {
        OF(frame_so)(b, frame, (how_t){.servo = true, .bends = true});
    } else {
        OF(frame_so)(b, frame, (how_t){.servo = true, .whole = true});
    }
    b->step += SUBSTEPS;
}

#undef SUBSTEP_OF
#undef LANE_OF
#undef STEPS
#undef WATER_LAG
