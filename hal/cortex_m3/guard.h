/* Memory protection: the stack's end, and what only the tick may write. */
#ifndef CORTEX_M3_GUARD_H
#define CORTEX_M3_GUARD_H

/* Once at boot, after the chip's own regions. Switches the MPU on; empties the guarded memory,
 * which from here on opens for the tick alone. */
void guard_init(void);

#endif
