/* Timer counter channel: a 32-bit counter with RC compare, up or up to RC; as vboard/periph/tc.py.
 */
#ifndef VBOARD_TIMER_H
#define VBOARD_TIMER_H

#include "soc.h"

#define VB_TIMER_NAME_BYTES 8
#define VB_COMPARES 3 /* RA, RB, RC */

typedef struct {
    vb_soc_t *soc;
    char name[VB_TIMER_NAME_BYTES];
    int pid;
    int slot;
    bool running;
    int64_t unit;  /* clock ticks per count */
    int64_t since; /* when the count was |count| */
    int64_t count;
    uint32_t flags, mask, mode;
    uint32_t compare[VB_COMPARES];
} vb_timer_t;

void vb_timer_init(vb_timer_t *timer, vb_soc_t *soc, const char *name, int pid);
void vb_timer_reset(vb_timer_t *timer);

/* The clock's frequency changes or changed. */
void vb_timer_retime(vb_timer_t *timer);

vb_access_t vb_timer_read(vb_timer_t *timer, uint32_t offset, uint32_t *value);
vb_access_t vb_timer_write(vb_timer_t *timer, uint32_t offset, uint32_t value);

#endif
