/* The Cortex-M3 as Unicorn runs it: instructions only, in slices of a known length; the native half
 * of vboard/core/cpu.py. */
#ifndef VBOARD_CPU_H
#define VBOARD_CPU_H

#include "clock.h"
#include "engine.h"
#include "soc.h"
#include "state.h"

#define VB_XPSR_THUMB (1u << 24)
#define VB_XPSR_EXCEPTION 0x1FFu
#define VB_CONTROL_SPSEL 2u
#define VB_PAGE_BYTES 1024u /* of Unicorn for processors of the M profile */

/* Why a slice ended; the same order as in vboard/core/cpu.py. */
typedef enum {
    VB_STOP_COUNT = 1,
    VB_STOP_SLEEP,
    VB_STOP_EXCEPTION_RETURN,
    VB_STOP_SVC,
    VB_STOP_BREAKPOINT,
    VB_STOP_UNDEFINED,
    VB_STOP_NO_COPROCESSOR,
    VB_STOP_INVALID_STATE,
    VB_STOP_BUS_DATA,
    VB_STOP_BUS_FETCH,
    VB_STOP_PROTECTED_DATA,
    VB_STOP_PROTECTED_FETCH
} vb_stop_t;

/* Those of exception entry. */
typedef struct {
    uint32_t r0, r1, r2, r3, r12, lr, xpsr, sp, control;
} vb_registers_t;

typedef struct {
    uint32_t primask, basepri, faultmask;
} vb_masks_t;

typedef struct {
    const vb_engine_t *engine;
    vb_state_t *state;
    vb_clock_t *clock;
    uint32_t interrupt; /* that ended the slice; 0: none */
    bool executes[VB_RAM_BYTES / VB_PAGE_BYTES];
} vb_cpu_t;

/* Unicorn's uc_tlb_entry. */
typedef struct {
    uint64_t address;
    uint32_t permissions;
} vb_page_t;

/* Runs up to |count| instructions from pc; state->executed tells how many it was. May fail. */
vb_stop_t vb_cpu_run(vb_cpu_t *cpu, int64_t count);

/* During vb_cpu_run(): instructions before the present one. */
int64_t vb_cpu_begun(const vb_cpu_t *cpu);

/* This instruction is the last (an IT block is completed first). */
void vb_cpu_end_slice(vb_cpu_t *cpu);

/* At most |count| instructions in all, the present one included. */
void vb_cpu_shorten_slice(vb_cpu_t *cpu, int64_t count);

/* Ends the slice at once after a failure; the access is not to be repeated. */
void vb_cpu_stop_if_failed(vb_cpu_t *cpu);

/* Unicorn's hook of interrupts. */
void vb_cpu_on_interrupt(vb_cpu_t *cpu, uint32_t number);

/* Unicorn's hook of pages of which it knows nothing yet. Stores to pages that may be executed are
 * slow; a page of RAM is one from the first time on that it is. */
bool vb_cpu_on_page(vb_cpu_t *cpu, uint32_t address, int kind, vb_page_t *page);

/* In a hook of Unicorn's, for an access that is no fault after all: Unicorn has put the rest of the
 * IT block into XPSR, where the code that goes on does not expect it. */
void vb_cpu_go_on(vb_cpu_t *cpu);

vb_registers_t vb_cpu_registers(const vb_cpu_t *cpu);
vb_masks_t vb_cpu_masks(const vb_cpu_t *cpu);
uint32_t vb_cpu_exception(const vb_cpu_t *cpu);
uint32_t vb_cpu_stack_pointer(const vb_cpu_t *cpu, bool process);
bool vb_cpu_privileged(const vb_cpu_t *cpu);
void vb_cpu_clear_faultmask(vb_cpu_t *cpu);

/* Leaves the interrupted stack at |frame| and goes to the vector in handler mode. */
void vb_cpu_enter(vb_cpu_t *cpu, const vb_registers_t *before, uint32_t frame, int number,
                  uint32_t exc_return, uint32_t vector);

/* From handler to handler without a new frame. */
void vb_cpu_chain(vb_cpu_t *cpu, int number, uint32_t exc_return, uint32_t vector);

/* Restores the eight words of a frame; the stack it was on continues at |stack|. */
void vb_cpu_leave(vb_cpu_t *cpu, const uint32_t frame[8], uint32_t stack, bool process);

#endif
