#include "speed/motion.h"

#include "base/fixed.h"
#include "base/panic.h"
#include "base/real.h"

#include <string.h>

/* How many bits stand behind the binary point (base/fixed.h). */
enum {
    RATE = 24,  /* rad/s */
    FORCE = 22, /* m/s^2 */
    ANGLE = ATTITUDE_BITS,
    TIME = 33,       /* s */
    SHORT_TIME = 36, /* s */
    YAW = 20,        /* rad/s */
    RECIPROCAL = 22,
    GAIN = 29, /* m/s, of a slot */
    WAY = 32,  /* m, of a slot */
    TURN = 27, /* rad, of a slot */
    WEIGHT = 20,
    FINER = 22, /* than RATE and FORCE: of numbers that are rounded to them */
    GAIN_SUM = FORCE + TIME,
    WAY_SUM = GAIN + TIME,
    TURN_SUM = YAW + TIME,
};

#define FELT (2u * 3u)     /* rate, force */
#define FELT_MAX (1 << 30) /* 64 rad/s, 256 m/s^2: sum and difference of two fit */
#define FORCES 3u
#define PER_S 0x1p33f /* TIME */
/* SPEED_SLOT_S with 5 bits more, rounded up: a frame that ends with a slot does not begin the next.
 */
#define SLOT_FINE 27487790695
#define SLOT_FINER 5
#define SLOT (SLOT_FINE >> SLOT_FINER)
#define COVERED ((int32_t)(0.98f * (float)SLOT)) /* or it lacks more than a gap */
#define PERIOD_MAX ((int32_t)(0.03f * PER_S))    /* frames come at 50 to 400 Hz */
#define DT_MAX (1 << (TIME - 3))                 /* 0.125 s */
#define GAP_MAX ((int32_t)(MOTION_GAP_MAX_S * PER_S))
#define TIME_MAX ((int64_t)6500 << TIME)
#define BEAT_SLOTS_MAX ((float)(MOTION_SLOTS / 2u - 2u))
#define WHOLE_WEIGHT (1 << WEIGHT)
#define TURN_STEPS_PER_RAD 10000
#define TURN_STEPS_MAX 32767
/* Of a frame, about each axis. The rate may change by three times ANGLE_MAX's within it. */
#define ANGLE_MAX ((int32_t)(0.75f * ATTITUDE_ONE))
#define BEND_MAX (ATTITUDE_ONE / 4)
/* The nose is 3.6 degrees from the vertical: cosine squared of its pitch, Q60. */
#define UPRIGHT ((int64_t)1 << (2 * ATTITUDE_BITS - 8))
#define YAW_UNKNOWN INT32_MAX
#define TURN_UNKNOWN ((int64_t)1 << 60) /* 128 rad: nothing in a slot brings it back */

/* A frame, or what stands for missing ones: rate and force are straight lines with the means |felt|
 * and a |change| from frame to frame. */
typedef struct {
    int32_t felt[FELT], change[FELT]; /* RATE, FORCE */
    int32_t dt;                       /* TIME */
    int32_t angle[3];                 /* rate times dt */
    int32_t bend[3];                  /* a twelfth of the rate's change times dt; ANGLE */
} stretch_t;

/* Means over a stretch, in the level frame. */
typedef struct {
    int32_t accel[2], nose[2], yaw; /* FORCE, ATTITUDE_BITS, YAW */
} levelled_t;

void motion_begin(motion_t *motion, const rest_mean_t *rest, const imu_frame_t *last) {
    int32_t rows[3][3];
    REQUIRE(rest != NULL || last != NULL);
    memset(motion, 0, sizeof *motion);
    motion->begun = true;
    if (rest != NULL) {
        for (uint32_t i = 0; i < 3u; i++) {
            motion->rate_bias[i] = fixed_from(rest->rate_rad_s[i], RATE + FINER);
        }
    }
    attitude_stand(&motion->attitude, rest != NULL ? rest->accel_m_s2 : last->accel_m_s2);
    attitude_rows(&motion->attitude, rows);
    for (uint32_t i = 0; i < 2u; i++) {
        motion->first_nose[i] = fixed_down((int64_t)rows[i][0] * SLOT, ATTITUDE_BITS);
    }
}

/* 1 / |square|, both Q30 and up to 1, not less than UPRIGHT: from 10 bits by Newton's step to 20,
 * while the fish is not upright to 28. As RECIPROCAL. */
static int32_t reciprocal(int32_t square) {
    const int32_t rough = (int32_t)(UINT32_MAX / ((uint32_t)square >> 12));                /* Q14 */
    const int32_t lacks = (int32_t)((((int64_t)1 << 44) - (int64_t)square * rough) >> 20); /* Q24 */
    return rough * (1 << 8) + fixed_down((int64_t)rough * lacks, 16);
}

/* How fast the nose's heading turns: the body's rate about the vertical would have its roll in it,
 * by the sine of the pitch. |down|: the level frame's third row as the stretch begins; what counts
 * is that of its middle. */
static int32_t yaw_rate(const int32_t down[3], const stretch_t *stretch) {
    const int32_t *const rate = stretch->felt;
    int32_t middle[3];
    int64_t crossed[3];
    fixed_cross(down, stretch->angle, crossed);
    for (uint32_t i = 0; i < 3u; i++) {
        middle[i] = down[i] + fixed_down(crossed[i], ANGLE + 1);
    }
    const int64_t turned = (int64_t)middle[1] * rate[1] + (int64_t)middle[2] * rate[2];
    const int64_t square = (int64_t)middle[1] * middle[1] + (int64_t)middle[2] * middle[2];
    if (square < UPRIGHT) {
        return YAW_UNKNOWN;
    }
    const int64_t yaw =
        (int64_t)fixed_down(turned, ATTITUDE_BITS) * reciprocal(fixed_down(square, ATTITUDE_BITS));
    return fixed_clipped(yaw, RATE + RECIPROCAL - YAW);
}

static motion_slot_t *slot_for(motion_t *motion, uint32_t index) {
    motion_slot_t *slot = &motion->slots[index % MOTION_SLOTS];
    if (slot->index != index) {
        *slot = (motion_slot_t){.index = (uint16_t)index};
        motion->filling = (motion_sums_t){0};
    }
    return slot;
}

static int16_t rounded_turn(int64_t sum) {
    const int32_t turn = fixed_clipped(sum, TURN_SUM - TURN);
    const int32_t steps = fixed_clipped((int64_t)turn * TURN_STEPS_PER_RAD, TURN);
    return steps > TURN_STEPS_MAX || steps < -TURN_STEPS_MAX ? SPEED_NO_MOTION : (int16_t)steps;
}

static void add_piece(motion_t *motion, const levelled_t *levelled, int32_t piece) {
    motion_slot_t *slot = slot_for(motion, motion->index);
    motion_sums_t *sums = &motion->filling;
    for (uint32_t i = 0; i < 2u; i++) {
        const int64_t gained = (int64_t)levelled->accel[i] * piece;
        const int32_t middle = fixed_clipped(sums->gain[i] + gained / 2, GAIN_SUM - GAIN);
        sums->gain[i] += gained;
        sums->way[i] += (int64_t)middle * piece;
        slot->gain[i] = fixed_clipped(sums->gain[i], GAIN_SUM - GAIN);
        slot->way[i] = fixed_clipped(sums->way[i], WAY_SUM - WAY);
        slot->nose[i] += fixed_down((int64_t)levelled->nose[i] * piece, ATTITUDE_BITS);
    }
    sums->turn += (int64_t)levelled->yaw * piece;
    if (levelled->yaw == YAW_UNKNOWN) {
        sums->turn = TURN_UNKNOWN;
    }
    slot->turn_100urad = rounded_turn(sums->turn);
    slot->covered += piece;
}

/* The |dt| before |time|, slot by slot. The board's clock for the sensor's wavers: pieces follow
 * each other without gap or overlap unless frames are missing. */
static void sum_up(motion_t *motion, const levelled_t *levelled, int64_t time, int32_t dt) {
    if (time >= TIME_MAX) {
        return;
    }
    int64_t from = time - dt;
    if (from < motion->until + GAP_MAX) {
        from = motion->until;
    }
    while (from < time) {
        const int64_t slot_end = (int64_t)(motion->index + 1u) * SLOT_FINE >> SLOT_FINER;
        if (from >= slot_end) {
            motion->index++;
            continue;
        }
        const int64_t end = slot_end < time ? slot_end : time;
        add_piece(motion, levelled, (int32_t)(end - from));
        from = end;
    }
    motion->until = from;
}

/* Mean force in the body's axes at its begin. Exact to the third order of dt; with less, 100 Hz
 * frames of a fish that yaws, rolls and sways at 1 Hz make 0.5 mm/s out of nothing. */
static void mean_force(const stretch_t *stretch, int32_t left[3], int32_t force[3]) {
    const int32_t *const felt = stretch->felt + FORCES;
    int32_t middle[3], curve[3];
    int64_t turned[3], crossed[3];
    for (uint32_t i = 0; i < 3u; i++) {
        middle[i] = stretch->angle[i] / 2 - stretch->bend[i];
    }
    fixed_cross(middle, felt, turned);
    for (uint32_t i = 0; i < 3u; i++) {
        curve[i] = stretch->change[FORCES + i] / 12 + fixed_clipped(turned[i], ANGLE) / 3;
    }
    fixed_cross(stretch->angle, curve, crossed);
    for (uint32_t i = 0; i < 3u; i++) {
        const int64_t whole = crossed[i] + turned[i] + (int64_t)felt[i] * ATTITUDE_ONE;
        force[i] = fixed_carried(whole, ANGLE, &left[i]);
    }
}

/* By how much each axis' turn raises or lowers the nose. |row|: the level frame's second. */
static void cone(motion_t *motion, const int32_t row[3], const int32_t angle[3]) {
    for (uint32_t i = 0; i < 3u; i++) {
        motion->coned[i] += fixed_down((int64_t)row[i] * angle[i], ATTITUDE_BITS);
    }
}

float motion_tilt_sigma(const motion_t *motion, float scale_sigma) {
    float square = 0.0f;
    for (uint32_t i = 0; i < 3u; i++) {
        const float coned_rad = (float)motion->coned[i] * 0x1p-30f;
        square += coned_rad * coned_rad;
    }
    return scale_sigma * real_sqrt(square);
}

static bool within(int32_t x, int32_t limit) { return x <= limit && x >= -limit; }

/* False when it turned too far to be followed. */
static bool stretch_from(stretch_t *stretch, const int32_t last[FELT]) {
    const int32_t twelfth = (int32_t)((uint32_t)stretch->dt * 2u / 3u); /* SHORT_TIME */
    bool followed = true;
    for (uint32_t i = 0; i < FELT; i++) {
        stretch->change[i] = stretch->felt[i] - last[i];
    }
    for (uint32_t i = 0; i < 3u; i++) {
        stretch->angle[i] =
            fixed_clipped((int64_t)stretch->felt[i] * stretch->dt, RATE + TIME - ANGLE);
        stretch->bend[i] =
            fixed_clipped((int64_t)stretch->change[i] * twelfth, RATE + SHORT_TIME - ANGLE);
        followed =
            followed && within(stretch->angle[i], ANGLE_MAX) && within(stretch->bend[i], BEND_MAX);
    }
    return followed;
}

/* The turn has a term for a rate whose direction changes (coning): without it the attitude would
 * tilt by 3e-5 rad/s, 0.2 m/s in 40 s. */
static void turn(attitude_t *attitude, const stretch_t *stretch) {
    int64_t angle[3];
    fixed_cross(stretch->angle, stretch->bend, angle);
    for (uint32_t i = 0; i < 3u; i++) {
        angle[i] = (angle[i] >> (2 * ANGLE - ATTITUDE_TURN_BITS)) +
                   (int64_t)stretch->felt[i] * stretch->dt;
    }
    attitude_turn(attitude, angle);
}

static void step(motion_t *motion, stretch_t *stretch, int64_t time) {
    int32_t rows[3][3], force[3];
    levelled_t levelled;
    if (motion->lost || !stretch_from(stretch, motion->last)) {
        motion->lost = true;
        return;
    }
    memcpy(motion->last, stretch->felt, sizeof motion->last);
    mean_force(stretch, motion->force_left, force);
    attitude_rows(&motion->attitude, rows);
    for (uint32_t i = 0; i < 2u; i++) {
        levelled.accel[i] =
            fixed_carried(fixed_dot(rows[i], force), ATTITUDE_BITS, &motion->accel_left[i]);
        levelled.nose[i] = rows[i][0];
    }
    levelled.yaw = yaw_rate(rows[2], stretch);
    sum_up(motion, &levelled, time, stretch->dt);
    cone(motion, rows[1], stretch->angle);
    turn(&motion->attitude, stretch);
}

/* False when it is out of range: no sensor's frame. */
static bool convert(motion_t *motion, const imu_frame_t *frame, int32_t felt[FELT]) {
    bool in_range = true;
    for (uint32_t i = 0; i < 3u; i++) {
        const int64_t rate = fixed_from(frame->rate_rad_s[i], RATE + FINER) - motion->rate_bias[i];
        const int64_t force = fixed_from(frame->accel_m_s2[i], FORCE + FINER);
        felt[i] = fixed_carried(rate, FINER, &motion->felt_left[i]);
        felt[FORCES + i] = fixed_carried(force, FINER, &motion->felt_left[FORCES + i]);
        in_range = in_range && within(felt[i], FELT_MAX) && within(felt[FORCES + i], FELT_MAX);
    }
    return in_range;
}

/* Half way from the frame before to |felt|. */
static void bridge(motion_t *motion, const int32_t felt[FELT], int64_t time, int32_t missing) {
    stretch_t between = {.dt = missing};
    for (uint32_t i = 0; i < FELT; i++) {
        between.felt[i] = (motion->last[i] + felt[i]) / 2;
    }
    step(motion, &between, time);
}

void motion_push(motion_t *motion, const imu_frame_t *frame, float time_s, float dt_s) {
    REQUIRE(motion->begun);
    stretch_t stretch;
    if (motion->lost || !convert(motion, frame, stretch.felt)) {
        motion->lost = true;
        return;
    }
    const bool first = !motion->follows;
    if (first) {
        memcpy(motion->last, stretch.felt, sizeof motion->last);
        motion->period = PERIOD_MAX;
        motion->follows = true;
    }
    const int32_t dt = fixed_clipped(fixed_from(dt_s, TIME + 1), 1);
    if (dt > 0 && dt <= DT_MAX && dt - motion->period <= motion->period / 2) {
        motion->period = dt;
    }
    const int32_t missing = dt - motion->period;
    if (dt <= 0 || dt > DT_MAX || missing > GAP_MAX) {
        motion->lost = !first;
        return;
    }
    const int64_t time = fixed_from(time_s, TIME);
    if (missing > 0) {
        bridge(motion, stretch.felt, time - motion->period, missing);
    }
    stretch.dt = motion->period;
    step(motion, &stretch, time);
}

/* NULL when it is not in the ring. */
static const motion_slot_t *slot_in(const motion_t *motion, uint32_t index) {
    const motion_slot_t *slot = &motion->slots[index % MOTION_SLOTS];
    return slot->index == index ? slot : NULL;
}

static void add_nose(const motion_t *motion, int32_t index, int32_t weight, int64_t sum[2]) {
    const motion_slot_t *slot = slot_in(motion, (uint32_t)index);
    const int32_t *nose = motion->first_nose;
    if (index >= 0) {
        if (slot == NULL) {
            return;
        }
        nose = slot->nose;
    }
    sum[0] += (int64_t)weight * nose[0];
    sum[1] += (int64_t)weight * nose[1];
}

/* The mean direction, of any length. A row of slots as long as a beat is averaged over the same row
 * once more: weights fall off linearly from the middle. Unless a beat is an odd number of slots,
 * the slots at the ends of the rows count in part, |part|; that rounds the peak and the feet. */
static void mean_nose(const motion_t *motion, int32_t index, float beat_s, float nose[2]) {
    const int32_t slots = (int32_t)fixed_from(
        real_clip(beat_s * (1.0f / SPEED_SLOT_S), 1.0f, BEAT_SLOTS_MAX), WEIGHT);
    const int32_t row = ((slots >> WEIGHT) - 1) | 1;
    const int32_t part = (slots - row * WHOLE_WEIGHT) / 2;
    const int32_t foot = fixed_down((int64_t)part * part, WEIGHT);
    int64_t sum[2] = {0};
    add_nose(motion, index, slots - 2 * (part - foot), sum);
    for (int32_t apart = 1; apart <= row + 1; apart++) {
        const int32_t weight = apart <= row ? slots - apart * WHOLE_WEIGHT : foot;
        add_nose(motion, index - apart, weight, sum);
        add_nose(motion, index + apart, weight, sum);
    }
    nose[0] = (float)fixed_down(sum[0], 32);
    nose[1] = (float)fixed_down(sum[1], 32);
}

/* NULL unless frames cover it whole. */
static const motion_slot_t *covered_slot(const motion_t *motion, uint32_t index) {
    const motion_slot_t *slot = slot_in(motion, index);
    return slot != NULL && slot->covered > COVERED ? slot : NULL;
}

int16_t motion_turn(const motion_t *motion, uint16_t index) {
    const motion_slot_t *slot = covered_slot(motion, index);
    return slot != NULL ? slot->turn_100urad : SPEED_NO_MOTION;
}

static float along(const float a[2], const int32_t b[2]) {
    return a[0] * (float)b[0] + a[1] * (float)b[1];
}

bool motion_forward(const motion_t *motion, uint16_t index, float beat_s, float *gain_m_s,
                    float *way_m) {
    float nose[2];
    const motion_slot_t *slot = covered_slot(motion, index);
    if (slot == NULL) {
        return false;
    }
    mean_nose(motion, index, beat_s, nose);
    const float length = real_sqrt(nose[0] * nose[0] + nose[1] * nose[1]);
    if (!(length > 0.0f)) {
        return false;
    }
    *gain_m_s = along(nose, slot->gain) / length * 0x1p-29f;
    *way_m = along(nose, slot->way) / length * 0x1p-32f;
    return true;
}
