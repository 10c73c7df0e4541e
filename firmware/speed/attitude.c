#include "speed/attitude.h"

#include "base/fixed.h"
#include "base/real.h"

#define STATE_BITS 61
#define TURN_DOWN (ATTITUDE_TURN_BITS - ATTITUDE_BITS)
#define ONE_Q60 ((int64_t)1 << 60)

/* What the products are made of, Q30. */
static void rounded(const attitude_t *attitude, int32_t q[4]) {
    for (uint32_t i = 0; i < 4u; i++) {
        q[i] = fixed_down(attitude->q[i], STATE_BITS - ATTITUDE_BITS);
    }
}

/* One step of Newton's for 1 / |q|, which is next to 1: q -= q * (|q|^2 - 1) / 2. */
static void normalise(attitude_t *attitude) {
    int32_t q[4];
    rounded(attitude, q);
    const int64_t square = (int64_t)q[0] * q[0] + fixed_dot(&q[1], &q[1]);
    const int32_t excess = fixed_down(square - ONE_Q60, 28); /* Q32: of half of it, Q33 */
    for (uint32_t i = 0; i < 4u; i++) {
        attitude->q[i] -= (int64_t)q[i] * excess >> 2;
    }
}

/* A quaternion (1 + cos, axis sin) is half the angle, whatever its length. */
void attitude_stand(attitude_t *attitude, const float accel_m_s2[3]) {
    const float x = accel_m_s2[0], y = accel_m_s2[1], z = accel_m_s2[2];
    const float q[3] = {real_sqrt(x * x + y * y + z * z) - z, -y, x};
    const float square = q[0] * q[0] + y * y + x * x;
    *attitude = (attitude_t){0};
    if (!(square > 1e-12f && square < 1e12f)) { /* upside down, or no force at all */
        attitude->q[1] = ONE_Q60 * 2;
        return;
    }
    const float scale = 1.0f / real_sqrt(square);
    for (uint32_t i = 0; i < 3u; i++) {
        attitude->q[i] = fixed_from(q[i] * scale, STATE_BITS);
    }
    normalise(attitude);
}

void attitude_rows(const attitude_t *attitude, int32_t rows[3][3]) {
    int32_t q[4];
    rounded(attitude, q);
    const int32_t *const v = &q[1];
    for (uint32_t i = 0, j = 1, k = 2; i < 3u; j = k, k = i++) {
        const int64_t mixed = (int64_t)v[i] * v[j], turned = (int64_t)q[0] * v[k];
        const int64_t others = (int64_t)v[j] * v[j] + (int64_t)v[k] * v[k];
        rows[i][i] = fixed_down(ONE_Q60 / 2 - others, ATTITUDE_BITS - 1);
        rows[i][j] = fixed_down(mixed - turned, ATTITUDE_BITS - 1);
        rows[j][i] = fixed_down(mixed + turned, ATTITUDE_BITS - 1);
    }
}

/* The quaternion of a turn by |angle| (Q57), by the series of sine and cosine: vector part v (Q31,
 * its rest carried on), scalar part less 1 (returned, Q31). Where all three axes turn by 0.75 rad,
 * more than the sensor measures at 50 Hz, they lack 1e-4. */
static int32_t small_turn(attitude_t *attitude, const int64_t angle[3], int32_t v[3]) {
    int32_t half[3]; /* Q31 of the half is Q30 of the angle */
    for (uint32_t i = 0; i < 3u; i++) {
        half[i] = fixed_down(angle[i], TURN_DOWN);
    }
    const int32_t square = fixed_down(fixed_dot(half, half), 32); /* Q30 */
    const int32_t fourth = fixed_down((int64_t)square * square, 30);
    const int32_t lacks = square / 6 - fourth / 120;
    for (uint32_t i = 0; i < 3u; i++) {
        const int64_t arc = angle[i] - ((int64_t)half[i] * lacks >> (60 - ATTITUDE_TURN_BITS));
        v[i] = fixed_carried(arc, TURN_DOWN, &attitude->left[i]);
    }
    return fourth / 12 - square;
}

void attitude_turn(attitude_t *attitude, const int64_t angle[3]) {
    int32_t q[4], v[3];
    int64_t crossed[3];
    const int32_t less_one = small_turn(attitude, angle, v);
    rounded(attitude, q);
    fixed_cross(&q[1], v, crossed);
    attitude->q[0] += (int64_t)q[0] * less_one - fixed_dot(&q[1], v);
    for (uint32_t i = 0; i < 3u; i++) {
        attitude->q[i + 1u] += (int64_t)q[0] * v[i] + (int64_t)q[i + 1u] * less_one + crossed[i];
    }
    normalise(attitude);
}
