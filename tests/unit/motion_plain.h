/*
 * The integration of motion.c as its formulas say it, in floating point. Compiled for float it is
 * what the board computed before its fixed point, for double what both are compared with. No guard:
 * it is included once per type, behind motion.h.
 *
 * Include with these defined, which are undefined again: REAL, the type; ROOT(x), its square root;
 * NAME(x), what makes names different.
 */
#ifndef PLAIN_SLOTS
#define PLAIN_SLOTS 460
#endif

typedef struct {
    REAL q[4], bias_rad_s[3], last[6], period_s, until_s;
    unsigned index;
    bool follows;
    REAL gain_m_s[PLAIN_SLOTS][2], way_m[PLAIN_SLOTS][2], nose_s[PLAIN_SLOTS][2];
    REAL covered_s[PLAIN_SLOTS], turn_rad[PLAIN_SLOTS], coned_rad[3];
} NAME(plain_t);

static REAL NAME(dot)(const REAL a[3], const REAL b[3]) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void NAME(cross)(const REAL a[3], const REAL b[3], REAL out[3]) {
    for (unsigned i = 0, j = 1, k = 2; i < 3u; j = k, k = i++) {
        out[i] = a[j] * b[k] - a[k] * b[j];
    }
}

static void NAME(add)(REAL sum[3], REAL times, const REAL v[3]) {
    for (unsigned i = 0; i < 3u; i++) {
        sum[i] += times * v[i];
    }
}

static void NAME(normalise)(REAL q[4]) {
    const REAL scale = (REAL)1 / ROOT(q[0] * q[0] + NAME(dot)(&q[1], &q[1]));
    for (unsigned i = 0; i < 4u; i++) {
        q[i] *= scale;
    }
}

static void NAME(level)(const REAL q[4], REAL v[3]) {
    REAL inner[3], outer[3];
    NAME(cross)(&q[1], v, inner);
    NAME(add)(inner, q[0], v);
    NAME(cross)(&q[1], inner, outer);
    NAME(add)(v, (REAL)2, outer);
}

static void NAME(begin)(NAME(plain_t) * plain, const rest_mean_t *mean) {
    *plain = (NAME(plain_t)){0};
    const REAL accel[3] = {(REAL)mean->accel_m_s2[0], (REAL)mean->accel_m_s2[1],
                           (REAL)mean->accel_m_s2[2]};
    for (unsigned i = 0; i < 3u; i++) {
        plain->bias_rad_s[i] = (REAL)mean->rate_rad_s[i];
    }
    plain->q[0] = ROOT(NAME(dot)(accel, accel)) - accel[2];
    plain->q[1] = -accel[1];
    plain->q[2] = accel[0];
    NAME(normalise)(plain->q);
}

static void NAME(add_piece)(NAME(plain_t) * plain, const REAL accel[3], const REAL nose[3],
                            REAL yaw_rad_s, REAL piece_s) {
    const unsigned slot = plain->index;
    for (unsigned i = 0; i < 2u; i++) {
        const REAL gain = accel[i] * piece_s;
        plain->way_m[slot][i] += (plain->gain_m_s[slot][i] + (REAL)0.5 * gain) * piece_s;
        plain->gain_m_s[slot][i] += gain;
        plain->nose_s[slot][i] += nose[i] * piece_s;
    }
    plain->turn_rad[slot] += yaw_rad_s * piece_s;
    plain->covered_s[slot] += piece_s;
}

static void NAME(sum_up)(NAME(plain_t) * plain, const REAL accel[3], const REAL rate[3],
                         REAL time_s, REAL dt_s) {
    REAL nose[3] = {(REAL)1}, level_rate[3] = {rate[0], rate[1], rate[2]};
    NAME(level)(plain->q, nose);
    NAME(level)(plain->q, level_rate);
    const REAL yaw_rad_s = (level_rate[2] - nose[2] * rate[0]) / ((REAL)1 - nose[2] * nose[2]);
    REAL from_s = time_s - dt_s;
    if (from_s < plain->until_s + (REAL)MOTION_GAP_MAX_S) {
        from_s = plain->until_s;
    }
    while (from_s < time_s) {
        const REAL slot_end_s = (REAL)(plain->index + 1u) * ((REAL)1 / (REAL)10);
        if (from_s >= slot_end_s) {
            plain->index++;
            continue;
        }
        const REAL end_s = slot_end_s < time_s ? slot_end_s : time_s;
        NAME(add_piece)(plain, accel, nose, yaw_rad_s, end_s - from_s);
        from_s = end_s;
    }
    plain->until_s = from_s;
}

static void NAME(mean_force)(const REAL felt[6], const REAL change[6], const REAL angle[3],
                             REAL dt_s, REAL force[3]) {
    const REAL twelfth = (REAL)1 / (REAL)12;
    REAL middle[3] = {0}, bend[3] = {0}, turned[3];
    NAME(add)(middle, (REAL)0.5, angle);
    NAME(add)(middle, -twelfth * dt_s, change);
    NAME(cross)(middle, felt + 3, turned);
    NAME(add)(bend, twelfth, change + 3);
    NAME(add)(bend, (REAL)4 * twelfth, turned);
    NAME(cross)(angle, bend, force);
    NAME(add)(force, (REAL)1, turned);
    NAME(add)(force, (REAL)1, felt + 3);
}

static void NAME(turn)(NAME(plain_t) * plain, const REAL angle[3]) {
    const REAL square = (REAL)0.25 * NAME(dot)(angle, angle);
    const REAL *const q = plain->q;
    REAL by[4] = {(REAL)1 - (REAL)0.5 * square}, turned[4];
    NAME(add)(&by[1], (REAL)0.5 - square / (REAL)12, angle);
    NAME(cross)(&q[1], &by[1], &turned[1]);
    NAME(add)(&turned[1], q[0], &by[1]);
    NAME(add)(&turned[1], by[0], &q[1]);
    turned[0] = q[0] * by[0] - NAME(dot)(&q[1], &by[1]);
    NAME(normalise)(turned);
    for (unsigned i = 0; i < 4u; i++) {
        plain->q[i] = turned[i];
    }
}

static void NAME(cone)(NAME(plain_t) * plain, const REAL angle[3]) {
    const REAL *const q = plain->q;
    const REAL row[3] = {(REAL)2 * (q[1] * q[2] + q[0] * q[3]),
                         (REAL)1 - (REAL)2 * (q[1] * q[1] + q[3] * q[3]),
                         (REAL)2 * (q[2] * q[3] - q[0] * q[1])};
    for (unsigned i = 0; i < 3u; i++) {
        plain->coned_rad[i] += row[i] * angle[i];
    }
}

static void NAME(push)(NAME(plain_t) * plain, const imu_frame_t *frame, float at_s, float after_s) {
    REAL felt[6], change[6], angle[3] = {0}, accel[3], coning[3];
    const REAL dt_s = (REAL)after_s;
    for (unsigned i = 0; i < 3u; i++) {
        felt[i] = (REAL)frame->rate_rad_s[i] - plain->bias_rad_s[i];
        felt[3u + i] = (REAL)frame->accel_m_s2[i];
    }
    for (unsigned i = 0; i < 6u; i++) {
        change[i] = plain->follows ? felt[i] - plain->last[i] : (REAL)0;
        plain->last[i] = felt[i];
    }
    plain->follows = true;
    NAME(add)(angle, dt_s, felt);
    NAME(mean_force)(felt, change, angle, dt_s, accel);
    NAME(level)(plain->q, accel);
    NAME(sum_up)(plain, accel, felt, (REAL)at_s, dt_s);
    NAME(cone)(plain, angle);
    NAME(cross)(angle, change, coning);
    NAME(add)(angle, dt_s / (REAL)12, coning);
    NAME(turn)(plain, angle);
}

#undef REAL
#undef ROOT
#undef NAME
