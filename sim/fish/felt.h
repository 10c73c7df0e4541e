/*
 * What a sensor in the fish's body takes part in: velocity and heading, the sway and yaw that go
 * with the tail, roll and pitch. A history, because a sensor averages and sends late.
 *
 * Angles follow the tail smoothly (cubics with continuous rate between the servo's frames), so that
 * sway has an acceleration. Where somebody puts the fish at the start, its velocity over ground and
 * its heading jump; the felt velocity goes on without a jump, the felt heading turns after it.
 */
#ifndef SIM_FELT_H
#define SIM_FELT_H

#include "water/plant.h"

#include <stdint.h>

#define FELT_FRAMES 64u /* 1.28 s; a power of two */

typedef struct {
    uint64_t begin_us, end_us;
    double vx_m_s[SUBSTEPS + 1], vy_m_s[SUBSTEPS + 1], heading_rad[SUBSTEPS + 1];
    bool straight;                          /* the heading stays the same ... */
    double sine, cosine;                    /* ... and these with it */
    double tail_rad[2], tail_rate_rad_s[2]; /* about the mean, at the ends */
    double tilt_rad[2];
    double yaw_per_tail, sway_m_per_rad;
    double hand_rad[2][3]; /* what a hand adds to yaw, pitch and roll, at the ends */
} felt_frame_t;

typedef struct {
    double roll_per_tail, roll_s, cone_s; /* the latter two: roll and pitch per rate of the tail */
    uint64_t tremor_key;
    double tremor_rad;                       /* of the hand that holds it; 0 = none */
    double held;                             /* 1 = by a hand, 0 = free */
    bool by_hand;                            /* somebody has turned it ever ... */
    double turn_from_rad[3], turn_to_rad[3]; /* ... yaw, pitch, roll ... */
    uint64_t turn_begin_us, turn_end_us;     /* ... smoothly from then to then */
    felt_frame_t frame[FELT_FRAMES];
    uint32_t frames;       /* added; the newest FELT_FRAMES are held */
    double carried_m_s[2]; /* felt velocity minus velocity over ground */
    double turned_rad;     /* felt heading minus heading */
    double slope_rad_s[3]; /* of the tail in the newest frames, newest first */
    double tilt_rad, tilt_wanted_rad;
} felt_t;

/* Level frame: x along the tank, y to the right, z down. Angles in rad, yaw and heading against x;
 * yaw is the body's, heading that of its path. */
typedef struct {
    double x_m_s, y_m_s;
    double heading_rad;
    double yaw_rad, pitch_rad, roll_rad;
} felt_moment_t;

void felt_init(felt_t *felt, const sim_config_t *config);

/* The frame that ends at |end_us|. |plant|: its trace is of that frame. |in_hand|: somebody holds
 * the fish. */
void felt_frame(felt_t *felt, const plant_t *plant, bool in_hand, double tail_from_rad,
                double tail_to_rad, uint64_t begin_us, uint64_t end_us);

/* The velocity over ground jumps without being felt, and the heading by |turn_rad|. */
void felt_carried(felt_t *felt, double by_x_m_s, double by_y_m_s, double turn_rad);

/* A hand turns it within |within_s|, > 0, so that yaw, pitch and roll are that much more than
 * without it; turns count. */
void felt_turn(felt_t *felt, const double angle_rad[3], double within_s, uint64_t now_us);

/* Between the oldest frame held and the newest; beyond them the state at that end. */
felt_moment_t felt_at(const felt_t *felt, uint64_t time_us);

#endif
