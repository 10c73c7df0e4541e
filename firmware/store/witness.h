/*
 * The witness: which version of each critical record was stored last, kept outside littlefs.
 *
 * littlefs takes a commit with a wrong CRC for one that a power cut ended, and goes back to the
 * commit before. After a power cut that is right; after a flipped bit it brings back a key that was
 * revoked or a limit that was raised. The witness tells the two apart: each critical record carries
 * a generation (an attribute of its file, committed with it), and the witness, written after that
 * commit, holds the newest generation. A record older than its witness has gone back; one that is
 * newer was stored just before a cut.
 *
 * It lies in raw pages at the end of the store, in its last STORE_RAW_BLOCKS blocks, which littlefs
 * never programs and nothing in littlefs points to. Where programming erases (hal/flash.h), with
 * blocks of 8 pages:
 *
 *   pages 0-3     kept free for the state of a firmware update
 *   pages 4-21    ring of 18 pages, copy A
 *   pages 22-39   the same, copy B; the copies of a version never share a block
 *
 * Where blocks are erased first:
 *
 *   block 0       kept free for the state of a firmware update
 *   blocks 1, 2   ring of all their pages, copy A
 *   blocks 3, 4   the same, copy B
 *
 * A version of the witness is one page, written to place generation % places of both copies. One
 * flipped bit damages one copy at most. There, a block is erased when its first page is due, and
 * never when it alone holds the newest version. A page that a cut left half programmed is passed
 * over. A store that an earlier firmware filled may have files in these blocks: they stay, and
 * their pages are not used until the files are gone.
 *
 * Main loop only. A write takes two page writes, 20 ms at most, and where blocks are erased first
 * two erases once in as many versions as a block has pages; reading the newest page 2 x 256 bytes.
 */
#ifndef STORE_WITNESS_H
#define STORE_WITNESS_H

#include "store/store.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define WITNESS_PLACES 18u /* of each copy where programming erases */
#define WITNESS_ENTRIES 6u
#define WITNESS_NOTE_BYTES 136u

/* What is known of one record. */
typedef struct {
    uint32_t generation; /* 0 = nothing is known */
    uint32_t crc;        /* the one the record states; 0 = there is no such record */
} witness_entry_t;

typedef struct {
    uint32_t generation; /* of this version of the witness */
    uint32_t alarm;      /* not 0: a record went back, and nobody has cleared that yet */
    witness_entry_t entry[WITNESS_ENTRIES];
    uint8_t note[WITNESS_NOTE_BYTES]; /* contents that are kept here as well (critical.c) */
} witness_t;

/* The newest intact version into |witness|, and store->generation. False, and zeros, when there is
 * none. Looks at both rings. */
bool witness_find(store_t *store, witness_t *witness);

/* The version that store->generation names, or witness_find() when it cannot be read. */
bool witness_read(store_t *store, witness_t *witness);

/* Writes |witness| as the next version. STORE_NOT_FOUND: files lie in all of its pages; STORE_IO:
 * no page takes it. Neither harms: an older witness only knows less. */
store_result_t witness_write(store_t *store, witness_t *witness);

#endif
