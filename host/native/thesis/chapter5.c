#include "chapter5.h"

#include <math.h>
#include <stddef.h>

#define PI 3.14159265358979323846
#define DURATION 0.5
#define GAMMA_1 NUMBER(3)
#define GAMMA_2 NUMBER(2)
#define GAMMA_NORM GAMMA_1 /* of the diagonal (3, 2) */
#define XI NUMBER(0.1)
/* The plant's own gain on trial 1 goes down to 0.28. */
#define GAIN_MIN NUMBER(1e-3)

uint16_t chapter5_estimates(const chapter5_t *example) { return example->uncertain ? 2u : 1u; }

static void wanted(const void *with, double t, double *to) {
    (void)with;
    to[0] = 0.5 * sin(8.0 * PI * t) + 1.0;
    to[1] = -0.25 * cos(16.0 * PI * t) - 0.5;
}

static void known(const double *state, double *f) {
    f[0] = state[0] + sin(state[1]);
    f[1] = 2.0 * sin(state[0] + state[1]);
}

static void input_gain(double t, const double *state, double *b) {
    b[0] = 2.0 + sin(state[0]) + 0.1 * sin(2.0 * PI * t);
    b[1] = 1.0 + sin(state[1]) + 0.1 * sin(4.0 * PI * t);
}

static double actuated(const chapter5_t *example, double input) {
    return fmax(-example->input_max, fmin(example->input_max, input));
}

static void slope(const void *with, double t, const double *state, const double *input,
                  double *to) {
    const chapter5_t *example = with;
    const double part = example->uncertain ? 1.0 : 0.0;
    const double known_part = 1.0 - part * 0.1 * sin(state[0]);
    double f[2];
    double b[2];
    known(state, f);
    input_gain(t, state, b);
    to[0] = f[0] + 4.0 * PI * cos(8.0 * PI * t) +
            b[0] * (known_part * actuated(example, input[0]) + part * 0.1 * sin(state[0]));
    to[1] = f[1] + 4.0 * PI * sin(16.0 * PI * t) +
            b[1] * (known_part * actuated(example, input[1]) + part * 0.2 * sin(state[1]));
}

static double bound_of_f(const chapter5_t *example, const double *state) {
    double f[2];
    known(state, f);
    return example->bound * hypot(f[0], f[1]);
}

static double bound_of_d(const chapter5_t *example, const double *state) {
    const double first = sin(state[0]);
    const double second = pow(sin(state[1]), (double)example->beta_power);
    return 0.2 * sqrt(first * first + 4.0 * second);
}

static void direction_of(const chapter5_t *example, const loop_view_t *view, number_t *direction) {
    feedback_direction(LOOP_STATES, view->error, view->input_gain, (number_t)example->softness,
                       direction);
}

static void basics(double t, const double *state, loop_view_t *view) {
    double is[LOOP_STATES];
    double b[LOOP_STATES];
    wanted(NULL, t, is);
    input_gain(t, state, b);
    for (uint32_t r = 0; r < LOOP_STATES; r++) {
        view->error[r] = (number_t)(is[r] - state[r]);
        view->input_gain[r] = (number_t)b[r];
    }
}

static void look(const void *with, double t, const double *state, loop_view_t *view) {
    const chapter5_t *example = with;
    basics(t, state, view);
    const number_t rho = (number_t)bound_of_f(example, state);
    for (uint32_t r = 0; r < LOOP_STATES; r++) {
        const number_t steep = rho * view->error[r] / (number_t)example->epsilon;
        view->phi[r] =
            rho * (example->smooth ? feedback_tanh(steep) : feedback_sign(view->error[r]));
    }
    if (example->uncertain) {
        const number_t beta = (number_t)bound_of_d(example, state);
        number_t direction[LOOP_STATES];
        direction_of(example, view, direction);
        for (uint32_t r = 0; r < LOOP_STATES; r++) {
            view->phi[LOOP_STATES + r] = view->input_gain[r] * beta * direction[r];
        }
    }
}

static number_t inverse_gain_norm(const chapter5_t *example, const loop_view_t *view) {
    const number_t first = number_abs(view->input_gain[0]);
    const number_t second = number_abs(view->input_gain[1]);
    const number_t smaller = first < second ? first : second;
    const number_t larger = first < second ? second : first;
    return NUMBER(1) / (example->inverse_norm ? smaller : larger);
}

static void add_reserve(const void *with, double t, const double *state, const number_t *estimates,
                        number_t *input) {
    const chapter5_t *example = with;
    loop_view_t view = {0};
    basics(t, state, &view);
    const number_t *error = view.error;
    const feedback_reserve_t reserve = {.kappa = (number_t)(0.1 * fabs(sin(state[0]))),
                                        .xi = XI,
                                        .gamma_norm = GAMMA_NORM,
                                        .error_norm =
                                            number_sqrt(error[0] * error[0] + error[1] * error[1]),
                                        .inverse_gain_norm = inverse_gain_norm(example, &view),
                                        .root_channels = number_sqrt((number_t)LOOP_STATES),
                                        .alpha = (number_t)bound_of_f(example, state),
                                        .theta = estimates[0],
                                        .beta = (number_t)bound_of_d(example, state),
                                        .eta = estimates[1],
                                        .smooth = example->smooth};
    number_t direction[LOOP_STATES];
    direction_of(example, &view, direction);
    for (uint32_t r = 0; r < LOOP_STATES; r++) {
        input[r] += feedback_reserve(&reserve) * direction[r];
    }
}

feedback_result_t chapter5_trial(const chapter5_t *example, double *state, number_t *bank,
                                 double *trace, loop_report_t *report) {
    const feedback_rule_t rules[2] = {{.gain = (number_t)example->gain_theta,
                                       .leak = (number_t)example->leak,
                                       .dead_zone = (number_t)example->dead_zone,
                                       .low = (number_t)(-example->theta_max),
                                       .high = (number_t)example->theta_max},
                                      {.gain = (number_t)example->gain_eta,
                                       .leak = (number_t)example->leak,
                                       .low = NUMBER(-1e30),
                                       .high = NUMBER(1e30)}};
    const feedback_t law = {.channels = LOOP_STATES,
                            .estimates = chapter5_estimates(example),
                            .gamma = {GAMMA_1, GAMMA_2},
                            .input_gain_min = GAIN_MIN,
                            .rules = rules};
    const loop_plant_t plant = {.task = example,
                                .duration = DURATION,
                                .wanted = wanted,
                                .look = look,
                                .slope = slope,
                                .add = example->uncertain ? add_reserve : NULL};
    return loop_trial(&plant, &law, example->grid, state, bank, trace, report);
}
