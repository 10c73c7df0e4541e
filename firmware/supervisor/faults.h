/*
 * Every reason why the tail stopped or the board refused, once: number, name, what it means, what
 * to do (faults.def). The firmware sends numbers, the host tool prints the words, the docs list
 * them. Numbers are stable for ever.
 */
#ifndef SUPERVISOR_FAULTS_H
#define SUPERVISOR_FAULTS_H

#include <stdint.h>

typedef enum {
#define FAULT(number, name, kind, meaning, remedy) FAULT_##name = number,
#include "supervisor/faults.def"
#undef FAULT
} fault_t;

typedef enum {
    FAULT_KIND_NONE = 0,
    FAULT_KIND_ABORT = 1,  /* a running trial is cut: ABORTED */
    FAULT_KIND_FAULT = 2,  /* the board needs looking at: FAULT */
    FAULT_KIND_REFUSAL = 3 /* a request was turned down; nothing changed */
} fault_kind_t;

typedef struct {
    uint16_t number;
    fault_kind_t kind;
    const char *name;
    const char *meaning; /* at most 49 characters: it travels in one STATUSTEXT */
} fault_info_t;

/* Rows in rising order of number. */
uint16_t fault_count(void);
const fault_info_t *fault_row(uint16_t row);

/* What to do about the fault of a row; "" for FAULT_NONE. The host tool prints it; the firmware has
 * no use for it, so it stays out of the image. */
const char *fault_remedy(uint16_t row);

/* The row of |fault|; that of FAULT_NONE when there is no such number. Never NULL. */
const fault_info_t *fault_info(fault_t fault);

#endif
