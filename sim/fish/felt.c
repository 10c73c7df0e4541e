#include "felt.h"

#include "common/noise.h"

#include <math.h>

#define PITCH_PER_TAIL2 0.02
#define TWO_PI 6.28318530717958647692
/* A hand trembles with up to some 8 Hz. */
#define TREMOR_KNOT_US 60000u
#define GRASP_S 0.3
/* Faster than any servo: a limp tail of the thesis plant falls back within a frame. */
#define SLOPE_MAX_RAD_S 40.0
/* Somebody who rolls the fish is this quick. */
#define TILT_RAD_S 20.0
/* ... and who turns it, so quick. */
#define TURN_RAD_S 2.0

static double limited(double x, double most) { return x > most ? most : x < -most ? -most : x; }

/* Rate at the end of the newest frame: the parabola through the slopes of the last three, which
 * stand for the middles of their frames. */
static double end_rate(const double slope[3]) {
    return (11 * slope[0] - 7 * slope[1] + 2 * slope[2]) / 6;
}

static double tilt_next(const felt_t *felt, double length_s) {
    return felt->tilt_rad + limited(felt->tilt_wanted_rad - felt->tilt_rad, TILT_RAD_S * length_s);
}

static void follow(felt_t *felt, felt_frame_t *frame, const plant_t *plant, double length_s) {
    const double from = felt->turned_rad;
    felt->turned_rad += limited(-from, TURN_RAD_S * length_s);
    for (unsigned i = 0; i <= SUBSTEPS; i++) {
        const plant_point_t *at = &plant->motion.trace[i];
        frame->vx_m_s[i] = at->vx_m_s + felt->carried_m_s[0];
        frame->vy_m_s[i] = at->vy_m_s + felt->carried_m_s[1];
        frame->heading_rad[i] = at->heading_rad + from + (felt->turned_rad - from) * i / SUBSTEPS;
    }
}

/* The tank's fish swims straight on for whole trials. */
static void look_ahead(const felt_t *felt, felt_frame_t *frame) {
    const double heading = frame->heading_rad[0] + 0.0; /* as along() has it: -0 becomes 0 */
    frame->straight = true;
    for (unsigned i = 1; i <= SUBSTEPS; i++) {
        frame->straight = frame->straight && frame->heading_rad[i] == frame->heading_rad[0];
    }
    const felt_frame_t *before = &felt->frame[(felt->frames - 2) % FELT_FRAMES];
    if (felt->frames > 1 && before->straight && before->heading_rad[0] == heading) {
        frame->sine = before->sine;
        frame->cosine = before->cosine;
    } else if (frame->straight) {
        frame->sine = sin(heading);
        frame->cosine = cos(heading);
    }
}

void felt_init(felt_t *felt, const sim_config_t *config) {
    felt->roll_per_tail = config->roll_per_tail * cos(config->roll_lag_rad);
    felt->roll_s = -config->roll_per_tail * sin(config->roll_lag_rad) * config->beat_s / TWO_PI;
    felt->cone_s = config->cone_per_tail * config->beat_s / TWO_PI;
    felt->tremor_rad = config->tremor_rad;
    felt->tremor_key = noise_key(config->seed, NOISE_TREMOR, 0);
    felt->held = 1;
}

/* Smooth between independent values. */
static void tremble(const felt_t *felt, uint64_t time_us, double out[3]) {
    out[0] = out[1] = out[2] = 0;
    if (felt->tremor_rad <= 0) {
        return;
    }
    const uint64_t knot = time_us / TREMOR_KNOT_US;
    const double u = (double)(time_us % TREMOR_KNOT_US) / TREMOR_KNOT_US;
    const double part = u * u * (3 - 2 * u);
    for (unsigned i = 0; i < 3; i++) {
        const double from = noise_normal(felt->tremor_key, 3 * knot + i);
        const double to = noise_normal(felt->tremor_key, 3 * knot + 3 + i);
        out[i] = felt->held * felt->tremor_rad * (from + part * (to - from));
    }
}

static void turned(const felt_t *felt, uint64_t time_us, double out[3]) {
    if (!felt->by_hand) {
        return;
    }
    const double since_s = (double)(int64_t)(time_us - felt->turn_begin_us);
    const double whole_s = (double)(felt->turn_end_us - felt->turn_begin_us);
    const double u = since_s <= 0 ? 0 : since_s >= whole_s ? 1 : since_s / whole_s;
    const double part = u * u * (3 - 2 * u);
    for (unsigned i = 0; i < 3; i++) {
        out[i] += felt->turn_from_rad[i] + part * (felt->turn_to_rad[i] - felt->turn_from_rad[i]);
    }
}

void felt_turn(felt_t *felt, const double angle_rad[3], double within_s, uint64_t now_us) {
    double from[3] = {0};
    turned(felt, now_us, from);
    for (unsigned i = 0; i < 3; i++) {
        felt->turn_from_rad[i] = from[i];
        felt->turn_to_rad[i] = angle_rad[i];
    }
    felt->by_hand = true;
    felt->turn_begin_us = now_us;
    felt->turn_end_us = now_us + (uint64_t)(within_s * 1e6);
}

static void hold(felt_t *felt, felt_frame_t *frame, bool in_hand) {
    const double most = (double)(frame->end_us - frame->begin_us) * 1e-6 / GRASP_S;
    tremble(felt, frame->begin_us, frame->hand_rad[0]);
    felt->held += limited((in_hand ? 1 : 0) - felt->held, most);
    tremble(felt, frame->end_us, frame->hand_rad[1]);
    turned(felt, frame->begin_us, frame->hand_rad[0]);
    turned(felt, frame->end_us, frame->hand_rad[1]);
}

void felt_frame(felt_t *felt, const plant_t *plant, bool in_hand, double tail_from_rad,
                double tail_to_rad, uint64_t begin_us, uint64_t end_us) {
    if (end_us <= begin_us) {
        return;
    }
    const double length_s = (double)(end_us - begin_us) * 1e-6;
    const double rate_before = felt->frames > 0 ? end_rate(felt->slope_rad_s) : 0;
    felt_frame_t *frame = &felt->frame[felt->frames++ % FELT_FRAMES];
    felt->slope_rad_s[2] = felt->slope_rad_s[1];
    felt->slope_rad_s[1] = felt->slope_rad_s[0];
    felt->slope_rad_s[0] = limited((tail_to_rad - tail_from_rad) / length_s, SLOPE_MAX_RAD_S);
    frame->begin_us = begin_us;
    frame->end_us = end_us;
    follow(felt, frame, plant, length_s);
    look_ahead(felt, frame);
    hold(felt, frame, in_hand);
    frame->tail_rad[0] = tail_from_rad;
    frame->tail_rad[1] = tail_to_rad;
    frame->tail_rate_rad_s[0] = rate_before;
    frame->tail_rate_rad_s[1] = end_rate(felt->slope_rad_s);
    frame->yaw_per_tail = plant->yaw_per_tail;
    frame->sway_m_per_rad = plant->sway_m_per_rad;
    frame->tilt_rad[0] = felt->tilt_rad;
    frame->tilt_rad[1] = felt->tilt_rad = tilt_next(felt, length_s);
}

void felt_carried(felt_t *felt, double by_x_m_s, double by_y_m_s, double turn_rad) {
    felt->carried_m_s[0] -= by_x_m_s;
    felt->carried_m_s[1] -= by_y_m_s;
    felt->turned_rad -= turn_rad;
}

/* The newest frame that begins before |time_us|, or the oldest one held. */
static const felt_frame_t *frame_at(const felt_t *felt, uint64_t time_us) {
    const uint32_t held = felt->frames < FELT_FRAMES ? felt->frames : FELT_FRAMES;
    uint32_t back = 1;
    while (back < held && felt->frame[(felt->frames - back) % FELT_FRAMES].begin_us > time_us) {
        back++;
    }
    return &felt->frame[(felt->frames - back) % FELT_FRAMES];
}

static double along(const double ends[2], double part) {
    return ends[0] + part * (ends[1] - ends[0]);
}

/* |part| 0...1 of the frame. */
static felt_moment_t moment(const felt_t *felt, const felt_frame_t *frame, double part) {
    const double length_s = (double)(frame->end_us - frame->begin_us) * 1e-6;
    const double steps = part * SUBSTEPS;
    const unsigned i = steps < SUBSTEPS - 1 ? (unsigned)steps : SUBSTEPS - 1;
    const double u = part;
    const double w = 1 - u;
    const double swing = frame->tail_rad[1] - frame->tail_rad[0];
    const double r0 = frame->tail_rate_rad_s[0];
    const double r1 = frame->tail_rate_rad_s[1];
    const double tail =
        frame->tail_rad[0] + swing * u * u * (3 - 2 * u) + length_s * u * w * (r0 * w - r1 * u);
    const double rate = 6 * swing / length_s * u * w + r0 * w * (1 - 3 * u) + r1 * u * (3 * u - 2);
    const double heading = along(frame->heading_rad + i, steps - i);
    const double sine = frame->straight ? frame->sine : sin(heading);
    const double cosine = frame->straight ? frame->cosine : cos(heading);
    const double side = frame->sway_m_per_rad * rate;
    double hand[3];
    for (unsigned axis = 0; axis < 3; axis++) {
        hand[axis] =
            frame->hand_rad[0][axis] + u * (frame->hand_rad[1][axis] - frame->hand_rad[0][axis]);
    }
    return (felt_moment_t){
        .x_m_s = along(frame->vx_m_s + i, steps - i) - side * sine,
        .y_m_s = along(frame->vy_m_s + i, steps - i) + side * cosine,
        .heading_rad = heading,
        .yaw_rad = heading + frame->yaw_per_tail * tail + hand[0],
        .pitch_rad = PITCH_PER_TAIL2 * tail * tail + felt->cone_s * rate + hand[1],
        .roll_rad = frame->tilt_rad[0] + u * (frame->tilt_rad[1] - frame->tilt_rad[0]) +
                    felt->roll_per_tail * tail + felt->roll_s * rate + hand[2],
    };
}

felt_moment_t felt_at(const felt_t *felt, uint64_t time_us) {
    if (felt->frames == 0) {
        return (felt_moment_t){.roll_rad = felt->tilt_rad};
    }
    const felt_frame_t *frame = frame_at(felt, time_us);
    if (time_us <= frame->begin_us || time_us >= frame->end_us) {
        return moment(felt, frame, time_us <= frame->begin_us ? 0 : 1);
    }
    return moment(felt, frame,
                  (double)(time_us - frame->begin_us) / (double)(frame->end_us - frame->begin_us));
}
