#include "cpu.h"

#include "check.h"

#define NEVER 0xFFFFFFFEu
#define XPSR_IT 0x0600FC00u

enum {
    INTR_SVC = 2,
    INTR_PREFETCH_ABORT = 3,
    INTR_BREAKPOINT = 7,
    INTR_EXCEPTION_EXIT = 8,
    INTR_NO_COPROCESSOR = 17,
    INTR_INVALID_STATE = 18
};

static uint32_t read_register(const vb_cpu_t *cpu, int id) {
    uint32_t value = 0;
    (void)cpu->engine->reg_read(cpu->engine->handle, id, &value);
    return value;
}

static void write_register(const vb_cpu_t *cpu, int id, uint32_t value) {
    (void)cpu->engine->reg_write(cpu->engine->handle, id, &value);
}

enum { R0, R1, R2, R3, R12, LR, XPSR, SP, CONTROL };

static vb_stop_t stop_of_interrupt(vb_cpu_t *cpu) {
    if ((cpu->state->pc & ~0xFLL) == 0xFFFFFFF0LL) {
        return VB_STOP_EXCEPTION_RETURN;
    }
    switch (cpu->interrupt) {
    case INTR_SVC:
        return VB_STOP_SVC;
    case INTR_PREFETCH_ABORT:
        return VB_STOP_PROTECTED_FETCH;
    case INTR_BREAKPOINT:
        return VB_STOP_BREAKPOINT;
    case INTR_EXCEPTION_EXIT:
        return VB_STOP_EXCEPTION_RETURN;
    case INTR_NO_COPROCESSOR:
        return VB_STOP_NO_COPROCESSOR;
    case INTR_INVALID_STATE:
        return VB_STOP_INVALID_STATE;
    default:
        vb_clock_fail(cpu->clock, VB_LOCKUP, "unicorn: interrupt %u", (unsigned)cpu->interrupt);
        return VB_STOP_COUNT;
    }
}

static vb_stop_t stop_of_error(vb_cpu_t *cpu, int error) {
    const vb_engine_t *engine = cpu->engine;
    if (error == engine->insn_invalid) {
        cpu->state->thumb = (read_register(cpu, engine->entry[XPSR]) & VB_XPSR_THUMB) != 0;
        return cpu->state->thumb ? VB_STOP_UNDEFINED : VB_STOP_INVALID_STATE;
    }
    if (error == engine->read_unmapped || error == engine->write_unmapped) {
        return VB_STOP_BUS_DATA;
    }
    if (error == engine->read_prot || error == engine->write_prot) {
        return VB_STOP_PROTECTED_DATA;
    }
    if (error == engine->fetch_unmapped) {
        return VB_STOP_BUS_FETCH;
    }
    if (error != engine->fetch_prot && error != engine->exception) {
        vb_clock_fail(cpu->clock, VB_LOCKUP, "unicorn: error %d", error);
    }
    return VB_STOP_PROTECTED_FETCH;
}

vb_stop_t vb_cpu_run(vb_cpu_t *cpu, int64_t count) {
    const vb_engine_t *engine = cpu->engine;
    vb_state_t *state = cpu->state;
    cpu->interrupt = 0;
    uint64_t start = (uint64_t)state->pc | (state->thumb ? 1 : 0);
    int error = engine->emu_start(engine->handle, start, NEVER, 0, (size_t)count);
    state->pc = read_register(cpu, engine->pc);
    state->executed = (int64_t)*engine->begun;
    if (cpu->clock->failure != VB_OK) {
        return VB_STOP_COUNT;
    }
    if (error != engine->ok) {
        return stop_of_error(cpu, error);
    }
    if (cpu->interrupt) {
        return stop_of_interrupt(cpu);
    }
    if (*engine->begun > *engine->wanted) {
        state->executed--;
        return VB_STOP_COUNT;
    }
    return VB_STOP_SLEEP;
}

int64_t vb_cpu_begun(const vb_cpu_t *cpu) { return (int64_t)*cpu->engine->begun - 1; }

void vb_cpu_end_slice(vb_cpu_t *cpu) { *cpu->engine->wanted = *cpu->engine->begun; }

void vb_cpu_shorten_slice(vb_cpu_t *cpu, int64_t count) {
    uint64_t begun = *cpu->engine->begun, wanted = *cpu->engine->wanted;
    wanted = count >= 0 && (uint64_t)count < wanted ? (uint64_t)count : wanted;
    *cpu->engine->wanted = count < 0 || wanted < begun ? begun : wanted;
}

void vb_cpu_stop_if_failed(vb_cpu_t *cpu) {
    if (cpu->clock->failure != VB_OK) {
        (void)cpu->engine->emu_stop(cpu->engine->handle);
    }
}

void vb_cpu_on_interrupt(vb_cpu_t *cpu, uint32_t number) {
    cpu->interrupt = number;
    (void)cpu->engine->emu_stop(cpu->engine->handle);
}

vb_registers_t vb_cpu_registers(const vb_cpu_t *cpu) {
    vb_registers_t out = {0};
    void *places[VB_ENTRY_REGISTERS] = {&out.r0, &out.r1,   &out.r2, &out.r3,     &out.r12,
                                        &out.lr, &out.xpsr, &out.sp, &out.control};
    (void)cpu->engine->reg_read_batch(cpu->engine->handle, cpu->engine->entry, places,
                                      VB_ENTRY_REGISTERS);
    return out;
}

vb_masks_t vb_cpu_masks(const vb_cpu_t *cpu) {
    vb_masks_t out = {0};
    void *places[VB_MASKS] = {&out.primask, &out.basepri, &out.faultmask};
    (void)cpu->engine->reg_read_batch(cpu->engine->handle, cpu->engine->masks, places, VB_MASKS);
    return out;
}

uint32_t vb_cpu_exception(const vb_cpu_t *cpu) {
    return read_register(cpu, cpu->engine->entry[XPSR]) & VB_XPSR_EXCEPTION;
}

uint32_t vb_cpu_stack_pointer(const vb_cpu_t *cpu, bool process) {
    return read_register(cpu, process ? cpu->engine->psp : cpu->engine->msp);
}

bool vb_cpu_privileged(const vb_cpu_t *cpu) {
    return (read_register(cpu, cpu->engine->entry[CONTROL]) & 1) == 0 || vb_cpu_exception(cpu) != 0;
}

void vb_cpu_clear_faultmask(vb_cpu_t *cpu) {
    write_register(cpu, cpu->engine->masks[VB_MASKS - 1], 0);
}

/* Writing the flags too makes the translator see the new mode. */
static void write_xpsr(vb_cpu_t *cpu, uint32_t value) {
    write_register(cpu, cpu->engine->entry[XPSR], value);
    write_register(cpu, cpu->engine->apsr, value & 0xF0000000u);
}

void vb_cpu_enter(vb_cpu_t *cpu, const vb_registers_t *before, uint32_t frame, int number,
                  uint32_t exc_return, uint32_t vector) {
    write_register(cpu, cpu->engine->entry[SP], frame);
    if (before->control & VB_CONTROL_SPSEL) {
        write_register(cpu, cpu->engine->entry[CONTROL], before->control & ~VB_CONTROL_SPSEL);
    }
    vb_cpu_chain(cpu, number, exc_return, vector);
}

void vb_cpu_chain(vb_cpu_t *cpu, int number, uint32_t exc_return, uint32_t vector) {
    VB_CHECK(number > 0 && number < VB_EXCEPTIONS);
    uint32_t flags = read_register(cpu, cpu->engine->entry[XPSR]) & 0xF8000000u;
    write_xpsr(cpu, flags | (vector & 1 ? VB_XPSR_THUMB : 0) | (uint32_t)number);
    write_register(cpu, cpu->engine->entry[LR], exc_return);
    cpu->state->pc = vector & ~1u;
    cpu->state->thumb = vector & 1;
}

void vb_cpu_leave(vb_cpu_t *cpu, const uint32_t frame[8], uint32_t stack, bool process) {
    uint32_t words[VB_CALLER_SAVED], xpsr = frame[7];
    void *places[VB_CALLER_SAVED];
    write_xpsr(cpu, xpsr & ~(1u << 9));
    if ((xpsr & VB_XPSR_EXCEPTION) == 0) {
        uint32_t control = read_register(cpu, cpu->engine->entry[CONTROL]) & ~VB_CONTROL_SPSEL;
        write_register(cpu, cpu->engine->entry[CONTROL],
                       control | (process ? VB_CONTROL_SPSEL : 0));
    }
    write_register(cpu, cpu->engine->entry[SP], stack);
    for (int i = 0; i < VB_CALLER_SAVED; i++) {
        words[i] = frame[i];
        places[i] = &words[i];
    }
    (void)cpu->engine->reg_write_batch(cpu->engine->handle, cpu->engine->entry, places,
                                       VB_CALLER_SAVED);
    cpu->state->pc = frame[6] & ~1u;
    cpu->state->thumb = (xpsr & VB_XPSR_THUMB) != 0;
}

void vb_cpu_go_on(vb_cpu_t *cpu) {
    uint32_t xpsr = read_register(cpu, cpu->engine->entry[XPSR]);
    if (xpsr & XPSR_IT) {
        write_register(cpu, cpu->engine->entry[XPSR], xpsr & ~XPSR_IT);
    }
}

/* Devices and the system's own, but for the page of NEVER: Unicorn asks for it at each stop, and a
 * refusal would be the stop's error. Nothing is mapped there. */
static bool never_executes(uint32_t page) {
    bool device = page - 0x40000000u < 0x20000000u || page >= 0xA0000000u;
    return device && NEVER - page >= VB_PAGE_BYTES;
}

bool vb_cpu_on_page(vb_cpu_t *cpu, uint32_t address, int kind, vb_page_t *page) {
    const vb_engine_t *engine = cpu->engine;
    bool fetch = kind == engine->mem_fetch;
    if (!fetch) {
        vb_cpu_go_on(cpu);
    } else if (never_executes(address)) {
        return false;
    }
    page->address = address;
    page->permissions = engine->prot_all;
    if (address - VB_RAM_START < VB_RAM_BYTES) {
        bool *executes = &cpu->executes[(address - VB_RAM_START) / VB_PAGE_BYTES];
        *executes = *executes || fetch;
        if (!*executes) {
            page->permissions &= ~engine->prot_exec;
        }
    }
    return true;
}
