/* What processor and chip share with Python: whole numbers of 64 bits each, mirrored by name in
 * vboard/native/library.py. */
#ifndef VBOARD_STATE_H
#define VBOARD_STATE_H

#include <stdint.h>

#define VB_IRQS 45
#define VB_FIRST_IRQ 16
#define VB_EXCEPTIONS (VB_FIRST_IRQ + VB_IRQS)
#define VB_REGIONS 8
#define VB_NO_RESET (-1)
#define VB_AWAKE (-1)

typedef struct {
    /* Exceptions, by exception number; IRQ n = 16 + n. */
    uint64_t pending, active, enabled, lines;
    int64_t group_mask, vector_table, ccr, sleep_on_exit, debug_monitor;
    int64_t cfsr, hfsr, mmfar, bfar;
    int64_t attention; /* it may have become time to do something */
    int64_t exit_to_sleep, taken;
    int64_t priority[VB_EXCEPTIONS];
    /* Memory protection unit. */
    int64_t mpu_control, mpu_base[VB_REGIONS], mpu_attributes[VB_REGIONS];
    /* Processor. */
    int64_t pc, thumb, executed, address_of_fault;
    /* Chip. */
    int64_t off, sleeping, deferred;
    int64_t reset_cause; /* of the reset that is asked for, or VB_NO_RESET */
    int64_t tracing, masked_steps;
    int64_t cost; /* clock ticks per instruction */
    int64_t slice_start, slice_end;
    int64_t blocked[2]; /* banks of flash that can be neither read nor executed */
    int64_t instructions, idle_ticks;
    int64_t asleep_since; /* or VB_AWAKE */
    int64_t mck_ticks;
    uint64_t clocked; /* peripherals whose clock is on, by id */
} vb_state_t;

#endif
