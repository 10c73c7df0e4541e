/* Watchdog: one write of its mode per reset, then it is fed or it bites; as vboard/periph/wdt.py.
 */
#ifndef VBOARD_WATCHDOG_H
#define VBOARD_WATCHDOG_H

#include "soc.h"

/* The first members, up to |shortest_left_s|, are shared with Python (vboard/native/library.py). */
typedef struct {
    int64_t fed;
    double shortest_left_s; /* negative: never fed */
    vb_soc_t *soc;
    int slot;
    bool mode_written, idle;
    int64_t fed_at; /* VB_NEVER: not since the reset */
    int64_t since;  /* VB_NEVER: held */
    double left;    /* counts left when it was last held */
    uint32_t flags, mode;
} vb_watchdog_t;

void vb_watchdog_init(vb_watchdog_t *dog, vb_soc_t *soc);

/* Runs from the reset on, with the longest time. */
void vb_watchdog_reset(vb_watchdog_t *dog);

/* Counts left. */
double vb_watchdog_counter(const vb_watchdog_t *dog);

/* The processor goes to sleep or wakes. */
void vb_watchdog_idle(vb_watchdog_t *dog, bool sleeping);

/* Around a change of the slow clock. */
void vb_watchdog_hold(vb_watchdog_t *dog);
void vb_watchdog_run(vb_watchdog_t *dog);

vb_access_t vb_watchdog_read(vb_watchdog_t *dog, uint32_t offset, uint32_t *value);
vb_access_t vb_watchdog_write(vb_watchdog_t *dog, uint32_t offset, uint32_t value);

#endif
