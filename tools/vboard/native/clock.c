#include "clock.h"

#include "check.h"
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#define FOREIGN VB_SLOTS

void vb_clock_init(vb_clock_t *clock, void (*run_foreign)(void)) {
    VB_CHECK(run_foreign != NULL);
    memset(clock, 0, sizeof *clock);
    clock->foreign_due = VB_NEVER;
    clock->run_foreign = run_foreign;
    for (int i = 0; i < VB_SLOTS; i++) {
        clock->slots[i].due = VB_NEVER;
    }
}

int vb_clock_reserve(vb_clock_t *clock, vb_fire_t fire, void *owner) {
    VB_CHECK(fire != NULL);
    for (int i = 0; i < VB_SLOTS; i++) {
        if (clock->slots[i].fire == NULL) {
            clock->slots[i] = (vb_slot_t){VB_NEVER, 0, fire, owner};
            return i;
        }
    }
    VB_CHECK(!"a free slot");
    return VB_NO_SLOT;
}

void vb_clock_release(vb_clock_t *clock, int slot) {
    if (slot != VB_NO_SLOT) {
        clock->slots[slot] = (vb_slot_t){VB_NEVER, 0, NULL, NULL};
    }
}

void vb_clock_arm(vb_clock_t *clock, int slot, int64_t due) {
    if (slot == VB_NO_SLOT) {
        return;
    }
    VB_CHECK(clock->slots[slot].fire != NULL);
    clock->slots[slot].due = due > clock->now ? due : clock->now;
    clock->slots[slot].number = ++clock->number;
}

void vb_clock_disarm(vb_clock_t *clock, int slot) {
    if (slot != VB_NO_SLOT) {
        clock->slots[slot].due = VB_NEVER;
    }
}

int64_t vb_clock_due(const vb_clock_t *clock, int slot) {
    return slot == VB_NO_SLOT ? VB_NEVER : clock->slots[slot].due;
}

/* The first of all events: a slot or FOREIGN. */
static int first(const vb_clock_t *clock, int64_t *due) {
    int best = FOREIGN;
    uint64_t number = clock->foreign_number;
    *due = clock->foreign_due;
    for (int i = 0; i < VB_SLOTS; i++) {
        const vb_slot_t *slot = &clock->slots[i];
        if (slot->due < *due ||
            (slot->due == *due && slot->due != VB_NEVER && slot->number < number)) {
            best = i;
            *due = slot->due;
            number = slot->number;
        }
    }
    return best;
}

int64_t vb_clock_next_due(const vb_clock_t *clock) {
    int64_t due = VB_NEVER;
    (void)first(clock, &due);
    return due;
}

bool vb_clock_advance(vb_clock_t *clock, int64_t until) {
    VB_CHECK(until < VB_NEVER);
    int64_t due = VB_NEVER;
    for (int next = first(clock, &due); due <= until; next = first(clock, &due)) {
        clock->now = due > clock->now ? due : clock->now;
        if (next == FOREIGN) {
            clock->run_foreign();
        } else {
            clock->slots[next].due = VB_NEVER;
            clock->slots[next].fire(clock->slots[next].owner);
        }
        if (clock->failure != VB_OK) {
            return false;
        }
    }
    clock->now = until > clock->now ? until : clock->now;
    return true;
}

void vb_clock_fail(vb_clock_t *clock, vb_failure_t failure, const char *format, ...) {
    if (clock->failure != VB_OK) {
        return;
    }
    clock->failure = failure;
    va_list arguments;
    va_start(arguments, format);
    (void)vsnprintf(clock->message, sizeof clock->message, format, arguments);
    va_end(arguments);
}
