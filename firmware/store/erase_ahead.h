/*
 * Blocks erased ahead, on a flash that erases first (hal/flash.h): an erase takes up to seconds, so
 * none may run while a trial is open. Before the trial, in steps of one erase: the blocks that
 * littlefs will take next, in its order, and the half of each folder's pair that its next
 * compaction goes to. During the trial a block that is not blank counts as a bad one, and littlefs
 * passes it over. Where programming erases, none of this is needed.
 *
 * Main loop only; all but erase_ahead_room() and erase_ahead_forbid() only where blocks are erased
 * first.
 */
#ifndef STORE_ERASE_AHEAD_H
#define STORE_ERASE_AHEAD_H

#include "store/store.h"

/* The bytes of all blocks that a log of at most |bytes| bytes and |syncs| syncs takes one after the
 * other, and leaves behind: one for each sync, after which littlefs moves the last block, and those
 * of its folder. */
uint32_t erase_ahead_moves(const store_t *store, uint32_t bytes, uint32_t syncs);

/* The room that such a log needs, bytes. */
static inline uint32_t erase_ahead_room(const store_t *store, uint32_t bytes, uint32_t syncs) {
    return store_erases_first(store->hal) ? erase_ahead_moves(store, bytes, syncs) : bytes;
}

/* Erases the next block that is missing, and sets |*done| once |room_bytes| of blank blocks come
 * next. STORE_NO_SPACE: so many are not free, or they do not become blank. One call takes one
 * erase; for each block that fails, one more, a few at most. */
store_result_t erase_ahead_step(store_t *store, uint32_t room_bytes, bool *done);

/* While |forbidden| nothing is erased; what asked for it is counted in store->erases_refused. */
static inline void erase_ahead_forbid(store_t *store, bool forbidden) {
    if (store_erases_first(store->hal)) {
        store->erase_forbidden = forbidden;
    }
}

#endif
