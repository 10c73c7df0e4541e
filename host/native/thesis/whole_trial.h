/* A learner's samples in one call, for callers to whom a call is dear. */
#ifndef WHOLE_TRIAL_H
#define WHOLE_TRIAL_H

#include "learner.h"

/* buffer_learner_output of every sample into |input| (samples values). */
void whole_trial_input(const buffer_learner_t *learner, double *input);

/* buffer_learner_measure for every sample, then buffer_learner_end. |error|: samples values; NaN =
 * not measured.
 */
law_result_t whole_trial_learn(buffer_learner_t *learner, const double *error, uint16_t valid,
                               law_report_t *report);

#endif
