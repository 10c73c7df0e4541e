/*
 * How a fish moves, whichever plant moves it: its path over ground, the current, and what a hand or
 * a paddle adds.
 */
#ifndef SIM_PLANT_MOTION_H
#define SIM_PLANT_MOTION_H

#include "tail_beat.h"

#include <math.h>

/* The water comes to rest with this time constant. */
#define STIR_S 8.0

/* Over ground. */
typedef struct {
    double x_m, y_m, heading_rad;
    double vx_m_s, vy_m_s;
} plant_point_t;

/* A hand or a paddle, at work for so long still. */
typedef struct {
    double left_s, m_s2;
} plant_stroke_t;

typedef struct {
    double flow_m_s;
    double stir_m_s; /* what the water moves beyond that, dying down */
    double water_v_m_s;
    double way_m; /* along the heading, over ground, since plant_begin */
    double x_m, y_m, heading_rad, cosine, sine;
    plant_stroke_t push, stir;
    plant_point_t trace[SUBSTEPS + 1]; /* at the ends of the substeps of the last frame */
} plant_motion_t;

static inline double plant_current_m_s(const plant_motion_t *motion) {
    return motion->flow_m_s + motion->stir_m_s;
}

/* What it adds to a speed in one substep. */
static inline double plant_stroke(plant_stroke_t *stroke, double dt) {
    if (stroke->left_s <= 0) {
        return 0;
    }
    const double part = dt < stroke->left_s ? dt : stroke->left_s;
    stroke->left_s -= part;
    return stroke->m_s2 * part;
}

/* The stirred water, one substep on. */
static inline void plant_stir_on(plant_motion_t *motion, double dt) {
    motion->stir_m_s += plant_stroke(&motion->stir, dt);
    if (fabs(motion->stir_m_s) > 0) {
        motion->stir_m_s *= exp(-dt / STIR_S);
    }
}

#endif
