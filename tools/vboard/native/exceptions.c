#include "exceptions.h"

#include "check.h"
#include "mpu.h"
#include <string.h>

#define IACCVIOL (1u << 0)
#define DACCVIOL (1u << 1)
#define MUNSTKERR (1u << 3)
#define MSTKERR (1u << 4)
#define MMARVALID (1u << 7)
#define IBUSERR (1u << 8)
#define PRECISERR (1u << 9)
#define UNSTKERR (1u << 11)
#define STKERR (1u << 12)
#define BFARVALID (1u << 15)
#define UNDEFINSTR (1u << 16)
#define INVSTATE (1u << 17)
#define INVPC (1u << 18)
#define NOCP (1u << 19)
#define HFSR_VECTTBL (1u << 1)
#define HFSR_FORCED (1u << 30)
#define HFSR_DEBUGEVT (1u << 31)
#define CCR_NONBASETHRDENA (1u << 0)
#define CCR_STKALIGN (1u << 9)

/* Cortex-M3 Technical Reference Manual, zero wait states; the flash adds to them on the chip. */
enum { ENTRY_CYCLES = 12, RETURN_CYCLES = 10, CHAIN_CYCLES = 6 };
enum { FRAME_BYTES = 32, FRAME_WORDS = 8 };

static uint64_t bit(int number) { return 1ull << number; }

static bool failed(const vb_exceptions_t *exceptions) {
    return exceptions->soc->clock->failure != VB_OK;
}

/* The time that entry and return take. */
static void spend(vb_exceptions_t *exceptions, int cycles) {
    vb_clock_t *clock = exceptions->soc->clock;
    (void)vb_clock_advance(clock, clock->now + cycles * exceptions->state->mck_ticks);
}

/* Pending and priorities. */

void vb_exceptions_set_line(vb_exceptions_t *exceptions, int irq, bool level) {
    VB_CHECK(irq >= 0 && irq < VB_IRQS);
    vb_state_t *state = exceptions->state;
    uint64_t line = bit(VB_FIRST_IRQ + irq);
    if (level && !(state->lines & line)) {
        vb_exceptions_pend(exceptions, VB_FIRST_IRQ + irq);
    }
    state->lines = level ? state->lines | line : state->lines & ~line;
}

void vb_exceptions_pend(vb_exceptions_t *exceptions, int number) {
    exceptions->state->pending |= bit(number);
    exceptions->state->attention = 1;
}

int vb_exceptions_best_pending(const vb_exceptions_t *exceptions) {
    const vb_state_t *state = exceptions->state;
    int best = VB_NO_EXCEPTION;
    for (uint64_t left = state->pending & state->enabled; left; left &= left - 1) {
        int number = __builtin_ctzll(left);
        if (best == VB_NO_EXCEPTION || state->priority[number] < state->priority[best]) {
            best = number;
        }
    }
    return best;
}

int vb_exceptions_group_priority(const vb_exceptions_t *exceptions, int number) {
    int priority = (int)exceptions->state->priority[number];
    return priority < 0 ? priority : priority & (int)exceptions->state->group_mask;
}

static int lower(int one, int other) { return one < other ? one : other; }

static int active_priority(const vb_exceptions_t *exceptions) {
    int best = VB_NO_PRIORITY;
    for (uint64_t left = exceptions->state->active; left; left &= left - 1) {
        best = lower(best, vb_exceptions_group_priority(exceptions, __builtin_ctzll(left)));
    }
    return best;
}

static int above_basepri(const vb_exceptions_t *exceptions, uint32_t basepri) {
    int priority = active_priority(exceptions);
    basepri &= 0xF0;
    return basepri ? lower(priority, (int)(basepri & (uint32_t)exceptions->state->group_mask))
                   : priority;
}

int vb_exceptions_execution_priority(const vb_exceptions_t *exceptions) {
    vb_masks_t masks = vb_cpu_masks(exceptions->cpu);
    int priority = above_basepri(exceptions, masks.basepri);
    if (masks.primask & 1) {
        priority = lower(priority, 0);
    }
    return masks.faultmask & 1 ? lower(priority, -1) : priority;
}

bool vb_exceptions_wakes(const vb_exceptions_t *exceptions) {
    int number = vb_exceptions_best_pending(exceptions);
    if (number == VB_NO_EXCEPTION) {
        return false;
    }
    vb_masks_t masks = vb_cpu_masks(exceptions->cpu);
    int priority = masks.faultmask & 1 ? -1 : above_basepri(exceptions, masks.basepri);
    return vb_exceptions_group_priority(exceptions, number) < priority;
}

/* Faults. */

static void lock_up(vb_exceptions_t *exceptions, const char *what, int number) {
    const vb_state_t *state = exceptions->state;
    char name[16] = "";
    if (number != VB_NO_EXCEPTION) {
        (void)snprintf(name, sizeof name, " %d", number);
    }
    vb_clock_fail(
        exceptions->soc->clock, VB_LOCKUP,
        "%s%s at HardFault priority (CFSR 0x%08x, HFSR 0x%08x, BFAR 0x%08x, MMFAR 0x%08x)", what,
        name, (unsigned)state->cfsr, (unsigned)state->hfsr, (unsigned)state->bfar,
        (unsigned)state->mmfar);
}

static void pend_synchronous(vb_exceptions_t *exceptions, int number, int running) {
    if (vb_exceptions_group_priority(exceptions, number) < running &&
        exceptions->state->enabled & bit(number)) {
        vb_exceptions_pend(exceptions, number);
        return;
    }
    exceptions->state->hfsr |= HFSR_FORCED;
    if (running <= -1) {
        lock_up(exceptions, "exception", number);
        return;
    }
    vb_exceptions_pend(exceptions, VB_HARD_FAULT);
}

/* Entry and return. */

static bool may_stack(const vb_exceptions_t *exceptions, uint32_t frame, int running, bool write) {
    if (!vb_mpu_active(exceptions->state, running)) {
        return true;
    }
    bool privileged = vb_cpu_privileged(exceptions->cpu);
    for (uint32_t offset = 0; offset < FRAME_BYTES; offset += 4) {
        if (!vb_mpu_allows(exceptions->state, frame + offset, write, privileged)) {
            return false;
        }
    }
    return true;
}

static void stack(vb_exceptions_t *exceptions, uint32_t frame, const uint32_t words[FRAME_WORDS]) {
    int running = vb_exceptions_execution_priority(exceptions);
    uint8_t *place = vb_soc_memory(exceptions->soc, frame, FRAME_BYTES, true);
    if (place == NULL) {
        exceptions->state->cfsr |= STKERR;
        pend_synchronous(exceptions, VB_BUS_FAULT, running);
    } else if (!may_stack(exceptions, frame, running, true)) {
        exceptions->state->cfsr |= MSTKERR;
        pend_synchronous(exceptions, VB_MEM_MANAGE, running);
    } else {
        memcpy(place, words, FRAME_BYTES);
    }
}

/* Makes the best pending exception the active one; false after a failure. */
static bool take(vb_exceptions_t *exceptions, int *number, uint32_t *vector) {
    vb_state_t *state = exceptions->state;
    *number = vb_exceptions_best_pending(exceptions);
    VB_CHECK(*number != VB_NO_EXCEPTION);
    uint32_t address = ((uint32_t)state->vector_table + 4u * (uint32_t)*number) & 0xFFFFFFFCu;
    const uint8_t *place = vb_soc_memory(exceptions->soc, address, 4, false);
    if (place == NULL) {
        state->hfsr |= HFSR_VECTTBL;
        vb_clock_fail(exceptions->soc->clock, VB_LOCKUP, "no vector for exception %d: VTOR 0x%08x",
                      *number, (unsigned)state->vector_table);
        return false;
    }
    state->pending &= ~bit(*number);
    state->active |= bit(*number);
    state->taken++;
    memcpy(vector, place, 4);
    return true;
}

static uint32_t exc_return_of(uint32_t xpsr, bool process) {
    if (xpsr & VB_XPSR_EXCEPTION) {
        return 0xFFFFFFF1u;
    }
    return process ? 0xFFFFFFFDu : 0xFFFFFFF9u;
}

/* Stacks a frame, takes the best pending exception; |exc_return|, if not 0, is its LR. */
static void enter(vb_exceptions_t *exceptions, uint32_t exc_return) {
    vb_cpu_t *cpu = exceptions->cpu;
    vb_registers_t before = vb_cpu_registers(cpu);
    bool process = !(before.xpsr & VB_XPSR_EXCEPTION) && before.control & VB_CONTROL_SPSEL;
    uint32_t odd = exceptions->state->ccr & CCR_STKALIGN ? before.sp & 4 : 0;
    uint32_t frame = (before.sp - FRAME_BYTES - odd) & 0xFFFFFFFCu;
    uint32_t stacked = (before.xpsr & ~(1u << 9)) | (odd ? 1u << 9 : 0);
    uint32_t words[FRAME_WORDS] = {before.r0,
                                   before.r1,
                                   before.r2,
                                   before.r3,
                                   before.r12,
                                   before.lr,
                                   (uint32_t)exceptions->state->pc,
                                   stacked};
    stack(exceptions, frame, words);
    int number = 0;
    uint32_t vector = 0;
    if (failed(exceptions) || !take(exceptions, &number, &vector)) {
        return;
    }
    vb_cpu_enter(cpu, &before, frame, number,
                 exc_return ? exc_return : exc_return_of(before.xpsr, process), vector);
    spend(exceptions, ENTRY_CYCLES);
}

static void chain(vb_exceptions_t *exceptions, uint32_t exc_return) {
    int number = 0;
    uint32_t vector = 0;
    if (failed(exceptions) || !take(exceptions, &number, &vector)) {
        return;
    }
    vb_cpu_chain(exceptions->cpu, number, exc_return, vector);
    spend(exceptions, CHAIN_CYCLES);
}

bool vb_exceptions_dispatch(vb_exceptions_t *exceptions) {
    int number = vb_exceptions_best_pending(exceptions);
    if (number == VB_NO_EXCEPTION) {
        return false;
    }
    int priority = vb_exceptions_group_priority(exceptions, number);
    if (priority >= active_priority(exceptions)) {
        return false;
    }
    if (priority >= vb_exceptions_execution_priority(exceptions)) {
        return true;
    }
    enter(exceptions, 0);
    return false;
}

/* A synchronous exception: taken now, or HardFault in its place. */
static void raise_exception(vb_exceptions_t *exceptions, int number) {
    pend_synchronous(exceptions, number, vb_exceptions_execution_priority(exceptions));
    if (!failed(exceptions)) {
        enter(exceptions, 0);
    }
}

static void bus_fault(vb_exceptions_t *exceptions, bool data) {
    vb_state_t *state = exceptions->state;
    if (data) {
        state->cfsr |= PRECISERR | BFARVALID;
        state->bfar = state->address_of_fault;
    } else {
        state->cfsr |= IBUSERR;
    }
    raise_exception(exceptions, VB_BUS_FAULT);
}

static void protection_fault(vb_exceptions_t *exceptions, bool data) {
    vb_state_t *state = exceptions->state;
    uint32_t address = (uint32_t)state->address_of_fault;
    if (data && vb_soc_memory(exceptions->soc, address, 1, false) != NULL &&
        !exceptions->restricts(address)) {
        bus_fault(exceptions, data);
        return;
    }
    if (data) {
        state->cfsr |= DACCVIOL | MMARVALID;
        state->mmfar = address;
    } else {
        state->cfsr |= IACCVIOL;
    }
    raise_exception(exceptions, VB_MEM_MANAGE);
}

static void breakpoint(vb_exceptions_t *exceptions) {
    vb_state_t *state = exceptions->state;
    int running = vb_exceptions_execution_priority(exceptions);
    if (state->debug_monitor &&
        vb_exceptions_group_priority(exceptions, VB_DEBUG_MONITOR) < running) {
        raise_exception(exceptions, VB_DEBUG_MONITOR);
        return;
    }
    state->hfsr |= HFSR_DEBUGEVT;
    if (running <= -1) {
        lock_up(exceptions, "BKPT", VB_NO_EXCEPTION);
        return;
    }
    vb_exceptions_pend(exceptions, VB_HARD_FAULT);
    enter(exceptions, 0);
}

void vb_exceptions_usage_fault(vb_exceptions_t *exceptions, uint32_t cause) {
    exceptions->state->cfsr |= cause;
    raise_exception(exceptions, VB_USAGE_FAULT);
}

static void unstack(vb_exceptions_t *exceptions, uint32_t exc_return) {
    vb_state_t *state = exceptions->state;
    bool process = (exc_return & 0xF) == 0xD;
    uint32_t stack = vb_cpu_stack_pointer(exceptions->cpu, process);
    const uint8_t *place = vb_soc_memory(exceptions->soc, stack, FRAME_BYTES, false);
    int running = vb_exceptions_execution_priority(exceptions);
    if (place == NULL || !may_stack(exceptions, stack, running, false)) {
        state->cfsr |= place == NULL ? UNSTKERR : MUNSTKERR;
        pend_synchronous(exceptions, place == NULL ? VB_BUS_FAULT : VB_MEM_MANAGE, running);
        chain(exceptions, exc_return);
        return;
    }
    uint32_t words[FRAME_WORDS];
    memcpy(words, place, sizeof words);
    uint32_t xpsr = words[FRAME_WORDS - 1], after = stack + FRAME_BYTES;
    if (xpsr & 1u << 9 && state->ccr & CCR_STKALIGN) {
        after |= 4;
    }
    vb_cpu_leave(exceptions->cpu, words, after, process);
    spend(exceptions, RETURN_CYCLES);
    if (failed(exceptions)) {
        return;
    }
    bool handler = (xpsr & VB_XPSR_EXCEPTION) != 0;
    if (handler != ((exc_return & 0xF) == 0x1)) {
        state->cfsr |= INVPC;
        pend_synchronous(exceptions, VB_USAGE_FAULT, vb_exceptions_execution_priority(exceptions));
        if (!failed(exceptions)) {
            enter(exceptions, exc_return);
        }
        return;
    }
    state->exit_to_sleep = state->sleep_on_exit && !handler;
}

static bool legal_return(const vb_exceptions_t *exceptions, int number, uint32_t exc_return) {
    const vb_state_t *state = exceptions->state;
    uint32_t kind = exc_return & 0xF;
    bool alone = state->active == bit(number);
    if (exc_return & 8 && !alone && !(state->ccr & CCR_NONBASETHRDENA)) {
        return false;
    }
    return state->active & bit(number) && (kind == 0x1 || kind == 0x9 || kind == 0xD);
}

static void return_from(vb_exceptions_t *exceptions, uint32_t exc_return) {
    vb_state_t *state = exceptions->state;
    int number = (int)vb_cpu_exception(exceptions->cpu);
    if (number == 0) {
        state->pc &= ~1LL;
        protection_fault(exceptions, false);
        return;
    }
    if (number != VB_NMI) {
        vb_cpu_clear_faultmask(exceptions->cpu);
    }
    bool legal = legal_return(exceptions, number, exc_return);
    state->active &= ~bit(number);
    state->pending |= state->lines & bit(number);
    state->attention = 1;
    if (!legal) {
        state->cfsr |= INVPC;
        pend_synchronous(exceptions, VB_USAGE_FAULT, vb_exceptions_execution_priority(exceptions));
        chain(exceptions, exc_return);
        return;
    }
    int next = vb_exceptions_best_pending(exceptions);
    if (next != VB_NO_EXCEPTION && vb_exceptions_group_priority(exceptions, next) <
                                       vb_exceptions_execution_priority(exceptions)) {
        chain(exceptions, exc_return);
    } else {
        unstack(exceptions, exc_return);
    }
}

void vb_exceptions_handle(vb_exceptions_t *exceptions, vb_stop_t stop) {
    switch (stop) {
    case VB_STOP_EXCEPTION_RETURN:
        return_from(exceptions, (uint32_t)exceptions->state->pc | 1);
        break;
    case VB_STOP_SVC:
        raise_exception(exceptions, VB_SVCALL);
        break;
    case VB_STOP_BREAKPOINT:
        breakpoint(exceptions);
        break;
    case VB_STOP_UNDEFINED:
        vb_exceptions_usage_fault(exceptions, UNDEFINSTR);
        break;
    case VB_STOP_INVALID_STATE:
        vb_exceptions_usage_fault(exceptions, INVSTATE);
        break;
    case VB_STOP_NO_COPROCESSOR:
        vb_exceptions_usage_fault(exceptions, NOCP);
        break;
    case VB_STOP_BUS_DATA:
    case VB_STOP_BUS_FETCH:
        bus_fault(exceptions, stop == VB_STOP_BUS_DATA);
        break;
    case VB_STOP_PROTECTED_DATA:
    case VB_STOP_PROTECTED_FETCH:
        protection_fault(exceptions, stop == VB_STOP_PROTECTED_DATA);
        break;
    case VB_STOP_COUNT:
    case VB_STOP_SLEEP:
        break;
    }
}
