#include "crash.h"

#include "base/crc.h"
#include "base/panic.h"
#include "hal/clock.h"
#include "hal/system.h"
#include "memory_map.h"
#include "registers/cortex_m3.h"

#include <string.h>

/* The board's one, whose time the record has. */
extern hal_t board;

#define RECORD_MAGIC 0x43524153u

/* What the core pushes on the stack when it takes an exception (ARMv7-M, B1.5.6). */
typedef struct {
    uint32_t r0, r1, r2, r3, r12, lr, pc, xpsr;
} exception_frame_t;

/* In the order of hal_crash_t.registers (ARMv7-M, B1.5 and B3.2). */
enum { R0, R1, R2, R3, R12, XPSR, EXC_RETURN, CFSR, HFSR, MMFAR, BFAR, ICSR, REGISTERS };
static const char register_names[REGISTERS][HAL_CRASH_NAME_BYTES] = {
    "r0", "r1", "r2", "r3", "r12", "xpsr", "exc_ret", "cfsr", "hfsr", "mmfar", "bfar", "icsr"};
_Static_assert(REGISTERS <= HAL_CRASH_REGISTERS, "each has a place");

#define XPSR_PADDED 0x00000200u

/* Exception numbers; memory and bus faults lie between them. */
#define HARD_FAULT 3u
#define USAGE_FAULT 6u

typedef struct {
    uint32_t magic;
    uint32_t crc; /* of what follows */
    uint32_t present;
    uint32_t crashes;
    hal_crash_t crash;
} record_t;

static NOINIT record_t record;

/* The run's own stack may be what went wrong. */
#define EMERGENCY_STACK_WORDS 128u
static NOINIT uint64_t emergency_stack[EMERGENCY_STACK_WORDS / 2u];

/* A number instead of a flag: a crash may come before RAM is set up. */
#define RECORDING 0x52454331u
static uint32_t recording;

static uint32_t record_crc(void) {
    const size_t start = offsetof(record_t, present);
    return crc32_update(0, (const uint8_t *)&record + start, sizeof record - start);
}

static bool record_valid(void) {
    return record.magic == RECORD_MAGIC && record.crc == record_crc();
}

static void record_seal(void) {
    record.magic = RECORD_MAGIC;
    record.crc = record_crc();
}

static void record_begin(hal_crash_kind_t kind) {
    const uint32_t crashes = record_valid() ? record.crashes : 0;
    memset(&record, 0, sizeof record);
    record.present = 1;
    record.crashes = crashes + 1u;
    record.crash.kind = kind;
    record.crash.crashes = record.crashes;
    record.crash.time_us = hal_time_us(&board);
    record.crash.registers[CFSR] = SCB->CFSR;
    record.crash.registers[HFSR] = SCB->HFSR;
    record.crash.registers[MMFAR] = SCB->MMFAR;
    record.crash.registers[BFAR] = SCB->BFAR;
    record.crash.registers[ICSR] = SCB->ICSR;
}

/* Below the stack's bottom there is nothing worth keeping. */
static void record_stack(uint32_t sp) {
    hal_crash_t *crash = &record.crash;
    const uint32_t top = (uint32_t)__stack_top;
    const uint32_t bottom = (uint32_t)__stack_bottom;
    crash->sp = sp;
    uint32_t from = sp < bottom ? bottom : sp & ~3u;
    while (from < top && crash->stack_words < HAL_CRASH_STACK_WORDS) {
        crash->stack[crash->stack_words++] = *(const uint32_t *)from;
        from += 4u;
    }
}

/* A fault whose handler may not run arrives as a hard fault; CFSR knows what it was. */
static hal_crash_kind_t kind_of_exception(void) {
    const uint32_t number = FIELD_OF(SCB->ICSR, SCB_ICSR_VECTACTIVE);
    const uint32_t cfsr = SCB->CFSR;
    if (number < HARD_FAULT || number > USAGE_FAULT) {
        return HAL_CRASH_INTERRUPT;
    }
    if ((cfsr & SCB_CFSR_MMFSR) != 0) {
        return HAL_CRASH_MEMORY_FAULT;
    }
    if ((cfsr & SCB_CFSR_BFSR) != 0) {
        return HAL_CRASH_BUS_FAULT;
    }
    return (cfsr & SCB_CFSR_UFSR) != 0 ? HAL_CRASH_USAGE_FAULT : HAL_CRASH_HARD_FAULT;
}

/* On an overflowed stack the core could not push the frame: what lies there is old. */
static bool frame_good(const exception_frame_t *frame) {
    const uint32_t at = (uint32_t)frame;
    return (record.crash.registers[CFSR] & (SCB_CFSR_MSTKERR | SCB_CFSR_STKERR)) == 0 &&
           at % 4u == 0 && at >= (uint32_t)__stack_bottom &&
           at <= (uint32_t)__stack_top - sizeof *frame;
}

static void record_frame(const exception_frame_t *frame, uint32_t exc_return) {
    hal_crash_t *crash = &record.crash;
    crash->registers[EXC_RETURN] = exc_return;
    if (!frame_good(frame)) {
        record_stack((uint32_t)frame);
        return;
    }
    crash->registers[R0] = frame->r0;
    crash->registers[R1] = frame->r1;
    crash->registers[R2] = frame->r2;
    crash->registers[R3] = frame->r3;
    crash->registers[R12] = frame->r12;
    crash->registers[XPSR] = frame->xpsr;
    crash->return_address = frame->lr;
    crash->pc = frame->pc;
    const uint32_t padding = (frame->xpsr & XPSR_PADDED) != 0 ? 4u : 0;
    record_stack((uint32_t)(frame + 1) + padding);
}

static void record_where(const char *where) {
    const size_t length = strlen(where);
    const size_t room = sizeof record.crash.where - 1u;
    memcpy(record.crash.where, length > room ? where + length - room : where,
           length > room ? room : length);
}

/* Whoever crashes while recording a crash goes straight on to the restart, with what is recorded.
 */
static bool crash_begin(void) {
    cpu_interrupts_off();
    servo_kill();
    const bool first = recording != RECORDING;
    recording = RECORDING;
    return first;
}

static _Noreturn void crash_end(void) {
    record_seal();
    chip_restart();
}

/* Called from crash_entry_isr, on the emergency stack. */
_Noreturn __attribute__((used)) void crash_from_exception(const exception_frame_t *frame,
                                                          uint32_t exc_return) {
    MPU->CTRL = 0;
    cpu_barrier();
    if (crash_begin()) {
        record_begin(kind_of_exception());
        record_frame(frame, exc_return);
    }
    crash_end();
}

/* Bit 2 of the exception return value says which stack the frame is on (ARMv7-M, B1.5.8). */
__attribute__((naked)) void crash_entry_isr(void) {
    __asm__ volatile("cpsid i\n\t"
                     "tst lr, #4\n\t"
                     "ite eq\n\t"
                     "mrseq r0, msp\n\t"
                     "mrsne r0, psp\n\t"
                     "mov r1, lr\n\t"
                     "ldr r2, =%c0\n\t"
                     "mov sp, r2\n\t"
                     "b crash_from_exception\n\t"
                     ".ltorg"
                     :
                     : "i"(emergency_stack + EMERGENCY_STACK_WORDS / 2u));
}

_Noreturn void panic(const char *where) {
    if (crash_begin()) {
        record_begin(HAL_CRASH_ASSERTION);
        record_where(where);
        record.crash.pc = (uint32_t)__builtin_return_address(0);
        record_stack((uint32_t)__builtin_frame_address(0));
    }
    crash_end();
}

bool hal_crash_read(const hal_t *hal, hal_crash_t *out) {
    (void)hal;
    if (!record_valid() || record.present == 0) {
        return false;
    }
    *out = record.crash;
    return true;
}

const char *hal_crash_register(const hal_t *hal, uint32_t index) {
    (void)hal;
    return index < REGISTERS ? register_names[index] : "";
}

void hal_crash_forget(hal_t *hal) {
    (void)hal;
    if (record_valid()) {
        record.present = 0;
        record_seal();
    }
}
