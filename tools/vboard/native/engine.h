/* What is used of Unicorn, as Python loaded it: functions, and numbers that its headers define. The
 * library is neither linked nor are its headers needed. */
#ifndef VBOARD_ENGINE_H
#define VBOARD_ENGINE_H

#include <stddef.h>
#include <stdint.h>

enum { VB_ENTRY_REGISTERS = 9, VB_CALLER_SAVED = 6, VB_MASKS = 3 };

/* Mirrored in vboard/native/library.py. */
typedef struct {
    int (*emu_start)(void *engine, uint64_t begin, uint64_t until, uint64_t timeout, size_t count);
    int (*emu_stop)(void *engine);
    int (*reg_read)(void *engine, int id, void *value);
    int (*reg_write)(void *engine, int id, const void *value);
    int (*reg_read_batch)(void *engine, const int *ids, void **values, int count);
    int (*reg_write_batch)(void *engine, const int *ids, void *const *values, int count);
    void *handle;
    uint64_t *begun, *wanted; /* instructions of the slice, see vboard/core/counter.py */
    /* Register numbers. R0 to R3, R12, LR, XPSR, SP, CONTROL; PRIMASK, BASEPRI, FAULTMASK. */
    int32_t entry[VB_ENTRY_REGISTERS];
    int32_t masks[VB_MASKS];
    int32_t pc, msp, psp, apsr;
    /* Errors of emu_start, kinds of memory accesses, permissions. */
    int32_t ok, read_unmapped, write_unmapped, fetch_unmapped, read_prot, write_prot, fetch_prot;
    int32_t insn_invalid, exception, mem_read_prot, mem_write_prot, mem_fetch;
    uint32_t prot_all, prot_exec;
} vb_engine_t;

#endif
