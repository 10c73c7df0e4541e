/*
 * What becomes of a fault: the servo is let go, how it came about is written to a part of RAM that
 * no reset clears, and the board restarts. hal_crash_read() finds it there.
 */
#ifndef SAM3X8E_CRASH_H
#define SAM3X8E_CRASH_H

#include <stdint.h>

/* Where all faults and all interrupts that nobody expects enter (vectors.c). Never returns. */
void crash_entry_isr(void);

/* Restarts the chip, or hangs until the watchdog does. */
_Noreturn void chip_restart(void);

#endif
