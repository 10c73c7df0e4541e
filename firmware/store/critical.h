/*
 * The critical records: what the board must never silently lose or bring back. Each is a file in
 * the root folder that carries a generation, and has an entry in the witness (store/witness.h).
 *
 * The file is replaced first, then the witness is written: after a cut between the two the file is
 * newer than its witness, which is no fault. A removal goes the other way round, and the next boot
 * ends it. Small contents are kept in the witness as well, as a second copy: the key, the counter
 * and the limits among the parameters.
 *
 * Main loop only; a call writes as much as store_replace() and two pages more.
 */
#ifndef STORE_CRITICAL_H
#define STORE_CRITICAL_H

#include "params/limits.h"
#include "store/witness.h"

#define KEY_PATH "/key.bin" /* not in the FTP tree */
#define REFERENCE_PATH "/reference.bin"
#define LEARNED_PATH "/learned.bin"
#define PENDING_PATH "/pending.bin"
#define PARAMS_PATH "/params.bin"
#define COUNTER_PATH "/counter.bin"

typedef enum {
    CRITICAL_KEY,
    CRITICAL_REFERENCE,
    CRITICAL_LEARNED,
    CRITICAL_PENDING,
    CRITICAL_PARAMS,
    CRITICAL_COUNTER,
    CRITICAL_COUNT /* also: no critical record */
} critical_t;

_Static_assert(CRITICAL_COUNT == WITNESS_ENTRIES, "an entry for each");

const char *critical_path(critical_t kind);

/* Replaces the record |kind|, then its entry in the witness. The result is that of the file: a
 * witness that cannot be written only knows less. */
store_result_t critical_replace(store_t *store, critical_t kind, const void *bytes, size_t length);

/* The number of the next trial. It changes with every trial and is kept in the witness alone, whose
 * two copies outlive what a file would: a file of each trial's number costs a block and would wear
 * the busiest pages a twentieth faster (tests/unit/test_wear.c). Where there is no room for a
 * witness it is the record CRITICAL_COUNTER. */
store_result_t critical_count(store_t *store, uint32_t next_trial);

/* The record |kind| is about to be removed: from now on a boot that finds it removes it. */
store_result_t critical_drop(store_t *store, critical_t kind);

/* How a file stands to its witness. */
typedef enum {
    CRITICAL_SAME,    /* or nothing is known of it */
    CRITICAL_NEWER,   /* stored just before a cut */
    CRITICAL_UNKNOWN, /* stored by a firmware that does not know the witness */
    CRITICAL_OLDER,   /* gone back, or gone */
    CRITICAL_DROPPED  /* was to be removed */
} critical_age_t;

/* |crc|: the one the file states, 0 when it cannot be read. */
critical_age_t critical_age(store_t *store, const witness_t *witness, critical_t kind,
                            uint32_t crc);

/* The second copies. A key or counter as its whole record: its bytes into |out|, which holds
 * RECORD_KEY_MAX_BYTES; their number is returned, 0 when there is none. */
size_t critical_copy(const witness_t *witness, critical_t kind, uint8_t *out);
void critical_limits(const witness_t *witness, float limits[LIMIT_COUNT]);

/* Whether a record went back and nobody has cleared that yet; lasts over restarts. */
store_result_t critical_set_alarm(store_t *store, bool alarm);

/* After a firmware that does not know the witness: the entries say nothing any more, and go. */
void critical_forget(store_t *store);

#endif
