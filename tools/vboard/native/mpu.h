/* Memory protection unit, as far as exception entry and return ask it; as vboard/core/mpu.py, which
 * has the rest. */
#ifndef VBOARD_MPU_H
#define VBOARD_MPU_H

#include "state.h"
#include <stdbool.h>

/* Whether it checks anything at this execution priority. */
bool vb_mpu_active(const vb_state_t *state, int priority);

/* Whether a data access passes. */
bool vb_mpu_allows(const vb_state_t *state, uint32_t address, bool write, bool privileged);

#endif
