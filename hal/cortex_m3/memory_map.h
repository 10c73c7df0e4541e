/* What the linker script (sam3x8e.ld) says about memory. Only the addresses of these mean anything.
 */
#ifndef CORTEX_M3_MEMORY_MAP_H
#define CORTEX_M3_MEMORY_MAP_H

#include <stdint.h>

extern const uint32_t __data_load[]; /* start values in flash of what lies between ... */
extern uint32_t __data_start[];      /* ... here ... */
extern uint32_t __data_end[];        /* ... and here */
extern uint32_t __bss_start[];
extern uint32_t __bss_end[];
extern uint32_t __ram_start[];
extern uint32_t __guarded[];     /* HAL_GUARDED_BYTES (hal/guard.h), aligned to their number */
extern uint32_t __stack_guard[]; /* no access from here up to __stack_bottom: a power of two */
extern uint32_t __stack_bottom[];
extern uint32_t __stack_top[];

/* Contents survive every reset but loss of power, and are whatever they are after that. */
#define NOINIT __attribute__((section(".noinit")))

#endif
