/* Whether a fish may follow a reference in this tank. Pure. */
#ifndef LEARN_REFERENCE_H
#define LEARN_REFERENCE_H

#include "params/params.h"
#include "store/records.h"

/* By the limits of the moment: FAULT_NONE; FAULT_BAD_DATA for a beat that is too long, too short or
 * not a whole number of frames; FAULT_TOO_FAST; FAULT_TOO_FAR for the tank. */
fault_t reference_judge(const params_t *params, const reference_t *reference);

#endif
