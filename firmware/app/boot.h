/* From the store into RAM, and what the board found out about the run before. Main loop only. */
#ifndef APP_BOOT_H
#define APP_BOOT_H

#include "app/owners.h"

/* Mounts the store and loads all of it; tells people what was lost. The fault that the board begins
 * with; FAULT_NONE: it is well. */
fault_t boot_load(app_t *app);

/* The stored parameters; what contradicts itself, or what this firmware refuses, falls back to its
 * default. */
void boot_load_params(app_t *app);

#endif
