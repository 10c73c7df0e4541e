/*
 * What a lost filesystem or a damaged file leaves in the blocks.
 *
 * Every record lies in blocks of its own and begins with its magic, so it is found by looking at
 * the first bytes of all blocks, and believed when its CRC is right. Its length need not be known:
 * it ends where the CRC of what has been read is the one it states. A record longer than a block
 * goes on in one that begins with the number of the block before (littlefs SPEC.md, "CTZ
 * skip-lists").
 *
 * Older versions lie around, too. A record that the witness names by its CRC is the newest. Without
 * a witness, trial numbers and the mark of the key tell which is the newest; the reference is the
 * one that the newest trial belongs to. Parameters say nothing of their age: without a witness they
 * count only when all copies are equal. So does a key: one that was replaced must not come back.
 *
 * Uses vault->record and what it has taken of the workspace. Reads all blocks twice; main loop, at
 * boot only.
 */
#ifndef STORE_SALVAGE_FIND_H
#define STORE_SALVAGE_FIND_H

#include "store/critical.h"
#include "store/vault.h"

/* Which reference trials belong to, and how new that is. */
typedef struct {
    uint32_t crc; /* 0 = unknown */
    uint32_t trial;
    uint16_t iteration;
} salvage_origin_t;

typedef struct {
    workspace_content_t *content; /* of the record seen last */
    witness_t witness;            /* entries of 0: nothing is known */
    uint8_t best[CRITICAL_COUNT]; /* first block of the newest; 0 = none */
    bool exact[CRITICAL_COUNT];   /* that is the one which the witness names */
    uint8_t keep[STORE_BLOCK_SET_BYTES];
    salvage_origin_t origin, learned;
    bool origin_fixed; /* by a file that is whole */
    bool anything;     /* there were records or trials */
    bool key_damaged, keys_differ;
    bool params_differ;
    bool key_set;
    uint64_t mark;
    uint32_t key_crc; /* of its bytes; 0 = none found yet */
    uint32_t params_crc, pending_trial, next_trial;
} salvage_t;

/* Looks at all blocks and fills in all but |witness|, |origin_fixed| and what is fixed with it. */
void salvage_look(vault_t *vault, salvage_t *salvage);

/* The record that begins in |block|, into vault->record; its length, 0 when there is none. */
size_t salvage_gather(vault_t *vault, uint8_t block);

/* What the |length| bytes of vault->record are; leaves a reference, a memory or a trial in
 * salvage->content. */
critical_t salvage_kind(const vault_t *vault, const salvage_t *salvage, size_t length,
                        key_record_t *key, uint32_t *counter);

/* The origin of the record of |kind| (LEARNED or PENDING) that salvage_kind() has just seen. */
salvage_origin_t salvage_origin(const salvage_t *salvage, critical_t kind);

/* Trial |trial| has been used. */
void salvage_note_trial(salvage_t *salvage, uint32_t trial);

#endif
