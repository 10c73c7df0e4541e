/* From reset to main(). */
#ifndef SAM3X8E_STARTUP_H
#define SAM3X8E_STARTUP_H

/* The vector table (vectors.c). */
extern const struct vector_table vectors;

/* First code after reset, on the 4 MHz RC oscillator, with the stack set up and nothing else.
 * Starts the clocks before it fills 52 KB of RAM: 3 ms instead of 50. */
_Noreturn void reset_handler(void);

#endif
