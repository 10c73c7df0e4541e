#include "speed/motion.h"

#include "base/panic.h"
#include "base/real.h"

#include <string.h>

#define PERIOD_MAX_S 0.03f /* frames come at 50 to 400 Hz */
#define FELT (2u * 3u)     /* rate, force */
#define FORCE 3u
#define TWELFTH (1.0f / 12.0f)
#define TIME_MAX_S 6500.0f
#define BEAT_SLOTS_MAX ((float)(MOTION_SLOTS / 2u - 2u))
/* Rounding of times apart, a slot is either covered or lacks more than a gap. */
#define COVERED_S (0.98f * SPEED_SLOT_S)
#define TURN_STEPS_PER_RAD 1e4f
#define TURN_STEPS_MAX 32767.0f

/* Means over a frame, in the level frame. */
typedef struct {
    float accel_m_s2[3], nose[3], yaw_rad_s;
} levelled_t;

static float dot(const float a[3], const float b[3]) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* |out| is neither of the factors. */
static void cross(const float a[3], const float b[3], float out[3]) {
    for (uint32_t i = 0, j = 1, k = 2; i < 3u; j = k, k = i++) {
        out[i] = a[j] * b[k] - a[k] * b[j];
    }
}

static void add(float sum[3], float times, const float v[3]) {
    for (uint32_t i = 0; i < 3u; i++) {
        sum[i] += times * v[i];
    }
}

/* Quaternion product; |out| is neither of the factors. */
static void multiply(const float a[4], const float b[4], float out[4]) {
    cross(&a[1], &b[1], &out[1]);
    add(&out[1], a[0], &b[1]);
    add(&out[1], b[0], &a[1]);
    out[0] = a[0] * b[0] - dot(&a[1], &b[1]);
}

/* False: there is no direction in it. */
static bool normalise(float q[4]) {
    const float square = q[0] * q[0] + dot(&q[1], &q[1]);
    if (!(square > 1e-12f)) {
        return false;
    }
    const float scale = 1.0f / real_sqrt(square);
    for (uint32_t i = 0; i < 4u; i++) {
        q[i] *= scale;
    }
    return true;
}

/* Turns a body vector into the level frame: v + 2 u x (w v + u x v). */
static void level(const float q[4], float v[3]) {
    float inner[3], outer[3];
    cross(&q[1], v, inner);
    add(inner, q[0], v);
    cross(&q[1], inner, outer);
    add(v, 2.0f, outer);
}

static void nose_of(const float q[4], float nose[3]) {
    nose[0] = 1.0f;
    nose[1] = 0.0f;
    nose[2] = 0.0f;
    level(q, nose);
}

/* How fast the nose's heading turns: the body's rate about the vertical would have its roll in it,
 * by the sine of the pitch. |rate| in body axes; not finite when the nose is upright. */
static float yaw_rate(const float q[4], const float rate[3], float nose_down) {
    float level_rate[3] = {rate[0], rate[1], rate[2]};
    level(q, level_rate);
    return (level_rate[2] - nose_down * rate[0]) / (1.0f - nose_down * nose_down);
}

static float along(const float a[2], const float b[2]) { return a[0] * b[0] + a[1] * b[1]; }

/* Down is against the specific force of a fish at rest: the shortest turn that brings it there. A
 * quaternion (1 + cos, axis sin) is half the angle, whatever its length. */
static void stand(float q[4], const float accel[3]) {
    q[0] = real_sqrt(dot(accel, accel)) - accel[2];
    q[1] = -accel[1];
    q[2] = accel[0];
    if (!normalise(q)) { /* upside down */
        q[1] = 1.0f;
    }
}

void motion_begin(motion_t *motion, const rest_mean_t *rest, const imu_frame_t *last) {
    REQUIRE(rest != NULL || last != NULL);
    memset(motion, 0, sizeof *motion);
    motion->begun = true;
    if (rest != NULL) {
        memcpy(motion->rate_bias_rad_s, rest->rate_rad_s, sizeof motion->rate_bias_rad_s);
    }
    stand(motion->q, rest != NULL ? rest->accel_m_s2 : last->accel_m_s2);
    nose_of(motion->q, motion->first_nose);
}

/* Turns the body by the rotation vector |angle|: series of sine and cosine of its half. */
static void turn(motion_t *motion, const float angle[3]) {
    const float square = 0.25f * dot(angle, angle);
    const float before[4] = {motion->q[0], motion->q[1], motion->q[2], motion->q[3]};
    float by[4] = {1.0f - 0.5f * square};
    add(&by[1], 0.5f - TWELFTH * square, angle);
    multiply(before, by, motion->q);
    (void)normalise(motion->q);
}

static motion_slot_t *slot_for(motion_t *motion, uint32_t index) {
    motion_slot_t *slot = &motion->slots[index % MOTION_SLOTS];
    if (slot->index != index) {
        *slot = (motion_slot_t){.index = (uint16_t)index};
        motion->turn_rad = 0.0f;
    }
    return slot;
}

static int16_t rounded_turn(float turn_rad) {
    const float steps = turn_rad * TURN_STEPS_PER_RAD;
    if (!(real_abs(steps) <= TURN_STEPS_MAX)) {
        return SPEED_NO_MOTION;
    }
    return (int16_t)(steps < 0.0f ? steps - 0.5f : steps + 0.5f);
}

static void add_piece(motion_t *motion, const levelled_t *levelled, float piece_s) {
    motion_slot_t *slot = slot_for(motion, motion->index);
    for (uint32_t i = 0; i < 2u; i++) {
        const float gain_m_s = levelled->accel_m_s2[i] * piece_s;
        slot->way_m[i] += (slot->gain_m_s[i] + 0.5f * gain_m_s) * piece_s;
        slot->gain_m_s[i] += gain_m_s;
        slot->nose_s[i] += levelled->nose[i] * piece_s;
    }
    motion->turn_rad += levelled->yaw_rad_s * piece_s;
    slot->turn_100urad = rounded_turn(motion->turn_rad);
    slot->covered_s += piece_s;
}

/* The |dt_s| before |time_s|, slot by slot. The board's clock for the sensor's wavers: pieces
 * follow each other without gap or overlap unless frames are missing. */
static void sum_up(motion_t *motion, const levelled_t *levelled, float time_s, float dt_s) {
    if (!(time_s < TIME_MAX_S)) {
        return;
    }
    float from_s = time_s - dt_s;
    if (from_s < motion->until_s + MOTION_GAP_MAX_S) {
        from_s = motion->until_s;
    }
    while (from_s < time_s) {
        const float slot_end_s = (float)(motion->index + 1u) * SPEED_SLOT_S;
        if (from_s >= slot_end_s) {
            motion->index++;
            continue;
        }
        const float end_s = slot_end_s < time_s ? slot_end_s : time_s;
        add_piece(motion, levelled, end_s - from_s);
        from_s = end_s;
    }
    motion->until_s = from_s;
}

/* Mean force of a frame in the body's axes at its begin: rate and force are straight lines with the
 * means |felt| and a |change| from frame to frame. Exact to the third order of dt; with less, 100
 * Hz frames of a fish that yaws, rolls and sways at 1 Hz make 0.5 mm/s out of nothing. */
static void mean_force(const float felt[FELT], const float change[FELT], const float angle[3],
                       float dt_s, float force[3]) {
    float middle[3] = {0}, bend[3] = {0}, turned[3];
    add(middle, 0.5f, angle);
    add(middle, -TWELFTH * dt_s, change);
    cross(middle, felt + FORCE, turned);
    add(bend, TWELFTH, change + FORCE);
    add(bend, 4.0f * TWELFTH, turned);
    cross(angle, bend, force);
    add(force, 1.0f, turned);
    add(force, 1.0f, felt + FORCE);
}

/* By how much each axis' turn raises or lowers the nose: the level frame's second row. */
static void cone(motion_t *motion, const float angle[3]) {
    const float *q = motion->q;
    const float row[3] = {2.0f * (q[1] * q[2] + q[0] * q[3]),
                          1.0f - 2.0f * (q[1] * q[1] + q[3] * q[3]),
                          2.0f * (q[2] * q[3] - q[0] * q[1])};
    for (uint32_t i = 0; i < 3u; i++) {
        motion->coned_rad[i] += row[i] * angle[i];
    }
}

float motion_tilt_sigma(const motion_t *motion, float scale_sigma) {
    return scale_sigma * real_sqrt(dot(motion->coned_rad, motion->coned_rad));
}

/* One frame, or what stands for missing ones. The turn has a term for a rate whose direction
 * changes (coning): without it the attitude would tilt by 3e-5 rad/s, 0.2 m/s in 40 s. */
static void step(motion_t *motion, const float felt[FELT], float time_s, float dt_s) {
    float change[FELT], angle[3] = {0}, coning[3];
    for (uint32_t i = 0; i < FELT; i++) {
        change[i] = felt[i] - motion->last[i];
        motion->last[i] = felt[i];
    }
    add(angle, dt_s, felt);
    levelled_t levelled = {0};
    mean_force(felt, change, angle, dt_s, levelled.accel_m_s2);
    level(motion->q, levelled.accel_m_s2);
    nose_of(motion->q, levelled.nose);
    levelled.yaw_rad_s = yaw_rate(motion->q, felt, levelled.nose[2]);
    sum_up(motion, &levelled, time_s, dt_s);
    cross(angle, change, coning);
    cone(motion, angle);
    add(angle, TWELFTH * dt_s, coning);
    turn(motion, angle);
}

void motion_push(motion_t *motion, const imu_frame_t *frame, float time_s, float dt_s) {
    REQUIRE(motion->begun);
    if (motion->lost) {
        return;
    }
    float felt[FELT], between[FELT];
    memcpy(felt, frame->rate_rad_s, sizeof frame->rate_rad_s);
    memcpy(felt + FORCE, frame->accel_m_s2, sizeof frame->accel_m_s2);
    add(felt, -1.0f, motion->rate_bias_rad_s);
    const bool first = !motion->follows;
    if (first) {
        memcpy(motion->last, felt, sizeof felt);
        motion->period_s = PERIOD_MAX_S;
        motion->follows = true;
    }
    if (dt_s > 0.0f && dt_s <= 1.5f * motion->period_s) {
        motion->period_s = dt_s;
    }
    const float missing_s = dt_s - motion->period_s;
    if (!(dt_s > 0.0f && missing_s <= MOTION_GAP_MAX_S)) {
        motion->lost = !first;
        return;
    }
    if (missing_s > 0.0f) {
        for (uint32_t i = 0; i < FELT; i++) {
            between[i] = 0.5f * (motion->last[i] + felt[i]);
        }
        step(motion, between, time_s - motion->period_s, missing_s);
    }
    step(motion, felt, time_s, motion->period_s);
}

/* NULL when it is not in the ring. */
static const motion_slot_t *slot_in(const motion_t *motion, uint32_t index) {
    const motion_slot_t *slot = &motion->slots[index % MOTION_SLOTS];
    return slot->index == index ? slot : NULL;
}

static void add_nose(const motion_t *motion, int32_t index, float weight, float sum[2]) {
    const motion_slot_t *slot = slot_in(motion, (uint32_t)index);
    const float *nose = motion->first_nose;
    if (index < 0) {
        weight *= SPEED_SLOT_S;
    } else if (slot != NULL) {
        nose = slot->nose_s;
    } else {
        return;
    }
    sum[0] += weight * nose[0];
    sum[1] += weight * nose[1];
}

/* The mean direction, of any length. A row of slots as long as a beat is averaged over the same row
 * once more: weights fall off linearly from the middle. Unless a beat is an odd number of slots,
 * the slots at the ends of the rows count in part, |part|; that rounds the peak and the feet. */
static void mean_nose(const motion_t *motion, int32_t index, float beat_s, float nose[2]) {
    const float slots = real_clip(beat_s * (1.0f / SPEED_SLOT_S), 1.0f, BEAT_SLOTS_MAX);
    const int32_t row = ((int32_t)slots - 1) | 1;
    const float part = 0.5f * (slots - (float)row);
    nose[0] = 0.0f;
    nose[1] = 0.0f;
    add_nose(motion, index, slots - 2.0f * part * (1.0f - part), nose);
    for (int32_t apart = 1; apart <= row + 1; apart++) {
        const float weight = apart <= row ? slots - (float)apart : part * part;
        add_nose(motion, index - apart, weight, nose);
        add_nose(motion, index + apart, weight, nose);
    }
}

/* NULL unless frames cover it whole. */
static const motion_slot_t *covered_slot(const motion_t *motion, uint32_t index) {
    const motion_slot_t *slot = slot_in(motion, index);
    return slot != NULL && slot->covered_s > COVERED_S ? slot : NULL;
}

int16_t motion_turn(const motion_t *motion, uint16_t index) {
    const motion_slot_t *slot = covered_slot(motion, index);
    return slot != NULL ? slot->turn_100urad : SPEED_NO_MOTION;
}

bool motion_forward(const motion_t *motion, uint16_t index, float beat_s, float *gain_m_s,
                    float *way_m) {
    float nose[2];
    const motion_slot_t *slot = covered_slot(motion, index);
    if (slot == NULL) {
        return false;
    }
    mean_nose(motion, index, beat_s, nose);
    const float length = real_sqrt(along(nose, nose));
    if (!(length > 0.0f)) {
        return false;
    }
    *gain_m_s = along(nose, slot->gain_m_s) / length;
    *way_m = along(nose, slot->way_m) / length;
    return true;
}
