#include "chapter4.h"

#include <math.h>

#define PI 3.14159265358979323846
#define BASIS 5u
#define REGRESSORS_MAX (2u * BASIS)

typedef struct {
    const chapter4_t *example;
    double lambda; /* of the reference; also dt / d(real time) */
} task_t;

static uint32_t regressors(const chapter4_t *example) { return example->varying ? 2u * BASIS : 2u; }

uint16_t chapter4_estimates(const chapter4_t *example) {
    const uint32_t rows = example->block ? 1u : 2u;
    return (uint16_t)(regressors(example) * rows + (example->varying ? 1u : 0u));
}

static void wanted(const void *with, double t, double *to) {
    const double real = t / ((const task_t *)with)->lambda;
    to[0] = (cos(real) + 1.5) * sin(t);
    to[1] = (sin(real) + 1.5) * (1.0 - cos(t));
}

/* In real time. */
static void wanted_slope(double lambda, double t, double *to) {
    const double real = t / lambda;
    to[0] = -sin(real) * sin(t) + (cos(real) + 1.5) * lambda * cos(t);
    to[1] = cos(real) * (1.0 - cos(t)) + (sin(real) + 1.5) * lambda * sin(t);
}

static void known(const chapter4_t *example, const double *state, double *f) {
    f[0] = example->varying ? state[0] + sin(state[1]) : state[0] * state[0] * state[0];
    f[1] = sin(state[0] + state[1]);
}

static void parameters(const chapter4_t *example, double real, double *theta) {
    theta[0] = example->varying ? exp(sin(real)) + 2.0 * sin(cos(real)) : 3.0;
    theta[1] = example->varying ? sin(real) * sin(real) : 2.0;
}

static void slope(const void *with, double t, const double *state, const double *input,
                  double *to) {
    const task_t *task = with;
    double f[2];
    double theta[2];
    known(task->example, state, f);
    parameters(task->example, t / task->lambda, theta);
    to[0] = (theta[0] * f[0] + 2.0 * input[0]) / task->lambda;
    to[1] = (theta[1] * f[1] + input[1]) / task->lambda;
}

/* f, or in example 2 Xi f: each entry of f times each function of the basis, in real time. */
static void regress(const task_t *task, double t, const double *f, double *to) {
    if (!task->example->varying) {
        to[0] = f[0];
        to[1] = f[1];
        return;
    }
    const double real = t / task->lambda;
    const double basis[BASIS] = {1.0, sin(real), cos(real), sin(2.0 * real), cos(2.0 * real)};
    for (uint32_t j = 0; j < 2u * BASIS; j++) {
        to[j] = f[j / BASIS] * basis[j % BASIS];
    }
}

/* The regressor of lambda, on both channels. */
static void bound_term(const task_t *task, const double *f, const double *error, number_t *phi) {
    const double g = 0.5 * (fabs(f[0]) + 2.0 * fabs(f[1]));
    for (uint32_t r = 0; r < LOOP_STATES; r++) {
        const number_t steep = (number_t)(g * error[r] / (task->lambda * task->example->epsilon));
        phi[r] = (number_t)g *
                 (task->example->smooth ? feedback_tanh(steep) : feedback_sign((number_t)error[r]));
    }
}

static void look(const void *with, double t, const double *state, loop_view_t *view) {
    const task_t *task = with;
    const chapter4_t *example = task->example;
    double f[2];
    double regressor[REGRESSORS_MAX];
    double is[LOOP_STATES];
    double rate[LOOP_STATES];
    wanted(task, t, is);
    wanted_slope(task->lambda, t, rate);
    for (uint32_t r = 0; r < LOOP_STATES; r++) {
        is[r] -= state[r];
        view->error[r] = (number_t)is[r];
        view->feed_forward[r] = (number_t)rate[r];
    }
    view->input_gain[0] = NUMBER(2);
    view->input_gain[1] = NUMBER(1);
    known(example, state, f);
    regress(task, t, f, regressor);
    const uint32_t count = regressors(example);
    number_t *phi = view->phi;
    for (uint32_t r = 0; r < LOOP_STATES; r++) {
        for (uint32_t c = 0; c < count; c++) {
            if (!example->block || c / (count / 2u) == r) {
                phi[r] = -(number_t)regressor[c];
                phi += LOOP_STATES;
            }
        }
    }
    if (example->varying) {
        bound_term(task, f, is, phi);
    }
}

static void fill_rules(const task_t *task, uint16_t estimates, feedback_rule_t *rules) {
    const chapter4_t *example = task->example;
    for (uint32_t j = 0; j < estimates; j++) {
        const bool bound = example->varying && j + 1u == estimates;
        const double leak = bound ? example->leak_lambda : example->leak_eta;
        const double high = bound ? example->lambda_max : 1e30;
        rules[j] = (feedback_rule_t){.gain = (number_t)(1.0 / task->lambda),
                                     .leak = (number_t)(example->smooth ? leak : 0.0),
                                     .dead_zone = (number_t)(bound ? example->dead_zone : 0.0),
                                     .low = (number_t)(-high),
                                     .high = (number_t)high};
    }
}

feedback_result_t chapter4_trial(const chapter4_t *example, uint32_t iteration, number_t *bank,
                                 double *trace, loop_report_t *report) {
    const task_t task = {example, fabs(sin((double)iteration)) + 0.5};
    feedback_rule_t rules[LOOP_ESTIMATES_MAX];
    const feedback_t law = {.channels = LOOP_STATES,
                            .estimates = chapter4_estimates(example),
                            .gamma = {NUMBER(2), NUMBER(1)},
                            .input_gain_min = NUMBER(0.5),
                            .rules = rules};
    fill_rules(&task, law.estimates, rules);
    const loop_plant_t plant = {
        .task = &task, .duration = 2.0 * PI, .wanted = wanted, .look = look, .slope = slope};
    double state[LOOP_STATES] = {0.0, 0.0};
    return loop_trial(&plant, &law, example->grid, state, bank, trace, report);
}
