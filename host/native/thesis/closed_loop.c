#include "closed_loop.h"

#include <math.h>
#include <string.h>

/* Where the trial is. |old|: the last trial's estimates at the nodes before and after; |now|: this
 * one's at the node before. */
typedef struct {
    const loop_plant_t *plant;
    const feedback_t *law;
    double step;
    number_t old[2][LOOP_ESTIMATES_MAX];
    number_t now[LOOP_ESTIMATES_MAX];
} trial_t;

/* The law at |part| of a step: 0, 0.5 or 1. */
static feedback_result_t correct(const trial_t *trial, double t, const double *state, double part,
                                 number_t *now, double *input) {
    const loop_plant_t *plant = trial->plant;
    loop_view_t view = {0};
    plant->look(plant->task, t, state, &view);
    const feedback_moment_t moment = {.error = view.error,
                                      .feed_forward = view.feed_forward,
                                      .input_gain = view.input_gain,
                                      .phi = view.phi};
    number_t between[LOOP_ESTIMATES_MAX];
    number_t corrected[LOOP_STATES];
    const uint16_t estimates = trial->law->estimates;
    for (uint32_t j = 0; j < estimates; j++) {
        between[j] = trial->old[0][j] + (number_t)part * (trial->old[1][j] - trial->old[0][j]);
    }
    const feedback_result_t result = feedback_step(trial->law, &moment, between, now, corrected);
    if (result == FEEDBACK_OK && plant->add != NULL) {
        plant->add(plant->task, t, state, now, corrected);
    }
    for (uint32_t r = 0; result == FEEDBACK_OK && r < LOOP_STATES; r++) {
        input[r] = (double)corrected[r];
    }
    return result;
}

static void ahead(const double *state, double step, const double *slope, double *to) {
    for (uint32_t r = 0; r < LOOP_STATES; r++) {
        to[r] = state[r] + step * slope[r];
    }
}

/* Runge-Kutta; with |held| NULL the law is asked again in every stage but the first. */
static feedback_result_t runge_kutta(const trial_t *trial, double t, const double *first, bool held,
                                     double *state) {
    static const double parts[4] = {0.0, 0.5, 0.5, 1.0};
    static const double weights[4] = {1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0};
    const loop_plant_t *plant = trial->plant;
    double slope[LOOP_STATES] = {0};
    double sum[LOOP_STATES] = {0};
    double input[LOOP_STATES] = {first[0], first[1]};
    for (uint32_t stage = 0; stage < 4u; stage++) {
        const double at = t + parts[stage] * trial->step;
        double there[LOOP_STATES];
        ahead(state, parts[stage] * trial->step, slope, there);
        if (stage > 0 && !held) {
            number_t unused[LOOP_ESTIMATES_MAX];
            const feedback_result_t result = correct(trial, at, there, parts[stage], unused, input);
            if (result != FEEDBACK_OK) {
                return result;
            }
        }
        plant->slope(plant->task, at, there, input, slope);
        ahead(sum, weights[stage], slope, sum);
    }
    ahead(state, trial->step, sum, state);
    return FEEDBACK_OK;
}

static feedback_result_t integrate(const trial_t *trial, loop_scheme_t scheme, double t,
                                   const double *input, double *state) {
    if (scheme != LOOP_EULER) {
        return runge_kutta(trial, t, input, scheme == LOOP_HELD, state);
    }
    double slope[LOOP_STATES];
    trial->plant->slope(trial->plant->task, t, state, input, slope);
    ahead(state, trial->step, slope, state);
    return FEEDBACK_OK;
}

static void note(const trial_t *trial, double t, const double *state, const double *input,
                 const double *before, double *row, loop_report_t *report) {
    double wanted[LOOP_STATES];
    trial->plant->wanted(trial->plant->task, t, wanted);
    for (uint32_t r = 0; r < LOOP_STATES; r++) {
        report->max_abs_error[r] = fmax(report->max_abs_error[r], fabs(wanted[r] - state[r]));
        report->max_abs_input[r] = fmax(report->max_abs_input[r], fabs(input[r]));
        report->input_variation[r] += before != NULL ? fabs(input[r] - before[r]) : 0.0;
    }
    for (uint32_t j = 0; j < trial->law->estimates; j++) {
        report->max_estimate[j] = fmax(report->max_estimate[j], fabs((double)trial->now[j]));
    }
    if (row != NULL) {
        const double values[LOOP_TRACE_COLUMNS] = {t,         state[0], state[1], wanted[0],
                                                   wanted[1], input[0], input[1]};
        memcpy(row, values, sizeof values);
    }
}

feedback_result_t loop_trial(const loop_plant_t *plant, const feedback_t *law, loop_grid_t grid,
                             double *state, number_t *bank, double *trace, loop_report_t *report) {
    trial_t trial = {.plant = plant, .law = law, .step = plant->duration / (double)grid.steps};
    const size_t row = law->estimates;
    const size_t row_bytes = row * sizeof(number_t);
    double input[LOOP_STATES] = {0};
    double before[LOOP_STATES] = {0};
    *report = (loop_report_t){0};
    if (feedback_check(law) != FEEDBACK_OK || law->channels != LOOP_STATES || grid.steps == 0 ||
        law->estimates > LOOP_ESTIMATES_MAX) {
        return FEEDBACK_BAD_CONFIG;
    }
    for (uint32_t k = 0; k <= grid.steps; k++) {
        const double t = plant->duration * (double)k / (double)grid.steps;
        memcpy(trial.old[0], bank + k * row, row_bytes);
        memcpy(trial.old[1], bank + (k < grid.steps ? k + 1u : k) * row, row_bytes);
        memcpy(before, input, sizeof before);
        feedback_result_t result = correct(&trial, t, state, 0.0, trial.now, input);
        if (result == FEEDBACK_OK) {
            memcpy(bank + k * row, trial.now, row_bytes);
            note(&trial, t, state, input, k > 0 ? before : NULL,
                 trace != NULL ? trace + (size_t)k * LOOP_TRACE_COLUMNS : NULL, report);
        }
        if (result == FEEDBACK_OK && k < grid.steps) {
            result = integrate(&trial, grid.scheme, t, input, state);
        }
        if (result != FEEDBACK_OK) {
            return result;
        }
    }
    return FEEDBACK_OK;
}
