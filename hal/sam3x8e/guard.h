/* Memory protection: the stack's end, and what only the tick may write. */
#ifndef SAM3X8E_GUARD_H
#define SAM3X8E_GUARD_H

/* Once at boot. Empties the guarded memory; from here on it opens for the tick alone. */
void guard_init(void);

#endif
