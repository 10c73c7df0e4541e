/*
 * What becomes of a fault: the servo is let go, how it came about is written to a part of RAM that
 * no reset clears, and the board restarts. hal_crash_read() finds it there.
 */
#ifndef CORTEX_M3_CRASH_H
#define CORTEX_M3_CRASH_H

#include <stdint.h>

/* Where all faults and all interrupts that nobody expects enter (vectors.c). Never returns. */
void crash_entry_isr(void);

/* The chip's part. Restarts it, or hangs until the watchdog does. */
_Noreturn void chip_restart(void);

/* The chip's part. Ends the pulses at once, whatever runs. Any context; at reset even before RAM is
 * set up: uses no variables. */
void servo_kill(void);

#endif
