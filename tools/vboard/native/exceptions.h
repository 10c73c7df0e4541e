/* Exceptions of the Cortex-M3: what is pending, what is active, entry, return and faults; as
 * vboard/core/exceptions.py, where the rules and what is not modelled are explained. */
#ifndef VBOARD_EXCEPTIONS_H
#define VBOARD_EXCEPTIONS_H

#include "cpu.h"
#include "soc.h"

enum {
    VB_NMI = 2,
    VB_HARD_FAULT = 3,
    VB_MEM_MANAGE = 4,
    VB_BUS_FAULT = 5,
    VB_USAGE_FAULT = 6,
    VB_SVCALL = 11,
    VB_DEBUG_MONITOR = 12,
    VB_NO_EXCEPTION = -1,
    VB_NO_PRIORITY = 256
};

#define VB_CCR_DIV_0_TRP (1u << 4)

typedef struct {
    vb_state_t *state;
    vb_cpu_t *cpu;
    vb_soc_t *soc;
    /* Python's: whether the MPU restricts the page of an address. */
    int (*restricts)(uint32_t address);
} vb_exceptions_t;

/* Drives an interrupt line: a rising one pends, a high one pends again after return. */
void vb_exceptions_set_line(vb_exceptions_t *exceptions, int irq, bool level);

void vb_exceptions_pend(vb_exceptions_t *exceptions, int number);

/* The pending and enabled exception that is to come next, or VB_NO_EXCEPTION. */
int vb_exceptions_best_pending(const vb_exceptions_t *exceptions);

/* Priority for preemption. */
int vb_exceptions_group_priority(const vb_exceptions_t *exceptions, int number);

/* What a pending exception must beat to be taken. */
int vb_exceptions_execution_priority(const vb_exceptions_t *exceptions);

/* Whether WFI would end now; PRIMASK does not count. */
bool vb_exceptions_wakes(const vb_exceptions_t *exceptions);

/* Takes the best pending exception if its time has come. True: something is held back by PRIMASK,
 * BASEPRI or FAULTMASK alone, so that it may become due at any instruction. May fail. */
bool vb_exceptions_dispatch(vb_exceptions_t *exceptions);

/* What ended a slice, as the exception that it is. May fail. */
void vb_exceptions_handle(vb_exceptions_t *exceptions, vb_stop_t stop);

/* UsageFault for the instruction at pc. May fail. */
void vb_exceptions_usage_fault(vb_exceptions_t *exceptions, uint32_t cause);

#endif
