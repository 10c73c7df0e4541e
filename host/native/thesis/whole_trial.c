#include "whole_trial.h"

void whole_trial_input(const buffer_learner_t *learner, double *input) {
    for (uint16_t k = 0; k < learner->config.samples; k++) {
        input[k] = (double)buffer_learner_output(learner, k);
    }
}

law_result_t whole_trial_learn(buffer_learner_t *learner, const double *error, uint16_t valid,
                               law_report_t *report) {
    for (uint16_t k = 0; k < learner->config.samples; k++) {
        (void)buffer_learner_measure(learner, k, (number_t)error[k]);
    }
    return buffer_learner_end(learner, valid, report);
}
