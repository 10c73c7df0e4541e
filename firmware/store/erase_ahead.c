#include "store/erase_ahead.h"

#include "store/blockdev.h"
#include "store/store_call.h"

/* A file's block begins with two of littlefs's pointers on average. */
#define POINTERS_BYTES 16u
/* A folder of 16 pages that has just been compacted takes so many commits until the next time;
 * then it moves, for its other half is not blank. */
#define COMMITS_PER_MOVE 8u
/* What else may be taken: a folder that splits, the superblock that expands, two moves, and what
 * the start itself stores (key, first amplitudes). */
#define MORE_BLOCKS 16u
#define TRIES 4u /* erases in one step, of which all but the last failed */

uint32_t erase_ahead_moves(const store_t *store, uint32_t bytes, uint32_t syncs) {
    const uint32_t block_bytes = store_block_bytes(store->hal);
    const uint32_t data = bytes / (block_bytes - POINTERS_BYTES) + 1u;
    return (data + syncs + syncs / COMMITS_PER_MOVE + MORE_BLOCKS) * block_bytes;
}

/* littlefs looks for free blocks anew, from where it is: then what is free now comes in turn. */
static void look_anew(lfs_t *lfs) {
    lfs->lookahead.start = (lfs->lookahead.start + lfs->lookahead.next) % lfs->block_count;
    lfs->lookahead.next = lfs->lookahead.size = 0;
    lfs->lookahead.ckpoint = (lfs_block_t)lfs->block_count;
}

/* The erases of one step. */
typedef struct {
    uint32_t tries;
    bool erased;
} step_t;

static bool goes_on(const step_t *step) { return !step->erased && step->tries < TRIES; }

/* Whether |block| is blank now. */
static bool make_blank(store_t *store, uint32_t block, step_t *step) {
    if (blockdev_is_blank(store, block)) {
        return true;
    }
    if (!goes_on(step)) {
        return false;
    }
    step->tries++;
    step->erased = blockdev_erase(store, block);
    return step->erased;
}

/* The old halves of |folder|'s pairs. */
static void erase_old_halves(store_t *store, const char *folder, step_t *step) {
    lfs_dir_t dir;
    struct lfs_info info;
    int more = lfs_dir_open(&store->lfs, &dir, folder);
    if (more < 0) {
        return;
    }
    do {
        (void)make_blank(store, dir.m.pair[1], step);
        more = goes_on(step) ? lfs_dir_read(&store->lfs, &dir, &info) : 0;
    } while (more > 0);
    (void)lfs_dir_close(&store->lfs, &dir);
    store->lfs.rcache.block = (lfs_block_t)-1; /* it may hold what has been erased */
}

/* Free blocks in littlefs's order; how many of the first |wanted| are blank. */
static uint32_t erase_free(store_t *store, const store_usage_t *usage, uint32_t wanted,
                           step_t *step) {
    const lfs_t *lfs = &store->lfs;
    uint32_t blank = 0;
    for (uint32_t i = 0; i < lfs->block_count && blank < wanted && goes_on(step); i++) {
        const uint32_t block = (lfs->lookahead.start + i) % lfs->block_count;
        const bool used = (usage->seen[block / 8u] & 1u << block % 8u) != 0u;
        blank += !used && make_blank(store, block, step);
    }
    return blank;
}

store_result_t erase_ahead_step(store_t *store, uint32_t room_bytes, bool *done) {
    static const char *const folders[] = {"/", "/in", "/trials"};
    const uint32_t wanted = room_bytes / store_block_bytes(store->hal);
    step_t step = {0};
    store_usage_t usage;
    *done = false;
    if (!store_find_usage(store, &usage)) {
        return STORE_IO;
    }
    look_anew(&store->lfs);
    for (uint32_t f = 0; f < sizeof folders / sizeof folders[0] && goes_on(&step); f++) {
        erase_old_halves(store, folders[f], &step);
    }
    const uint32_t blank = erase_free(store, &usage, wanted, &step);
    *done = blank == wanted && !step.erased;
    if (step.tries == TRIES && !step.erased) {
        store->hurt = true;
        return STORE_IO;
    }
    return goes_on(&step) && blank < wanted ? STORE_NO_SPACE : STORE_OK;
}
