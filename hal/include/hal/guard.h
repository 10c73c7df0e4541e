/* Memory that nothing but the tick can change, where the board can see to that. */
#ifndef HAL_GUARD_H
#define HAL_GUARD_H

#include "hal/hal.h"

#define HAL_GUARDED_BYTES 32u

/* HAL_GUARDED_BYTES of memory, aligned for any type, all zeros after each reset. It may always be
 * read and is to be written between open and close only: elsewhere a write is a crash on boards
 * that can tell. Where the memory lies does not depend on anything in RAM if that can be had. */
void *hal_guarded(hal_t *hal);

/* From the tick only, a few instructions apart: nothing else runs between the two. */
void hal_guard_open_isr(hal_t *hal);
void hal_guard_close_isr(hal_t *hal);

#endif
