/*
 * A flash that does not take data is a fault of the board, whoever found it; a full store is not.
 * Main loop only.
 */
#ifndef APP_DAMAGE_H
#define APP_DAMAGE_H

#include "app/owners.h"

/* Raises FAULT_STORAGE when the store was damaged since the last question; true when it was. While
 * a trial is open its own end decides (trial_finish). */
bool damage_raise(app_t *app);

/* FAULT_STORAGE instead of FAULT_WRITE_FAILED when that is why. */
fault_t damage_judge(app_t *app, fault_t fault);

#endif
