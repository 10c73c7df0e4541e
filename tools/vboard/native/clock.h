/* Virtual time and what is due when; the native half of vboard/core/clock.py.
 *
 * Time is a whole number of ticks of 1/84 us. Events of the native models stand in slots; those of
 * Python stay in Python's heap, of which the clock knows the first. What is due at the same time
 * comes in the order of scheduling, whoever scheduled it.
 *
 * The clock also keeps the first failure: what happens inside a call has no other way out.
 */
#ifndef VBOARD_CLOCK_H
#define VBOARD_CLOCK_H

#include <stdbool.h>
#include <stdint.h>

#define VB_TICKS_PER_S 84000000LL
#define VB_NEVER INT64_MAX
#define VB_SLOTS 32
#define VB_NO_SLOT (-1)
#define VB_MESSAGE_BYTES 256

typedef enum { VB_OK, VB_VIOLATION, VB_LOCKUP, VB_PYTHON } vb_failure_t;

typedef void (*vb_fire_t)(void *owner);

typedef struct {
    int64_t due; /* VB_NEVER: not armed */
    uint64_t number;
    vb_fire_t fire; /* NULL: free */
    void *owner;
} vb_slot_t;

/* The first members, up to run_foreign, are shared with Python (vboard/native/library.py). */
typedef struct {
    int64_t now;
    uint64_t number; /* of the last event scheduled, by anybody */
    int64_t foreign_due;
    uint64_t foreign_number;
    /* The register, by its address, that a load from Python's part of the bus has left to be read
     * again with the same value and without effect: until any of Python's code runs, which forgets
     * it. 0: none. Firmware asks by the thousand whether the flash is ready. */
    int64_t steady_at, steady_value;
    int64_t failure; /* vb_failure_t */
    char message[VB_MESSAGE_BYTES];
    void (*run_foreign)(void); /* runs Python's first event and tells of the next one */
    vb_slot_t slots[VB_SLOTS];
} vb_clock_t;

void vb_clock_init(vb_clock_t *clock, void (*run_foreign)(void));

/* A slot for events of |owner|; there must be a free one. */
int vb_clock_reserve(vb_clock_t *clock, vb_fire_t fire, void *owner);

/* Gives a slot back. VB_NO_SLOT is ignored here and below. */
void vb_clock_release(vb_clock_t *clock, int slot);

/* Calls the owner once when time reaches |due|, or now if that has passed; replaces what was. */
void vb_clock_arm(vb_clock_t *clock, int slot, int64_t due);
void vb_clock_disarm(vb_clock_t *clock, int slot);

/* When the slot is due; VB_NEVER when it is not armed. */
int64_t vb_clock_due(const vb_clock_t *clock, int slot);

/* Time of the next event of anybody; VB_NEVER when there is none. */
int64_t vb_clock_next_due(const vb_clock_t *clock);

/* Runs all that is due up to and including |until|, each at its own time. Ends early, with false,
 * at a failure. */
bool vb_clock_advance(vb_clock_t *clock, int64_t until);

/* Notes a failure with a message as of printf(); later ones are ignored. */
void vb_clock_fail(vb_clock_t *clock, vb_failure_t failure, const char *format, ...)
    __attribute__((format(printf, 3, 4)));

#define vb_violation(clock, ...) vb_clock_fail((clock), VB_VIOLATION, __VA_ARGS__)

#endif
