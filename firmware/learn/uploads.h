/*
 * Files that hosts have uploaded become what they are meant to be: checked, stored, in force. In
 * IDLE only, and while no trial is pending. The file of one that was taken goes; of one that was
 * refused it stays. Main loop only.
 */
#ifndef LEARN_UPLOADS_H
#define LEARN_UPLOADS_H

#include "learn/learner.h"

/* FAULT_BAD_FILE, FAULT_BAD_FORMAT, FAULT_BAD_DATA as vault.h says; else as the learner. */
fault_t uploads_reference(learner_t *learner, const vault_stamp_t *stamp);
fault_t uploads_amplitudes(learner_t *learner, const vault_stamp_t *stamp);
fault_t uploads_learned(learner_t *learner, const vault_stamp_t *stamp);

#endif
