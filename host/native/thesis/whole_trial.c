#include "whole_trial.h"

void whole_trial_input(const learner_t *learner, double *input) {
    for (uint16_t k = 0; k < learner->config.samples; k++) {
        input[k] = (double)learner_output(learner, k);
    }
}

law_result_t whole_trial_learn(learner_t *learner, const double *error, uint16_t valid,
                               law_report_t *report) {
    for (uint16_t k = 0; k < learner->config.samples; k++) {
        (void)learner_measure(learner, k, (number_t)error[k]);
    }
    return learner_end(learner, valid, report);
}
