/*
 * Who may move the tail, and when: one transition table over (state, event).
 *
 *   BOOT -> IDLE -> ARMED -> RUNNING -> SETTLING -> IDLE       learning only from IDLE
 *   RUNNING --abort--> ABORTED, any but BOOT --fault--> FAULT; both stay until cleared.
 *
 * In ARMED nothing is cut yet: an abort by command and a lost link disarm without leaving a reason,
 * other aborts are refused. A fault in ABORTED leads to FAULT and leaves the reason of the abort;
 * one in FAULT changes nothing.
 *
 * The amplitude may be nonzero only in RUNNING. Pure; guards that need the rest of the board are
 * checked by the caller before it sends the event. Not for interrupts.
 */
#ifndef SUPERVISOR_SUPERVISOR_H
#define SUPERVISOR_SUPERVISOR_H

#include "supervisor/faults.h"

#include <stdbool.h>
#include <stdint.h>

typedef enum {
    STATE_BOOT = 0,
    STATE_IDLE = 1,
    STATE_ARMED = 2,
    STATE_RUNNING = 3,
    STATE_SETTLING = 4,
    STATE_LEARNING = 5,
    STATE_ABORTED = 6, /* a trial was cut short; tail stopped until cleared */
    STATE_FAULT = 7,   /* the board does not trust itself; tail stopped until cleared */
    STATE_COUNT
} state_t;

typedef enum {
    EVENT_BOOTED = 0,
    EVENT_ARM,
    EVENT_DISARM,
    EVENT_START,
    EVENT_SWUM,    /* the last beat is over */
    EVENT_SETTLED, /* late samples are in, the trial is stored */
    EVENT_LEARN,
    EVENT_LEARNED, /* or the update was refused */
    EVENT_STOP,    /* a stop rule or an abort; carries a fault_t */
    EVENT_CLEAR,
    EVENT_COUNT
} event_t;

typedef struct {
    state_t state;
    fault_t reason; /* of ABORTED and FAULT; the first one stays until cleared. Else FAULT_NONE */
} supervisor_t;

void supervisor_init(supervisor_t *supervisor);

/* Applies |event|; |fault| matters for EVENT_STOP only. Returns whether the event was taken; a
 * refused event changes nothing. */
bool supervisor_event(supervisor_t *supervisor, event_t event, fault_t fault);

/* Whether |event| would be taken now; EVENT_STOP: whether an abort by command would. */
bool supervisor_allows(const supervisor_t *supervisor, event_t event);

/* MAV_MODE_FLAG_SAFETY_ARMED: ARMED or RUNNING. */
bool state_is_armed(state_t state);

/* IDLE, ABORTED or FAULT: nothing swims, nothing is about to, and no trial is being taught. */
bool state_is_at_rest(state_t state);

/* "IDLE", ... */
const char *state_name(state_t state);

#endif
