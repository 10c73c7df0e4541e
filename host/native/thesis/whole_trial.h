/* A learner's samples in one call, for callers to whom a call is dear. */
#ifndef WHOLE_TRIAL_H
#define WHOLE_TRIAL_H

#include "learner.h"

/* learner_output of every sample into |input| (samples values). */
void whole_trial_input(const learner_t *learner, double *input);

/* learner_measure for every sample, then learner_end. |error|: samples values; NaN = not measured.
 */
law_result_t whole_trial_learn(learner_t *learner, const double *error, uint16_t valid,
                               law_report_t *report);

#endif
