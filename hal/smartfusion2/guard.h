/* Memory that only the tick may write. */
#ifndef SMARTFUSION2_GUARD_H
#define SMARTFUSION2_GUARD_H

/* Once at boot, after RAM was filled: from here on the guarded memory opens for the tick alone. */
void guard_init(void);

#endif
