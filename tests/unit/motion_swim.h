/*
 * A swim whose every motion is a formula, in double precision: the frames are what a perfect IMU
 * would send, means over their windows.
 */
#ifndef MOTION_SWIM_H
#define MOTION_SWIM_H

#include "imu/frame.h"

#include <math.h>

#define PI 3.14159265358979323846
#define G 9.81
#define DEG (PI / 180.0)

/* All swings begin with the swim, in the first |grow_s|, and fade out in the last |grow_s|. */
typedef struct {
    double yaw_rad, pitch_rad, roll_rad; /* amplitudes, once per beat */
    double yaw_phase, pitch_phase, roll_phase, sway_phase;
    double sway_m_s2; /* amplitude, once per beat */
    double beat_s, grow_s, length_s;
    double cruise_m_s, ripple_m_s; /* ripple: twice per beat */
    double ahead_m;                /* the IMU lies so far ahead of the axis of yaw */
    double turn_rad, turn_at_s, turn_s;
    double tilt_rad[2]; /* roll and pitch all the time: how the IMU is mounted */
    double bias_rad_s[3];
} swim_t;

/* The IMU at one moment; level frame x = heading at the start, y right, z down. */
typedef struct {
    double velocity[2];
    double course; /* mean heading */
    double force[3], rate[3];
} moment_t;

static swim_t swim;

static void swim_as_usual(void) {
    swim = (swim_t){.yaw_rad = 10.0 * DEG,
                    .pitch_rad = 2.0 * DEG,
                    .roll_rad = 3.0 * DEG,
                    .yaw_phase = 0.4,
                    .pitch_phase = 2.0,
                    .roll_phase = 1.1,
                    .sway_phase = 0.9,
                    .sway_m_s2 = 0.4,
                    .beat_s = 1.0,
                    .grow_s = 10.0,
                    .length_s = 40.0,
                    .cruise_m_s = 0.08,
                    .ripple_m_s = 0.01,
                    .tilt_rad = {0.05, -0.03}};
}

/* 0 to 1 with three smooth derivatives; its value and derivatives by s. */
static void smooth_step(double s, double d[3]) {
    const double x = s < 0.0 ? 0.0 : s > 1.0 ? 1.0 : s;
    d[0] = x * x * x * x * (35.0 + x * (-84.0 + x * (70.0 - 20.0 * x)));
    d[1] = 140.0 * x * x * x * (1.0 - x) * (1.0 - x) * (1.0 - x);
    d[2] = 420.0 * x * x * (1.0 - x) * (1.0 - x) * (1.0 - 2.0 * x);
}

/* How much of everything there is, with its derivatives. */
static void share_at(double t, double d[3]) {
    double up[3], down[3];
    smooth_step(t / swim.grow_s, up);
    smooth_step((t - swim.length_s + swim.grow_s) / swim.grow_s, down);
    d[0] = up[0] - down[0];
    d[1] = (up[1] - down[1]) / swim.grow_s;
    d[2] = (up[2] - down[2]) / (swim.grow_s * swim.grow_s);
}

/* amplitude * share * sin(w t + phase), with derivatives. */
static void swing_at(double t, const double share[3], double amplitude, double w, double phase,
                     double d[3]) {
    const double s = amplitude * sin(w * t + phase), c = amplitude * w * cos(w * t + phase);
    d[0] = share[0] * s;
    d[1] = share[1] * s + share[0] * c;
    d[2] = share[2] * s + 2.0 * share[1] * c - share[0] * w * w * s;
}

static void course_at(double t, double d[3]) {
    const double long_s = swim.turn_s > 0.0 ? swim.turn_s : 1.0;
    smooth_step((t - swim.turn_at_s) / long_s, d);
    d[0] *= swim.turn_rad;
    d[1] *= swim.turn_rad / long_s;
    d[2] *= swim.turn_rad / (long_s * long_s);
}

/* Body rates of yaw, pitch, roll turned in that order, and the body's view of a level vector. */
static void into_body(const double angle[3][3], const double level[3], moment_t *now) {
    const double sy = sin(angle[0][0]), cy = cos(angle[0][0]);
    const double sp = sin(angle[1][0]), cp = cos(angle[1][0]);
    const double sr = sin(angle[2][0]), cr = cos(angle[2][0]);
    now->rate[0] = angle[2][1] - angle[0][1] * sp;
    now->rate[1] = angle[1][1] * cr + angle[0][1] * sr * cp;
    now->rate[2] = angle[0][1] * cr * cp - angle[1][1] * sr;
    const double x = cy * level[0] + sy * level[1], y = cy * level[1] - sy * level[0];
    const double z = sp * x + cp * level[2];
    now->force[0] = cp * x - sp * level[2];
    now->force[1] = cr * y + sr * z;
    now->force[2] = cr * z - sr * y;
}

static moment_t moment_at(double t) {
    moment_t now;
    double share[3], ripple[3], sway[3], course[3], angle[3][3];
    const double w = 2.0 * PI / swim.beat_s;
    share_at(t, share);
    course_at(t, course);
    swing_at(t, share, swim.ripple_m_s, 2.0 * w, 0.3, ripple);
    swing_at(t, share, -swim.sway_m_s2 / (w * w), w, swim.sway_phase, sway);
    swing_at(t, share, swim.yaw_rad, w, swim.yaw_phase, angle[0]);
    swing_at(t, share, swim.pitch_rad, w, swim.pitch_phase, angle[1]);
    swing_at(t, share, swim.roll_rad, w, swim.roll_phase, angle[2]);
    for (int i = 0; i < 3; i++) {
        angle[0][i] += course[i];
    }
    angle[1][0] += swim.tilt_rad[1];
    angle[2][0] += swim.tilt_rad[0];
    const double along = swim.cruise_m_s * share[0] + ripple[0];
    const double along_rate = swim.cruise_m_s * share[1] + ripple[1];
    const double ahead = swim.ahead_m;
    const double sc = sin(course[0]), cc = cos(course[0]);
    const double sy = sin(angle[0][0]), cy = cos(angle[0][0]);
    const double a_along = along_rate - sway[1] * course[1];
    const double a_across = sway[2] + along * course[1];
    now.course = course[0];
    now.velocity[0] = cc * along - sc * sway[1] - ahead * angle[0][1] * sy;
    now.velocity[1] = sc * along + cc * sway[1] + ahead * angle[0][1] * cy;
    const double level[3] = {
        cc * a_along - sc * a_across - ahead * (angle[0][2] * sy + angle[0][1] * angle[0][1] * cy),
        sc * a_along + cc * a_across + ahead * (angle[0][2] * cy - angle[0][1] * angle[0][1] * sy),
        -G};
    into_body(angle, level, &now);
    return now;
}

/* Means from |from_s| to |to_s|: Gauss with two points, exact to the fourth order. */
static imu_frame_t frame_of(double from_s, double to_s) {
    const double middle = 0.5 * (from_s + to_s), off = 0.5 * (to_s - from_s) / sqrt(3.0);
    const moment_t a = moment_at(middle - off), b = moment_at(middle + off);
    imu_frame_t frame = {0};
    for (int i = 0; i < 3; i++) {
        frame.accel_m_s2[i] = (float)(0.5 * (a.force[i] + b.force[i]));
        frame.rate_rad_s[i] = (float)(0.5 * (a.rate[i] + b.rate[i]) + swim.bias_rad_s[i]);
    }
    return frame;
}

#endif
