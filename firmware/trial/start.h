/* Arming and starting: all that has to be so before the tail moves. Main loop only. */
#ifndef TRIAL_START_H
#define TRIAL_START_H

#include "trial/trial.h"

/* Commands of the link. FAULT_NONE = accepted, else what is in the way, and nothing has changed. */
fault_t start_arm(trial_t *trial, const link_command_t *command);
fault_t start_swim(trial_t *trial, const link_command_t *command);

#endif
