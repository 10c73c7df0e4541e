#include "reactive.h"

#include <math.h>
#include <stdbool.h>

#define PI 3.14159265358979323846

/* Moments of the water's mass along the tail link, from the hinge on: the integrals of m, m*s and
 * m*s^2, with m = pi/4 * density * depth^2 of peduncle and fin. */
typedef struct {
    double m0, m1, m2;
    double edge; /* m at the fin's edge */
} tail_mass_t;

typedef struct {
    double sine, cosine, rate;
} tail_angle_t;

static double mass_per_m(const reactive_config_t *config, double depth_m) {
    return 0.25 * PI * config->water_kg_m3 * depth_m * depth_m;
}

static tail_mass_t tail_mass(const reactive_config_t *config) {
    const double end = config->tail_m;
    const double begin = end - config->fin_m;
    const double thin = mass_per_m(config, config->peduncle_depth_m);
    const double fin = mass_per_m(config, config->fin_depth_m);
    return (tail_mass_t){
        .m0 = thin * begin + fin * (end - begin),
        .m1 = (thin * begin * begin + fin * (end * end - begin * begin)) / 2,
        .m2 = (thin * begin * begin * begin + fin * (end * end * end - begin * begin * begin)) / 3,
        .edge = fin,
    };
}

/* Momentum = matrix * speeds + carried * tail rate. The normal speed of the link at s is
 * w(s) = a . (surge, sway, yaw) - s * rate with a = (-sin, cos, -hinge*cos - s). */
typedef struct {
    double matrix[3][3];
    double carried[3];
} inertia_t;

static inertia_t inertia(const reactive_config_t *config, tail_angle_t tail) {
    const tail_mass_t m = tail_mass(config);
    const double b[3] = {-tail.sine, tail.cosine, -config->hinge_m * tail.cosine};
    inertia_t found = {.matrix = {{config->mass_kg, 0, 0},
                                  {0, config->sway_mass_kg, 0},
                                  {0, 0, config->inertia_kg_m2}}};
    const double e[3] = {0, 0, -1};
    for (unsigned i = 0; i < 3; i++) {
        for (unsigned j = 0; j < 3; j++) {
            found.matrix[i][j] +=
                m.m0 * b[i] * b[j] + m.m1 * (b[i] * e[j] + e[i] * b[j]) + m.m2 * e[i] * e[j];
        }
        found.carried[i] = -(m.m1 * b[i] + m.m2 * e[i]);
    }
    return found;
}

/* Cramer's rule; the matrix is symmetric and positive definite. */
static void solve(const double a[3][3], const double y[3], double x[3]) {
    const double c0 = a[1][1] * a[2][2] - a[1][2] * a[1][2];
    const double c1 = a[0][2] * a[1][2] - a[0][1] * a[2][2];
    const double c2 = a[0][1] * a[1][2] - a[0][2] * a[1][1];
    const double c3 = a[0][0] * a[2][2] - a[0][2] * a[0][2];
    const double c4 = a[0][1] * a[0][2] - a[0][0] * a[1][2];
    const double c5 = a[0][0] * a[1][1] - a[0][1] * a[0][1];
    const double by = 1 / (a[0][0] * c0 + a[0][1] * c1 + a[0][2] * c2);
    x[0] = by * (c0 * y[0] + c1 * y[1] + c2 * y[2]);
    x[1] = by * (c1 * y[0] + c3 * y[1] + c4 * y[2]);
    x[2] = by * (c2 * y[0] + c4 * y[1] + c5 * y[2]);
}

typedef struct {
    double x_n, y_n, yaw_nm;
} force_t;

static void speeds(const reactive_config_t *config, tail_angle_t tail, const double momentum[3],
                   double found[3]) {
    const inertia_t m = inertia(config, tail);
    const double own[3] = {momentum[0] - m.carried[0] * tail.rate,
                           momentum[1] - m.carried[1] * tail.rate,
                           momentum[2] - m.carried[2] * tail.rate};
    solve(m.matrix, own, found);
}

/* Of the link, |s| behind the hinge, across itself. */
static double across_m_s(const reactive_config_t *config, tail_angle_t tail, const double q[3],
                         double s) {
    return -q[0] * tail.sine + (q[1] - q[2] * config->hinge_m) * tail.cosine -
           s * (q[2] + tail.rate);
}

/* A force |n| across the link at |s|. */
static void add_across(const reactive_config_t *config, tail_angle_t tail, double n, double s,
                       force_t *force) {
    force->x_n -= n * tail.sine;
    force->y_n += n * tail.cosine;
    force->yaw_nm -= n * (config->hinge_m * tail.cosine + s);
}

/* What the theory leaves at the edge: m*w*w/2 along the link, m*w*u across it. */
static force_t shed(const reactive_config_t *config, tail_angle_t tail, const double q[3]) {
    const double w = across_m_s(config, tail, q, config->tail_m);
    const double u = q[0] * tail.cosine + (q[1] - q[2] * config->hinge_m) * tail.sine;
    const double m = mass_per_m(config, config->fin_depth_m) * (1 + copysign(config->asymmetry, w));
    const double along_n = 0.5 * m * w * w;
    force_t force = {
        .x_n = along_n * tail.cosine,
        .y_n = along_n * tail.sine,
        .yaw_nm = -along_n * config->hinge_m * tail.sine,
    };
    add_across(config, tail, -m * w * u, config->tail_m, &force);
    return force;
}

/* Gauss's rule over the fin. */
static void add_fin_drag(const reactive_config_t *config, tail_angle_t tail, const double q[3],
                         force_t *force) {
    static const double place[3] = {0.112701665379258, 0.5, 0.887298334620742};
    static const double weight[3] = {5.0 / 18, 8.0 / 18, 5.0 / 18};
    const double area_m2 = config->fin_m * config->fin_depth_m;
    for (unsigned i = 0; i < 3; i++) {
        const double s = config->tail_m - config->fin_m * (1 - place[i]);
        const double w = across_m_s(config, tail, q, s);
        const double n = -0.5 * config->water_kg_m3 * config->fin_drag * area_m2 * fabs(w) * w;
        add_across(config, tail, n * weight[i], s, force);
    }
}

static void add_body_drag(const reactive_config_t *config, double amplitude_rad, const double q[3],
                          force_t *force) {
    const double grown = 1 + config->drag_per_rad * amplitude_rad;
    force->x_n -= grown * (config->drag_kg_m * fabs(q[0]) + config->drag_linear_kg_s) * q[0];
    force->y_n -= config->sway_drag_kg_m * fabs(q[1]) * q[1];
    force->yaw_nm -= config->yaw_drag_kg_m2 * fabs(q[2]) * q[2];
}

#define REFERENCE_RAD 0.5 /* where every exponent gives the theory's thrust */
#define COLLAPSE_WIDTH_RAD 0.1

static double thrust_part(const reactive_config_t *config, double amplitude_rad) {
    double part =
        amplitude_rad > 0 ? pow(amplitude_rad / REFERENCE_RAD, config->thrust_exponent - 2) : 0;
    if (config->collapse_rad > 0 && amplitude_rad > config->collapse_rad) {
        const double beyond = (amplitude_rad - config->collapse_rad) / COLLAPSE_WIDTH_RAD;
        part *= exp(-beyond * beyond);
    }
    return part;
}

enum { SURGE, SWAY, YAW, X, Y, HEADING, WAKE, VALUES };

/* Of one step: what does not change meanwhile. */
typedef struct {
    const reactive_config_t *config;
    double amplitude_rad;
    double thrust_part; /* of the theory's */
    bool late;
    double late_n; /* the thrust of |delay_s| ago, where there is a delay */
} step_t;

static void rates(const step_t *step, tail_angle_t tail, const double state[VALUES],
                  double rate[VALUES]) {
    const reactive_config_t *config = step->config;
    double q[3];
    speeds(config, tail, state, q);
    force_t force = shed(config, tail, q);
    const double thrust_n = step->late ? step->late_n : force.x_n * step->thrust_part;
    rate[WAKE] = config->wake_s > 0 ? (thrust_n - state[WAKE]) / config->wake_s : 0;
    const double late = config->wake_s > 0 ? config->wake_share : 0;
    force.x_n = (1 - late) * thrust_n + late * state[WAKE];
    add_fin_drag(config, tail, q, &force);
    add_body_drag(config, step->amplitude_rad, q, &force);
    rate[SURGE] = q[2] * state[SWAY] + force.x_n;
    rate[SWAY] = -q[2] * state[SURGE] + force.y_n;
    rate[YAW] = q[1] * state[SURGE] - q[0] * state[SWAY] + force.yaw_nm;
    rate[X] = q[0] * cos(state[HEADING]) - q[1] * sin(state[HEADING]);
    rate[Y] = q[0] * sin(state[HEADING]) + q[1] * cos(state[HEADING]);
    rate[HEADING] = q[2];
}

static tail_angle_t tail_at(double rad, double rate) {
    return (tail_angle_t){.sine = sin(rad), .cosine = cos(rad), .rate = rate};
}

void reactive_init(reactive_t *fish) { *fish = (reactive_t){.momentum = {0, 0, 0}}; }

reactive_speed_t reactive_speed(const reactive_t *fish, const reactive_config_t *config,
                                double tail_rad, double tail_rad_s) {
    double q[3];
    speeds(config, tail_at(tail_rad, tail_rad_s), fish->momentum, q);
    return (reactive_speed_t){q[0], q[1], q[2]};
}

void reactive_set_speed(reactive_t *fish, const reactive_config_t *config, double tail_rad,
                        double tail_rad_s, reactive_speed_t speed) {
    const inertia_t m = inertia(config, tail_at(tail_rad, tail_rad_s));
    const double q[3] = {speed.surge_m_s, speed.sway_m_s, speed.yaw_rad_s};
    for (unsigned i = 0; i < 3; i++) {
        fish->momentum[i] = m.carried[i] * tail_rad_s + m.matrix[i][0] * q[0] +
                            m.matrix[i][1] * q[1] + m.matrix[i][2] * q[2];
    }
}

#define ENVELOPE_S 0.3

static double follow_envelope(reactive_t *fish, double rad, double rate, double omega, double dt) {
    const double now = rad * rad + rate * rate / (omega * omega);
    fish->envelope_rad2 += (1 - exp(-dt / ENVELOPE_S)) * (now - fish->envelope_rad2);
    return sqrt(fish->envelope_rad2);
}

/* What is shed now joins the ring; what was shed a delay ago. */
static double delayed(reactive_t *fish, const reactive_config_t *config, tail_angle_t tail,
                      double part) {
    double q[3];
    speeds(config, tail, fish->momentum, q);
    const double steps = config->delay_s / REACTIVE_STEP_S;
    const unsigned whole = (unsigned)steps;
    const unsigned now = fish->step++;
    fish->thrust_n[now % REACTIVE_RING] = part * shed(config, tail, q).x_n;
    const double late = fish->thrust_n[(now - whole) % REACTIVE_RING];
    const double later = fish->thrust_n[(now - whole - 1u) % REACTIVE_RING];
    return late + (steps - whole) * (later - late);
}

static void add_steps(reactive_t *fish, const double sum[VALUES]) {
    for (unsigned i = 0; i < 3; i++) {
        fish->momentum[i] += sum[i];
    }
    fish->x_m += sum[X];
    fish->y_m += sum[Y];
    fish->yaw_rad += sum[HEADING];
    fish->wake_n += sum[WAKE];
}

void reactive_step(reactive_t *fish, const reactive_config_t *config, double gain,
                   double tail_from_rad, double tail_to_rad, double omega_rad_s, double dt_s) {
    const double rate = (tail_to_rad - tail_from_rad) / dt_s;
    const double middle_rad = 0.5 * (tail_from_rad + tail_to_rad);
    const tail_angle_t tail[3] = {tail_at(tail_from_rad, rate), tail_at(middle_rad, rate),
                                  tail_at(tail_to_rad, rate)};
    step_t step = {
        .config = config,
        .amplitude_rad = follow_envelope(fish, middle_rad, rate, omega_rad_s, dt_s),
        .late = config->delay_s > 0,
    };
    step.thrust_part = gain * gain * thrust_part(config, step.amplitude_rad);
    step.late_n = step.late ? delayed(fish, config, tail[0], step.thrust_part) : 0;
    static const double ahead[4] = {0, 0.5, 0.5, 1};
    static const double weight[4] = {1.0 / 6, 1.0 / 3, 1.0 / 3, 1.0 / 6};
    const double from[VALUES] = {fish->momentum[0], fish->momentum[1], fish->momentum[2], fish->x_m,
                                 fish->y_m,         fish->yaw_rad,     fish->wake_n};
    double sum[VALUES] = {0}, slope[VALUES] = {0};
    for (unsigned i = 0; i < 4; i++) {
        double state[VALUES];
        for (unsigned k = 0; k < VALUES; k++) {
            state[k] = from[k] + ahead[i] * dt_s * slope[k];
        }
        rates(&step, tail[(i + 1) / 2], state, slope);
        for (unsigned k = 0; k < VALUES; k++) {
            sum[k] += weight[i] * dt_s * slope[k];
        }
    }
    add_steps(fish, sum);
}
